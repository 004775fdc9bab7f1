/* Part of the pages of clicks: views of all cameras, in which named points are clicked by mouse, finger or keys. The page
   itself says what is `shownOf` a camera besides clicks, the `outlineOf` its picture, what to `take` of an answer, how to
   `draw` and `advance`, and what to do when clicks have `changed`. */
const clicks = data.clicks;
let current = data.joints[0], busy = false, waiting = null, drag = null, touched = null;
const message = document.getElementById("message");
const clickOf = (camera, joint) => clicks[camera]?.[joint];

function tell(text, kind = "soft") { message.textContent = text; message.className = kind; }

async function post(path, question) {
  const reply = await fetch("." + path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(question) });
  return reply.json();
}

/** One question at a time; of those that come meanwhile the last one is asked next. */
async function ask(path, question) {
  if (busy) { waiting = [path, question]; return; }
  busy = true;
  document.body.dataset.busy = "yes";
  try {
    take(await post(path, question));
  } catch {
    tell("The server does not answer. Is twistcap still running?", "bad");
  }
  busy = false;
  if (waiting) { const next = waiting; waiting = null; ask(...next); } else document.body.dataset.busy = "no";
}

function place(camera, joint, [x, y]) {
  (clicks[camera] ??= {})[joint] = [Math.round(x * 100) / 100, Math.round(y * 100) / 100];
}

function remove(camera, joint) {
  delete clicks[camera]?.[joint];
  if (clicks[camera] && !Object.keys(clicks[camera]).length) delete clicks[camera];
}

/* ---- views ---- */
const views = data.cameras.map((camera) => {
  const [w, h] = camera.size, svg = make("svg", { viewBox: `0 0 ${w} ${h}`, "data-camera": camera.name, tabindex: 0, role: "application", "aria-label": `${camera.name}: arrow keys move the cross, Enter clicks, Delete removes, plus and minus zoom` });
  if (camera.image) svg.append(make("image", { href: camera.image, x: 0, y: 0, width: w, height: h, preserveAspectRatio: "none" }));
  const layer = make("g"), note = make("b", {}, camera.name), loupe = loupeOf(camera), fingers = new Map();
  svg.append(layer);
  const view = { camera, svg, layer, note, loupe, fingers, cross: null, box: [0, 0, w, h] };
  const listen = { pointerdown: press, pointermove: move, pointerup: release, pointercancel: cancel, keydown: keys };
  for (const [kind, listener] of Object.entries(listen)) svg.addEventListener(kind, (event) => listener(view, event));
  svg.addEventListener("blur", () => { view.cross = null; hideLoupe(view); });
  svg.addEventListener("contextmenu", (event) => { event.preventDefault(); drop(camera.name, event.target.dataset.joint); });
  svg.addEventListener("wheel", (event) => { event.preventDefault(); zoom(view, pixel(view, event), event.deltaY > 0 ? 1.2 : 1 / 1.2); }, { passive: false });
  const button = (text, label, factor) => make("button", { "aria-label": `${label} ${camera.name}`, click: () => zoom(view, [view.box[0] + view.box[2] / 2, view.box[1] + view.box[3] / 2], factor) }, text);
  const buttons = make("span", {}, button("+", "zoom into", 1 / 1.5), button("−", "zoom out of", 1.5));
  view.tile = make("div", { class: "view" }, svg, note, loupe.box, buttons);
  document.getElementById("views").append(view.tile);
  return view;
});
const columns = Math.ceil(Math.sqrt(views.length));
document.getElementById("views").style.gridTemplate = `repeat(${Math.ceil(views.length / columns)}, minmax(0, 1fr)) / repeat(${columns}, minmax(0, 1fr))`;

/** Pixel of the image under the pointer; pixel centres are at integers. */
function pixel(view, event) {
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(view.svg.getScreenCTM().inverse());
  return [point.x - 0.5, point.y - 0.5];
}

/** The joint under the pointer; for a finger, the nearest one within its reach. */
function jointAt(view, event) {
  if (event.pointerType !== "touch") return event.target.dataset.joint ?? null;
  const [x, y] = pixel(view, event), reach = 18 / view.svg.getScreenCTM().a;
  const all = { ...shownOf(view.camera.name), ...clicks[view.camera.name] };
  const near = Object.entries(all).filter(([, at]) => at).map(([joint, [a, b]]) => [Math.hypot(a - x, b - y), joint]).filter(([far, joint]) => far < reach && (data.joints.includes(joint) || clickOf(view.camera.name, joint)));
  return near.sort((a, b) => a[0] - b[0])[0]?.[1] ?? null;
}

function drop(camera, joint) {
  if (!joint || !clickOf(camera, joint)) return;
  remove(camera, joint);
  draw(); changed();
}

/** One finger points, two move and zoom. */
function press(view, event) {
  view.fingers.set(event.pointerId, [event.clientX, event.clientY]);
  if (view.fingers.size === 2) { drag = { view, pinch: true }; hideLoupe(view); }
  else if (view.fingers.size > 2) return;
  else if (event.button === 1 || event.shiftKey) drag = { view, pan: [event.clientX, event.clientY] };
  else if (event.button === 0) {
    drag = { view, joint: jointAt(view, event), start: [event.clientX, event.clientY], moved: false };
    if (event.pointerType === "touch") showLoupe(view, pixel(view, event), outlineOf(view.camera));
  } else return;
  view.svg.setPointerCapture(event.pointerId);
  view.svg.focus({ preventScroll: true });
  event.preventDefault();
}

