const state = { layer: 0, strategy: Math.max(data.strategies.findIndex((s) => s.name === data.chosen), 0), mode: "error", hidden: new Set(), until: 1, magnified: 20, scale: 1, x: 0, y: 0, picked: -1 };
const FARTHEST = 1.5;  // mm that the nozzle is drawn off the path; beyond it is compressed
const BARE = 2.5;  // px of a line, below which the nozzle's is not drawn on it; it is drawn in full on twice as wide ones
let rows = null;

// ------------------------------------------------------------------ small helpers

const micrometres = (um) => um >= 99.5 ? um.toFixed(0) : um >= 9.95 ? um.toFixed(0) : um.toFixed(1);
const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const share = (um) => MODES.error.share(um);
function clock(seconds) {
  const s = Math.round(seconds), h = Math.floor(s / 3600), m = Math.floor(s / 60) % 60;
  return h ? `${h} h ${m} min` : m ? `${m} min ${s % 60} s` : `${s} s`;
}
async function unpacked(id) {
  const packed = Uint8Array.from(atob($(id).textContent), (c) => c.charCodeAt(0));
  if (!packed.length) return new ArrayBuffer(0);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

// ------------------------------------------------------------------ the path

async function load() {
  const bytes = await unpacked("segments");
  const n = data.layers.reduce((sum, layer) => sum + layer.count, 0);
  let offset = 0;
  const take = (Kind) => { const made = new Kind(bytes, offset, n); offset += n * Kind.BYTES_PER_ELEMENT; return made; };
  const summed = () => { const made = take(Int32Array); for (let k = 1; k < n; k++) made[k] += made[k - 1]; return made; };
  const each = (make) => data.strategies.map(make), pair = () => [take(Int16Array), take(Int16Array)];
  path = { x: summed(), y: summed(), line: summed(), speed: take(Uint16Array), error: each(() => take(Uint16Array)), nozzle: each(pair), off: each(pair), feature: take(Uint8Array) };
  let start = 0;
  first = data.layers.map((layer) => { const here = start; start += layer.count; return here; });
  first.push(n);
}
const begins = (k) => path.feature[k] >= 128 || k === first[state.layer];
const layerOf = (k) => first.findIndex((start, n) => k >= start && k < first[n + 1]);
function nozzle(k) {  // where it is drawn: its way from the path is magnified
  const [x, y] = place(k), [along, off] = [path.nozzle[state.strategy], path.off[state.strategy]], more = (state.magnified - 1) / 1000;
  return [x + along[0][k] / 100 + more * off[0][k], y + along[1][k] / 100 + more * off[1][k]];
}
function drawn(k) {  // the nozzle, not so far off that corners hide the rest
  const [x, y] = place(k), [u, v] = nozzle(k), far = Math.hypot(u - x, v - y);
  const shown = far > FARTHEST ? FARTHEST * (1 + Math.log(far / FARTHEST)) / far : 1;
  return [x + shown * (u - x), y + shown * (v - y)];
}
async function lineOf(number) {
  if (rows === null) rows = new TextDecoder("utf-8").decode(await unpacked("text")).split("\n");
  return rows[number - 1];
}

// ------------------------------------------------------------------ drawing

const canvas = $("canvas");
function fit() {
  const box = canvas.getBoundingClientRect();
  let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity;
  const shown = Array.from({ length: first[state.layer + 1] - first[state.layer] }, (_, k) => first[state.layer] + k);
  const printed = shown.filter((k) => (path.feature[k] & 127) !== 0);
  for (const k of printed.length ? printed : shown) {  // a journey from far away would make the part small
    const [x, y] = place(k);
    x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y);
  }
  if (!(x1 >= x0)) return;
  state.scale = 0.86 * Math.min(box.width / Math.max(x1 - x0, 1), box.height / Math.max(y1 - y0, 1));
  state.x = (x0 + x1) / 2; state.y = (y0 + y1) / 2;
}
const toScreen = (x, y, box) => [box.width / 2 + (x - state.x) * state.scale, box.height / 2 - (y - state.y) * state.scale];
let asked = false;
function draw() {
  if (!asked) { asked = true; requestAnimationFrame(() => { asked = false; paint(); }); }
}
function paint() {
  if (!path) return;
  const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(box.width * ratio); canvas.height = Math.round(box.height * ratio);
  const ink = canvas.getContext("2d");
  ink.scale(ratio, ratio);
  grid(ink, box);
  const from = first[state.layer], to = from + Math.round(state.until * (first[state.layer + 1] - from));
  const mode = MODES[state.mode], ramp = rampOf(state.mode);
  const strokes = new Array(COLOURS).fill(null), travels = new Path2D(), nozzleLine = new Path2D();
  let [x0, y0] = from < to ? toScreen(...place(from), box) : [0, 0], before = null;
  for (let k = from; k < to; k++) {
    const [x, y] = toScreen(...place(k), box);
    if (!begins(k) && !state.hidden.has(path.feature[k] & 127)) {
      const shown = isTravel(k) ? 0 : shadeOf(mode.share(mode.value(k, state.strategy), state.mode));
      const stroke = isTravel(k) ? travels : (strokes[shown] = strokes[shown] || new Path2D());
      stroke.moveTo(x0, y0); stroke.lineTo(x, y);
      if (!isTravel(k) && state.magnified) before = ringing(nozzleLine, k, before, box);
      else before = null;
    } else before = null;
    x0 = x; y0 = y;
  }
  ink.lineCap = "round"; ink.lineJoin = "round";
  ink.lineWidth = 1; ink.strokeStyle = style("--faint"); ink.setLineDash([2, 4]); ink.stroke(travels); ink.setLineDash([]);
  const wide = Math.min(Math.max(0.38 * state.scale, 1.3), 9), order = [...strokes.keys()];
  if (mode.diverging) order.sort((a, b) => Math.abs(a - COLOURS / 2) - Math.abs(b - COLOURS / 2));
  for (const k of order) if (strokes[k]) {  // the worst on top, and wider where lines are thin
    const bad = mode.diverging ? Math.abs(2 * k / COLOURS - 1) : k / COLOURS;
    ink.lineWidth = wide + Math.max(3 - wide, 0) * bad; ink.strokeStyle = colour(k, ramp); ink.stroke(strokes[k]);
  }
  ink.globalAlpha = Math.min(Math.max((0.38 * state.scale - BARE) / BARE, 0), 1);  // it must not hide the colours
  ink.lineWidth = 1.2; ink.strokeStyle = style("--ink"); ink.stroke(nozzleLine); ink.globalAlpha = 1;
  if (state.until < 1 && to > from) { ink.beginPath(); ink.arc(x0, y0, 6, 0, 7); ink.fillStyle = style("--accent"); ink.fill(); }
  if (state.picked >= from && state.picked < to) {
    const [x, y] = toScreen(...place(state.picked), box);
    ink.beginPath(); ink.arc(x, y, 9, 0, 7); ink.lineWidth = 5; ink.strokeStyle = style("--stage"); ink.stroke();
    ink.beginPath(); ink.arc(x, y, 9, 0, 7); ink.lineWidth = 2.5; ink.strokeStyle = style("--ink"); ink.stroke();
  }
}
function ringing(line, k, before, box) {  // through the middles of the pieces, so that it bends
  const here = toScreen(...drawn(k), box);
  if (before === null) { before = toScreen(...drawn(k - 1), box); line.moveTo(...before); }
  line.quadraticCurveTo(...before, (before[0] + here[0]) / 2, (before[1] + here[1]) / 2);
  return here;
}
function grid(ink, box) {
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100].find((mm) => mm * state.scale >= 56) || 200;
  const [left, right] = [-1, 1].map((side) => state.x + side * box.width / 2 / state.scale);
  const [low, high] = [-1, 1].map((side) => state.y + side * box.height / 2 / state.scale);
  ink.strokeStyle = style("--line"); ink.fillStyle = style("--soft"); ink.lineWidth = 1; ink.font = "11px system-ui, sans-serif";
  const label = (mm) => String(Math.round(mm * 10) / 10);
  for (let x = Math.ceil(left / step) * step; x < right; x += step) {
    const at = Math.round(toScreen(x, 0, box)[0]) + 0.5;
    ink.beginPath(); ink.moveTo(at, 0); ink.lineTo(at, box.height); ink.stroke(); ink.fillText(label(x), at + 4, box.height - 6);
  }
  for (let y = Math.ceil(low / step) * step; y < high; y += step) {
    const at = Math.round(toScreen(0, y, box)[1]) + 0.5;
    ink.beginPath(); ink.moveTo(0, at); ink.lineTo(box.width, at); ink.stroke(); ink.fillText(label(y), 6, at - 4);
  }
}
function strip() {  // the error of each layer, above the slider
  const shown = $("strip"), box = shown.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  shown.width = Math.round(box.width * ratio); shown.height = Math.round(box.height * ratio);
  const ink = shown.getContext("2d"); ink.scale(ratio, ratio);
  const n = data.layers.length, inset = 8, wide = (box.width - 2 * inset) / Math.max(n - 1, 1);
  const height = (um) => box.height * Math.min(Math.max(share(um), 0.06), 1);
  data.layers.forEach((layer, k) => {
    const um = layer.rms[state.strategy];
    ink.fillStyle = colour(shadeOf(share(um))); ink.globalAlpha = k === state.layer ? 1 : 0.45;
    ink.fillRect(inset + (k - 0.5) * wide + (wide > 3 ? 0.5 : 0), box.height - height(um), Math.max(wide - (wide > 3 ? 1 : 0), 1), height(um));
  });
  ink.globalAlpha = 1; ink.fillStyle = style("--ink"); ink.fillRect(inset + state.layer * wide - 1, 0, 2, box.height);
}

