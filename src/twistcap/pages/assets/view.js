/* The viewer: 3D scene, images with outlines, time line and joint-angle plots, all driven by `seek`. */
const COLOURS = data.runs.length > 1 ? ["#2f7de1", "#ef8a24", "#35a368", "#a758cf", "#c8466a", "#5a6270"] : ["#2f7de1"];
const TRUTH = "#15181d", LOST = "#e5484d", DROPPED = "#9aa3ad", DOUBT = "#5d6875", OUT = "#d98a00";
const colourOf = (k) => COLOURS[k % COLOURS.length];
const runs = data.runs.map((run, k) => ({
  ...run, colour: colourOf(k), visible: true, transforms: unpack(run.transforms), angles: unpack(run.angles_deg),
  sigma: unpack(run.sigma_deg), limbProbability: unpack(run.limb_probability),
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

/* ---- header ---- */
const legend = document.getElementById("legend");
runs.forEach((run) => {
  const box = make("input", { type: "checkbox", change: (e) => { run.visible = e.target.checked; refresh(); } });
  box.checked = true;
  const swatch = make("span", { class: "swatch", style: `background:${run.colour}` });
  const lost = run.lost.filter(Boolean).length;
  const note = lost ? make("span", { class: "lost" }, ` (${lost} of ${run.lost.length} frames lost)`) : "";
  const told = make("details", {}, make("summary", {}, "lost frames and cameras"), ...run.told.map((text) => make("div", {}, text)));
  legend.append(make("label", {}, box, swatch, run.name, note), " ", told, " ");
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
  const group = new THREE.Group();
  group.add(new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color: 0x4a5563 })));
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
  group.add(plane, label(camera.name, centre));
  return { group, plane, texture, canvas };
}

function label(text, at) {
  const canvas = make("canvas", { width: 256, height: 64 }), pen = canvas.getContext("2d");
  pen.font = "600 34px sans-serif"; pen.textAlign = "center"; pen.fillStyle = "#1b2430"; pen.fillText(text, 128, 44);
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
  scene.background = new THREE.Color("#e9edf2");
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
  const points = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color: TRUTH, size: 7, sizeAttenuation: false, depthTest: false }));
  const sticks = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: TRUTH, depthTest: false }));
  points.renderOrder = sticks.renderOrder = 1;
  points.frustumCulled = sticks.frustumCulled = false;
  scene.add(points, sticks);
  const eye = new THREE.PerspectiveCamera(40, 1, 0.05, 200);
  eye.up.set(0, 0, 1);
  eye.position.copy(middle).add(new THREE.Vector3(2.6, -3.4, 1.1));
  const controls = new OrbitControls(eye, renderer.domElement);
  controls.target.copy(middle);
  controls.update();
  const draw = () => renderer.render(scene, eye);
  controls.addEventListener("change", draw);
  const resize = () => {
    renderer.setSize(box.clientWidth, box.clientHeight);
    eye.aspect = box.clientWidth / box.clientHeight;
    eye.updateProjectionMatrix();
    draw();
  };
  new ResizeObserver(resize).observe(box);
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
  return { frusta, draw };
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
const scene3d = buildScene();
const pictures = data.cameras.map((camera, c) => {
  if (!camera.images.length) return null;
  const canvas = make("canvas", { width: camera.size[0], height: camera.size[1] });
  const note = make("b", {}, camera.name);
  const tile = make("div", { class: "view" }, canvas, note);
  views.append(tile);
  const images = camera.images.map((url) => {
    if (!url) return null;
    const image = new Image();
    image.src = url;
    image.addEventListener("load", () => { if (shownAt(state.frame) === images.indexOf(image)) paint(c, state.frame); });
    return image;
  });
  return { canvas, images, note, tile };
});
if (!pictures.some(Boolean)) document.getElementById("stage").classList.add("bare");
const pictured = pictures.filter(Boolean).length, columns = Math.ceil(Math.sqrt(pictured));
views.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
views.style.gridTemplateRows = `repeat(${Math.ceil(pictured / columns)}, minmax(0, 1fr))`;

