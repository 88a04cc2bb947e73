// The requirements: what is asked, what is reached, how much is left, and which way each slider would help.
import { byId, made, on, shown } from "./wire.js";
import { near, rows } from "./sliders.js";

const KEY = "Arrows: which way to move a slider to help. Colour: how much 5 % of it changes; empty: next to nothing.";
const LEAST = 0.002, MOST = 0.1;
// What is left of a limit, signed; a missed one is below zero.
const left = (one) => (one.ratio === null ? null : 1 - one.ratio);
const percent = (share) => (share === null ? "–" : `${share < 0 ? "−" : "+"}${shown(Math.min(999, 100 * Math.abs(share)), Math.abs(share) < 0.1 ? 2 : 3)} %`);
let influence = null;

const bar = (one) => {
  // Roots, so that the last per cent before a limit can be seen.
  const margin = Math.sign(left(one) ?? -1) * Math.sqrt(Math.min(1, Math.abs(left(one) ?? 1)));
  const fill = made("span", { className: "fill" });
  fill.style.left = `${margin >= 0 ? 50 : 50 + 50 * margin}%`;
  fill.style.width = `${Math.max(0.8, 50 * Math.abs(margin))}%`;
  return made("span", { className: "track", role: "img", "aria-label": left(one) === null ? "missed" : `${percent(left(one))} left` }, fill);
};

const cell = (one, knob, change) => {
  const element = made("td", { className: "cell", "data-knob": knob.name });
  if (change === null || change === undefined) return element;
  const rises = change === "inf" || change > 0;
  const size = change === "inf" ? MOST : Math.abs(change);
  const words = change === "inf" ? "the loop becomes unstable" : `${one.name}: ${rises ? "worse" : "better"} by ${shown(100 * size, 2)} % of the limit`;
  element.title = `${knob.label} + 5 %: ${words}`;
  if (size < LEAST) return element;
  // The arrow says which way to move the slider to help.
  element.append(rises ? "↓" : "↑");
  const strength = 0.1 + 0.5 * Math.min(1, Math.log(size / LEAST) / Math.log(MOST / LEAST));
  element.style.background = `rgba(var(--${rises ? "down" : "up"}), ${strength.toFixed(3)})`;
  return element;
};

const paintTable = (requirements) => {
  const table = document.querySelector("#requirements table");
  const knobs = [...rows.values()].map((row) => row.knob);
  const places = new Map((influence?.knobs ?? []).map((name, k) => [name, k]));
  const head = made("tr", {},
    made("th", { scope: "col" }, made("span", { className: "key" }, KEY), "Requirement"), made("th", { scope: "col", className: "number" }, "asked"),
    made("th", { scope: "col", className: "number" }, "reached"), made("th", { scope: "col", className: "number" }, "left"), made("th", { scope: "col" }),
    ...knobs.map((knob) => made("th", { scope: "col", className: "knob-name", "data-knob": knob.name, title: knob.label }, made("span", {}, knob.label))),
    made("th", { className: "rest" }));
  table.tHead.replaceChildren(head);
  const body = requirements.map((one, r) => {
    const changes = influence?.change[one.name] ?? [];
    return made("tr", { className: `${one.passed ? "met" : "missed"}${one.hard ? "" : " goal"}` },
      made("th", { scope: "row", title: one.full }, one.name),
      made("td", { className: "number" }, one.asked),
      made("td", { className: "number value" }, `${one.passed ? "" : "✗ "}${one.reached}`),
      made("td", { className: "number left" }, percent(left(one))), made("td", { className: "bar" }, bar(one)),
      ...knobs.map((knob) => cell(one, knob, changes[places.get(knob.name)])),
      made("td", { className: "rest" }));
  });
  table.tBodies[0].replaceChildren(...body);
};

let requirements = [];
on("requirements", (given) => {
  requirements = given;
  byId("requirements").classList.add("stale");
  paintTable(requirements);
});
on("influence", (given) => {
  influence = given;
  byId("requirements").classList.toggle("stale", given === null);
  paintTable(requirements);
});
for (const [type, is] of [["mouseover", true], ["mouseout", false]]) {
  byId("requirements").addEventListener(type, (event) => {
    const knob = event.target.closest?.("[data-knob]")?.dataset.knob;
    if (knob) near(knob, is);
  });
}