// ------------------------------------------------------------------ readout

function showReadout() {
  const layer = data.layers[state.layer];
  $("where").replaceChildren("Layer ", make("b", layer ? layer.name : "–"), ` (${state.layer + 1} of ${data.layers.length})`,
    ...(layer ? data.strategies.flatMap((each, s) => [" · ", each.label, " ", make("b", micrometres(layer.rms[s]) + "\u00a0µm")]) : []));
  document.querySelectorAll("#strategies button").forEach((button, k) => button.setAttribute("aria-checked", String(k === state.strategy)));
  strip(); draw();
}
function show(layer) {
  const n = data.layers.length;
  state.layer = Math.min(Math.max(layer, 0), n - 1);
  $("layer").value = state.layer;
  showReadout();
}
async function pick(k) {
  state.picked = k;
  const [x, y] = place(k), number = path.line[k], feature = data.features[path.feature[k] & 127] || "";
  const text = await lineOf(number);
  if (state.picked !== k) return;
  const code = make("code");
  add(code, make("i", `line ${number}  `), text === undefined || (!rows || rows.length < 2) ? "(the file is too large: its lines are not in this page)" : text.slice(0, 300));
  const facts = make("div", undefined, "facts");
  const fact = (name, value) => add(facts, add(make("span", name + " "), make("b", value)));
  fact("at", `X${x.toFixed(2)} Y${y.toFixed(2)}`);
  fact("feature", feature);
  for (const name of ["speed", "motor", "acceleration"]) fact(name, `${MODES[name].value(k).toFixed(0)} ${MODES[name].unit}`);
  if (!isTravel(k)) fact("line width", `${MODES.width.value(k, state.strategy).toFixed(0)} %`);
  data.strategies.forEach((each, s) => fact(each.label, `${micrometres(um(k, s))} µm`));
  $("place").replaceChildren(code, facts);
  draw();
}
function nearest(px, py) {
  const box = canvas.getBoundingClientRect();
  let best = -1, least = 24 * 24;
  let before = null;
  for (let k = first[state.layer]; k < first[state.layer + 1]; k++) {
    if (state.hidden.has(path.feature[k] & 127)) { before = null; continue; }
    const here = toScreen(...place(k), box);
    const start = begins(k) || !before ? here : before;
    const dx = here[0] - start[0], dy = here[1] - start[1], length2 = dx * dx + dy * dy;
    const t = length2 ? Math.min(Math.max(((px - start[0]) * dx + (py - start[1]) * dy) / length2, 0), 1) : 0;
    const ex = px - start[0] - t * dx, ey = py - start[1] - t * dy;
    const far = ex * ex + ey * ey + ((path.feature[k] & 127) === 0 ? 60 : 0);  // printing before travel
    if (far < least) { least = far; best = k; }
    before = here;
  }
  return best;
}