/** Which of the pictured frames stands for this one: the last at or before it. */
function shownAt(frame) {
  let k = 0;
  while (k + 1 < data.shown.length && data.shown[k + 1] <= frame) k++;
  return k;
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
  const k = shownAt(frame), image = picture.images[k], pen = picture.canvas.getContext("2d");
  pen.fillStyle = "#14181f";
  pen.fillRect(0, 0, picture.canvas.width, picture.canvas.height);
  if (image?.complete && state.images) pen.drawImage(image, 0, 0, picture.canvas.width, picture.canvas.height);
  if (scene3d) {
    const { plane, texture, canvas } = scene3d.frusta[c];
    plane.visible = Boolean(image) && state.images;
    canvas.getContext("2d").drawImage(picture.canvas, 0, 0);
    texture.needsUpdate = true;
  }
  if (state.outlines) for (const run of runs) {
    if (!run.visible) continue;
    pen.strokeStyle = "#0008"; pen.lineWidth = 3; trace(pen, run.outlines[c][k]);
    pen.strokeStyle = run.lost[run.rows[data.shown[k]]] ? LOST : run.colour; pen.lineWidth = 1.6; trace(pen, run.outlines[c][k]);
  }
  const marks = data.reference && state.reference ? data.reference.pixels[c]?.[k] ?? [] : [];
  pen.fillStyle = "#fff"; pen.strokeStyle = TRUTH; pen.lineWidth = 1;
  for (const mark of marks) if (mark) { pen.beginPath(); pen.arc(mark[0] + 0.5, mark[1] + 0.5, 1.8, 0, 7); pen.fill(); pen.stroke(); }
  const number = data.indices[data.shown[k]];
  const old = image && data.shown[k] !== frame ? ` (frame ${number})` : "", own = runs[0].cameras[runs[0].rows[frame]]?.[c];
  const note = own === "left out" || image ? own : "no image";
  picture.note.textContent = data.cameras[c].name + old + (note ? `: ${note}` : "");
  picture.tile.classList.toggle("out", own === "left out");
}
listeners.push((frame) => { pictures.forEach((_, c) => paint(c, frame)); scene3d?.draw(); });

