// The sliders: a row each with its number, unit, a lock and a reset button.
import { request, byId, icon, made, move, newGesture, on, pending, put, settled, shown, typed } from "./messages.js";

const STEPS = 4000, FINE = 4, COARSE = 20;
// Milliseconds without a key after which the next one begins a series of its own; a key that is held is one series.
const SERIES = 1500;
const GROUPS = { main: "Speed and robustness", gains: "Gains", lead: "Lead and lag", lag: "Lag", notch: "Notch", design: "Design" };
export const rows = new Map();
let structure = "", designOpen = false, allOpen = true;

const place = (slider, value) => {
  const part = slider.logarithmic
    ? Math.log(value / slider.low) / Math.log(slider.high / slider.low)
    : (value - slider.low) / (slider.high - slider.low);
  return Math.round(STEPS * Math.min(1, Math.max(0, Number.isFinite(part) ? part : 0)));
};

const valueAt = (slider, position) => {
  const part = position / STEPS;
  const value = slider.logarithmic ? slider.low * (slider.high / slider.low) ** part : slider.low + part * (slider.high - slider.low);
  return Number(value.toPrecision(slider.logarithmic ? 4 : 6));
};

export const near = (name, is) => {
  for (const element of document.querySelectorAll(`[data-slider="${CSS.escape(name)}"]`)) element.classList.toggle("near", is);
};

const paintRow = (row) => {
  const { slider, range, number, pin, element } = row;
  const position = row.dragged ?? place(slider, slider.value);
  const value = row.dragged === null ? slider.value : valueAt(slider, row.dragged);
  const now = JSON.stringify([position, value, slider.fixed, slider.value === slider.start, row.typing, document.activeElement === number]);
  if (now === row.painted) return;
  row.painted = now;
  if (Number(range.value) !== position) range.value = position;
  range.style.setProperty("--at", `${position / STEPS * 100}%`);
  range.style.setProperty("--start", `${place(slider, slider.start) / STEPS * 100}%`);
  range.setAttribute("aria-valuetext", `${shown(value)} ${slider.unit}`.trim());
  if (document.activeElement !== number || !row.typing) number.value = shown(value);
  pin.setAttribute("aria-pressed", String(slider.fixed));
  element.classList.toggle("fixed", slider.fixed);
  element.classList.toggle("still", slider.value === slider.start);
};

let pressed = -Infinity;
const keyed = (row, event, way) => {
  if (!event.repeat && event.timeStamp - pressed > SERIES) newGesture();
  pressed = event.timeStamp;
  slide(row, (row.dragged ?? place(row.slider, row.slider.value)) + way);
};

const slide = (row, position) => {
  row.dragged = Math.min(STEPS, Math.max(0, position));
  paintRow(row);
  move(row.slider.name, valueAt(row.slider, row.dragged));
};

