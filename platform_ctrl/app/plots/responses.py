"""Responses over time, and the response to a disturbance over time or frequency."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from platform_ctrl.analysis.curves import Curve, Curves, Level
from platform_ctrl.app.pictures import Drawing, TimeResponse
from platform_ctrl.app.plots.loop import designs, positive
from platform_ctrl.app.plots.painter import Axis, Panel, Theme
from platform_ctrl.app.plots.views import View, column, decades, extent, thinned
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import HZ, quantity

# Points of a curve, signals in a figure; how far the set's band may widen the view beyond the plant shown.
_POINTS, _SIGNALS, _WIDER = 400, 9, 3.0
# Share of a limit, and size in the plain unit, below which a signal counts as zero.
_NEGLIGIBLE, _ROUNDING = 1e-4, 1e-12
# A signal smaller than this share of the other plants' signals: the view shows those.
_DWARFED = 0.03
# An unstable response is shown up to this many times its size in the first eighth.
_UNSTABLE = 2.0
# A view that changes nothing.
_AS_IT_IS = (math.nan, math.nan)
# Gains below this share of the peak are shown only when zoomed.
_LEAST_GAIN = 1e-5


def over_time(picture: Drawing, name: str, unbounded: bool) -> dict[int, Curves]:
    """Return a response of a picture in two figures by units: angles, and torques.

    The view of an unstable loop is left as it is unless it is still `unbounded`.
    """
    response: TimeResponse = getattr(picture, name)
    units = list(dict.fromkeys(response.units))[:2] or [""]
    others = [(look, getattr(one, name)) for look, one in designs(picture)]
    out = {}
    for k, unit in enumerate(units):
        limit = response.limit if k == 0 and response.limit and 0.0 < response.limit < math.inf else None
        rows = [i for i, this in enumerate(response.units) if this == unit][:_SIGNALS]
        curves = _signals(response, rows, banded=picture.stable)
        same = [(look, one) for look, one in others if (one.signals, one.units) == (response.signals, response.units)]
        for look, one in same:
            curves += _signals(one, rows, look)
            # Other designs have the colours of the signals, and dashes.
            more = {"name": look["name"], "dashes": look["dashes"], "role": "muted"}
            curves.append(Curve(x=np.zeros(0), y=np.zeros(0), **more))
        values = response.values[rows]
        if picture.stable:
            low, high = (response.low[rows], response.high[rows]) if response.low.size else (values, values)
            view = _view([values], [low, high, *(one.values[rows] for _, one in same)], limit)
        else:
            # An unbounded response is shown at its beginning.
            early = values[:, : 1 + values.shape[1] // 8]
            view = (_view([_UNSTABLE * early], [], limit) if unbounded else None) or _AS_IT_IS
        # A constant needs no curve.
        if k == 0 and view is not None and len(np.unique(response.drive[1:])) > 1:
            curves.append(
                Curve(x=response.t, y=0.9 * max(view) * response.drive, form="thin", role="reference", dashes=2)
            )
        levels = () if limit is None else (
            Level(y=limit, text=f"limit {quantity(limit, unit)}", shaded=True), Level(y=-limit, text="", shaded=True)
        )  # fmt: skip
        out[k] = Curves(curves=tuple(curves), unit=unit, levels=levels, view=view)
    return out


def _signals(
    response: TimeResponse, rows: list[int], look: Mapping[str, Any] | None = None, *, banded: bool = False
) -> list[Curve]:
    """Return signals, and behind them their bands; with a `look` those of another design."""
    at = thinned(len(response.t), _POINTS)
    t, out, bands = response.t[at], [], []
    for i in rows:
        about: dict[str, Any] = {"x": t, "series": response.series[i]}
        own: dict[str, Any] = {"name": greek(response.signals[i]), "form": "strong"}
        if look is not None:
            own = {"words": (look["name"],), "dashes": look["dashes"]}
        out.append(Curve(y=response.values[i, at], **own, **about))
        if banded and response.low.size:
            bands.append(Curve(y=response.low[i, at], top=response.high[i, at], form="band", **about))
    return [*out, *bands]


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


class TimePanel(Panel):
    """A response over time in two figures: angles, and torques below them."""

    def __init__(self, theme: Theme, name: str, title: str, response: str, parts: str = "bands lines") -> None:
        super().__init__(name, title, theme)
        self._response = response
        self._fitted = False
        time = Axis(View(0.0, 1.0, _whole), "time, s", "time", "{0.[0000]} s", "mouse")
        for last in (False, True):
            self.add(time, View(-1.0, 1.0), "{0.[000]}", parts if not last else "bands lines", last=last)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        super().show(picture)
        response: TimeResponse = getattr(picture, self._response)
        shown = over_time(picture, self._response, not self._fitted)
        known = bool(np.isfinite(column(response.values)).any())
        self._fitted = self._fitted or known
        trouble = "" if picture.stable else "closed loop not stable"
        self.put(shown, response.title, trouble if known else "no finite response")


class DisturbancePanel(TimePanel):
    """Response to Omega, or of the free platform to a torque on it, over time or over frequency."""

    others = ("frequency", "time")

    def __init__(self, theme: Theme, frequency: Axis) -> None:
        super().__init__(theme, "Omega", "Disturbance", "Omega_time", "strips bands ground levels lines")
        self._frequency = frequency

    def show(self, picture: Drawing) -> None:
        """Follow a picture with the figures that are visible."""
        if not self.turned:
            super().show(picture)
            return
        self.picture = picture
        if len(self.figures) == 2:
            view = View(1e-3, 1.0, decades, logarithmic=True)
            self.add(self._frequency, view, "{0.[0000]}", "strips bands levels lines")
        response = picture.Omega_frequency
        known = extent([positive(response.gain)]) is not None
        trouble = "" if picture.stable else "closed loop not stable"
        self.put({2: over_frequency(picture)}, response.title, trouble if known else "no finite response")


def over_frequency(picture: Drawing) -> Curves:
    """Return the gain of a disturbance over frequency."""
    response, limit = picture.Omega_frequency, picture.Omega_frequency.limit
    limit = limit if limit is not None and 0.0 < limit < math.inf else None
    gain = positive(response.gain)
    top, view = extent([gain]), None
    f = response.frequency * HZ
    curves = [Curve(x=f, y=gain, name=picture.settings.design, form="strong")]
    for look, one in designs(picture):
        other = one.Omega_frequency
        curves.append(Curve(x=other.frequency * HZ, y=positive(other.gain), **look))
    if top is not None:
        size = top[1]
        # A logarithmic axis has no zero.
        low, high = (np.maximum(one, _LEAST_GAIN * size) for one in (response.low, response.high))
        if low.size:
            curves.append(Curve(x=response.band_frequency * HZ, y=low, top=high, form="band"))
        # A limit close by is shown too.
        near = limit is not None and size / 30.0 < limit < 30.0 * size
        view = max(top[0], _LEAST_GAIN * size), max(size, 1.5 * limit) if near and limit is not None else size
    levels = () if limit is None else (Level(y=limit, text=f"limit {quantity(limit, response.unit)}", shaded=True),)
    return Curves(curves=tuple(curves), unit=response.unit, levels=levels, view=view)
