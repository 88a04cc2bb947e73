// The sliders: a row each with its number, unit, a lock and a way back to where it stood at first.
import { ask, byId, icon, made, move, newGesture, on, pending, put, settled, shown, typed } from "./wire.js";

const STEPS = 1000, FINE = 2, COARSE = 20;
// Milliseconds without a key after which the next one begins a series of its own; a key that is held is one series.
const SERIES = 1500;
const GROUPS = { gains: "Gains", lead: "Lead and lag", lag: "Lag", notch: "Notch", design: "Design", sampling: "Sampling", rotors: "Rotors", Omega: "Platform rate" };
export const rows = new Map();
let structure = "";

const place = (knob, value) => {
  const part = knob.logarithmic
    ? Math.log(value / knob.low) / Math.log(knob.high / knob.low)
    : (value - knob.low) / (knob.high - knob.low);
  return Math.round(STEPS * Math.min(1, Math.max(0, Number.isFinite(part) ? part : 0)));
};

const valueAt = (knob, position) => {
  const part = position / STEPS;
  const value = knob.logarithmic ? knob.low * (knob.high / knob.low) ** part : knob.low + part * (knob.high - knob.low);
  return Number(value.toPrecision(knob.logarithmic ? 4 : 6));
};

export const near = (name, is) => {
  for (const element of document.querySelectorAll(`[data-knob="${CSS.escape(name)}"]`)) element.classList.toggle("near", is);
};

const paintRow = (row) => {
  const { knob, slider, number, pin, element } = row;
  const position = row.dragged ?? place(knob, knob.value);
  const value = row.dragged === null ? knob.value : valueAt(knob, row.dragged);
  const now = JSON.stringify([position, value, knob.fixed, knob.value === knob.start, row.typing, document.activeElement === number]);
  if (now === row.painted) return;
  row.painted = now;
  if (Number(slider.value) !== position) slider.value = position;
  slider.style.setProperty("--at", `${position / STEPS * 100}%`);
  slider.setAttribute("aria-valuetext", `${shown(value)} ${knob.unit}`.trim());
  if (document.activeElement !== number || !row.typing) number.value = shown(value);
  pin.setAttribute("aria-pressed", String(knob.fixed));
  element.classList.toggle("fixed", knob.fixed);
  element.classList.toggle("still", knob.value === knob.start);
};

let pressed = -Infinity;
const keyed = (row, event, way) => {
  if (!event.repeat && event.timeStamp - pressed > SERIES) newGesture();
  pressed = event.timeStamp;
  slide(row, (row.dragged ?? place(row.knob, row.knob.value)) + way);
};

const slide = (row, position) => {
  row.dragged = Math.min(STEPS, Math.max(0, position));
  paintRow(row);
  move(row.knob.name, valueAt(row.knob, row.dragged));
};

