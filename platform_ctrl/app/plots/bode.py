"""Gain and phase of the loop over frequency, with the set's band, other designs, margins, and a crossover to drag."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource
from bokeh.models.annotations.geometry import BoxAnnotation, Span

from platform_ctrl.app.pictures import Bode, Drawing
from platform_ctrl.app.plots.data import (
    LIMIT_DASHES,
    Sources,
    View,
    column,
    decibels,
    extent,
    finite,
    inner_width,
    stepped,
)
from platform_ctrl.app.plots.handles import Drag
from platform_ctrl.app.plots.panel import Key, OverlayCurves, Panel, Theme, overlay_keys, tell
from platform_ctrl.common.values import FloatArray

# Half the width of the bar, pixels: wide enough to be caught.
_HALF = 6.0
RAD_PER_S = 2.0 * math.pi


class CrossoverHandle:
    """A bar over the crossover, to be dragged along the frequency axis."""

    def __init__(self, plot: Any, theme: Theme) -> None:
        self.callbacks: list[Callable[[float], None]] = []
        self._plot = plot
        self._shown: float | None = None
        # Where it was put last; while the document holds its events, news of that comes later.
        self._put: tuple[float, float] | None = None
        self.box: Any = BoxAnnotation(
            left=1.0, right=2.0, editable=True, movable="x", resizable="none", visible=False, name="crossover-handle",
            fill_alpha=0.14, hover_fill_alpha=0.38, line_alpha=0.0, hover_line_alpha=0.0, propagate_hover=True,
        )  # fmt: skip
        theme.paint(self.box, fill_color="series-1", hover_fill_color="series-1")
        plot.add_layout(self.box)
        self.line: Any = Span(dimension="height", location=None, line_width=1.2)
        theme.paint(self.line, line_color="series-1")
        plot.add_layout(self.line)
        self.drag: Drag[float] = Drag(plot, self._dragged, self._place)
        for name in ("left", "right"):
            self.box.on_change(name, self._moved)
        for name in ("start", "end"):
            plot.x_range.on_change(name, self._zoomed)
        plot.on_change("inner_width", self._zoomed)

    def show(self, frequency: float | None) -> None:
        """Stand at the crossover, Hz, or nowhere; a bar that is being dragged stays under the mouse."""
        self._shown = frequency if frequency is not None and math.isfinite(frequency) and frequency > 0.0 else None
        self.line.location = self._shown
        if not self.drag.active:
            self._place()

    def _place(self) -> None:
        if self._shown is None:
            self.box.visible = False
            return
        half = self._half()
        left, right = self._put = self._shown / half, self._shown * half
        self.box.update(left=left, right=right, visible=True)

    def _half(self) -> float:
        """Return the factor that half the bar's width is on the axis."""
        low, high = self._plot.x_range.start, self._plot.x_range.end
        if not (isinstance(low, int | float) and isinstance(high, int | float) and 0.0 < low < high < math.inf):
            return 1.05
        return math.exp(math.log(high / low) * min(_HALF / inner_width(self._plot), 0.2))

    def _zoomed(self, name: str, old: object, new: object) -> None:
        if not self.drag.active:
            self._place()

    def _moved(self, name: str, old: object, new: object) -> None:
        left, right = self.box.left, self.box.right
        if not all(isinstance(end, int | float) and 0.0 < end < math.inf for end in (left, right)):
            return
        if self._put is not None and (left == self._put[0] or right == self._put[1]):
            return
        if name == "right":  # both ends come one after the other, this one last
            self.drag.move(math.sqrt(left * right))

    def _dragged(self, frequency: float) -> None:
        for callback in self.callbacks:
            callback(RAD_PER_S * frequency)


HZ = 1.0 / (2.0 * math.pi)


