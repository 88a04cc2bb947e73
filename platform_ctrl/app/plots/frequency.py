"""The loop over frequency: the Bode diagram, and the Nichols plot of all plants of the set."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bokeh.models.annotations.geometry import Span

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.app.pictures import Bode, Drawing
from platform_ctrl.app.plots.data import (
    HZ,
    LIMIT_DASHES,
    Column,
    Sources,
    Unit,
    View,
    assign,
    column,
    dashes,
    decades,
    decibels,
    extent,
    finite,
    inner_size,
    joined_curves,
    positive,
    series,
    stepped,
    thinned,
)
from platform_ctrl.app.plots.panel import Key, OverlayCurves, Panel, Theme, limit_key, overlay_keys, set_message
from platform_ctrl.common.values import FloatArray

# Words of the button while the open loop is shown, and while the closed one is.
_TOGGLE = {False: "S, T, KS, PS", True: "loop L"}
_BAND = ("frequency", "gain_low", "gain_high", "phase_low", "phase_high")
_MARK_WORDS = ("gain_words", "phase_words")
_MARKS = ("frequency", "gain0", "gain1", "phase0", "phase1")


class BodePanel(Panel):
    """The Bode diagram, or what the loop that it shows is when it is closed."""

    _is_closed = False
    _picture: Drawing | None = None

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
        band, marks = sources.new("band", *_BAND), sources.new("margins", *_MARKS, lists=_MARK_WORDS)
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
            # Beside the end that is never at the edge of the view.
            end, offset, side = (f"{name}1", -3, "bottom") if name == "gain" else (f"{name}0", 3, "top")
            look = {"text": f"{name}_words", "x_offset": 7, "y_offset": offset, "text_baseline": side}
            self.words(plot, "frequency", end, marks, "ink", **look)
            self.hover(plot, [line], rows, mode="vline", line_policy="interp")
        # The same frequency is marked wherever it is an axis.
        self.mouse = self.crosshair(above, below)
        self._crossover = self.span(above, "height", "series-1", line_width=1.2)
        self._message = self.message(above)
        self._open, self._closed = (above, below), ClosedLoopFigures(self, frequency, self.mouse)

    @property
    def other(self) -> str:  # type: ignore[override]
        """What the panel can show instead."""
        return _TOGGLE[self._is_closed]

    def turn(self) -> None:
        """Show the closed loop in place of the open one, or the open one again."""
        self._is_closed = closed = not self._is_closed
        for plot in self._open:
            plot.visible = not closed
        self._closed.choose(closed)
        if self._picture is not None:
            self.show(self._picture)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        self._picture = picture
        bode, crossover, required = picture.bode, picture.crossover, picture.bandwidth
        f, gain, phase = column(bode.frequency * HZ), decibels(bode.response), column(bode.phase)
        self.sources.put("loop", frequency=f, gain=gain, phase=phase)
        band = _extremes(bode, decibels(bode.band), bode.band_phase)
        self.sources.put("band", **dict(zip(_BAND, band, strict=True)))
        self.overlays.show(bode.overlays, bode.frequency)
        marks = _margin_marks(bode) if picture.stable else np.zeros((0, 5))
        self.sources.put(
            "margins",
            **{name: column(marks[:, k]) for k, name in enumerate(_MARKS)},
            gain_words=["" if math.isnan(to) else f"{abs(to):.1f} dB" for to in marks[:, 2]],
            phase_words=["" if math.isnan(to) else f"{abs(to - at):.1f}°" for at, to in marks[:, 3:]],
        )
        for span in self._nyquist:
            assign(span, location=float(bode.nyquist * HZ) if math.isfinite(bode.nyquist) else None)
        for span in self._required:
            assign(span, location=required)
        self._frequency.fit(extent([f]))
        self._gain.fit(extent([gain, band[1], band[2]]))
        self._phase.fit(extent([phase]))
        assign(self._crossover, location=None if crossover is None else crossover * HZ)
        if self._is_closed:
            self.detail = f"closed loop at {bode.channel}"
            self.keys = self._closed.show(picture)
        else:
            self.detail = f"L at {bode.channel}, others closed"
            limits = [limit_key("required bandwidth")] if required is not None else []
            self.keys = [(picture.settings.design or "L", "series-1", (), 2.2), *overlay_keys(bode.overlays), *limits]
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
    f, gain, phase = bode.frequency, np.abs(bode.response), bode.phase
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


# Points of a thin line, plants that are drawn, points of a region's rim.
_POINTS, _PLANTS, _RIM = 110, 64, 121
# Gains beyond these are shown only when zoomed, dB.
_LOWEST, _HIGHEST = -30.0, 40.0


# Phases of the view around the critical point, degrees, and the contours of the closed loop's gain |T|, dB.
_CRITICAL_VIEW = (-270.0, -90.0)
_LABELLED = 180.0  # pixels of height from which they are labelled
_CONTOURS = (-20.0, -12.0, -6.0, -3.0, -1.0, 1.0, 3.0, 6.0, 12.0)


def gain_contours() -> tuple[list[FloatArray], list[FloatArray], list[tuple[float, float, str]]]:
    """Return phases, degrees, and gains, dB, of L with |T| constant around -180 degrees, and places of their labels."""
    phases, gains, labels = [], [], []
    for level in _CONTOURS:
        M = 10.0 ** (level / 20.0)
        # Closed curves around the critical point beyond 0 dB, curves over all phases below it.
        T = M * np.exp(1j * np.linspace(0.0 if M > 1.0 else -np.pi, 2.0 * np.pi if M > 1.0 else np.pi, 241))
        L = T / (1.0 - T)
        phase = np.degrees(np.angle(-L))
        order = np.arange(len(phase)) if M > 1.0 else np.argsort(phase)
        phases.append(phase[order])
        gains.append(20.0 * np.log10(np.abs(L[order])))
        top = 20.0 * math.log10(M / (M - 1.0) if M > 1.0 else M / math.sqrt(1.0 - M * M))
        labels.append((0.0 if M > 1.0 else 88.0, top, f"{level:+g} dB".replace("-", "−")))
    return phases, gains, labels


class NicholsPanel(Panel):
    """The Nichols diagram."""

    def __init__(self, theme: Theme, sources: Sources, overlays: OverlayCurves) -> None:
        super().__init__("nichols", "Nichols", theme, sources)
        self._phase = View(*_CRITICAL_VIEW, stepped(45.0, -720.0, 180.0))
        self._gain = View(-40.0, 40.0, stepped(10.0, _LOWEST, _HIGHEST))
        plot = self.add(self._phase, self._gain, "phase, °", "gain, dB")
        self.degrees(plot.xaxis[0])
        self.decibels(plot.yaxis[0])
        regions = sources.new("regions", lists=("xs", "ys"))
        critical = sources.new("critical", "phase", "gain")
        plants = sources.new("plants", "phase", "gain")
        self.draw(plot.patches, "xs", "ys", source=regions, line="reference", fill="band", line_width=1)
        self._draw_contours(plot)
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
        bode, required = picture.bode, picture.disk_margin
        rows = [k for k, label in enumerate(bode.labels) if label != picture.settings.plant]
        others = len(rows)
        phase, gain = _thin_curves(bode, rows)
        self.sources.put("plants", phase=phase, gain=gain)
        loop = self.sources.by_name["loop"].data
        # The critical point at the crossover with 90 degrees on both sides: the rest is seen by zooming out.
        left, right = _CRITICAL_VIEW
        phases, gains = (np.concatenate([loop[name], one]) for name, one in (("phase", phase), ("gain", gain)))
        self._gain.fit(extent([gains[(phases >= left) & (phases <= right)]]) or extent([gains]))
        self._regions(required)
        self.detail = "" if required is None else f"grey: disk margin {required:g}"
        set_of_plants = [(f"{others} more plants", "series-1", (), 0.9)] if others else []
        self.keys = [("L", "series-1", (), 2.2), *set_of_plants, *overlay_keys(bode.overlays)]
        empty = not (np.isfinite(loop["phase"]).any() and np.isfinite(loop["gain"]).any())
        trouble = "no finite response of this loop" if empty else "" if picture.stable else "closed loop not stable"
        set_message(self._message, trouble)

    def _draw_contours(self, plot: Any) -> None:
        """Draw the contours of |T| around the critical points that the view may show."""
        curves = self.sources.new("contours", lists=("xs", "ys"))
        words = self.sources.new("contour_labels", "x", "y", lists=("text", "align"))
        phases, gains, labels = gain_contours()
        centres = (-540.0, -180.0, 180.0)
        self.sources.put(
            "contours", xs=[column(c + x) for c in centres for x in phases], ys=[column(y) for y in gains] * 3
        )
        self.sources.put(
            "contour_labels",
            x=column([c + x for c in centres for x, _, _ in labels]),
            y=column([y for _, y, _ in labels] * 3),
            text=[text for _, _, text in labels] * 3,
            align=["right" if x else "center" for x, _, _ in labels] * 3,
        )
        self.draw(plot.multi_line, "xs", "ys", source=curves, line="grid", line_width=1)
        look = {"text": "text", "size": "9px", "text_align": "align", "text_baseline": "bottom"}
        text = self.words(plot, "x", "y", words, "muted", **look)
        text.visible = False

        def follow(attr: str, old: object, new: object) -> None:
            text.visible = inner_size(plot)[1] >= _LABELLED

        plot.on_change("inner_height", follow)

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


def _thin_curves(bode: Bode, rows: list[int]) -> tuple[Column, Column]:
    """Return phase and gain of plants of the set as one line with gaps, thinned."""
    at = thinned(len(bode.band_frequency), _POINTS)
    some = np.array(rows, dtype=np.intp)[thinned(len(rows), _PLANTS)]
    return joined_curves(bode.band_phase[some][:, at]), joined_curves(decibels(bode.band[some][:, at]))


def _extremes(bode: Bode, *curves: Any) -> tuple[Column, ...]:
    """Return the frequencies of the band, and the least and the largest of the set there of each of some curves."""
    ends = [end(column(one), axis=0) for one in curves for end in (np.min, np.max)]
    return finite(column(bode.band_frequency * HZ), *ends)


# Of KS and PS: the curve, its words, and what is drawn below this share of the largest gain only when zoomed.
_GAINS = (("KS", "noise → torque", "series-3"), ("PS", "torque → readings", "series-4"))
_LEAST = 1e-4
# Where a bandwidth ends, dB, and what is beyond any view, Hz and dB.
_HALF, _FAR = -10.0 * math.log10(2.0), (1e-6, 200.0)


class ClosedLoopFigures:
    """Three figures of a panel, hidden at first: |S| and |T| in dB, and the gains from noise and from a torque."""

    def __init__(self, panel: Panel, frequency: View, mouse: Span) -> None:
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
            plot.visible = False
        for plot in self._figures[:-1]:
            panel.label_ticks(plot, False)
        panel.crosshair(*self._figures, vertical=mouse)

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
        band = _extremes(bode, *_levels(bode.band))
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

    def _show_limits(self, picture: Drawing) -> list[Key]:
        """Shade where the job's limits on all channels leave no room for this one, and return what the lines are."""
        alpha, bandwidth = picture.disk_margin, picture.bandwidth
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
