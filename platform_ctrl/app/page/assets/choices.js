// What is shown: mode, loop, design, plant and the rest; verdict and margins.
import { request, byId, dress, lastRequest, made, on, shown, write } from "./messages.js";

const SELECTS = { loop: "loop", design: "design", channel: "channel", axis: "axis", plant: "plant" };

const fill = (select, options, value) => {
  const now = JSON.stringify(options);
  if (select.dataset.options !== now) {
    select.dataset.options = now;
    select.replaceChildren(...options.map((one) => made("option", { value: String(one.value ?? one) }, String(one.label ?? one))));
  }
  if (select.value !== String(value)) select.value = String(value);
  select.disabled = options.length < 2;
};

for (const [id, name] of Object.entries(SELECTS)) {
  byId(id).addEventListener("change", (event) => request("set", { name, value: name === "axis" ? Number(event.target.value) : event.target.value }));
}
byId("band").addEventListener("change", (event) => request("set", { name: "band", value: event.target.checked }));

// Buttons of which one is chosen: Tab reaches the chosen one, arrows go through them.
export const radios = (group, choose) => {
  const buttons = [...group.querySelectorAll("button")];
  const paint = (is) => {
    for (const button of buttons) {
      button.setAttribute("aria-checked", String(is(button)));
      button.tabIndex = is(button) ? 0 : -1;
    }
  };
  for (const [k, button] of buttons.entries()) {
    button.addEventListener("click", () => choose(button));
    button.addEventListener("keydown", (event) => {
      const way = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!way) return;
      const next = buttons[(k + way + buttons.length) % buttons.length];
      next.focus();
      choose(next);
      event.preventDefault();
    });
  }
  return paint;
};
const paintMode = radios(byId("mode"), (button) => request("set", { name: "mode", value: button.dataset.mode }));
const paintTheme = radios(byId("theme"), (button) => window.pageTheme.choose(button.dataset.themeChoice));
export const themeChanged = () => {
  paintTheme((button) => button.dataset.themeChoice === window.pageTheme.choice());
  request("dark", { dark: window.pageTheme.isDark() });
};
window.pageTheme.onChange(themeChanged);

let state = null, overlays = "";
// The address follows once nothing moves: browsers allow it to change only so often.
const REST = 150;
let resting = 0;
const showLink = () => {
  clearTimeout(resting);
  resting = setTimeout(() => {
    const address = new URL(location);
    if (state.link) address.searchParams.set("state", state.link);
    else address.searchParams.delete("state");
    if (address.href !== location.href) history.replaceState(null, "", address);
  }, REST);
};
export const shownState = () => state;
on("state", (given, { n }) => {
  state = given;
  paintMode((button) => button.dataset.mode === given.mode);
  // A single one is no choice.
  byId("mode").hidden = given.choices.mode.length < 2;
  for (const button of byId("mode").children) button.disabled = !given.choices.mode.includes(button.dataset.mode);
  for (const [id, name] of Object.entries(SELECTS)) fill(byId(id), given.choices[name], given[name]);
  byId("band").checked = given.band;
  // The chosen manoeuvre is the page's own.
  const runs = given.choices.manoeuvre, all = runs.length > 1 ? [{ value: "", label: `all ${runs.length} runs` }] : [];
  const list = byId("manoeuvre");
  fill(list, [...runs, ...all], list.options.length ? list.value : given.manoeuvre);
  byId("simulate").disabled = given.choices.manoeuvre.length === 0;
  byId("undo").disabled = !given.undo;
  byId("redo").disabled = !given.redo;
  byId("tune").disabled = !given.tunable;
  byId("compared").hidden = given.choices.overlays.length === 0;
  showLink();
  const now = JSON.stringify(given.choices.overlays);
  if (now !== overlays) {
    overlays = now;
    byId("overlays").replaceChildren(...given.choices.overlays.map(overlayRow));
  }
  for (const box of byId("overlays").querySelectorAll("input")) {
    if (n >= Number(box.dataset.request)) box.checked = given.overlays.includes(box.value);
  }
});

// Each box is one request: an answer to an earlier one neither unchecks it nor decides what the next one sends.
const overlayRow = ({ design, method }) => {
  const box = made("input", { type: "checkbox", value: design, "data-request": 0 });
  box.addEventListener("change", () => {
    request("overlay", { design, on: box.checked });
    box.dataset.request = lastRequest();
  });
  return made("li", {}, made("label", { title: `${method}; drawn over every plot once it is designed` }, box, made("span", {}, design)));
};

let figures = "", cells = [];
on("bar", (given) => {
  const verdict = byId("verdict");
  dress(verdict, `verdict ${given.verdict}`);
  write(verdict.querySelector(".mark"), { good: "✓", bad: "✗" }[given.verdict] ?? "");
  const words = verdict.querySelector(".words");
  if (words.childElementCount === 0) words.replaceChildren(made("span"), made("small"));
  write(words.firstChild, given.words);
  write(words.lastChild, given.more);
  words.lastChild.title = given.more;
  const now = JSON.stringify(given.figures.map((one) => [one.label, one.unit]));
  if (now !== figures) {
    figures = now;
    cells = given.figures.map((one) => {
      const number = made("span");
      return { number, element: made("div", {}, made("dt", {}, one.label), made("dd", {}, number, made("small", {}, one.unit))) };
    });
    byId("figures").replaceChildren(...cells.map((cell) => cell.element));
  }
  for (const [k, one] of given.figures.entries()) {
    write(cells[k].number, typeof one.value === "string" && one.value !== "inf" ? one.value : shown(one.value, 3));
    dress(cells[k].element, one.bad ? "bad" : "");
    if (cells[k].element.title !== one.tip) cells[k].element.title = one.tip;
  }
  write(byId("elapsed"), given.elapsed);
});

on("line", (given) => {
  const line = byId("line");
  write(line, given?.text ?? "");
  if (line.title !== line.textContent) line.title = line.textContent;
  dress(line, given?.kind ?? "");
});
on("busy", (given) => {
  byId("busy").hidden = given === null;
  if (given === null) return;
  byId("busy").querySelector(".words").textContent = given.text;
});
