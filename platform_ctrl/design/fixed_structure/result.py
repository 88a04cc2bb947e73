"""What a structured synthesis comes to."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.parametrised import Parametrised
from platform_ctrl.design.fixed_structure.run import Outcome
from platform_ctrl.design.fixed_structure.structures import Structure, Units
from platform_ctrl.design.partition import Partition, closed_loop, out_of_w_plane
from platform_ctrl.design.partition import whole as whole_plant
from platform_ctrl.design.synthesis import Synthesis, hinf
from platform_ctrl.errors import DesignError, NotCertifiedError, NotFoundError, TimeLimitError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace

# Norms, in the natural unit of the scaled plant, that count as zero, and that rounding alone can make.
_ZERO, _NOTHING = 1e-6, 1e-9
# What the recomputed norm may exceed that of the search by, relative.
_AGREEMENT = 1e-3


@value
class SearchRecord:
    """How the search from one starting point went.

    Attributes
    ----------
    value
        What it reached: the worst norm, or with requirements the largest ratio; inf where no loop became stable.
    evaluations, seconds
        What it took; time in s.
    finished
        Whether it ended by itself.
    """

    value: float
    evaluations: int
    seconds: float
    finished: bool


@value
class StructuredDesign:
    """A controller of fixed structure with the evidence that it does what is claimed.

    Attributes
    ----------
    plants, nmeas, ncon
        The problem.
    structure
        What was requested.
    controller
        K, u = K y; sampled where the plants are.
    parameters
        Every number of the structure by name, in its unit; for sampled plants those of the w-plane controller.
    closed_loops
        From w to z, one a plant.
    gammas : (plants,)
        H-infinity norm of each closed loop, in units of z per w, recomputed from it; with requirements the largest
        ratio of each plant.
    gamma
        The largest of them, in the same units.
    gamma_optimal
        Least norm of a full-order controller, in the same units: the largest over the plants; 0 where none was found.
    bound
        The route that found it; empty where none did.
    poles
        Closed-loop poles, one array (n,) a plant: rad/s, or in z (dimensionless).
    searches
        One record for every start that had its turn, in their order.
    finished
        Whether every start had its turn and ended by itself, not by its evaluations or by the time limit.
    cut
        Whether the time limit ended the search: at another load of the machine the result is another one.
    infimum
        Where the search saw that no controller reaches the infimum, or that it is zero: a sentence that says so.
    outcomes
        The requirements checked on every closed loop, where any were given; those of the first plant first.
    """

    plants: tuple[StateSpace, ...]
    nmeas: int
    ncon: int
    structure: Structure
    controller: StateSpace
    parameters: dict[str, float]
    closed_loops: tuple[StateSpace, ...]
    gammas: FloatArray
    gamma: float
    gamma_optimal: float
    bound: str
    poles: tuple[ComplexArray, ...]
    searches: tuple[SearchRecord, ...]
    finished: bool
    cut: bool
    infimum: str
    outcomes: tuple[CheckResult, ...] = ()

    @property
    def price(self) -> float:
        """What the structure costs at most: ratio of gamma to the full-order bound; inf where that is 0."""
        return self.gamma / self.gamma_optimal if self.gamma_optimal > 0.0 else float("inf")

    @property
    def passed(self) -> bool:
        """Whether every hard requirement is met by every plant."""
        return all(one.passed for one in self.outcomes if one.hard)


# Matrix inequalities of more states than this take minutes.
_LMI_STATES = 20
# Back-offs of the controllers that starts are fitted to: near the least norm they have needlessly fast poles, and far
# from it they are simple.
_BACKOFFS = (0.1, 0.5, 2.0)


@value
class Bound:
    """What is known of controllers of full order for one plant."""

    gamma: float  # the least norm; 0 where none was found
    source: str  # the route that found it
    # Some near it and some far from it, in the w-plane where the plant is sampled; none where none are fitted.
    controllers: tuple[StateArrays, ...]
    cut: bool = False  # whether the time limit ended a computation


def full_order(plant: Partition, power: bool, time_limit: float, fitted: bool) -> Bound:
    """Return the least norm of a continuous (or w-plane) plant, in H2 where `power`.

    With controllers and, where there is no solution of Riccati equations, by matrix inequalities where `fitted`.
    """
    P = _system(plant)
    cut = False
    for method in ("riccati", "lmi"):
        if method == "lmi" and (power or not fitted or len(plant.A) > _LMI_STATES):
            continue
        try:
            found = _designed(P, plant, power, method, time_limit)
        except DesignError as error:
            cut = cut or isinstance(error, TimeLimitError)
            continue
        own = (state_arrays(found.controller, "structured"),)
        more = () if power or method == "lmi" or not fitted else _simpler(P, plant, None)
        controllers = (*own, *more) if fitted else ()
        return Bound(gamma=found.gamma_optimal, source=found.method, controllers=controllers, cut=cut)
    controllers = _simpler(P, plant, 1e-2) if fitted and not power else ()
    return Bound(gamma=0.0, source="", controllers=controllers, cut=cut)


def _designed(P: StateSpace, plant: Partition, power: bool, method: str, time_limit: float) -> Synthesis:
    ny, nu = plant.C2.shape[0], plant.B2.shape[1]
    if power:
        from platform_ctrl.design.riccati.h2 import h2

        return h2(P, ny, nu)
    return hinf(P, ny, nu, method=method, backoff=_BACKOFFS[0], time_limit=time_limit)  # type: ignore[arg-type]


def _simpler(P: StateSpace, plant: Partition, regularise: float | None) -> tuple[StateArrays, ...]:
    """Return controllers farther from the least norm; of the regularised plant where its assumptions do not hold."""
    out = []
    for backoff in _BACKOFFS[1:]:
        with contextlib.suppress(DesignError):
            found = hinf(
                P, plant.C2.shape[0], plant.B2.shape[1], method="riccati", backoff=backoff, regularise=regularise
            )
            out.append(state_arrays(found.controller, "structured"))
    return tuple(out)


def _system(plant: Partition) -> StateSpace:
    import control

    one = whole_plant(plant)
    return control.StateSpace(one.A, one.B, one.C, one.D, remove_useless_states=False)


def _infimum(gamma: float, at_limit: bool, bound: float, unit: float) -> str:
    """Return what the search saw of an infimum that no controller reaches, or that is zero; empty where nothing."""
    if gamma <= _ZERO * unit:
        way = " at ever larger gains" if at_limit else ""
        return f"The infimum is 0, or next to it: the norm fell to {gamma:.3g}{way}, {unit:.3g} being its natural unit."
    if at_limit:
        near = ", which is the bound of full order" if bound > 0.0 and gamma <= (1.0 + _AGREEMENT) * bound else ""
        return (
            f"The infimum lies at infinite gain: the norm still fell at the largest gains that the search allows, to "
            f"{gamma:.6g}{near}; bound the structure's numbers where such gains are of no use."
        )
    return ""


def none_found(
    best: Outcome | None,
    starts: int,
    spent: int,
    cut: bool,
    structure: Structure,
    parts: tuple[Partition, ...],
    given: tuple[StateSpace, ...],
    requirements: Sequence[LoopRequirement],
) -> Exception:
    """Return what to raise where no start led to what is requested; the numbers are those of the plants as given."""
    kind = type(structure).__name__
    tried = f"{starts} starts and {spent} evaluations"
    if best is None or (cut and best.rank[0] > 1.0):
        return TimeLimitError(
            f"structured: no stabilising {kind} controller within time_limit, after {tried}; give a larger one, or "
            "starting values (start=...) that stabilise",
            given,
        )
    K = _controller(best.M, given[0], parts[0])
    further = "a local search does not show that there is none: give more starts or evaluations"
    if best.rank[0] > 1.0:
        worst, at = max((_abscissa(part, K), k) for k, part in enumerate(parts, 1))
        decay = max((r.limit for r in requirements if r.kind == "stability"), default=0.0)
        requested = f"a decay of {decay:g} 1/s with every plant" if decay else "a stable loop with every plant"
        return NotFoundError(
            f"structured: none found: no {kind} controller with {requested} in {tried}; the nearest has the rightmost "
            f"pole at {worst:+.4g} rad/s, with plant {at}; {further}, starting values (start=...), or a richer "
            "structure",
            given,
            K,
        )
    return NotFoundError(
        f"structured: none found: no {kind} controller that meets every hard requirement in {tried}; the nearest has "
        f"the largest ratio {best.hard:.4g}, and must not exceed 1; {further}, or relax a limit or make it soft",
        given,
        K,
    )


def _controller(M: FloatArray, P: StateSpace, part: Partition) -> StateSpace:
    """Return M = [A_K, B_K; C_K, D_K], in the w-plane where the plant is sampled, as a controller of the plant."""
    import control

    order = len(M) - part.B2.shape[1]
    K = StateArrays(A=M[:order, :order], B=M[:order, order:], C=M[order:, :order], D=M[order:, order:])
    K = out_of_w_plane(K, part.dt)
    y, u = P.output_labels[-K.B.shape[1] :], P.input_labels[-K.C.shape[0] :]
    return control.StateSpace(K.A, K.B, K.C, K.D, part.dt, inputs=y, outputs=u, remove_useless_states=False)


def _abscissa(part: Partition, K: StateSpace) -> float:
    """Return the largest real part, rad/s, of a loop's continuous(-equivalent) poles."""
    from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa

    loop = closed_loop(part, state_arrays(K, "controller"))
    return float(spectral_abscissa(continuous_poles(poles(loop.A), part.dt)))


