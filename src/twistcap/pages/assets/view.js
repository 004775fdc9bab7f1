/* The viewer: 3D scene, images with outlines and time line, all driven by `seek`; the plots are in plots.js. */
const COLOURS = data.runs.length > 1 ? ["#2f7de1", "#ef8a24", "#35a368", "#a758cf", "#c8466a", "#5a6270"] : ["#2f7de1"];
const LOST = "#e5484d", DROPPED = "#9aa3ad", OUT = "#d98a00";
const colourOf = (k) => COLOURS[k % COLOURS.length];
const runs = data.runs.map((run, k) => ({
  ...run, colour: colourOf(k), visible: true, transforms: unpack(run.transforms), angles: unpack(run.angles),
  sigma: unpack(run.sigmas), limbProbability: unpack(run.limb_probability),
  body: Object.fromEntries(Object.entries(run.body).map(([key, value]) => [key, unpack(value)])),
  influences: run.body.weights.shape[1], S: run.transforms.shape[1],
}));
const state = { frame: 0, playing: false, images: true, outlines: true, reference: true, apart: false };
const listeners = [];

function seek(frame) {
  state.frame = Math.max(0, Math.min(data.indices.length - 1, Math.round(frame)));
  document.body.dataset.frame = state.frame;
  for (const listener of listeners) listener(state.frame);
}
const refresh = () => seek(state.frame);
let truth = colour("--truth");

/* ---- header ---- */
const legend = document.getElementById("legend");
runs.forEach((run) => {
  const box = make("input", { type: "checkbox", change: (e) => { run.visible = e.target.checked; refresh(); } });
  box.checked = true;
  const swatch = make("span", { class: "swatch", style: `background:${run.colour}` });
  const lost = run.lost.filter(Boolean).length;
  const note = lost ? make("span", { class: "lost" }, ` (${lost} of ${run.lost.length} frames lost)`) : "";
  const statements = make("details", {}, make("summary", {}, "lost frames and cameras"), ...run.statements.map((text) => make("div", {}, text)));
  legend.append(make("span", { class: "run" }, make("label", {}, box, swatch, run.name, note), " ", statements), " ");
});
function toggle(key, text) {
  const box = make("input", { type: "checkbox", id: `show-${key}`, change: (e) => { state[key] = e.target.checked; refresh(); } });
  box.checked = state[key];
  document.getElementById("switches").append(make("label", {}, box, " " + text), " ");
}
if (data.shown.length) { toggle("images", "images"); toggle("outlines", "outlines"); }
if (data.reference) toggle("reference", "reference");
if (runs.length > 1) toggle("apart", "side by side");

/* ---- 3D ---- */
const THREE = await import("three");
const { OrbitControls } = await import("orbit");

function skinned(run) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(run.body.vertices), 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(new Float32Array(run.body.normals), 3));
  geometry.setIndex(new THREE.BufferAttribute(run.body.faces, 1));
  const material = new THREE.MeshStandardMaterial({ color: run.colour, roughness: 0.75 });
  const mesh = new THREE.Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}

/** Linear-blend skinning of one row of a run into its mesh. */
function pose(run, row) {
  const { vertices, normals, segments, weights } = run.body;
  const K = run.influences, T = run.transforms, base = row * run.S * 12, M = new Float32Array(12);
  const position = run.mesh.geometry.attributes.position, normal = run.mesh.geometry.attributes.normal;
  for (let v = 0; v < vertices.length / 3; v++) {
    M.fill(0);
    for (let k = 0; k < K; k++) {
      const w = weights[v * K + k];
      if (w === 0) continue;
      const at = base + 12 * segments[v * K + k];
      for (let i = 0; i < 12; i++) M[i] += w * T[at + i];
    }
    for (let i = 0; i < 3; i++) {
      const r = M.subarray(4 * i, 4 * i + 4), o = 3 * v;
      position.array[o + i] = r[0] * vertices[o] + r[1] * vertices[o + 1] + r[2] * vertices[o + 2] + r[3];
      normal.array[o + i] = r[0] * normals[o] + r[1] * normals[o + 1] + r[2] * normals[o + 2];
    }
  }
  position.needsUpdate = normal.needsUpdate = true;
}

