"""Nichols plot of the loop with all plants of the set, and the region that the required disk margin excludes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from platform_ctrl.app.pictures import Drawing, Nichols
from platform_ctrl.app.plots.data import (
    Column,
    Sources,
    View,
    column,
    decibels,
    extent,
    joined_curves,
    stepped,
    thinned,
)
from platform_ctrl.app.plots.panel import OverlayCurves, Panel, Theme, overlay_keys, set_message

# Points of a thin line, plants that are drawn, points of a region's rim.
_POINTS, _PLANTS, _RIM = 110, 64, 121
# Gains beyond these are shown only when zoomed, dB.
_LOWEST, _HIGHEST = -30.0, 40.0


class NicholsPanel(Panel):
    """The Nichols diagram."""

    def __init__(self, theme: Theme, sources: Sources, overlays: OverlayCurves) -> None:
        super().__init__("nichols", "Nichols", theme, sources)
        self._phase = View(-360.0, 0.0, stepped(45.0, -720.0, 180.0))
        self._gain = View(-40.0, 40.0, stepped(10.0, _LOWEST, _HIGHEST))
        plot = self.add(self._phase, self._gain, "phase, °", "gain, dB")
        self.degrees(plot.xaxis[0])
        self.decibels(plot.yaxis[0])
        regions = sources.new("regions", lists=("xs", "ys"))
        critical = sources.new("critical", "phase", "gain")
        plants = sources.new("plants", "phase", "gain")
        self.draw(plot.patches, "xs", "ys", source=regions, line="reference", fill="band", line_width=1)
        self.span(plot, "width", "reference", location=0.0)
        self.draw(plot.line, "phase", "gain", source=plants, line="series-1", line_width=0.7, line_alpha=0.35)
        overlays.draw(plot, "phases", "gains")
        loop = sources.by_name["loop"]
        line = self.draw(plot.line, "phase", "gain", source=loop, line="series-1", line_width=2.2)
        look: dict[str, Any] = {"marker": "cross", "size": 11, "line_width": 2}
        self.draw(plot.scatter, "phase", "gain", source=critical, line="limit", **look)
        rows = [("phase", "@phase{0.0}°"), ("gain", "@gain{0.0} dB"), ("frequency", "@frequency{0.[000]} Hz")]
        self.hover(plot, [line], rows, line_policy="interp")
        self.crosshair(plot)
        self._message = self.message(plot)
        self._drawn: tuple[float | None, tuple[float, float]] | None = None

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        nichols, required = picture.nichols, picture.nichols.disk_margin
        phase, gain = _thin_curves(nichols)
        self.sources.put("plants", phase=phase, gain=gain)
        loop = self.sources.by_name["loop"].data
        phases, gains = (np.concatenate([loop[name], one]) for name, one in (("phase", phase), ("gain", gain)))
        seen = extent([phases[np.isfinite(gains) & (gains > _LOWEST) & (gains < _HIGHEST)]])
        # The critical point is always in view, with 90 degrees on both sides.
        self._phase.fit(None if seen is None else (min(seen[0], -270.0), max(seen[1], -90.0)))
        self._gain.fit(extent([gains]))
        self._regions(required)
        others = len(nichols.labels) - 1
        self.heading("" if required is None else f"grey: disk margin {required:g}")
        set_of_plants = [(f"{others} more plants", "series-1", (), 0.9)] if others else []
        self.keys([("L", "series-1", (), 2.2), *set_of_plants, *overlay_keys(picture.bode.overlays)])
        empty = not (np.isfinite(loop["phase"]).any() and np.isfinite(loop["gain"]).any())
        trouble = "no finite response of this loop" if empty else "" if picture.stable else "closed loop not stable"
        set_message(self._message, trouble)

    def _regions(self, alpha: float | None) -> None:
        if alpha is not None and not 0.0 < alpha < 2.0:
            alpha = None
        # Wherever the user may move the view: two turns beyond it.
        left, right = self._phase.rest
        key = (alpha, (left, right))
        if key == self._drawn:
            return
        self._drawn = key
        first, last = math.ceil((left - 540.0) / 360.0), math.floor((right + 900.0) / 360.0)
        centres = [360.0 * k - 180.0 for k in range(first, last + 1)]
        self.sources.put("critical", phase=column(centres), gain=column(np.zeros(len(centres))))
        if alpha is None:
            self.sources.put("regions", xs=[], ys=[])
            return
        turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, _RIM))
        # |S - 1/2| = 1/alpha there (skew 0); near -180 degrees the angle of -L has no jump.
        rim = -(1.0 - 0.5 * alpha * turn) / (1.0 + 0.5 * alpha * turn)
        x, y = np.degrees(np.angle(-rim)), decibels(np.abs(rim))
        self.sources.put("regions", xs=[column(c + x) for c in centres], ys=[y] * len(centres))


def _thin_curves(nichols: Nichols) -> tuple[Column, Column]:
    """Return phase and gain of the other plants as one line with gaps, thinned."""
    if len(nichols.labels) < 2:
        return column([]), column([])
    at = thinned(nichols.phase.shape[1], _POINTS)
    rows = thinned(len(nichols.phase) - 1, _PLANTS) + 1
    phase = joined_curves(nichols.phase[rows][:, at])
    with np.errstate(divide="ignore", invalid="ignore"):
        return phase, joined_curves(20.0 * np.log10(nichols.magnitude[rows][:, at]))
