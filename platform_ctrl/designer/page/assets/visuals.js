// BokehJS asks the browser for styles again and again while it paints: for a CSS variable behind every property of
// everything, which this page sets none of, and for the size of a font, which stays. Each question makes the browser
// bring the whole page up to date first, and together they take as long as the painting.
const loaded = (name) => window.Bokeh?.loader?.[name] ?? {};
const { VisualProperties } = loaded("core/visuals/visual");
if (VisualProperties) VisualProperties.prototype._get_css_value = () => "";

const { PlotView } = loaded("models/plots/plot_canvas");
const size = PlotView && Object.getOwnPropertyDescriptor(PlotView.prototype, "base_font_size")?.get;
if (size) {
  const known = new WeakMap();
  Object.defineProperty(PlotView.prototype, "base_font_size", {
    get() {
      if (!known.has(this)) known.set(this, size.call(this));
      return known.get(this);
    },
  });
}