function frustum(camera, depth) {
  const centre = new THREE.Vector3(...camera.centre);
  const corners = camera.corners.map((c) => new THREE.Vector3(...c).sub(centre).multiplyScalar(depth).add(centre));
  const points = [];
  corners.forEach((c, k) => points.push(centre, c, c, corners[(k + 1) % 4]));
  const group = new THREE.Group(), edges = new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial());
  const [a, b, c, d] = corners, screen = new THREE.BufferGeometry();
  screen.setAttribute("position", new THREE.Float32BufferAttribute([a, b, c, d].flatMap((p) => p.toArray()), 3));
  screen.setAttribute("uv", new THREE.Float32BufferAttribute([0, 1, 1, 1, 1, 0, 0, 0], 2));
  screen.setIndex([0, 1, 2, 0, 2, 3]);
  const canvas = make("canvas", { width: camera.size[0], height: camera.size[1] });
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  const material = new THREE.MeshBasicMaterial({ map: texture, side: THREE.DoubleSide, transparent: true, opacity: 0.9 });
  const plane = new THREE.Mesh(screen, material);
  plane.visible = false;
  const name = label(camera.name, centre);
  group.add(edges, plane, name);
  const tint = () => { edges.material.color.set(colour("--soft")); name.material.color.set(colour("--ink")); };
  return { group, plane, texture, canvas, name, edges, tint };
}

/** A name in white, which the material's colour turns into another. */
function label(text, at) {
  const canvas = make("canvas", { width: 256, height: 64 }), pen = pen2d(canvas);
  pen.font = "600 34px sans-serif"; pen.textAlign = "center"; pen.fillStyle = "#fff"; pen.fillText(text, 128, 44);
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), depthTest: false }));
  sprite.position.copy(at).add(new THREE.Vector3(0, 0, 0.14)); sprite.scale.set(0.6, 0.15, 1);
  return sprite;
}

function buildScene() {
  const box = document.getElementById("scene");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  } catch {
    box.append(make("p", {}, "This browser has no WebGL, so the 3D view stays empty; everything else works."));
    document.body.dataset.webgl = "no";
    return;
  }
  document.body.dataset.webgl = "yes";
  renderer.setPixelRatio(window.devicePixelRatio);
  box.append(renderer.domElement);
  const scene = new THREE.Scene();
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f99, 2.2));
  const sun = new THREE.DirectionalLight(0xffffff, 1.6);
  sun.position.set(2, -3, 5);
  scene.add(sun);
  runs.forEach((run) => { run.mesh = skinned(run); scene.add(run.mesh); });
  const first = runs.find((run) => run.rows.some((row) => row >= 0));
  pose(first, 0);
  first.mesh.geometry.computeBoundingBox();
  const middle = first.mesh.geometry.boundingBox.getCenter(new THREE.Vector3());
  const grid = new THREE.GridHelper(10, 20, 0xa8b1bc, 0xcfd6de);
  grid.rotation.x = Math.PI / 2;
  grid.position.set(Math.round(middle.x), Math.round(middle.y), 0);
  scene.add(grid);
  const far = data.cameras.map((c) => new THREE.Vector3(...c.centre).distanceTo(middle));
  const depth = Math.max(0.25, 0.14 * Math.min(...far));
  const frusta = data.cameras.map((camera) => frustum(camera, depth));
  frusta.forEach((f) => scene.add(f.group));
  const points = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color: truth, size: 7, sizeAttenuation: false, depthTest: false }));
  const sticks = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: truth, depthTest: false }));
  points.renderOrder = sticks.renderOrder = 1;
  points.frustumCulled = sticks.frustumCulled = false;
  scene.add(points, sticks);
  const tint = () => {
    truth = colour("--truth");
    scene.background = new THREE.Color(colour("--ground"));
    points.material.color.set(truth); sticks.material.color.set(truth);
    frusta.forEach((f) => f.tint());
    grid.material.opacity = isDark() ? 0.25 : 1;
  };
  grid.material.transparent = true;
  tint();
  const eye = new THREE.PerspectiveCamera(40, 1, 0.05, 200);
  eye.up.set(0, 0, 1);
  eye.position.copy(middle).add(new THREE.Vector3(2.6, -3.4, 1.1));
  const controls = new OrbitControls(eye, renderer.domElement);
  controls.target.copy(middle);
  controls.update();
  let due = 0, size = "";
  const render = () => { cancelAnimationFrame(due); due = 0; renderer.render(scene, eye); };
  const draw = () => { due ||= requestAnimationFrame(render); };  // however often it is asked for, once a picture
  controls.addEventListener("change", draw);
  themeListeners.push(() => { tint(); draw(); });
  keys(renderer.domElement, eye, controls);
  /** Whether the canvas has got another size; it is empty then. */
  const resize = () => {
    const { clientWidth: width, clientHeight: height } = box;
    if (size === (size = `${width} ${height}`)) return false;
    renderer.setSize(width, height);
    eye.aspect = width / height;
    eye.updateProjectionMatrix();
    return true;
  };
  resize();
  new ResizeObserver(() => { if (resize()) render(); }).observe(box);
  const away = new THREE.Vector3().subVectors(eye.position, middle).normalize();
  const look = (distance) => { eye.position.copy(middle).addScaledVector(away, distance); controls.target.copy(middle); controls.update(); draw(); };
  const near = eye.position.distanceTo(middle), wide = 2.2 * Math.max(near / 2.2, ...far);
  let all = false;
  box.append(make("button", { id: "zoom", click: (e) => { all = !all; look(all ? wide : near); e.target.textContent = all ? "body" : "all cameras"; } }, "all cameras"));
  const side = new THREE.Vector3().subVectors(controls.target, eye.position).cross(eye.up).normalize();
  listeners.push((frame) => {
    runs.forEach((run, k) => {
      const row = run.rows[frame];
      run.mesh.visible = run.visible && row >= 0;
      run.mesh.position.copy(side).multiplyScalar(state.apart ? k : 0);
      if (!run.mesh.visible) return;
      pose(run, row);
      run.mesh.material.color.set(run.lost[row] ? LOST : run.colour);
    });
    showReference(points, sticks, frame, side);
    draw();
  });
  return { frusta, draw, ground: () => scene.background, drawn: () => renderer.info.render.frame };
}

