"""Responses over time, and the response to a disturbance over time or frequency."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import Range1d
from bokeh.models.annotations.geometry import Span

from platform_ctrl.app.pictures import Drawing, TimeResponse
from platform_ctrl.app.plots.data import (
    HZ,
    Sources,
    Unit,
    View,
    assign,
    column,
    dashes,
    decades,
    extent,
    finite,
    positive,
    quantity,
    series,
    thinned,
)
from platform_ctrl.app.plots.panel import Key, Panel, Theme, limit_key, overlay_keys, set_message
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray

# Points of a curve, signals in a figure; how far the set's band may widen the view beyond the plant shown.
_POINTS, _SIGNALS, _WIDER = 400, 9, 3.0
# Share of a limit, and size in the plain unit, below which a signal counts as zero.
_NEGLIGIBLE, _ROUNDING = 1e-4, 1e-12
# A signal smaller than this share of the other plants' signals: the view shows those.
_DWARFED = 0.03
# An unstable response is shown up to this many times its size in the first eighth.
_UNSTABLE = 2.0
# Width of a curve, pixels.
_WIDTH = 2.0
# Gains below this share of the peak are shown only when zoomed.
_LEAST_GAIN = 1e-5


class _TimeFigure:
    """A figure of signals in one unit over time."""

    def __init__(self, panel: Panel, name: str, time: View, *, last: bool) -> None:
        self._panel, self._name, self._sources, self._last = panel, name, panel.sources, last
        self._size = View(-1.0, 1.0)
        self.plot = plot = panel.add(time, self._size, "time, s" if last else "", "")
        new = panel.sources.new
        bands = new(f"{name}_bands", lists=("xs", "ys", "colour"))
        drive = new(f"{name}_drive", "t", "share")
        self._bounds = (1.0, panel.bound(plot, "bottom")), (-1.0, panel.bound(plot, "top"))
        plot.extra_y_ranges = {"share": Range1d(start=-1.1, end=1.1)}
        dotted: dict[str, Any] = {"line_width": 1, "line_dash": [2, 3], "y_range_name": "share"}
        panel.draw(plot.line, "t", "share", source=drive, line="reference", **dotted)
        plot.patches("xs", "ys", source=bands, fill_color="colour", fill_alpha=0.16, line_alpha=0.0)
        panel.curves(plot, f"{name}_overlays", 1.3)
        curves = panel.curves(plot, name, _WIDTH, "unit")
        rows = [("@name", "$snap_y{0.[000]} @unit"), ("time", "$snap_x{0.[0000]} s")]
        panel.hover(plot, [curves], rows, line_policy="interp")
        self._message = panel.message(plot)
        self._unit = Unit()
        self._shown = False
        self.used = True
        # Names of the signals with the roles of their colours, and the key of the limit.
        self.signals: list[tuple[str, str]] = []
        self.limits: list[Key] = []

    def show(
        self, picture: Drawing, response: TimeResponse, rows: list[int], unit: str, limit: float | None, own: str
    ) -> None:
        """Follow the `rows` of a response in one unit; `own` is its field in the overlays."""
        self.used = bool(rows)
        at = thinned(len(response.t), _POINTS)
        t, values = column(response.t[at]), response.values[rows][:, at]
        band = response.low.size > 0 and picture.stable  # the band of an unstable loop says nothing
        low, high = (response.low[rows][:, at], response.high[rows][:, at]) if band else (values, values)
        limit = limit if limit is not None and 0.0 < limit < math.inf else None
        responses = [(j, getattr(one, own)) for j, one in enumerate(picture.bode.overlays)]
        others = [(j, one) for j, one in responses if rows and (one.signals, one.units) == _signals(response)]
        if picture.stable:
            seen = _view([values], [low, high, *(one.values[rows] for _, one in others)], limit)
        else:
            # An unbounded response is shown at its beginning.
            seen = None if self._shown else _view([_UNSTABLE * values[:, : 1 + len(at) // 8]], [], limit)
        self._shown = self._shown or seen is not None
        self._unit.follow(unit, max(abs(seen[0]), abs(seen[1])) if seen is not None else math.nan)
        scale = self._unit.scale
        roles = [series(response.series[i]) for i in rows]
        colours = [self._panel.theme.colours[role] for role in roles]
        names = [greek(response.signals[i]) for i in rows]
        own_curves = [(name, role, (), t, column(y, scale)) for name, role, y in zip(names, roles, values, strict=True)]
        self._panel.put_curves(self._name, own_curves, unit=[self._unit.name] * len(names))
        edges = zip(low, high, strict=True) if band else ()
        areas = [_outline(t, column(a, scale), column(b, scale)) for a, b in edges]
        self._sources.put(
            f"{self._name}_bands", xs=[x for x, _ in areas], ys=[y for _, y in areas], colour=colours[: len(areas)]
        )
        designs = [one.design for one in picture.bode.overlays]
        drawn = [
            (designs[j], role, dashes(1 + j), column(one.t[some]), column(one.values[i, some], scale))
            for j, one in others
            for some in [thinned(len(one.t), _POINTS)]
            for i, role in zip(rows, roles, strict=True)
        ]
        self._panel.put_curves(f"{self._name}_overlays", drawn)
        # A constant needs no curve.
        varies = len(response.drive) == len(response.t) and not self._last and len(np.unique(response.drive[1:])) > 1
        drive = column(response.drive[at] if varies else [])
        self._sources.put(f"{self._name}_drive", t=t if varies else column([]), share=drive)
        if seen is not None:
            self._size.fit((scale * seen[0], scale * seen[1]))
        assign(self.plot.yaxis[0], axis_label=self._unit.name)
        for sign, bound in self._bounds:
            bound(None if limit is None else sign * scale * limit)
        trouble = "" if picture.stable or self._last else "closed loop not stable"
        lost = bool(rows) and not np.isfinite(column(values)).any()
        set_message(self._message, "no finite response" if lost else trouble)
        self.signals = list(zip(names, roles, strict=True))
        self.limits = [] if limit is None else [limit_key(f"limit {quantity(limit, unit)}")]


def _signals(response: TimeResponse) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return response.signals, response.units


def _whole(low: float, high: float) -> tuple[float, float]:
    return low, high if high > low else low + 1.0


def _view(shown: Sequence[FloatArray], others: Sequence[FloatArray], limit: float | None) -> tuple[float, float] | None:
    """Return the curves for a view: the plant shown, the others unless they dwarf it, and a limit nearby."""
    own = extent(shown)
    if own is None:
        return None
    size = max(abs(own[0]), abs(own[1]))
    low, high = extent(others) or own
    low, high = min(own[0], low), max(own[1], high)
    if limit is None and max(-low, high) < _ROUNDING:
        return -1e-6, 1e-6
    if limit is not None and size < _NEGLIGIBLE * limit:
        return -1.1 * limit, 1.1 * limit
    if size > _DWARFED * max(-low, high):
        low, high = max(low, -_WIDER * size), min(high, _WIDER * size)
    if limit is not None:
        # Of a response that leaves its limit far behind, what happens near the limit matters.
        low, high = max(low, -4.0 * limit), min(high, 4.0 * limit)
        if low < -0.5 * limit:
            low = min(low, -1.1 * limit)
        if high > 0.5 * limit:
            high = max(high, 1.1 * limit)
    return low, high


def _outline(t: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """Return the closed outline of a band."""
    t, low, high = finite(t, low, high)
    return np.concatenate([t, t[::-1]]), np.concatenate([low, high[::-1]])


class TimePanel(Panel):
    """A response over time in two figures: angles, and torques below them."""

    def __init__(self, name: str, title: str, theme: Theme, sources: Sources, source: str) -> None:
        super().__init__(name, title, theme, sources)
        self._time = View(0.0, 1.0, _whole)
        self._figures_over_time = [
            _TimeFigure(self, f"{source}_{k}" if k else source, self._time, last=k > 0) for k in (0, 1)
        ]
        self.crosshair(*(one.plot for one in self._figures_over_time))
        self._visible = True

    def show_response(self, picture: Drawing, response: TimeResponse, own: str) -> None:
        """Follow a response; `own` is its field in the overlays."""
        units = list(dict.fromkeys(response.units))[: len(self._figures_over_time)] or [""]
        words: dict[str, list[str]] = {}
        limits: list[Key] = []
        for k, one in enumerate(self._figures_over_time):
            unit = units[k] if k < len(units) else None
            rows = [i for i, this in enumerate(response.units) if this == unit][:_SIGNALS]
            one.show(picture, response, rows, unit or "", None if k else response.limit, own)
            for name, role in one.signals:
                words.setdefault(role, []).append(name)
            limits += one.limits
        self._time.fit(extent([column(response.t)]))
        self._arrange()
        self.detail = response.title
        # A gimbal's torque has the colour of its angle. Other designs have the colours of the signals, and dashes.
        signals: list[Key] = [(", ".join(names), role, (), _WIDTH) for role, names in words.items()]
        designs: list[Key] = [(one.design, "muted", dashes(1 + j), 1.3) for j, one in enumerate(picture.bode.overlays)]
        self.keys = [*signals, *limits, *designs]

    def set_visible(self, visible: bool) -> None:
        """Show the figures over time, or hide them."""
        self._visible = visible
        self._arrange()

    def _arrange(self) -> None:
        first, second = self._figures_over_time
        assign(first.plot, visible=self._visible)
        assign(second.plot, visible=self._visible and second.used)
        # Times are written once, below the lower figure.
        self.label_ticks(first.plot, not second.used, "time, s")


class StepPanel(TimePanel):
    """Step response: a torque step to the angles, or to the attitude."""

    def __init__(self, theme: Theme, sources: Sources) -> None:
        super().__init__("step", "Step response", theme, sources, "step")

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        self.show_response(picture, picture.step, "step")


class RatePanel(TimePanel):
    """Response to Omega, or of the free platform to a torque on it, over time or over frequency."""

    def __init__(self, theme: Theme, sources: Sources, frequency: View, mouse: Span) -> None:
        super().__init__("Omega", "Disturbance", theme, sources, "Omega_time")
        self._gain = View(1e-3, 1.0, decades, logarithmic=True)
        self._plot = plot = self.add(frequency, self._gain, "frequency, Hz", "")
        lines = sources.new("Omega_gain", "frequency", "gain")
        band = sources.new("Omega_gain_band", "frequency", "low", "high")
        self._bound = self.bound(plot, "bottom")
        self.draw(plot.varea, "frequency", "low", "high", source=band, fill="series-1", fill_alpha=0.16)
        self.curves(plot, "Omega_gain_overlays", 1.5)
        line = self.draw(plot.line, "frequency", "gain", source=lines, line="series-1", line_width=2.2)
        rows = [("frequency", "@frequency{0.[000]} Hz"), ("gain", "@gain{0.[0000]}")]
        self.hover(plot, [line], rows, mode="vline", line_policy="interp")
        self.crosshair(plot, vertical=mouse)
        self._message = self.message(plot)
        self._unit = Unit()
        self._over_frequency = False
        plot.visible = False
        self._picture: Drawing | None = None

    @property
    def other(self) -> str:  # type: ignore[override]
        """What the panel can show instead."""
        return "time" if self._over_frequency else "frequency"

    def turn(self) -> None:
        """Show the response over frequency in place of that over time, or over time again."""
        self._over_frequency = not self._over_frequency
        self._plot.visible = self._over_frequency
        self.set_visible(not self._over_frequency)
        if self._picture is not None:
            self.show(self._picture)

    def show(self, picture: Drawing) -> None:
        """Follow a picture with the figures that are visible."""
        self._picture = picture
        if self._over_frequency:
            self._show_gain(picture)
        else:
            self.show_response(picture, picture.Omega_time, "Omega_step")

    def _show_gain(self, picture: Drawing) -> None:
        response, overlays, put = picture.Omega_frequency, picture.bode.overlays, self.sources.put
        gain = positive(response.gain)
        top = extent([gain])
        size = top[1] if top is not None else math.nan
        limit = response.limit if response.limit is not None and 0.0 < response.limit < math.inf else None
        self._unit.follow(response.unit, size)
        scale = self._unit.scale
        frequency = column(response.frequency * HZ)
        put("Omega_gain", frequency=frequency, gain=column(gain, scale))
        band = column(response.band_frequency * HZ), column(response.low, scale), column(response.high, scale)
        f, low, high = finite(*band)
        # A logarithmic axis has no zero.
        floor = column(_LEAST_GAIN * scale * size if size > 0.0 else 1e-30)
        put("Omega_gain_band", frequency=f, low=np.maximum(low, floor), high=np.maximum(high, floor))
        own = [(k, one) for k, one in enumerate(overlays) if len(one.Omega_gain) == len(response.frequency)]
        gains = [(k, one.design, column(positive(one.Omega_gain), scale)) for k, one in own]
        self.put_curves(
            "Omega_gain_overlays", [(name, series(1 + k), dashes(1 + k), frequency, y) for k, name, y in gains]
        )
        self._bound(None if limit is None else scale * limit)
        if top is not None:
            # A limit close by is shown too.
            high_end = size if limit is None or not size / 30.0 < limit < 30.0 * size else max(size, 1.5 * limit)
            self._gain.fit((scale * max(top[0], _LEAST_GAIN * size), scale * high_end))
        self._plot.yaxis[0].axis_label = self._unit.name
        trouble = "" if picture.stable else "closed loop not stable"
        set_message(self._message, "no finite response" if top is None else trouble)
        self.detail = response.title
        limits = [] if limit is None else [limit_key(f"limit {quantity(limit, response.unit)}")]
        self.keys = [(picture.settings.design, "series-1", (), 2.2), *overlay_keys(overlays), *limits]
