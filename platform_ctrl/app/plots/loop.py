"""The loop over frequency and in the s-plane: the Bode diagram, the closed loop, the Nichols plot, the root locus."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from platform_ctrl.analysis.curves import Curve, Curves, Level, Words, decibels
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.app.curves import gain_crossings, gain_factors
from platform_ctrl.app.pictures import Bode, Drawing
from platform_ctrl.app.plots.painter import Axis, Panel, Theme, Trace
from platform_ctrl.app.plots.views import View, decades, extent, joined, stepped, thinned
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import HZ, plain

# Of KS and PS: words, colour, and what is drawn below this share of the largest gain only when zoomed.
_GAINS = {"KS": ("noise → torque", 2), "PS": ("torque → readings", 3)}
_LEAST = 1e-4
# Where a bandwidth ends, dB, and what is beyond any view, Hz and dB.
_HALF, _FAR = -10.0 * math.log10(2.0), (1e-6, 200.0)


def band(f: FloatArray, every: Any, k: int = 0) -> Curve:
    """Return the band between the extremes of the set (N, F)."""
    return Curve(x=f, y=every.min(axis=0), top=every.max(axis=0), form="band", series=k)


def designs(picture: Drawing) -> Iterator[tuple[dict[str, Any], Drawing]]:
    """Return the look of each other design that is drawn over a picture, and what is drawn of it."""
    for k, one in enumerate(picture.overlays, 1):
        yield {"name": one.settings.design, "series": k, "dashes": k}, one


class BodePanel(Panel):
    """The Bode diagram, or what the loop that it shows is when it is closed."""

    others = ("S, T, KS, PS", "loop L")

    def __init__(self, theme: Theme, frequency: Axis) -> None:
        super().__init__("bode", "Bode", theme)
        self._frequency = frequency
        for view, number, unit, last in (
            (View(-40.0, 40.0, stepped(20.0, -80.0, 80.0)), "{0.0} dB", "dB", False),
            (View(-360.0, 0.0, stepped(90.0, -720.0, 360.0)), "{0}°", "°", True),
        ):
            one = self.add(frequency, view, number, "bands levels verticals lines points words", last=last)
            one.rounded(unit)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        super().show(picture)
        bode = picture.bode
        finite = extent([np.abs(bode.response)]) is not None and extent([bode.phase]) is not None
        message = _trouble(picture) if finite else "no finite response of this loop"
        if not self.turned:
            self.put(dict(enumerate(open_loop(picture))), f"L at {bode.channel}, others closed", message)
            return
        if len(self.figures) == 2:
            # Most pages never show them.
            level = View(-40.0, 20.0, stepped(10.0, -40.0, 30.0))
            one = self.add(self._frequency, level, "{0.0} dB", "strips bands levels lines", last=False)
            one.rounded("dB")
            for last in (False, True):
                view = View(1e-3, 1.0, decades, logarithmic=True)
                self.add(self._frequency, view, "{0.[0000]}", "lines", last=last)
        self.put(dict(enumerate(closed_loop(picture), 2)), f"closed loop at {bode.channel}", "")


def _trouble(picture: Drawing) -> str:
    if not picture.stable:
        return "closed loop not stable"
    if not picture.all_stable:
        return "not stable with all plants"
    return "" if picture.crossover is not None else "the gain never passes 1: no crossover"


def open_loop(picture: Drawing) -> list[Curves]:
    """Return gain and phase of the loop broken at a torquer."""
    bode, at, required = picture.bode, picture.crossover, picture.limits.get("bandwidth")
    upright = [(bode.nyquist * HZ, "reference", "")] if math.isfinite(bode.nyquist) else []
    limits = [(required, "limit", "required bandwidth")] if required is not None else []
    crossover = [(at * HZ, "series-1", "")] if at is not None and math.isfinite(at) else []
    levels, phases = (
        _over_frequency(picture, lambda one: decibels(one.response)),
        _over_frequency(picture, lambda one: one.phase),
    )
    words: list[list[Words]] = [[], []]
    for f, start, end, diagram in _margins(bode) if picture.stable else ():
        curves, k = (phases, 1) if diagram == "phase" else (levels, 0)
        curves.append(Curve(x=np.full(2, f), y=np.array([start, end]), role="ink"))
        curves.append(Curve(x=np.array([f]), y=np.array([end]), form="mark", kind="margin", role="ink"))
        # Beside the end that is never at the edge of the view.
        text, y = (f"{abs(end - start):.1f}°", start) if k else (f"{abs(end):.1f} dB", end)
        beside, base = ((7.0, 3.0), "top") if k else ((7.0, -3.0), "bottom")
        words[k].append(Words(x=f, y=y, text=text, beside=beside, align=("left", base), role="ink"))
    if bode.band.size:
        levels.append(band(bode.band_frequency * HZ, decibels(bode.band)))
        phases.append(band(bode.band_frequency * HZ, bode.band_phase))
    gain = Curves(curves=tuple(levels), title="L", quantity="gain, dB", references={0.0: ""},
                  verticals=(*upright, *limits, *crossover), words=tuple(words[0]))  # fmt: skip
    # The phases of a set do not widen the view.
    phase = Curves(curves=tuple(phases), title="L", quantity="phase, °", references={-180.0: ""},
                   verticals=(*upright, *limits), words=tuple(words[1]), view=extent([phases[0].y]))  # fmt: skip
    return [gain, phase]


def _over_frequency(picture: Drawing, of: Callable[[Bode], FloatArray]) -> list[Curve]:
    """Return curves of what is drawn over frequency of a picture and of the other designs."""
    f, name = picture.bode.frequency * HZ, picture.settings.design or "L"
    others = [Curve(x=one.bode.frequency * HZ, y=of(one.bode), **look) for look, one in designs(picture)]
    return [Curve(x=f, y=of(picture.bode), name=name, form="strong"), *others]


def _margins(bode: Bode) -> list[tuple[float, float, float, str]]:
    """Return the least phase and gain margins as lengths: frequency, from, to, and in which diagram."""
    if not np.isfinite(bode.response).all():
        return []
    rows = []
    w, above = gain_crossings(bode.frequency, bode.response)
    if len(w):
        k = int(np.argmin(np.abs(above)))
        at = float(np.interp(np.log(w[k]), np.log(bode.frequency), bode.phase))
        rows.append((float(w[k] * HZ), at - float(above[k]), at, "phase"))
    w, factors = gain_factors(bode.frequency, bode.response)
    levels = -20.0 * np.log10(factors)
    for side in (levels < 0.0, levels > 0.0):
        if side.any():
            k = int(np.flatnonzero(side)[np.argmin(np.abs(levels[side]))])
            rows.append((float(w[k] * HZ), 0.0, float(levels[k]), "gain"))
    return rows


def closed_loop(picture: Drawing) -> list[Curves]:
    """Return |S| and |T|, and the gains from noise and from a torque."""
    bode, alpha, bandwidth = picture.bode, *map(picture.limits.get, ("disk margin", "bandwidth"))
    f, w = bode.frequency * HZ, bode.band_frequency * HZ
    sets = _levels(bode.band) if bode.band.size else ()
    curves = [
        Curve(x=f, y=y, name=name, series=k, form="strong")
        for k, (name, y) in enumerate(zip(("|S|", "|T|"), _levels(bode.response), strict=True))
    ]
    for look, one in designs(picture):
        own = _levels(one.bode.response)
        curves += [Curve(x=one.bode.frequency * HZ, y=y, **look) for y in own]
    if bandwidth is not None:
        # No channel is slower than the bandwidth of all: |S| stays right of the corner.
        x, y = np.array([_FAR[0], bandwidth, bandwidth]), np.array([_HALF, _HALF, _FAR[1]])
        curves.append(Curve(x=x, y=y, name=f"|S| of a bandwidth of {bandwidth:g} Hz", role="limit"))
    curves += [band(w, one, k) for k, one in enumerate(sets)]
    # Limits on all channels leave this one no room there: |S - 1/2| <= 1/alpha, and T = 1 - S.
    bound = [(float(20.0 * np.log10(1.0 / alpha + 0.5)), f"disk margin {alpha:g}")] if alpha else []
    levels = tuple(Level(y=y, text=text, shaded=True) for y, text in bound)
    out = [Curves(curves=tuple(curves), quantity="gain, dB", levels=levels, references={0.0: ""})]
    for k, (name, (words, series)) in enumerate(_GAINS.items()):
        gain = getattr(picture.closed, name)
        curve = Curve(x=f, y=positive(gain), name=f"|{name}|, {words}", series=series, form="strong")
        ends = extent([curve.y])
        view = None if ends is None else (max(ends[0], _LEAST * ends[1]), ends[1])
        out.append(Curves(curves=(curve,), unit=picture.closed.units[k], view=view))
    return out


def positive(gain: FloatArray) -> FloatArray:
    """Return gains with gaps where they are not positive."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(gain > 0.0, gain, np.nan))


