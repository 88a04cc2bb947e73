"""Torque limits of a caging loop: the largest Omega without saturation, and anti-windup with a region of attraction.

While only Omega changes, a good loop does not reach its limits until the torques that hold the gyros take nearly all of
them: `largest_Omega` proves up to where, by an ellipsoid from a Lyapunov equation. A shock drives the torques beyond
their limits, and the controller's states wind up. `anti_windup` feeds the excess back into those states,
x⁺ = A x + B y + E (limited u − u), by the gain that makes the region of shocks from which the loop returns largest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.certificates.certificate import Verification
from platform_ctrl.common.arguments import positive, real_array
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.antiwindup.lmi import InvariantEllipsoid, below_the_limits, minimum_decay_rate, widest
from platform_ctrl.design.antiwindup.loop import LimitedLoop
from platform_ctrl.errors import InfeasibleError, NotCertifiedError

if TYPE_CHECKING:
    from control import StateSpace
    from numpy.typing import ArrayLike

# Shares of the minimum decay rate at which ellipsoids are tried; and the one for shocks.
_DECAY_SHARES = (0.02, 0.04, 0.08, 0.13, 0.2, 0.28, 0.36, 0.44, 0.52, 0.6, 0.7, 0.8)
_SHOCK_DECAY_SHARE = 0.1


@value
class LargestOmega:
    """The largest Omega for which torques and angles provably stay within their limits.

    Attributes
    ----------
    Omega
        rad/s. It may have either sign and change as the loop's manoeuvre does (`LimitedLoop.jerk`), often.
    static_Omega
        Where the torques in equilibrium take all of a limit, rad/s.
    ellipsoid
        The proof's data; its `gain` is the anti-windup gain that is needed, zero where torques stay below their
        limits.
    verification
        Result of the proof.
    """

    Omega: float
    static_Omega: float
    ellipsoid: InvariantEllipsoid
    verification: Verification


@value
class AntiWindup:
    """An anti-windup gain with the region of attraction that it gives.

    Attributes
    ----------
    loop
        What was requested.
    gain : (n_K, m)
        E of x⁺ = A x + B y + E (limited u − u), in units of the controller's states per N m.
    controller
        Inputs: the measurements, then ``excess_`` + name for every control, limited less commanded torque of the same
        sample; outputs as before.
    Omega
        Rate of manoeuvres at the same time, rad/s.
    ellipsoid
        The region of attraction with the gain.
    without
        The largest region for the same shocks without anti-windup.
    reach, reach_without
        The largest common multiple of the shocks inside: N m s where they are the unit torque impulses.
    verification
        Result of the proof of `ellipsoid`.
    """

    loop: LimitedLoop
    gain: FloatArray
    controller: StateSpace
    Omega: float
    ellipsoid: InvariantEllipsoid
    without: InvariantEllipsoid
    reach: float
    reach_without: float
    verification: Verification


@check_arguments
def largest_Omega(loop: LimitedLoop, *, saturating: bool = False, time_limit: float = 60.0) -> LargestOmega:
    """Return the largest Omega for which the loop provably stays within its stops and returns.

    The bound is sharp to a few per cent where the manoeuvre is slow compared with the loop; for fast ones it is more
    conservative.

    Parameters
    ----------
    loop
        The loop, see `limited_loop`.
    saturating
        False: torques stay below their limits, which needs no anti-windup and no solver. True: they may exceed them,
        with an anti-windup gain found for the purpose.
    time_limit
        Longest time that one call of the solver may take, s.

    Returns
    -------
    LargestOmega
        The rate, and the ellipsoid that proves it.

    Raises
    ------
    NotCertifiedError
        The proof failed.
    DesignError
        The solver failed.

    References
    ----------
    J. M. Gomes da Silva, S. Tarbouriech, IEEE Trans. Automatic Control 50, 2005.

    See docs/torque-limits.md.
    """
    slowest = minimum_decay_rate(loop)
    best = max((below_the_limits(loop, share * slowest) for share in _DECAY_SHARES), key=lambda one: one.Omega)
    if saturating:
        best = max(best, widest(loop, best.Omega, best.alpha, time_limit=time_limit), key=lambda one: one.Omega)
    shown = best.verify()
    if not shown.proved:
        raise NotCertifiedError(
            f"largest_Omega: {best.Omega:.6g} rad/s was not proved: {shown.reason}; "
            "choose a loop with less spread between slow and fast poles",
            loop,
        )
    return LargestOmega(Omega=best.Omega, static_Omega=loop.static_Omega, ellipsoid=best, verification=shown)


@check_arguments
def anti_windup(
    loop: LimitedLoop, Omega: float = 0.0, shocks: ArrayLike | None = None, *, time_limit: float = 60.0
) -> AntiWindup:
    """Return the static anti-windup gain that makes the provable region of attraction largest.

    Parameters
    ----------
    loop
        The loop, see `limited_loop`.
    Omega
        Rate of manoeuvres at the same time, rad/s: less than the largest without saturation.
    shocks : (n, k), optional
        States whose common multiple is to be as large as possible, in units of the loop's states; default unit torque
        impulses on each axis.
    time_limit
        Longest time that one call of the solver may take, s.

    Returns
    -------
    AntiWindup
        The gain, and the region with it and without.

    Raises
    ------
    ArgumentError
        The arguments make no sense.
    InfeasibleError
        No region is left at that Omega.
    DesignError
        The solver failed, or its answer could not be proved.

    References
    ----------
    J. M. Gomes da Silva, S. Tarbouriech, IEEE Trans. Automatic Control 50, 2005.

    See docs/torque-limits.md.
    """
    Omega = positive("anti_windup: Omega", Omega, zero=True)
    n = len(loop.A)
    given = loop.impulses if shocks is None else np.asarray(shocks)
    directions = real_array("anti_windup: shocks", given, (n, given.shape[-1] if given.ndim == 2 else 1))
    order = loop.R.shape[1]
    if not order:
        raise InfeasibleError("anti_windup: the controller must have states: a static one does not wind up", loop)
    alpha = _SHOCK_DECAY_SHARE * minimum_decay_rate(loop)
    without = widest(
        loop, Omega, alpha, directions=directions, gain=np.zeros((order, len(loop.controls))), time_limit=time_limit
    )
    found = widest(loop, Omega, alpha, directions=directions, time_limit=time_limit)
    return AntiWindup(
        loop=loop,
        gain=found.gain,
        controller=with_excess(loop.controller, found.gain),
        Omega=Omega,
        ellipsoid=found,
        without=without,
        reach=min(found.reach(d) for d in directions.T),
        reach_without=min(without.reach(d) for d in directions.T),
        verification=found.verify(),
    )


def with_excess(controller: StateSpace, gain: FloatArray) -> StateSpace:
    """Return the controller with inputs ``excess_`` + torque, limited less commanded, into its states by `gain`."""
    K = state_arrays(controller, "with_excess")
    outputs = list(controller.output_labels)
    arrays = StateArrays(K.A, np.hstack([K.B, gain]), K.C, np.hstack([K.D, np.zeros((len(outputs),) * 2)]), K.dt)
    inputs = [*controller.input_labels, *(f"excess_{name}" for name in outputs)]
    return named_system(arrays, inputs, outputs, list(controller.state_labels))
