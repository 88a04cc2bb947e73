// The next step with its preview, and the snapshots A, B and C.
import { byId, icon, made, on, request, write } from "./messages.js";
import { near } from "./sliders.js";

let step = null;
const next = byId("next");
const [moveLine, gainLine, costLine] = next.querySelectorAll("p");

on("next", (given) => {
  step = given;
  next.classList.remove("stale");
  for (const [line, text] of [[moveLine, given.move], [gainLine, given.gain], [costLine, given.cost]]) {
    write(line, text);
    if (line.title !== text) line.title = text;
  }
  byId("preview").disabled = byId("apply").disabled = !given.slider;
});
for (const [enter, is] of [["mouseenter", true], ["mouseleave", false]]) {
  next.addEventListener(enter, () => { if (step?.slider) near(step.slider, is); });
}

const act = (name, what) => () => request("snapshot", { name, act: what });
const row = (one) => {
  const box = made("input", { type: "checkbox", checked: one.drawn, "aria-label": `Draw snapshot ${one.name}` });
  box.addEventListener("change", () => act(one.name, box.checked ? "draw" : "hide")());
  const back = made("button", { type: "button", title: `Return to snapshot ${one.name}`, "aria-label": `Return to snapshot ${one.name}` }, icon("reset"));
  const away = made("button", { type: "button", title: `Remove snapshot ${one.name}`, "aria-label": `Remove snapshot ${one.name}` }, icon("close"));
  back.addEventListener("click", act(one.name, "restore"));
  away.addEventListener("click", act(one.name, "remove"));
  return made("li", {}, made("label", { title: `${one.design}; draw its curves over the plots` }, box, made("b", {}, one.name)), back, away);
};

let snapshots = "", link = "";
on("state", (given) => {
  const now = JSON.stringify(given.pinned.map((one) => [one.name, one.design, one.drawn]));
  if (now !== snapshots) {
    snapshots = now;
    const focused = document.activeElement?.getAttribute?.("aria-label");
    byId("snapshots").replaceChildren(...given.pinned.map(row));
    if (focused) byId("snapshots").querySelector(`[aria-label="${CSS.escape(focused)}"]`)?.focus();
  }
  byId("pin").disabled = given.free === "";
  byId("preview").setAttribute("aria-pressed", String(given.previewed));
  // Of other settings another step is the next one.
  if (given.link !== link) next.classList.add("stale");
  link = given.link;
});
