// One frequency cursor: where the mouse is over a frequency axis, the same frequency is marked in the Nichols plot and
// as an arc in the root locus. Nothing of it goes to the server.
import { byId } from "./messages.js";

const quiet = { sync: false };
const models = () => [...window.Bokeh.documents[0]._all_models.values()];
const named = (name) => models().find((one) => one.name === name);
const every = (view) => [view, ...[...view.children()].flatMap(every)];

let found = null;
const parts = () => {
  found ??= {
    views: [...window.Bokeh.index.roots ?? window.Bokeh.index].flatMap(every).filter((one) => one.model.type === "Figure" && one.model.x_scale?.type === "LogScale"),
    loop: named("loop"), nichols: named("cursor_nichols"), locus: named("cursor_locus"), spans: models().filter((one) => one.name === "cursor"),
  };
  return found;
};

const between = (xs, ys, x) => {
  let low = 0, high = xs.length - 1;
  if (!(high > 0) || x < xs[0] || x > xs[high]) return NaN;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (xs[middle] <= x) low = middle; else high = middle;
  }
  const share = Math.log(x / xs[low]) / Math.log(xs[high] / xs[low]);
  return ys[low] + share * (ys[high] - ys[low]);
};

let shown = null, waiting = false;
const draw = () => {
  waiting = false;
  const { loop, nichols, locus, spans } = parts();
  const f = shown;
  for (const span of spans) span.setv({ location: f }, quiet);
  if (!loop || !nichols || !locus) return;
  const { frequency, gain, phase } = loop.data;
  nichols.setv({ data: f === null ? { phase: [], gain: [] } : { phase: [between(frequency, phase, f)], gain: [between(frequency, gain, f)] } }, quiet);
  const turns = f === null ? [] : Array.from({ length: 61 }, (_, k) => Math.PI * (0.5 + k / 60));
  locus.setv({ data: { re: turns.map((t) => 2 * Math.PI * f * Math.cos(t)), im: turns.map((t) => 2 * Math.PI * f * Math.sin(t)) } }, quiet);
};
const show = (f) => {
  if (f === shown) return;
  shown = f;
  if (!waiting) requestAnimationFrame(draw);
  waiting = true;
};

byId("plots").addEventListener("pointermove", (event) => {
  // While something is dragged its own plots move enough.
  if (event.buttons || !window.page?.settled()) return;
  for (const view of parts().views) {
    const box = view.canvas_view?.el.getBoundingClientRect();
    if (!box || !view.model.visible) continue;
    const x = event.clientX - box.left, y = event.clientY - box.top, frame = view.frame.bbox;
    if (x < frame.left || x > frame.right || y < frame.top || y > frame.bottom) continue;
    show(view.frame.x_scale.invert(x));
    return;
  }
  show(null);
}, { passive: true });
byId("plots").addEventListener("pointerleave", () => show(null));
