// The budget of the line of sight: whether its panels are shown, and the table of its sources.
import { byId, dress, made, on, percent, request, shown, write } from "./messages.js";
import { radios } from "./choices.js";

let view = "loop";
const paintView = byId("view") ? radios(byId("view"), (button) => showView(button.dataset.view)) : null;

export const showView = (now) => {
  if (now === view || !paintView) return;
  view = now;
  document.body.classList.toggle("budget", view === "budget");
  paintView((button) => button.dataset.view === view);
  request("view", { view });
};
paintView?.((button) => button.dataset.view === view);

let structure = "", rows = [], limits = [];

const cell = () => made("td", { className: "number" });
const row = (name, kind, count) => {
  const cells = Array.from({ length: count }, cell);
  return { cells, element: made("tr", { title: kind }, made("th", { scope: "row" }, name), ...cells) };
};

const build = (given) => {
  const table = byId("panel-budget").querySelector("table");
  table.tHead.replaceChildren(made("tr", {}, made("th", { scope: "col" }, "source"),
    ...given.axes.map((axis) => made("th", { scope: "col", className: "number" }, axis))));
  rows = [...given.rows.map((one) => row(one.name, one.kind, given.axes.length)), row("all, angles zero", "all together, at the angles zero; limits are at the worst angles of the job", given.axes.length)];
  rows.at(-1).element.className = "total";
  table.tBodies[0].replaceChildren(...rows.map((one) => one.element));
  limits = given.limits.map((one) => {
    const cells = [cell(), cell(), cell()];
    return { cells, element: made("tr", { title: `${one.full} (${one.method})` }, made("th", { scope: "row" }, one.name), ...cells) };
  });
  byId("budget-limits").closest("table").hidden = limits.length === 0;
  byId("budget-limits").replaceChildren(...limits.map((one) => one.element));
};

on("budget", (given) => {
  write(byId("budget-line"), given.line);
  const where = byId("panel-budget").querySelector(".where");
  write(where, given.axes.length && !given.exact ? "rms, µrad; not exact while sliders move" : "rms, µrad");
  where.title = given.line;
  byId("panel-budget").classList.toggle("stale", given.axes.length === 0);
  if (given.axes.length === 0) return;
  const now = JSON.stringify([given.axes, given.rows.map((one) => one.name), given.limits.map((one) => one.full)]);
  if (now !== structure) {
    structure = now;
    build(given);
  }
  for (const [k, one] of given.rows.entries()) {
    for (const [j, rms] of one.rms.entries()) {
      write(rows[k].cells[j], shown(rms, 3));
      rows[k].cells[j].title = `${shown(100 * one.share[j], 3)} % of the mean square`;
    }
  }
  for (const [j, rms] of given.total.entries()) write(rows.at(-1).cells[j], shown(rms, 4));
  for (const [k, one] of given.limits.entries()) {
    dress(limits[k].element, one.passed ? "met" : "missed");
    const texts = [`${one.passed ? "" : "✗ "}${shown(one.value, 4)}`, `≤ ${shown(one.limit, 4)}`, percent(one.margin)];
    for (const [j, text] of texts.entries()) write(limits[k].cells[j], text);
  }
  const words = given.friction.join("\n");
  if (byId("budget-friction").dataset.words !== words) {
    byId("budget-friction").dataset.words = words;
    byId("budget-friction").replaceChildren(...given.friction.map((line) => made("p", {}, line)));
  }
});
