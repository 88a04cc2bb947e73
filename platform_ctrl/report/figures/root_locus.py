"""Root loci over the loop's gain and over the speed of the rotors, with the numbers written along the branches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import ArrayLike

from platform_ctrl.analysis.curves import PlaneView, RootLocus, traced_locus, upper_half_plane
from platform_ctrl.analysis.feedback import loop_transfer
from platform_ctrl.analysis.poles import continuous_poles, damping_ratio
from platform_ctrl.analysis.response import NamedSystem, linear_arrays
from platform_ctrl.analysis.sampling import sampled, with_lag
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import instance, known_names, positive, real_numbers, short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.sections import gain
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, listed
from platform_ctrl.job.quantities import plain as number
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.modes import rotors_at_rest
from platform_ctrl.mechanics.state_space import linear_system
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report import style
from platform_ctrl.report.figures.panels import LabelPlacer, control_plot

if TYPE_CHECKING:
    import control


_HEIGHT = 4.6
# Damping ratios of the rays; the part below the real axis, of the reach.
DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8)
_BELOW = 0.05
_DASHES = (0, (1.2, 1.8))
# Numbers written along the branches, at most.
_LABELS = 9
# Branches shorter than this in the panel, points, carry none.
_SHORTEST = 24.0


@style.standalone
def root_locus(plant: NamedSystem, controller: NamedSystem, *, gains: ArrayLike | None = None) -> control.ControlPlot:
    """Poles of the closed loop while all of the controller's gains are multiplied by one factor.

    Crosses mark the smallest factor (0: the poles of plant and controller), rings the design itself; the factors are
    written along the branches, and red diamonds mark where the stability boundary is crossed. Only the upper half of
    the s-plane is drawn, the lower one is its mirror image; poles of a sampled loop by s = ln(z)/T.

    Parameters
    ----------
    plant, controller
        Joined as in `analysis.loop_transfer`: u = K y with no hidden sign; both continuous, or with the same sample
        period. Several channels are closed together.
    gains : (k,), optional
        Increasing factors, at least two: the range. More are taken between them wherever poles run. Default 0 to 2.5.

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
    return draw_locus(gain_locus(plant, controller, gains), "gain", "loop gain / nominal")


@style.standalone
def root_locus_over_spin(
    platform: Platform,
    gimbals: Sequence[str] | None,
    controller: control.StateSpace | control.TransferFunction,
    *,
    spins: ArrayLike | None = None,
    delay: float = 0.0,
) -> control.ControlPlot:
    """Poles of the closed loop while rotors run slower and faster and the controller stays as it is.

    Drawn as `root_locus`. The plant is linearised about zero angles, with the lags of its torquers.

    Parameters
    ----------
    platform
        The plant.
    gimbals
        Names of the gimbals of one or several subsystems; None: all.
    controller
        u = K y, torque = K(pick-off), joined by signal names; its sample period is that of the loop.
    spins : (k,), optional
        Increasing factors on all rotors' angular momenta, at least two: the range. Default 0.2 to 1.8.
    delay
        Of a sampled loop from sample to torque, s.

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

    See docs/theory/mechanics.md.
    """
    factors = increasing("spins", spins, np.linspace(0.2, 1.8, 101))
    K = linear_arrays(controller, "root_locus_over_spin: controller")
    late = positive("delay", delay, zero=True)
    if late and not K.dt:
        raise ArgumentError(f"root_locus_over_spin: a delay of {delay!r} s needs a controller with a sample period")
    # The linear model is affine in the rotors' momenta.
    models = [linearise(one) for one in (rotors_at_rest(spinning(platform)), platform)]
    # At rest there may be more subsystems, never fewer.
    still, full = (linear_system(model, gimbals).state_space() for model in models)
    angles, torques = list(controller.input_labels), list(controller.output_labels)
    known_names("root_locus_over_spin: inputs of the controller", angles, list(still.output_labels))
    known_names("root_locus_over_spin: outputs of the controller", torques, list(still.input_labels))
    P0, P1 = (System.of(system[angles, torques], "gimbals") for system in (still, full))
    lag = {torquer.name: torquer.lag for torquer in platform.torquers}
    lags = np.array([lag[name] for name in torques])

    def poles(k: FloatArray) -> ComplexArray:
        share = k[:, None, None]
        A, B, C, D = (now + share * (then - now) for now, then in zip(P0[:4], P1[:4], strict=True))
        plant = System(A, B, C, D, 0.0)
        P = sampled(plant, K.dt, late, lags) if K.dt else with_lag(plant, lags)
        return np.asarray(np.linalg.eigvals(P.feedback(K).A), dtype=np.complex128)

    return draw_locus(traced_locus(factors, poles, K.dt), "speed", "rotor speed / nominal")