/* ---- time line ---- */
const [slider, now, play, said, strip] = ["slider", "now", "play", "said", "marks"].map((id) => document.getElementById(id));
slider.max = data.indices.length - 1;
slider.addEventListener("input", () => seek(+slider.value));
listeners.push((frame) => {
  slider.value = frame;
  const lost = runs.filter((run) => run.rows[frame] >= 0 && run.lost[run.rows[frame]]).map((run) => run.name);
  now.replaceChildren(`frame ${data.indices[frame]}   ${data.times[frame].toFixed(3)} s `);
  if (lost.length) now.append(make("span", { class: "lost" }, runs.length > 1 ? `lost: ${lost.join(", ")}` : "lost"));
  const texts = runs.filter((run) => run.said[run.rows[frame]]).map((run) => (runs.length > 1 ? `${run.name}: ` : "") + run.said[run.rows[frame]]);
  said.textContent = texts.join(" — ") || "height: probability of loss; red: lost, grey: body not seen, amber: a camera left out";
  said.className = texts.length ? "" : "soft";
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
  const height = runs.length > 1 ? 14 : 22, step = stepOf(), wide = Math.max(2, step), pen = strip.getContext("2d");
  strip.width = strip.clientWidth;
  strip.height = height * runs.length;
  strip.style.height = `${strip.height}px`;
  const bar = (frame, top, size, colour) => { pen.fillStyle = colour; pen.fillRect(THUMB + (frame - 0.5) * step, top, wide, size); };
  pen.fillStyle = "#eef1f5"; pen.fillRect(0, 0, strip.width, strip.height);
  runs.forEach((run, k) => run.rows.forEach((row, frame) => {
    if (row < 0) return;
    const bottom = (k + 1) * height - 1, high = Math.round((height - 4) * run.probability[row]);
    if (run.lost[row] || run.dropped[row]) bar(frame, k * height, height - 1, run.lost[row] ? LOST + "55" : DROPPED + "77");
    bar(frame, bottom - 3 - high, high, run.lost[row] ? LOST : DOUBT);
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
document.addEventListener("keydown", (event) => {
  if (["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName)) return;
  if (event.key === " ") { event.preventDefault(); setPlaying(!state.playing); }
  if (event.key === "ArrowLeft" || event.key === "ArrowRight") seek(state.frame + (event.key === "ArrowRight" ? 1 : -1));
});

/* ---- plots ---- */
function column(run, j, values) {
  const J = run.coordinates.length;
  return run.rows.map((row) => (row < 0 ? null : values(row * J + j)));
}

function plotOf(name) {
  const series = [{}], table = [data.times], bands = [];
  for (const run of runs) {
    const j = run.coordinates.indexOf(name);
    if (j < 0) continue;
    const hi = table.length;
    table.push(column(run, j, (i) => run.angles[i] + 2 * run.sigma[i]), column(run, j, (i) => run.angles[i] - 2 * run.sigma[i]), column(run, j, (i) => run.angles[i]));
    const hidden = { stroke: "transparent", width: 0, points: { show: false } };
    series.push(hidden, { ...hidden }, { stroke: run.colour, width: 1.5, points: { show: false } });
    bands.push({ series: [hi, hi + 1], fill: run.colour + "33" });
  }
  const r = data.reference ? data.reference.coordinates.indexOf(name) : -1;
  if (r >= 0) {
    table.push(data.reference.angles_deg.map((row) => row[r]));
    series.push({ stroke: TRUTH, width: 1.2, dash: [5, 4], points: { show: false } });
  }
  const holder = make("div", { class: "plot" }, make("h2", {}, name));
  document.getElementById("plots").append(holder);
  const axis = { size: 34, font: "10px sans-serif", grid: { stroke: "#edf0f3" }, ticks: { show: false } };
  const width = holder.clientWidth || 320;
  const plot = new uPlot({
    width, height: 120, legend: { show: false }, cursor: { show: false }, series, bands,
    scales: { x: { time: false }, y: { range: (_, lo, hi) => { const pad = Math.max(0, (10 - (hi - lo)) / 2) + 0.05 * (hi - lo); return [lo - pad, hi + pad]; } } },
    axes: [{ ...axis, size: 20 }, axis], hooks: { drawClear: [shade] },
  }, table, holder);
  const needle = make("div", { class: "needle" });
  plot.over.append(needle);
  plot.over.addEventListener("click", (event) => {
    const t = plot.posToVal(event.offsetX, "x");
    seek(data.times.reduce((best, value, k) => (Math.abs(value - t) < Math.abs(data.times[best] - t) ? k : best), 0));
  });
  listeners.push((frame) => { needle.style.left = plot.valToPos(data.times[frame], "x") + "px"; });
}

/** Red behind the frames that any result lost. */
function shade(u) {
  const half = (data.times.at(-1) - data.times[0]) / Math.max(1, data.times.length - 1) / 2;
  u.ctx.fillStyle = "#e5484d2e";
  data.times.forEach((t, frame) => {
    if (!runs.some((run) => run.rows[frame] >= 0 && run.lost[run.rows[frame]])) return;
    const x = u.valToPos(t - half, "x", true), end = u.valToPos(t + half, "x", true);
    u.ctx.fillRect(x, u.bbox.top, end - x, u.bbox.height);
  });
}
const names = [...new Set(runs.flatMap((run) => run.coordinates))];
names.forEach(plotOf);

window.twistcapView = { seek, setPlaying, state, runs };
seek(0);
document.body.dataset.ready = "yes";
