"""A panel of the page: a heading in HTML, one or two figures below it, all in the page's colours and type."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.events import DoubleTap
from bokeh.models import (
    AdaptiveTicker,
    BasicTickFormatter,
    Column,
    CrosshairTool,
    HoverTool,
    InlineStyleSheet,
    LinearAxis,
    LogAxis,
    LogTicker,
    LogTickFormatter,
    Model,
    Node,
    NoOverlap,
    PanTool,
    ResetTool,
    Row,
    WheelZoomTool,
)
from bokeh.models.annotations.geometry import BoxAnnotation, Span
from bokeh.models.annotations.labels import Label
from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.markups import Div
from bokeh.plotting import figure

from platform_ctrl.app.pictures import Drawing, Overlay
from platform_ctrl.app.plots.data import (
    FONT,
    HZ,
    LIMIT_DASHES,
    NORMAL,
    SMALL,
    Sources,
    View,
    assign,
    colours,
    column,
    dashes,
    decibels,
    inner_size,
    series,
)
from platform_ctrl.common.values import FloatArray

# Key of a curve: words, role of its colour, dashes, width.
Key = tuple[str, str, Sequence[int], float]
# A curve: name, role of its colour, dashes, and the columns x and y.
Curve = tuple[str, str, Sequence[int], Any, Any]

# More keys than this are written closer together.
_FEW = 5
# Steps between ticks, times powers of 360 degrees, or of 10 dB: a phase is read in parts of a turn.
_TURNS, _DECIBELS = (1.0, 2.0, 5.0, 15.0, 45.0, 90.0, 180.0), (1.0, 2.0, 4.0)
# Least distance of the numbers at an axis, pixels.
_APART = 2
# Height of the numbers and the label below a figure, pixels.
_BELOW = 28
_LEFT, _RIGHT, _TOP = 54, 12, 7
# Height of a frame, pixels, below which a unit has to be written smaller, a short one and one of more characters than
# that: early enough that it never reaches the edge of the canvas, where Bokeh leaves the last half of a pixel.
_LOW, _SHORT, _LOW_OF_LONG = 64.0, 8, 100.0

_HEADING = f"""
.line {{ display: flex; gap: 10px; white-space: nowrap; overflow: hidden; font: {NORMAL}/18px {FONT};
  font-variant-numeric: tabular-nums; }}
