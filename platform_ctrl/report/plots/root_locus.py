"""Root loci over the loop's gain and over the speed of the rotors, with the numbers written along the branches."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.poles import continuous_poles, damping_ratio
from platform_ctrl.analysis.transfer_function import LinearSystem
from platform_ctrl.common.arguments import one_of, positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.loci import Locus, gain_locus, s_plane, spin_locus, upper_half_plane, z_plane
from platform_ctrl.report.plots.panels import control_plot
from platform_ctrl.report.quantities import listed
from platform_ctrl.report.quantities import plain as number
from platform_ctrl.report.style import INK, LIMIT, SERIES, panels, standalone

if TYPE_CHECKING:
    import control

    from platform_ctrl.plant.platform import Platform

Plane = Literal["s", "z"]

_HEIGHT = 4.6
# Numbers written along the branches: about so many.
_LABELS = 6
# Branches shorter than this in the panel, points, carry none.
_SHORTEST = 24.0


@standalone
def root_locus(
    plant: LinearSystem,
    controller: LinearSystem,
    *,
    gains: ArrayLike | None = None,
    plane: Plane = "s",
    reach: float | None = None,
) -> control.ControlPlot:
    """Poles of the closed loop while all of the controller's gains are multiplied by one factor.

    Crosses mark the smallest factor (0: the poles of plant and controller), rings the design itself; the factors are
    written along the branches, and red diamonds mark where the stability boundary is crossed. Only the
    upper half plane is drawn, the lower one is its mirror image.

    Parameters
    ----------
    plant, controller
        Joined as in `analysis.loop_transfer`: u = K y with no hidden sign; both continuous, or with the same sample
        period. Several channels are closed together.
    gains : (k,), optional
        Increasing factors, at least two: the range. More are taken between them wherever poles run. Default 0 to 2.5.
    plane
        ``"s"``: a sampled loop by s = ln(z)/T; ``"z"``: as it is.
    reach
        How far the view of the s-plane goes, rad/s; default as far as the slow poles need.

    Returns
    -------
    control.ControlPlot
        Its ``locus`` holds the branches and the edges of stability in numbers.

    Raises
    ------
    ArgumentError
        Plant and controller do not fit, a direct gain makes the loop singular, or an option makes no sense.

    References
    ----------
    W. R. Evans, Trans. AIEE 67, 1948.
    """
    return _drawn(gain_locus(plant, controller, gains), "gain", "loop gain / nominal", plane, reach)


@standalone
@check_arguments
def root_locus_over_spin(  # noqa: PLR0913 - options by keyword
    platform: Platform,
    gimbals: Sequence[str] | None,
    controller: LinearSystem,
    *,
    rotors: Sequence[str] | None = None,
    spins: ArrayLike | None = None,
    period: float | None = None,
    delay: float = 0.0,
    Omega: ArrayLike = (0.0, 0.0, 0.0),
    plane: Plane = "s",
    reach: float | None = None,
) -> control.ControlPlot:
    """Poles of the closed loop while rotors run slower and faster and the controller stays as it is.

    Drawn as `root_locus`. The plant is linearised about zero angles and `Omega`, with the lags of its torquers.

    Parameters
    ----------
    platform
        The plant.
    gimbals
        Names of the gimbals of one or several subsystems; None: all.
    controller
        u = K y, torque = K(pick-off); joined by signal names, by position where they are others.
    rotors
        Names of the rotors whose momentum changes, all by one factor; default all.
    spins : (k,), optional
        Increasing factors on the rotors' angular momenta, at least two: the range. Default 0.2 to 1.8.
    period, delay
        Of the sampled loop, s: sample period, and delay from sample to torque. None: a continuous loop.
    Omega : (3,)
        Constant platform rate, rad/s.
    plane, reach
        As in `root_locus`.

    Returns
    -------
    control.ControlPlot
        Its ``locus`` holds the branches and the edges of stability in numbers.

    Raises
    ------
    ArgumentError
        Names that do not exist, a controller that does not fit, no rotor that spins, or an option without sense.

    References
    ----------
    W. R. Evans, Trans. AIEE 67, 1948.

    See docs/theory.md.
    """
    locus = spin_locus(
        platform, gimbals, controller, rotors=rotors, spins=spins, period=period, delay=delay, Omega=Omega
    )
    return _drawn(locus, "speed", "rotor speed / nominal", plane, reach)


def _drawn(locus: Locus, word: str, quantity: str, plane: Plane, reach: float | None) -> control.ControlPlot:
    one_of("plane", plane, ("s", "z"))
    if plane == "z" and not locus.dt:
        raise ArgumentError("root_locus: plane 'z' needs a sampled loop, got a continuous one; use plane 's'")
    view = locus.view if reach is None else dataclasses.replace(locus.view, reach=positive("reach", reach))
    low, high = float(locus.values[0]), float(locus.values[-1])
    points = locus.branches if plane == "z" else locus.s
    nominal = locus.nominal if plane == "z" else continuous_poles(locus.nominal, locus.dt)
    at_start = f"{word} {number(low, 3)}" + (": plant and controller" if low == 0.0 and word == "gain" else "")
    marked = [(points[0], "x", INK, 5.5, at_start)]
    if low <= 1.0 <= high:
        marked.append((nominal, "o", SERIES[1], 7.0, f"{word} 1: nominal"))
    names = [quantity, *(name for *_, name in marked), *["stability begins or ends"] * bool(locus.edges.size)]
    _, grid = panels(1, 1, _HEIGHT, names)
    axes: Axes = grid[0, 0]
    places = z_plane(axes, locus.dt) if plane == "z" else s_plane(axes, view)
    lines = _branches(axes, points)
    places.avoid(lines)
    handles: list[Any] = [Line2D([], [], marker="o", linestyle="-", markersize=3.2, color=SERIES[0], linewidth=1.3)]
    for where, marker, colour, size, _ in marked:
        upper = upper_half_plane(where)
        look: dict[str, Any] = {"marker": marker, "color": colour, "markersize": size, "markerfacecolor": "none"}
        handles += axes.plot(upper.real, upper.imag, linestyle="none", markeredgewidth=1.3, zorder=4, **look)
        for s in upper:
            places.reserve(s.real, s.imag, 4.0)
    marks = _dots(axes, places, locus, points)
    handles += _edges(axes, places, locus, plane, word)
    for text, at in marks:
        places.write(text, at.real, at.imag)
    places.write_remaining()
    axes.set_title(_stable_words(locus, word))
    plot = control_plot(grid, [lines], handles, names)
    plot.locus = locus
    return plot


def _branches(axes: Axes, points: ComplexArray) -> list[Line2D]:
    size = np.abs(np.where(np.isfinite(points), points, 0.0)).max(initial=1e-300)
    lines: list[Line2D] = []
    for branch in points.T:
        shown = np.where(np.isfinite(branch) & (branch.imag > -1e-9 * size), branch, complex(np.nan, np.nan))
        if np.isfinite(shown.real).any():
            lines += axes.plot(shown.real, shown.imag, "-", color=SERIES[0], linewidth=1.3, zorder=2)
    return lines


def _edges(axes: Axes, places: LabelPlacer, locus: Locus, plane: Plane, word: str) -> list[Line2D]:
    """Mark the poles on the boundary where stability begins or ends, each with its number; return one of the marks."""
    drawn: list[Line2D] = []
    for edge in locus.edges:
        s = locus.s[int(np.argmin(np.abs(locus.values - edge)))]
        outermost = upper_half_plane(s[np.isfinite(s)])
        pole = outermost[int(np.argmax(outermost.real))]
        at = np.exp(pole * locus.dt) if plane == "z" else 1j * pole.imag
        drawn = axes.plot([at.real], [at.imag], "D", color=LIMIT, markersize=5.0, linestyle="none", zorder=5)
        places.reserve(at.real, at.imag, 4.0)
        places.write(f"{word} {number(edge, 3)}", at.real, at.imag, colour=LIMIT, size=7.5, bold=True, required=True)
    return drawn


def _dots(axes: Axes, places: LabelPlacer, locus: Locus, points: ComplexArray) -> list[tuple[str, complex]]:
    """Put dots at round numbers on every branch; return the numbers with their places, the least damped first."""
    chosen = [
        x for x in _round_numbers(float(locus.values[0]), float(locus.values[-1])) if x not in (locus.values[0], 1)
    ]
    rows = [int(np.argmin(np.abs(locus.values - x))) for x in chosen]
    finite = np.where(np.isfinite(points), points, 0.0)
    scale = float(np.abs(finite).max(initial=1e-300))
    long = [k for k, branch in enumerate(points.T) if places.length(branch) > _SHORTEST]
    s = continuous_poles(locus.branches[rows], locus.dt)
    ratio = np.where(np.isfinite(s), damping_ratio(s), 1.0).min(axis=0, initial=1.0)
    out: list[tuple[str, complex]] = []
    for column in sorted(long, key=lambda k: float(ratio[k])):
        for x, row in zip(chosen, rows, strict=True):
            at = complex(points[row, column])
            if np.isfinite(at) and at.imag >= -1e-9 * scale:
                axes.plot([at.real], [at.imag], "o", color=SERIES[0], markersize=3.2, linestyle="none", zorder=3)
                places.reserve(at.real, at.imag, 1.8)
                out.append((number(x, 3), at))
    return out


def _round_numbers(low: float, high: float) -> FloatArray:
    if low > 0.0 and high > 20.0 * low:
        units = np.outer(10.0 ** np.arange(np.floor(np.log10(low)), np.log10(high) + 1.0), [1.0, 2.0, 5.0]).ravel()
        return np.asarray(units[(units >= low * (1.0 - 1e-12)) & (units <= high * (1.0 + 1e-12))])
    rough = (high - low) / _LABELS
    decade = 10.0 ** np.floor(np.log10(rough))
    step = decade * min((1.0, 2.0, 5.0, 10.0), key=lambda unit: abs(np.log(unit * decade / rough)))
    first = np.ceil(low / step - 1e-9)
    return np.asarray(np.round(np.arange(first, np.floor(high / step + 1e-9) + 1.0) * step, 12) + 0.0)


def _stable_words(locus: Locus, word: str) -> str:
    low, high = float(locus.values[0]), float(locus.values[-1])
    span = f"{number(low, 3)} to {number(high, 3)}"
    ranges = locus.stable_ranges
    if not ranges:
        return f"{word} {span}: stable nowhere"
    if ranges == [(low, high)]:
        return f"{word} {span}: stable everywhere"
    words = []
    for start, end in ranges:
        if start == low:
            words.append(f"below {number(end, 4)}")
        elif end == high:
            words.append(f"above {number(start, 4)}")
        else:
            words.append(f"between {number(start, 4)} and {number(end, 4)}")
    return f"{word} {span}: stable {listed(words)}"
