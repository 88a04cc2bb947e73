// From robust to fast along precomputed designs.
import { byId, on, request, settled, write } from "./messages.js";

const range = byId("speed");
let stops = [];
const say = (words) => {
  write(byId("speed-words"), words);
  byId("speed-words").title = words;
  range.setAttribute("aria-valuetext", words);
};
const paint = () => range.style.setProperty("--at", `${Number(range.value) / Number(range.max) * 100}%`);
range.addEventListener("input", () => {
  const stop = stops[Number(range.value)];
  if (!stop) return;
  say(stop.words);
  paint();
  request("point", { k: stop.k });
});
byId("precompute").addEventListener("click", () => request("precompute"));
on("state", ({ trade_off: given }, message) => {
  byId("trade-off").hidden = given === null;
  if (given === null) return;
  stops = given.stops;
  range.max = Math.max(1, stops.length - 1);
  // A slider with one design alone would invite a move that cannot act.
  range.disabled = stops.length < 2;
  byId("precompute").disabled = !given.missing;
  byId("precompute").hidden = !given.missing;
  // While moves are on their way it stays under the hand.
  if (given.at >= 0 && settled(message.n)) range.value = given.at;
  paint();
  write(byId("speed-line"), given.line);
  byId("speed-line").title = given.line;
  say(given.words);
});