/** The 3D view by keys: arrows turn, + and − come near and go away. */
function keys(canvas, eye, controls) {
  canvas.tabIndex = 0;
  canvas.setAttribute("aria-label", "3D view: arrow keys turn, plus and minus zoom");
  const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }, nearer = { "+": 0.85, "=": 0.85, "-": 1 / 0.85 };
  canvas.addEventListener("keydown", (event) => {
    const turn = turns[event.key] ?? (nearer[event.key] ? [0, 0] : null);
    if (!turn) return;
    event.preventDefault(); event.stopPropagation();
    const away = new THREE.Vector3().subVectors(eye.position, controls.target), flat = Math.hypot(away.x, away.y);
    const length = away.length() * (nearer[event.key] ?? 1), about = Math.atan2(away.y, away.x) + turn[0];
    const up = Math.min(Math.max(Math.atan2(away.z, flat) - turn[1], -1.5), 1.5);
    eye.position.set(Math.cos(up) * Math.cos(about), Math.cos(up) * Math.sin(about), Math.sin(up)).multiplyScalar(length).add(controls.target);
    controls.update();
  });
}

function showReference(points, sticks, frame, side) {
  const own = data.reference && state.reference ? data.reference.points[frame] : [];
  points.geometry.dispose(); sticks.geometry.dispose();
  points.geometry = new THREE.BufferGeometry(); sticks.geometry = new THREE.BufferGeometry();
  points.position.copy(side).multiplyScalar(state.apart ? -1 : 0);
  sticks.position.copy(points.position);
  const vector = (p) => new THREE.Vector3(...p);
  points.geometry.setFromPoints(own.filter(Boolean).map(vector));
  const lines = (data.reference?.sticks ?? []).filter(([a, b]) => own[a] && own[b]);
  sticks.geometry.setFromPoints(lines.flatMap(([a, b]) => [vector(own[a]), vector(own[b])]));
}

/* ---- images ---- */
const views = document.getElementById("views");
const pictures = data.cameras.map((camera, c) => {
  if (!camera.images.length) return null;
  const canvas = make("canvas", { width: camera.size[0], height: camera.size[1] });
  const note = make("b", {}, camera.name);
  const tile = make("div", { class: "view" }, canvas, note);
  views.append(tile);
  const images = new Array(camera.images.length);
  return { canvas, images, note, tile };
});
if (!pictures.some(Boolean)) document.getElementById("stage").classList.add("bare");
const pictured = pictures.filter(Boolean).length, columns = Math.ceil(Math.sqrt(pictured));
views.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
views.style.gridTemplateRows = `repeat(${Math.ceil(pictured / columns)}, minmax(0, 1fr))`;
const scene3d = buildScene();  // its box has its size now

