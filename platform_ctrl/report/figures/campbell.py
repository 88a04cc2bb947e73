"""The Campbell diagram: natural frequencies of the gimbals, and what the rotors excite, over the rotors' speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from platform_ctrl.analysis.poles import pole_branches
from platform_ctrl.common.arguments import real_numbers
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, RPM, plain
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.modes import poles_and_kinds, rotors_at_rest
from platform_ctrl.mechanics.state_space import state_space, subsystems, whole_subsystems
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.figures.panels import LabelPlacer
from platform_ctrl.report.figures.root_locus import increasing, spinning
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

    label: str  # Its kind at the nominal speed, and the subsystem
    frequency: FloatArray  # (N,), |Im s|, rad/s
    nominal: float  # At the nominal speed


@standalone
def campbell(
    platform: Platform,
    *,
    gimbals: Sequence[str] | None = None,
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
    spins : (k,), optional
        Increasing factors on the speeds of all rotors, >= 0, at least two: the range. Default 0 to 1.5. Rotors of
        different speeds have an axis in shares of the nominal speed.
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

    See docs/theory/precession.md.
    """
    factors = increasing("spins", spins, np.array([0.0, 1.5]))
    if factors[0] < 0.0:
        raise ArgumentError(f"campbell: spins must be factors >= 0, got {factors[0]:g}")
    multiples = np.atleast_1d(real_numbers("orders", orders))
    if multiples.ndim != 1 or not np.all(np.isfinite(multiples) & (multiples > 0.0)):
        raise ArgumentError(f"campbell: orders must be finite numbers > 0, such as (1, 2), got {multiples}")
    stopped = rotors_at_rest(spinning(platform))
    spin = sorted({round(abs(r.spin), 9) for r in platform.rotors if r.angular_momentum != 0.0})
    unit = RPM * spin[0] if len(spin) == 1 else 1.0
    model, still = linearise(platform, Omega=Omega), linearise(stopped, Omega=Omega)
    chosen = {model.gimbal_names[k] for k in whole_subsystems(model, gimbals)}
    speed = np.union1d(factors, np.linspace(factors[0], factors[-1], _SPEEDS))
    modes = [m for group in subsystems(model) if set(group) <= chosen for m in _modes(model, still, group, speed)]

    labels = [f"{m.label}: {plain(m.nominal * HZ, 3)} Hz at nominal speed" for m in modes]
    figure, [[axes]] = panels(1, 1, _HEIGHT, labels, titles=False)
    handles: list[Any] = []
    for k, mode in enumerate(modes):
        handles += axes.plot(unit * speed, mode.frequency * HZ, **line_style(k))
        if speed[0] <= 1.0 <= speed[-1]:
            mark = MARKERS[k % len(MARKERS)]
            axes.plot([unit], [mode.nominal * HZ], mark, color=SERIES[k % len(SERIES)], markersize=5)
    highest = max((float(m.frequency.max()) for m in modes), default=0.0)
    axes.set_ylim(0.0, 1.18 * HZ * (highest or float(multiples.min()) * spin[0] * float(speed[-1])))
    axes.set_xlim(unit * speed[0], unit * speed[-1])
    linear_axis(axes.xaxis, 8)
    linear_axis(axes.yaxis, 6)
    axes.set_ylabel("frequency, Hz")
    axes.set_xlabel("rotor speed, rpm" if len(spin) == 1 else "rotor speed / nominal")
    if unit > 50.0:
        axes.xaxis.set_major_formatter(lambda rpm, _: f"{rpm:,.0f}")
    if speed[0] < 1.0 < speed[-1]:
        axes.axvline(unit, color=REFERENCE, linewidth=0.8, linestyle=(0, (1.2, 1.4)))
    _spin_lines(axes, modes, speed, unit, spin, multiples)
    if modes:
        legend(figure, handles, labels)
    else:
        words = "these gimbals have no oscillating mode"
        axes.annotate(words, (0.5, 0.5), xycoords="axes fraction", color=MUTED, ha="center")
    return figure


def _modes(model: LinearModel, still: LinearModel, group: tuple[str, ...], speed: FloatArray) -> list[SpinMode]:
    """Return the swinging modes of one subsystem, fastest first.

    The linear model is affine in the rotors' momenta, so that two linearisations give every speed.
    """
    full, rest = (state_space(one, gimbals=group).A for one in (model, still))
    at = np.union1d(speed, 1.0)
    s = pole_branches(np.linalg.eigvals(rest + at[:, None, None] * (full - rest)).astype(np.complex128))
    # A pair counts once. What is this small against the fastest is at rest: poles at zero come out that large.
    s = s[:, s.imag.sum(axis=0) > 0.0]
    lines = np.where(np.abs(s.imag) > _ZERO * float(np.abs(s).max(initial=0.0)), np.abs(s.imag), 0.0)
    poles, kinds = poles_and_kinds(model, group)
    out = []
    for line in lines.T:
        nominal = float(line[at == 1.0][0])
        kind = kinds[int(np.argmin(np.abs(np.abs(poles.imag) - nominal)))] if nominal > 0.0 else "oscillation"
        label = f"{kind} of {'-'.join(group)}"
        out.append(SpinMode(label=label, frequency=line[np.isin(at, speed)], nominal=nominal))
    return sorted(out, key=lambda one: -one.nominal)


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
            text = f"{order:g}×" if len(reference) == 1 else f"{order:g}× {plain(spin * RPM, 4)} rpm"
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
                    where = f"{plain(unit * at, 4)} rpm" if len(reference) == 1 else f"× {plain(at, 3)}"
                    marks.append((where, unit * at, frequency * HZ))
    for text, x, y in marks:
        places.write(text, x, y, colour=LIMIT, size=7.5, required=True)


def _meetings(frequency: FloatArray, speed: FloatArray, slope: float) -> list[tuple[float, float]]:
    """Return speeds and frequencies, rad/s, at which a mode swings with `slope` times the speed."""
    apart = frequency - slope * speed
    swings = (frequency[:-1] > 0.0) & (frequency[1:] > 0.0)
    at = np.flatnonzero(swings & (np.sign(apart[:-1]) != np.sign(apart[1:])) & (apart[1:] != 0.0))
    found = speed[at] + (speed[at + 1] - speed[at]) * apart[at] / (apart[at] - apart[at + 1])
    return [(float(x), slope * float(x)) for x in found if x > _CORNER * speed[-1]]
