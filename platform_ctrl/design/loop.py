"""A designed loop: all its values are recomputed from the actual sampled closed loop."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag

from platform_ctrl.analysis.feedback import with_error_alone
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.plant_set import COMMAND, PlantSet
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import nearest
from platform_ctrl.common.progress import Progress
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop_signals import loop_channels, loop_signals
from platform_ctrl.design.partition import Channels, gain, low_pass
from platform_ctrl.design.sections import Section
from platform_ctrl.errors import DesignError, NotCertifiedError
from platform_ctrl.job.job import CommandShaping, DesignSpec, Job, LoopSpec
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.methods import known_method, resolved
from platform_ctrl.job.requirements import LoopRequirement, hard_and_soft, of_readings
from platform_ctrl.mechanics.linearisation import LinearModel

if TYPE_CHECKING:
    import control

# Of the reference filter: it answers a step without overshoot.
_DAMPING = 1.0
# Metrics in which its lag counts.
_LATE = ("ramp error", "tracking error")


@value
class LoopDesign:
    """A sampled controller of one loop with what it does there.

    Attributes
    ----------
    loop, name, method
        Loop, design and method, as in the job file.
    controller
        u = K y with ``dt`` the sample period; inputs are signals that it measures, outputs the torques that it sets. A
        loop that is commanded, by one around it or in a run, has u = K (y − command), its commands behind the signals:
        NAME + ``_command``. Sensors of feedforward of the platform's rate come last.
    options
        The method's numbers as finally used, in the units of the job file.
    plants
        What it was designed for, nominal plant first; None for a loop that is only checked in the coupled system.
    measures
        Recomputed from the closed loop; None as above.
    results
        The loop's limits compared with the measures.
    goals
        The loop's goals compared with the measures; they do not count for the verdict.
    claims
        Claims of the method by name, in SI units: for example ``gamma``.
    sections
        The controller block by block, where its method makes it of blocks and nothing else is added to it.
    directions
        Gyroscopic pairs and inertial directions in which its method saw the plants; None where none was told.
    """

    loop: str
    name: str
    method: str
    controller: control.StateSpace
    options: dict[str, float] = field(default_factory=dict)
    plants: PlantSet | None = None
    measures: LoopMetrics | None = None
    results: tuple[CheckResult, ...] = ()
    goals: tuple[CheckResult, ...] = ()
    claims: dict[str, float] = field(default_factory=dict)
    sections: tuple[Section, ...] = ()
    directions: Channels | None = None

    @property
    def plant(self) -> control.StateSpace | None:
        """The nominal sampled plant, from torques and Omega1 to Omega3 to angles: see `PlantSet.system`.

        ``control.interconnect([design.plant, design.controller], inputs=["Omega1", "Omega2", "Omega3"], outputs=...)``
        closes the loop by the signals' names; with `own_controller` where the design has feedforward of the platform's
        rate, which is a part of its plants. None where `plants` is.
        """
        return None if self.plants is None else self.plants.system()

    @property
    def own_controller(self) -> control.StateSpace:
        """The controller from what the loop measures, without its commands and feedforward."""
        if self.plants is None:
            return self.controller
        return self.plants.joined(self.controller).to_control(self.plants.angles, self.plants.torques)

    @property
    def passed(self) -> bool:
        """Whether every requirement is met; goals do not count."""
        return all(result.passed for result in self.results)


def sampled_plant(plants: PlantSet, k: int = 0) -> control.StateSpace:
    """Return the nominal sampled plant (or plant `k` of the set) with its signal names."""
    return plants.arrays.at(k).to_control(plants.torques, plants.angles, plants.states)


@value
class LoopProblem:
    """What a design method is given."""

    # job, spec, design: the job, one of its loops, and one of that loop's designs.
    job: Job
    spec: LoopSpec
    design: DesignSpec
    model: LinearModel  # the platform linearised at rest
    plant_set: PlantSet | None = None  # the plants of the loop, the nominal one first; None for a stabilisation loop
    # Those that `channel` has, where they are known already, as those of a loop around another one have to be.
    directions: Channels | None = None
    progress: Progress = lambda line: None  # called with a line during long work

    @property
    def plants(self) -> PlantSet:
        """The plants, the nominal one first; their outputs are the directions of `channel` where it has `sense`."""
        assert self.plant_set is not None, "the loop has plants"
        sense = self.channel.sense
        return self.plant_set if sense is None else self.plant_set.in_directions(sense)

    def with_commands(self, K: System) -> System:
        """Return the design's controller of `plants` with its commands, if it says what to do with them; else K."""
        if self.design.command is None:
            return K
        return shaped(K._replace(dt=self.plants.period), self.design.command, self.channel, np.eye(len(K.B.T)))

    @property
    def channel(self) -> Channels:
        """Gyroscopic pairs and inertial directions of the loop's gimbals."""
        if self.directions is not None:
            return self.directions
        signals = loop_signals(self.model.platform, self.spec.read_by(self.design))
        return loop_channels(self.model, signals, self.job.period_of(self.spec))