def _levels(response: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return |S| and |T| of a loop transfer, dB."""
    with np.errstate(all="ignore"):
        S = 1.0 / (1.0 + response)
        return decibels(S), decibels(response * S)


# Points of a thin line, plants that are drawn, points of a region's rim.
_POINTS, _PLANTS, _RIM = 110, 64, 121
# Gains beyond these are shown only when zoomed, dB.
_LOWEST, _HIGHEST = -30.0, 40.0
# Phases of the view around the critical point, degrees, and the contours of the closed loop's gain |T|, dB.
_CRITICAL_VIEW = (-270.0, -90.0)
_CONTOURS = (-20.0, -12.0, -6.0, -3.0, -1.0, 1.0, 3.0, 6.0, 12.0)
_LABELLED = 180.0  # pixels of height from which they are labelled
# Critical points, wherever the user may move the view.
_CENTRES = (-900.0, -540.0, -180.0, 180.0, 540.0)


class NicholsPanel(Panel):
    """The Nichols diagram."""

    def __init__(self, theme: Theme) -> None:
        super().__init__("nichols", "Nichols", theme)
        phase = View(*_CRITICAL_VIEW, stepped(45.0, -720.0, 180.0))
        gain = View(-40.0, 40.0, stepped(10.0, _LOWEST, _HIGHEST), name="gain, dB")
        parts = "bands ground levels lines traced points words"
        across = Axis(phase, "phase, °", "phase, °", "{0.0}", "mouse", False)
        one = self.add(across, gain, "{0.0}", parts, trace=Trace("frequency", "{0.[000]} Hz", "series-1", 2.2))
        one.rounded("°", "x")
        one.rounded("dB")
        self._contours = gain_contours()

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        bode, alpha = picture.bode, picture.limits.get("disk margin")
        f = bode.frequency * HZ
        own = Curve(x=bode.phase, y=decibels(bode.response), name="L", form="strong", kind="traced", along=f)
        curves = [own]
        curves += [Curve(x=one.bode.phase, y=decibels(one.bode.response), **look) for look, one in designs(picture)]
        chosen = [k for k, label in enumerate(bode.labels) if label != picture.settings.plant]
        at = thinned(len(bode.band_frequency), _POINTS)
        some = np.array(chosen, dtype=np.intp)[thinned(len(chosen), _PLANTS)]
        if some.size and at.size:
            x, y = joined(bode.band_phase[some][:, at]), joined(decibels(bode.band[some][:, at]))
            curves.append(Curve(x=x, y=y, form="thin", name=f"{len(chosen)} more plants"))
        # The critical point at the crossover with 90 degrees on both sides: the rest is seen by zooming out.
        left, right = _CRITICAL_VIEW
        x, y = (np.concatenate([getattr(one, axis) for one in curves]) for axis in "xy")
        view = extent([y[(x >= left) & (x <= right)], np.array([-10.0, 10.0])])
        centres = np.array(_CENTRES)
        curves.insert(0, Curve(x=centres, y=np.zeros(5), form="mark", kind="critical", role="limit"))
        if alpha is not None and 0.0 < alpha < 2.0:
            curves += _regions(alpha)
        lines, words = self._contours
        finite = extent([own.x]) is not None and extent([own.y]) is not None
        trouble = "" if picture.stable else "closed loop not stable"
        detail = "" if alpha is None else f"grey: disk margin {alpha:g}"
        shown = Curves(curves=(*curves, *lines), quantity="gain, dB", references={0.0: ""}, words=words, view=view)
        self.put({0: shown}, detail, trouble if finite else "no finite response of this loop")


def _regions(alpha: float) -> list[Curve]:
    """Return the regions of the values of L that a disk margin keeps free: |S - 1/2| = 1/alpha at the rim (skew 0)."""
    delta = 0.5 * alpha * np.exp(2j * np.pi * np.linspace(0.0, 1.0, _RIM))
    # Near -180 degrees the angle of -L has no jump.
    minus = (1.0 - delta) / (1.0 + delta)
    x, y = np.degrees(np.angle(minus)), decibels(minus)
    return [Curve(x=at + x, y=y, form="band", kind="region", role="band") for at in _CENTRES]


def gain_contours() -> tuple[tuple[Curve, ...], tuple[Words, ...]]:
    """Return phases, degrees, and gains, dB, of L with |T| constant, and their labels."""
    lines, words = [], []
    for level in _CONTOURS:
        M = 10.0 ** (level / 20.0)
        # Closed curves around the critical point beyond 0 dB, curves over all phases below it.
        T = M * np.exp(1j * np.linspace(0.0 if M > 1.0 else -np.pi, 2.0 * np.pi if M > 1.0 else np.pi, 241))
        L = T / (1.0 - T)
        phase = np.degrees(np.angle(-L))
        order = np.arange(len(phase)) if M > 1.0 else np.argsort(phase)
        top = 20.0 * math.log10(M / (M - 1.0) if M > 1.0 else M / math.sqrt(1.0 - M * M))
        shift, align = (0.0, "center") if M > 1.0 else (88.0, "right")
        text = f"{level:+g} dB".replace("-", "−")
        for at in _CENTRES[1:4]:
            lines.append(Curve(x=at + phase[order], y=decibels(L[order]), form="thin", role="grid"))
            words.append(Words(x=at + shift, y=top, text=text, align=(align, "bottom"), least=_LABELLED))
    return tuple(lines), tuple(words)


DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.7)
# Poles of other plants that are drawn.
_OTHERS = 900
# The view relative to its reach: to the left, to the right, below; and how far rays and arcs go.
_LEFT, _RIGHT, _BELOW, _END = 1.12, 0.30, 0.06, 8.0
# The view follows a reach that is smaller by more than this factor.
_HYSTERESIS = 1.35
# Least distance between the labels of the rays as a share of the view.
_APART = 0.17
_ROUND = np.array([1.0, 2.0, 5.0])


def _ray(damping: float, end: float) -> tuple[FloatArray, FloatArray]:
    """Return a ray of a damping ratio up to an imaginary part, and its mirror image."""
    left = -damping / math.sqrt(1.0 - damping**2) * end
    return np.array([left, 0.0, left]), np.array([end, 0.0, -end])


class LocusPanel(Panel):
    """The root locus."""

    # Below the damping ratios at the ends of the rays.
    down = 19

    def __init__(self, theme: Theme) -> None:
        super().__init__("locus", "Root locus", theme)
        real, imaginary = (
            Axis(View(-1.0, 0.3), "Re s, rad/s", "Re s, rad/s", "{0.0}", "mouse", False),
            View(-0.1, 1.0, lambda low, high: (low, high)),
        )
        imaginary.name, parts = "Im s, rad/s", "bands ground levels verticals cloud lines traced points words"
        self._plane = self.add(real, imaginary, "{0.0}", parts, trace=Trace("gain", "{0.00}", "series-3", 1.2))
        self._plane.plot.xgrid.grid_line_color = self._plane.plot.ygrid.grid_line_color = None
        self._reach = 0.0
        self._net: tuple[list[Curve], tuple[Words, ...]] = [], ()

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        locus, damping = picture.locus, picture.limits.get("damping")
        self._follow(locus.view.reach)
        curves = [poles(picture.poles, kind="pole")]
        for look, one in designs(picture):
            curves.append(poles(one.poles, **look | {"dashes": None}, kind="other"))
        if damping is not None and 0.0 < damping < 1.0:
            x, y = _ray(damping, _END * self._reach)
            curves.append(Curve(x=x, y=y, name=f"required damping {damping:g}", role="limit"))
        for k, s in enumerate(locus.s.T):
            about: dict[str, Any] = {"kind": "traced", "along": locus.values, "series": 2}
            curves.append(Curve(x=s.real, y=s.imag, name="" if k else "gain from 0", **about))
        starts = locus.s[0] if locus.s.size else np.zeros(0, np.complex128)
        curves.append(poles(starts, kind="start", series=2))
        others = picture.other_poles[thinned(len(picture.other_poles), _OTHERS)]
        curves.append(Curve(x=others.real, y=others.imag, kind="cloud"))
        right = int((picture.poles.real > 0.0).sum())
        trouble = "" if picture.stable else f"not stable: {right} {'pole' if right == 1 else 'poles'} to the right"
        message = trouble if extent([np.abs(picture.poles)]) is not None else "no finite pole"
        lines, words = self._net
        axes: dict[str, Any] = {"references": {0.0: ""}, "verticals": ((0.0, "frame", ""),), "view": self._plane.y.rest}
        shown = Curves(curves=(*curves, *lines), quantity="Im s, rad/s", words=words, **axes)
        self.put({0: shown}, "", message)

    def _follow(self, reach: float) -> None:
        """Show the upper half plane as far as it matters; small changes of the reach move nothing."""
        if not (math.isfinite(reach) and reach > 0.0) or self._reach / _HYSTERESIS <= reach <= self._reach:
            return
        self._reach = reach
        self._plane.x.view.show(-_LEFT * reach, _RIGHT * reach)
        self._plane.y.show(-_BELOW * reach, reach)
        self._net = net(reach)


def net(reach: float) -> tuple[list[Curve], tuple[Words, ...]]:
    """Return rays of damping ratios and arcs of frequencies in the s-plane, with their numbers."""
    far, left = _END * reach, _LEFT * reach
    x = np.array([0.0, far, far, 0.0])
    lines = [Curve(x=x, y=np.array([-far, -far, far, far]), form="band", role="band")]
    rays = [_ray(one, far) for one in DAMPINGS]
    lines += [Curve(x=x, y=y, form="thin", role="frame") for x, y in rays]
    decade = math.floor(math.log10(reach * HZ))
    radii = np.sort(np.outer(10.0 ** np.arange(decade - 1, decade + 2), _ROUND).ravel()) / HZ
    turn = np.exp(1j * np.linspace(0.5 * np.pi, 1.5 * np.pi, 91))
    words = []
    for radius in radii[radii < 4.0 * reach]:
        lines.append(Curve(x=radius * turn.real, y=radius * turn.imag, form="thin", role="frame", dashes=2))
        if 0.12 * reach < radius < 0.95 * reach:
            text = f"{plain(radius * HZ, 3)} Hz"
            words.append(Words(x=0.0, y=radius, text=text, beside=(5.0, 0.0), align=("left", "middle")))
    last = math.inf
    for damping in reversed(DAMPINGS):
        slope = damping / math.sqrt(1.0 - damping**2)
        place: dict[str, Any] | None = None
        if slope * reach >= left:
            place = {"x": -left, "y": left / slope, "beside": (3.0, -3.0), "align": ("left", "bottom")}
        elif last - slope * reach >= _APART * left:
            last = slope * reach
            place = {"x": -last, "y": reach, "beside": (-3.0, 3.0), "align": ("right", "top")}
        if place is not None:
            words.append(Words(text=f"{damping:g}", **place))
    return lines, tuple(words)


def poles(s: ComplexArray, **look: Any) -> Curve:
    """Return poles in the s-plane as points, with what they are in words."""
    words = []
    with np.errstate(all="ignore"):
        for one, size in zip(s, np.abs(s), strict=True):
            ratio = -one.real / size if size else math.nan
            words.append(f"{one.real:.1f} ± j {abs(one.imag):.1f} rad/s, {size * HZ:.1f} Hz, damping {ratio:.3f}")
    return Curve(x=s.real, y=s.imag, form="mark", words=tuple(words), **look)
