"""The loops of a job: every design of every loop, made by its method and certified."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.progress import Local, Progress, shown
from platform_ctrl.common.values import value
from platform_ctrl.design.feedforward import design_plants
from platform_ctrl.design.loop import LoopDesign, LoopProblem, commanded, instability, with_commands
from platform_ctrl.design.loop_signals import loop_channels, loop_signals
from platform_ctrl.design.partition import Channels
from platform_ctrl.design.plants import plants_of, tracking_plants
from platform_ctrl.design.reduced_jobs import design_job, plant_job
from platform_ctrl.design.side_by_side import made_of
from platform_ctrl.errors import DesignError, reason
from platform_ctrl.job.job import DesignSpec, Job, LoopSpec
from platform_ctrl.job.reading import read_job
from platform_ctrl.mechanics.linearisation import LinearModel, linearise


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
    designs: tuple[LoopDesign, ...]
    use: str
    failed: tuple[FailedDesign, ...] = ()  # An unstable design is among `designs` as well

    @property
    def closed(self) -> LoopDesign:
        """The design that is closed together with those of the other loops."""
        return next(design for design in self.designs if design.name == self.use)

    @property
    def alternatives(self) -> tuple[LoopDesign, ...]:
        """The other designs."""
        return tuple(design for design in self.designs if design.name != self.use)

    @property
    def failure(self) -> FailedDesign | None:
        """The failure of the design that the job uses; None where it did not fail."""
        return next((one for one in self.failed if one.name == self.spec.use), None)


def loops(
    job: Job | str | os.PathLike[str] | Mapping[str, object],
    progress: Progress | bool | None = None,
) -> tuple[LoopOutcome, ...]:
    """Design every loop of `job` by each of its methods.

    Parameters
    ----------
    job
        The job, or what `read_job` reads: a path or a dict.
    progress
        Called with a line before and during each design; True shows the lines, in a notebook or on a terminal.

    Returns
    -------
    tuple of LoopOutcome
        In the job's order, but a tracking loop before the rate loop that it commands. A design that is not the one that
        its loop uses may fail: `failed` says why.

    Raises
    ------
    InputError
        The job makes no sense, or a loop's gimbals cut through a subsystem.
    DesignError
        A method found no controller for the design that a loop uses, or its closed loop is unstable.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).
    """
    found = attempted_loops(job, progress)
    for outcome in found:
        if outcome.failure is not None:
            raise outcome.failure.error
    return found


def attempted_loops(
    job: Job | str | os.PathLike[str] | Mapping[str, object],
    progress: Progress | bool | None = None,
    processes: int = 1,
) -> tuple[LoopOutcome, ...]:
    """Return what `loops` returns, though designs that loops use have failed; then a loop may have no design at all.

    Designs are made side by side in up to so many processes.
    """
    job = job if isinstance(job, Job) else read_job(job)
    with shown(progress) as say:
        return _loops(job, say, processes)


def _loops(job: Job, progress: Progress, processes: int) -> tuple[LoopOutcome, ...]:
    model = linearise(job.platform)
    # All plants before the first design: an error in the third loop is raised before the work on the first.
    plants_of_all = {spec.name: _plants_of_designs(plant_job(job, spec), spec) for spec in job.loops}
    made: dict[str, LoopOutcome] = {}
    # A tracking loop has the rate loop that it commands in its plants.
    for tracking in (False, True):
        specs = [spec for spec in job.loops if (spec.kind == "tracking") is tracking]
        problems: list[LoopProblem] = []
        for spec in specs:
            around = made[str(spec.around)] if tracking else None
            if around is not None and around.failure is not None:
                made[spec.name] = _without_inner(spec, around.failure)
                continue
            inner = None if around is None else around.closed
            directed = _with_directions(job, spec, model, plants_of_all[spec.name], inner)
            problems += [
                _problem(job, spec, design, model, *own, progress)
                for design, own in zip(spec.designs, directed, strict=True)
            ]
        found = made_of(problems, processes, progress)
        for spec in specs:
            own = [
                (problem.design, one)
                for problem, one in zip(problems, found, strict=True)
                if problem.spec.name == spec.name
            ]
            if own:
                made[spec.name] = _outcome(spec, own)
    return in_order(job, [made[spec.name] for spec in job.loops])


def _outcome(spec: LoopSpec, found: Sequence[tuple[DesignSpec, LoopDesign | Exception]]) -> LoopOutcome:
    """Return the outcome of a loop of what its designs have come to."""
    designs = tuple(one for _, one in found if isinstance(one, LoopDesign))
    errors = [(design, instability(one, design.tune) if isinstance(one, LoopDesign) else one) for design, one in found]
    failed = tuple(_failed(spec, design, error) for design, error in errors if error is not None)
    names = [one.name for one in designs]
    use = spec.use if spec.use in names or not names else names[0]
    return LoopOutcome(spec=spec, designs=designs, use=use, failed=failed)


def _without_inner(spec: LoopSpec, inner: FailedDesign) -> LoopOutcome:
    """Return the outcome of a tracking loop of which the loop inside has no design to rely on."""
    words = f"the design {inner.name!r} of the loop {inner.loop!r}, which it commands, has failed"
    failed = tuple(
        _failed(spec, design, DesignError(f"{spec.name}, {design.name}: {words}")) for design in spec.designs
    )
    return LoopOutcome(spec=spec, designs=(), use=spec.use, failed=failed)


def _failed(spec: LoopSpec, design: DesignSpec, error: Exception) -> FailedDesign:
    return FailedDesign(loop=spec.name, name=design.name, method=design.method, error=error)


Directed = tuple[PlantSet | None, Channels | None]


def _with_directions(
    job: Job, spec: LoopSpec, model: LinearModel, plants: Sequence[PlantSet | None], inner: LoopDesign | None
) -> list[Directed]:
    """Return the plants of each design of a loop with their directions.

    `inner` is the design of the loop that a tracking loop commands.
    """
    if inner is not None:
        around = next(one for one in job.loops if one.name == spec.around)
        assert inner.plants is not None, "a rate loop has plants"
        K = with_commands(inner.plants, inner.controller)
        return [tracking_plants(plant_job(job, spec, around), spec, around, inner.plants, K)] * len(plants)
    of_sensors: dict[tuple[str, ...], Channels] = {}
    out: list[Directed] = []
    for design, own in zip(spec.designs, plants, strict=True):
        read = spec.read_by(design)
        if own is not None and read.sensors not in of_sensors:
            # Once for all designs that read the same, which ask for them again and again.
            of_sensors[read.sensors] = loop_channels(model, loop_signals(job.platform, read), own.period)
        out.append((own, None if own is None else of_sensors[read.sensors]))
    return out


def _problem(
    job: Job,
    spec: LoopSpec,
    design: DesignSpec,
    model: LinearModel,
    plants: PlantSet | None,
    directions: Channels | None,
    progress: Progress,
) -> LoopProblem:
    alone = design_job(job, spec, design)
    return LoopProblem(
        job=alone,
        spec=alone.loops[-1],
        design=design,
        model=model,
        plant_set=plants,
        directions=directions,
        progress=Local(progress),
    )


def _plants_of_designs(job: Job, spec: LoopSpec) -> list[PlantSet | None]:
    """Return the plants of every design of a loop: those of designs that read the same are made once."""
    bare: dict[tuple[str, ...], PlantSet | None] = {}
    out = []
    for design in spec.designs:
        read = spec.read_by(design)
        if read.sensors not in bare:
            bare[read.sensors] = plants_of(job, read)
        out.append(design_plants(job, spec, design, bare[read.sensors]))
    return out


def _commanded(job: Job, design: LoopDesign, around: bool) -> LoopDesign:
    """Return a design with commands where a loop around it or a manoeuvre commands what it reads."""
    plants = design.plants
    return commanded(design) if plants is not None and (around or job.commanded & set(plants.angles)) else design


def in_order(job: Job, outcomes: Sequence[LoopOutcome]) -> tuple[LoopOutcome, ...]:
    """Return loops in the order in which their controllers are computed: a tracking loop before the one it commands.

    Those that such a loop or a manoeuvre commands take commands then.
    """
    around = {one.spec.around for one in outcomes}
    out = []
    for one in outcomes:
        designs = tuple(_commanded(job, design, one.spec.name in around) for design in one.designs)
        out.append(dataclasses.replace(one, designs=designs))
    for tracking in [one for one in out if one.spec.kind == "tracking"]:
        out.remove(tracking)
        k = next(i for i, one in enumerate(out) if one.spec.name == tracking.spec.around)
        out.insert(k, tracking)
    return tuple(out)
