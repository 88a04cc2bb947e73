"""The painter of `Curves` with Bokeh: panels of figures in the page's colours and type."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np
from bokeh import models
from bokeh.core.properties import field, value
from bokeh.events import DoubleTap
from bokeh.models.annotations.geometry import Span
from bokeh.models.annotations.labels import Label

from platform_ctrl.analysis.curves import Curve, Curves, Words
from platform_ctrl.app.plots import views
from platform_ctrl.common.palette import PALETTE

# Key of a curve: words, role of its colour, dashes, width.
Key = tuple[str, str, Sequence[int], float]
Row = dict[str, Any]

# Dashes of the k-th design in pixels, empty: a solid line; and of the job's limits.
DASHES: tuple[tuple[int, ...], ...] = ((), (8, 3), (2, 3), (9, 3, 2, 3), (9, 3, 2, 3, 2, 3), (5, 2), (14, 4), (4, 4))
LIMIT_DASHES, DOTTED = (6, 3), (2, 3)
# Steps between ticks, times powers of 360 degrees, or of 10 dB: a phase is read in parts of a turn.
_STEPS = {"°": (360, (1.0, 2.0, 5.0, 15.0, 45.0, 90.0, 180.0)), "dB": (10, (1.0, 2.0, 4.0))}
# Height of a frame, pixels, below which a unit has to be written smaller, a short one and one of more characters than
# that: early enough that it never reaches the edge of the canvas, where Bokeh leaves the last half of a pixel.
_LOW, _SHORT, _LOW_OF_LONG = 64.0, 8, 100.0
# Width of lines by their form, opacity of thin ones and of bands.
_WIDTHS = {"strong": 2.2, "line": 1.5, "thin": 0.7, "band": 0.0, "mark": 1.5}
_THIN, _BAND = 0.4, 0.16
# Points by their kind: shape, size, width of the line.
_POINTS = {
    "pole": ("x", 9, 2.0), "other": ("x", 7, 1.3), "start": ("circle", 4, 1.0), "margin": ("circle", 6, 1.0),
    "critical": ("cross", 11, 2.0),
}  # fmt: skip
# Vertical lines by their role: dashes and width.
_UPRIGHT: dict[str, tuple[Sequence[int], float]] = {"limit": (LIMIT_DASHES, 1.5), "reference": (DOTTED, 1.0)}
# What is drawn by the names of the sources, from behind to the front: the glyph, the properties that are columns of
# the source, more columns, and how it looks in any case.
_STROKE, _PLACE = ("line_color", "line_dash", "line_width"), ("x", "y")
_GLYPHS: dict[str, tuple[Any, tuple[str, ...], tuple[str, ...], Row]] = {
    "strips": (models.HStrip, ("y0", "y1", "fill_color"), (), {"line_alpha": 0.0}),
    "bands": (models.Patches, ("xs", "ys", "fill_color", "fill_alpha", "line_color", "line_alpha"), (), {}),
    "ground": (models.MultiLine, ("xs", "ys", *_STROKE), (), {}),
    "levels": (models.HSpan, ("y", *_STROKE), (), {}),
    "verticals": (models.VSpan, ("x", *_STROKE), (), {}),
    "cloud": (models.Scatter, _PLACE, (), {"marker": "dot", "size": 8, "line_alpha": 0.0, "fill_alpha": 0.35}),
    "lines": (models.MultiLine, ("xs", "ys", "line_alpha", *_STROKE), ("name", "unit"), {}),
    "traced": (models.Line, _PLACE, ("at",), {}),
    "points": (models.Scatter, (*_PLACE, "marker", "size", "line_width", "line_color", "fill_color"),
               ("name", "words"), {}),
    "words": (models.Text, (*_PLACE, "text", "text_color", "text_align", "text_baseline", "x_offset", "y_offset"),
              (), {"text_font_size": value("10px"), "text_font": value(views.FONT)}),
}  # fmt: skip
# Pixels up to which a frame is none, as it is where its panel is not shown.
_LEAST_SIZE = 10
# Points of a short line; how far a limit is shaded, in multiples of it.
_FEW = 4
_BEYOND = 1e4

# A style inside a tooltip is one for its host: Bokeh's is white in any theme.
_TIP = f"""<style>
:host {{ background-color: var(--page); color: var(--ink); border: 1px solid var(--frame); border-radius: 3px;
  padding: 4px 8px; opacity: 1; }}
.tip {{ display: grid; grid-template-columns: auto auto; gap: 0 10px; font: {views.SMALL}/16px {views.FONT};
  font-variant-numeric: tabular-nums; }}
