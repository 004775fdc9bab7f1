/* Cutting silhouettes: a rectangle and strokes go to the server, which sends back the outline of the cut. */
const views = data.views.map((view) => ({ ...view, rectangle: null, strokes: [], cut: false }));
const message = document.getElementById("message"), stage = document.getElementById("stage"), tools = document.getElementById("tools");
const TOOLS = { rectangle: "Rectangle", inside: "Person", outside: "Background" };
let shown = views[0], tool = "rectangle", drag = null, busy = false, svg = null, layer = null;

const waiting = [];  // questions, in the order in which they are asked

function tell(text, kind = "soft") { message.textContent = text; message.className = kind; }

async function post(path, question) {
  const reply = await fetch("." + path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(question) });
  return reply.json();
}

/** A cut takes the place of one of its view that waits, but not of one that a save waits for. */
function ask(path, question) {
  const next = { path, question: structuredClone(question) };  // as it is drawn now, not when its turn comes
  const saved = waiting.findLastIndex((one) => one.path === "/save");
  const same = waiting.findIndex((one, k) => k > saved && path === "/cut" && one.question.view === question.view);
  if (same >= 0) waiting[same] = next;
  else if (path !== "/save" || saved < 0 || saved < waiting.length - 1) waiting.push(next);
  if (!busy) work();
}

/** One question at a time. */
async function work() {
  busy = true;
  document.body.dataset.busy = "yes";
  while (waiting.length) {
    const { path, question } = waiting.shift();
    try {
      take(await post(path, question), question);
    } catch {
      tell("The server does not answer. Is twistcap still running?", "bad");
    }
  }
  busy = false;
  document.body.dataset.busy = "no";
}

function take(reply, question) {
  if (reply.error) {
    const failed = views.find((one) => one.name === question.view);
    if (failed) { Object.assign(failed, { outline: [], cut: false }); draw(); }  // nor has the server a cut of it now
    tell(reply.error, "bad");
    return;
  }
  if (reply.saved) {
    tell(`Saved ${reply.saved.join(", ")}. ${reply.note}`, "good");
    document.body.dataset.saved = reply.saved.join(" ");
    return;
  }
  const view = views.find((one) => one.name === reply.view);
  Object.assign(view, { outline: reply.outline, fraction: reply.fraction, cut: reply.cut });
  document.body.dataset.cuts = +(document.body.dataset.cuts ?? 0) + 1;
  if (reply.cut) tell("Paint with Person or Background where the outline is wrong.");
  else invite(shown);
  draw();
}

const cut = () => ask("/cut", { view: shown.name, rectangle: shown.rectangle, strokes: shown.strokes });

/* ---- drawing ---- */
function path(numbers, close) {
  let text = "";
  for (let i = 0; i < numbers.length; i += 2) text += `${i ? "L" : "M"}${numbers[i] + 0.5} ${numbers[i + 1] + 0.5}`;
  return text + (close ? "Z" : "");
}

function draw() {
  layer.replaceChildren();
  for (const stroke of shown.strokes)
    layer.append(make("path", { d: path(stroke.points), class: `stroke ${stroke.inside ? "inside" : "outside"}`, "stroke-width": stroke.width }));
  for (const kind of ["outline under", "outline"])
    for (const curve of shown.outline) layer.append(make("path", { d: path(curve, true), class: kind }));
  if (shown.rectangle) {
    const [a, b, c, d] = shown.rectangle;
    layer.append(make("path", { d: path([a, b, c, b, c, d, a, d], true), class: "rectangle" }));
  }
  drawTools();
}

function drawTools() {
  tools.replaceChildren();
  for (const view of views)
    tools.append(make("button", { "data-view": view.name, class: `${view === shown ? "current" : ""} ${view.cut ? "cut" : ""}`, click: () => show(view) }, view.name));
  tools.append(make("span", { class: "soft" }, "wheel zooms, shift-drag moves"));
  for (const [name, title] of Object.entries(TOOLS))
    tools.append(make("button", { "data-tool": name, class: name === tool ? "current" : "", click: () => { tool = name; drawTools(); } }, title));
  tools.append(make("button", { id: "undo", click: undo }, "Undo"), make("button", { id: "clear", click: clear }, "Clear"));
}

