// The whole job: a line about all of its requirements, and a chip for each part, which leads there.
import { byId, dress, made, on, percent, request, write } from "./messages.js";

import { showView } from "./budget.js";

const MARKS = { good: "✓", bad: "✗", open: "·" };
const SAID = { good: ", met, ", bad: ", missed, ", open: ", " };
let structure = "", chips = [];

const go = ({ loop, panel, key }) => {
  if (loop) {
    if (byId("view")) showView("loop");
    if (loop !== byId("loop").value) request("set", { name: "loop", value: loop });
    return;
  }
  if (byId("view")) showView(panel === "budget" ? "budget" : "loop");
  const place = byId(`panel-${panel}`);
  place.scrollIntoView({ block: "nearest" });
  // All runs are one choice of the list of manoeuvres.
  if (key === "runs" && byId("manoeuvre").options.length > 1) byId("manoeuvre").value = "";
  (key === "runs" ? byId("simulate") : place.querySelector("button"))?.focus();
};

const build = (given) => {
  chips = given.map((one) => {
    const chip = { mark: made("span", { className: "mark", "aria-hidden": "true" }), said: made("span", { className: "unseen" }), margin: made("span", { className: "margin" }), data: one };
    chip.element = made("button", { type: "button" }, chip.mark, made("span", { className: "label" }, one.label), chip.said, chip.margin);
    chip.element.addEventListener("click", () => go(chip.data));
    return chip;
  });
  byId("strip").querySelector(".chips").replaceChildren(...chips.map((chip) => chip.element));
};

on("strip", (given) => {
  const now = JSON.stringify(given.chips.map((one) => [one.key, one.label]));
  if (now !== structure) {
    structure = now;
    build(given.chips);
  }
  const whole = byId("strip").querySelector(".whole");
  dress(whole, `whole ${given.verdict}`);
  write(whole, given.words);
  for (const [k, one] of given.chips.entries()) {
    const chip = chips[k];
    chip.data = one;
    if (one.shown !== (chip.element.getAttribute("aria-current") === "true")) chip.element.setAttribute("aria-current", String(one.shown));
    // What is being measured keeps what it said, dimmed: nothing flickers while a slider moves.
    chip.element.classList.toggle("stale", one.measuring);
    if (one.measuring && chip.margin.textContent) continue;
    for (const verdict of Object.keys(MARKS)) chip.element.classList.toggle(verdict, verdict === one.verdict);
    write(chip.mark, MARKS[one.verdict]);
    write(chip.said, SAID[one.verdict]);
    write(chip.margin, one.margin === null ? one.short : percent(one.margin));
    if (chip.element.title !== one.words) chip.element.title = one.words;
  }
});
