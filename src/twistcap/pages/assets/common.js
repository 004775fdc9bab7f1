/* Shared by the pages. */
const data = JSON.parse(document.getElementById("data").textContent);
const TYPES = { f4: Float32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };

/** The typed array that Python's `packed` wrote. */
function unpack({ type, data }) {
  const text = atob(data), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new TYPES[type](bytes.buffer);
}

/** An element with attributes and children; attributes that are functions become listeners. */
function make(tag, attributes = {}, ...children) {
  const svg = ["svg", "image", "circle", "path", "polygon", "g", "text", "line", "title"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(key, value);
    else element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}

/** The pen of a small canvas, kept in memory: a canvas on the graphics card costs more to set up than to draw. */
const pen2d = (canvas) => canvas.getContext("2d", { willReadFrequently: true });

/** Size of a rem, px: the pages grow with the screen. */
const em = () => parseFloat(getComputedStyle(document.documentElement).fontSize);

/* ---- dark and light: as the system has it, until the button says otherwise ---- */
const darkSystem = matchMedia("(prefers-color-scheme: dark)"), themeListeners = [];

/** What the button said last; a file or a private window may have no storage. */
function storedTheme(value) {
  try {
    if (value) localStorage.setItem("twistcap-theme", value);
    return localStorage.getItem("twistcap-theme");
  } catch { return value; }
}
const isDark = () => (document.documentElement.style.colorScheme || (darkSystem.matches ? "dark" : "light")) === "dark";

/** The colour that a custom property of the style sheet has at present. */
const colours = new Map();
themeListeners.push(() => colours.clear());
function colour(name) {
  if (!colours.has(name)) {
    const probe = make("i", { style: `color: var(${name})` });
    document.body.append(probe);
    colours.set(name, getComputedStyle(probe).color);
    probe.remove();
  }
  return colours.get(name);
}

function themeButton() {
  const button = make("button", { id: "theme", click: () => show(storedTheme(isDark() ? "light" : "dark")) });
  const show = (theme) => {
    document.documentElement.style.colorScheme = theme ?? "";
    button.textContent = isDark() ? "☀ Light" : "☾ Dark";
    for (const listener of themeListeners) listener();
  };
  darkSystem.addEventListener("change", () => show(storedTheme()));
  document.querySelector("header").append(button);
  show(storedTheme());
}