.word {{ color: var(--muted); }} .number {{ text-align: right; }}
</style>"""


class Theme:
    """The colours of a page by role, the models that keep theirs whatever is shown, and what all sources share."""

    def __init__(self) -> None:
        self.colours = PALETTE["light"]
        self._models: list[tuple[Any, dict[str, str]]] = []
        # All sources and axes have the same: a page takes longer to open the more models it has.
        self.policy, self.every, self.no_ticks = models.UnionRenderers(), models.AllIndices(), models.FixedTicker()
        # Within a decade numbers come closer and closer together; a low figure has more ticks than numbers.
        self.apart: dict[Any, Any] = {
            models.LogAxis: models.NoOverlap(min_distance=2),
            models.LinearAxis: models.NoOverlap(min_distance=1),
        }

    def paint(self, model: Any, **roles: str) -> None:
        """Give properties of a model the colours of their roles, now and after every change of the theme."""
        self._models.append((model, roles))
        model.update(**{name: self.colours[role] for name, role in roles.items()})

    def change(self, dark: bool) -> bool:
        """Switch everything that was painted, and return whether that is a change."""
        before, self.colours = self.colours, PALETTE["dark" if dark else "light"]
        for model, roles in self._models:
            model.update(**{name: self.colours[role] for name, role in roles.items()})
        return self.colours is not before


@dataclasses.dataclass(frozen=True)
class Axis:
    """The horizontal axis of figures: its view, its label, and its name and Bokeh's format of its numbers at the mouse.

    `mode` is Bokeh's of what the mouse points at. `fits`: whether the view follows the curves. `mouse` is a line at the
    mouse, through all figures with this axis.
    """

    view: views.View
    label: str
    name: str
    number: str
    mode: Any = "vline"
    fits: bool = True
    mouse: Span = dataclasses.field(default_factory=lambda: Span(dimension="height", line_width=1, line_dash=[3, 3]))


class Trace(NamedTuple):
    """What each point of a figure's own lines belongs to, and their colour and width."""

    name: str
    number: str
    role: str
    width: float


