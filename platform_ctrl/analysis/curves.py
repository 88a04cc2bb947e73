"""The numbers of pictures: what a panel shows, curves that are refined where they turn, and root loci.

Nothing is drawn here: the report and the designer, of which neither knows the other, draw the same curves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.poles import Poles, continuous_poles, pole_branches
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray, value

# A step of the phase beyond which a pole or zero without damping is taken for its cause, degrees.
_JUMP = 135.0
# Halvings of a step, and values altogether, at most: a pole that leaps cannot be followed however short the steps.
_MOST_HALVINGS, _MOST_VALUES = 14, 3000
# Of the loop transfer from one point to the next, at most: degrees and dB, the latter 1 % of a Nichols plot; and the
# gains, dB, within which that counts.
_TURN, _RISE, _SEEN = 2.0, 0.8, 45.0


@value
class Curve:
    """A line of a panel, a band, or points."""

    x: FloatArray
    y: FloatArray
    name: str = ""  # Entry of the legend; empty: no entry
    series: int | None = 0  # Number of colour and marker; None: grey, a reference for the other curves
    dashes: int | None = None  # Number of the dash pattern, 0: solid; None: the pattern of the series
    # "strong": the curve that counts, "thin": belongs to another line, "mark": points, "band": from y up to `top`
    form: Literal["line", "strong", "thin", "mark", "band"] = "line"
    top: FloatArray | None = None
    role: str = ""  # Colour by role in the palette, for a curve without the colour of a series
    kind: str = ""  # Kind of the curve, for kinds that are drawn in a way of their own
    along: FloatArray | None = None  # Parameter of each point, such as a frequency or a gain
    words: tuple[str, ...] = ()  # Text for each point, or for a line without a name


@value
class Level:
    """A limit (hard) or goal for a gain, perhaps for a band of frequencies only."""

    y: float
    text: str
    hard: bool = True
    start: float | None = None
    end: float | None = None
    shaded: bool = False  # Whether the side of the level away from zero is shaded


@value
class Words:
    """Text at a point of a panel, moved by `beside`, pixels to the right and up, and aligned there."""

    x: float
    y: float
    text: str
    beside: tuple[float, float] = (0.0, 0.0)
    align: tuple[str, str] = ("center", "bottom")
    role: str = "muted"
    least: float = 0.0  # Least height of a panel with room for the text, pixels


@value
class Curves:
    """Curves of one panel, over frequency in Hz unless stated otherwise."""

    curves: tuple[Curve, ...]
    title: str = ""
    quantity: str = ""  # Label of the y axis: quantity and unit
    kind: Literal["gain", "phase"] = "gain"
    low: float = 0.0  # Gains below `low` and above `high` are cut off
    high: float = math.inf
    levels: tuple[Level, ...] = ()
    references: Mapping[float, str] = field(default_factory=dict)  # Grey lines at these y, with their text
    required: float | None = None  # Required bandwidth, and the one that is a goal
    wished: float | None = None
    verticals: tuple[tuple[float, str, str], ...] = ()  # Vertical lines: x, role of the colour, text
    words: tuple[Words, ...] = ()
    unit: str = ""  # Unit of y without prefix, for panels that choose a prefix
    view: tuple[float, float] | None = None  # Range of y that must be visible; None: the range of the curves


def decibels(response: ComplexArray) -> FloatArray:
    """Return |response| in decibels; NaN where it is 0 or NaN."""
    size = np.abs(response)
    return np.asarray(20.0 * np.log10(np.where(size > 0.0, size, math.nan)))


def loop_phase(loop: ComplexArray) -> FloatArray:
    """Return the phase of a loop transfer, degrees, in the turn in which it comes closest to the critical point.

    Across a pole on the stability boundary the phase falls by 180°, across a zero there it rises, as with the least
    damping. NaN where the response is 0 or NaN.
    """
    out = np.full(len(loop), np.nan)
    known = np.flatnonzero(np.isfinite(loop) & (loop != 0.0))
    if not known.size:
        return out
    h = loop[known]
    level, angle = np.log(np.abs(h)), np.degrees(np.angle(h))
    step = (np.diff(angle) + 180.0) % 360.0 - 180.0
    for k in np.flatnonzero(np.abs(step) > _JUMP).tolist():
        # The gain distinguishes pole and zero: it has a peak, or a dip, between the two points.
        bend = level[min(k + 2, len(h) - 1)] - level[k + 1] - (level[k] - level[max(k - 1, 0)])
        if bend * step[k] < 0.0:
            step[k] += np.copysign(360.0, bend)
    phase = angle[0] + np.concatenate([[0.0], np.cumsum(step)])
    closest = phase[np.argmin(np.abs(1.0 + h))]
    out[known] = phase - 360.0 * np.round((closest + 180.0) / 360.0)
    return out


def refined(
    values: FloatArray,
    evaluate: Callable[[FloatArray], ComplexArray],
    moved: Callable[[ComplexArray], FloatArray],
    found: ComplexArray | None = None,
) -> tuple[FloatArray, ComplexArray]:
    """Return rising `values` (N,) with more between them, and the results of each, (N, ...).

    `moved` says how far it is from each value to the next, (N - 1,): no more than 1 is left. `found` is what the values
    come to where that is known.
    """
    found = evaluate(values) if found is None else found
    for _ in range(_MOST_HALVINGS):
        with np.errstate(all="ignore"):
            long = np.flatnonzero(np.nan_to_num(moved(found), nan=0.0, posinf=0.0) > 1.0)
        if not long.size or len(values) + long.size > _MOST_VALUES:
            break
        between = 0.5 * (values[long] + values[long + 1])
        values = np.insert(values, long + 1, between)
        found = np.insert(found, long + 1, evaluate(between), axis=0)
    return values, found


def refined_loop(
    frequency: FloatArray, channels: Callable[[FloatArray], ComplexArray]
) -> tuple[FloatArray, ComplexArray]:
    """Return frequencies (N,), and loop transfers (m, N) there, that turn by at most 2° from one to the next.

    `channels` gives loop transfers (m, N) at any frequencies.
    """

    def moved(h: ComplexArray) -> FloatArray:
        ratio = h[1:] / h[:-1]
        level = decibels(h)
        seen = np.minimum(np.abs(level[1:]), np.abs(level[:-1])) < _SEEN
        way = np.hypot(np.degrees(np.angle(ratio)) / _TURN, decibels(ratio) / _RISE)
        return np.asarray(np.where(seen, way, 0.0).max(axis=1, initial=0.0))

    w, h = refined(frequency, lambda w: channels(w).T, moved)
    return w, h.T


# Largest and smallest share of a panel to the right of the imaginary axis; width of a panel over the height above the
# real axis, about; room beyond the outermost pole; a gap between poles.
_RIGHT, _MOST_RIGHT, _ASPECT, _BEYOND, _GAP = 0.17, 0.75, 1.95, 1.2, 8.0
# Poles within this share of the width are drawn stretched, so much at most; within 1/_FLAT they are on the axis.
_SLIM, _STRETCH, _FLAT = 0.35, 12.0, 400.0
# A pole this near to the boundary, against the largest, counts as on it: multiple ones come out that far away.
_ON = 1e-9
# An edge of stability this near to an end of the range, against its length, lies at the end.
_BESIDE = 1e-6
# Branches are drawn by steps of this share of the view at most, and while a slider moves.
_STEP, _QUICK_STEP = 0.012, 0.07


@value
class PlaneView:
    """How much of the s-plane is shown."""

    reach: float  # Up to which imaginary part, rad/s
    right: float = _RIGHT  # Share of the panel to the right of the imaginary axis
    stretch: float = 1.0  # How much longer a real part is drawn than an imaginary one


@value
class RootLocus:
    """Poles of a closed loop over a number."""

    values: FloatArray  # (N,), The number, increasing: closer together where poles move fast
    branches: ComplexArray  # (N, n), Poles in their own plane, s in rad/s or z, each column one continuous branch
    nominal: ComplexArray  # (n,), Those at 1
    dt: float  # Sample period, s; 0: continuous
    stable: NDArray[np.bool_]  # (N,), Whether all poles lie inside the stability boundary
    edges: FloatArray  # (k,), Numbers between the ends at which that changes, to rounding
    view: PlaneView  # What of the s-plane shows it

    @property
    def s(self) -> ComplexArray:
        """Branches in the s-plane, rad/s: ln(z)/T of a sampled loop."""
        return continuous_poles(self.branches, self.dt)

    @property
    def stable_ranges(self) -> list[tuple[float, float]]:
        """Intervals in which the loop is stable."""
        ends = [float(self.values[0]), *map(float, self.edges), float(self.values[-1])]
        first = bool(self.stable[0])
        return [(ends[k], ends[k + 1]) for k in range(0 if first else 1, len(ends) - 1, 2)]


def traced_locus(
    values: FloatArray, poles: Poles, dt: float, *, quick: bool = False, reach: float | None = None
) -> RootLocus:
    """Follow the poles through `values`, finer where they run, and find where stability begins and ends.

    `quick`: in longer steps, and without the edges of stability, which cost more than the rest. `reach` is how much of
    the s-plane is shown, rad/s, where that does not follow from the poles.
    """
    nominal = poles(np.ones(1))[0]
    nyquist = np.pi / dt if dt else np.inf
    coarse = values if quick else np.union1d(values, np.linspace(values[0], values[-1], 61))
    coarse = np.union1d(coarse, [1.0]) if values[0] <= 1.0 <= values[-1] else coarse
    first = poles(coarse)
    ends = np.concatenate([first[[0, -1]].ravel(), nominal])
    view = view_of(continuous_poles(ends, dt), continuous_poles(first.ravel(), dt), nyquist)
    view = view if reach is None else PlaneView(reach=reach)
    step = (_QUICK_STEP if quick else _STEP) * view.reach

    def moved(z: ComplexArray) -> FloatArray:
        s = continuous_poles(pole_branches(z), dt)
        outside = ~(np.abs(s) < 3.0 * view.reach)
        way = np.abs(np.diff(np.where(outside, np.nan, view.stretch * s.real + 1j * s.imag), axis=0))
        return np.asarray(np.nan_to_num(way, nan=0.0).max(axis=1, initial=0.0) / step)

    def stability(z: ComplexArray) -> NDArray[np.bool_]:
        size = np.abs(z).max(axis=-1)
        growth = size - 1.0 if dt else z.real.max(axis=-1)
        return np.asarray(growth < -_ON * (1.0 if dt else size))

    fine, z = refined(coarse, poles, moved, first)
    stable = stability(z)
    # At an end of the range the loop may be undamped: what counts there is stability a little inside.
    stable[[0, -1]] = stability(poles(fine[[0, -1]] + np.array([2.0, -2.0]) * _BESIDE * (fine[-1] - fine[0])))
    edges = np.array(
        [
            _edge(lambda x: bool(stability(poles(np.array([x])))[0]), fine[k], fine[k + 1], bool(stable[k]))
            for k in np.flatnonzero(stable[1:] != stable[:-1] if not quick else [])
        ]
    )
    new = np.setdiff1d(edges, fine)
    at, found = np.searchsorted(fine, new), poles(new) if new.size else z[:0]
    return RootLocus(
        values=np.insert(fine, at, new),
        branches=pole_branches(np.insert(z, at, found, axis=0)),
        nominal=nominal,
        dt=dt,
        stable=np.insert(stable, at, stability(found)),
        edges=edges,
        view=view,
    )


def _edge(stable: Callable[[float], bool], low: float, high: float, before: bool) -> float:
    """Bisect to where stability changes."""
    for _ in range(80):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (middle, high) if stable(middle) == before else (low, middle)
    return 0.5 * (low + high)


def view_of(ends: ComplexArray, between: ComplexArray, nyquist: float) -> PlaneView:
    """Return a view of the s-plane that shows the poles `ends`, 1/s, and those `between` that are no faster.

    Very fast poles are left out, and of a sampled system those beyond half the Nyquist frequency: delay and roll-off.
    """
    every = np.concatenate([ends, between])
    s = every[np.isfinite(every) & (np.abs(every) <= _bound(ends, nyquist))]
    up, left, right = (_BEYOND * float(np.max(x, initial=0.0)) for x in (np.abs(s.imag), -s.real, s.real))
    reach = max(up, (left + right) / _ASPECT) or 1.0
    share = float(np.clip(right / (_ASPECT * reach), _RIGHT, _MOST_RIGHT))
    reach = max(reach, left / ((1.0 - share) * _ASPECT))
    across = whole = _ASPECT * reach
    if whole / _FLAT < left + right < _SLIM * whole:
        # Little damping: what there is to see lies in a narrow strip.
        across = max(left + right, whole / _STRETCH)
    share = float(np.clip(right / across, _RIGHT, _MOST_RIGHT))
    across = max(across, min(max(left / (1.0 - share), right / share), whole))
    return PlaneView(reach=reach, right=share, stretch=whole / across)


def _bound(poles: ComplexArray, nyquist: float) -> float:
    """Return the largest |s| that is worth showing."""
    size = np.abs(poles[np.isfinite(poles)])
    size = size[size > 0.0]
    if not size.size:
        return 1.0
    slow = size[size <= 0.5 * nyquist]
    ordered = np.sort(slow if slow.size else size)
    turning = np.isfinite(poles) & (np.abs(poles.imag) > 0.1 * np.abs(poles)) & (np.abs(poles) <= ordered[-1])
    least = float(np.abs(poles[turning]).max(initial=0.0))
    # Where most of a decade parts the poles and nothing swings beyond, the fast side is left out.
    for gap in np.flatnonzero(ordered[1:] > _GAP * ordered[:-1])[::-1]:
        if ordered[gap] >= least > 0.0:
            return float(ordered[gap]) * (1.0 + 1e-9)
    return float(ordered[-1]) * (1.0 + 1e-9)


def upper_half_plane(z: ComplexArray) -> ComplexArray:
    """Return the finite poles of the closed upper half plane."""
    return np.asarray(z[np.isfinite(z.real) & (z.imag >= -1e-9 * np.maximum(np.abs(z), 1e-12))])
