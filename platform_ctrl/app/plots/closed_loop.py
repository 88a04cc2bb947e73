"""The four transfer functions of the closed loop at one torquer: |S| and |T|, |KS|, |PS|, with limits on them."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plots.data import (
    HZ,
    LIMIT_DASHES,
    Column,
    Unit,
    View,
    column,
    dashes,
    decades,
    decibels,
    extent,
    finite,
    positive,
    series,
    stepped,
)
from platform_ctrl.app.plots.panel import Key, Panel, limit_key, overlay_keys

# Of KS and PS: the curve, its words, and what is drawn below this share of the largest gain only when zoomed.
_GAINS = (("KS", "noise → torque", "series-3"), ("PS", "torque → readings", "series-4"))
_LEAST = 1e-4
# Where a bandwidth ends, dB, and what is beyond any view, Hz and dB.
_HALF, _FAR = -10.0 * math.log10(2.0), (1e-6, 200.0)


class ClosedLoopFigures:
    """Three figures of a panel, hidden at first: |S| and |T| in dB, and the gains from noise and from a torque."""

    def __init__(self, panel: Panel, frequency: View) -> None:
        self._panel = panel
        new = panel.sources.new
        self._level = View(-40.0, 20.0, stepped(10.0, -40.0, 30.0))
        first = panel.add(frequency, self._level, "", "gain, dB")
        panel.decibels(first.yaxis[0])
        lines = new("closed_loop", "frequency", "S", "T")
        bands = new("closed_loop_band", "frequency", "S_low", "S_high", "T_low", "T_high")
        self._bound = panel.bound(first, "bottom")
        slow = new("closed_loop_bandwidth", "frequency", "level")
        panel.draw(
            first.line, "frequency", "level", source=slow, line="limit", line_width=1.5, line_dash=list(LIMIT_DASHES)
        )
        panel.span(first, "width", "reference", location=0.0)
        panel.curves(first, "closed_loop_overlays", 1.3)
        drawn = []
        for name, role in (("S", "series-1"), ("T", "series-2")):
            ends = f"{name}_low", f"{name}_high"
            panel.draw(first.varea, "frequency", *ends, source=bands, fill=role, fill_alpha=0.16)
            drawn.append(panel.draw(first.line, "frequency", name, source=lines, line=role, line_width=2.2))
        rows = [("frequency", "@frequency{0.[000]} Hz"), ("|S|", "@S{0.0} dB"), ("|T|", "@T{0.0} dB")]
        panel.hover(first, drawn[:1], rows, mode="vline", line_policy="interp")
        self._figures = [first]
        self._units = [Unit() for _ in _GAINS]
        self._views = [View(1e-3, 1.0, decades, logarithmic=True) for _ in _GAINS]
        for (name, _, role), view in zip(_GAINS, self._views, strict=True):
            last = name == _GAINS[-1][0]
            plot = panel.add(frequency, view, "frequency, Hz" if last else "", "")
            line = panel.draw(
                plot.line, "frequency", "gain", source=new(name, "frequency", "gain"), line=role, line_width=2.2
            )
            rows = [("frequency", "@frequency{0.[000]} Hz"), (f"|{name}|", "@gain{0.[0000]}")]
            panel.hover(plot, [line], rows, mode="vline", line_policy="interp")
            self._figures.append(plot)
        for plot in self._figures:
            panel.span(plot, "height", "reference", line_dash=[3, 3], name="cursor")
            plot.visible = False
        for plot in self._figures[:-1]:
            panel.label_ticks(plot, False)
        panel.crosshair(*self._figures)

    def choose(self, visible: bool) -> None:
        """Show the figures, or hide them."""
        for plot in self._figures:
            plot.visible = visible

    def show(self, picture: Drawing) -> list[Key]:
        """Follow a picture and return what the curves are."""
        bode, put = picture.bode, self._panel.sources.put
        f = column(bode.frequency * HZ)
        S, T = _levels(bode.response)
        put("closed_loop", frequency=f, S=S, T=T)
        band = self._band(picture)
        put("closed_loop_band", **dict(zip(("frequency", "S_low", "S_high", "T_low", "T_high"), band, strict=True)))
        others = [(k, one.design, ys) for k, one in enumerate(bode.overlays) for ys in _levels(one.response)]
        self._panel.put_curves(
            "closed_loop_overlays", [(name, series(1 + k), dashes(1 + k), f, ys) for k, name, ys in others]
        )
        self._level.fit(extent([S, T, *band[1:]]))
        for k, (name, _, _) in enumerate(_GAINS):
            gain = positive(getattr(picture.closed, name))
            ends = extent([gain])
            unit, plot = self._units[k], self._figures[1 + k]
            if ends is not None:
                unit.follow(picture.closed.units[k], ends[1])
                self._views[k].fit((unit.scale * max(ends[0], _LEAST * ends[1]), unit.scale * ends[1]))
            put(name, frequency=f, gain=column(gain, unit.scale))
            plot.yaxis[0].axis_label = unit.name
        keys: list[Key] = [("|S|", "series-1", (), 2.2), ("|T|", "series-2", (), 2.2)]
        keys += [(f"|{name}|, {words}", role, (), 2.2) for name, words, role in _GAINS]
        return [*keys, *overlay_keys(bode.overlays), *self._show_limits(picture)]

    def _band(self, picture: Drawing) -> tuple[Column, ...]:
        """Return frequencies, and the least and largest |S| and |T| there of all plants of the set."""
        nichols = picture.nichols
        if len(nichols.labels) < 2:
            return (column([]),) * 5
        with np.errstate(all="ignore"):
            L = nichols.magnitude * np.exp(1j * np.radians(nichols.phase))
            S, T = _levels(np.asarray(L, dtype=np.complex128))
            ends = S.min(axis=0), S.max(axis=0), T.min(axis=0), T.max(axis=0)
        return finite(column(nichols.frequency * HZ), *ends)

    def _show_limits(self, picture: Drawing) -> list[Key]:
        """Shade where the job's limits on all channels leave no room for this one, and return what the lines are."""
        alpha, bandwidth = picture.nichols.disk_margin, picture.bandwidth
        # |S - 1/2| <= 1/alpha, and T = 1 - S.
        bound = float(20.0 * np.log10(1.0 / alpha + 0.5)) if alpha else None
        self._bound(bound)
        # No channel is slower than the bandwidth of all: |S| stays right of the corner.
        f = [] if bandwidth is None else [_FAR[0], bandwidth, bandwidth]
        self._panel.sources.put(
            "closed_loop_bandwidth", frequency=column(f), level=column([_HALF, _HALF, _FAR[1]][: len(f)])
        )
        out = [] if bound is None else [limit_key(f"disk margin {alpha:g}")]
        return out if bandwidth is None else [*out, limit_key(f"|S| of a bandwidth of {bandwidth:g} Hz")]


def _levels(response: ComplexArray) -> tuple[Column, Column]:
    """Return |S| and |T| of a loop transfer, dB."""
    with np.errstate(all="ignore"):
        S = 1.0 / (1.0 + response)
        return decibels(np.abs(S)), decibels(np.abs(response * S))
