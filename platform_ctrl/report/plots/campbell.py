"""The Campbell diagram: natural frequencies of the gimbals, and what the rotors excite, over the rotors' speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import state_arrays
from platform_ctrl.common.arguments import known_name, real_numbers
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, RPM
from platform_ctrl.job.quantities import plain as number
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.state_space import state_space, subsystems, whole_subsystems
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.modes import poles_and_kinds
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.root_locus import increasing, with_rotors_at_rest
from platform_ctrl.report.plots.systems import drawable
from platform_ctrl.report.style import (
    LIMIT,
    MARKERS,
    MUTED,
    REFERENCE,
    SERIES,
    legend,
    line_style,
    linear_axis,
    panels,
    standalone,
)

# Speeds at which the modes are computed, at least.
_SPEEDS = 401
# A frequency this small against the fastest is none: poles at zero come out that large.
_ZERO = 1e-5
# Intersections near the origin, where all lines begin, do not count: share of the largest speed.
_CORNER = 0.005
_HEIGHT = 4.25


@value
class SpinMode:
    """One natural frequency of the gimbals over the rotors' speed."""

    gimbals: tuple[str, ...]  # The subsystem
    kind: str  # As Mode.kind, at the nominal speed
    frequency: FloatArray  # (N,), |Im s|, rad/s
    nominal: float  # At the nominal speed


@standalone
def campbell(  # noqa: PLR0915 - one picture
    platform: Platform,
    *,
    gimbals: Sequence[str] | None = None,
    rotors: Sequence[str] | None = None,
    rotor: str | None = None,
    spins: ArrayLike | None = None,
    orders: ArrayLike = (1.0, 2.0),
    Omega: ArrayLike = (0.0, 0.0, 0.0),
) -> Figure:
    """Natural frequencies of the uncontrolled gimbals over the speed of the rotors, with multiples of that speed.

    Nutation rises with L, one mode for each gyroscopic pair; precession is slower: it rises if a platform rate
    stiffens the gimbals, and falls if springs do. Grey lines are multiples of the rotors' speed (1×:
    unbalance); where one meets a mode, a diamond says at which speed.

    Parameters
    ----------
    platform
        The plant, linearised about zero angles.
    gimbals
        Names of the gimbals of one or several subsystems; default all.
    rotors
        Names of the rotors whose speed changes, all by one factor; default all that spin.
    rotor
        The one whose speed the axis shows, in rpm; default: the speed that all of them share. Rotors of different
        speeds have an axis in shares of the nominal speed.
    spins : (k,), optional
        Increasing factors on the speeds, >= 0, at least two: the range. Default 0 to 1.5.
    orders : (j,)
        Factors on the speed at which rotors excite.
    Omega : (3,)
        Constant platform rate, rad/s.

    Returns
    -------
    matplotlib.figure.Figure
        One panel, frequencies in Hz.

    Raises
    ------
    ArgumentError
        Names that do not exist, no rotor that spins, or numbers that make no sense.

    References
    ----------
    W. Campbell, Trans. ASME 46, 1924.

    See docs/precession.md.
    """
    factors = increasing("spins", spins, np.array([0.0, 1.5]))
    if factors[0] < 0.0:
        raise ArgumentError(f"campbell: spins must be factors >= 0, got {factors[0]:g}")
    multiples = np.atleast_1d(real_numbers("orders", orders))
    if multiples.ndim != 1 or not np.all(np.isfinite(multiples) & (multiples > 0.0)):
        raise ArgumentError(f"campbell: orders must be finite numbers > 0, such as (1, 2), got {multiples}")
    stopped, turning = with_rotors_at_rest(platform, rotors)
    reference = _reference(platform, turning, rotor)
    speed = np.union1d(factors, np.linspace(factors[0], factors[-1], _SPEEDS))
    model, still = linearise(platform, Omega=Omega), linearise(stopped, Omega=Omega)
    chosen = {model.gimbal_names[k] for k in whole_subsystems(model, gimbals)}
    modes = [m for group in subsystems(model) if set(group) <= chosen for m in _modes(model, still, group, speed)]

    unit = RPM * reference[0] if len(reference) == 1 else 1.0
    labels = [
        f"{m.kind} of {drawable('-'.join(m.gimbals))}: {number(m.nominal * HZ, 3)} Hz at nominal speed" for m in modes
    ]
    figure, [[axes]] = panels(1, 1, _HEIGHT, labels, titles=False)
    handles: list[Any] = []
    x = unit * speed
    for k, mode in enumerate(modes):
        handles += axes.plot(x, mode.frequency * HZ, **line_style(k))
        if speed[0] <= 1.0 <= speed[-1]:
            mark = MARKERS[k % len(MARKERS)]
            axes.plot([unit], [mode.nominal * HZ], mark, color=SERIES[k % len(SERIES)], markersize=5)
    highest = max((float(m.frequency.max()) for m in modes), default=0.0)
    lowest_line = float(multiples.min(initial=1.0)) * min(reference) * float(speed[-1])
    top = 1.18 * HZ * (highest or lowest_line)
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(0.0, top)
    linear_axis(axes.xaxis, 8)
    linear_axis(axes.yaxis, 6)
    axes.set_ylabel("frequency, Hz")
    if len(reference) == 1:
        axes.set_xlabel("rotor speed, rpm" if rotor is None else f"speed of rotor {drawable(rotor)}, rpm")
        axes.xaxis.set_major_formatter(lambda rpm, _: f"{rpm:,.0f}" if unit > 50.0 else f"{rpm:g}")
    else:
        axes.set_xlabel("rotor speed / nominal")
    if speed[0] < 1.0 < speed[-1]:
        axes.axvline(unit, color=REFERENCE, linewidth=0.8, linestyle=(0, (1.2, 1.4)))
    _spin_lines(axes, modes, speed, unit, reference, multiples)
    if modes:
        legend(figure, handles, labels)
    else:
        axes.annotate(
            "these gimbals have no oscillating mode", (0.5, 0.5), xycoords="axes fraction", color=MUTED, ha="center"
        )
    return figure