function undo() {
  if (shown.strokes.pop() === undefined) return;
  draw(); cut();
}

function clear() {
  Object.assign(shown, { rectangle: null, strokes: [], cut: false, outline: data.views.find((one) => one.name === shown.name).outline });
  tool = shown.outline.length ? "inside" : "rectangle";
  draw(); cut();
}

/* ---- the image ---- */
function show(view) {
  shown = view;
  const [w, h] = view.size;
  tool = view.rectangle || view.outline.length ? "inside" : "rectangle";
  svg = make("svg", { viewBox: `0 0 ${w} ${h}`, "data-view": view.name });
  layer = make("g");
  svg.append(make("image", { href: view.image, x: 0, y: 0, width: w, height: h, preserveAspectRatio: "none" }), layer);
  for (const [kind, listener] of Object.entries({ pointerdown: press, pointermove: move, pointerup: release })) svg.addEventListener(kind, listener);
  svg.addEventListener("wheel", zoom, { passive: false });
  svg.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.replaceChildren(svg, make("b", {}, view.name));
  invite(view);
  draw();
}

function invite(view) {
  tell(view.outline.length ? "Paint with Person or Background where the outline is wrong, or draw a rectangle to start again." : "Draw a rectangle around the whole person.");
}

/** Pixel of the image under the pointer, within the image; pixel centres are at integers. */
function pixel(event) {
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse()), [w, h] = shown.size;
  return [Math.min(Math.max(point.x - 0.5, 0), w - 1), Math.min(Math.max(point.y - 0.5, 0), h - 1)].map((v) => Math.round(v * 10) / 10);
}

/** A brush is as wide on the screen whatever the zoom: 10 px. */
const brush = () => Math.max(1, 10 / svg.getScreenCTM().a);

function press(event) {
  if (event.button === 1 || event.shiftKey) drag = { pan: [event.clientX, event.clientY] };
  else if (event.button === 0 || event.button === 2) {
    const at = pixel(event);
    if (tool === "rectangle" && event.button === 0) drag = { from: at };
    else {
      const stroke = { inside: tool === "inside" && event.button === 0, points: [...at, ...at], width: Math.round(brush() * 10) / 10 };
      shown.strokes.push(stroke);
      drag = { stroke };
    }
  } else return;
  svg.setPointerCapture(event.pointerId);
  event.preventDefault();
  draw();
}

function move(event) {
  if (!drag) return;
  if (drag.pan) pan(event);
  else if (drag.from) { shown.rectangle = [...drag.from, ...pixel(event)]; draw(); }
  else { drag.stroke.points.push(...pixel(event)); draw(); }
}

function release() {
  const ended = drag;
  drag = null;
  if (!ended || ended.pan) return;
  if (ended.from) {
    const r = shown.rectangle;
    if (!r || Math.abs(r[0] - r[2]) < 2 || Math.abs(r[1] - r[3]) < 2) { shown.rectangle = null; draw(); return; }
    shown.strokes = [];
    tool = "inside";
  }
  draw();
  cut();
}

function box() { return svg.getAttribute("viewBox").split(" ").map(Number); }

function pan(event) {
  const scale = svg.getScreenCTM().a, [x, y, w, h] = box();
  svg.setAttribute("viewBox", [x - (event.clientX - drag.pan[0]) / scale, y - (event.clientY - drag.pan[1]) / scale, w, h].join(" "));
  drag.pan = [event.clientX, event.clientY];
}

function zoom(event) {
  event.preventDefault();
  const factor = Math.exp(0.0015 * event.deltaY), [x, y, w, h] = box();
  const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  svg.setAttribute("viewBox", [at.x - (at.x - x) * factor, at.y - (at.y - y) * factor, w * factor, h * factor].join(" "));
}

document.getElementById("save").addEventListener("click", () => ask("/save", {}));
window.twistcapCut = { view: (name) => views.find((one) => one.name === name) };
themeButton();
show(shown);
document.body.dataset.ready = "yes";