// ------------------------------------------------------------------ pointers

const fingers = new Map();
let moved = 0;
function zoom(factor, px, py) {
  const box = canvas.getBoundingClientRect();
  const x = state.x + (px - box.width / 2) / state.scale, y = state.y - (py - box.height / 2) / state.scale;
  state.scale = Math.min(Math.max(state.scale * factor, 0.2), 4000);
  state.x = x - (px - box.width / 2) / state.scale; state.y = y + (py - box.height / 2) / state.scale;
  draw();
}
function drag(px, py) { state.x -= px / state.scale; state.y += py / state.scale; draw(); }
const at = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  if (!fingers.size) moved = 0;
  fingers.set(event.pointerId, at(event));
});
canvas.addEventListener("pointermove", (event) => {
  const old = fingers.get(event.pointerId);
  if (!old) return;
  const now = at(event), other = [...fingers].find(([id]) => id !== event.pointerId);
  moved += Math.hypot(now[0] - old[0], now[1] - old[1]);
  if (other) {
    const q = other[1], factor = Math.hypot(now[0] - q[0], now[1] - q[1]) / Math.max(Math.hypot(old[0] - q[0], old[1] - q[1]), 1);
    zoom(factor, (now[0] + q[0]) / 2, (now[1] + q[1]) / 2);
    drag((now[0] - old[0]) / 2, (now[1] - old[1]) / 2);
  } else if (moved > 4) drag(now[0] - old[0], now[1] - old[1]);
  fingers.set(event.pointerId, now);
});
canvas.addEventListener("pointerup", (event) => {
  if (path && fingers.size === 1 && moved <= 4) { const k = nearest(...at(event)); if (k >= 0) pick(k); }
  fingers.delete(event.pointerId);
});
canvas.addEventListener("pointercancel", (event) => fingers.delete(event.pointerId));
canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY / 400), ...at(event)); }, { passive: false });
const middle = () => { const box = canvas.getBoundingClientRect(); return [box.width / 2, box.height / 2]; };
$("closer").addEventListener("click", () => zoom(1.6, ...middle()));
$("farther").addEventListener("click", () => zoom(1 / 1.6, ...middle()));
$("fit").addEventListener("click", () => { fit(); draw(); });
$("layer").addEventListener("input", () => show(Number($("layer").value)));
$("below").addEventListener("click", () => show(state.layer - 1));
$("above").addEventListener("click", () => show(state.layer + 1));
$("until").addEventListener("input", () => { state.until = Number($("until").value) / 1000; draw(); });
const KEYS = {
  ArrowUp: () => show(state.layer + 1), ArrowDown: () => show(state.layer - 1),
  ArrowRight: () => along(0.01), ArrowLeft: () => along(-0.01),
  "+": () => zoom(1.6, ...middle()), "-": () => zoom(1 / 1.6, ...middle()), 0: () => { fit(); draw(); },
};
function along(more) {
  state.until = Math.min(Math.max(state.until + more, 0), 1);
  $("until").value = 1000 * state.until; draw();
}
canvas.addEventListener("keydown", (event) => { if (path && KEYS[event.key] && !event.ctrlKey && !event.metaKey) { event.preventDefault(); KEYS[event.key](); } });
window.addEventListener("resize", () => { if (path) { strip(); draw(); } });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (path) showReadout(); });