function move(view, event) {
  if (drag?.view !== view) return;
  if (drag.pinch) { pinch(view, event); return; }
  if (drag.pan) { pan(view, event); return; }
  if (Math.hypot(event.clientX - drag.start[0], event.clientY - drag.start[1]) > 3) drag.moved = true;
  if (drag.moved || event.pointerType === "touch") showLoupe(view, pixel(view, event), outlineOf(view.camera));
  if (!drag.joint || !drag.moved) return;
  current = drag.joint;
  place(view.camera.name, drag.joint, pixel(view, event));
  draw();
  if (!busy) changed();
}

function cancel(view, event) {
  view.fingers.delete(event.pointerId);
  if (!view.fingers.size) drag = null;
  hideLoupe(view);
}

function release(view, event) {
  const ended = drag;
  if (ended?.pinch) { view.fingers.delete(event.pointerId); if (!view.fingers.size) drag = null; return; }
  cancel(view, event);
  if (ended?.view !== view || ended.pan) return;
  const { joint, moved } = ended, open = !clickOf(view.camera.name, current); // joints may cover one another: the wanted one goes first
  if (joint && !moved && !open && clickOf(view.camera.name, joint)) { choose(view.camera.name, joint); return; }
  click(view, joint && moved ? joint : current, pixel(view, event), !(joint && moved));
}

function choose(camera, joint) { current = joint; touched = camera; draw(); }

function click(view, joint, [x, y], next) {
  const [w, h] = view.camera.size;
  if (x < -0.5 || y < -0.5 || x > w - 0.5 || y > h - 0.5) return;
  place(view.camera.name, joint, [x, y]);
  touched = view.camera.name;
  if (next) advance(view.camera.name);
  draw();
  changed();
}

/** A view by keys: a cross under the loupe takes the pointer's place. */
function keys(view, event) {
  const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  const [x, y, w, h] = view.box, step = event.shiftKey ? 10 : 1, [wide, high] = view.camera.size;
  const start = view.cross ?? clickOf(view.camera.name, current) ?? shownOf(view.camera.name)[current] ?? [Math.round(x + w / 2), Math.round(y + h / 2)];
  if (moves) view.cross = [Math.min(Math.max(start[0] + step * moves[0], 0), wide - 1), Math.min(Math.max(start[1] + step * moves[1], 0), high - 1)];
  else if (event.key === "Enter") { view.cross = start; click(view, current, start, true); }
  else if (event.key === "Delete" || event.key === "Backspace") drop(view.camera.name, current);
  else if (event.key === "+" || event.key === "=" || event.key === "-") zoom(view, start, event.key === "-" ? 1.2 : 1 / 1.2);
  else return;
  event.preventDefault();
  if (view.cross) showLoupe(view, view.cross, outlineOf(view.camera));
}

function pinch(view, event) {
  if (!view.fingers.has(event.pointerId) || view.fingers.size < 2) return;
  const before = [...view.fingers.values()].slice(0, 2);
  view.fingers.set(event.pointerId, [event.clientX, event.clientY]);
  const after = [...view.fingers.values()].slice(0, 2), gap = ([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]) || 1;
  const middle = ([a, b]) => ({ clientX: (a[0] + b[0]) / 2, clientY: (a[1] + b[1]) / 2 });
  const [from, to] = [pixel(view, middle(before)), pixel(view, middle(after))];
  if (view.box[2] >= view.camera.size[0]) scrollBy(0, middle(before).clientY - middle(after).clientY);  // the whole image: the page moves
  view.box[0] -= to[0] - from[0]; view.box[1] -= to[1] - from[1];
  zoom(view, from, gap(before) / gap(after));
}

function pan(view, event) {
  const scale = view.svg.getScreenCTM().a;
  view.box[0] -= (event.clientX - drag.pan[0]) / scale;
  view.box[1] -= (event.clientY - drag.pan[1]) / scale;
  drag.pan = [event.clientX, event.clientY];
  view.svg.setAttribute("viewBox", view.box.join(" "));
}

/** About a pixel, which stays where it is; at most 20-fold, and never smaller than the view. */
function zoom(view, [x, y], wanted) {
  const [w, h] = view.camera.size, factor = Math.min(w / view.box[2], Math.max(w / view.box[2] / 20, wanted));
  view.box = [x - (x - view.box[0]) * factor, y - (y - view.box[1]) * factor, view.box[2] * factor, view.box[3] * factor];
  if (view.box[2] >= w * 0.999) view.box = [0, 0, w, h];
  view.svg.setAttribute("viewBox", view.box.join(" "));
  draw();
}

/* ---- list ---- */
const jointList = document.getElementById("joints"), jointButtons = new Map();
function addJoint(joint) {
  const count = make("i"), button = make("button", { "data-name": joint, click: () => { current = joint; touched = null; draw(); } }, joint.replaceAll("_", " "), count);
  jointButtons.set(joint, { button, count });
  return button;
}
new ResizeObserver(draw).observe(document.getElementById("views"));
const bar = new ResizeObserver(([{ target }]) => { document.getElementById("joints").style.top = `${target.getBoundingClientRect().height}px`; });
bar.observe(document.querySelector("header"));
