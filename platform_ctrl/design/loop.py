"""A designed loop, certified: every figure is recomputed from the actual sampled closed loop."""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system, state_arrays
from platform_ctrl.analysis.certificates import Certificate, plant_set_certificates
from platform_ctrl.analysis.feedback import closed_loop_arrays
from platform_ctrl.analysis.loop_measures import LoopMeasures, exact_measures
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.values import value
from platform_ctrl.design.partition import Block
from platform_ctrl.errors import DesignError, NotCertifiedError
from platform_ctrl.job.job import DesignSpec, LoopSpec
from platform_ctrl.job.requirements import CheckResult, LoopRequirement, hard_and_soft

if TYPE_CHECKING:
    import control

# What to try where a method's loop is not stable.
CURES = {
    "classical": "a lower crossover_hz, or tune = true",
    "hinf": "a lower bandwidth_hz, or a larger backoff",
    "lqg": "a lower bandwidth_hz, or a larger disturbance",
    "structured": "weaker limits, or another structure",
}


@value
class LoopDesign:
    """A sampled controller of one loop with what it does there.

    Attributes
    ----------
    loop, name, method
        Loop, design and method, as in the job file.
    controller
        u = K y with ``dt`` the sample period; inputs are signals that it measures, outputs the torques that it sets.
    options
        The method's numbers as finally used, in the units of the job file.
    plants
        What it was designed for, nominal plant first; None for a loop that is judged in the coupled system alone.
    measures
        Recomputed from the closed loop; None as above.
    results
        The loop's limits held against the measures.
    goals
        The loop's goals held against the measures: no verdict rests on them.
    claims
        What the method claims, by name, in SI units: for example ``gamma``.
    certificates
        Proofs that the loop is stable with each of its plants, of the disk margin that is asked for with each, and of
        the nominal one.
    unproved
        A line for each such claim without a proof.
    """

    loop: str
    name: str
    method: str
    controller: control.StateSpace
    options: dict[str, float] = field(default_factory=dict)
    plants: PlantSet | None = None
    measures: LoopMeasures | None = None
    results: tuple[CheckResult, ...] = ()
    goals: tuple[CheckResult, ...] = ()
    claims: dict[str, float] = field(default_factory=dict)
    certificates: tuple[Certificate, ...] = ()
    unproved: tuple[str, ...] = ()

    @property
    def plant(self) -> control.StateSpace | None:
        """The nominal sampled plant, from torques and Omega1 to Omega3 to angles: see `PlantSet.system`.

        ``control.interconnect([design.plant, design.controller], inputs=["Omega1", "Omega2", "Omega3"], outputs=...)``
        closes the loop by the signals' names. None where `plants` is.
        """
        return None if self.plants is None else self.plants.system()

    @property
    def passed(self) -> bool:
        """Whether every requirement is met; goals do not count."""
        return all(result.passed for result in self.results)


def sampled_plant(plants: PlantSet, k: int = 0) -> control.StateSpace:
    """Return the nominal sampled plant (or plant `k` of the set) with its signal names."""
    arrays = StateArrays(plants.A[k], plants.B[k], plants.C[k], plants.D[k], plants.period)
    return named_system(arrays, plants.torques, plants.angles, plants.states)


def certified(
    spec: LoopSpec,
    design: DesignSpec,
    controller: Block,
    plants: PlantSet,
    options: dict[str, float],
    claims: dict[str, float],
) -> LoopDesign:
    """Return the design with all its figures recomputed from the closed loops."""
    K = StateArrays(*controller, dt=plants.period)
    measures = exact_measures(plants, K, asked_of(spec))
    if not measures.decay[0] > 0.0:
        raise NotCertifiedError(
            f"{spec.name}, {design.name}: the closed loop grows at {-measures.decay[0]:.3g} 1/s; expected a stable "
            f"loop; try {CURES[design.method]}",
            plants,
        )
    results, goals = judged(spec, design.name, plants, measures)
    certificates, unproved = proofs(spec, plants, K, measures)
    return LoopDesign(
        loop=spec.name,
        name=design.name,
        method=design.method,
        controller=named_system(K, plants.angles, plants.torques, name=f"{spec.name}, {design.name}"),
        options=options,
        plants=plants,
        measures=measures,
        results=results,
        goals=goals,
        claims=claims,
        certificates=certificates,
        unproved=unproved,
    )


def asked_of(spec: LoopSpec) -> tuple[LoopRequirement, ...]:
    """Return all limits and goals of a loop."""
    hard, soft = hard_and_soft(spec.limits, spec.soft)
    return (*hard, *soft)


def judged(
    spec: LoopSpec, design: str, plants: PlantSet, measures: LoopMeasures
) -> tuple[tuple[CheckResult, ...], tuple[CheckResult, ...]]:
    """Return the loop's limits and its goals held against `measures`."""
    hard, soft = (
        tuple(requirement.result(plants, measures, subject=spec.name, design=design) for requirement in requirements)
        for requirements in hard_and_soft(spec.limits, spec.soft)
    )
    return hard, soft


def proofs(
    spec: LoopSpec, plants: PlantSet, controller: StateArrays, measures: LoopMeasures
) -> tuple[tuple[Certificate, ...], tuple[str, ...]]:
    """Return the certificates of stability and of the disk margins that `spec` asks for, and what is left unproved."""
    asked = np.zeros(len(plants.labels))
    for requirement in asked_of(spec):
        if requirement.kind == "disk margin" and requirement.hard:
            chosen = measures.of(requirement.over)
            asked[chosen] = np.maximum(asked[chosen], requirement.limit)
    return plant_set_certificates(plants, controller, measures.decay, measures.disk_margin, asked)


def remeasured(spec: LoopSpec, name: str, controller: control.StateSpace, plants: PlantSet) -> LoopDesign:
    """Return an existing controller as a design of `spec`, measured anew: nothing that was claimed is believed."""
    K = plants.joined(controller)
    measures = exact_measures(plants, K, asked_of(spec))
    results, goals = judged(spec, name, plants, measures)
    certificates, unproved = proofs(spec, plants, K, measures)
    return LoopDesign(
        loop=spec.name,
        name=name,
        method="given",
        controller=named_system(K, plants.angles, plants.torques, name=f"{spec.name}, {name}"),
        plants=plants,
        measures=measures,
        results=results,
        goals=goals,
        certificates=certificates,
        unproved=unproved,
    )


def closed_loop_poles(plants: PlantSet, controller: control.StateSpace) -> ComplexArray:
    """Return the poles of every plant's closed loop, complex (N, poles), in z."""
    K = state_arrays(controller, "closed_loop_poles")
    A = closed_loop_arrays(plants.A, plants.B, plants.C, plants.D, *K[:4])[0]
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)


def completed(method: str, given: dict[str, float], defaults: dict[str, float]) -> dict[str, float]:
    """Return `defaults` with the `given` numbers in place."""
    unused = sorted(set(given) - set(defaults))
    if unused:
        raise DesignError(
            f"{method}: option {unused[0]!r} has no meaning for this loop; expected some of {', '.join(defaults)}"
        )
    out = defaults | given
    wrong = [name for name, x in out.items() if not x > 0.0]
    if wrong:
        raise DesignError(f"{method}: {wrong[0]} = {out[wrong[0]]:g}; expected a number > 0")
    return out
