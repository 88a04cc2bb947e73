"""A sampled loop at its torque limits while the platform turns, in deviation from the equilibrium that turns with it.

::

        b ──► 1/(s/ρ + 1) ──► 1/s ──► Omega ──┐
                                              ▼
        u ──►[ limit ]──► hold, delay, lag ──► plant ──► angles ──► K ──► u
                │                                                   ▲
                └──────────── excess: limited u − u ──► E ──────────┘

For a constant Omega the loop rests at x = x_e Omega, with the torques u_e Omega that hold the gyros (L Omega). Only a
change of Omega moves ξ = x − x_e Omega, and the limits less |u_e Omega| are left to bring it back. The derivative of
Omega is filtered at the corner ρ: |b| <= 1 covers every manoeuvre whose |Ω' + Ω''/ρ| is below `jerk` times its largest
rate; among them the half-cosine of length `rise`. Between the samples b is held.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.poles import poles, spectral_radius
from platform_ctrl.analysis.sampling import held_input, sampled, with_lag
from platform_ctrl.common.arguments import known_name, not_negative, positive, real_numbers
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    from control import StateSpace


@value
class LimitedLoop:
    """A sampled loop with limited torques, states η = [ξ, Ω'] with ξ = [plant and lags, held controls, controller].

    With φ = u − limited u and an anti-windup gain E, for one rad/s of Omega,

        η⁺ = A η − (B + R E) φ + B_w b,    u = u_steady Omega + K η,    angles = angle_steady Omega + C η.

    Attributes
    ----------
    A, B, B_w, R, K, C
        Matrices of the equations above, SI units for one rad/s of Omega; R selects the controller's states. Shapes (n,
        n), (n, m), (n, 1), (n, n_K), (m, n), (p, n).
    u_steady, angle_steady
        Torques and angles in equilibrium, N m and rad for each rad/s. Shapes (m,), (p,).
    limits, stops
        Largest torques, N m, and angles, rad (inf: none). Shapes (m,), (p,).
    period, rise, corner
        Sample period, s; length of the half-cosine, s; corner ρ of the filter, rad/s.
    jerk
        Bound of |Ω' + Ω''/ρ| for one rad/s of Omega, 1/s.
    controls, measurements
        Signal names.
    controller
        As given.
    impulses : (n, m)
        States after unit torque impulses (1 N m s), one column a control.
    """

    A: FloatArray
    B: FloatArray
    B_w: FloatArray
    R: FloatArray
    K: FloatArray
    C: FloatArray
    u_steady: FloatArray
    angle_steady: FloatArray
    limits: FloatArray
    stops: FloatArray
    period: float
    rise: float
    corner: float
    jerk: float
    controls: tuple[str, ...]
    measurements: tuple[str, ...]
    controller: StateSpace
    impulses: FloatArray

    @property
    def static_Omega(self) -> float:
        """The rate, rad/s, whose torques in equilibrium take all of a limit."""
        with np.errstate(divide="ignore"):
            shares = np.concatenate([self.limits / np.abs(self.u_steady), self.stops / np.abs(self.angle_steady)])
        return float(shares.min(initial=np.inf))

    @check_arguments
    def impulse(self, control: str) -> FloatArray:
        """Return the state (n,) after an impulse of 1 N m s where a control acts, behind its lag."""
        return np.asarray(self.impulses[:, known_name("control", control, self.controls)])


@check_arguments
def limited_loop(  # noqa: PLR0913 - options by keyword
    plant: StateSpace,
    controller: StateSpace,
    disturbance: str | dict[str, float],
    *,
    limits: ArrayLike,
    stops: ArrayLike = math.inf,
    delay: float = 0.0,
    lag: ArrayLike | None = None,
    rise: float = 0.5,
    corner: float | None = None,
) -> LimitedLoop:
    """Return the loop of a continuous plant and a sampled controller, joined by the controller's signal names.

    Parameters
    ----------
    plant
        Continuous; among its inputs the controller's outputs and the disturbance, among its outputs the
        controller's inputs.
    controller
        u = K y, ``dt`` the sample period.
    disturbance
        Input of the plant that plays Omega, or several with their direction cosines (dimensionless).
    limits, stops
        Largest torques, N m, and largest angles, rad; in the controller's order of signals, or one for all. Shapes
        (m,), (p,) or scalar.
    delay
        From sample to torque, s.
    lag : (m,) or scalar, optional
        Time constants of the torquers, s; default none.
    rise
        Length of the half-cosine, s.
    corner
        Corner ρ of the filter, rad/s; default 4 π/rise.

    Returns
    -------
    LimitedLoop
        With its states in deviation from the equilibrium.

    Raises
    ------
    ArgumentError
        The arguments do not fit, or the loop without limits is not stable.
    """
    P, K = state_arrays(plant, "limited_loop (plant)"), state_arrays(controller, "limited_loop (controller)")
    if P.dt != 0.0 or not K.dt > 0.0:
        raise ArgumentError(
            f"limited_loop: the plant must be continuous and the controller sampled, got dt = {P.dt} and {K.dt}"
        )
    shares = {disturbance: 1.0} if isinstance(disturbance, str) else dict(disturbance)
    u = [known_name("limited_loop, torque", name, plant.input_labels) for name in controller.output_labels]
    y = [known_name("limited_loop, angle", name, plant.output_labels) for name in controller.input_labels]
    w = np.zeros((P.B.shape[1], 1))
    for name, share in shares.items():
        w[known_name("limited_loop, disturbance", name, plant.input_labels)] = share
    m, p = len(u), len(y)
    if np.any(P.D[np.ix_(y, u)]) or np.any(P.D[y] @ w):
        raise ArgumentError("limited_loop: the plant must have no direct term from torques and disturbance to angles")
    rise = positive("limited_loop: rise", rise)
    rho = 4.0 * math.pi / rise if corner is None else positive("limited_loop: corner", corner)
    lags = not_negative("limited_loop: lag", 0.0 if lag is None else lag, m)
    lagged = with_lag(StateArrays(P.A, P.B[:, u], P.C[y], np.zeros((p, m))), lags)
    behind = ((0, len(lagged.A) - len(P.A)), (0, 0))
    driven = _driven(lagged, np.pad(P.B @ w, behind), rho, K.dt, delay)
    A, B, C, _, _ = driven.plant
    held, order = len(A), len(K.A)
    closed = np.block([[A + B @ K.D @ C, B @ K.C], [K.B @ C, K.A]])
    radius = float(spectral_radius(poles(closed)))
    if not radius < 1.0:
        raise ArgumentError(
            f"limited_loop: without limits the loop must be stable, but has a pole at |z| = {radius:.6g}"
        )
    command = np.hstack([K.D @ C, K.C])
    by_Omega, by_slope, by_b = (np.pad(column, ((0, order), (0, 0))) for column in driven.columns)
    steady = np.linalg.solve(np.eye(len(closed)) - closed, by_Omega)
    u_steady, angle_steady = (command @ steady)[:, 0], (C @ steady[:held])[:, 0]
    # An integrator leaves rounding in place of zero.
    rounding = 1e-9 * np.abs(C).sum(axis=1) * np.abs(steady).max()
    angle_steady = np.where(np.abs(angle_steady) > rounding, angle_steady, 0.0)
    jerk = 0.5 * math.pi / rise * math.hypot(1.0, math.pi / (rise * rho))
    size = len(closed) + 1
    (rate_by_slope, rate_by_b), (slope_by_slope, slope_by_b) = driven.filter
    edge = np.zeros((1, m))
    return LimitedLoop(
        A=np.block([[closed, by_slope - steady * rate_by_slope], [np.zeros((1, size - 1)), slope_by_slope]]),
        B=np.vstack([B, np.zeros((order, m)), edge]),
        B_w=jerk * np.vstack([by_b - steady * rate_by_b, [[slope_by_b]]]),
        R=np.vstack([np.zeros((held, order)), np.eye(order), np.zeros((1, order))]),
        K=np.hstack([command, np.zeros((m, 1))]),
        C=np.hstack([C, np.zeros((p, order + 1))]),
        u_steady=u_steady,
        angle_steady=angle_steady,
        limits=_each("limits", limits, m),
        stops=_each("stops", stops, p),
        period=K.dt,
        rise=rise,
        corner=rho,
        jerk=jerk,
        controls=tuple(controller.output_labels),
        measurements=tuple(controller.input_labels),
        controller=controller,
        impulses=np.pad(P.B[:, u], ((0, size - len(P.A)), (0, 0))),
    )


class _Driven(NamedTuple):
    """A sampled plant that Omega drives: columns from Omega, Ω' and b to its states, and the filter of Ω'.

    `filter` are the next Omega and the next Ω' by Ω' and by b, (2, 2).
    """

    plant: StateArrays
    columns: tuple[FloatArray, FloatArray, FloatArray]
    filter: FloatArray


def _driven(plant: StateArrays, moved: FloatArray, corner: float, period: float, delay: float) -> _Driven:
    """Return a continuous plant, which Omega moves by the column `moved`, sampled with hold and delay."""
    A, B, C, _, _ = plant
    (n, m), p = B.shape, len(C)
    # Behind the plant's states: Omega, and its derivative behind the filter.
    rate, slope = n, n + 1
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, rate : rate + 1] = A, moved
    whole[rate, slope], whole[slope, slope] = 1.0, -corner
    into_filter = np.zeros((n + 2, 1))
    into_filter[slope] = corner
    continuous = StateArrays(whole, np.pad(B, ((0, 2), (0, 0))), np.pad(C, ((0, 0), (0, 2))), np.zeros((p, m)))
    Ad, Bd, Cd, Dd, dt = sampled(continuous, period, delay)
    late = np.pad(held_input(whole, into_filter, period)[1], ((0, len(Ad) - n - 2), (0, 0)))
    own = [*range(n), *range(n + 2, len(Ad))]
    columns = Ad[own, rate : rate + 1], Ad[own, slope : slope + 1], late[own]
    of_filter = np.column_stack([Ad[[rate, slope], slope], late[[rate, slope], 0]])
    return _Driven(StateArrays(Ad[np.ix_(own, own)], Bd[own], Cd[:, own], Dd, dt), columns, of_filter)


def _each(name: str, given: ArrayLike, count: int) -> FloatArray:
    array = real_numbers(f"limited_loop: {name}", given)
    if array.shape not in ((), (count,)) or not np.all(array > 0.0):
        raise ArgumentError(f"limited_loop: {name} must be one positive number or {count}, got {short(given)}")
    return np.full(count, array)