const makeRow = (knob, k) => {
  const id = `knob-${k}`;
  const slider = made("input", { type: "range", id, min: 0, max: STEPS, step: 1, "aria-describedby": `${id}-tip` });
  const number = made("input", { type: "text", inputMode: "decimal", autocomplete: "off", spellcheck: false, "aria-label": `${knob.label}, ${knob.unit || "number"}` });
  const pin = made("button", { type: "button", className: "pin", title: "Fix: neither pulling nor tuning moves it (X)", "aria-label": `Fix ${knob.label}` }, icon("pin"));
  const reset = made("button", { type: "button", className: "reset", title: "Back to where it stood (R)", "aria-label": `Reset ${knob.label}` }, icon("reset"));
  const label = made("label", { for: id, title: knob.tip }, knob.label);
  const unit = made("span", { className: "unit" }, knob.unit);
  const tip = made("span", { hidden: true, id: `${id}-tip` }, knob.tip);
  const element = made("div", { className: "knob", "data-knob": knob.name }, label, slider, number, unit, pin, reset, tip);
  const row = { knob, element, slider, number, pin, reset, dragged: null, typing: false, painted: "" };

  slider.addEventListener("pointerdown", newGesture);
  slider.addEventListener("input", () => slide(row, Number(slider.value)));
  slider.addEventListener("keydown", (event) => {
    const way = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
    const page = { PageUp: 1, PageDown: -1 }[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (way) keyed(row, event, way * (event.shiftKey ? COARSE * FINE : FINE));
    else if (page) keyed(row, event, page * STEPS / 10);
    else if (event.key === "Home") keyed(row, event, -STEPS);
    else if (event.key === "End") keyed(row, event, STEPS);
    else return;
    event.preventDefault();
  });
  const commit = () => {
    if (!row.typing) return;
    row.typing = false;
    row.dragged = null;
    const value = typed(number.value);
    put(row.knob.name, Number.isFinite(value) ? value : number.value.slice(0, 40));
  };
  number.addEventListener("input", () => { row.typing = true; });
  number.addEventListener("focus", () => number.select());
  number.addEventListener("blur", commit);
  number.addEventListener("keydown", (event) => {
    if (event.key === "Enter") { commit(); number.select(); }
    else if (event.key === "Escape") { row.typing = false; row.painted = ""; paintRow(row); number.select(); }
    else if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      row.typing = false;
      keyed(row, event, (event.key === "ArrowUp" ? 1 : -1) * (event.shiftKey ? COARSE * FINE : FINE));
      event.preventDefault();
    }
  });
  pin.addEventListener("click", () => ask("fix", { knob: row.knob.name, fixed: !row.knob.fixed }));
  reset.addEventListener("click", () => { row.dragged = null; ask("reset", { knob: row.knob.name }); slider.focus(); });
  for (const [enter, leave] of [["mouseenter", "mouseleave"], ["focusin", "focusout"]]) {
    element.addEventListener(enter, () => near(knob.name, true));
    element.addEventListener(leave, () => near(knob.name, false));
  }
  return row;
};

const build = (knobs, parts) => {
  const focused = document.activeElement?.closest?.("[data-knob]")?.dataset.knob;
  rows.clear();
  const groups = new Map();
  for (const [k, knob] of knobs.entries()) {
    const row = makeRow(knob, k);
    rows.set(knob.name, row);
    if (!groups.has(knob.group)) groups.set(knob.group, []);
    groups.get(knob.group).push(row.element);
  }
  const fieldsets = [...groups].map(([group, elements]) =>
    made("fieldset", { "data-group": group }, made("legend", {}, GROUPS[group] ?? group), ...elements));
  if (parts.length) {
    const boxes = parts.map((part) => {
      const box = made("input", { type: "checkbox", checked: part.on });
      box.addEventListener("change", () => ask("part", { part: part.name, on: box.checked }));
      return made("label", { title: part.tip }, box, part.label);
    });
    const at = fieldsets.findIndex((one) => ["sampling", "rotors", "Omega"].includes(one.dataset.group));
    fieldsets.splice(at < 0 ? fieldsets.length : at, 0, made("fieldset", { className: "parts" }, made("legend", {}, "With", ...boxes)));
  }
  byId("knobs").replaceChildren(...fieldsets);
  if (focused && rows.has(focused)) rows.get(focused).slider.focus();
};

on("knobs", (knobs, told) => {
  const parts = told.parts ?? [];
  // Ends that move with another slider, as with the sample rate, leave the rows: one of them may be under the hand.
  const now = JSON.stringify([knobs.map((one) => [one.name, one.label, one.unit, one.group]), parts]);
  if (now !== structure) {
    structure = now;
    build(knobs, parts);
  }
  for (const knob of knobs) {
    const row = rows.get(knob.name);
    row.knob = knob;
    if (told.line?.kind === "error") row.painted = "";
    // A slider that is being moved stays under the hand: its newest move is still on its way.
    if (!pending(knob.name) && settled(told.n)) row.dragged = null;
    paintRow(row);
  }
});