def _reference(platform: Platform, turning: list[str], rotor: str | None) -> list[float]:
    """Return the speeds, rad/s, whose multiples are drawn: one, where the axis can show it."""
    spin = {r.name: abs(r.spin) for r in platform.rotors}
    if rotor is not None:
        known_name("rotor", rotor, turning)
        return [spin[rotor]]
    distinct: list[float] = []
    for name in turning:
        if all(abs(spin[name] - other) > 1e-9 * other for other in distinct):
            distinct.append(spin[name])
    return distinct


def _modes(model: LinearModel, still: LinearModel, group: tuple[str, ...], speed: FloatArray) -> list[SpinMode]:
    """Return the swinging modes of one subsystem, fastest first.

    The linear model is affine in the rotors' momenta, so that two linearisations give every speed.
    """
    full, rest = (state_arrays(state_space(m, gimbals=group), "campbell").A for m in (model, still))
    at = np.append(speed, 1.0)
    poles = np.linalg.eigvals(rest + at[:, None, None] * (full - rest))
    # A pair counts once.
    turning = np.sort(np.abs(poles.imag), axis=1)[:, ::-1][:, ::2]
    scale = float(np.abs(poles).max(initial=0.0))
    turning = np.where(turning > _ZERO * scale, turning, 0.0)
    lines, nominal = _smooth(turning[:-1]), turning[-1]
    poles, kinds = poles_and_kinds(model, group)
    beside = np.argmin(np.abs(speed - 1.0))
    # Which line a frequency at nominal speed belongs to.
    order = np.argsort(-lines[beside], kind="stable")
    out = []
    for rank, column in enumerate(order):
        line = lines[:, column]
        if line.max() <= 0.0 or (nominal[rank] == 0.0 and np.count_nonzero(line) < 0.5 * len(line)):
            continue
        nearest = int(np.argmin(np.abs(np.abs(poles.imag) - nominal[rank])))
        kind = kinds[nearest] if nominal[rank] > 0.0 else "oscillation"
        out.append(SpinMode(gimbals=group, kind=kind, frequency=line, nominal=float(nominal[rank])))
    return out


def _smooth(sorted_lines: FloatArray) -> FloatArray:
    """Reorder frequencies that are sorted at every speed so that each column goes on as it went: lines may cross."""
    from scipy.optimize import linear_sum_assignment

    out = sorted_lines.copy()
    for k in range(1, len(out)):
        ahead = out[k - 1] if k == 1 else 2.0 * out[k - 1] - out[k - 2]
        out[k] = out[k][linear_sum_assignment((ahead[:, None] - out[k][None, :]) ** 2)[1]]
    return out


def _spin_lines(
    axes: Axes, modes: list[SpinMode], speed: FloatArray, unit: float, reference: list[float], orders: FloatArray
) -> None:
    """Draw multiples of the rotors' speeds, and where they intersect the modes."""
    right, top = axes.get_xlim()[1], axes.get_ylim()[1]
    named = []
    for spin in reference:
        for order in orders:
            slope = order * spin * HZ
            axes.plot(unit * speed, slope * speed, color=MUTED, linewidth=0.9, linestyle=(0, (6, 2)), zorder=1.5)
            text = f"{order:g}×" if len(reference) == 1 else f"{order:g}× {number(spin * RPM, 4)} rpm"
            end = min(0.96 * right / unit, 0.96 * top / slope)
            named.append((text, unit * end, slope * end))
    places = LabelPlacer(axes, [np.column_stack([line.get_xdata(), line.get_ydata()]) for line in axes.lines])
    for text, x, y in named:
        places.write(text, x, y, colour=MUTED, size=7.5, directions=(160, 180, -20, 90))
    if axes.get_xlim()[0] < unit < right:
        places.write("nominal", unit, 0.975 * top, colour=MUTED, size=7.0, directions=(0, 180))
    marks = []
    for spin in reference:
        for order in orders:
            for mode in modes:
                for at, frequency in _meetings(mode.frequency, speed, order * spin):
                    axes.plot([unit * at], [frequency * HZ], "D", color=LIMIT, markersize=5, zorder=5, linestyle="none")
                    places.reserve(unit * at, frequency * HZ)
                    where = f"{number(unit * at, 4)} rpm" if len(reference) == 1 else f"× {number(at, 3)}"
                    marks.append((f"{order:g}× meets {mode.kind}: {where}", unit * at, frequency * HZ))
    for text, x, y in marks:
        places.write(text, x, y, colour=LIMIT, size=7.5)


def _meetings(frequency: FloatArray, speed: FloatArray, slope: float) -> list[tuple[float, float]]:
    """Return speeds and frequencies, rad/s, at which a mode swings with `slope` times the speed."""
    apart = frequency - slope * speed
    out: list[tuple[float, float]] = []
    for k in range(len(speed) - 1):
        if (
            frequency[k] > 0.0
            and frequency[k + 1] > 0.0
            and apart[k] * apart[k + 1] <= 0.0
            and apart[k] != apart[k + 1]
        ):
            at = float(speed[k] + (speed[k + 1] - speed[k]) * apart[k] / (apart[k] - apart[k + 1]))
            if at > _CORNER * speed[-1] and (not out or at - out[-1][0] > 1e-9):
                out.append((at, slope * at))
    return out
