const COLOURS = [1, 2, 3, 4, 5, 6, 7].map((n) => `var(--line-${n})`);
const FEW = 12;  // points of a line that are shown themselves
const HEIGHT = 240, EDGE = { left: 52, right: 12, top: 10, bottom: 34 };

// ------------------------------------------------------------------ small helpers

function addSvg(parent, tag, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}
function rounded(value) {  // to three digits
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  return size >= 1e5 || (size > 0 && size < 1e-3) ? value.toExponential(1) : String(Number(value.toPrecision(3)));
}

// ------------------------------------------------------------------ axes

function range(chart, key, log) {
  let low = Infinity, high = -Infinity;
  for (const line of chart.lines) for (const value of line[key]) if (value !== null) { low = Math.min(low, value); high = Math.max(high, value); }
  if (!(high > low)) { const by = log ? 2 : Math.abs(low) || 1; [low, high] = Number.isFinite(low) ? (log ? [low / by, low * by] : [low - by, low + by]) : [log ? 1 : 0, log ? 10 : 1]; }
  if (key === "at") return [low, high];
  const spare = 0.06;
  return log ? [low / (high / low) ** spare, high * (high / low) ** spare] : [low - spare * (high - low), high + spare * (high - low)];
}
function ticks([low, high], log, most) {
  if (log) {
    const decades = Math.log10(high / low), found = [];
    const parts = decades > 3 ? [1] : decades > 2 ? [1, 3] : decades > 1 ? [1, 2, 5] : [1, 2, 3, 5, 7];
    for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++)
      for (const part of parts) { const at = part * 10 ** power; if (at >= 0.999 * low && at <= 1.001 * high) found.push(at); }
    const every = Math.ceil(found.length / most);
    return found.filter((_, k) => k % every === 0);
  }
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((each) => each * power >= rough) * power, found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
  return found;
}
function scale([low, high], log, from, to) {
  const place = log ? Math.log : (value) => value, a = place(low), b = place(high);
  return (value) => from + (to - from) * (place(value) - a) / (b - a);
}

// ------------------------------------------------------------------ a chart

