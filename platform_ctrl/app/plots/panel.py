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
    LinearAxis,
    LogAxis,
    LogTicker,
    LogTickFormatter,
    Model,
    Node,
    NoOverlap,
    PanTool,
    ResetTool,
    WheelZoomTool,
)
from bokeh.models.annotations.geometry import BoxAnnotation, Span
from bokeh.models.annotations.labels import Label
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

# A style inside a tooltip is one for its host: Bokeh's is white in any theme.
_TIP = f"""<style>
:host {{ background-color: var(--page); color: var(--ink); border: 1px solid var(--frame); border-radius: 3px;
  padding: 4px 8px; opacity: 1; }}
.tip {{ display: grid; grid-template-columns: auto auto; gap: 0 10px; font: {SMALL}/16px {FONT};
  font-variant-numeric: tabular-nums; }}
.word {{ color: var(--muted); }} .number {{ text-align: right; }}
</style>"""


class Theme:
    """The colour of each property of each model by role, so that all can change in place."""

    def __init__(self, dark: bool) -> None:
        self.colours = colours(dark)
        self._properties: list[tuple[Model, str, str]] = []

    def paint(self, model: Model, **roles: str) -> None:
        """Give properties of a model the colours of their roles, now and after every change of the theme."""
        for name, role in roles.items():
            self._properties.append((model, name, role))
            setattr(model, name, self.colours[role])

    def change(self, dark: bool) -> None:
        """Switch everything that was painted."""
        self.colours = colours(dark)
        for model, name, role in self._properties:
            setattr(model, name, self.colours[role])


class Panel:
    """One or two figures, one below the other, and what the page writes above them.

    A plot is a subclass: its constructor adds figures and draws on empty sources, `show` fills the sources.

    Attributes
    ----------
    title, detail, keys
        Texts above the figures: the quantity, the loop or plant, and a legend.
    other
        Text of the button for the panel's other content; empty: it has none.
    """

    other = ""

    def __init__(self, name: str, title: str, theme: Theme, sources: Sources) -> None:
        self.name, self.title, self.theme, self.sources = name, title, theme, sources
        self.detail, self.keys = "", list[Key]()
        self.views: list[View] = []
        self._plots: list[Any] = []
        self._messages: list[Any] = []
        self.layout: Any = Column(sizing_mode="stretch_both", margin=0, spacing=2, name=name)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        raise NotImplementedError

    @property
    def caption(self) -> str:
        """A description for a screen reader: loop or plant, axes, curves, messages."""
        shown = [one for one in self._plots if one.visible]
        axes = [one for one in (shown[0].yaxis[0].axis_label, shown[-1].xaxis[0].axis_label) if one] if shown else []
        said = [one.text for one in self._messages if one.visible]
        curves = ", ".join(words for words, *_ in self.keys)
        return "; ".join(filter(None, [self.detail, " over ".join(axes), curves, *said]))

    def reset(self) -> None:
        """Show everything again."""
        for view in self.views:
            view.reset()

    def turn(self) -> None:
        """Show what the panel can show instead."""

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
        out.on_event(DoubleTap, lambda event: self.reset())
        # The page shows through: half of the outermost pixels would keep the colour of the theme before.
        out.background_fill_color = out.border_fill_color = out.outline_line_color = None
        for axis in (*out.xaxis, *out.yaxis):
            self._style_axis(axis)
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
                    # A single tick label gives no scale.
                    axis.ticker.desired_num_ticks = max(3, min(9, round(pixels / each)))

    def _style_axis(self, axis: Any) -> None:
        # The page's style sheet has the colours of axes and grids.
        axis.major_tick_in, axis.major_tick_out = 0, 4
        axis.major_label_standoff, axis.axis_label_standoff = 3, 4
        axis.major_label_text_font = axis.axis_label_text_font = FONT
        axis.major_label_text_font_size = axis.axis_label_text_font_size = SMALL
        axis.axis_label_text_font_style = "normal"
        if isinstance(axis, LogAxis):
            axis.ticker = LogTicker(desired_num_ticks=8, num_minor_ticks=9)
            axis.minor_tick_in, axis.minor_tick_out = 0, 2
            axis.formatter = LogTickFormatter(ticker=axis.ticker, min_exponent=4)
            # Within a decade the numbers come closer and closer together.
            axis.major_label_policy = NoOverlap(min_distance=_APART)
        elif isinstance(axis, LinearAxis):
            axis.ticker.desired_num_ticks = 5
            axis.minor_tick_in = axis.minor_tick_out = 0
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
        tool = HoverTool(
            renderers=list(renderers), tooltips=_tooltip(rows), visible=False, show_arrow=False, **settings
        )
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


def set_message(label: Any, text: str) -> None:
    """Write a message into a figure; an empty one hides it."""
    assign(label, text=text, visible=bool(text))


def _tooltip(rows: Sequence[tuple[str, str]]) -> str:
    """Return the HTML of a tooltip with Bokeh's fields."""
    cells = "".join(
        f'<span class="word">{escape(words)}</span><span class="number">{number}</span>' for words, number in rows
    )
    return f'<div class="tip">{cells}{_TIP}</div>'


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
