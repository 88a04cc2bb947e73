// Requests of the page to the server, and what it shows of the state that Bokeh keeps equal at both ends.
// Moves of sliders are never queued: while one is being computed, only the newest of each slider waits.
export const byId = (id) => document.getElementById(id);
const moves = new Map(), later = [], listeners = {};
// Requests that refer to the final positions of the sliders: they wait until all moves are done.
const AFTER_MOVES = new Set(["undo", "redo", "tune", "save", "simulate"]);
// What is shown of the state's parts.
const texts = {};
let state = null, sent = 0, answered = 0, gesture = 0;
// Sliders that are being dragged: their newest moves are not answered yet.
export const held = new Set();
// Number of the request of each choice: an answer to an earlier request does not take the choice back.
const chosen = new WeakMap();
export const choose = (element, what, more) => {
  request(what, more);
  chosen.set(element.closest("select, fieldset") ?? element, sent);
};

// For tests and scripts: whether all requests are done.
window.page = { settled: () => sent > 0 && sent === answered && moves.size + later.length === 0 };

export const request = (what, more = {}) => {
  if (state === null) return;
  if (AFTER_MOVES.has(what) && !window.page.settled()) {
    later.push([what, more]);
    return;
  }
  // Another request for a slider replaces a waiting move.
  for (const { slider } of more.moves ?? [more]) moves.delete(slider);
  sent += 1;
  state.request = { n: sent, what, ...more };
};

// A gesture is a step of undo: a drag, a series of arrow keys, a typed number.
export const newGesture = () => { gesture += 1; return gesture; };
export const move = (slider, value) => {
  moves.delete(slider);
  moves.set(slider, { slider, value, gesture });
  sendMoves();
};
// The oldest first: a move that waited belongs to its own gesture, also once another has begun.
const sendMoves = () => {
  if (answered < sent || moves.size === 0) return;
  const [oldest] = moves.values(), together = [...moves.values()].filter((one) => one.gesture === oldest.gesture);
  request("move", { moves: together.map(({ slider, value }) => ({ slider, value })), gesture: oldest.gesture });
};

// What to do when a property of the state changes.
export const on = (name, act) => { listeners[name] = act; };
const follow = () => {
  const [count] = state.answered, isNew = count > answered, isLast = count >= sent;
  if (isLast) for (const name of held) if (!moves.has(name)) held.delete(name);
  answered = count;
  for (const [id, [text]] of Object.entries(state.parts.data)) {
    // Beside a line about a request all is shown again: what was refused is taken back.
    if (text !== texts[id] || (isNew && state.line[0])) show(byId(id), text);
    // Until the last request is done the user's own choices stay.
    if (isLast) texts[id] = text;
  }
  sendMoves();
  if (answered >= sent && later.length > 0) request(...later.shift());
  window.dispatchEvent(new CustomEvent("response"));
};

const show = (element, text) => {
  const template = document.createElement("template"), focused = document.activeElement?.id;
  template.innerHTML = text;
  become(element, template.content);
  // Where a row was inserted before it, the element that had the focus is a new one.
  if (focused && document.activeElement === document.body) byId(focused)?.focus();
};

// The children of `there` become those of `given`; equal ones stay, with focus and pointer.
const become = (there, given) => {
  const old = [...there.childNodes], now = [...given.childNodes];
  for (const [k, one] of now.entries()) {
    const kept = old[k];
    if (!kept) there.append(one);
    else if (kept.nodeName !== one.nodeName || kept.id !== one.id || kept.dataset?.slider !== one.dataset?.slider) kept.replaceWith(one);
    else if (kept.nodeType !== Node.ELEMENT_NODE) { if (kept.data !== one.data) kept.data = one.data; }
    else if (!held.has(kept.dataset.slider)) {
      dress(kept, one);
      become(kept, one);
    }
  }
  for (const one of old.slice(now.length)) one.remove();
};

const dress = (there, given) => {
  for (const { name, value } of given.attributes) if (there.getAttribute(name) !== value) there.setAttribute(name, value);
  // Open details and text that is being typed are the user's.
  for (const { name } of [...there.attributes]) if (!given.hasAttribute(name) && name !== "open" && name !== "data-typing") there.removeAttribute(name);
  if (chosen.get(there.closest("select, fieldset") ?? there) > answered) return;
  if (there instanceof HTMLOptionElement) there.selected = given.selected;
  else if (there instanceof HTMLInputElement && !(there.type === "text" && there === document.activeElement)) {
    there.checked = given.checked;
    if (there.type !== "radio" && there.type !== "checkbox" && there.value !== given.value) there.value = given.value;
  }
};

// The state, once BokehJS has it.
export const connect = (bokeh) => {
  state = bokeh.get_model_by_name("state");
  state.properties.answered.change.connect(follow);
  for (const [name, act] of Object.entries(listeners)) state.properties[name].change.connect(() => act(state[name]));
};
