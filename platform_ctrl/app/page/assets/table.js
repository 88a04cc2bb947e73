// The requirements: required value, actual value, margin, and which way each slider would help.
import { byId, dress, made, on, percent, put, request, shown, typed, write } from "./messages.js";
import { near, rows } from "./sliders.js";

const KEY = "Arrows: which way to move a slider to help. Colour: how much 5 % of it changes; empty: next to nothing.";
const LEAST = 0.002, MOST = 0.1;
let influence = null;

const bar = () => {
  const fill = made("span", { className: "fill" });
  return [made("span", { className: "track" }, fill), fill];
};

const paintBar = (row, one) => {
  const share = one.margin;
  // Roots, so that the last per cent before a limit can be seen.
  const margin = Math.sign(share ?? -1) * Math.sqrt(Math.min(1, Math.abs(share ?? 1)));
  const place = `left: ${(margin >= 0 ? 50 : 50 + 50 * margin).toFixed(1)}%; width: ${Math.max(0.8, 50 * Math.abs(margin)).toFixed(1)}%`;
  if (row.place === place) return;
  row.place = place;
  row.fill.style.cssText = place;
};

const paintCell = (element, name, slider, change) => {
  const rises = change === "inf" || change > 0;
  const size = change === "inf" ? MOST : Math.abs(change ?? 0);
  // The arrow says which way to move the slider to help.
  write(element, size < LEAST ? "" : rises ? "↓" : "↑");
  const strength = 0.1 + 0.5 * Math.min(1, Math.log(size / LEAST) / Math.log(MOST / LEAST));
  element.style.background = size < LEAST ? "" : `rgba(var(--${rises ? "down" : "up"}), ${strength.toFixed(3)})`;
  const words = change === "inf" ? "the loop becomes unstable"
    : size < LEAST ? `${name}: next to nothing` : `${name}: ${rises ? "worse" : "better"} by ${shown(100 * size, 2)} % in the ratio to its limit`;
  element.title = change === null || change === undefined ? "" : `${slider.label} + 5 %: ${words}`;
};

// A limit that may be edited: its words, and while it is edited its number in the units of the job file.
const limitCell = (one) => {
  const field = made("input", { type: "text", inputMode: "decimal", autocomplete: "off", size: one.required.length, "aria-label": `Limit of ${one.name}`, title: "The limit, in the units of the job file; Enter takes it" });
  const row = { key: one.key, limit: one.limit, field, words: one.required };
  field.addEventListener("focus", () => { field.value = row.limit; field.select(); });
  field.addEventListener("blur", () => { field.value = row.words; });
  field.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" && event.key !== "Escape") return;
    const number = typed(field.value);
    if (event.key === "Enter" && number !== row.limit) request("limit", { key: row.key, number: Number.isFinite(number) ? number : field.value.slice(0, 40) });
    field.blur();
  });
  return row;
};

let structure = "", body = [];
const buildTable = (requirements, sliders) => {
  const table = document.querySelector("#requirements table");
  table.tHead.replaceChildren(made("tr", {},
    made("th", { scope: "col", "aria-label": "Requirement" }, made("span", { className: "key", id: "requirements-key" }, KEY), "Requirement"), made("th", { scope: "col", className: "number" }, "required"),
    made("th", { scope: "col", className: "number" }, "value"), made("th", { scope: "col", className: "number" }, "margin"), made("th", { "aria-hidden": true }),
    ...sliders.map((slider) => made("th", { scope: "col", className: "slider-name", "data-slider": slider.name, title: slider.label }, made("span", {}, slider.label))),
    made("th", { className: "rest", "aria-hidden": true })));
  body = requirements.map((one) => {
    const [track, fill] = bar();
    const row = {
      track, fill, place: "",
      required: made("td", { className: "number" }), edited: one.key ? limitCell(one) : null, reached: made("td", { className: "number value" }), left: made("td", { className: "number left" }),
      cells: sliders.map((slider) => made("td", { className: "cell", "data-slider": slider.name })),
    };
    row.element = made("tr", {}, made("th", { scope: "row", title: `${one.full} (${one.method})` }, one.name), row.required, row.reached, row.left,
      made("td", { className: "bar", "aria-hidden": true }, track), ...row.cells, made("td", { className: "rest", "aria-hidden": true }));
    if (row.edited) row.required.append(row.edited.field);
    else row.required.title = "No job file states it: every loop has to be stable";
    return row;
  });
  table.tBodies[0].replaceChildren(...body.map((row) => row.element));
};

