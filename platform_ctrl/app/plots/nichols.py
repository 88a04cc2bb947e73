"""Gain over phase of the loop with all plants of the set, and the region that the required disk margin keeps free."""

from __future__ import annotations

import math

import numpy as np
from bokeh.models.annotations.geometry import Span

from platform_ctrl.app.pictures import Drawing, Nichols
from platform_ctrl.app.plots.data import Column, Sources, View, column, decibels, extent, stepped, strung, thinned
from platform_ctrl.app.plots.panel import OverlayCurves, Panel, Theme, overlay_keys, tell
from platform_ctrl.common.values import FloatArray

# Points of a thin line, plants that are drawn, points of a region's rim.
_POINTS, _PLANTS, _RIM = 110, 64, 121
# Gains beyond these are not shown at rest, dB.
_LOWEST, _HIGHEST = -30.0, 40.0


class NicholsPanel:
    """The Nichols diagram."""

    def __init__(self, theme: Theme, sources: Sources, overlays: OverlayCurves) -> None:
        self.panel = Panel("nichols", "Nichols", theme)
        self._sources = sources
        self._phase = View(-360.0, 0.0, stepped(45.0, -720.0, 180.0))
        self._gain = View(-40.0, 40.0, stepped(10.0, _LOWEST, _HIGHEST))
        plot = self.panel.add(self._phase, self._gain, "phase, °", "gain, dB")
        self.plot = plot
        self.panel.degrees(plot.xaxis[0])
        self.panel.decibels(plot.yaxis[0])
        regions = sources.new("regions", lists=("xs", "ys"))
        critical = sources.new("critical", "phase", "gain")
        plants = sources.new("plants", "phase", "gain")
        paint = theme.paint
        region = plot.patches("xs", "ys", source=regions, line_width=1)
        paint(region.glyph, fill_color="band", line_color="reference")
        zero = Span(dimension="width", location=0.0, line_width=1)
        paint(zero, line_color="reference")
        plot.add_layout(zero)
        thin = plot.line("phase", "gain", source=plants, line_width=0.7, line_alpha=0.35)
        paint(thin.glyph, line_color="series-1")
        overlays.draw(plot, "phases", "gains")
        line = plot.line("phase", "gain", source=sources.by_name["loop"], line_width=2.2)
        paint(line.glyph, line_color="series-1")
        cross = plot.scatter("phase", "gain", source=critical, marker="cross", size=11, line_width=2)
        paint(cross.glyph, line_color="limit")
        rows = [("phase", "@phase{0.0}°"), ("gain", "@gain{0.0} dB"), ("frequency", "@frequency{0.[000]} Hz")]
        self.panel.hover(plot, [line], rows, line_policy="interp")
        self.panel.crosshair(plot)
        self._message = self.panel.message(plot)
        self._drawn: tuple[float | None, tuple[float, float]] | None = None

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        nichols = picture.nichols
        phase, gain = _thin(nichols)
        self._sources.put("plants", phase=phase, gain=gain)
        loop = self._sources.by_name["loop"].data
        phases, gains = [np.asarray(loop["phase"])], [np.asarray(loop["gain"])]
        if len(nichols.labels) > 1:
            phases.append(phase)
            gains.append(gain)
        seen = _among(phases, gains)
        # The critical point is always in view, and what is to the left and right of it.
        self._phase.fit(None if seen is None else (min(seen[0], -270.0), max(seen[1], -90.0)))
        self._gain.fit(extent(gains))
        self._regions(nichols.disk_margin)
        others = len(nichols.labels) - 1
        overlays = picture.bode.overlays
        required = nichols.disk_margin
        self.panel.say("" if required is None else f"grey: disk margin {required:g}")
        set_of_plants = [(f"{others} more plants", "series-1", (), 0.9)] if others else []
        self.panel.keys([("L", "series-1", (), 2.2), *set_of_plants, *overlay_keys(overlays)])
        empty = not (np.isfinite(phases[0]).any() and np.isfinite(gains[0]).any())
        if empty:
            tell(self._message, "no finite response of this loop")
        else:
            tell(self._message, "" if picture.stable else "closed loop not stable")

    def _regions(self, alpha: float | None) -> None:
        if alpha is not None and not 0.0 < alpha < 2.0:
            alpha = None
        # Wherever the view may go by hand: two turns beyond what is shown.
        left, right = self._phase.rest
        key = (alpha, (left, right))
        if key == self._drawn:
            return
        self._drawn = key
        first, last = math.ceil((left - 540.0) / 360.0), math.floor((right + 900.0) / 360.0)
        centres = [360.0 * k - 180.0 for k in range(first, last + 1)]
        self._sources.put("critical", phase=column(centres), gain=column(np.zeros(len(centres))))
        if alpha is None:
            self._sources.put("regions", xs=[], ys=[])
            return
        turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, _RIM))
        # |S - 1/2| = 1/alpha there (skew 0); about -180 degrees the angle of -L has no jump.
        rim = -(1.0 - 0.5 * alpha * turn) / (1.0 + 0.5 * alpha * turn)
        x, y = np.degrees(np.angle(-rim)), decibels(np.abs(rim))
        self._sources.put("regions", xs=[column(c + x) for c in centres], ys=[y] * len(centres))


def _thin(nichols: Nichols) -> tuple[Column, Column]:
    """Return all plants as one line with gaps: those first that come first, thinned along the frequencies."""
    if len(nichols.labels) < 2:
        return column([]), column([])
    at = thinned(nichols.phase.shape[1], _POINTS)
    rows = thinned(len(nichols.phase) - 1, _PLANTS) + 1
    return strung(nichols.phase[rows][:, at]), strung(20.0 * _log10(nichols.magnitude[rows][:, at]))


def _log10(gain: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log10(gain))


def _among(phases: list[Column], gains: list[Column]) -> tuple[float, float] | None:
    """Return least and largest phase where the gain is shown."""
    shown = [
        p[np.isfinite(g) & (g > _LOWEST) & (g < _HIGHEST)]
        for p, g in zip(phases, gains, strict=True)
        if p.size == g.size
    ]
    return extent(shown)