@value
class Designed:
    """What a design method returns; `designed` measures the closed loop and does not rely on the claims."""

    controller: System  # u = K y, sampled with the job's period or a static gain
    options: dict[str, float]  # the method's numbers as finally used, in the units of the job file
    claims: dict[str, float] = field(default_factory=dict)  # what the method claims, by name, in SI units
    # inputs, outputs: names of the signals; by default the pick-offs and the torquers of the loop's plants.
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


def designed(problem: LoopProblem) -> LoopDesign:
    """Return the design that the problem's method makes, with all its values recomputed; a DesignError says why not."""
    return evaluated(problem, resolved(known_method(problem.design.method).design)(problem))


def evaluated(problem: LoopProblem, found: Designed, *, stable: bool = True) -> LoopDesign:
    """Return what a method has found, all values recomputed; unless `stable` is False, an unstable loop is an error."""
    spec, design, plants = problem.spec, problem.design, problem.plant_set
    method = known_method(design.method)
    if plants is not None:
        found = dataclasses.replace(found, controller=in_signals(problem, found.controller))
        out = measured(spec, design, found, plants, stable=stable)
        out = dataclasses.replace(out, sections=_sections(problem, out), directions=problem.channel)
        if method.goals:
            ratios = {"limit_ratio": out.results, "goal_ratio": out.goals}
            largest = {name: max(result.ratio for result in results) for name, results in ratios.items() if results}
            out = dataclasses.replace(out, claims=out.claims | largest)
        if design.responses is not None and method.on_responses is not None:
            out = resolved(method.on_responses)(problem, out)
        return out
    K = found.controller._replace(dt=problem.job.sampling.period)
    out = LoopDesign(
        loop=spec.name,
        name=design.name,
        method=design.method,
        controller=K.to_control(found.inputs, found.outputs, name=f"{spec.name}, {design.name}"),
        options=found.options,
        claims=found.claims,
    )
    return dataclasses.replace(out, sections=_sections(problem, out))


def _sections(problem: LoopProblem, design: LoopDesign) -> tuple[Section, ...]:
    """Return the sections of a design; none where commands or feedforward are added to its method's controller."""
    method, plants = known_method(design.method), problem.plant_set
    if method.sections is None or (plants is not None and tuple(design.controller.input_labels) != plants.angles):
        return ()
    found: tuple[Section, ...] = resolved(method.sections)(problem, design.options)
    return found


def in_signals(problem: LoopProblem, controller: System) -> System:
    """Return what a method made, from the readings of the loop's plants, with the commands that its design shapes."""
    design, channel = problem.design, problem.channel
    sense, K = channel.sense, controller
    if sense is not None:
        K = K._replace(B=K.B @ sense, D=K.D @ sense)
    if design.command is not None:
        own = K._replace(dt=problem.job.period_of(problem.spec))
        K = shaped(own, design.command, channel, np.eye(len(own.B.T)) if sense is None else sense)
    return K


def measured(
    spec: LoopSpec, design: DesignSpec, found: Designed, plants: PlantSet, *, stable: bool = True
) -> LoopDesign:
    """Return the design with all its numbers recomputed from the closed loops; `stable` as of `evaluated`."""
    K = found.controller._replace(dt=plants.period)
    out = _measured(spec, design.name, design.method, K, plants)
    out = dataclasses.replace(out, options=found.options, claims=found.claims)
    if stable and (error := instability(out, design.tune)) is not None:
        raise error
    return out


