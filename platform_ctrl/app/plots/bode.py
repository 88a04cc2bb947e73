"""Gain and phase of the loop over frequency, with the set's band, other designs, margins, and a crossover to drag."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.app.pictures import Bode, Drawing
from platform_ctrl.app.plots.data import HZ, Sources, View, column, decibels, extent, finite, stepped
from platform_ctrl.app.plots.handles import CrossoverHandle
from platform_ctrl.app.plots.panel import OverlayCurves, Panel, Theme, limit_key, overlay_keys, set_message
from platform_ctrl.common.values import FloatArray

_BAND = ("frequency", "gain_low", "gain_high", "phase_low", "phase_high")
_MARKS = ("frequency", "gain0", "gain1", "phase0", "phase1")


class BodePanel(Panel):
    """The Bode diagram."""

    def __init__(self, theme: Theme, sources: Sources, frequency: View) -> None:
        super().__init__("bode", "Bode", theme, sources)
        self._frequency = frequency
        self._gain = View(-40.0, 40.0, stepped(20.0, -80.0, 80.0))
        self._phase = View(-360.0, 0.0, stepped(90.0, -720.0, 360.0))
        above = self.add(frequency, self._gain, "", "gain, dB")
        below = self.add(frequency, self._phase, "frequency, Hz", "phase, °")
        self.label_ticks(above, False)
        self.decibels(above.yaxis[0])
        self.degrees(below.yaxis[0])
        loop = sources.new("loop", "frequency", "gain", "phase")
        band, marks = sources.new("band", *_BAND), sources.new("margins", *_MARKS)
        self.overlays = OverlayCurves(sources, theme)
        self._nyquist, self._required = [], []
        rows = [("frequency", "@frequency{0.[000]} Hz"), ("gain", "@gain{0.0} dB"), ("phase", "@phase{0}°")]
        for plot, name, level in ((above, "gain", 0.0), (below, "phase", -180.0)):
            ends = f"{name}_low", f"{name}_high"
            self.draw(plot.varea, "frequency", *ends, source=band, fill="series-1", fill_alpha=0.16)
            self.span(plot, "width", "reference", location=level)
            self._nyquist.append(self.span(plot, "height", "reference", line_dash=[2, 3]))
            self._required.append(self.limit_line(plot, "height"))
            self.overlays.draw(plot, "xs", f"{name}s")
            line = self.draw(plot.line, "frequency", name, source=loop, line="series-1", line_width=2.2)
            mark = "frequency", f"{name}0", "frequency", f"{name}1"
            self.draw(plot.segment, *mark, source=marks, line="ink", line_width=2)
            self.draw(plot.scatter, "frequency", f"{name}1", source=marks, line="ink", fill="page", size=6)
            self.hover(plot, [line], rows, mode="vline", line_policy="interp")
        self.crosshair(above, below)
        self.handle = CrossoverHandle(above, theme)
        self._message = self.message(above)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        bode, crossover, required = picture.bode, picture.crossover, picture.bandwidth
        f, gain, phase = column(bode.frequency * HZ), decibels(bode.magnitude), column(bode.phase)
        self.sources.put("loop", frequency=f, gain=gain, phase=phase)
        band = finite(
            column(bode.band_frequency * HZ),
            decibels(bode.magnitude_low),
            decibels(bode.magnitude_high),
            column(bode.phase_low),
            column(bode.phase_high),
        )
        self.sources.put("band", **dict(zip(_BAND, band, strict=True)))
        self.overlays.show(bode.overlays, bode.frequency)
        marks = _margin_marks(bode) if picture.stable else np.zeros((0, 5))
        self.sources.put("margins", **{name: column(marks[:, k]) for k, name in enumerate(_MARKS)})
        for span in self._nyquist:
            span.location = float(bode.nyquist * HZ) if math.isfinite(bode.nyquist) else None
        for span in self._required:
            span.location = required
        # An axis that moves would move the crossover under the mouse.
        self._frequency.fit(None if self.handle.drag.active else extent([f]))
        self._gain.fit(extent([gain, band[1], band[2]]))
        self._phase.fit(extent([phase]))
        self.handle.show(None if crossover is None else crossover * HZ)
        self.heading(f"L at {bode.channel}, others closed")
        limits = [limit_key("required bandwidth")] if required is not None else []
        self.keys([(picture.settings.design or "L", "series-1", (), 2.2), *overlay_keys(bode.overlays), *limits])
        empty = not (np.isfinite(gain).any() and np.isfinite(phase).any())
        set_message(self._message, "no finite response of this loop" if empty else _trouble(picture))


def _trouble(picture: Drawing) -> str:
    if not picture.stable:
        return "closed loop not stable"
    if not picture.all_stable:
        return "not stable with all plants"
    return "" if picture.crossover is not None else "the gain never passes 1: no crossover"


def _margin_marks(bode: Bode) -> FloatArray:
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
        share = np.clip((critical - phase[jumps]) / (phase[jumps + 1] - phase[jumps]), 0.0, 1.0)
        where = x[jumps] + share * (x[jumps + 1] - x[jumps])
        level_there = level[jumps] + share * (level[jumps + 1] - level[jumps])
        for side in (level_there < 0.0, level_there > 0.0):
            if side.any():
                k = int(np.flatnonzero(side)[np.argmin(np.abs(level_there[side]))])
                rows.append((math.exp(where[k]) * HZ, 0.0, level_there[k], math.nan, math.nan))
    return np.array(rows).reshape(-1, 5)
