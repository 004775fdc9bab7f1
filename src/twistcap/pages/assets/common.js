/* Shared by the pages. */
const data = JSON.parse(document.getElementById("data").textContent);
const TYPES = { f4: Float32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };

/** The typed array that Python's `packed` wrote. */
function unpack({ type, data }) {
  const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
  return new TYPES[type](bytes.buffer);
}

/** An element with attributes and children; attributes that are functions become listeners. */
function make(tag, attributes = {}, ...children) {
  const svg = ["svg", "image", "circle", "path", "polygon", "g", "text", "line"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(key, value);
    else element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}
