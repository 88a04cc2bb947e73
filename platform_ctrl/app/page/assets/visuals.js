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

// Of every curve BokehJS keeps four copies ready: selected, not selected, muted, and thinned out while one zooms. No
// plot here shows any of them, so new data need not go into them.
const { GlyphRendererView } = loaded("models/renderers/glyph_renderer");
if (GlyphRendererView) {
  const begin = GlyphRendererView.prototype.lazy_initialize;
  GlyphRendererView.prototype.lazy_initialize = async function () {
    await begin.call(this);
    const nothing = () => {};
    for (const copy of [this.selection_glyph, this.nonselection_glyph, this.muted_glyph, this.decimated_glyph]) {
      copy.set_data = copy.set_visuals = copy.map_data = nothing;
    }
  };
}

// Everything that is painted writes its place into a style sheet first, also where that is what stands there. The
// browser then judges all styles anew before it writes the next word on a canvas.
const { InlineStyleSheet } = loaded("core/dom");
if (InlineStyleSheet) {
  const write = InlineStyleSheet.prototype._update;
  InlineStyleSheet.prototype._update = function (css) {
    if (this.written === css) return;
    this.written = css;
    write.call(this, css);
  };
}

// New data go into a curve step by step, and BokehJS may paint between two of them: with more curves than colours, say,
// which ends in an error, and whatever came with the data is lost. A curve is painted once all of it is there.
if (GlyphRendererView) {
  const { set_data: fill, _paint: paint } = GlyphRendererView.prototype;
  GlyphRendererView.prototype.set_data = async function (...given) {
    this.filling = (this.filling ?? 0) + 1;
    try {
      await fill.apply(this, given);
    } finally {
      this.filling -= 1;
    }
  };
  GlyphRendererView.prototype._paint = function (context) {
    if (!this.filling) paint.call(this, context);
  };
}

// Where the focus is shows as everywhere on the page, and not after every click.
const { CanvasView } = loaded("models/canvas/canvas");
if (CanvasView) {
  const sheets = CanvasView.prototype.stylesheets;
  const own = ".bk-events:focus { outline: none; } .bk-events:focus-visible { outline: 2px solid var(--accent); outline-offset: -2px; }";
  CanvasView.prototype.stylesheets = function () { return [...sheets.call(this), own]; };
}

// A curve's element holds nothing: where it would stand need not be said whenever the curve moves.
if (GlyphRendererView) GlyphRendererView.prototype.update_position = () => {};

// Numbers at an axis that become a little wider make BokehJS lay the figure out anew, and tell the server its new size.
// Where the border has room for them nothing else moves.
if (PlotView) {
  const BORDERS = { left: "min_border_left", right: "min_border_right", above: "min_border_top", below: "min_border_bottom" };
  const crowded = (view) => view.model.side_panels.some((model) => {
    const { panel, layout } = view.renderer_views.get(model) ?? {};
    if (!layout?.has_size_changed()) return false;
    const extent = panel.is_horizontal ? "height" : "width", room = view.model[BORDERS[panel.side]] ?? 0;
    return layout.bbox[extent] > room || layout._content_size()[extent] > room;
  });
  const layOut = PlotView.prototype._invalidate_layout_if_needed;
  PlotView.prototype._invalidate_layout_if_needed = function () {
    if (this._needs_layout || crowded(this)) layOut.call(this);
  };
}

// BokehJS sorts all points of a curve into a tree whenever they change: to find those under the mouse and those in view,
// and for axes that follow their data by themselves. No axis here does, what is out of view the canvas leaves out, and
// for the mouse it is time when it asks.
if (PlotView) Object.defineProperty(PlotView.prototype, "auto_ranged_renderers", { get: () => [] });
const { GlyphView } = loaded("models/glyphs/glyph");
const { Indices } = loaded("core/types");
if (GlyphView && Indices) {
  const sort = GlyphView.prototype.index_data;
  GlyphView.prototype.index_data = function () { this._index = null; };
  Object.defineProperty(GlyphView.prototype, "index", {
    get() {
      if (this._index === null) sort.call(this);
      return this._index;
    },
  });
  GlyphView.prototype.mask_data = function () { return Indices.all_set(this.data_size); };
}
