"""The loops of a job: every design of every loop, made by its method and certified."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.progress import Progress, shown
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.store import Store
from platform_ctrl.common.values import value
from platform_ctrl.design.caging_claims import shortest_rise
from platform_ctrl.design.feedforward import design_plants
from platform_ctrl.design.loop import LoopDesign, LoopProblem, commanded, with_commands
from platform_ctrl.design.loop_signals import loop_channels, loop_signals
from platform_ctrl.design.partition import Channels
from platform_ctrl.design.plants import plants_of, tracking_plants
from platform_ctrl.design.reuse import design_job, kept_or_designed, plant_job
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.reading import read_job
from platform_ctrl.mechanics.linearisation import linearise


@value
class LoopOutcome:
    """A loop of a job with all its designs, in the job's order; `use` is the name of the one that is closed."""

    spec: LoopSpec
    designs: tuple[LoopDesign, ...]
    use: str

    @property
    def closed(self) -> LoopDesign:
        """The design that is closed together with those of the other loops."""
        return next(design for design in self.designs if design.name == self.use)

    @property
    def alternatives(self) -> tuple[LoopDesign, ...]:
        """The other designs."""
        return tuple(design for design in self.designs if design.name != self.use)


@check_arguments
def loops(
    job: Job | str | os.PathLike[str] | Mapping[str, object],
    progress: Progress | bool | None = None,
    store: Store | None = None,
) -> tuple[LoopOutcome, ...]:
    """Design every loop of `job` by each of its methods.

    Parameters
    ----------
    job
        The job, or what `read_job` reads: a path or a dict.
    progress
        Called with a line before and during each design; True shows the lines, in a notebook or on a terminal.
    store
        Where designs are kept. One that was made from the same loop, plant and sampling by the same code is not made
        again: it is measured, and its certificates are verified, against the closed loops of this job.

    Returns
    -------
    tuple of LoopOutcome
        In the job's order, but a tracking loop before the rate loop that it commands.

    Raises
    ------
    InputError
        The job makes no sense, or a loop's gimbals cut through a subsystem.
    DesignError
        A method found no controller that its certificate accepts.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).
    """
    job = job if isinstance(job, Job) else read_job(job)
    with shown(progress) as say:
        return _loops(job, say, store)


def _loops(job: Job, progress: Progress, store: Store | None) -> tuple[LoopOutcome, ...]:
    model = linearise(job.platform)
    # All plants before the first design: an error in the third loop is raised before the work on the first.
    plants_of_all = [_plants_of_designs(plant_job(job, spec), spec) for spec in job.loops]
    out: list[LoopOutcome] = []
    for spec, plants_of_loop in zip(job.loops, plants_of_all, strict=True):
        inside = directions = inner = None
        if spec.kind == "tracking":
            inner = next(one for one in out if one.spec.name == spec.around).closed
            around = next(one for one in job.loops if one.name == spec.around)
            assert inner.plants is not None, "a rate loop has plants"
            K = with_commands(inner.plants, inner.controller)
            inside, directions = tracking_plants(plant_job(job, spec, around), spec, around, inner.plants, K)
        of_sensors: dict[tuple[str, ...], Channels] = {}
        designs = []
        for design, own in zip(spec.designs, plants_of_loop, strict=True):
            plants = own if inside is None else inside
            if inside is None and plants is not None:
                # Once for all designs that read the same, which ask for them again and again.
                read = spec.read_by(design)
                if read.sensors not in of_sensors:
                    found = loop_channels(model, loop_signals(job.platform, read), plants.period)
                    of_sensors[read.sensors] = found
                directions = of_sensors[read.sensors]
            alone = design_job(job, spec, design)
            problem = LoopProblem(
                job=alone,
                spec=alone.loops[-1],
                design=design,
                model=model,
                plant_set=plants,
                directions=directions,
                progress=progress,
            )
            progress(f"{spec.name}: {design.name}")
            try:
                designs.append(kept_or_designed(problem, shortest_rise(job), inner, store))
            except DesignError as error:
                if plants is None or str(error).startswith(f"{spec.name}, "):
                    raise
                raise type(error)(f"{spec.name}, {design.name}: {error}", error.problem) from None
        out.append(LoopOutcome(spec=spec, designs=tuple(designs), use=spec.use))
    return in_order(job, out)


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