const makeRow = (slider, k) => {
  const id = `slider-${k}`;
  const range = made("input", { type: "range", id, min: 0, max: STEPS, step: 1, "aria-describedby": `${id}-tip` });
  const number = made("input", { type: "text", inputMode: "decimal", autocomplete: "off", spellcheck: false, "aria-label": `${slider.label}, ${slider.unit || "number"}` });
  const pin = made("button", { type: "button", className: "pin", title: "Fix: tuning does not change it (X)", "aria-label": `Fix ${slider.label}` }, icon("pin"));
  const reset = made("button", { type: "button", className: "reset", title: "Reset to the job's value (R)", "aria-label": `Reset ${slider.label}` }, icon("reset"));
  const label = made("label", { for: id, title: slider.tip }, slider.label);
  const unit = made("span", { className: "unit" }, slider.unit);
  range.title = "Shaded: all requirements are met, by their slopes; mark: the job's value";
  const tip = made("span", { hidden: true, id: `${id}-tip` }, slider.tip);
  const element = made("div", { className: "slider", "data-slider": slider.name }, label, range, number, unit, pin, reset, tip);
  // What moves along is fixed where it is.
  pin.disabled = slider.group === "main";
  const row = { slider, element, range, number, pin, reset, dragged: null, typing: false, painted: "" };

  range.addEventListener("pointerdown", newGesture);
  range.addEventListener("input", () => slide(row, Number(range.value)));
  range.addEventListener("keydown", (event) => {
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
    put(row.slider.name, Number.isFinite(value) ? value : number.value.slice(0, 40));
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
  pin.addEventListener("click", () => request("fix", { slider: row.slider.name, fixed: !row.slider.fixed }));
  reset.addEventListener("click", () => { row.dragged = null; request("reset", { slider: row.slider.name }); range.focus(); });
  for (const [enter, leave] of [["mouseenter", "mouseleave"], ["focusin", "focusout"]]) {
    element.addEventListener(enter, () => near(slider.name, true));
    element.addEventListener(leave, () => near(slider.name, false));
  }
  return row;
};

const build = (sliders, parts) => {
  const focused = document.activeElement?.closest?.("[data-slider]")?.dataset.slider;
  rows.clear();
  const groups = new Map();
  for (const [k, slider] of sliders.entries()) {
    const row = makeRow(slider, k);
    rows.set(slider.name, row);
    // A section that was added stands under its own name, beside which it is removed.
    const group = slider.part ? `part ${slider.part}` : slider.group;
    if (!groups.has(group)) groups.set(group, []);
    groups.get(group).push(row.element);
  }
  const section = (group) => {
    const part = parts.find((one) => `part ${one.name}` === group);
    if (!part) return [GROUPS[group] ?? group];
    const remove = made("button", { type: "button", className: "remove", title: "Remove this section" , "aria-label": `Remove ${part.label}`}, "Remove");
    remove.addEventListener("click", () => request("part", { part: part.name, on: false }));
    return [part.label, remove];
  };
  // The options of a method that designs are for experts: each move of one is a new design.
  const fieldsets = [...groups].map(([group, elements]) => made("fieldset", { "data-group": group }, ...(group === "design"
    ? [made("details", { open: designOpen, ontoggle: (event) => { designOpen = event.target.open; } }, made("summary", {}, "Advanced: options of the method"), ...elements)]
    : [made("legend", {}, ...section(group)), ...elements])));
  const off = parts.filter((part) => !part.on);
  if (off.length) {
    const buttons = off.map((part) => {
      const button = made("button", { type: "button", title: part.tip, "aria-label": `Add ${part.label}` }, `+ ${part.label}`);
      button.addEventListener("click", () => request("part", { part: part.name, on: true }));
      return button;
    });
    fieldsets.push(made("fieldset", { className: "parts" }, made("legend", {}, "Add a section", ...buttons)));
  }
  // Who has the two main sliders need not see the others.
  const main = fieldsets.filter((one) => one.dataset.group === "main");
  const rest = main.length === 0 ? fieldsets : [...main, made("details", { className: "all", open: allOpen, ontoggle: (event) => { allOpen = event.target.open; } },
    made("summary", {}, "All options"), ...fieldsets.filter((one) => one.dataset.group !== "main"))];
  byId("sliders").replaceChildren(...rest);
  if (focused && rows.has(focused)) rows.get(focused).range.focus();
};

// Where all requirements are met, as far as their slopes tell: none is marked where one is missed now.
const FARTHEST = 0.3;
const admissible = ({ sliders, ratios, share, change }) => {
  for (const [k, name] of sliders.entries()) {
    const row = rows.get(name);
    if (!row || !row.slider.value) continue;
    let low = -FARTHEST, high = FARTHEST;
    for (const [r, changes] of Object.values(change).entries()) {
      const slope = typeof changes[k] === "number" ? changes[k] / share : changes[k] === null ? 0 : Infinity;
      const room = 1 - ratios[r];
      if (!(room >= 0)) { low = high = 0; break; }
      if (slope > 0) high = Math.min(high, room / slope);
      if (slope < 0) low = Math.max(low, room / slope);
    }
    const at = (share) => Math.min(100, Math.max(0, place(row.slider, row.slider.value * (1 + share)) / STEPS * 100));
    row.range.style.setProperty("--from", `${at(low)}%`);
    row.range.style.setProperty("--to", `${at(high)}%`);
  }
};
on("influence", admissible);

on("sliders", (sliders, message) => {
  const parts = message.parts ?? [];
  const now = JSON.stringify([sliders.map((one) => [one.name, one.label, one.unit, one.group]), parts]);
  if (now !== structure) {
    structure = now;
    build(sliders, parts);
  }
  for (const slider of sliders) {
    const row = rows.get(slider.name);
    row.slider = slider;
    if (message.line?.kind === "error") row.painted = "";
    // A slider that is being moved stays under the hand: its newest move is still on its way.
    if (!pending(slider.name) && settled(message.n)) row.dragged = null;
    paintRow(row);
  }
});
