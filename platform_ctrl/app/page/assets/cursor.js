// One frequency cursor: where the mouse is over a frequency axis, the same frequency is marked in the Nichols plot and
// as an arc in the root locus. Nothing of it goes to the server.
const FIGURES = ["bode-figure-0", "bode-figure-1", "bode-figure-2", "bode-figure-3", "bode-figure-4", "Omega-figure-2"];
const quiet = { sync: false };

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

// Of BokehJS's document, once it is there.
export const follow = (bokeh) => {
  const [loop, nichols, locus, ...figures] = ["loop", "cursor_nichols", "cursor_locus", ...FIGURES].map((name) => bokeh.get_model_by_name(name));
  const spans = figures.flatMap((one) => one.center.filter((line) => line.name === "cursor"));
  let shown = null, waiting = false;
  const draw = () => {
    waiting = false;
    const f = shown, { frequency, gain, phase } = loop.data;
    for (const span of spans) span.setv({ location: f }, quiet);
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
  for (const one of figures) {
    // While something is computed its own plots move enough.
    one.on_event("mousemove", ({ x }) => { if (window.page.settled()) show(x); });
    one.on_event("mouseleave", () => show(null));
  }
};
