"""Output feedback for several requirements at once: norms of channels, pole regions, poles of the controller.

Scherer, Gahinet and Chilali (1997): all inequalities share one Lyapunov matrix, which makes them linear in X, Y and the
transformed controller. So the bounds of the inequalities exceed the norms of the closed loop, and both are reported;
with one norm alone they agree.

The largest soft ratio is minimised while every hard one stays below 1. Then the bounds are relaxed by the back-off and
X, Y are moved away from X Y = I, where controllers have arbitrarily fast poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.poles import continuous_poles, spectral_abscissa
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.lmi.search import CURE, posed
from platform_ctrl.design.lmi.solutions import Solution, solutions
from platform_ctrl.design.lmi.tasks import checked, proofs, tasks
from platform_ctrl.design.partition import (
    Partition,
    closed_loop,
    closed_loop_system,
    controller_system,
    out_of_w_plane,
    partition,
)
from platform_ctrl.design.scaling import autoscale, require_stabilisable, unscale
from platform_ctrl.design.synthesis import direct_size
from platform_ctrl.errors import DesignError, NotCertifiedError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "multiobjective, lmi"


@value
class Multiobjective:
    """A controller and what its closed loop does for every requirement.

    Attributes
    ----------
    plant, nmeas, ncon
        The plant P with inputs [w, u] and outputs [z, y].
    requirements
        What was requested.
    controller, closed_loop
        K, u = K y (positive feedback), and the loop from w to z.
    outcomes
        Every requirement with its value, recomputed from the closed loop, and its ratio, at most 1 when met.
    ratio_optimal
        Least common bound of the soft norms (all, where none is soft) as a ratio to their limits that the inequalities
        allow, as the solver found it: sufficient, so other controllers may have less; nan where no norm is requested.
    backoff
        Relative distance from it.
    poles : complex (n,)
        Poles of the closed loop: rad/s, or in z (dimensionless) where the plant is sampled.
    method
        The route.
    residual
        Figures of merit by name, in scaled units.
    """

    plant: StateSpace
    nmeas: int
    ncon: int
    requirements: tuple[LoopRequirement, ...]
    controller: StateSpace
    closed_loop: StateSpace
    outcomes: tuple[CheckResult, ...]
    ratio_optimal: float
    backoff: float
    poles: ComplexArray
    method: str
    residual: dict[str, float]

    @property
    def certificates(self) -> tuple[Certificate, ...]:
        """Proofs in interval arithmetic: stability, then one for each requirement, of `closed_loop` as it is.

        Norms are proved just above what they are, pole regions as requested. A `NotCertifiedError` says which claim is
        not proved.
        """
        return proofs(self.requirements, self.closed_loop, self.controller)

    @property
    def ratio(self) -> float:
        """Largest recomputed ratio of what was minimised."""
        soft = [outcome.ratio for outcome in self.outcomes if not outcome.hard]
        return max(soft or [outcome.ratio for outcome in self.outcomes], default=0.0)


@check_arguments
def multiobjective(
    P: StateSpace,
    nmeas: int,
    ncon: int,
    requirements: Sequence[LoopRequirement],
    *,
    backoff: float = 0.05,
    time_limit: float = 60.0,
) -> Multiobjective:
    """Full-order output feedback that meets several requirements, certified by the actual closed loop.

    Parameters
    ----------
    P
        Plant with inputs [w, u] and outputs [z, y]. A sampled one (dt > 0) is carried to the w-plane, and its
        controller is sampled, too.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    requirements
        `requirements.requirement` of kind "H-infinity norm" or "H2 norm" (of a channel of w and z, with weights),
        "stability", "damping", "fastest pole" (of the closed loop) or "fastest controller pole". Soft norms
        (``hard=False``) are minimised: the largest of their ratios to their limits. Where none is soft, all norms are.
    backoff
        Relative distance from the least ratio and from the hard limits, positive.
    time_limit
        Longest time that one call of the solver may take, s.

    Returns
    -------
    Multiobjective
        The controller, with every requirement measured.

    Raises
    ------
    ArgumentError
        The arguments do not make sense, or a kind of requirement that has no matrix inequality.
    IllPosedError
        A mode that no controller moves violates a pole region (the message names it), or an H2 norm is infinite
        whatever the controller.
    NotStabilisableError
        No controller stabilises the plant.
    InfeasibleError
        No controller was found for the hard requirements with a common Lyapunov matrix.
    TimeLimitError, UnscalableError, NotCertifiedError
        The solver was ended or gave up, or the closed loop does not meet the limits.

    References
    ----------
    C. Scherer, P. Gahinet, M. Chilali, IEEE Trans. Automatic Control 42, 1997.

    M. Chilali, P. Gahinet, IEEE Trans. Automatic Control 41, 1996.

    See docs/lmi.md.
    """
    backoff, time_limit = positive(f"{WHERE}: backoff", backoff), positive(f"{WHERE}: time_limit", time_limit)
    plant = partition(P, nmeas, ncon, sampled=True)
    requested = tasks(P, plant, requirements, WHERE)
    require_stabilisable(requested.plant, P, "multiobjective", autoscale(requested.plant))
    tried = solutions(posed(requested, plant.dt, WHERE, time_limit, P), backoff)
    failure: DesignError | None = None
    for solution in tried:
        if isinstance(solution, DesignError):
            failure = failure or solution
            continue
        try:
            return _finished(solution, plant, requirements, backoff)
        except NotCertifiedError as error:
            failure = failure or error
        except np.linalg.LinAlgError as error:
            failure = failure or NotCertifiedError(f"{WHERE}: {str(error).lower()}; {CURE}", P)
    assert failure is not None
    raise failure


def _finished(
    solution: Solution, plant: Partition, requirements: Sequence[LoopRequirement], backoff: float
) -> Multiobjective:
    """Return the controller in the plant's units, checked by its actual closed loop."""
    problem, best, least, made = solution
    K = out_of_w_plane(unscale(made, problem.scaled), plant.dt)
    P = problem.solver.P
    loop = closed_loop(plant, K)
    D = np.where(np.abs(loop.D) > 1e-12 * direct_size(plant, K), loop.D, 0.0)
    controller = controller_system(P, K)
    system = closed_loop_system(P, loop._replace(D=D))
    poles = np.linalg.eigvals(loop.A).astype(np.complex128)
    if not spectral_abscissa(continuous_poles(poles, plant.dt)) < 0:
        raise NotCertifiedError(f"{WHERE}: the closed loop is not stable; {CURE}", P)
    # A hard norm that was minimised has its limit; a soft one its bound.
    outcomes = checked(requirements, system, controller, problem.solver, (1 + backoff + 0.01) * least)
    return Multiobjective(
        plant=P,
        nmeas=len(plant.C2),
        ncon=plant.B2.shape[1],
        requirements=tuple(requirements),
        controller=controller,
        closed_loop=system,
        outcomes=outcomes,
        ratio_optimal=least,
        backoff=backoff,
        poles=poles,
        method=WHERE,
        residual={"separation of X and Y": best.pair.separation},
    )
