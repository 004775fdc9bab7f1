/* Plots of the joint angles: one range of time for all, values at the pointer or at the frame. Part of the viewer. */
const zooming = document.getElementById("zooming"), plotGrid = document.getElementById("plots"), plots = [];
const whole = [data.times[0], data.times.at(-1)], LEAST = 4 * (whole[1] - whole[0]) / Math.max(4, data.times.length - 1);
let range = whole, spreading = false, pointed = null;

function column(run, j, values) {
  const J = run.coordinates.length;
  return run.rows.map((row) => (row < 0 ? null : values(row * J + j)));
}

/** What counts for the height of a plot: where the body is lost or not seen, a band may be whole turns wide. */
function counted(run, edge) {
  const out = (row) => run.lost[row] || run.dropped[row], all = run.lost.every((_, row) => out(row));
  return edge.map((value, frame) => (all || !out(run.rows[frame]) ? value : null));
}

/** With so many digits, and no minus before a zero. */
const written = (value, digits) => (+value.toFixed(digits) || 0).toFixed(digits);

/** Curves of one coordinate: of every result with its band of ± 2σ, and of the reference. */
function curvesOf(name) {
  const series = [{}], table = [data.times], bands = [], read = [];
  for (const run of runs) {
    const j = run.coordinates.indexOf(name);
    if (j < 0) continue;
    const hidden = { paths: () => null, points: { show: false } }, outside = { ...hidden, auto: false };
    const edges = [1, -1].map((side) => column(run, j, (i) => run.angles[i] + side * 2 * run.sigma[i]));
    bands.push([table.length, run.colour + "55"]);
    table.push(...edges, column(run, j, (i) => run.angles[i]), ...edges.map((edge) => counted(run, edge)));
    series.push(outside, { ...outside }, { stroke: run.colour, width: 1.5, points: { show: false }, auto: false }, hidden, { ...hidden });
    read.push((frame) => {
      const row = run.rows[frame], i = row * run.coordinates.length + j;
      const digits = run.units[j] === "°" ? 1 : 3;
      return row < 0 ? null : [run.colour, `${written(run.angles[i], digits)}${run.units[j]} ± ${(2 * run.sigma[i]).toFixed(digits)}${run.units[j]}`];
    });
  }
  const r = data.reference ? data.reference.coordinates.indexOf(name) : -1;
  if (r >= 0) {
    table.push(data.reference.angles_deg.map((row) => row[r]));
    series.push({ stroke: () => colour("--truth"), width: 1.2, dash: [5, 4], points: { show: false } });
    read.push((frame) => { const v = data.reference.angles_deg[frame][r]; return v === null ? null : ["var(--truth)", `reference ${written(v, 1)}°`]; });
  }
  return { series, table, bands, read };
}

/** A band in the columns of pixels that have frames, each as tall as its frames are; a part for each stretch without
 * gaps. The band lies between the columns `hi` and `hi` + 1 of the plot's table. */
function bandParts(u, hi) {
  const [times, upper, lower] = [0, hi, hi + 1].map((k) => u.data[k]), [from, to] = u.series[0].idxs, parts = [];
  let part = null;
  for (let i = Math.max(0, from - 1); i <= Math.min(times.length - 1, to + 1); i++) {
    if (upper[i] === null) { part = null; continue; }
    const x = Math.round(u.valToPos(times[i], "x", true)), last = (part ?? parts.at(-1))?.at(-1);
    const top = u.valToPos(upper[i], "y", true), bottom = u.valToPos(lower[i], "y", true);
    if (last?.x === x) { last.top = Math.min(last.top, top); last.bottom = Math.max(last.bottom, bottom); continue; }
    if (!part) parts.push(part = []);
    part.push({ x, top, bottom });
  }
  return parts;
}

