"""A designed loop: all its values are recomputed from the actual sampled closed loop."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import field

import numpy as np

from platform_ctrl.analysis.feedback import with_error_alone
from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import ComplexArray, StateSpace, System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.sections import Section, gain
from platform_ctrl.errors import reason
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import LoopRequirement
from platform_ctrl.plant.platform import OMEGA_NAMES

# A torque for 1 rad/s below this share of the limit counts as zero: that rate does not load the loop.
_NO_LOAD = 1e-6
# Metrics in which the lag of a reference filter counts, on a path that is not known ahead.
_LATE = ("ramp error", "tracking error")


@value
class Design:
    """A sampled controller of one loop, what it does there, and whether that meets the limits.

    A method makes it, `design.method.evaluated` measures it.

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
        Recomputed from the closed loop; None as above, and until it is measured.
    results
        The loop's limits compared with the measures.
    goals
        The loop's goals compared with the measures; they do not count for the verdict.
    claims
        Claims of the method by name, in SI units: for example ``gamma``.
    sections
        The controller block by block, where its method makes it of blocks and nothing else is added to it.
    directions
        Gyroscopic pairs and inertial directions in which its method saw the plants; None where they are not known.
    """

    loop: str
    name: str
    method: str
    controller: StateSpace
    options: dict[str, float] = field(default_factory=dict)
    plants: PlantSet | None = None
    measures: LoopMetrics | None = None
    results: tuple[CheckResult, ...] = ()
    goals: tuple[CheckResult, ...] = ()
    claims: dict[str, float] = field(default_factory=dict)
    sections: tuple[Section, ...] = ()
    directions: Channels | None = None

    @property
    def plant(self) -> StateSpace | None:
        """The nominal sampled plant, from torques and Omega1 to Omega3 to angles: see `PlantSet.system`.

        ``control.interconnect([design.plant, design.controller], inputs=["Omega1", "Omega2", "Omega3"], outputs=...)``
        closes the loop by the signals' names; with `own_controller` where the design has feedforward of the platform's
        rate, which is a part of its plants. None where `plants` is.
        """
        return None if self.plants is None else self.plants.system()

    @property
    def own_controller(self) -> StateSpace:
        """The controller from what the loop measures, without its commands and feedforward."""
        if self.plants is None:
            return self.controller
        return self.plants.joined(self.controller).to_control(self.plants.angles, self.plants.torques)

    @property
    def passed(self) -> bool:
        """Whether every requirement is met; goals do not count."""
        return all(result.passed for result in self.results)


@value
class FailedDesign:
    """A design that a method did not find, or whose closed loop is unstable; `error` says why."""

    loop: str
    name: str
    method: str
    error: Exception

    @property
    def sentence(self) -> str:
        """Why it failed, in one line, without its name."""
        return reason(self.error).removeprefix(f"{self.loop}, {self.name}: ")


@value
class LoopOutcome:
    """A loop of a job with its designs, in the job's order; `use` is the name of the one that is closed.

    Where the design that the job uses was not found, the first of the others is closed: `failed` says so.
    """

    spec: LoopSpec
    designs: tuple[Design, ...]
    use: str
    failed: tuple[FailedDesign, ...] = ()  # An unstable design is among `designs` as well

    @property
    def closed(self) -> Design:
        """The design that is closed together with those of the other loops."""
        return next(design for design in self.designs if design.name == self.use)

    @property
    def alternatives(self) -> tuple[Design, ...]:
        """The other designs."""
        return tuple(design for design in self.designs if design.name != self.use)

    @property
    def failure(self) -> FailedDesign | None:
        """The failure of the design that the job uses; None where it did not fail."""
        return next((one for one in self.failed if one.name == self.spec.use), None)


def sampled_plant(plants: PlantSet, k: int = 0) -> StateSpace:
    """Return the nominal sampled plant (or plant `k` of the set) with its signal names."""
    return plants.arrays.at(k).to_control(plants.torques, plants.angles, plants.states)


def limits_and_goals(
    spec: LoopSpec, design: str, plants: PlantSet, measures: LoopMetrics
) -> tuple[tuple[CheckResult, ...], tuple[CheckResult, ...]]:
    """Return the loop's limits and its goals compared with `measures`."""
    shaping = next((one.command for one in spec.designs if one.name == design), None)

    def result(requirement: LoopRequirement) -> CheckResult:
        found = requirement.result(plants, measures, subject=spec.name, design=design)
        if shaping is None or requirement.kind not in _LATE:
            return found
        hz = shaping.filter_hz
        late = f"{1.0 / (math.pi * hz):.3g} s late"
        return found.because(f"behind the reference filter (filter_hz = {hz:g}), which alone is {late}")

    return tuple(map(result, spec.requirements)), tuple(map(result, spec.goals))


def measured(spec: LoopSpec, design: Design) -> Design:
    """Return a design of plants with what its controller does in the closed loops, judged."""
    plants = design.plants
    assert plants is not None, "the loop has plants"
    measures = measure(plants, with_commands(plants, design.controller), spec.requests)
    results, goals = limits_and_goals(spec, design.name, plants, measures)
    return dataclasses.replace(design, measures=measures, results=results, goals=goals)


def given_design(
    spec: LoopSpec, name: str, controller: System | StateSpace, plants: PlantSet, method: str = "given"
) -> Design:
    """Return a controller of what the plants measure, perhaps of its commands behind it, as a design, measured."""
    K = controller if isinstance(controller, System) else with_commands(plants, controller)
    made = delivered(K._replace(dt=plants.period), plants, f"{spec.name}, {name}")
    return measured(spec, Design(loop=spec.name, name=name, method=method, controller=made, plants=plants))


