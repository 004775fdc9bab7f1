/* Clicking the first pose: clicks go to the server, which fits the body and sends back its outline. */
const clicks = data.clicks, held = {};
let fitted = data.state, rejected = new Set(), current = data.joints[0], busy = false, waiting = null, drag = null;
const message = document.getElementById("message");
const key = (camera, joint) => `${camera} ${joint}`;
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
    tell("The server does not answer. Is twistcap init still running?", "bad");
  }
  busy = false;
  if (waiting) { const next = waiting; waiting = null; ask(...next); } else document.body.dataset.busy = "no";
}

function take(reply) {
  if (reply.error) { tell(reply.error, fitted ? "bad" : "soft"); draw(); return; }
  fitted = reply;
  document.body.dataset.fits = +(document.body.dataset.fits ?? 0) + 1;
  if (reply.rejected) rejected = new Set(reply.rejected.map(([camera, joint]) => key(camera, joint)));
  if (reply.saved) { tell(`Saved ${reply.saved}. ${reply.note}`, "good"); document.body.dataset.saved = reply.saved; }
  else if (reply.residual_px !== undefined) {
    const poor = rejected.size ? `. ${rejected.size} do not agree (red): check left and right` : "";
    tell(`Clicks are ${reply.residual_px} px (median) from the body${poor}. Drag a joint to correct it.`);
  }
  draw();
}

const fit = () => ask("/fit", { clicks, held });

function place(camera, joint, [x, y]) {
  (clicks[camera] ??= {})[joint] = [Math.round(x * 100) / 100, Math.round(y * 100) / 100];
}

function remove(camera, joint) {
  delete clicks[camera]?.[joint];
  if (clicks[camera] && !Object.keys(clicks[camera]).length) delete clicks[camera];
}

function advance(camera) {
  const list = data.joints, start = list.indexOf(current);
  const next = [...list.slice(start + 1), ...list.slice(0, start + 1)].find((joint) => !clickOf(camera, joint));
  if (next) current = next;
}

/* ---- views ---- */
const views = data.cameras.map((camera) => {
  const [w, h] = camera.size, svg = make("svg", { viewBox: `0 0 ${w} ${h}`, "data-camera": camera.name });
  if (camera.image) svg.append(make("image", { href: camera.image, x: 0, y: 0, width: w, height: h, preserveAspectRatio: "none" }));
  const layer = make("g");
  svg.append(layer);
  const view = { camera, svg, layer, box: [0, 0, w, h] };
  svg.addEventListener("pointerdown", (event) => press(view, event));
  svg.addEventListener("pointermove", (event) => move(view, event));
  svg.addEventListener("pointerup", (event) => release(view, event));
  svg.addEventListener("contextmenu", (event) => {
    event.preventDefault();
    if (!event.target.dataset.joint) return;
    remove(camera.name, event.target.dataset.joint);
    draw(); fit();
  });
  svg.addEventListener("wheel", (event) => { event.preventDefault(); zoom(view, event); }, { passive: false });
  document.getElementById("views").append(make("div", { class: "view" }, svg, make("b", {}, camera.name + (camera.image ? "" : ": no image"))));
  return view;
});
const columns = Math.ceil(Math.sqrt(views.length));
document.getElementById("views").style.gridTemplate = `repeat(${Math.ceil(views.length / columns)}, minmax(0, 1fr)) / repeat(${columns}, minmax(0, 1fr))`;

/** Pixel of the image under the pointer; pixel centres are at integers. */
function pixel(view, event) {
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(view.svg.getScreenCTM().inverse());
  return [point.x - 0.5, point.y - 0.5];
}

function press(view, event) {
  if (event.button === 1 || event.shiftKey) drag = { view, pan: [event.clientX, event.clientY] };
  else if (event.button === 0) drag = { view, joint: event.target.dataset.joint ?? null, start: [event.clientX, event.clientY], moved: false };
  else return;
  view.svg.setPointerCapture(event.pointerId);
  event.preventDefault();
}

function move(view, event) {
  if (drag?.view !== view) return;
  if (drag.pan) { pan(view, event); return; }
  if (Math.hypot(event.clientX - drag.start[0], event.clientY - drag.start[1]) > 3) drag.moved = true;
  if (!drag.joint || !drag.moved) return;
  current = drag.joint;
  place(view.camera.name, drag.joint, pixel(view, event));
  draw();
  if (!busy) fit();
}

function release(view, event) {
  if (drag?.view !== view) return;
  const { pan: panned, joint, moved } = drag;
  drag = null;
  if (panned) return;
  const open = !clickOf(view.camera.name, current); // joints may cover one another: the wanted one goes first
  if (joint && !moved && !open && clickOf(view.camera.name, joint)) { current = joint; draw(); return; }
  const name = joint && moved ? joint : current;
  const [x, y] = pixel(view, event), [w, h] = view.camera.size;
  if (x < -0.5 || y < -0.5 || x > w - 0.5 || y > h - 0.5) return;
  place(view.camera.name, name, [x, y]);
  if (!(joint && moved)) advance(view.camera.name);
  draw();
  fit();
}