def measured_design(  # noqa: PLR0913 - what certifies one result
    given: tuple[StateSpace, ...],
    parts: tuple[Partition, ...],
    structure: Structure,
    requirements: Sequence[LoopRequirement],
    best: Outcome,
    ended: Sequence[Outcome],
    cut: bool,
    whole: Parametrised | None,
    order: int,
    bounds: Sequence[Bound],
    unit: float,
) -> StructuredDesign:
    """Close the loops with the plants as given and measure them."""
    import control

    from platform_ctrl.analysis.norms import hinf_norm
    from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa

    M, period = best.M, parts[0].dt
    controller = _controller(M, given[0], parts[0])
    K = state_arrays(controller, "controller")
    nmeas, ncon = K.B.shape[1], K.C.shape[0]
    loops, gammas, every, outcomes = [], [], [], []
    for k, (P, part) in enumerate(zip(given, parts, strict=True), 1):
        loop = closed_loop(part, K)
        at = poles(loop.A)
        if at.size and not spectral_abscissa(continuous_poles(at, period)) < 0.0:
            raise NotCertifiedError(f"structured: the closed loop of plant {k} is not stable; give other starts", given)
        system = control.StateSpace(
            loop.A, loop.B, loop.C, loop.D, period, inputs=P.input_labels[:-ncon], outputs=P.output_labels[:-nmeas],
            remove_useless_states=False,
        )  # fmt: skip
        loops.append(system)
        every.append(at)
        if requirements:
            checked = [one.check_closed_loop(system, subject=f"plant {k}") for one in requirements]
            outcomes += checked
            norms = [
                one.ratio for one, requested in zip(checked, requirements, strict=True) if requested.kind != "stability"
            ]
            soft = [r for r, requested in zip(norms, [a for a in requirements if a.kind != "stability"], strict=True)
                    if not requested.hard]  # fmt: skip
            gammas.append(max(soft or norms))
        else:
            gammas.append(float(hinf_norm(system)[0]))
    gamma = max(gammas)
    # A norm of next to nothing is known to rounding of what cancels in it.
    if not gamma <= (1.0 + _AGREEMENT) * best.value + _NOTHING * unit:
        raise NotCertifiedError(
            f"structured: the closed loops have the norm {gamma:.6g}, the search promised {best.value:.6g}; "
            "bound the structure's numbers: gains this large are at the limit of floating point",
            given,
        )
    largest = max(bounds, key=lambda one: one.gamma)
    units = Units(gain=np.ones((ncon, nmeas)), rate=1.0)
    names = [one.name for one in structure.parameters(nmeas, ncon, units)]
    if whole is not None:
        parameters = whole.named(best.x)
    else:
        blocks = (M[:order, :order], M[:order, order:], M[order:, :order], M[order:, order:])
        parameters = dict(zip(names, map(float, np.concatenate([block.ravel() for block in blocks])), strict=True))
    return StructuredDesign(
        plants=given,
        nmeas=nmeas,
        ncon=ncon,
        structure=structure,
        controller=controller,
        parameters=parameters,
        closed_loops=tuple(loops),
        gammas=np.array(gammas),
        gamma=float(gamma),
        gamma_optimal=min(largest.gamma, float(gamma)),
        bound=largest.source,
        poles=tuple(every),
        searches=tuple(
            SearchRecord(value=one.rank[1] if one.rank[0] == 0.0 else float("inf"), evaluations=one.evaluations,
                         seconds=one.seconds, finished=one.finished)
            for one in ended
        ),
        finished=not cut and all(one.finished for one in ended),
        cut=cut,
        infimum=_infimum(gamma, best.at_limit, largest.gamma, unit),
        outcomes=tuple(outcomes),
    )  # fmt: skip
