"""Where the poles of a closed loop go while its gain, or the speed of the rotors, changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, scaled, state_arrays
from platform_ctrl.analysis.feedback import closed_loop, loop_transfer
from platform_ctrl.analysis.pole_branches import Poles, pole_branches, refined_values
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.analysis.sampling import sampled, with_lag
from platform_ctrl.analysis.transfer_function import LinearSystem
from platform_ctrl.common.arguments import known_names, positive, real_numbers
from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.plants import changed
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.systems import as_state_space, drawn_systems
from platform_ctrl.report.quantities import HZ
from platform_ctrl.report.style import BAND, FRAME, REFERENCE, linear_axis

if TYPE_CHECKING:
    import control

DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8)
_BELOW, _RIGHT, _MOST_RIGHT = 0.05, 0.17, 0.75
# Width of a panel over the height above the real axis, about; room beyond the outermost pole; a gap between poles.
_ASPECT, _BEYOND, _GAP = 1.95, 1.2, 8.0
# Poles within this share of the width are drawn stretched, so much at most; within 1/_FLAT they are on the axis.
_SLIM, _STRETCH, _FLAT = 0.35, 12.0, 400.0
_DASHES = (0, (1.2, 1.8))


@value
class View:
    """How much of the s-plane is shown."""

    reach: float  # Up to which imaginary part, rad/s
    right: float = _RIGHT  # Share of the panel to the right of the imaginary axis
    stretch: float = 1.0  # How much longer a real part is drawn than an imaginary one


def round_steps(top: float, number: int = 4) -> FloatArray:
    """Return `number` or so round numbers up to `top`, equally spaced, without 0."""
    rough = top / number
    decade = 10.0 ** np.floor(np.log10(rough))
    step = decade * min((1.0, 2.0, 2.5, 5.0, 10.0), key=lambda unit: abs(np.log(unit * decade / rough)))
    return np.asarray(np.arange(1, int(top / step + 1e-9) + 1) * step)


def s_plane(axes: Axes, view: View) -> LabelPlacer:
    """Make `axes` the upper half of the s-plane, with damping rays and frequency arcs.

    Both axes have the same scale, so that a ray's direction is the damping ratio; unless all poles lie close to the
    imaginary axis, where rays and arcs are stretched with them.
    """
    reach = view.reach
    whole = axes.get_window_extent()
    width, height = whole.width, whole.height
    span = (1.0 + _BELOW) * reach
    across = span * width / height / view.stretch
    left, right = -(1.0 - view.right) * across, view.right * across
    axes.set_xlim(left, right)
    axes.set_ylim(-_BELOW * reach, reach)
    axes.grid(False)
    axes.axvspan(0.0, right, color=BAND, linewidth=0, zorder=0)
    axes.axvline(0.0, color=REFERENCE, linewidth=0.9, zorder=1)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6, zorder=1)
    turn = np.linspace(0.5 * np.pi, np.pi, 181)
    places = LabelPlacer(axes)
    for hz in round_steps(reach * HZ):
        radius = hz / HZ
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=FRAME, linewidth=0.6, linestyle=_DASHES, zorder=1)
        if radius < 0.97 * reach:
            places.write_later(f"{hz:g} Hz", 0.0, radius, (0,))
    for ratio in DAMPINGS:
        slope = ratio / np.sqrt(1.0 - ratio**2)
        end = min(reach, -left / slope)
        axes.plot([0.0, -slope * end], [0.0, end], color=FRAME, linewidth=0.7, zorder=1)
        at = 0.955 * end
        text = f"{ratio:g}" if ratio != DAMPINGS[1] else f"damping {ratio:g}"
        places.write_later(text, -slope * at, at, (180, 0))
    linear_axis(axes.xaxis, 8)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part, 1/s")
    axes.set_ylabel("imaginary part, rad/s")
    return places


def z_plane(axes: Axes, period: float) -> LabelPlacer:
    """Make `axes` the upper half of the z-plane with the unit circle, damping spirals and frequency rays."""
    axes.set_aspect("equal")
    axes.set_xlim(-1.25, 1.25)
    axes.set_ylim(-0.06, 1.12)
    axes.grid(False)
    turn = np.linspace(0.0, np.pi, 361)
    circle = np.exp(1j * turn)
    x = np.linspace(-1.6, 1.6, 641)
    rim = np.where(np.abs(x) < 1.0, np.sqrt(np.maximum(1.0 - x**2, 0.0)), -0.06)
    axes.fill_between(x, rim, 1.2, color=BAND, linewidth=0, zorder=0)
    axes.plot(circle.real, circle.imag, color=REFERENCE, linewidth=0.9, zorder=1)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6, zorder=1)
    places = LabelPlacer(axes)
    for hz in round_steps(0.5 / period, 5):
        angle = hz / HZ * period
        ray = np.array([0.0, np.exp(1j * angle)])
        axes.plot(ray.real, ray.imag, color=FRAME, linewidth=0.6, linestyle=_DASHES, zorder=1)
        at = np.exp(1j * min(angle, 0.985 * np.pi))
        places.write_later(f"{hz:g} Hz", at.real, at.imag, (int(np.degrees(angle)), 60, 120))
    for ratio in DAMPINGS[1:]:
        spiral = np.exp(turn * (-ratio / np.sqrt(1.0 - ratio**2) + 1j))
        axes.plot(spiral.real, spiral.imag, color=FRAME, linewidth=0.7, zorder=1)
        at = spiral[150]
        text = f"{ratio:g}" if ratio != DAMPINGS[1] else f"damping {ratio:g}"
        places.write_later(text, at.real, at.imag, (-90, 90))
    linear_axis(axes.xaxis, 8)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part of z")
    axes.set_ylabel("imaginary part of z")
    return places


def view_of(ends: ComplexArray, between: ComplexArray, nyquist: float, reach: float | None = None) -> View:
    """Return a view of the s-plane that shows the poles `ends`, 1/s, and those `between` that are no faster.

    Very fast poles are left out, and of a sampled system those beyond half the Nyquist frequency: delay and roll-off.
    """
    bound = _bound(ends, nyquist)
    every = np.concatenate([ends, between])
    s = every[np.isfinite(every) & (np.abs(every) <= bound)]
    up, left, right = (_BEYOND * float(np.max(x, initial=0.0)) for x in (np.abs(s.imag), -s.real, s.real))
    if reach is None:
        reach = max(up, (left + right) / _ASPECT) or 1.0
        share = float(np.clip(right / (_ASPECT * reach), _RIGHT, _MOST_RIGHT))
        reach = max(reach, left / ((1.0 - share) * _ASPECT))
    across = whole = _ASPECT * reach
    if whole / _FLAT < left + right < _SLIM * whole:
        # Little damping: what there is to see lies in a narrow strip.
        across = max(left + right, whole / _STRETCH)
    share = float(np.clip(right / across, _RIGHT, _MOST_RIGHT))
    across = max(across, min(max(left / (1.0 - share), right / share), whole))
    return View(reach=reach, right=share, stretch=whole / across)


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


# A pole this near to the boundary, against the largest, counts as on it: multiple ones come out that far away.
_ON = 1e-9
# An edge of stability this near to an end of the range, against its length, lies at the end.
_BESIDE = 1e-6
# Branches are drawn by steps of this share of the view at most.
_STEP = 0.012


@value
class Locus:
    """Poles of a closed loop over a number."""

    values: FloatArray  # (N,), The number, increasing: closer together where poles move fast
    branches: ComplexArray  # (N, n), Poles in their own plane, s in rad/s or z, each column one continuous branch
    nominal: ComplexArray  # (n,), Those at 1
    dt: float  # Sample period, s; 0: continuous
    stable: NDArray[np.bool_]  # (N,), Whether all poles lie inside the stability boundary
    edges: FloatArray  # (k,), Numbers between the ends at which that changes, to rounding
    view: View  # What of the s-plane shows it

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


def gain_locus(plant: LinearSystem, controller: LinearSystem, gains: ArrayLike | None) -> Locus:
    """Return the poles of the closed loop while all of the controller is multiplied by one factor."""
    factors = increasing("gains", gains, np.linspace(0.0, 2.5, 101))
    parts = _linear("root_locus: plant", plant), _linear("root_locus: controller", controller)
    L = state_arrays(loop_transfer(*parts), "root_locus")
    A, B, C = scaled(L.A, L.B, L.C)
    if not len(A):
        raise ArgumentError("root_locus: neither the plant nor the controller has a state; there are no poles to draw")
    eye = np.eye(len(L.D))

    def poles(k: FloatArray) -> ComplexArray:
        K = k[:, None, None]
        feedback = K * C
        if L.D.any():
            direct = eye + K * L.D
            if np.linalg.cond(direct).max() > 1e12:
                raise ArgumentError(
                    "root_locus: I + gain D_L is singular for one of the gains: the direct gains of plant and "
                    "controller form an algebraic loop; add a lag or a delay, or leave that gain out"
                )
            feedback = np.asarray(np.linalg.solve(direct, feedback), dtype=np.float64)
        return np.asarray(np.linalg.eigvals(A - B @ feedback), dtype=np.complex128)

    return traced_locus(factors, poles, L.dt)


def _linear(name: str, given: LinearSystem) -> control.StateSpace:
    """Return a system in states: transfer functions are brought to them."""
    [one] = drawn_systems(name, given, data=False)
    return as_state_space(name, one)


def spin_locus(
    platform: Platform,
    gimbals: Sequence[str] | None,
    controller: LinearSystem,
    *,
    rotors: Sequence[str] | None,
    spins: ArrayLike | None,
    period: float | None,
    delay: float,
    Omega: ArrayLike,
) -> Locus:
    """Return the poles of a loop with the momenta of rotors multiplied by one factor; see `root_locus_over_spin`."""
    factors = increasing("spins", spins, np.linspace(0.2, 1.8, 101))
    controller = _linear("root_locus_over_spin: controller", controller)
    K = state_arrays(controller, "root_locus_over_spin: controller")
    dt = 0.0 if period is None else positive("period", period)
    late = positive("delay", delay, zero=True)
    if period is None and late:
        raise ArgumentError(f"root_locus_over_spin: a delay of {delay!r} s needs a sample period; give period in s")
    if controller.dt is not None and abs(K.dt - dt) > 1e-9 * max(K.dt, dt):
        raise ArgumentError(f"root_locus_over_spin: period must be the controller's dt, {K.dt} s, got {period!r}")
    still, change, lags = _affine_plant(platform, gimbals, rotors, Omega, controller)

    def poles(k: FloatArray) -> ComplexArray:
        share = k[:, None, None]
        A, B, C, D = (now + share * more for now, more in zip(still[:4], change[:4], strict=True))
        plant = StateArrays(A, B, C, D, 0.0)
        P = with_lag(plant, lags) if period is None else sampled(plant, dt, late, lags)
        return np.asarray(np.linalg.eigvals(closed_loop(P, K).A), dtype=np.complex128)

    return traced_locus(factors, poles, dt)


def with_rotors_at_rest(platform: Platform, rotors: Sequence[str] | None) -> tuple[Platform, list[str]]:
    """Return the platform with those rotors at rest, and their names; rotors already at rest are left out.

    The linear model is affine in the rotors' momenta: this one and the nominal one give it at every speed.
    """
    names = [rotor.name for rotor in platform.rotors]
    chosen = names if rotors is None else [names[k] for k in known_names("rotors", rotors, names)]
    turning = [r.name for r in platform.rotors if r.name in chosen and r.angular_momentum != 0.0]
    if not turning:
        given = ", ".join(map(repr, chosen)) or "none at all"
        raise ArgumentError(f"rotors must include one of platform {platform.name!r} that spins, got {given}")
    return changed(platform, {}, dict.fromkeys(turning, -1.0)), turning


def _affine_plant(
    platform: Platform,
    gimbals: Sequence[str] | None,
    rotors: Sequence[str] | None,
    Omega: ArrayLike,
    controller: control.StateSpace,
) -> tuple[StateArrays, StateArrays, FloatArray]:
    """Return the plant with the rotors at rest, what full speed adds to it, and the lags of its torquers."""
    stopped, _ = with_rotors_at_rest(platform, rotors)
    turning, resting = linearise(platform, Omega=Omega), linearise(stopped, Omega=Omega)
    full = state_space(turning, gimbals=gimbals)
    # At rest there may be more subsystems, never fewer.
    none = state_space(resting, gimbals=gimbals)
    torques = [name for name in full.input_labels if not name.startswith("Omega")]
    angles = list(full.output_labels)
    if set(controller.output_labels) <= set(torques) and set(controller.input_labels) <= set(angles):
        torques, angles = list(controller.output_labels), list(controller.input_labels)
    elif (len(torques), len(angles)) != (controller.noutputs, controller.ninputs):
        raise ArgumentError(
            f"root_locus_over_spin: the controller must use angles {angles} and torquers {torques}, or as many, "
            f"got inputs {list(controller.input_labels)} and outputs {list(controller.output_labels)}"
        )
    P, P0 = (state_arrays(system[angles, torques], "gimbals") for system in (full, none))
    change = StateArrays(P.A - P0.A, P.B - P0.B, P.C - P0.C, P.D - P0.D, 0.0)
    lag = {torquer.name: torquer.lag for torquer in platform.torquers}
    return P0, change, np.array([lag[name] for name in torques])


def upper_half_plane(z: ComplexArray) -> ComplexArray:
    """Return the finite poles of the closed upper half plane."""
    return np.asarray(z[np.isfinite(z.real) & (z.imag >= -1e-9 * np.maximum(np.abs(z), 1e-12))])


def increasing(name: str, given: ArrayLike | None, default: FloatArray) -> FloatArray:
    """Return at least two finite increasing numbers."""
    if given is None:
        return default
    out = real_numbers(name, given)
    if out.ndim != 1 or out.size < 2 or not np.isfinite(out).all() or np.any(np.diff(out) <= 0.0):
        raise ArgumentError(f"{name} must be at least two finite increasing numbers, got {short(given)}")
    return out


def traced_locus(values: FloatArray, poles: Poles, dt: float) -> Locus:
    """Follow the poles through `values`, finer where they run, and find where stability begins and ends."""
    nominal = poles(np.ones(1))[0]
    nyquist = np.pi / dt if dt else np.inf
    coarse = np.union1d(values, np.linspace(values[0], values[-1], 61))
    coarse = np.union1d(coarse, [1.0]) if values[0] <= 1.0 <= values[-1] else coarse
    ends = np.concatenate([poles(values[[0, -1]]).ravel(), nominal])
    view = view_of(continuous_poles(ends, dt), continuous_poles(poles(coarse).ravel(), dt), nyquist)

    def shown(z: ComplexArray) -> ComplexArray:
        s = continuous_poles(z, dt)
        outside = ~(np.abs(s) < 3.0 * view.reach)
        return np.where(outside, np.nan, view.stretch * s.real + 1j * s.imag)

    # At an end of the range the loop may be undamped: what counts there is stability a little inside.
    inside = np.array([1.0, -1.0]) * 2.0 * _BESIDE * (values[-1] - values[0]) + values[[0, -1]]

    def stability(at: FloatArray) -> NDArray[np.bool_]:
        return _stable(poles(np.clip(at, *inside)), dt)

    fine = refined_values(coarse, poles, shown, _STEP * view.reach)
    stable = stability(fine)
    at = np.flatnonzero(stable[1:] != stable[:-1])
    edges = [_edge(stability, float(fine[k]), float(fine[k + 1]), bool(stable[k])) for k in at]
    fine = np.union1d(fine, edges)
    z, stable = poles(fine), stability(fine)
    return Locus(
        values=fine,
        branches=pole_branches(z),
        nominal=nominal,
        dt=dt,
        stable=stable,
        edges=np.array(edges),
        view=view,
    )


def _stable(z: ComplexArray, dt: float) -> NDArray[np.bool_]:
    growth = np.abs(z).max(axis=-1) - 1.0 if dt else z.real.max(axis=-1)
    size = 1.0 if dt else np.abs(z).max(axis=-1)
    return np.asarray(growth < -_ON * size)


def _edge(stability: Callable[[FloatArray], NDArray[np.bool_]], low: float, high: float, before: bool) -> float:
    """Bisect to where stability changes."""
    for _ in range(80):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (middle, high) if bool(stability(np.array([middle]))[0]) == before else (low, middle)
    return 0.5 * (low + high)