function pan(view, event) {
  const scale = view.svg.getScreenCTM().a;
  view.box[0] -= (event.clientX - drag.pan[0]) / scale;
  view.box[1] -= (event.clientY - drag.pan[1]) / scale;
  drag.pan = [event.clientX, event.clientY];
  view.svg.setAttribute("viewBox", view.box.join(" "));
}

function zoom(view, event) {
  const [x, y] = pixel(view, event), [w, h] = view.camera.size;
  const factor = Math.min(1.2, w / view.box[2] , Math.max(w / view.box[2] / 20, event.deltaY > 0 ? 1.2 : 1 / 1.2));
  view.box = [x - (x - view.box[0]) * factor, y - (y - view.box[1]) * factor, view.box[2] * factor, view.box[3] * factor];
  if (view.box[2] >= w * 0.999) view.box = [0, 0, w, h];
  view.svg.setAttribute("viewBox", view.box.join(" "));
  draw();
}

/* ---- drawing ---- */
function draw() {
  for (const view of views) drawView(view);
  drawJoints();
  drawSliders();
}

function drawView({ camera, svg, layer }) {
  const unit = 1 / (svg.getScreenCTM()?.a || 1), own = clicks[camera.name] ?? {};
  layer.replaceChildren();
  const path = (fitted?.outlines[camera.name] ?? []).map((c) => "M" + c.map((v) => v + 0.5).join(" ") + "Z").join("");
  if (path) layer.append(make("path", { d: path, class: "outline under" }), make("path", { d: path, class: "outline" }));
  for (const [joint, [x, y]] of Object.entries(fitted?.joints[camera.name] ?? {})) {
    if (own[joint] || !data.joints.includes(joint)) continue;
    layer.append(make("circle", { cx: x + 0.5, cy: y + 0.5, r: 3.5 * unit, class: "joint", "data-joint": joint }, make("title", {}, joint)));
  }
  for (const [joint, [x, y]] of Object.entries(own)) {
    const kind = `clicked${rejected.has(key(camera.name, joint)) ? " rejected" : ""}${joint === current ? " current" : ""}`;
    layer.append(make("circle", { cx: x + 0.5, cy: y + 0.5, r: 4.5 * unit, class: kind, "data-joint": joint }, make("title", {}, joint)));
  }
}

function drawJoints() {
  const list = document.getElementById("joints"), top = list.scrollTop;
  const row = (joint) => {
    const seen = data.cameras.filter((c) => clickOf(c.name, joint));
    const poor = seen.some((c) => rejected.has(key(c.name, joint)));
    const kind = `${joint === current ? "current" : ""} ${poor ? "rejected" : ""}`;
    return make("button", { class: kind, "data-name": joint, click: () => { current = joint; draw(); } }, joint, make("i", {}, "●".repeat(seen.length)));
  };
  list.replaceChildren(make("h2", {}, "Click this joint"), ...data.joints.map(row), make("h2", {}, "If you like"), ...data.more.map(row));
  list.scrollTop = top;
}

const sliders = {};
function drawSliders() {
  for (const [name, { box, range, output }] of Object.entries(sliders)) {
    const value = held[name] ?? fitted?.q_deg[name] ?? 0;
    if (document.activeElement !== range || held[name] === undefined) range.value = value;
    output.textContent = `${value.toFixed(0)}°`;
    range.disabled = !fitted || !data.sliders;
    box.classList.toggle("held", held[name] !== undefined);
  }
}

const side = document.getElementById("sliders");
side.append(make("h2", {}, "Joint angles"));
side.append(make("p", { class: "soft" }, data.sliders ? "A slider holds its angle (orange) in further fits; click its name to let go." : "This session reads clicks, which keep no slider; for sliders write [first_pose] file = \"first_pose.json\"."));
for (const { name, limits } of data.coordinates) {
  const range = make("input", { type: "range", min: limits[0], max: limits[1], step: 0.5, "data-coordinate": name });
  const output = make("output"), text = make("span", {}, name), box = make("div", { class: "slider" }, text, output, range);
  range.addEventListener("input", () => { held[name] = +range.value; drawSliders(); ask("/pose", { held }); });
  text.addEventListener("click", () => { if (held[name] === undefined) return; delete held[name]; fit(); });
  sliders[name] = { box, range, output };
  side.append(box);
}

document.getElementById("save").addEventListener("click", () => ask("/save", {}));
document.getElementById("clear").addEventListener("click", () => {
  for (const camera of Object.keys(clicks)) delete clicks[camera];
  for (const name of Object.keys(held)) delete held[name];
  fitted = null; rejected.clear(); current = data.joints[0];
  draw();
  fit();
});
new ResizeObserver(draw).observe(document.getElementById("views"));
window.twistcapInit = { clicks, held, state: () => fitted, current: () => current };
tell("Choose a joint and click it in two or more views. The body appears when two views have five joints in common. Wheel zooms, shift-drag moves, right-click removes.");
draw();
if (!fitted && Object.keys(clicks).length) fit();
document.body.dataset.ready = "yes";