// ------------------------------------------------------------------ the page around it

function cards() {
  const whole = Object.fromEntries(data.figures.map((each) => [each.name, each])), before = whole.none, shaper = whole.shaper, chosen = whole[data.chosen];
  for (const each of data.figures) card(each.label, micrometres(each.rms), "µm RMS", each.range ? `${each.range.map(micrometres).join(" to ")} as the printer changes` : `95 % below ${micrometres(each.p95)} µm`, each.name === data.chosen ? "best" : "");
  const [plain, compensated] = data.seconds, longer = 100 * (compensated / plain - 1);
  card("Print time", clock(compensated), "", Math.abs(longer) < 0.05 ? "as long as the sliced file" : `${longer > 0 ? "+" : ""}${longer.toFixed(1)} % for compensation`, "");
  card("Belts at most", String(data.belts.speed[0]), data.belts.speed[1] ? `of ${data.belts.speed[1]} mm/s` : "mm/s", `${data.belts.acceleration.join(" of ")} mm/s²`, "");
  if (before && chosen && data.chosen !== "none") {
    const strong = (each) => make("strong", `${micrometres(each.rms)}\u00a0µm`);
    $("lead").replaceChildren("Predicted distance of the nozzle from the path, RMS: ", strong(chosen), " with compensation, ",
      ...(shaper ? [strong(shaper), " with the best input shaper, "] : []), strong(before), " with neither.");
  } else $("lead").textContent = "Nothing is compensated in this file.";
}
function tables() {
  const table = (id, names, rows) => {
    add($(id), add(make("thead"), add(make("tr"), ...names.map((name) => make("th", name)))), add(make("tbody"), ...rows));
    for (const row of rows) [...row.cells].forEach((cell, k) => { cell.dataset.label = names[k]; });  // shown on phones
  };
  const errors = data.strategies.map((s) => `${s.label}, µm`);
  table("features", ["feature", "of the time", ...errors], data.byFeature.map((each) => {
    const share = make("td"), meter = make("span", undefined, "meter");
    meter.style.width = `${Math.max(60 * each.share, 1)}px`;
    add(share, meter, `${(100 * each.share).toFixed(1)} %`);
    return add(make("tr"), make("td", each.name, "name"), share, ...each.rms.map((um) => make("td", micrometres(um))));
  }));
  table("worst", ["layer", ...errors, "place", "line", "feature", "mm/s"], data.worst.map((k) => {
    const layer = layerOf(k), [x, y] = place(k), row = make("tr", undefined, "go");
    const go = () => { state.x = x; state.y = y; show(layer); state.scale = Math.max(state.scale, 14); pick(k); canvas.scrollIntoView({ behavior: "smooth", block: "center" }); };
    row.tabIndex = 0;
    row.addEventListener("click", go);
    row.addEventListener("keydown", (event) => { if (event.key === "Enter") go(); });
    const cells = [data.layers[layer].name, ...data.strategies.map((_, s) => micrometres(um(k, s))), `X${x.toFixed(1)} Y${y.toFixed(1)}`, path.line[k]];
    return add(row, ...cells.map((text) => make("td", text)), make("td", data.features[path.feature[k] & 127] || "", "name"), make("td", path.speed[k]));
  }));
}
function legend() {  // the scale of what the path is coloured by
  const ink = $("ramp").getContext("2d"), ramp = rampOf(state.mode);
  for (let k = 0; k < COLOURS; k++) { ink.fillStyle = colour(k, ramp); ink.fillRect(k * 256 / COLOURS, 0, 256 / COLOURS + 1, 1); }
  $("marks").replaceChildren(...MODES[state.mode].marks(state.mode).map(([share, text]) => {
    const mark = make("span", text);
    mark.style.left = `${100 * share}%`; mark.style.transform = `translateX(-${100 * share}%)`;
    return mark;
  }));
}
function filters() {  // a switch for each feature of the print
  for (const [k, name] of data.features.entries()) {
    if (!path.feature.some((each) => (each & 127) === k)) continue;
    const box = make("input"), label = make("label");
    box.type = "checkbox"; box.checked = true;
    box.addEventListener("change", () => { if (box.checked) state.hidden.delete(k); else state.hidden.add(k); draw(); });
    add($("filter"), add(label, box, name));
  }
}
function frame() {
  $("mode").addEventListener("change", () => { state.mode = $("mode").value; legend(); draw(); });
  $("magnified").addEventListener("change", () => { state.magnified = Number($("magnified").value); draw(); });
  data.strategies.forEach((each, k) => {
    const button = make("button", each.label);
    button.setAttribute("role", "radio");
    button.addEventListener("click", () => { state.strategy = k; showReadout(); });
    add($("strategies"), button);
  });
  $("layer").max = Math.max(data.layers.length - 1, 0);
  if (data.coarse) $("sampled").textContent = `This print is long: its path is shown in pieces of up to ${data.coarse[0]} mm, each with the largest error of its samples, 4 ms apart; places may be off by ${Math.round(1000 * data.coarse[1])} µm.`;
}
frame(); cards();
load().then(() => {
  $("loading").remove();
  show(Math.floor(data.layers.length / 2));
  scales(); filters(); legend(); fit(); tables(); showReadout();
  document.body.dataset.ready = "yes";
}).catch((error) => { $("loading").textContent = "This browser cannot unpack the view: " + error; throw error; });
