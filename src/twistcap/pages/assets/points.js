/* Clicking measured points: one camera after the other is asked for each by its name; null marks one that is not seen. */
const shownOf = () => ({});
const outlineOf = () => "";
const isOpen = (camera, name) => clickOf(camera, name) === undefined;
const countOf = (camera) => data.joints.filter((name) => clickOf(camera, name)).length;

/** The next point of this camera without an answer, or the first of another camera. */
function advance(camera) {
  const names = data.joints, start = names.indexOf(current) + 1;
  const own = [...names.slice(start), ...names.slice(0, start)].find((name) => isOpen(camera, name));
  if (own !== undefined) { current = own; touched = camera; return; }
  const other = data.cameras.find((c) => names.some((name) => isOpen(c.name, name)));
  if (other) { touched = other.name; current = names.find((name) => isOpen(touched, name)); }
}

/** The camera that is asked. */
let last = data.cameras[0].name;
const asked = () => (last = touched ?? last);

function changed() {
  document.body.dataset.saved = "";
  const camera = asked(), few = data.cameras.filter((c) => countOf(c.name) < data.fewest);
  if (isOpen(camera, current)) tell(`Click “${current}” in ${camera}, or say that it is not seen.`);
  else if (few.length) tell(`${few.map((c) => c.name).join(", ")}: at least ${data.fewest} points are needed. Drag a point to correct it.`);
  else tell("Drag a point to correct it. Save keeps the clicks; Calibrate goes on with them.");
}

function take(reply) {
  if (reply.error) tell(reply.error, "bad");
  else { tell(`Saved ${reply.saved}. ${reply.note}`, "good"); document.body.dataset.saved = reply.saved; }
  if (reply.closed) for (const button of document.querySelectorAll("header button:not(#theme)")) button.disabled = true;
}

/* ---- drawing ---- */
function draw() {
  for (const view of views) drawView(view);
  for (const [name, { button, count }] of jointButtons) {
    button.classList.toggle("current", name === current);
    button.setAttribute("aria-pressed", name === current);
    count.textContent = data.cameras.map((c) => (isOpen(c.name, name) ? "" : clickOf(c.name, name) ? "●" : "–")).join("");
  }
  document.getElementById("remove").disabled = isOpen(asked(), current);
}

function drawView({ camera, svg, layer, note, tile }) {
  const unit = em() / 14 / (svg.getScreenCTM()?.a || 1);
  note.textContent = `${camera.name}: ${countOf(camera.name)} of ${data.joints.length}`;
  tile.classList.toggle("asked", camera.name === asked());
  layer.replaceChildren();
  for (const name of data.joints) {
    if (!clickOf(camera.name, name)) continue;
    const [x, y] = clickOf(camera.name, name), kind = `clicked${name === current ? " current" : ""}`;
    layer.append(make("circle", { cx: x + 0.5, cy: y + 0.5, r: 4.5 * unit, class: kind, "data-joint": name }, make("title", {}, name)));
  }
}

jointList.append(make("h2", {}, "Click this point"), ...data.joints.map(addJoint));
for (const { button } of jointButtons.values()) button.addEventListener("click", changed);
for (const { svg, camera } of views) svg.addEventListener("focus", () => { touched = camera.name; draw(); changed(); });
document.getElementById("skip").addEventListener("click", () => {
  const camera = asked();
  (clicks[camera] ??= {})[current] = null;
  advance(camera);
  draw();
  changed();
});
document.getElementById("remove").addEventListener("click", () => { touched = asked(); remove(touched, current); draw(); changed(); });
document.getElementById("save").addEventListener("click", () => ask("/save", { clicks }));
document.getElementById("go").addEventListener("click", () => ask("/go", { clicks }));
window.twistcapPoints = { clicks, current: () => current, asked };
current = data.joints.at(-1);  // so that the first is next
advance(last);
themeButton();
draw();
changed();
document.body.dataset.ready = "yes";
