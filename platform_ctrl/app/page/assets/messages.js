// Requests of the page to the server, and the functions that follow its responses.
// Moves of sliders are never queued: while one is being worked out, only the newest of each slider waits.
let send = null;
let sent = 0, answered = 0, gesture = 0;
const waiting = new Map();
// What is meant for where the sliders have come to: it waits until they are there.
const AFTER_MOVES = new Set(["undo", "redo", "tune", "save", "simulate"]);
const later = [];
const listeners = new Map();

export const byId = (id) => document.getElementById(id);

export const made = (tag, properties = {}, ...children) => {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.includes("-") || name === "role" || name === "for" || name === "scope") element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children);
  return element;
};

export const icon = (name) => {
  const SVG = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(SVG, "svg"), use = document.createElementNS(SVG, "use");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  svg.setAttribute("viewBox", "0 0 16 16");
  use.setAttribute("href", `#icon-${name}`);
  svg.append(use);
  return svg;
};

// While an answer is on its way the browser's frames go on: when it comes, the next one is near.
let ticking = false;
const tick = () => {
  ticking = answered < sent;
  if (ticking) requestAnimationFrame(tick);
};

export const request = (what, more = {}) => {
  if (send === null) return;
  if (AFTER_MOVES.has(what) && (answered < sent || waiting.size > 0)) {
    later.push([what, more]);
    return;
  }
  sent += 1;
  if (!ticking) tick();
  send({ n: sent, what, ...more });
};
// The number of the last request; an answer with a smaller one does not include it.
export const lastRequest = () => sent;

const sendWaiting = () => {
  if (answered < sent || waiting.size === 0) return;
  const moves = [...waiting.values()];
  waiting.clear();
  request("move", { moves, gesture });
};

// One gesture is one step of undo: a drag, a series of arrow keys, a number typed.
export const move = (slider, value) => {
  waiting.set(slider, { slider, value });
  sendWaiting();
};
// A number that was typed goes at once, whatever it is: the server judges it.
export const put = (slider, value) => {
  newGesture();
  request("move", { moves: [{ slider, value }], gesture });
};
export const newGesture = () => { gesture += 1; };
export const pending = (slider) => waiting.has(slider);
export const settled = (n) => n >= sent;
export const traffic = () => ({ sent, answered, waiting: waiting.size + later.length });
export const connect = (given) => { send = given; };

export const on = (part, listen) => {
  if (!listeners.has(part)) listeners.set(part, []);
  listeners.get(part).push(listen);
};

export const receive = (message) => {
  for (const [part, content] of Object.entries(message)) {
    for (const listen of listeners.get(part) ?? []) listen(content, message);
  }
  if (typeof message.n === "number" && message.n >= answered) {
    answered = message.n;
    sendWaiting();
    if (answered >= sent && later.length > 0) request(...later.shift());
  }
};

// Writes only what is different: whatever is written makes the browser lay the page out again.
export const write = (element, text) => { if (element.textContent !== text) element.textContent = text; };
export const dress = (element, name) => { if (element.className !== name) element.className = name; };

// Numbers as an instrument shows them: four figures, no exponent where none is needed.
export const shown = (value, figures = 4) => {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value === "inf" || value === Infinity) return "∞";
  if (value === "-inf" || value === -Infinity) return "−∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e6 || size < 1e-4
    ? value.toExponential(figures - 2).replace(/\.?0+e/, "e").replace("e+", "e")
    : String(Number(value.toPrecision(size >= 1000 ? Math.max(figures, 5) : figures)));
  return text.replace("-", "−");
};
// A margin as a share of its limit. What has no room is said to be more, never to be another number.
export const percent = (share) => {
  if (share === null || share === undefined) return "–";
  if (share === "inf" || share === "-inf") return share === "inf" ? "+∞" : "−∞";
  const sign = share < 0 ? "−" : "+", size = Math.abs(share);
  return size > 9.99 ? `${share < 0 ? "< −" : "> +"}999 %` : `${sign}${shown(100 * size, size < 0.1 ? 2 : 3)} %`;
};
export const typed = (text) => {
  const plain = text.trim().replace("−", "-").replace(/^(-?\d*),(\d+)$/, "$1.$2");
  return plain === "" ? NaN : Number(plain);
};