class Figure:
    """A figure that follows `Curves`; `parts` of `_GLYPHS` that it has, as a rule, from the beginning.

    Attributes
    ----------
    plot, sources
        Bokeh's figure and its column data sources: ``"lines"``, ``"bands"``, ``"points"``, ..., in units of the axes.
    keys
        The legend of what it shows.
    """

    def __init__(
        self,
        panel: Panel,
        x: Axis,
        y: views.View,
        number: str,
        parts: str,
        *,
        last: bool = True,
        trace: Trace | None = None,
    ) -> None:
        self.x, self.y, self._theme, self._unit, self._trace = x, y, panel.theme, views.Unit(), trace
        self.keys: list[Key] = []
        self.message: Any = None
        self._shown: Curves | None = None
        # What was drawn of each of the curves: several stay the same from one picture to the next.
        self._drawn: dict[Curve, tuple[str, list[Row]]] = {}
        self._number = number
        self.plot: Any = views.empty_figure(f"{panel.name}-figure-{len(panel.figures)}", x.view, y, last)
        self.xaxis, self.yaxis = self.plot.xaxis[0], self.plot.yaxis[0]
        for axis, grid in ((self.xaxis, self.plot.xgrid[0]), (self.yaxis, self.plot.ygrid[0])):
            axis.major_label_policy, grid.ticker = self._theme.apart[type(axis)], axis.ticker
        self.xaxis.minor_tick_out = 2
        self.sources: dict[str, models.ColumnDataSource] = {}
        # Of the frame, pixels: a guess before the browser has sent it.
        self._size: dict[str, float] = {"inner_width": 320.0, "inner_height": 240.0}
        self.plot.on_change("inner_width", self._resized)
        self.plot.on_change("inner_height", self._resized)
        # Each model that comes later has Bokeh look through all of them.
        for name in parts.split():
            self._source(name, {one: [] for one in _columns(name)})

    def _source(self, name: str, data: Row) -> models.ColumnDataSource:
        """Return the source of a name; the first time it is made with `data`, and what it is drawn with."""
        if name not in self.sources:
            make, fields, _, look = _GLYPHS[name]
            policy, view = self._theme.policy, models.CDSView(filter=self._theme.every)
            self.sources[name] = source = models.ColumnDataSource(
                data=data, name=f"{self.plot.name}-{name}", selection_policy=policy
            )
            glyph = make(**{one: field(one) for one in fields}, **look)
            drawn = self.plot.add_glyph(source, glyph, view=view, nonselection_glyph=None, muted_glyph=None)
            trace, number = self._trace, self._number
            if name == "cloud":
                self._theme.paint(glyph, fill_color="series-1")
            elif name == "traced" and trace is not None:
                glyph.line_width = trace.width
                self._theme.paint(glyph, line_color=trace.role)
                self._hover(drawn, (trace.name, f"@at{trace.number}"), (self.y.name, f"$snap_y{number}"))
            elif name == "points" and trace is not None:
                self._hover(drawn, ("@name", "@words"), snaps=False)
            elif name == "lines" and trace is None:
                self._hover(drawn, ("@name", f"$snap_y{number} @unit"), mode=self.x.mode)
        return self.sources[name]

    def _hover(self, renderer: Any, *rows: tuple[str, str], snaps: bool = True, mode: Any = "mouse") -> None:
        """Show numbers at the mouse: rows of a label and Bokeh's fields with the unit."""
        every = [*rows, (self.x.name, f"$snap_x{self.x.number}")] if snaps else rows
        cells = "".join(f'<span class="word">{escape(a)}</span><span class="number">{b}</span>' for a, b in every)
        more: Row = {"line_policy": "interp"} if snaps else {}
        tips = f'<div class="tip">{cells}{_TIP}</div>'
        tool = models.HoverTool(renderers=[renderer], tooltips=tips, mode=mode, visible=False, show_arrow=False, **more)
        self.plot.add_tools(tool)

    def show(self, shown: Curves) -> None:
        """Follow curves."""
        self._shown = shown
        own = [one for one in shown.curves if one.form in ("strong", "band")]
        view = shown.view or views.extent([each for one in own for each in (one.y, one.top) if each is not None])
        before = self._unit.scale
        if shown.unit:
            self._unit.follow(shown.unit, math.nan if view is None else max(map(abs, view)))
        scale = self._unit.scale
        if view is not None and math.isfinite(view[0]):
            self.y.fit((scale * view[0], scale * view[1]))
        if self.x.fits:
            self.x.view.fit(views.extent([views.column(one.x) for one in own if one.form == "strong"]))
        label = self._unit.name if shown.unit else shown.quantity
        if self.yaxis.axis_label != label:
            self.yaxis.axis_label = label
            self._ticks()
        self.keys = [(one.name, _role(one), _dashes(one), _WIDTHS[one.form]) for one in shown.curves if one.name]
        limits = [*((one.text, "limit") for one in shown.levels), *((text, role) for _, role, text in shown.verticals)]
        self.keys += [(text, role, LIMIT_DASHES, 1.5) for text, role in limits if text]
        if scale != before:
            self._drawn = {}
        self._draw(shown)

    def again(self) -> None:
        """Draw the same in other colours."""
        self._drawn = {}
        if self._shown is not None:
            self._draw(self._shown)

    def _draw(self, shown: Curves) -> None:
        scale, stroke = self._unit.scale, self._stroke
        rows: dict[str, list[Row]] = {name: [] for name in _GLYPHS}
        drawn, self._drawn = self._drawn, {}
        # The first curve is what counts: it is drawn last.
        for one in reversed(shown.curves):
            self._drawn[one] = name, own = drawn.get(one) or self._rows(one, shown.title)
            rows[name] += own
        rows["levels"] = [{"y": at * scale, **stroke((), 1.0, "reference")} for at in shown.references]
        rows["levels"] += [{"y": one.y * scale, **stroke(LIMIT_DASHES, 1.5, "limit")} for one in shown.levels]
        far, colours = [one.y * scale for one in shown.levels if one.shaded], self._theme.colours
        rows["strips"] = [{"y0": y, "y1": y * _BEYOND or _BEYOND, "fill_color": colours["beyond"]} for y in far]
        for at, role, _ in shown.verticals:
            rows["verticals"].append({"x": at, **stroke(*_UPRIGHT.get(role, ((), 1.2)), role)})
        height = self._size["inner_height"]
        words = [one for one in shown.words if math.isfinite(one.y) and one.least <= height]
        rows["words"] = [_word(one, scale, colours[one.role]) for one in words]
        for name, each in rows.items():
            if each or name in self.sources:
                data: Row = {key: [one[key] for one in each] for key in _columns(name)}
                if name in ("cloud", "traced"):
                    data = {key: views.column(views.joined(own)) for key, own in data.items()}
                views.put(self._source(name, data), data)

    def _stroke(self, dashes: Sequence[int], width: float, role: str) -> Row:
        return {"line_dash": list(dashes), "line_width": width, "line_color": self._theme.colours[role]}

    def _rows(self, one: Curve, title: str) -> tuple[str, list[Row]]:
        """Return the source that a curve belongs to, and its rows there."""
        colours, scale, role = self._theme.colours, self._unit.scale, _role(one)
        if one.kind in ("cloud", "traced"):
            return one.kind, [{"x": one.x, "y": scale * one.y, "at": one.along}]
        x, y = views.column(one.x), views.column(one.y, scale)
        if one.form == "band":
            opaque = {"fill_alpha": 1.0 if one.role else _BAND, "line_alpha": float(bool(one.kind))}
            colour = {"fill_color": colours[role], "line_color": colours["reference" if one.kind == "region" else role]}
            return "bands", [_area(x, y, one.top, scale) | opaque | colour]
        if one.form == "mark":
            marker, size, width = _POINTS[one.kind]
            look = {"marker": marker, "size": size, "name": one.name or one.kind, **self._stroke((), width, role)}
            look["fill_color"] = colours["page" if marker == "circle" else role]
            places = zip(x.tolist(), y.tolist(), one.words or [""] * len(x), strict=True)
            return "points", [look | {"x": at, "y": level, "words": words} for at, level, words in places]
        # A short line goes within its message, not as arrays of their own.
        ends = (x.tolist(), y.tolist()) if len(x) <= _FEW else (x, y)
        line = {"xs": ends[0], "ys": ends[1], **self._stroke(_dashes(one), _WIDTHS[one.form], role)}
        if one.form == "thin" and one.role:
            return "ground", [line]
        line["line_alpha"] = _THIN if one.form == "thin" else 1.0
        unit = self._unit.name if self._shown is not None and self._shown.unit else ""
        name = one.name or " ".join(one.words) or title
        return "lines", [line | {"name": name, "unit": unit}]

    def say(self, text: str, down: int) -> None:
        """Write a message at the top left, so many pixels below the edge; an empty one hides it."""
        if self.message is None and text:
            corner = models.Node(target="frame", symbol="top_left")
            self.message = Label(
                x=corner, y=corner, x_offset=8, y_offset=-down, text=text, text_baseline="top", text_font=views.FONT,
                text_font_size=views.NORMAL, level="annotation", background_fill_alpha=0.85,
            )  # fmt: skip
            self.message.padding = 3
            self._theme.paint(self.message, text_color="limit", background_fill_color="page")
            self.plot.add_layout(self.message)
        if self.message is not None:
            views.assign(self.message, text=text, visible=bool(text))

    def _resized(self, name: str, old: object, new: float) -> None:
        if new > _LEAST_SIZE:
            self._size[name] = float(new)
        self._ticks()
        if self._shown is not None and any(one.least for one in self._shown.words):
            self._draw(self._shown)

    def _ticks(self) -> None:
        """Let the figure have as many ticks as there is room for on the screen."""
        width, height = self._size.values()
        # The unit of a low figure is longer than its axis.
        low = _LOW if len(self.yaxis.axis_label or "") <= _SHORT else _LOW_OF_LONG
        views.assign(self.yaxis, axis_label_text_font_size=views.SMALL if height >= low else "9px")
        for axis, grid, pixels, each in (
            (self.xaxis, self.plot.xgrid[0], width, 58.0),
            (self.yaxis, self.plot.ygrid[0], height, 24.0),
        ):
            if isinstance(axis, models.LinearAxis) and hasattr(grid.ticker, "desired_num_ticks"):
                # A single tick label gives no scale.
                views.assign(grid.ticker, desired_num_ticks=max(3, min(9, round(pixels / each))))

    def label_ticks(self, shown: bool) -> None:
        """Write numbers and a label below the figure, or leave them to the figure under it."""
        ticker = self.plot.xgrid[0].ticker if shown else self._theme.no_ticks
        views.assign(self.xaxis, ticker=ticker, axis_label=self.x.label if shown else "")
        # Room for half a number of the vertical axis.
        views.assign(self.plot, min_border_bottom=0 if shown else 8)

    def rounded(self, unit: str, axis: str = "y") -> None:
        """Put the ticks of an axis at parts of a turn, or at round decibels."""
        base, mantissas = _STEPS[unit]
        ticker = models.AdaptiveTicker(base=base, mantissas=list(mantissas), desired_num_ticks=5, num_minor_ticks=0)
        for part in ("axis", "grid"):
            getattr(self.plot, f"{axis}{part}").ticker = ticker