def instability(design: LoopDesign, tuned: bool) -> NotCertifiedError | None:
    """Return the error that the closed loop with the nominal plant is unstable; None where it is stable."""
    measures = design.measures
    if measures is None or measures.decay[0] > 0.0:
        return None
    advice = known_method(design.method).advice
    if tuned:
        advice = "a higher rate_hz, a shorter delay or other limits: no start of the tuner leads to a stable loop"
    return NotCertifiedError(
        f"{design.loop}, {design.name}: the closed loop grows at {-measures.decay[0]:.3g} 1/s: it is unstable; try "
        f"{advice}",
        design.plants,
    )


def requirements_of(spec: LoopSpec) -> tuple[LoopRequirement, ...]:
    """Return all limits and goals of a loop."""
    hard, soft = _hard_and_soft(spec)
    return (*hard, *soft)


def _hard_and_soft(spec: LoopSpec) -> list[tuple[LoopRequirement, ...]]:
    def named(one: LoopRequirement) -> LoopRequirement:
        return dataclasses.replace(one, name=of_readings(one.name, spec.kind), unit=of_readings(one.unit, spec.kind))

    return [tuple(map(named, part)) for part in hard_and_soft(spec.limits, spec.soft)]


def limits_and_goals(
    spec: LoopSpec, design: str, plants: PlantSet, measures: LoopMetrics
) -> tuple[tuple[CheckResult, ...], tuple[CheckResult, ...]]:
    """Return the loop's limits and its goals compared with `measures`."""
    shaping = next((one.command for one in spec.designs if one.name == design), None)

    def result(requirement: LoopRequirement) -> CheckResult:
        found = requirement.result(plants, measures, subject=spec.name, design=design)
        late = shaping is not None and requirement.kind in _LATE
        return found.because(filter_lag(shaping.filter_hz)) if late and shaping is not None else found

    hard, soft = (tuple(map(result, requirements)) for requirements in _hard_and_soft(spec))
    return hard, soft


def filter_lag(hz: float) -> str:
    """Say how late a reference filter makes a path that is not known ahead."""
    return f"behind the reference filter (filter_hz = {hz:g}), which alone is {1.0 / (math.pi * hz):.3g} s late"


def remeasured(spec: LoopSpec, name: str, controller: control.StateSpace, plants: PlantSet) -> LoopDesign:
    """Return an existing controller as a design of `spec`, measured again, without its claims."""
    K = with_commands(plants, controller)
    return _measured(spec, name, "given", K, plants)


def _measured(spec: LoopSpec, name: str, method: str, K: System, plants: PlantSet) -> LoopDesign:
    """Return a controller with its measures, compared with the limits and goals."""
    measures = measure(plants, K, requirements_of(spec))
    results, goals = limits_and_goals(spec, name, plants, measures)
    return LoopDesign(
        loop=spec.name,
        name=name,
        method=method,
        controller=_delivered(K, plants, f"{spec.name}, {name}"),
        plants=plants,
        measures=measures,
        results=results,
        goals=goals,
    )


def _commands(plants: PlantSet) -> list[str]:
    return [f"{name}{COMMAND}" for name in plants.angles]


def _delivered(K: System, plants: PlantSet, name: str) -> control.StateSpace:
    """Return a controller of what the plants measure, perhaps of its commands behind it, with feedforward, by name."""
    commands = _commands(plants)[: K.B.shape[1] - len(plants.angles)]
    whole = K if plants.feedforward is None else plants.feedforward.joined_to(K)
    return whole.to_control(plants.named_inputs(commands), plants.torques, name=name)


def with_commands(plants: PlantSet, controller: control.StateSpace) -> System:
    """Return a controller of what the plants measure and, if it takes their commands, of these behind it."""
    own = plants.joined(controller)
    given, names = plants.without_feedforward(controller)
    commands = _commands(plants)
    if not set(commands) <= set(names):
        return own
    at = [names.index(name) for name in (*plants.angles, *commands)]
    of = [controller.output_labels.index(name) for name in plants.torques]
    p, K = len(plants.angles), given.part(of, at)
    # What compares readings and commands alone is measured as what it is, K.
    error = np.array_equal(K.B[:, :p], -K.B[:, p:]) and np.array_equal(K.D[:, :p], -K.D[:, p:])
    return own if error else K


