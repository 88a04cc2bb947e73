"""A designed loop, certified: every figure is recomputed from the actual sampled closed loop."""

from __future__ import annotations

import dataclasses
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays, state_space
from platform_ctrl.analysis.bandwidth import bandwidth
from platform_ctrl.analysis.feedback import closed_loop_arrays, closed_loop_with_sensitivity
from platform_ctrl.analysis.norms import hinf_norm_arrays
from platform_ctrl.analysis.plant_set import LoopMeasures, PlantSet, measure
from platform_ctrl.certificates import Certificate, plant_set_certificates
from platform_ctrl.design.blocks import Block
from platform_ctrl.errors import NotCertifiedError
from platform_ctrl.frozen import value
from platform_ctrl.job import DesignSpec, LoopSpec
from platform_ctrl.requirements import CheckResult, loop_requirements

if TYPE_CHECKING:
    import control

# What to try where a method's loop is not stable.
CURES = {
    "classical": "a lower crossover_hz, or tune = true",
    "hinf": "a lower bandwidth_hz, or a larger backoff",
    "structured": "weaker limits, or another structure",
}

# Plants whose margin on the grid lies this near to the worst get the exact norm; the others keep the grid's figure.
_NEAR_WORST = 1.25


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
        The method's numbers as finally used.
    plants
        What it was designed for, nominal plant first; None for a loop that is judged in the coupled system alone.
    measures
        Recomputed from the closed loop; None as above.
    results
        The loop's limits held against the measures.
    claims
        What the method claims, by name: for example ``gamma``.
    certificates
        Proofs that the loop is stable with each of its plants, and of the nominal plant's disk margin.
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
    claims: dict[str, float] = field(default_factory=dict)
    certificates: tuple[Certificate, ...] = ()
    unproved: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every requirement is met; goals do not count."""
        return all(result.passed or not result.hard for result in self.results)


def sampled_plant(plants: PlantSet, k: int = 0) -> control.StateSpace:
    """Return the nominal sampled plant (or plant `k` of the set) with its signal names."""
    arrays = StateArrays(plants.A[k], plants.B[k], plants.C[k], plants.D[k], plants.period)
    return state_space(arrays, plants.torques, plants.angles)


def certified(
    spec: LoopSpec,
    design: DesignSpec,
    controller: Block,
    plants: PlantSet,
    options: dict[str, float],
    claims: dict[str, float],
) -> LoopDesign:
    """Return the design with all its figures recomputed from the closed loops.

    Raises
    ------
    NotCertifiedError
        The nominal closed loop is not stable.
    """
    K = StateArrays(*controller, dt=plants.period)
    measures = exact_measures(plants, K)
    if not measures.decay[0] > 0.0:
        raise NotCertifiedError(
            f"{spec.name}, {design.name}: the closed loop grows at {-measures.decay[0]:.3g} 1/s; expected a stable "
            f"loop; try {CURES[design.method]}",
            plants,
        )
    certificates, unproved = plant_set_certificates(plants, K, measures.decay)
    return LoopDesign(
        loop=spec.name,
        name=design.name,
        method=design.method,
        controller=state_space(K, plants.angles, plants.torques, name=f"{spec.name}, {design.name}"),
        options=options,
        plants=plants,
        measures=measures,
        results=judged(spec, design.name, plants, measures),
        claims=claims,
        certificates=certificates,
        unproved=unproved,
    )


def judged(spec: LoopSpec, design: str, plants: PlantSet, measures: LoopMeasures) -> tuple[CheckResult, ...]:
    """Return the loop's limits held against `measures`."""
    out = []
    for requirement in loop_requirements(spec.limits):
        figures = requirement.figures(measures)
        worst = int(figures.argmax() if requirement.sense == "at most" else figures.argmin())
        where = "nominal plant"
        if requirement.kind == "torque noise":
            where = f"torquer {plants.torques[worst]}"
        elif requirement.over_spread:
            where = plants.labels[worst]
        out.append(
            requirement.judge(
                float(figures[worst]),
                subject=spec.name,
                design=design,
                stage="decoupled",
                evidence=f"{where}; {len(plants.labels)} plants, sampled with delay and torquer lag",
            )
        )
    return tuple(out)


def exact_measures(plants: PlantSet, controller: StateArrays) -> LoopMeasures:
    """Return the measures with margins as norms (not on a grid) wherever they decide anything."""
    rough = measure(plants, controller)
    named = state_space(controller, plants.angles, plants.torques)
    margin = rough.disk_margin.copy()
    alive = margin > 0.0
    floor = margin[1:][alive[1:]].min(initial=np.inf)
    for k in np.flatnonzero(alive & ((margin <= _NEAR_WORST * floor) | (np.arange(len(margin)) == 0))):
        margin[k] = disk_margin_norm(sampled_plant(plants, int(k)), named)
    nominal = sampled_plant(plants)
    return dataclasses.replace(
        rough,
        bandwidth=min(bandwidth(nominal, named, at="input"), bandwidth(nominal, named, at="output")),
        disk_margin=margin,
    )


def disk_margin_norm(plant: control.StateSpace, controller: control.StateSpace) -> float:
    """Return 1/‖(S − T)/2‖ in the H-infinity norm, the smaller of input and output."""
    norms = []
    for at in ("input", "output"):
        A, B, C, D, dt = closed_loop_with_sensitivity(plant, controller, at)
        # (S − T)/2 = S − I/2.
        norms.append(hinf_norm_arrays(A, B, C, D - 0.5 * np.eye(len(D)), dt)[0])
    return 1.0 / max(norms)


def remeasured(spec: LoopSpec, name: str, controller: control.StateSpace, plants: PlantSet) -> LoopDesign:
    """Return an existing controller as a design of `spec`, measured anew: nothing that was claimed is believed."""
    K = state_arrays(controller, f"{spec.name}, {name}")
    order_in = [list(controller.input_labels).index(a) for a in plants.angles]
    order_out = [list(controller.output_labels).index(q) for q in plants.torques]
    K = StateArrays(K.A, K.B[:, order_in], K.C[order_out], K.D[np.ix_(order_out, order_in)], plants.period)
    measures = exact_measures(plants, K)
    certificates, unproved = plant_set_certificates(plants, K, measures.decay)
    return LoopDesign(
        loop=spec.name,
        name=name,
        method="given",
        controller=state_space(K, plants.angles, plants.torques, name=f"{spec.name}, {name}"),
        plants=plants,
        measures=measures,
        results=judged(spec, name, plants, measures),
        certificates=certificates,
        unproved=unproved,
    )


def closed_loop_poles(plants: PlantSet, controller: control.StateSpace) -> ComplexArray:
    """Return the poles of every plant's closed loop, complex (N, poles), in z."""
    K = state_arrays(controller, "closed_loop_poles")
    A = closed_loop_arrays(plants.A, plants.B, plants.C, plants.D, *K[:4])[0]
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