// The tightest first, as they were when the sliders last rested: nothing jumps while one moves.
let own = [], budget = [], requirements = [], order = new Map();
const room = (one) => (one.hard ? 0 : 1e9) + (one.passed ? one.margin ?? 1e6 : (one.margin ?? 0) - 1e6);
const sort = () => { order = new Map([...own, ...budget].sort((a, b) => room(a) - room(b)).map((one, k) => [one.full, k])); };
const paintTable = () => {
  if ([...own, ...budget].some((one) => !order.has(one.full))) sort();
  requirements = [...own, ...budget].sort((a, b) => order.get(a.full) - order.get(b.full));
  const sliders = [...rows.values()].map((row) => row.slider);
  const now = JSON.stringify([sliders.map((slider) => slider.label), requirements.map((one) => one.full)]);
  const fresh = now !== structure;
  if (fresh) {
    structure = now;
    influence = null;
    buildTable(requirements, sliders);
  }
  for (const [r, one] of requirements.entries()) {
    const row = body[r];
    dress(row.element, `${one.passed ? "met" : "missed"}${one.hard ? "" : " goal"}`);
    if (row.edited) {
      Object.assign(row.edited, { limit: one.limit, words: one.required });
      if (document.activeElement !== row.edited.field) row.edited.field.value = one.required;
    } else write(row.required, one.required);
    const reached = `${one.passed ? "" : "✗ "}${one.reached}`;
    if (row.reached.textContent !== reached) {
      row.reached.textContent = reached;
      if (one.passed) row.reached.removeAttribute("aria-label");
      else row.reached.setAttribute("aria-label", `missed: ${one.reached}`);
    }
    write(row.left, percent(one.margin));
    paintBar(row, one);
  }
};

const paintInfluence = () => {
  const places = new Map(influence.sliders.map((name, k) => [name, k]));
  const sliders = [...rows.values()].map((row) => row.slider);
  for (const [r, one] of requirements.entries()) {
    const changes = influence.change[one.name] ?? [];
    for (const [k, slider] of sliders.entries()) paintCell(body[r].cells[k], one.name, slider, changes[places.get(slider.name)]);
  }
};

on("requirements", (given) => {
  own = given;
  paintTable();
  byId("requirements").classList.add("stale");
  // Of other settings another step is the next one.
  showStep({ words: "Working out the next step …" });
});
on("influence", (given) => {
  // The limits of the budget follow when the sliders rest.
  budget = given.budget;
  sort();
  paintTable();
  influence = given;
  paintInfluence();
  byId("requirements").classList.remove("stale");
  showStep(given.next);
});

let step = null;
const next = byId("next");
const showStep = (given) => {
  step = given;
  write(byId("step"), given.words);
  byId("apply").disabled = !given.slider;
};
byId("apply").addEventListener("click", () => put(step.slider, step.value));
for (const [enter, is] of [["mouseenter", true], ["mouseleave", false]]) {
  next.addEventListener(enter, () => { if (step?.slider) near(step.slider, is); });
}
for (const [type, is] of [["mouseover", true], ["mouseout", false]]) {
  byId("requirements").addEventListener(type, (event) => {
    const slider = event.target.closest?.("[data-slider]")?.dataset.slider;
    if (slider) near(slider, is);
  });
}
