"""Where the poles of a closed loop go while its gain, or the speed of the rotors, changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, scaled, state_arrays
from platform_ctrl.analysis.feedback import closed_loop_arrays, loop_transfer
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.analysis.rational import LinearSystem
from platform_ctrl.analysis.sampled import sampled_arrays, with_lag
from platform_ctrl.arguments import known_names, positive, real_numbers
from platform_ctrl.description import Platform
from platform_ctrl.design.plants import changed
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.linearisation import linearise
from platform_ctrl.report.branches import Poles, followed, traced
from platform_ctrl.report.plots.planes import View, view_of
from platform_ctrl.report.plots.systems import as_state_space, drawn_systems
from platform_ctrl.signatures import short
from platform_ctrl.state_space import state_space

if TYPE_CHECKING:
    import control


# A pole this near to the boundary, against the largest, counts as on it: multiple ones come out that far away.
_ON = 1e-9
# An edge of stability this near to an end of the range, against its length, lies at the end.
_BESIDE = 1e-6
# Branches are drawn by steps of this share of the view at most.
_STEP = 0.012


@value
class Locus:
    """Poles of a closed loop over a number.

    Attributes
    ----------
    values : (N,)
        The number, increasing: closer together where poles move fast.
    branches : complex (N, n)
        Poles in their own plane, s in rad/s or z, each column one continuous branch.
    nominal : complex (n,)
        Those at 1.
    dt
        Sample period, s; 0: continuous.
    stable : (N,)
        Whether all poles lie inside the stability boundary.
    edges : (k,)
        Numbers between the ends at which that changes, to rounding.
    view
        What of the s-plane shows it.
    """

    values: FloatArray
    branches: ComplexArray
    nominal: ComplexArray
    dt: float
    stable: NDArray[np.bool_]
    edges: FloatArray
    view: View

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
    """Return the poles of the closed loop while all of the controller is multiplied by one factor.

    Raises
    ------
    ArgumentError
        Plant and controller do not fit, `gains` are not increasing numbers, or a direct gain makes the loop singular.
    """
    factors = increasing("gains", gains, np.linspace(0.0, 2.5, 101))
    parts = _linear("root_locus: plant", plant), _linear("root_locus: controller", controller)
    L = state_arrays(loop_transfer(*parts), "root_locus")
    A, B, C = scaled(L.A, L.B, L.C)
    if not len(A):
        raise ArgumentError("root_locus: neither the plant nor the controller has a state; expected poles to draw")
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
    """Return the poles of a loop while the momenta of rotors are multiplied by one factor; see `root_locus_over_spin`.

    Raises
    ------
    ArgumentError
        Names that do not exist, a controller that does not fit, rotors that stand still, numbers that make no sense.
    """
    factors = increasing("spins", spins, np.linspace(0.2, 1.8, 101))
    controller = _linear("root_locus_over_spin: controller", controller)
    K = state_arrays(controller, "root_locus_over_spin: controller")
    dt = 0.0 if period is None else positive("period", period)
    late = positive("delay", delay, zero=True)
    if period is None and late:
        raise ArgumentError(f"delay: given {delay!r} without a period; expected 0, or a sample period in s as well")
    if controller.dt is not None and abs(K.dt - dt) > 1e-9 * max(K.dt, dt):
        raise ArgumentError(f"period: given {period!r}, the controller has dt = {K.dt} s; expected the same")
    still, change, lags = _affine_plant(platform, gimbals, rotors, Omega, controller)

    def poles(k: FloatArray) -> ComplexArray:
        share = k[:, None, None]
        A, B, C, D = (now + share * more for now, more in zip(still[:4], change[:4], strict=True))
        P = with_lag(A, B, C, D, lags) if period is None else sampled_arrays(A, B, C, D, dt, late, lags)
        return np.asarray(np.linalg.eigvals(closed_loop_arrays(*P, *K[:4])[0]), dtype=np.complex128)

    return traced_locus(factors, poles, dt)


def with_rotors_at_rest(platform: Platform, rotors: Sequence[str] | None) -> tuple[Platform, list[str]]:
    """Return the platform with those rotors at rest, and their names; rotors that stand still anyway are left out.

    The linear model is affine in the rotors' momenta: this one and the nominal one give it at every speed.

    Raises
    ------
    ArgumentError
        A name that does not exist, or none of the rotors spins.
    """
    names = [rotor.name for rotor in platform.rotors]
    chosen = names if rotors is None else [names[k] for k in known_names("rotors", rotors, names)]
    turning = [r.name for r in platform.rotors if r.name in chosen and r.angular_momentum != 0.0]
    if not turning:
        given = ", ".join(map(repr, chosen)) or "none at all"
        raise ArgumentError(f"rotors: {given} of platform {platform.name!r}; expected at least one that spins")
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
            f"controller: from {list(controller.input_labels)} to {list(controller.output_labels)}, the gimbals have "
            f"angles {angles} and torquers {torques}; expected the same names, or the same numbers"
        )
    P, P0 = (state_arrays(system[angles, torques], "gimbals") for system in (full, none))
    change = StateArrays(P.A - P0.A, P.B - P0.B, P.C - P0.C, P.D - P0.D, 0.0)
    lag = {torquer.name: torquer.lag for torquer in platform.torquers}
    return P0, change, np.array([lag[name] for name in torques])


def increasing(name: str, given: ArrayLike | None, default: FloatArray) -> FloatArray:
    """Return at least two finite increasing numbers.

    Raises
    ------
    ArgumentError
        They are something else.
    """
    if given is None:
        return default
    out = real_numbers(name, given)
    if out.ndim != 1 or out.size < 2 or not np.isfinite(out).all() or np.any(np.diff(out) <= 0.0):
        raise ArgumentError(f"{name}: given {short(given)}; expected at least two finite increasing numbers")
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

    fine = traced(coarse, poles, shown, _STEP * view.reach)
    z = poles(fine)
    stable = _stable(z, dt)
    at = np.flatnonzero(stable[1:] != stable[:-1])
    found = [_edge(poles, dt, float(fine[k]), float(fine[k + 1]), bool(stable[k])) for k in at]
    # Undamped at an end of the range: on the boundary there, stable or not as soon as it moves.
    beside = _BESIDE * float(fine[-1] - fine[0])
    edges = [edge for edge in found if fine[0] + beside < edge < fine[-1] - beside]
    fine = np.union1d(fine, edges)
    z = poles(fine)
    stable = _stable(z, dt)
    stable[fine <= fine[0] + beside] = _stable(poles(np.array([fine[0] + 2.0 * beside])), dt)[0]
    stable[fine >= fine[-1] - beside] = _stable(poles(np.array([fine[-1] - 2.0 * beside])), dt)[0]
    return Locus(
        values=fine,
        branches=followed(z),
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


def _edge(poles: Callable[[FloatArray], ComplexArray], dt: float, low: float, high: float, before: bool) -> float:
    """Bisect to where stability changes."""
    for _ in range(80):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if bool(_stable(poles(np.array([middle])), dt)[0]) == before:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
