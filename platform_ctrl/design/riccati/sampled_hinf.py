"""H-infinity synthesis of a sampled controller for the continuous signals: rate, hold and delay belong to the problem.

::

        w(t) ──►┌───┐──► z(t)
                │ P │
    u(t) ┌─────►└───┘──► y(t) ──► sampler ──► K ──► hold ──► delay ──┐
         └───────────────────────────────────────────────────────────┘

For a level γ the plant over one period is replaced by the discrete plant that is equivalent to it (see
`platform_ctrl.analysis.lifting`): a controller keeps the sampled loop below γ exactly if it keeps that plant below one.
Discrete synthesis finds its least norm, which says how to move γ; at the end the norm of the actual sampled loop is
worked out anew. Nothing is discretised afterwards and no delay is approximated.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.makers import stability_certificate
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.intersample import intersample_norm
from platform_ctrl.analysis.lifting import PeriodExceedsLevel, SampledPlant, lifted_plant, sampled_plant
from platform_ctrl.analysis.poles import poles
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.synthesis import HinfMethod, Synthesis, hinf
from platform_ctrl.errors import ArgumentError, IllPosedError, InfeasibleError, NotCertifiedError

if TYPE_CHECKING:
    from control import StateSpace

    from platform_ctrl.analysis.arrays import ComplexArray

# The least level is found to this relative accuracy.
_ACCURACY = 1e-3
_ROUNDS = 40
# What the recomputed norm may exceed the backed-off level by.
_TOLERANCE = 0.01
# Largest number of delayed controls, each a state of the lifted plant; the time of a synthesis grows with their cube.
MOST_DELAYED = 100
_CURE = "give a larger backoff, the other method, or weights with less spread between slow and fast poles"


@value
class SampledSynthesis:
    """A sampled controller with the evidence of what it does between the samples.

    Attributes
    ----------
    plant
        The continuous plant P with inputs [w, u] and outputs [z, y].
    nmeas, ncon
        Number of measurements y and of controls u.
    period, delay
        Sample period, and delay from the sample to the hold's step, s.
    controller
        K, u = K y, its ``dt`` the period.
    gamma, frequency
        `analysis.intersample_norm` of the actual loop, in units of z per w, and its frequency, rad/s (or None).
    gamma_optimal
        A level that no controller keeps, at most 0.1 % below the least one that was found, in the same units.
    backoff
        Relative back-off: the controller was made for (1 + backoff) times the least level that was found.
    method
        The route of the discrete synthesis.
    poles : complex (n + delayed controls + nK,)
        Poles of the sampled loop, in z (dimensionless).
    equivalent
        The discrete synthesis that the controller comes from: of the lifted plant at the backed-off level.
    """

    plant: StateSpace
    nmeas: int
    ncon: int
    period: float
    delay: float
    controller: StateSpace
    gamma: float
    frequency: float | None
    gamma_optimal: float
    backoff: float
    method: str
    poles: ComplexArray
    equivalent: Synthesis

    @property
    def certificates(self) -> tuple[Certificate, Certificate]:
        """Proofs that the sampled loop is stable, and of the norm of `equivalent`: below one, the level is kept.

        They start at the sampled and at the lifted plant, which are worked out in floating point. Made at each use; a
        `NotCertifiedError` where one is not found.
        """
        plant = sampled_plant(self.plant, self.nmeas, self.ncon, self.period, self.delay, "sampled_hinf")
        A, B, C, D, dt = _from_controls(plant)
        K = state_arrays(self.controller, "controller")
        stable = stability_certificate(A, dt, B=B, C=C, D=D, controller=K, label="sampled loop")
        return stable, self.equivalent.certificate


@check_arguments
def sampled_hinf(
    P: StateSpace,
    nmeas: int,
    ncon: int,
    *,
    period: float,
    delay: float = 0.0,
    method: HinfMethod = "riccati",
    backoff: float = 0.02,
    time_limit: float = 60.0,
) -> SampledSynthesis:
    """Sampled controller with the least L2-induced norm from w(t) to z(t), backed off and certified.

    Parameters
    ----------
    P
        Continuous plant with inputs [w, u] and outputs [z, y]; y strictly proper from w.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    period, delay
        Sample period, and delay from the sample to the hold's step, s; any number >= 0 with which at most 100 controls
        wait for their time.
    method
        Route of the discrete synthesis, as in `design.hinf`.
    backoff
        Relative distance from the least level, positive.
    time_limit
        Longest time that one call of a solver may take, s.

    Returns
    -------
    SampledSynthesis
        The controller, and the norm of its actual loop.

    Raises
    ------
    ArgumentError
        The arguments make no sense.
    IllPosedError
        y has a direct path from w.
    DesignError
        As in `design.hinf`; `NotCertifiedError` where the actual loop does not keep what was promised.

    References
    ----------
    B. Bamieh, J. B. Pearson, Systems & Control Letters 18, 1992.

    P. T. Kabamba, S. Hara, IEEE Trans. Automatic Control 38, 1993.

    T. Chen, B. A. Francis, Optimal Sampled-Data Control Systems, 1995.

    See docs/sampled-data.md.
    """
    backoff = positive("sampled_hinf: backoff", backoff)
    nz, nw = state_arrays(P, "sampled_hinf (P)").D.shape[0] - nmeas, P.ninputs - ncon
    if np.any(np.asarray(P.D)[nz:, :nw]):
        try:
            sampled_plant(P, nmeas, ncon, period, delay, "sampled_hinf")
        except ArgumentError as error:
            raise IllPosedError(str(error), P) from None
    plant = sampled_plant(P, nmeas, ncon, period, delay, "sampled_hinf")
    if nz < 1 or nw < 1:
        raise ArgumentError(f"sampled_hinf: P must have at least one disturbance w and one output z, got {nw} and {nz}")

    delayed = plant.reach * ncon
    if delayed > MOST_DELAYED:
        raise ArgumentError(
            f"sampled_hinf: delay = {delay:.4g} s makes {delayed} delayed controls of a period of {period:.4g} s, each "
            f"a state, more than {MOST_DELAYED}; give a longer period or a shorter delay"
        )

    def solved(level: float, inner: float) -> Synthesis:
        return hinf(_named(P, plant, level), nmeas, ncon, method=method, backoff=inner, time_limit=time_limit)

    try:
        bound, least = _least_level(P, plant, lambda level: solved(level, 0.05))
    except PeriodExceedsLevel:
        raise ArgumentError(
            f"sampled_hinf: P overflows within a period of {plant.period:g} s; give a shorter one"
        ) from None
    level = (1.0 + backoff) * least
    room = 1.0 / _reached(solved(level, 0.05)) - 1.0
    if not room > 0.0:
        raise NotCertifiedError(f"sampled_hinf: no room above the least norm {least:.6g}; {_CURE}", P)
    made = solved(level, room)
    K = made.controller
    try:
        gamma, frequency = intersample_norm(P, K, nmeas, ncon, delay)
    except ArgumentError as error:
        raise NotCertifiedError(f"sampled_hinf: {error}; {_CURE}", P) from None
    limit = (1.0 + backoff + _TOLERANCE) * least
    if not gamma <= limit:
        raise NotCertifiedError(
            f"sampled_hinf: the sampled loop has the norm {gamma:.6g}, more than {limit:.6g} for the least norm "
            f"{least:.6g}; {_CURE}",
            P,
        )
    return SampledSynthesis(
        plant=P,
        nmeas=nmeas,
        ncon=ncon,
        period=plant.period,
        delay=float(delay),
        controller=K,
        gamma=gamma,
        frequency=frequency,
        gamma_optimal=bound,
        backoff=backoff,
        method=f"sampled hinf, {method}",
        poles=poles(closed_loop(_from_controls(plant), state_arrays(K, "controller")).A),
        equivalent=made,
    )


def _reached(made: Synthesis) -> float:
    return made.level / (1.0 + made.backoff)


def _least_level(P: StateSpace, plant: SampledPlant, designed: Callable[[float], Synthesis]) -> tuple[float, float]:
    """Return two levels, 0.1 % apart at most: no controller keeps the lifted plant at one at the first, one does after.

    Far above them the lifted plant's least norm is proportional to 1/level: level times norm is nearly the answer.
    """
    low, high = 0.0, np.inf
    level = _reached(designed(np.inf))
    for _ in range(_ROUNDS):
        try:
            made = designed(level)
            norm, kept = _reached(made), made.gamma_optimal <= 1.0
        except PeriodExceedsLevel:
            norm, kept = np.inf, False
        if norm <= 1.0:
            high = level
        elif not kept:
            low = level
        if high <= (1.0 + _ACCURACY) * low:
            return float(low), float(high)
        # A little above where it should be: mostly the other end of the bracket.
        guess = level * norm * (1.0 + 0.5 * _ACCURACY) if norm > 1.0 else level * norm * (1.0 - 0.5 * _ACCURACY)
        inside = low < guess < high and np.isfinite(guess)
        level = guess if inside else (np.sqrt(low * high) if np.isfinite(high) and low > 0.0 else 2.0 * level)
    raise InfeasibleError(f"sampled_hinf: no least level was found between {low:.6g} and {high:.6g}; {_CURE}", P)


def _from_controls(plant: SampledPlant) -> StateArrays:
    """Return the sampled plant from u to y: the lifted one at an infinite level; at the loop's own its A is another."""
    m, p = plant.B2.shape[1], len(plant.C2)
    return lifted_plant(plant, np.inf).part(slice(-p, None), slice(-m, None))


def _named(P: StateSpace, plant: SampledPlant, level: float) -> StateSpace:
    """Return the lifted plant with P's names of u and y."""
    lifted = lifted_plant(plant, level)
    m, p = plant.B2.shape[1], len(plant.C2)
    nw, nz = lifted.B.shape[1] - m, len(lifted.C) - p
    return named_system(
        lifted,
        [f"lifted_w{k + 1}" for k in range(nw)] + list(P.input_labels[-m:]),
        [f"lifted_z{k + 1}" for k in range(nz)] + list(P.output_labels[-p:]),
    )