function draw(figure, chart) {
  const box = figure.querySelector(".plot"), width = box.clientWidth;
  if (!width) return;
  box.replaceChildren();
  const svg = addSvg(box, "svg", { width, height: HEIGHT, role: "img", "aria-label": chart.title });
  const [right, bottom] = [width - EDGE.right, HEIGHT - EDGE.bottom];
  const xs = range(chart, "at", chart.log[0]), ys = range(chart, "y", chart.log[1]);
  const x = scale(xs, chart.log[0], EDGE.left, right), y = scale(ys, chart.log[1], bottom, EDGE.top);
  for (const at of ticks(xs, chart.log[0], width / 70)) {
    addSvg(svg, "line", { x1: x(at), x2: x(at), y1: EDGE.top, y2: bottom, class: "grid" });
    addSvg(svg, "text", { x: x(at), y: bottom + 15, "text-anchor": "middle" }, rounded(at));
  }
  for (const at of ticks(ys, chart.log[1], 6)) {
    addSvg(svg, "line", { x1: EDGE.left, x2: right, y1: y(at), y2: y(at), class: "grid" });
    addSvg(svg, "text", { x: EDGE.left - 7, y: y(at) + 4, "text-anchor": "end" }, rounded(at));
  }
  addSvg(svg, "text", { x: right, y: HEIGHT - 4, "text-anchor": "end" }, chart.x);
  for (const line of [...chart.lines].sort((a, b) => a.strong - b.strong)) {
    let path = "", lifted = true;
    line.at.forEach((at, k) => {
      if (line.y[k] === null) { lifted = true; return; }
      path += `${lifted ? "M" : "L"}${x(at).toFixed(1)} ${y(line.y[k]).toFixed(1)}`; lifted = false;
    });
    const shown = addSvg(svg, "path", { d: path, fill: "none", "stroke-width": line.strong ? 2.2 : 1.1, "stroke-linejoin": "round" });
    shown.style.stroke = colour(chart, line);
    if (line.at.length <= FEW) line.at.forEach((at, k) => {
      if (line.y[k] !== null) addSvg(svg, "circle", { cx: x(at), cy: y(line.y[k]), r: line.at.length > 1 ? 3.5 : 5 }).style.fill = colour(chart, line);
    });
    if (line.dashed) shown.setAttribute("stroke-dasharray", "6 4");
  }
  addMarks(svg, chart.marks.filter((mark) => mark.at >= xs[0] && mark.at <= xs[1]), x, bottom);
  const cursor = addSvg(svg, "line", { y1: EDGE.top, y2: bottom, class: "cursor", visibility: "hidden" });
  const read = (event) => {
    const at = event.clientX - svg.getBoundingClientRect().left;
    if (at < EDGE.left || at > right) return;
    const place = chart.log[0] ? xs[0] * (xs[1] / xs[0]) ** ((at - EDGE.left) / (right - EDGE.left)) : xs[0] + (xs[1] - xs[0]) * (at - EDGE.left) / (right - EDGE.left);
    cursor.setAttribute("x1", at); cursor.setAttribute("x2", at); cursor.setAttribute("visibility", "visible");
    legend(figure, chart, place);
  };
  svg.addEventListener("pointermove", read);
  svg.addEventListener("pointerdown", read);
  svg.addEventListener("pointerleave", () => { cursor.setAttribute("visibility", "hidden"); legend(figure, chart, null); });
}
function addMarks(svg, marks, x, bottom) {  // in rows, where names would overlap
  const ends = [];
  for (const mark of marks) {
    const text = addSvg(svg, "text", { y: 0, "text-anchor": "middle", class: "mark" }, mark.text), half = text.getComputedTextLength() / 2 + 4;
    const at = Math.min(Math.max(x(mark.at), EDGE.left + half), svg.clientWidth - half);
    const free = ends.findIndex((end) => at - half > end), row = free < 0 ? ends.length : free;
    ends[row] = at + half;
    text.setAttribute("x", at); text.setAttribute("y", EDGE.top + 11 + 13 * row);
    addSvg(svg, "line", { x1: x(mark.at), x2: x(mark.at), y1: EDGE.top + 15 + 13 * row, y2: bottom, class: "mark" });
  }
}
const colour = (chart, line) => line.colour || COLOURS[chart.lines.filter((each) => !each.colour).indexOf(line) % COLOURS.length];
function legend(figure, chart, place) {  // names, and values where the pointer is
  const box = figure.querySelector(".key");
  box.replaceChildren(make("span", place === null ? "" : `${rounded(place)} ${chart.x.split(", ")[1] || ""}`, "at"));
  for (const line of chart.lines) {
    const dot = make("i");
    dot.style.background = colour(chart, line);
    let text = line.label;
    if (place !== null) text += ` ${rounded(line.y[nearest(line.at, place)])}`;
    add(box, add(make("span"), dot, text));
  }
}
function nearest(sorted, value) {
  let low = 0, high = sorted.length - 1;
  while (high - low > 1) { const middle = (low + high) >> 1; if (sorted[middle] <= value) low = middle; else high = middle; }
  return value - sorted[low] <= sorted[high] - value ? low : high;
}

// ------------------------------------------------------------------ the page

$("lead").textContent = data.lead;
for (const each of data.cards) card(each.what, each.value, each.unit, each.more, each.kind);
const figures = [];
for (const section of data.sections) {
  const charts = make("div", undefined, "charts");
  for (const chart of section.charts) {
    const figure = add(make("figure"), add(make("figcaption", chart.title), make("small", chart.y && ` ${chart.y}`)), make("div", undefined, "plot"), make("p", undefined, "key"));
    figures.push([figure, chart]);
    add(charts, figure);
  }
  add($("sections"), add(make("section", undefined, "panel"), make("h2", section.title), charts));
}
function drawAll() { for (const [figure, chart] of figures) { draw(figure, chart); legend(figure, chart, null); } }
window.addEventListener("resize", drawAll);
drawAll();
document.body.dataset.ready = "yes";
