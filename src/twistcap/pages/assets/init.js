/* Clicking the first pose: clicks go to the server, which fits the body and sends back its outline. */
const held = {};
let fitted = data.state, rejected = new Set();
const key = (camera, joint) => `${camera} ${joint}`;
function take(reply) {
  if (reply.error) { tell(reply.error, fitted ? "bad" : "soft"); draw(); return; }
  fitted = reply;
  document.body.dataset.fits = +(document.body.dataset.fits ?? 0) + 1;
  if (reply.rejected) rejected = new Set(reply.rejected.map(([camera, joint]) => key(camera, joint)));
  const poor = unseenPoor().map((view) => `${view.camera}: ${Math.round(100 * view.iou)} %`).join(", ");
  const doubt = poor ? ` The body covers too little of what moves in views without clicks (${poor}): click there too.` : "";
  if (reply.saved) { tell(`Saved ${reply.saved}. ${reply.note}${doubt}`, doubt ? "amber" : "good"); document.body.dataset.saved = reply.saved; }
  else if (reply.residual_px !== undefined) {
    const odd = rejected.size ? `. ${rejected.size} do not agree (red): check left and right` : "";
    tell(`Clicks are ${reply.residual_px} px (median) from the body${odd}.${doubt || " Drag a joint to correct it."}`, doubt ? "amber" : "soft");
  }
  draw();
}

/** Views without a click in which the body does not fit what stands out from the background. */
const unseenPoor = () => Object.entries(fitted?.overlap ?? {}).filter(([camera, iou]) => !clicks[camera] && iou < data.least_iou).map(([camera, iou]) => ({ camera, iou }));

const fit = () => ask("/fit", { clicks, held });
const changed = fit;
const shownOf = (name) => fitted?.joints[name] ?? {};

function advance(camera) {
  const list = data.joints, start = list.indexOf(current);
  const next = [...list.slice(start + 1), ...list.slice(0, start + 1)].find((joint) => !clickOf(camera, joint));
  if (next) current = next;
}

/* ---- drawing ---- */
function draw() {
  for (const view of views) drawView(view);
  drawJoints();
  drawSliders();
  const poor = unseenPoor().length > 0, save = document.getElementById("save");
  save.classList.toggle("amber", poor);
  save.title = poor ? "a view without clicks does not fit the body" : "";
  document.getElementById("remove").disabled = !(touched && clickOf(touched, current)) && !data.cameras.some((c) => clickOf(c.name, current));
}

const outlineOf = (camera) => (fitted?.outlines[camera.name] ?? []).map((c) => "M" + c.map((v) => v + 0.5).join(" ") + "Z").join("");

function drawView({ camera, svg, layer, note, tile }) {
  const unit = em() / 14 / (svg.getScreenCTM()?.a || 1), own = clicks[camera.name] ?? {};
  layer.replaceChildren();
  const path = outlineOf(camera), iou = clicks[camera.name] ? undefined : fitted?.overlap?.[camera.name];
  note.textContent = camera.name + (camera.image ? "" : ": no image") + (iou === undefined ? "" : `: no clicks, overlap ${Math.round(100 * iou)} %`);
  tile.classList.toggle("amber", iou < data.least_iou);
  if (path) layer.append(make("path", { d: path, class: "outline under" }), make("path", { d: path, class: "outline" }));
  for (const [joint, [x, y]] of Object.entries(shownOf(camera.name))) {
    if (own[joint] || !data.joints.includes(joint)) continue;
    layer.append(make("circle", { cx: x + 0.5, cy: y + 0.5, r: 3.5 * unit, class: "joint", "data-joint": joint }, make("title", {}, joint)));
  }
  for (const [joint, [x, y]] of Object.entries(own)) {
    const kind = `clicked${rejected.has(key(camera.name, joint)) ? " rejected" : ""}${joint === current ? " current" : ""}`;
    layer.append(make("circle", { cx: x + 0.5, cy: y + 0.5, r: 4.5 * unit, class: kind, "data-joint": joint }, make("title", {}, joint)));
  }
}

jointList.append(make("h2", {}, "Click this joint"), ...data.joints.map(addJoint), make("h2", {}, "If you like"), ...data.more.map(addJoint));

function drawJoints() {
  for (const [joint, { button, count }] of jointButtons) {
    const seen = data.cameras.filter((c) => clickOf(c.name, joint));
    button.classList.toggle("current", joint === current);
    button.classList.toggle("rejected", seen.some((c) => rejected.has(key(c.name, joint))));
    button.setAttribute("aria-pressed", joint === current);
    count.textContent = "●".repeat(seen.length);
  }
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
  const range = make("input", { type: "range", min: limits[0], max: limits[1], step: 0.5, "data-coordinate": name, "aria-label": name });
  const output = make("output"), text = make("button", { title: "let this angle go" }, name.replaceAll("_", " ")), box = make("div", { class: "slider" }, text, output, range);
  range.addEventListener("input", () => { held[name] = +range.value; drawSliders(); ask("/pose", { held }); });
  text.addEventListener("click", () => { if (held[name] === undefined) return; delete held[name]; fit(); });
  sliders[name] = { box, range, output };
  side.append(box);
}

document.getElementById("save").addEventListener("click", () => ask("/save", {}));
/** Of the view that was touched last, or of every view where the joint was chosen in the list. */
document.getElementById("remove").addEventListener("click", () => {
  const cameras = touched && clickOf(touched, current) ? [touched] : data.cameras.map((c) => c.name);
  for (const camera of cameras) if (clickOf(camera, current)) remove(camera, current);
  draw();
  fit();
});
document.getElementById("clear").addEventListener("click", () => {
  for (const camera of Object.keys(clicks)) delete clicks[camera];
  for (const name of Object.keys(held)) delete held[name];
  fitted = null; rejected.clear(); current = data.joints[0];
  draw();
  fit();
});
window.twistcapInit = { clicks, held, state: () => fitted, current: () => current };
tell("Choose a joint and click it in two or more views. The body appears when two views have five joints in common. Wheel or two fingers zoom, shift-drag or two fingers move, right-click removes.");
themeButton();
draw();
if (!fitted && Object.keys(clicks).length) fit();
document.body.dataset.ready = "yes";
