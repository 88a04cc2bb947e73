// Three things that BokehJS does while it paints and that this page pays for at every move of a slider.
const loaded = (name) => window.Bokeh?.loader?.[name] ?? {};

// It asks the browser for a CSS variable behind every property of everything, of which this page sets none.
const { VisualProperties } = loaded("core/visuals/visual");
if (VisualProperties) VisualProperties.prototype._get_css_value = () => "";

// Everything that is painted writes its place into a style sheet first, also where that is what stands there: the
// browser judges all styles anew each time.
const { InlineStyleSheet } = loaded("core/dom");
if (InlineStyleSheet) {
  const write = InlineStyleSheet.prototype._update;
  InlineStyleSheet.prototype._update = function (css) {
    if (this.written !== css) write.call(this, css);
    this.written = css;
  };
}

// New data go into a curve step by step, and it may be painted between two of them: with more curves than colours, say,
// which ends in an error, and whatever came with the data is lost.
const { GlyphRendererView } = loaded("models/renderers/glyph_renderer");
if (GlyphRendererView) {
  const { set_data: fill, _paint: paint } = GlyphRendererView.prototype;
  GlyphRendererView.prototype.set_data = async function (...given) {
    this.filling = (this.filling ?? 0) + 1;
    await fill.apply(this, given).finally(() => { this.filling -= 1; });
  };
  GlyphRendererView.prototype._paint = function (context) {
    if (!this.filling) paint.call(this, context);
  };
}