def _columns(name: str) -> tuple[str, ...]:
    return (*_GLYPHS[name][1], *_GLYPHS[name][2])


def _role(one: Curve) -> str:
    return one.role or ("reference" if one.series is None else f"series-{1 + one.series % 8}")


def _dashes(one: Curve) -> Sequence[int]:
    return LIMIT_DASHES if one.role == "limit" else DASHES[(one.dashes or 0) % len(DASHES)]


def _area(x: Any, y: Any, top: Any, scale: float) -> Row:
    """Return the closed outline of a band from y to `top`, or of the region around which x and y go."""
    if top is None:
        return {"xs": x, "ys": y}
    x, y, top = views.finite(x, y, views.column(top, scale))
    return {"xs": np.concatenate([x, x[::-1]]), "ys": np.concatenate([y, top[::-1]])}


def _word(one: Words, scale: float, colour: str) -> Row:
    place = {"x": one.x, "y": scale * one.y, "x_offset": one.beside[0], "y_offset": one.beside[1], "text": one.text}
    return place | {"text_color": colour, "text_align": one.align[0], "text_baseline": one.align[1]}


class Panel:
    """Figures one below the other, of which some are shown, and what the page writes above them.

    A plot is a subclass: its constructor adds figures, `show` gives them curves.

    Attributes
    ----------
    title, detail, keys
        Texts above the figures: the quantity, the loop or plant, and a legend.
    turned
        Whether it shows its other content, if `others` has texts for the button that shows it, and that takes it back.
    """

    others: tuple[str, ...] = ()
    # Pixels from the upper edge to a message.
    down = 5

    def __init__(self, name: str, title: str, theme: Theme) -> None:
        self.name, self.title, self.theme = name, title, theme
        self.detail, self.keys, self._said = "", list[Key](), ""
        self.turned = False
        self.picture: Any = None
        self.figures: list[Figure] = []
        self.layout: Any = models.Column(sizing_mode="stretch_both", margin=0, spacing=2, name=name)

    def show(self, picture: Any) -> None:
        """Follow a picture."""
        self.picture = picture

    @property
    def caption(self) -> str:
        """A description for a screen reader: loop or plant, axes, curves, messages."""
        shown = [one for one in self.figures if one.plot.visible]
        axes = [one for one in (shown[0].yaxis.axis_label, shown[-1].xaxis.axis_label) if one] if shown else []
        curves = ", ".join(words for words, *_ in self.keys)
        return "; ".join(filter(None, [self.detail, " over ".join(axes), curves, self._said]))

    @property
    def views(self) -> set[views.View]:
        """The views of its axes."""
        return {view for one in self.figures for view in (one.x.view, one.y)}

    def reset(self) -> None:
        """Show everything again."""
        for view in self.views:
            view.reset()

    def turn(self) -> None:
        """Show what the panel can show instead."""
        self.turned = not self.turned
        if self.picture is not None:
            self.show(self.picture)

    def add(self, *given: Any, **more: Any) -> Figure:
        """Return a new figure below the others."""
        out = Figure(self, *given, **more)
        self.figures.append(out)
        across = Span(dimension="width", line_width=1, line_dash=[3, 3])
        self.theme.paint(across, line_color="reference")
        self.theme.paint(out.x.mouse, line_color="reference")
        out.plot.add_tools(models.CrosshairTool(overlay=(across, out.x.mouse), visible=False))
        out.plot.on_event(DoubleTap, lambda event: self.reset())
        return out

    def laid_out(self) -> Any:
        """Return the layout with all figures: what comes later is placed with its data, which its view might miss."""
        views.assign(self.layout, children=[one.plot for one in self.figures])
        return self.layout

    def put(self, shown: Mapping[int, Curves], detail: str, message: str = "") -> None:
        """Show curves in the figures with these numbers, and no others."""
        keys: dict[tuple[str, tuple[int, ...], float, str], str] = {}
        for k, one in enumerate(self.figures):
            views.assign(one.plot, visible=k in shown)
            if k not in shown:
                continue
            one.show(shown[k])
            one.label_ticks(k == max(shown))
            one.say(message if k == min(shown) else "", self.down)
            # Curves of one look have one key: a gimbal's torque has the colour of its angle.
            for words, role, dashes, width in one.keys:
                look = role, tuple(dashes), width, words if role in ("limit", "muted") else ""
                known = keys.get(look, words)
                keys[look] = words if words == known else f"{known}, {words}"
        self.keys = sorted(((words, *look[:3]) for look, words in keys.items()), key=lambda one: one[1] == "limit")
        self.detail, self._said = detail, message
        self.laid_out()