def s_plane(axes: Axes, view: PlaneView) -> list[tuple[str, float, float, tuple[int, ...]]]:
    """Make `axes` the upper half of the s-plane, with damping rays and frequency arcs; return what to write at them.

    Both axes have the same scale, so that a ray's direction is the damping ratio; unless all poles lie close to the
    imaginary axis, where rays and arcs are stretched with them.
    """
    reach = view.reach
    whole = axes.get_window_extent()
    across = (1.0 + _BELOW) * reach * whole.width / whole.height / view.stretch
    left, right = -(1.0 - view.right) * across, view.right * across
    axes.set_xlim(left, right)
    axes.set_ylim(-_BELOW * reach, reach)
    axes.grid(False)
    axes.axvspan(0.0, right, color=style.BAND, linewidth=0, zorder=0)
    axes.axvline(0.0, color=style.REFERENCE, linewidth=0.9, zorder=1)
    axes.axhline(0.0, color=style.REFERENCE, linewidth=0.6, zorder=1)
    turn = np.linspace(0.5 * np.pi, np.pi, 181)
    labels: list[tuple[str, float, float, tuple[int, ...]]] = []
    steps = np.asarray(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, reach * HZ))
    for hz in steps[(steps > 0.0) & (steps <= reach * HZ * (1.0 + 1e-9))]:
        radius = hz / HZ
        axes.plot(
            radius * np.cos(turn), radius * np.sin(turn), color=style.FRAME, linewidth=0.6, linestyle=_DASHES, zorder=1
        )
        if radius < 0.97 * reach:
            labels.append((f"{hz:g} Hz", 0.0, radius, (0,)))
    for ratio in DAMPINGS:
        slope = ratio / np.sqrt(1.0 - ratio**2)
        end = min(reach, -left / slope)
        axes.plot([0.0, -slope * end], [0.0, end], color=style.FRAME, linewidth=0.7, zorder=1)
        at = 0.955 * end
        text = f"{ratio:g}" if ratio != DAMPINGS[1] else f"damping {ratio:g}"
        labels.append((text, -slope * at, at, (180, 0)))
    style.linear_axis(axes.xaxis, 8)
    style.linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part, 1/s")
    axes.set_ylabel("imaginary part, rad/s")
    return labels


def draw_locus(locus: RootLocus, word: str, quantity: str) -> control.ControlPlot:
    """Draw poles over a number: what a word says, and in the legend a quantity."""
    low, high = float(locus.values[0]), float(locus.values[-1])
    points, nominal = locus.s, continuous_poles(locus.nominal, locus.dt)
    at_start = f"{word} {number(low, 3)}" + (": plant and controller" if low == 0.0 and word == "gain" else "")
    marked = [(points[0], "x", style.INK, 5.5, at_start)]
    if low <= 1.0 <= high:
        marked.append((nominal, "o", style.SERIES[1], 7.0, f"{word} 1: nominal"))
    names = [quantity, *(name for *_, name in marked), *["stability begins or ends"] * bool(locus.edges.size)]
    _, grid = style.panels(1, 1, _HEIGHT, names)
    axes: Axes = grid[0, 0]
    labels = s_plane(axes, locus.view)
    lines = _branches(axes, points)
    places = LabelPlacer(axes, lines)
    handles: list[Any] = [
        Line2D([], [], marker="o", linestyle="-", markersize=3.2, color=style.SERIES[0], linewidth=1.3)
    ]
    for where, marker, colour, size, _ in marked:
        upper = upper_half_plane(where)
        look: dict[str, Any] = {"marker": marker, "color": colour, "markersize": size, "markerfacecolor": "none"}
        handles += axes.plot(upper.real, upper.imag, linestyle="none", markeredgewidth=1.3, zorder=4, **look)
        for s in upper:
            places.reserve(s.real, s.imag, 4.0)
    marks = _dots(axes, places, locus, points)
    handles += _edges(axes, places, locus, word)
    for text, at in marks:
        places.write(text, at.real, at.imag)
    # Labels of the plane go where the others leave room.
    for text, x, y, directions in labels:
        places.write(text, x, y, colour=style.MUTED, size=6.5, directions=directions)
    axes.set_title(_stable_words(locus, word))
    plot = control_plot(grid, lines, handles, names)
    plot.locus = locus
    return plot