/** An image is decoded when it is first wanted; null where there is none. */
function imageOf(c, k) {
  const { images } = pictures[c], url = data.cameras[c].images[k];
  if (!url || images[k]) return images[k] ?? null;
  images[k] = new Image();
  images[k].addEventListener("load", () => { if (shownAt(state.frame) === k) { paint(c, state.frame); scene3d?.draw(); } });
  images[k].src = url;
  return images[k];
}

/** Which of the pictured frames stands for this one: the last at or before it. */
function shownAt(frame) {
  let low = 0, high = data.shown.length;
  while (high - low > 1) { const middle = (low + high) >> 1; if (data.shown[middle] <= frame) low = middle; else high = middle; }
  return low;
}

function trace(pen, curves) {
  pen.beginPath();
  for (const curve of curves) {
    for (let i = 0; i < curve.length; i += 2) i ? pen.lineTo(curve[i] + 0.5, curve[i + 1] + 0.5) : pen.moveTo(curve[0] + 0.5, curve[1] + 0.5);
    pen.closePath();
  }
  pen.stroke();
}

function paint(c, frame) {
  const picture = pictures[c];
  if (!picture) return;
  const k = shownAt(frame), image = imageOf(c, k), pen = pen2d(picture.canvas);
  if (k + 1 < data.shown.length) imageOf(c, k + 1);
  pen.fillStyle = "#14181f";
  pen.fillRect(0, 0, picture.canvas.width, picture.canvas.height);
  if (image?.complete && state.images) pen.drawImage(image, 0, 0, picture.canvas.width, picture.canvas.height);
  if (scene3d) {
    const { plane, texture, canvas } = scene3d.frusta[c];
    plane.visible = Boolean(image) && state.images;
    pen2d(canvas).drawImage(picture.canvas, 0, 0);
    texture.needsUpdate = true;
  }
  if (state.outlines) for (const run of runs) {
    if (!run.visible) continue;
    pen.strokeStyle = "#0008"; pen.lineWidth = 3; trace(pen, run.outlines[c][k]);
    pen.strokeStyle = run.lost[run.rows[data.shown[k]]] ? LOST : run.colour; pen.lineWidth = 1.6; trace(pen, run.outlines[c][k]);
  }
  const marks = data.reference && state.reference ? data.reference.pixels[c]?.[k] ?? [] : [];
  pen.fillStyle = "#fff"; pen.strokeStyle = "#15181d"; pen.lineWidth = 1;
  for (const mark of marks) if (mark) { pen.beginPath(); pen.arc(mark[0] + 0.5, mark[1] + 0.5, 1.8, 0, 7); pen.fill(); pen.stroke(); }
  const number = data.indices[data.shown[k]];
  const old = image && data.shown[k] !== frame ? ` (frame ${number})` : "", own = runs[0].cameras[runs[0].rows[frame]]?.[c];
  const note = own === "left out" || image ? own : "no image";
  picture.note.textContent = data.cameras[c].name + old + (note ? `: ${note}` : "");
  picture.tile.classList.toggle("out", own === "left out");
}
listeners.push((frame) => { pictures.forEach((_, c) => paint(c, frame)); scene3d?.draw(); });

/* ---- time line ---- */
const [slider, now, play, note, strip] = ["slider", "now", "play", "frame-note", "marks"].map((id) => document.getElementById(id));
slider.max = data.indices.length - 1;
slider.addEventListener("input", () => seek(+slider.value));
listeners.push((frame) => {
  slider.value = frame;
  const lost = runs.filter((run) => run.rows[frame] >= 0 && run.lost[run.rows[frame]]).map((run) => run.name);
  now.replaceChildren(`frame ${data.indices[frame]}   ${data.times[frame].toFixed(3)} s `);
  if (lost.length) now.append(make("span", { class: "lost" }, runs.length > 1 ? `lost: ${lost.join(", ")}` : "lost"));
  const texts = runs.filter((run) => run.notes[run.rows[frame]]).map((run) => (runs.length > 1 ? `${run.name}: ` : "") + run.notes[run.rows[frame]]);
  note.textContent = texts.join(" — ") || "height: probability of loss; red: lost, grey: body not seen, amber: a camera left out";
  note.className = texts.length ? "" : "soft";
});