def commanded(design: LoopDesign) -> LoopDesign:
    """Return the design with commands: u = K (y − command) unless it says otherwise."""
    plants = design.plants
    assert plants is not None, "a loop that is commanded has plants"
    if set(_commands(plants)) <= set(design.controller.input_labels):
        return design
    arrays = with_error_alone(plants.joined(design.controller))
    controller = _delivered(arrays, plants, str(design.controller.name))
    errors = {name: f"{name}_error" for name in plants.angles}
    compared = gain(np.hstack([np.eye(len(errors)), -np.eye(len(errors))]))
    inputs = (*plants.angles, *_commands(plants))
    first = Section("error", "mix", "readings minus commands", compared, inputs, tuple(errors.values()))
    rest = (one._replace(inputs=tuple(errors.get(name, name) for name in one.inputs)) for one in design.sections)
    sections = (first, *rest) if design.sections else ()
    return dataclasses.replace(design, controller=controller, sections=sections)


def with_controller(design: LoopDesign, controller: System) -> LoopDesign:
    """Return a design with another controller of what its plants measure; nothing of it is measured again."""
    plants = design.plants
    assert plants is not None, "the loop has plants"
    K = _delivered(controller._replace(dt=plants.period), plants, str(design.controller.name))
    found = dataclasses.replace(design, controller=K, sections=())
    return commanded(found) if set(_commands(plants)) <= set(design.controller.input_labels) else found


def closed_loop_poles(plants: PlantSet, controller: control.StateSpace) -> ComplexArray:
    """Return the poles of every plant's closed loop, complex (N, poles), in z."""
    K = System.of(controller, "closed_loop_poles")
    A = plants.arrays._replace(dt=K.dt).feedback(K).A
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)


def completed(method: str, given: dict[str, float], defaults: dict[str, float]) -> dict[str, float]:
    """Return `defaults` with the `given` numbers in place."""
    unused = sorted(set(given) - set(defaults))
    if unused:
        close = nearest(unused[0], defaults)
        hint = "" if close is None else f"did you mean {close!r}? "
        raise DesignError(
            f"{method}: option {unused[0]!r} has no meaning for this loop; {hint}its options are {', '.join(defaults)}"
        )
    out = defaults | given
    wrong = [name for name, x in out.items() if not x > 0.0]
    if wrong:
        raise DesignError(f"{method}: {wrong[0]} must be > 0, got {out[wrong[0]]:g}")
    return out


def shaped(K: System, shaping: CommandShaping, directions: Channels, sense: FloatArray) -> System:
    """Return the controller of readings and commands behind a reference filter, of K from the readings.

    u = K (y − F r) + H F r. F = ω²/(s + ω)² does not overshoot. H is the inverse of the plant along the directions:
    J s² + d s + c of an angle, inertia, viscous friction and spring, and J s + d of a rate. Both are sampled by
    Tustin's rule. `sense` (n, p) leads from the readings to the directions, along which the inertias are known.
    """
    p, w = len(K.B.T), 2.0 * math.pi * shaping.filter_hz
    derivatives = [low_pass(w, _DAMPING, K.dt, order) for order in range(directions.order + 1)]
    A, B, C, D = (block_diag(*(part,) * p) for part in derivatives[0][:4])
    fed_C, fed_D = np.zeros((len(K.C), len(A))), np.zeros((len(K.D), p))
    if shaping.acceleration:
        # By the derivative that they go with, the highest first.
        needed = (directions.inertias, directions.damping, directions.stiffness)
        for one, strength in zip(reversed(derivatives), needed, strict=False):
            if strength is not None:
                torque = strength[:, None] * sense
                fed_C += torque @ block_diag(*(one.C,) * p)
                fed_D += torque @ block_diag(*(one.D,) * p)
    return System(
        np.block([[K.A, -K.B @ C], [np.zeros((len(A), len(K.A))), A]]),
        np.block([[K.B, -K.B @ D], [np.zeros((len(A), p)), B]]),
        np.hstack([K.C, fed_C - K.D @ C]),
        np.hstack([K.D, fed_D - K.D @ D]),
        K.dt,
    )