function drawBand(u, hi, fill) {
  const pen = u.ctx;
  pen.save();
  pen.beginPath();
  pen.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
  pen.clip();
  pen.beginPath();
  for (const part of bandParts(u, hi)) {
    const end = part.at(-1);
    part.forEach(({ x, top }, k) => (k ? pen.lineTo(x, top) : pen.moveTo(x, top)));
    pen.lineTo(end.x + 1, end.top);
    pen.lineTo(end.x + 1, end.bottom);
    part.reverse().forEach(({ x, bottom }) => pen.lineTo(x, bottom));
  }
  pen.fillStyle = fill;
  pen.fill();
  pen.restore();
}

const unitOf = (name) => { const run = runs.find((one) => one.coordinates.includes(name)); return run.units[run.coordinates.indexOf(name)]; };

/** At least 10° or 50 mm high, so that a very small motion does not fill the plot. */
const heightOf = (unit) => (u, lo, hi) => {
  const least = unit === "°" ? 10 : 0.05, { min, max } = u.scales.y;
  if (lo === null) return min == null ? [-least / 2, least / 2] : [min, max];
  const pad = Math.max(0, (least - (hi - lo)) / 2) + 0.05 * (hi - lo);
  return [lo - pad, hi + pad];
};

const sizeOf = (holder) => ({ width: Math.max(120, holder.clientWidth), height: Math.round(9.2 * em()) });

function axesNow(unit) {
  const axis = { font: `${0.75 * em()}px sans-serif`, stroke: () => colour("--soft"), grid: { stroke: () => colour("--grid") }, ticks: { show: false } };
  const seconds = (_, values, __, ___, step) => values.map((v) => `${v.toFixed(step < 0.1 ? 2 : step < 1 ? 1 : 0)} s`);
  return [{ ...axis, size: 1.7 * em(), values: seconds }, { ...axis, size: 3.4 * em(), values: (_, values) => values.map((v) => v + unit) }];
}

function buildPlot(one) {
  const { series, table, bands } = one.curves = curvesOf(one.name);
  one.plot = new uPlot({
    ...sizeOf(one.holder), legend: { show: false }, series, axes: axesNow(unitOf(one.name)),
    cursor: { y: false, drag: { x: true, y: false }, sync: { key: "time" }, points: { show: false } },
    scales: { x: { time: false, min: range[0], max: range[1] }, y: { range: heightOf(unitOf(one.name)) } },
    hooks: {
      ready: [() => point(one)], drawClear: [shade], drawAxes: [(u) => bands.forEach((one) => drawBand(u, ...one))],
      setCursor: [(u) => { pointed = u.cursor.idx ?? null; for (const other of plots) readOut(other); }],
      setScale: [(u, key) => { if (key === "x") spread(u.scales.x.min, u.scales.x.max); }],
    },
  }, table, one.holder);
  one.needle = make("div", { class: "needle" });
  one.plot.over.append(one.needle);
  one.plot.over.addEventListener("click", (event) => seek(nearest(one.plot.posToVal(event.offsetX, "x"))));
  one.plot.over.addEventListener("dblclick", () => show(...whole));
  one.plot.setScale("x", { min: range[0], max: range[1] });
  point(one);
}

/** Frame whose time is nearest; times rise. */
function nearest(t) {
  let low = 0, high = data.times.length - 1;
  while (high - low > 1) { const middle = (low + high) >> 1; if (data.times[middle] <= t) low = middle; else high = middle; }
  return t - data.times[low] <= data.times[high] - t ? low : high;
}

/** All plots show the time that one shows. */
function spread(from, to) {
  if (spreading || from == null || (from === range[0] && to === range[1])) return;
  spreading = true;
  range = [from, to];
  for (const one of plots) one.plot?.setScale("x", { min: from, max: to });
  spreading = false;
  document.body.dataset.zoomed = range[0] > whole[0] || range[1] < whole[1] ? "yes" : "no";
  plots.forEach(point);
}

function show(from, to) {
  const width = Math.min(Math.max(to - from, LEAST), whole[1] - whole[0]);
  const start = Math.min(Math.max(from, whole[0]), whole[1] - width);
  spread(start, start + width);
}