def _branches(axes: Axes, points: ComplexArray) -> list[Line2D]:
    size = np.abs(np.where(np.isfinite(points), points, 0.0)).max(initial=1e-300)
    lines: list[Line2D] = []
    for branch in points.T:
        shown = np.where(np.isfinite(branch) & (branch.imag > -1e-9 * size), branch, complex(np.nan, np.nan))
        if np.isfinite(shown.real).any():
            lines += axes.plot(shown.real, shown.imag, "-", color=style.SERIES[0], linewidth=1.3, zorder=2)
    return lines


def _edges(axes: Axes, places: LabelPlacer, locus: RootLocus, word: str) -> list[Line2D]:
    """Mark the poles on the boundary where stability begins or ends, each with its number; return one of the marks."""
    drawn: list[Line2D] = []
    for edge in locus.edges:
        s = locus.s[int(np.argmin(np.abs(locus.values - edge)))]
        outermost = upper_half_plane(s[np.isfinite(s)])
        at = 1j * outermost[int(np.argmax(outermost.real))].imag
        drawn = axes.plot([at.real], [at.imag], "D", color=style.LIMIT, markersize=5.0, linestyle="none", zorder=5)
        places.reserve(at.real, at.imag, 4.0)
        places.write(
            f"{word} {number(edge, 3)}", at.real, at.imag, colour=style.LIMIT, size=7.5, bold=True, required=True
        )
    return drawn


def _dots(axes: Axes, places: LabelPlacer, locus: RootLocus, points: ComplexArray) -> list[tuple[str, complex]]:
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
                axes.plot([at.real], [at.imag], "o", color=style.SERIES[0], markersize=3.2, linestyle="none", zorder=3)
                places.reserve(at.real, at.imag, 1.8)
                out.append((number(x, 3), at))
    return out


def _round_numbers(low: float, high: float) -> FloatArray:
    several_decades = low > 0.0 and high > 20.0 * low
    locator = LogLocator(subs=(1.0, 2.0, 5.0)) if several_decades else MaxNLocator(_LABELS, steps=[1, 2, 5, 10])
    numbers = np.round(locator.tick_values(low, high), 12) + 0.0
    return np.asarray(numbers[(numbers >= low * (1.0 - 1e-12)) & (numbers <= high * (1.0 + 1e-12))])


def _stable_words(locus: RootLocus, word: str) -> str:
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


def gain_locus(
    plant: NamedSystem, controller: NamedSystem, gains: ArrayLike | None = None, unseen: int = 0
) -> RootLocus:
    """Return the poles of the closed loop while all of the controller is multiplied by one factor.

    So many poles at rest are left out as are `unseen`: of angles that drift, from which nothing follows.
    """
    factors = increasing("gains", gains, np.linspace(0.0, 2.5, 101))
    L = System.of(loop_transfer(plant, controller), "root_locus")
    if not len(L.A):
        raise ArgumentError("root_locus: neither the plant nor the controller has a state; there are no poles to draw")
    m = len(L.D)

    def poles(k: FloatArray) -> ComplexArray:
        closed = L.feedback(gain(-k[:, None, None] * np.eye(m)))
        s = np.asarray(np.linalg.eigvals(closed.A), dtype=np.complex128)
        resting = np.argsort(np.abs(s - (1.0 if L.dt else 0.0)), axis=-1)[..., :unseen]
        kept = np.ones(s.shape, dtype=bool)
        np.put_along_axis(kept, resting, False, axis=-1)
        return s[kept].reshape(len(s), -1)

    return traced_locus(factors, poles, L.dt)


def spinning(platform: Platform) -> Platform:
    """Return a platform that has a rotor with momentum."""
    if not any(r.angular_momentum != 0.0 for r in instance("platform", platform, Platform).rotors):
        raise ArgumentError(f"platform {platform.name!r} must have a rotor that spins")
    return platform


def increasing(name: str, given: ArrayLike | None, default: FloatArray) -> FloatArray:
    """Return at least two finite increasing numbers."""
    if given is None:
        return default
    out = real_numbers(name, given)
    if out.ndim != 1 or out.size < 2 or not np.isfinite(out).all() or np.any(np.diff(out) <= 0.0):
        raise ArgumentError(f"{name} must be at least two finite increasing numbers, got {short(given)}")
    return out