.bk-clearfix {{ display: block; max-width: 100%; }} .title {{ font-weight: 650; flex: none; }}
.detail {{ min-width: 0; overflow: hidden; text-overflow: ellipsis; }}
.keys {{ position: relative; font-size: {SMALL}; gap: 14px; height: 16px; line-height: 16px; }}
.keys span {{ flex: none; }}
.keys {{ mask: linear-gradient(to right, #000 calc(100% - 16px), transparent); }}
.keys.many {{ gap: 8px; }} .keys.many svg {{ width: 10px; margin-right: 3px; }}
.keys svg {{ width: 22px; height: 8px; margin-right: 5px; overflow: visible; vertical-align: 0; }}
"""

_BUTTON = """
:host {{ flex: none; }}
.bk-btn {{ padding: 0 7px; height: 18px; line-height: 16px; border: 1px solid transparent; border-radius: 3px;
  background: transparent; color: {muted}; font: {small} {font}; box-shadow: none; cursor: pointer; }}
.bk-btn:hover, .bk-btn:focus-visible {{ border-color: {frame}; background: transparent; color: {ink}; }}
.bk-btn:focus, .bk-btn:active {{ outline: none; }}
.bk-btn:focus-visible {{ outline: 2px solid var(--accent, currentColor); outline-offset: 1px; }}
.bk-btn.bk-active {{ border-color: {frame}; background: {panel}; color: {ink}; }}
"""


_TIP = """
:host {{ background-color: {page}; color: {ink}; border: 1px solid {frame}; border-radius: 3px; padding: 4px 8px;
  opacity: 1; }}
.tip {{ display: grid; grid-template-columns: auto auto; gap: 0 10px; font: {small}/16px {font};
  font-variant-numeric: tabular-nums; }}
.word {{ color: {muted}; }} .number {{ text-align: right; }}
"""


class Theme:
    """The colour of each property of each model by role, so that all can change in place."""

    def __init__(self, dark: bool) -> None:
        self.colours = colours(dark)
        self._properties: list[tuple[Model, str, str]] = []
        self._texts: list[tuple[Model, str, str]] = []

    def paint(self, model: Model, **roles: str) -> None:
        """Give properties of a model the colours of their roles, now and after every change of the theme."""
        for name, role in roles.items():
            self._properties.append((model, name, role))
            setattr(model, name, self.colours[role])

    def sheet(self, css: str) -> InlineStyleSheet:
        """Return a style sheet in which ``{role}`` stands for a colour of the theme."""
        out = InlineStyleSheet()
        self.text(out, "css", css)
        return out

    def text(self, model: Model, name: str, text: str) -> None:
        """Give a property a text in which ``{role}`` stands for a colour of the theme."""
        self._texts.append((model, name, text))
        setattr(model, name, self._filled(text))

    def change(self, dark: bool) -> None:
        """Switch everything that was painted."""
        self.colours = colours(dark)
        for model, name, role in self._properties:
            setattr(model, name, self.colours[role])
        for model, name, text in self._texts:
            setattr(model, name, self._filled(text))

    def _filled(self, text: str) -> str:
        names = {name.replace("-", "_"): colour for name, colour in self.colours.items()}
        return text.format(small=SMALL, font=FONT, **names)


class Panel:
    """Heading, keys of the curves, reset button, and one or two figures below.

    A plot is a subclass: its constructor adds figures and draws on empty sources, `show` fills the sources.
    """

    def __init__(self, name: str, title: str, theme: Theme, sources: Sources) -> None:
        self.name, self._title, self.theme, self.sources = name, title, theme, sources
        self.views: list[View] = []
        self._plots: list[Any] = []
        self._messages: list[Any] = []
        self._detail = self._curves = ""
        colour = theme.sheet(":host {{ color: {ink}; }} .detail, .keys {{ color: {muted}; }}")
        common: dict[str, Any] = {
            "sizing_mode": "stretch_width",
            "tags": ["heading"],
            "margin": 0,
            "styles": {"min-width": "0", "overflow": "hidden"},
            "stylesheets": [InlineStyleSheet(css=_HEADING), colour],
        }
        self._head, self._keys = Div(height=18, **common), Div(height=16, **common)
        self._reset = self.button("reset", f"{name}-reset")
        self._reset.update(visible=False)
        self._reset.on_click(self.reset)
        self.row: Any = Row(
            children=[self._head, self._reset], sizing_mode="stretch_width", margin=(0, 20, 0, 0), spacing=4
        )
        self.layout: Any = Column(
            children=[self.row, self._keys],
            sizing_mode="stretch_both",
            margin=0,
            spacing=2,
            name=name,
            css_classes=[f"plot-{name}"],
        )
        self.heading("")
        self.keys([])

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        raise NotImplementedError

    @property
    def caption(self) -> str:
        """What the panel shows, for a screen reader: what of, the axes, the curves, what is wrong."""
        shown = [one for one in self._plots if one.visible]
        axes = [one for one in (shown[0].yaxis[0].axis_label, shown[-1].xaxis[0].axis_label) if one] if shown else []
        said = [one.text for one in self._messages if one.visible]
        return "; ".join(filter(None, [self._detail, " over ".join(axes), self._curves, *said]))

    def reset(self) -> None:
        """Show everything again."""
        for view in self.views:
            view.reset()

    def _offer_reset(self, name: str, old: object, new: object) -> None:
        # Only where there is something to undo: a narrow panel needs the room for its heading.
        self._reset.update(visible=any(view.zoomed for view in self.views))

    def button(self, label: str, name: str) -> Button:
        """Return a small button in the page's style."""
        return Button(label=label, name=name, margin=0, height=18, stylesheets=[self.theme.sheet(_BUTTON)])

    def toggle(self, label: str, clicked: Callable[[], None]) -> Button:
        """Return a button beside the heading, by which the panel shows something else."""
        out = self.button(label, f"{self.name}-toggle")
        out.on_click(clicked)
        heading, *others = self.row.children
        self.row.children = [heading, out, *others]
        return out

    def add(self, x: View, y: View, x_label: str, y_label: str) -> Any:
        """Return a new figure below the others, styled, with zoom, pan and reset but without a tool bar."""
        out = figure(
            name=f"{self.name}-figure-{len(self._plots)}",
            x_range=x.range,
            y_range=y.range,
            x_axis_type="log" if x.logarithmic else "linear",
            y_axis_type="log" if y.logarithmic else "linear",
            x_axis_label=x_label,
            y_axis_label=y_label,
            toolbar_location=None,
            tools=[],
            sizing_mode="stretch_both",
            min_height=36,
            min_width=200,
            min_border_left=_LEFT,
            min_border_right=_RIGHT,
            min_border_top=_TOP,
            min_border_bottom=0,
            output_backend="canvas",
            lod_threshold=None,
            margin=0,
            # The frames of two figures are equally high, with or without a label below.
            styles={"flex-grow": "1", "flex-basis": f"{_BELOW}px" if x_label else "0"},
        )
        self._plots.append(out)
        pan, wheel = PanTool(), WheelZoomTool(zoom_on_axis=True)
        out.add_tools(pan, wheel, ResetTool())
        out.toolbar.active_drag, out.toolbar.active_scroll = pan, wheel
        for view in (x, y):
            if view not in self.views:
                self.views.append(view)
                view.range.on_change("start", self._offer_reset)
                view.range.on_change("end", self._offer_reset)
        out.on_event(DoubleTap, lambda event: self.reset())
        # The page shows through: half of the outermost pixels would keep the colour of the theme before.
        out.background_fill_color = out.border_fill_color = out.outline_line_color = None
        for axis in (*out.xaxis, *out.yaxis):
            self._style_axis(axis)
        for grid in (*out.xgrid, *out.ygrid):
            self.theme.paint(grid, grid_line_color="grid")
            grid.grid_line_width = 1
        for name in ("inner_width", "inner_height"):
            out.on_change(name, lambda attr, old, new: self._ticks(out))
        for axis in out.yaxis:
            axis.on_change("axis_label", lambda attr, old, new: self._ticks(out))
        self.layout.children = [*self.layout.children, out]
        return out

    def _ticks(self, plot: Any) -> None:
        """Let a figure have as many ticks as there is room for on the screen."""
        width, height = inner_size(plot)
        for axis in plot.yaxis:
            # The unit of a low figure is longer than its axis.
            low = _LOW if len(axis.axis_label or "") <= _SHORT else _LOW_OF_LONG
            assign(axis, axis_label_text_font_size=SMALL if height >= low else "9px")
        for axes, pixels, each in ((plot.xaxis, width, 58.0), (plot.yaxis, height, 24.0)):
            for axis in axes:
                if isinstance(axis, LinearAxis):
                    # One number alone tells no scale.
                    axis.ticker.desired_num_ticks = max(3, min(9, round(pixels / each)))

    def _style_axis(self, axis: Any) -> None:
        self.theme.paint(
            axis,
            axis_line_color="frame",
            major_tick_line_color="frame",
            major_label_text_color="muted",
            axis_label_text_color="muted",
        )
        axis.minor_tick_line_color = None
        axis.major_tick_in, axis.major_tick_out = 0, 4
        axis.major_label_standoff, axis.axis_label_standoff = 3, 4
        axis.major_label_text_font = axis.axis_label_text_font = FONT
        axis.major_label_text_font_size = axis.axis_label_text_font_size = SMALL
        axis.axis_label_text_font_style = "normal"
        if isinstance(axis, LogAxis):
            axis.ticker = LogTicker(desired_num_ticks=8, num_minor_ticks=9)
            self.theme.paint(axis, minor_tick_line_color="frame")
            axis.minor_tick_in, axis.minor_tick_out = 0, 2
            axis.formatter = LogTickFormatter(ticker=axis.ticker, min_exponent=4)
            # Within a decade the numbers come closer and closer together.
            axis.major_label_policy = NoOverlap(min_distance=_APART)
        elif isinstance(axis, LinearAxis):
            axis.ticker.desired_num_ticks = 5
            axis.formatter = BasicTickFormatter(use_scientific=False)
            # A low figure has more ticks than numbers.
            axis.major_label_policy = NoOverlap(min_distance=1)

    def degrees(self, axis: Any) -> None:
        """Put the ticks of an axis at parts of a turn."""
        axis.ticker = AdaptiveTicker(base=360, mantissas=_TURNS, desired_num_ticks=4, num_minor_ticks=0)

    def decibels(self, axis: Any) -> None:
        """Put the ticks of an axis at round decibels."""
        axis.ticker = AdaptiveTicker(base=10, mantissas=_DECIBELS, desired_num_ticks=5, num_minor_ticks=0)

    def label_ticks(self, plot: Any, shown: bool, label: str = "") -> None:
        """Write numbers and a label below a figure, or leave them to the figure under it."""
        # The exponents of powers of ten need a size above 0.
        size, alpha, major, minor = (SMALL, 1.0, 4, 2) if shown else ("1px", 0.0, 0, 0)
        ticks: dict[str, Any] = {"major_tick_out": major, "minor_tick_out": minor}
        numbers: dict[str, Any] = {"major_label_text_font_size": size, "major_label_text_alpha": alpha}
        assign(plot.xaxis[0], **ticks, **numbers, axis_label=label if shown else "")
        # Room for half a number of the vertical axis.
        assign(plot, min_border_bottom=0 if shown else 8)

    # What is drawn.

    def draw(
        self, glyph: Callable[..., Any], *columns: str, source: Any, line: str = "", fill: str = "", **look: Any
    ) -> Any:
        """Return what a figure's method `glyph` draws of columns of a source, in the colours of roles."""
        out = glyph(*columns, source=source, **look)
        roles = {"line_color": line, "fill_color": fill}
        self.theme.paint(out.glyph, **{name: role for name, role in roles.items() if role})
        return out

    def span(self, plot: Any, dimension: Any, role: str, **look: Any) -> Any:
        """Return a straight line through a figure; without a location it is not drawn."""
        out: Any = Span(dimension=dimension, **({"location": None, "line_width": 1} | look))
        self.theme.paint(out, line_color=role)
        plot.add_layout(out)
        return out

    def limit_line(self, plot: Any, dimension: Any) -> Any:
        """Return a straight line for a limit of the job."""
        return self.span(plot, dimension, "limit", line_width=1.5, line_dash=list(LIMIT_DASHES))

    def bound(self, plot: Any, edge: str) -> Callable[[float | None], None]:
        """Return the function that draws a limit: a line, and all above it (edge "bottom") or below it ("top") shaded.

        None hides it.
        """
        region: Any = BoxAnnotation(visible=False, level="underlay", fill_alpha=1.0, line_alpha=0.0)
        setattr(region, edge, 0.0)
        self.theme.paint(region, fill_color="beyond")
        plot.add_layout(region)
        line = self.limit_line(plot, "width")

        def show(at: float | None) -> None:
            assign(line, location=at)
            assign(region, visible=at is not None, **({} if at is None else {edge: at}))

        return show

    def curves(self, plot: Any, name: str, width: float, *more: str) -> Any:
        """Draw the curves of a new source, which `put_curves` fills, with `more` columns of texts."""
        source = self.sources.new(name, lists=("xs", "ys", "name", "colour", "dash", *more))
        return plot.multi_line("xs", "ys", source=source, line_color="colour", line_dash="dash", line_width=width)

    def put_curves(self, source: str, curves: Iterable[Curve], **more: list[Any]) -> None:
        """Set the curves of a source."""
        rows = list(curves)
        self.sources.put(
            source,
            name=[name for name, _, _, _, _ in rows],
            colour=[self.theme.colours[role] for _, role, _, _, _ in rows],
            dash=[list(dash) for _, _, dash, _, _ in rows],
            xs=[x for _, _, _, x, _ in rows],
            ys=[y for _, _, _, _, y in rows],
            **more,
        )

    def words(self, plot: Any, x: str, y: str, source: Any, role: str, **look: Any) -> Any:
        """Write texts at places of a source."""
        font = {"text_font": value(FONT), "text_font_size": value(look.pop("size", "10px"))}
        out = plot.text(x, y, source=source, **font, **look)
        self.theme.paint(out.glyph, text_color=role)
        return out

    def crosshair(self, *plots: Any, vertical: Span | None = None) -> Span:
        """Give figures a cross at the mouse and return its vertical line, which goes through all that have it."""
        vertical = Span(dimension="height", line_width=1, line_dash=[3, 3]) if vertical is None else vertical
        across = [Span(dimension="width", line_width=1, line_dash=[3, 3]) for _ in plots]
        for one in (vertical, *across):
            self.theme.paint(one, line_color="reference")
        for plot, one in zip(plots, across, strict=True):
            plot.add_tools(CrosshairTool(overlay=(one, vertical), visible=False))
        return vertical

    def hover(self, plot: Any, renderers: Sequence[Any], rows: Sequence[tuple[str, str]], **settings: Any) -> None:
        """Show numbers of curves at the mouse: rows of a label and Bokeh's fields with the unit."""
        tool = HoverTool(renderers=list(renderers), tooltips="", visible=False, show_arrow=False, **settings)
        self.theme.text(tool, "tooltips", _tooltip(rows))
        plot.add_tools(tool)

    def message(self, plot: Any) -> Any:
        """Return a line of text at the top left of a figure for what is wrong, hidden at first."""
        corner = Node(target="frame", symbol="top_left")
        out: Any = Label(
            x=corner, y=corner, x_offset=8, y_offset=-5, text="", text_baseline="top", text_font=FONT,
            text_font_size=NORMAL, level="annotation", visible=False, background_fill_alpha=0.85,
        )  # fmt: skip
        out.padding = 3
        self.theme.paint(out, text_color="limit", background_fill_color="page")
        plot.add_layout(out)
        self._messages.append(out)
        return out

    def heading(self, detail: str) -> None:
        """Write a detail beside the title."""
        self._detail = detail
        text = (
            f'<div class="line" title="{escape(detail)}"><span class="title" role="heading" aria-level="2">'
            f'{escape(self._title)}</span><span class="detail">{escape(detail)}</span></div>'
        )
        assign(self._head, text=text)

    def keys(self, entries: Sequence[Key]) -> None:
        """Write what each curve is; the title has those too that do not fit."""
        self._curves = ", ".join(words for words, _, _, _ in entries)
        parts = []
        many = len(entries) > _FEW
        for words, role, dash, width in entries:
            written = escape(words.replace("attitude", "att.") if many else words)
            dashing = f' stroke-dasharray="{" ".join(map(str, dash))}"' if dash else ""
            parts.append(
                f'<span><svg aria-hidden="true"><line x1="0" x2="100%" y1="4" y2="4" '
                f'stroke="{self.theme.colours[role]}" stroke-width="{width:g}"{dashing}/></svg>{written}</span>'
            )
        text = f'<div class="line keys{" many" if many else ""}" title="{escape(self._curves)}">{"".join(parts)}</div>'
        assign(self._keys, text=text)


def set_message(label: Any, text: str) -> None:
    """Write a message into a figure; an empty one hides it."""
    assign(label, text=text, visible=bool(text))


def _tooltip(rows: Sequence[tuple[str, str]]) -> str:
    """Return the HTML of a tooltip with ``{role}`` for the theme's colours; Bokeh's own fields stay as they are."""
    cells = "".join(
        f'<span class="word">{escape(words)}</span><span class="number">{number}</span>' for words, number in rows
    )
    # A style inside the tooltip is one for its host: Bokeh's is white in any theme.
    return '<div class="tip">' + cells.replace("{", "{{").replace("}", "}}") + f"<style>{_TIP}</style></div>"


_OVERLAY_WIDTH = 1.5


class OverlayCurves:
    """Loop transfers of other designs, for the Bode and the Nichols diagram."""

    def __init__(self, sources: Sources, theme: Theme) -> None:
        self._sources, self._theme = sources, theme
        self._source = sources.new("overlays", lists=("xs", "gains", "phases", "colour", "dash", "name"))

    def draw(self, plot: Any, x: str, y: str) -> None:
        """Draw two of the columns against one another."""
        plot.multi_line(x, y, source=self._source, line_color="colour", line_dash="dash", line_width=_OVERLAY_WIDTH)

    def show(self, overlays: Sequence[Overlay], frequency: FloatArray) -> None:
        """Follow the overlays of a picture; `frequency` in rad/s."""
        self._sources.put(
            "overlays",
            xs=[column(frequency * HZ)] * len(overlays),
            gains=[decibels(np.abs(one.response)) for one in overlays],
            phases=[column(one.phase) for one in overlays],
            colour=[self._theme.colours[series(1 + k)] for k in range(len(overlays))],
            dash=[list(dashes(1 + k)) for k in range(len(overlays))],
            name=[one.design for one in overlays],
        )


def overlay_keys(overlays: Sequence[Overlay]) -> list[Key]:
    """Return the keys of other designs."""
    return [(one.design, series(1 + k), dashes(1 + k), _OVERLAY_WIDTH) for k, one in enumerate(overlays)]


def limit_key(words: str) -> Key:
    """Return the key of a limit of the job."""
    return words, "limit", LIMIT_DASHES, 1.5
