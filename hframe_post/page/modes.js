// What the path is coloured by: each mode has a value of a piece, its place on a scale from 0 to 1, and marks on that scale.

const LOW = 1, HIGH = 1000;  // µm
const WIDEST = 0.2;  // share by which a line is too thin or too thick at the ends of the scale
const LINE = 0.4;  // mm of the nozzle's way over which a line's width is taken
let path = null, first = [], most = {};

const place = (k) => [path.x[k] / 100, path.y[k] / 100];
const um = (k, s) => path.error[s][k] / 10;
const isTravel = (k) => (path.feature[k] & 127) === 0;
const isStart = (k) => path.feature[k] >= 128 || k === 0;
const way = (k) => { const [x, y] = place(k), [u, v] = place(k - 1); return [x - u, y - v]; };

function motorSpeed(k) {  // of the faster motor
  if (isStart(k)) return 0;
  const [x, y] = way(k), length = Math.hypot(x, y) || 1;
  return path.speed[k] / length * Math.max(...data.matrix.map(([a, b]) => Math.abs(a * x + b * y)));
}
function acceleration(k) {  // along the path, from one end of the piece to the other
  if (isStart(k)) return 0;
  return Math.abs(path.speed[k] ** 2 - path.speed[k - 1] ** 2) / (2 * Math.max(Math.hypot(...way(k)), 0.05));
}
const widths = {};  // by strategy: of each piece, over that of the slicer's line
function width(k, s) {
  if (!widths[s]) {
    const found = widths[s] = new Float32Array(path.x.length).fill(1), [x, y] = path.nozzle[s];
    let begun = 0, planned = 0, gone = 0;
    const close = (end) => {  // what is left at the end of a line is too short to tell
      if (gone >= LINE) found.fill(planned / gone, begun, end);
      [begun, planned, gone] = [end, 0, 0];
    };
    for (let n = 0; n < found.length; n++) {
      if (isStart(n) || isTravel(n)) { close(n); begun = n + 1; continue; }
      const [dx, dy] = way(n);
      planned += Math.hypot(dx, dy);
      gone += Math.hypot(dx + (x[n] - x[n - 1]) / 100, dy + (y[n] - y[n - 1]) / 100);
      if (gone >= LINE) close(n + 1);
    }
  }
  return widths[s][k];
}

const linear = (unit, of) => ({
  value: of, unit,
  share: (value, name) => value / most[name],
  marks: (name) => [0, 0.5, 1].map((share) => [share, `${Number((share * most[name]).toPrecision(2))}${share === 1 ? ` ${unit}` : ""}`]),
});
const MODES = {
  error: {
    value: um, unit: "µm",
    share: (value) => Math.log(Math.max(value, LOW) / LOW) / Math.log(HIGH / LOW),
    marks: () => [[0, "1"], [1 / 3, "10"], [2 / 3, "100"], [1, "1000 µm"]],
  },
  width: {
    value: (k, s) => 100 * (width(k, s) - 1), unit: "%", diverging: true,
    share: (value) => 0.5 + value / 200 / WIDEST,
    marks: () => [[0, `−${100 * WIDEST}`], [0.5, "0"], [1, `+${100 * WIDEST} %`]],
  },
  speed: linear("mm/s", (k) => path.speed[k]),
  acceleration: linear("mm/s²", acceleration),
  motor: linear("mm/s", motorSpeed),
};
function scales() {  // the ends of the linear scales: what 99.5 % of the printed pieces stay below
  const step = Math.ceil(path.x.length / 20000), printed = [];
  for (let k = 0; k < path.x.length; k += step) if (!isTravel(k) && !isStart(k)) printed.push(k);
  for (const name of ["speed", "acceleration", "motor"]) {
    const values = printed.map((k) => MODES[name].value(k)).sort((a, b) => a - b);
    most[name] = Math.max(values[Math.floor(0.995 * (values.length - 1))] || 0, 1);
  }
}

// ------------------------------------------------------------------ colours

const RAMP = [[0, 88, 138, 190], [1 / 3, 46, 146, 136], [0.466, 178, 132, 20], [2 / 3, 216, 62, 48], [1, 176, 66, 156]];  // calm up to 10 µm
const THIN_TO_THICK = [[0, 52, 104, 214], [0.42, 98, 136, 166], [0.5, 118, 130, 136], [0.58, 160, 128, 100], [1, 216, 62, 48]];
const COLOURS = 48;  // shades
const shadeOf = (share) => Math.min(Math.max(Math.floor(share * COLOURS), 0), COLOURS - 1);
function colour(k, ramp = RAMP) {
  const at = k / (COLOURS - 1), i = Math.max(ramp.findIndex(([to]) => at <= to + 1e-3), 1);
  const [from, ...a] = ramp[i - 1], [to, ...b] = ramp[i], t = (at - from) / (to - from);
  return `rgb(${a.map((c, n) => Math.round(c + t * (b[n] - c))).join(",")})`;
}
const rampOf = (mode) => MODES[mode].diverging ? THIN_TO_THICK : RAMP;