/** The probability of loss of one frame in words, with that of its most doubtful limbs. */
function doubt(run, row) {
  const G = run.limbs.length, each = run.limbs.map((name, g) => [name, run.limbProbability[row * G + g]]);
  const worst = each.filter(([, p]) => p >= 0.05).sort((a, b) => b[1] - a[1]).slice(0, 3).map(([name, p]) => `${name} ${p.toFixed(2)}`);
  return `${run.name}: probability of loss ${run.probability[row].toFixed(2)}${worst.length ? ` (${worst.join(", ")})` : ""}`;
}

const THUMB = 8;  // px, half of the slider's knob
const stepOf = () => (strip.clientWidth - 2 * THUMB) / Math.max(1, data.indices.length - 1);

function drawMarks() {
  const height = runs.length > 1 ? 14 : 22, step = stepOf(), wide = Math.max(2, step), pen = pen2d(strip);
  strip.width = strip.clientWidth;
  strip.height = height * runs.length;
  strip.style.height = `${strip.height}px`;
  const bar = (frame, top, size, colour) => { pen.fillStyle = colour; pen.fillRect(THUMB + (frame - 0.5) * step, top, wide, size); };
  pen.fillStyle = colour("--bar"); pen.fillRect(0, 0, strip.width, strip.height);
  runs.forEach((run, k) => run.rows.forEach((row, frame) => {
    if (row < 0) return;
    const bottom = (k + 1) * height - 1, high = Math.round((height - 4) * run.probability[row]);
    if (run.lost[row] || run.dropped[row]) bar(frame, k * height, height - 1, run.lost[row] ? LOST + "55" : DROPPED + "77");
    bar(frame, bottom - 3 - high, high, run.lost[row] ? LOST : colour("--soft"));
    if (run.lost[row] || run.dropped[row]) bar(frame, bottom - 3, 3, run.lost[row] ? LOST : DROPPED);
    if (run.cameras[row].includes("left out")) bar(frame, k * height, 3, OUT);
  }));
}
const frameAt = (event) => Math.max(0, Math.min(data.indices.length - 1, Math.round((event.offsetX - THUMB) / stepOf())));
strip.addEventListener("click", (event) => seek(frameAt(event)));
strip.addEventListener("mousemove", (event) => {
  const frame = frameAt(event), there = runs.filter((run) => run.rows[frame] >= 0);
  strip.title = [`frame ${data.indices[frame]}`, ...there.map((run) => doubt(run, run.rows[frame]))].join("\n");
});
new ResizeObserver(drawMarks).observe(slider);
themeListeners.push(drawMarks);

let started = 0, from = 0;
function tick(clock) {
  if (!state.playing) return;
  const t = data.times[from] + (clock - started) / 1000 * +document.getElementById("speed").value;
  if (state.frame === data.times.length - 1) { from = 0; started = clock; seek(0); requestAnimationFrame(tick); return; }
  let frame = state.frame;
  while (frame + 1 < data.times.length && data.times[frame + 1] <= t) frame++;
  if (frame !== state.frame) seek(frame);
  requestAnimationFrame(tick);
}
function setPlaying(on) {
  state.playing = on;
  play.textContent = on ? "❚❚ Pause" : "▶ Play";
  if (on) { from = state.frame === data.times.length - 1 ? 0 : state.frame; seek(from); started = performance.now(); requestAnimationFrame(tick); }
}
play.addEventListener("click", () => setPlaying(!state.playing));
document.getElementById("speed").addEventListener("change", () => setPlaying(state.playing));
/** Keys work wherever the focus is, except where they already mean something: a list takes all of them, a button the
 * space, the slider the arrows. */
document.addEventListener("keydown", (event) => {
  const { tagName, type } = event.target;
  if (tagName === "SELECT" || event.ctrlKey || event.metaKey || event.altKey) return;
  const { key } = event, last = data.indices.length - 1, step = event.shiftKey ? 10 : 1;
  if (key === " " && !["BUTTON", "SUMMARY"].includes(tagName) && type !== "checkbox") setPlaying(!state.playing);
  else if (key === "+" || key === "=") zoomTime(0.5);
  else if (key === "-") zoomTime(2);
  else if (key === "0") show(...whole);
  else if (type === "range") return;
  else if (key === "ArrowLeft" || key === "ArrowRight") seek(state.frame + (key === "ArrowRight" ? step : -step));
  else if (key === "Home" || key === "End") seek(key === "End" ? last : 0);
  else return;
  event.preventDefault();
});