def _commands(plants: PlantSet) -> list[str]:
    return [f"{name}{COMMAND}" for name in plants.angles[: plants.kept]]


def delivered(K: System, plants: PlantSet, name: str) -> StateSpace:
    """Return a controller of what the plants measure, perhaps of its commands behind it, with feedforward, by name."""
    commands = _commands(plants)[: K.B.shape[1] - len(plants.angles)]
    whole = K if plants.feedforward is None else plants.feedforward.joined_to(K)
    return whole.to_control(plants.named_inputs(commands), plants.torques, name=name)


def with_commands(plants: PlantSet, controller: StateSpace) -> System:
    """Return a controller of what the plants measure and, if it takes their commands, of these behind it."""
    own, commands = plants.joined(controller), _commands(plants)
    if not set(commands) <= set(controller.input_labels):
        return own
    given, names = plants.without_feedforward(controller)
    at = [names.index(name) for name in (*plants.angles, *commands)]
    of = [controller.output_labels.index(name) for name in plants.torques]
    p, K = len(plants.angles), given.part(of, at)
    # A controller of the errors y − r alone is measured as K from the errors.
    alone = with_error_alone(K.part(slice(None), slice(p)), plants.commanded)
    return own if np.array_equal(K.B, alone.B) and np.array_equal(K.D, alone.D) else K


def takes_commands(design: Design) -> bool:
    """Return whether a design of a loop with plants has commands of what it reads among its inputs."""
    return design.plants is not None and set(_commands(design.plants)) <= set(design.controller.input_labels)


def commanded(design: Design) -> Design:
    """Return the design with commands: u = K (y − command) unless it says otherwise."""
    plants = design.plants
    assert plants is not None, "a loop that is commanded has plants"
    if takes_commands(design):
        return design
    arrays = with_error_alone(plants.joined(design.controller), plants.commanded)
    controller = delivered(arrays, plants, str(design.controller.name))
    errors = {name: f"{name}_error" for name in plants.angles}
    compared = with_error_alone(gain(np.eye(len(errors))), plants.commanded)
    inputs = (*plants.angles, *_commands(plants))
    first = Section("error", "mix", "readings minus commands", compared, inputs, tuple(errors.values()))
    rest = (one._replace(inputs=tuple(errors.get(name, name) for name in one.inputs)) for one in design.sections)
    sections = (first, *rest) if design.sections else ()
    return dataclasses.replace(design, controller=controller, sections=sections)


def moves_freely(job: Job, controllers: Sequence[StateSpace]) -> bool:
    """Return whether the platform is free: the plant says how it moves, or a controller sets a torque on the root."""
    return job.platform.moves_freely(any(set(job.platform.root_torquers) & set(K.output_labels) for K in controllers))


def with_resolvers(job: Job, controllers: Sequence[StateSpace], q: FloatArray) -> list[StateSpace]:
    """Return controllers behind what turns readings to joint axes at gimbal angles (n,), a constant matrix each."""
    read = {name for K in controllers for name in K.input_labels}
    laws = [law for law in job.resolvers if not read.isdisjoint(law.names)]
    period = job.sampling.period
    static = [gain(law.matrix(q))._replace(dt=period).to_control(law.read, law.names) for law in laws]
    return [*static, *controllers]


def closed_loop_poles(plants: PlantSet, controller: StateSpace) -> ComplexArray:
    """Return the poles of every plant's closed loop, complex (N, poles), in z."""
    K = System.of(controller, "closed_loop_poles")
    A = plants.arrays._replace(dt=K.dt).feedback(K).A
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)


def with_largest_rates(design: Design) -> Design:
    """Return a caging design with the constant rates about the root axes at which a torquer comes to its limit, rad/s.

    The rates are those of the nominal plant, and where all are stable the least over the plants of the parameter
    uncertainty. They follow from the torques in the steady state; while Omega changes the torques may be larger. There
    is no such rate for torquers without limits, for an axis that loads no torquer, and for an unstable loop.
    """
    plants, measures = design.plants, design.measures
    if plants is None or measures is None or not measures.decay[0] > 0.0:
        return design
    torques, rates = slice(len(plants.torques)), slice(len(plants.torques), len(plants.torques) + 3)
    varied = plants.of(("nominal", "uncertainty"))
    chosen = varied if np.all(measures.decay[varied] > 0.0) else np.arange(len(varied)) == 0
    closed = Loop(plants, with_commands(plants, design.controller)).arrays
    A, B, C, D, _ = closed.part(torques, rates).at(np.flatnonzero(chosen))
    try:
        steady = D + C @ np.linalg.solve(np.eye(A.shape[-1]) - A, B)
    except np.linalg.LinAlgError:
        return design
    # Per axis: share of its limit that the most loaded torquer needs for 1 rad/s.
    share = np.abs(steady / plants.torque_limit[:, None]).max(axis=1)
    claims = dict(design.claims)
    for axis in map(int, np.flatnonzero(share[0] > _NO_LOAD)):
        name = f"largest {OMEGA_NAMES[axis]} without saturation"
        claims[f"{name}, rad/s"] = float(1.0 / share[0, axis])
        if len(share) > 1:
            claims[f"{name}, worst case, rad/s"] = float(1.0 / share[:, axis].max())
    return dataclasses.replace(design, claims=claims)
