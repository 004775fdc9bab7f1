/* Part of the page of clicks: a magnified circle about the pixel that a finger, the mouse or the keys point at. */
const LOUPE = 9;  // rem across
const SHOWN = 7;  // rem of the image, as it is on the screen, that fill it

function loupeOf(camera) {
  const svg = make("svg", { viewBox: "0 0 1 1" }), outline = make("path", { class: "outline" }), [w, h] = camera.size;
  if (camera.image) svg.append(make("image", { href: camera.image, x: 0, y: 0, width: w, height: h, preserveAspectRatio: "none" }));
  const cross = make("path", { class: "cross" });
  svg.append(outline, cross);
  const box = make("div", { class: "loupe", hidden: "" }, svg);
  return { box, svg, outline, cross };
}

/** Show it about a pixel, above the finger, or below where there is no room; `view` is one of the page's views. */
function showLoupe(view, [x, y], d) {
  const { box, svg, outline, cross } = view.loupe, rem = em();
  const matrix = view.svg.getScreenCTM(), half = SHOWN * rem / 8 / matrix.a;
  const at = new DOMPoint(x + 0.5, y + 0.5).matrixTransform(matrix), frame = view.svg.parentElement.getBoundingClientRect();
  svg.setAttribute("viewBox", `${x + 0.5 - half} ${y + 0.5 - half} ${2 * half} ${2 * half}`);
  cross.setAttribute("d", `M${x + 0.5 - half} ${y + 0.5}h${0.85 * half}m${0.3 * half} 0h${0.85 * half}M${x + 0.5} ${y + 0.5 - half}v${0.85 * half}m0 ${0.3 * half}v${0.85 * half}`);
  outline.setAttribute("d", d);
  const size = LOUPE * rem, left = at.x - frame.left - size / 2, above = at.y - frame.top - size - 2 * rem;
  box.style.left = `${Math.min(Math.max(left, 0), Math.max(0, frame.width - size))}px`;
  box.style.top = `${above >= 0 ? above : Math.min(at.y - frame.top + 2 * rem, Math.max(0, frame.height - size))}px`;
  box.hidden = false;
}
const hideLoupe = (view) => { view.loupe.box.hidden = true; };
