"""A designed loop, certified: every figure is recomputed from the actual sampled closed loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays, state_space
from platform_ctrl.analysis.bandwidth import bandwidth
from platform_ctrl.analysis.feedback import closed_loop_arrays
from platform_ctrl.analysis.norms import hinf_norm_arrays
from platform_ctrl.analysis.plant_set import LoopMeasures, PlantSet, measure
from platform_ctrl.design.blocks import Block
from platform_ctrl.errors import DesignError
from platform_ctrl.frozen import value
from platform_ctrl.job import DesignSpec, LoopSpec
from platform_ctrl.requirements import CheckResult, loop_requirements

if TYPE_CHECKING:
    import control

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
    """

    loop: str
    name: str
    method: str
    controller: control.StateSpace
    options: dict[str, float]
    plants: PlantSet | None
    measures: LoopMeasures | None
    results: tuple[CheckResult, ...]
    claims: dict[str, float]

    @property
    def passed(self) -> bool:
        """Whether every requirement is met."""
        return all(result.passed for result in self.results)


def nominal_plant(plants: PlantSet) -> control.StateSpace:
    """Return the nominal sampled plant with its signal names."""
    arrays = StateArrays(plants.A[0], plants.B[0], plants.C[0], plants.D[0], plants.period)
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
    DesignError
        The nominal closed loop is not stable.
    """
    K = StateArrays(*controller, dt=plants.period)
    measures = exact_measures(plants, K)
    if not measures.decay[0] > 0.0:
        raise DesignError(
            f"{spec.name}, {design.name}: the closed loop grows at {-measures.decay[0]:.3g} 1/s; expected a stable "
            "loop; try a lower crossover_hz, or tune = true",
            plants,
        )
    return LoopDesign(
        loop=spec.name,
        name=design.name,
        method=design.method,
        controller=state_space(K, plants.angles, plants.torques, name=f"{spec.name}, {design.name}"),
        options=options,
        plants=plants,
        measures=measures,
        results=judged(spec, design.name, plants, measures),
        claims=claims | {"disk_margin": float(measures.disk_margin[0]), "damping": float(measures.damping[0])},
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
                requirement.worst(measures),
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
    margin = rough.disk_margin.copy()
    alive = margin > 0.0
    floor = margin[1:][alive[1:]].min(initial=np.inf)
    for k in np.flatnonzero(alive & ((margin <= _NEAR_WORST * floor) | (np.arange(len(margin)) == 0))):
        margin[k] = disk_margin_norm(plants.only([int(k)]), controller)
    named = state_space(controller, plants.angles, plants.torques)
    nominal = nominal_plant(plants)
    return LoopMeasures(
        bandwidth=min(bandwidth(nominal, named, at="input"), bandwidth(nominal, named, at="output")),
        disk_margin=margin,
        damping=rough.damping,
        decay=rough.decay,
        torque_noise=rough.torque_noise,
    )


def disk_margin_norm(plant: PlantSet, controller: StateArrays) -> float:
    """Return 1/‖(S − T)/2‖ in the H-infinity norm, the smaller of input and output, for the first plant of the set."""
    A, B, C, D = closed_loop_arrays(plant.A[0], plant.B[0], plant.C[0], plant.D[0], *controller[:4])
    m, p = plant.B.shape[-1], plant.C.shape[-2]
    # Closed loop from [d, n] to [u, y]: at the input u = −T d, at the output y = −T n, and (S − T)/2 = I/2 − T.
    at_input = hinf_norm_arrays(A, B[:, :m], C[:m], D[:m, :m] + 0.5 * np.eye(m), plant.period)[0]
    at_output = hinf_norm_arrays(A, B[:, m:], C[m:], D[m:, m:] + 0.5 * np.eye(p), plant.period)[0]
    return 1.0 / max(at_input, at_output)


def remeasured(spec: LoopSpec, name: str, controller: control.StateSpace, plants: PlantSet) -> LoopDesign:
    """Return an existing controller as a design of `spec`, measured anew: nothing that was claimed is believed."""
    K = state_arrays(controller, f"{spec.name}, {name}")
    order_in = [list(controller.input_labels).index(a) for a in plants.angles]
    order_out = [list(controller.output_labels).index(q) for q in plants.torques]
    K = StateArrays(K.A, K.B[:, order_in], K.C[order_out], K.D[np.ix_(order_out, order_in)], plants.period)
    measures = exact_measures(plants, K)
    return LoopDesign(
        loop=spec.name,
        name=name,
        method="given",
        controller=state_space(K, plants.angles, plants.torques, name=f"{spec.name}, {name}"),
        options={},
        plants=plants,
        measures=measures,
        results=judged(spec, name, plants, measures),
        claims={},
    )


def closed_loop_poles(plants: PlantSet, controller: control.StateSpace) -> ComplexArray:
    """Return the poles of every plant's closed loop, complex (N, poles), in z."""
    K = state_arrays(controller, "closed_loop_poles")
    A = closed_loop_arrays(plants.A, plants.B, plants.C, plants.D, *K[:4])[0]
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
