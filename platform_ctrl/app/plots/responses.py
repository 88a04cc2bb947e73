"""Responses over time, and the response to a disturbance over time or frequency."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.models.annotations.geometry import BoxAnnotation, Span

from platform_ctrl.app.pictures import Drawing, Overlay, TimeResponse
from platform_ctrl.app.plots.bode import HZ
from platform_ctrl.app.plots.data import (
    LIMIT_DASHES,
    Column,
    Sources,
    Unit,
    View,
    column,
    dashes,
    extent,
    finite,
    quantity,
    series,
    thinned,
)
from platform_ctrl.app.plots.panel import Key, Panel, Theme, overlay_keys, tell
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray

# Points of a curve, signals in a figure; how far the set's band may widen the view beyond the plant shown.
_POINTS, _SIGNALS, _WIDER = 400, 9, 3.0
# Share of a limit, and size in the plain unit, below which a signal is nothing.
_NOTHING, _ROUNDING = 1e-4, 1e-12
# Share of the others below which a signal is as good as nothing: then they are looked at.
_DWARFED = 0.03
# What grows without bound is shown to this many times its size in the first eighth.
_BEGUN = 2.0
# Of a curve, pixels.
_WIDTH = 2.0
# Figures: the first unit of a response, and the second.
_FIGURES = 2


class TimePanel:
    """A response over time: angles, and torques below them."""

    def __init__(self, panel: Panel, name: str, sources: Sources, theme: Theme) -> None:
        time = View(0.0, 1.0, _whole)
        self._panel = panel
        self._time = time
        self._traces = [_Trace(panel, f"{name}_{k}" if k else name, time, sources, theme, last=k > 0) for k in (0, 1)]
        panel.crosshair(*self.plots)
        self._shown = True

    @property
    def plots(self) -> list[Any]:
        """The figures."""
        return [one.plot for one in self._traces]

    def visible(self, shown: bool) -> None:
        """Show the figures, or hide them."""
        self._shown = shown
        self._arrange()

    def show(self, picture: Drawing, response: TimeResponse, own: str) -> list[Key]:
        """Follow a response."""
        units = list(dict.fromkeys(response.units))[:_FIGURES] or [""]
        overlays = picture.bode.overlays
        words: dict[str, list[str]] = {}
        limits: list[Key] = []
        for k, trace in enumerate(self._traces):
            rows = [i for i, unit in enumerate(response.units) if k < len(units) and unit == units[k]][:_SIGNALS]
            trace.show(picture, response, rows, units[k] if k < len(units) else "", None if k else response.limit, own)
            for name, colour in trace.signals:
                words.setdefault(colour, []).append(name)
            limits += trace.limits
        self._time.fit(extent([column(response.t)]))
        self._arrange()
        # A gimbal's torque has the colour of its angle. Other designs have the colours of the signals, and dashes.
        keys: list[Key] = [(", ".join(names), colour, (), _WIDTH) for colour, names in words.items()]
        return [*keys, *limits, *((one.design, "muted", dashes(1 + j), 1.3) for j, one in enumerate(overlays))]

    def _arrange(self) -> None:
        first, second = self._traces
        first.plot.visible = self._shown
        second.plot.visible = self._shown and second.used
        # Times are written once, below the lower figure.
        self._panel.label_ticks(first.plot, not second.used, "time, s")


class _Trace:
    """One figure of signals in one unit."""

    def __init__(self, panel: Panel, name: str, time: View, sources: Sources, theme: Theme, *, last: bool) -> None:
        self._name, self._sources, self._theme, self._last = name, sources, theme, last
        self._size = View(-1.0, 1.0)
        self.plot = plot = panel.add(time, self._size, "time, s" if last else "", "")
        lines: ColumnDataSource = sources.new(name, lists=("xs", "ys", "name", "unit", "colour"))
        bands = sources.new(f"{name}_bands", lists=("xs", "ys", "colour"))
        others = sources.new(f"{name}_overlays", lists=("xs", "ys", "name", "colour", "dash"))
        drive = sources.new(f"{name}_drive", "t", "share")
        self._limits, self._edges = [], []
        for edge in ("bottom", "top"):
            line = Span(dimension="width", location=None, line_width=1.5, line_dash=list(LIMIT_DASHES))
            theme.paint(line, line_color="limit")
            plot.add_layout(line)
            self._edges.append(line)
            beyond: Any = BoxAnnotation(visible=False, level="underlay", fill_alpha=1.0, line_alpha=0.0)
            setattr(beyond, edge, 0.0)
            theme.paint(beyond, fill_color="beyond")
            plot.add_layout(beyond)
            self._limits.append(beyond)
        plot.extra_y_ranges = {"share": Range1d(start=-1.1, end=1.1)}
        acts = plot.line("t", "share", source=drive, line_width=1, line_dash=[2, 3], y_range_name="share")
        theme.paint(acts.glyph, line_color="reference")
        plot.patches("xs", "ys", source=bands, fill_color="colour", fill_alpha=0.16, line_alpha=0.0)
        plot.multi_line("xs", "ys", source=others, line_color="colour", line_dash="dash", line_width=1.3)
        curves = plot.multi_line("xs", "ys", source=lines, line_color="colour", line_width=_WIDTH)
        rows = [("@name", "$snap_y{0.[000]} @unit"), ("time", "$snap_x{0.[0000]} s")]
        panel.hover(plot, [curves], rows, line_policy="interp")
        self._message = panel.message(plot)
        self._unit = Unit()
        self._begun = False
        self.used = True
        # Names of the signals with their colours, and the key of the limit.
        self.signals: list[tuple[str, str]] = []
        self.limits: list[Key] = []

    def show(
        self, picture: Drawing, response: TimeResponse, rows: list[int], unit: str, limit: float | None, own: str
    ) -> None:
        self.used = bool(rows)
        at = thinned(len(response.t), _POINTS)
        t = column(response.t[at])
        values = response.values[rows][:, at]
        band = response.low.size > 0 and response.low.shape == response.high.shape == response.values.shape
        low, high = (response.low[rows][:, at], response.high[rows][:, at]) if band else (values, values)
        limit = limit if limit is not None and 0.0 < limit < math.inf else None
        others = [(j, _fitting(one, own, response)) for j, one in enumerate(picture.bode.overlays)]
        fitting = [(j, one) for j, one in others if one is not None and rows]
        wider = [low, high, *(one.values[rows] for _, one in fitting)]
        if not picture.stable:
            # What grows without bound is looked at where it begins; the set's band says nothing any more.
            band, wider = False, []
        seen = _seen(values if picture.stable else _BEGUN * values[:, : 1 + len(at) // 8], wider, limit)
        if self._begun and not picture.stable:
            seen = None
        self._begun = self._begun or seen is not None
        plain = unit
        self._unit.follow(unit, max(abs(seen[0]), abs(seen[1])) if seen is not None else math.nan)
        scale, unit = self._unit.scale, self._unit.name
        own_series = [series(response.series[i]) for i in rows]
        colours = [self._theme.colours[one] for one in own_series]
        names = [greek(response.signals[i]) for i in rows]
        put = self._sources.put
        put(
            self._name,
            xs=[t] * len(rows),
            ys=[column(one, scale) for one in values],
            name=names,
            unit=[unit] * len(rows),
            colour=colours,
        )
        areas = [_area(t, column(a, scale), column(b, scale)) for a, b in zip(low, high, strict=True)] if band else []
        put(f"{self._name}_bands", xs=[x for x, _ in areas], ys=[y for _, y in areas], colour=colours[: len(areas)])
        drawn = [
            (j, k, column(one.t[some]), one.values[i, some])
            for j, one in fitting
            for some in [thinned(len(one.t), _POINTS)]
            for k, i in enumerate(rows)
        ]
        put(
            f"{self._name}_overlays",
            xs=[x for _, _, x, _ in drawn],
            ys=[column(y, scale) for _, _, _, y in drawn],
            name=[picture.bode.overlays[j].design for j, _, _, _ in drawn],
            colour=[colours[k] for _, k, _, _ in drawn],
            dash=[list(dashes(1 + j)) for j, _, _, _ in drawn],
        )
        # What stands all the time needs no curve.
        acts = len(response.drive) == len(response.t) and not self._last and len(np.unique(response.drive[1:])) > 1
        put(f"{self._name}_drive", t=t if acts else column([]), share=column(response.drive[at] if acts else []))
        if seen is not None:
            self._size.fit((scale * seen[0], scale * seen[1]))
        self.plot.yaxis[0].axis_label = unit
        above, below = self._limits
        if limit is not None:
            above.bottom, below.top = scale * limit, -scale * limit
        above.visible = below.visible = limit is not None
        for sign, line in zip((1.0, -1.0), self._edges, strict=True):
            line.location = None if limit is None else sign * scale * limit
        if rows and not np.isfinite(column(values)).any():
            tell(self._message, "no finite response")
        else:
            troubled = not (picture.stable or self._last)
            tell(self._message, "closed loop not stable" if troubled else "")
        self.signals = list(zip(names, own_series, strict=True))
        self.limits = [] if limit is None else [(f"limit {quantity(limit, plain)}", "limit", LIMIT_DASHES, 1.5)]


def _fitting(overlay: Overlay, own: str, response: TimeResponse) -> TimeResponse | None:
    out: TimeResponse = getattr(overlay, own)
    return out if out.signals == response.signals and out.units == response.units else None


def _whole(low: float, high: float) -> tuple[float, float]:
    return low, high if high > low else low + 1.0


def _seen(values: FloatArray, wider: Sequence[FloatArray], limit: float | None) -> tuple[float, float] | None:
    """Return what the view has to show: the plant shown, the others as long as they do not dwarf it, a limit nearby."""
    own = extent([values])
    if own is None:
        return None
    size = max(abs(own[0]), abs(own[1]))
    if limit is None and max(map(abs, extent([values, *wider]) or own)) < _ROUNDING:
        return -1e-6, 1e-6
    if limit is not None and size < _NOTHING * limit:
        # Rounding, or as good as nothing: against the limit it is a straight line.
        return -1.1 * limit, 1.1 * limit
    low, high = extent(wider) or own
    low, high = min(own[0], low), max(own[1], high)
    if size > _DWARFED * max(-low, high):
        low, high = max(low, -_WIDER * size), min(high, _WIDER * size)
    if limit is not None:
        # An unstable loop leaves its limit far behind: what happens near the limit is of interest.
        low, high = max(low, -4.0 * limit), min(high, 4.0 * limit)
        if low < -0.5 * limit:
            low = min(low, -1.1 * limit)
        if high > 0.5 * limit:
            high = max(high, 1.1 * limit)
    return low, high


def _area(t: Column, low: Column, high: Column) -> tuple[Column, Column]:
    """Return the closed outline of a band."""
    t, low, high = finite(t, low, high)
    return np.concatenate([t, t[::-1]]), np.concatenate([low, high[::-1]])


class StepPanel:
    """Step response: a torque step to the angles, or to the attitude."""

    def __init__(self, theme: Theme, sources: Sources) -> None:
        self.panel = Panel("step", "Step response", theme)
        self.over_time = TimePanel(self.panel, "step", sources, theme)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        keys = self.over_time.show(picture, picture.step, "step")
        self.panel.say(picture.step.title)
        self.panel.keys(keys)


# Below this share of the peak nothing is shown at rest.
_LEAST = 1e-5


class RatePanel:
    """Response to Omega, or of the free platform to a torque on it, over time or over frequency."""

    def __init__(self, theme: Theme, sources: Sources, frequency: View) -> None:
        self.panel = Panel("Omega", "Disturbance", theme)
        self._sources, self._theme, self._frequency = sources, theme, frequency
        self.over_time = TimePanel(self.panel, "Omega_time", sources, theme)
        self._gain = View(1e-3, 1.0, _decades, logarithmic=True)
        plot = self.panel.add(frequency, self._gain, "frequency, Hz", "", log_x=True, log_y=True)
        self.plot = plot
        lines = sources.new("Omega_gain", "frequency", "gain")
        band = sources.new("Omega_gain_band", "frequency", "low", "high")
        others = sources.new("Omega_gain_overlays", lists=("xs", "ys", "name", "colour", "dash"))
        self._limit = BoxAnnotation(bottom=1.0, visible=False, level="underlay", fill_alpha=1.0, line_alpha=0.0)
        theme.paint(self._limit, fill_color="beyond")
        plot.add_layout(self._limit)
        self._edge = Span(dimension="width", location=None, line_width=1.5, line_dash=list(LIMIT_DASHES))
        theme.paint(self._edge, line_color="limit")
        plot.add_layout(self._edge)
        area = plot.varea("frequency", "low", "high", source=band, fill_alpha=0.16)
        theme.paint(area.glyph, fill_color="series-1")
        plot.multi_line("xs", "ys", source=others, line_color="colour", line_dash="dash", line_width=1.5)
        line = plot.line("frequency", "gain", source=lines, line_width=2.2)
        theme.paint(line.glyph, line_color="series-1")
        self.panel.hover(
            plot, [line], [("frequency", "@frequency{0.[000]} Hz"), ("gain", "@gain{0.[0000]}")], mode="vline",
            line_policy="interp",
        )  # fmt: skip
        self.panel.crosshair(plot)
        self._message = self.panel.message(plot)
        self._unit = Unit()
        self.shows_frequency = False
        self.toggle = self.panel.button("frequency", "Omega-toggle")
        self.toggle.on_click(self._toggled)
        row = self.panel.row
        row.children = [row.children[0], self.toggle, *row.children[1:]]
        plot.visible = False
        self._picture: Drawing | None = None

    def _toggled(self) -> None:
        self.choose(not self.shows_frequency)

    def choose(self, frequency: bool) -> None:
        """Show the response over frequency, or over time."""
        self.shows_frequency = frequency
        self.toggle.label = "time" if frequency else "frequency"
        self.plot.visible = frequency
        self.over_time.visible(not frequency)
        if self._picture is not None:
            self.show(self._picture)

    def show(self, picture: Drawing) -> None:
        """Follow a picture with the figures that are seen."""
        self._picture = picture
        if self.shows_frequency:
            self._show_gain(picture)
        else:
            keys = self.over_time.show(picture, picture.Omega_time, "Omega_step")
            self.panel.say(picture.Omega_time.title)
            self.panel.keys(keys)

    def _show_gain(self, picture: Drawing) -> None:
        response, overlays = picture.Omega_frequency, picture.bode.overlays
        with np.errstate(invalid="ignore"):
            gain = np.where(response.gain > 0.0, response.gain, np.nan)
        top = extent([gain])
        size = top[1] if top is not None else math.nan
        limit = response.limit if response.limit is not None and 0.0 < response.limit < math.inf else None
        self._unit.follow(response.unit, size)
        scale, unit = self._unit.scale, self._unit.name
        put = self._sources.put
        put("Omega_gain", frequency=column(response.frequency * HZ), gain=column(gain, scale))
        f, low, high = finite(
            column(response.band_frequency * HZ), column(response.low, scale), column(response.high, scale)
        )
        # A logarithmic axis has no zero.
        floor = column(_LEAST * scale * size if size > 0.0 else 1e-30)
        put("Omega_gain_band", frequency=f, low=np.maximum(low, floor), high=np.maximum(high, floor))
        own = [(k, one) for k, one in enumerate(overlays) if len(one.Omega_gain) == len(response.frequency)]
        put(
            "Omega_gain_overlays",
            xs=[column(response.frequency * HZ)] * len(own),
            ys=[column(np.where(one.Omega_gain > 0.0, one.Omega_gain, np.nan), scale) for _, one in own],
            name=[one.design for _, one in own],
            colour=[self._theme.colours[series(1 + k)] for k, _ in own],
            dash=[list(dashes(1 + k)) for k, _ in own],
        )
        if limit is not None:
            self._limit.bottom = scale * limit
        self._limit.visible = limit is not None
        self._edge.location = None if limit is None else scale * limit
        if top is not None:
            # A limit close by is shown too.
            high_end = size if limit is None or not size / 30.0 < limit < 30.0 * size else max(size, 1.5 * limit)
            self._gain.fit((scale * max(top[0], _LEAST * size), scale * high_end))
        self.plot.yaxis[0].axis_label = unit
        tell(self._message, "no finite response" if top is None else "" if picture.stable else "closed loop not stable")
        self.panel.say(response.title)
        limits = [] if limit is None else [(f"limit {quantity(limit, response.unit)}", "limit", LIMIT_DASHES, 1.5)]
        self.panel.keys([(picture.settings.design, "series-1", (), 2.2), *overlay_keys(overlays), *limits])


def _decades(low: float, high: float) -> tuple[float, float]:
    bottom, top = math.floor(math.log10(low) + 1e-9), math.ceil(math.log10(high) - 1e-9)
    return 10.0**bottom, 10.0 ** max(top, bottom + 1)