/** The frame's time stays where it is in the plots. */
function zoomTime(factor) {
  const t = data.times[state.frame], inside = t >= range[0] && t <= range[1] ? t : (range[0] + range[1]) / 2;
  show(inside - (inside - range[0]) * factor, inside + (range[1] - inside) * factor);
}

function readOut(one) {
  if (!one.curves) return;
  const frame = pointed ?? state.frame, found = one.curves.read.map((value) => value(frame)).filter(Boolean);
  const parts = found.map(([tint, text]) => make("span", runs.length > 1 || data.reference ? { style: `color:${tint}` } : {}, text + " "));
  one.output.replaceChildren(...parts, ...(pointed === null ? [] : [make("span", { class: "soft" }, `at ${data.times[frame].toFixed(2)} s`)]));
}

function point(one) {
  if (!one.plot) return;
  const t = data.times[state.frame];
  one.needle.style.display = t >= range[0] && t <= range[1] ? "" : "none";
  one.needle.style.left = one.plot.valToPos(t, "x") + "px";
  readOut(one);
}

/** Frames that any result lost, as spans of time. */
const lostSpans = [];
{
  const half = (whole[1] - whole[0]) / Math.max(1, data.times.length - 1) / 2;
  data.times.forEach((t, frame) => {
    if (!runs.some((run) => run.rows[frame] >= 0 && run.lost[run.rows[frame]])) return;
    if (lostSpans.length && t - half <= lostSpans.at(-1)[1] + half) lostSpans.at(-1)[1] = t + half;
    else lostSpans.push([t - half, t + half]);
  });
}
function shade(u) {
  u.ctx.fillStyle = "#e5484d2e";
  const [left, right] = [u.bbox.left, u.bbox.left + u.bbox.width];
  for (const span of lostSpans) {
    const [x, end] = span.map((t) => Math.min(Math.max(u.valToPos(t, "x", true), left), right));
    if (end > x) u.ctx.fillRect(x, u.bbox.top, end - x, u.bbox.height);
  }
}

for (const name of new Set(runs.flatMap((run) => run.coordinates))) {
  const output = make("output"), holder = make("div", { class: "plot", "data-coordinate": name }, make("h2", {}, name.replaceAll("_", " "), output));
  plotGrid.append(holder);
  plots.push({ name, holder, output });
}
const inSight = new IntersectionObserver((entries) => {
  for (const { isIntersecting, target } of entries) {
    const one = plots.find((other) => other.holder === target);
    if (isIntersecting && !one.plot) buildPlot(one);
  }
}, { rootMargin: "300px" });
const resized = new ResizeObserver((entries) => {
  for (const { target } of entries) plots.find((one) => one.holder === target).plot?.setSize(sizeOf(target));
  plots.forEach(point);
});
for (const { holder } of plots) { inSight.observe(holder); resized.observe(holder); }
addEventListener("beforeprint", () => { for (const one of plots) if (!one.plot) buildPlot(one); });
themeListeners.push(() => { for (const { plot } of plots) plot?.redraw(false, true); });

zooming.append(
  make("button", { id: "zoom-in", "aria-label": "show less time", click: () => zoomTime(0.5) }, "+"), make("button", { id: "zoom-out", "aria-label": "show more time", click: () => zoomTime(2) }, "−"),
  make("button", { id: "zoom-all", click: () => show(...whole) }, "All"),
  make("span", { class: "soft" }, "Joint angles, ± 2σ. Drag in a plot to zoom, click to go there; keys + − 0."),
);
listeners.push((frame) => {
  const t = data.times[frame], width = range[1] - range[0];
  if (t > range[1] || t < range[0]) show(t - 0.1 * width, t + 0.9 * width);  // the plots follow
  plots.forEach(point);
});

window.twistcapView = { seek, setPlaying, state, runs, plots, scene: scene3d, shown: () => range };
themeButton();
seek(0);
document.body.dataset.ready = "yes";
