"use strict";
const RATES = [0.5, 1, 2, 5, 10, 20, 50, 100];
const PRINT_WIDTH = 680; // A4 between the margins [px]
const NEAR = 25; // half the width of the close-up [m]
const HEIGHTS = [260, 560]; // smallest and largest height of the map [px]
const NARROW = 900; // below this width the tool bar would cover legends [px]
const CONFIG = {
  displaylogo: false, responsive: true, modeBarButtonsToRemove: ["select2d", "lasso2d"],
  displayModeBar: window.innerWidth < NARROW ? false : "hover",
};
const AXIS_HEIGHT = 52; // numbers and title of the x axis [px]
const at = (id) => document.getElementById(id);
const plots = [];
let report, now = 0, playing = false, drawing = false, syncing = false;

// Text of an element that contains gzip in base64.
async function unpacked(id) {
  const bytes = Uint8Array.from(atob(at(id).textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).text();
}

function run(code) {
  const script = document.createElement("script");
  script.textContent = code;
  document.head.append(script);
}

// Index of the last time at or before t.
function before(times, t) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

// Linear interpolation of a series between frames i and i + 1; null where there is no value.
function between(drive, name, i, share) {
  const values = drive[name];
  if (!values.length || values[i] === null) return null;
  const next = values[Math.min(i + 1, values.length - 1)];
  return next === null ? values[i] : values[i] + share * (next - values[i]);
}

function stateAt(drive, t) {
  const i = before(drive.t, t), j = Math.min(i + 1, drive.t.length - 1);
  const step = drive.t[j] - drive.t[i];
  const share = step > 0 ? Math.min(Math.max((t - drive.t[i]) / step, 0), 1) : 0;
  const state = { i };
  for (const name of ["x", "y", "yaw", "speed", "error", "heading", "steering"])
    state[name] = between(drive, name, i, share);
  return state;
}

function predictionAt(drive, t) {
  const all = drive.predictions;
  if (!all.length || t < all[0].t) return { x: [], y: [] };
  const last = all[before(drive.predicted_at, t)];
  return t - last.t > report.oldest ? { x: [], y: [] } : last;
}

// Coordinates of the moving traces of one drive: prediction, outline, marker.
function placed(drive, t) {
  const s = stateAt(drive, t), c = Math.cos(s.yaw), n = Math.sin(s.yaw);
  const predicted = predictionAt(drive, t);
  return {
    x: [predicted.x, drive.outline.map(([a, b]) => s.x + a * c - b * n), [s.x + drive.cg * c]],
    y: [predicted.y, drive.outline.map(([a, b]) => s.y + a * n + b * c), [s.y + drive.cg * n]],
    angle: [0, 0, 90 - (s.yaw * 180) / Math.PI],
    state: s,
  };
}

function moveCars() {
  const change = { x: [], y: [], "marker.angle": [] }, traces = [], view = {};
  report.drives.forEach((drive, k) => {
    const place = placed(drive, now);
    change.x.push(...place.x);
    change.y.push(...place.y);
    change["marker.angle"].push(...place.angle);
    traces.push(drive.trace, drive.trace + 1, drive.trace + 2);
    if (k === Number(at("which").value)) Object.assign(view, about(place.state));
    fillReadout(drive, k, place.state);
  });
  return Promise.all([
    Plotly.restyle(at("map"), change, traces),
    Plotly.update(at("near"), change, view, traces),
  ]);
}

// Axis ranges of the close-up around its car; the zoom is kept.
function about(state) {
  const { xaxis, yaxis } = at("near")._fullLayout;
  const half = (axis) => (axis.range[1] - axis.range[0]) / 2;
  const [w, h] = [half(xaxis), half(yaxis)];
  return { "xaxis.range": [state.x - w, state.x + w], "yaxis.range": [state.y - h, state.y + h] };
}

// Row of a drive in the table below the maps.
function fillReadout(drive, k, state) {
  const cells = at("readout").tBodies[0].rows[k].cells;
  const words = (value, digits, unit) =>
    value === null ? "\u2013" : `${value.toFixed(digits).replace(/^-(?=[0.]+$)/, "")} ${unit}`;
  cells[1].textContent = words(state.error, 3, "m");
  cells[2].textContent = words(state.heading, 2, "deg");
  cells[3].textContent = words(state.steering, 2, "deg");
  cells[4].textContent = words(state.speed, 2, "m/s");
  cells[5].textContent = drive.rung.length ? report.rungs[drive.rung[state.i]] || drive.rung[state.i] : "\u2013";
}

function moveCursors() {
  for (const plot of plots) {
    const axis = plot._fullLayout.xaxis, size = plot._fullLayout._size;
    const pixel = axis.l2p(now), line = plot.cursor;
    line.style.display = pixel < 0 || pixel > axis._length ? "none" : "block";
    line.style.left = `${axis._offset + pixel - 1}px`;
    line.style.top = `${size.t}px`;
    line.style.height = `${size.h}px`;
  }
}

function show(t) {
  now = Math.min(Math.max(t, report.begin), report.end);
  const slider = at("slider");
  slider.value = Math.round(now * 1000);
  slider.setAttribute("aria-valuetext", `${now.toFixed(1)} seconds`);
  at("clock").textContent = `${now.toFixed(1)} s`;
  moveCursors();
  if (drawing) return;
  drawing = true;
  Promise.resolve(moveCars()).finally(() => { drawing = false; });
}

function play(on) {
  playing = on;
  if (on && now >= report.end) show(report.begin);
  at("play").setAttribute("aria-pressed", String(on));
  at("play").textContent = on ? "\u275A\u275A Pause" : "\u25B6 Play";
  let last = performance.now();
  const frame = (time) => {
    if (!playing) return;
    show(now + Math.max(0, time - last) / 1000 * Number(at("rate").value));
    last = time;
    if (now >= report.end) play(false); else requestAnimationFrame(frame);
  };
  if (on) requestAnimationFrame(frame);
}

function onKey(event) {
  const own = event.target.closest("button, select, summary, a");
  if (event.altKey || event.ctrlKey || event.metaKey || own) return;
  const step = event.shiftKey ? 5 : report.period;
  if (event.key === " ") play(!playing);
  else if (event.key === "ArrowLeft") show(now - step);
  else if (event.key === "ArrowRight") show(now + step);
  else return;
  event.preventDefault();
}

// Apply the time range of one chart to all charts.
async function onZoom(source, change) {
  if (syncing) return;
  const key = Object.keys(change).find((name) => /^xaxis\d*\.(range|autorange)/.test(name));
  if (!key) return;
  syncing = true;
  const all = /autorange/.test(key), axis = source._fullLayout.xaxis.range;
  const range = all ? [report.begin, report.end] : [...axis];
  await Promise.all(plots.map((p) => (p === source && !all ? null : Plotly.relayout(p, { "xaxis.range": range }))));
  syncing = false;
  moveCursors();
}

// Height of the map at which both axes have the same scale [px].
function heightOf(element, data) {
  const span = (name) => {
    const values = data.flatMap((line) => line[name]).filter((value) => value !== null);
    return values.reduce((a, b) => Math.max(a, b), -Infinity) - values.reduce((a, b) => Math.min(a, b), Infinity);
  };
  const wanted = ((element.clientWidth - 76) * span("y")) / Math.max(span("x"), 1) * 1.15 + 110;
  return Math.min(Math.max(wanted, HEIGHTS[0]), HEIGHTS[1]);
}

// Bottom margin for the legend, which has more rows on a narrow page.
function fitLegend() {
  const map = at("map"), legend = map.querySelector(".legend"), margin = map._fullLayout.margin.b;
  const wanted = Math.ceil(legend.getBBox().height) + AXIS_HEIGHT;
  if (wanted === margin) return Promise.resolve();
  return Plotly.relayout(map, { "margin.b": wanted, height: map._fullLayout.height + wanted - margin });
}

async function drawMaps() {
  const { data, layout } = report.map, config = { ...CONFIG, scrollZoom: true };
  const height = heightOf(at("map"), data), near = structuredClone({ data, layout });
  await Plotly.newPlot(at("map"), data, { ...layout, height }, config);
  at("map").on("plotly_afterplot", fitLegend); // also after a change of the width
  await fitLegend();
  for (const axis of [near.layout.xaxis, near.layout.yaxis]) axis.range = [-NEAR, NEAR];
  Object.assign(near.layout, { height: Math.max(height, 300), showlegend: false });
  for (const drive of report.drives) near.data[drive.trace + 2].visible = false;
  await Plotly.newPlot(at("near"), near.data, near.layout, config);
}

async function drawPlot(plot, figure) {
  await Plotly.newPlot(plot, figure.data, figure.layout, CONFIG);
  plot.cursor = document.createElement("div");
  plot.cursor.className = "cursor";
  plot.append(plot.cursor);
  plot.on("plotly_relayout", (change) => onZoom(plot, change));
  plot.on("plotly_click", (click) => show(click.points[0].x));
  plot.on("plotly_afterplot", moveCursors);
  plots.push(plot);
}

async function draw() {
  await drawMaps();
  for (const [key, figure] of Object.entries(report.plots)) {
    const plot = at(`plot-${key}`), fold = plot.closest("details");
    if (!fold) await drawPlot(plot, figure);
    else fold.addEventListener("toggle", () => drawPlot(plot, figure).then(moveCursors), { once: true });
  }
}

function fillControls() {
  const slider = at("slider"), seconds = report.end - report.begin;
  slider.min = Math.round(report.begin * 1000);
  slider.max = Math.round(report.end * 1000);
  slider.step = 1;
  const usual = RATES.find((rate) => seconds / rate <= 60) || RATES.at(-1);
  for (const rate of RATES) at("rate").add(new Option(`${rate}\u00d7`, rate, rate === usual, rate === usual));
  for (const drive of report.drives) drive.predicted_at = drive.predictions.map((p) => p.t);
  at("which-label").hidden = report.drives.length === 1;
  for (const [k, drive] of report.drives.entries()) {
    at("which").add(new Option(drive.name, k));
    const row = at("readout").tBodies[0].insertRow();
    const head = document.createElement("th");
    head.scope = "row";
    const swatch = document.createElement("span");
    swatch.className = "swatch";
    swatch.style.background = drive.color;
    head.append(swatch, drive.name);
    row.append(head);
    for (let k = 0; k < 5; k++) row.insertCell().className = k < 4 ? "n" : "";
  }
}

function listen() {
  at("slider").addEventListener("input", (event) => show(Number(event.target.value) / 1000));
  at("play").addEventListener("click", () => play(!playing));
  at("which").addEventListener("change", () => show(now));
  document.addEventListener("keydown", onKey);
  const resized = (layout) => [at("map"), ...plots].forEach((plot) => Plotly.relayout(plot, layout));
  window.addEventListener("beforeprint", () => resized({ width: PRINT_WIDTH }));
  window.addEventListener("afterprint", () => resized({ width: null, autosize: true }));
}

async function main() {
  if (!("DecompressionStream" in window)) {
    at("trouble").textContent = "This browser is too old to unpack the charts (they need Chrome 80, Firefox 113 " +
      "or Safari 16.4). All tables are complete.";
    return;
  }
  report = JSON.parse(await unpacked("data"));
  run(await unpacked("plotly"));
  fillControls();
  await draw();
  listen();
  for (const id of ["play", "slider"]) at(id).disabled = false;
  show(report.begin);
  at("trouble").textContent = "";
  document.body.dataset.ready = "yes";
}

main().catch((error) => {
  at("trouble").textContent = `The charts could not be drawn: ${error.message}. All tables are complete.`;
  console.error(error);
});