class BodePanel:
    """The Bode diagram."""

    def __init__(self, theme: Theme, sources: Sources, frequency: View) -> None:
        self.panel = Panel("bode", "Bode", theme)
        self._sources, self._frequency = sources, frequency
        self._gain = View(-40.0, 40.0, stepped(20.0, -80.0, 80.0))
        self._phase = View(-360.0, 0.0, stepped(90.0, -720.0, 360.0))
        above = self.panel.add(frequency, self._gain, "", "gain, dB", log_x=True)
        below = self.panel.add(frequency, self._phase, "frequency, Hz", "phase, °", log_x=True)
        self.above, self.below = above, below
        self.panel.label_ticks(above, False)
        self.panel.decibels(above.yaxis[0])
        self.panel.degrees(below.yaxis[0])
        self._loop: ColumnDataSource = sources.new("loop", "frequency", "gain", "phase")
        self._band = sources.new("band", "frequency", "gain_low", "gain_high", "phase_low", "phase_high")
        self._marks = sources.new("margins", "frequency", "gain0", "gain1", "phase0", "phase1")
        self._nyquist: list[Span] = []
        self._required: list[Span] = []
        paint = theme.paint
        for plot, name, level in ((above, "gain", 0.0), (below, "phase", -180.0)):
            area = plot.varea("frequency", f"{name}_low", f"{name}_high", source=self._band, fill_alpha=0.16)
            paint(area.glyph, fill_color="series-1")
            level_line = Span(dimension="width", location=level, line_width=1)
            nyquist = Span(dimension="height", location=None, line_width=1, line_dash=[2, 3])
            paint(level_line, line_color="reference")
            paint(nyquist, line_color="reference")
            plot.add_layout(level_line)
            plot.add_layout(nyquist)
            self._nyquist.append(nyquist)
            required = Span(dimension="height", location=None, line_width=1.5, line_dash=list(LIMIT_DASHES))
            paint(required, line_color="limit")
            plot.add_layout(required)
            self._required.append(required)
        self.overlays = OverlayCurves(sources, theme)
        self.overlays.draw(above, "xs", "gains")
        self.overlays.draw(below, "xs", "phases")
        loops = []
        for plot, name in ((above, "gain"), (below, "phase")):
            line = plot.line("frequency", name, source=self._loop, line_width=2.2)
            paint(line.glyph, line_color="series-1")
            loops.append(line)
            mark = plot.segment("frequency", f"{name}0", "frequency", f"{name}1", source=self._marks, line_width=2)
            end = plot.scatter("frequency", f"{name}1", source=self._marks, size=6)
            paint(mark.glyph, line_color="ink")
            paint(end.glyph, fill_color="page", line_color="ink")
        rows = [("frequency", "@frequency{0.[000]} Hz"), ("gain", "@gain{0.0} dB"), ("phase", "@phase{0}°")]
        for plot, line in zip((above, below), loops, strict=True):
            self.panel.hover(plot, [line], rows, mode="vline", line_policy="interp")
        self.panel.crosshair(above, below)
        self.handle = CrossoverHandle(above, theme)
        self._message = self.panel.message(above)

    def on_dragged(self, callback: Callable[[float], None]) -> None:
        """Call `callback` with a frequency, rad/s, while the crossover is dragged."""
        self.handle.callbacks.append(callback)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        bode, crossover = picture.bode, picture.crossover
        f = column(bode.frequency * HZ)
        gain, phase = decibels(bode.magnitude), column(bode.phase)
        self._sources.put("loop", frequency=f, gain=gain, phase=phase)
        band = finite(
            column(bode.band_frequency * HZ),
            decibels(bode.magnitude_low),
            decibels(bode.magnitude_high),
            column(bode.phase_low),
            column(bode.phase_high),
        )
        self._sources.put(
            "band",
            **dict(zip(("frequency", "gain_low", "gain_high", "phase_low", "phase_high"), band, strict=True)),
        )
        self.overlays.show(bode.overlays, bode.frequency)
        marks = _marks(bode) if picture.stable else np.zeros((0, 5))
        names = ("frequency", "gain0", "gain1", "phase0", "phase1")
        self._sources.put("margins", **{name: column(marks[:, k]) for k, name in enumerate(names)})
        nyquist = bode.nyquist * HZ
        for span in self._nyquist:
            span.location = float(nyquist) if math.isfinite(nyquist) else None
        required = picture.bandwidth
        for span in self._required:
            span.location = required
        seen = extent([f])
        # An axis that moves would move the crossover under the mouse.
        still = self.handle.drag.active or seen is None or seen[0] <= 0.0
        self._frequency.fit(None if still else seen)
        self._gain.fit(extent([gain, band[1], band[2]]))
        self._phase.fit(extent([phase]))
        self.handle.show(None if crossover is None else crossover * HZ)
        self.panel.say(f"L at {bode.channel}, others closed")
        keys: list[Key] = [(picture.settings.design or "L", "series-1", (), 2.2)]
        self.panel.keys(
            [
                *keys,
                *overlay_keys(bode.overlays),
                *([("required bandwidth", "limit", LIMIT_DASHES, 1.5)] if required is not None else []),
            ]
        )
        empty = not (np.isfinite(gain).any() and np.isfinite(phase).any())
        tell(self._message, "no finite response of this loop" if empty else _trouble(picture))


def _trouble(picture: Drawing) -> str:
    if not picture.stable:
        return "closed loop not stable"
    if not picture.all_stable:
        return "not stable with all plants"
    return "" if picture.crossover is not None else "the gain never passes 1: no crossover"


def _marks(bode: Bode) -> FloatArray:
    """Return rows of frequency, gain from and to, phase from and to: the least phase and gain margins as lengths."""
    f, gain, phase = bode.frequency, bode.magnitude, bode.phase
    fine = np.isfinite(f) & np.isfinite(gain) & np.isfinite(phase) & (gain > 0.0) & (f > 0.0)
    if fine.sum() < 2:
        return np.zeros((0, 5))
    x, level, phase = np.log(f[fine]), 20.0 * np.log10(gain[fine]), phase[fine]
    rows = []
    crossovers = bode.crossovers[np.isfinite(bode.crossovers) & (bode.crossovers > 0.0)]
    if crossovers.size:
        at = np.interp(np.log(crossovers), x, phase)
        critical = 360.0 * np.round((at + 180.0) / 360.0) - 180.0
        k = int(np.argmin(np.abs(at - critical)))
        rows.append((crossovers[k] * HZ, math.nan, math.nan, critical[k], at[k]))
    turns = np.floor((phase + 180.0) / 360.0)
    jumps = np.flatnonzero(np.diff(turns))
    if jumps.size:
        critical = 360.0 * np.maximum(turns[jumps], turns[jumps + 1]) - 180.0
        step = phase[jumps + 1] - phase[jumps]
        share = np.clip((critical - phase[jumps]) / step, 0.0, 1.0)
        where = x[jumps] + share * (x[jumps + 1] - x[jumps])
        level_there = level[jumps] + share * (level[jumps + 1] - level[jumps])
        for side in (level_there < 0.0, level_there > 0.0):
            if side.any():
                k = int(np.flatnonzero(side)[np.argmin(np.abs(level_there[side]))])
                rows.append((math.exp(where[k]) * HZ, 0.0, level_there[k], math.nan, math.nan))
    return np.array(rows).reshape(-1, 5)
