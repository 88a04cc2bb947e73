"""The loops of a job: every design of every loop, made by its method and certified."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.loop import LoopDesign, LoopProblem, Progress, designed
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.job.job import Job, LoopSpec, Uncertainty
from platform_ctrl.job.reading import read_job
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.plant.platform import OMEGA_NAMES


def with_caging_claims(job: Job, design: LoopDesign, *, closed: bool) -> LoopDesign:
    """Return a caging design with its gains in continuous time and, where it is closed, its largest Omega.

    The names end in their units. What does not exist for a loop is left out: the gains of an unstable loop, the largest
    Omega of torquers without limits or of an axis that loads none.
    """
    if design.measures is None or not design.measures.decay[0] > 0.0:
        return design
    claims = dict(design.claims) | _between_samples(job, design)
    if closed:
        claims |= _at_the_limits(job, design)
    return dataclasses.replace(design, claims=claims)


def largest_Omega_name(axis: int, *, worst_case: bool = False) -> str:
    """Return the name of the claim of the largest Omega without saturation about a root axis, 1 to 3."""
    return f"largest {OMEGA_NAMES[axis - 1]} without saturation{', worst case' if worst_case else ''}, rad/s"


def _between_samples(job: Job, design: LoopDesign) -> dict[str, float]:
    from platform_ctrl.design.riccati.intersample_loop import intersample_gains

    try:
        gains = intersample_gains(job, design.controller)
    except ArgumentError:
        return {}
    return {
        "intersample torque rejection, rad/(N m)": gains.torque_rejection,
        "intersample Omega rejection, rad/(rad/s)": gains.Omega_rejection,
    }


def _at_the_limits(job: Job, design: LoopDesign) -> dict[str, float]:
    from platform_ctrl.design.antiwindup.job import caging_largest_Omega

    # Where one plant of the uncertainty is unstable, the claims are those of the nominal plant.
    for requested in (job, dataclasses.replace(job, uncertainty=Uncertainty())):
        try:
            found = caging_largest_Omega(requested, design.controller)
        except (ArgumentError, DesignError):
            continue
        out = {largest_Omega_name(one.axis): one.nominal.Omega for one in found}
        if requested.uncertainty.inertia > 0.0 or requested.uncertainty.spin > 0.0:
            out |= {largest_Omega_name(one.axis, worst_case=True): one.worst_case for one in found}
        return out
    return {}


@value
class LoopOutcome:
    """A loop with all its designs.

    Attributes
    ----------
    spec
        The loop of the job.
    designs
        In the job's order.
    use
        Name of the design that is closed.
    """

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
    job: Job | str | os.PathLike[str] | Mapping[str, object], progress: Progress | None = None
) -> tuple[LoopOutcome, ...]:
    """Design every loop of `job` by each of its methods.

    Parameters
    ----------
    job
        The job, or what `read_job` reads: a path or a dict.
    progress
        Called with a line before and during each design.

    Returns
    -------
    tuple of LoopOutcome
        In the job's order.

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
    say = progress or (lambda line: None)
    model = linearise(job.platform)
    # All plants before the first design: an error in the third loop is raised before the work on the first.
    plant_sets = [plants_of(job, spec) for spec in job.loops]
    out = []
    for spec, plants in zip(job.loops, plant_sets, strict=True):
        designs = []
        for design in spec.designs:
            say(f"{spec.name}: {design.name}")
            problem = LoopProblem(job=job, spec=spec, design=design, model=model, plant_set=plants, say=say)
            try:
                made = designed(problem)
            except DesignError as error:
                if plants is None or str(error).startswith(f"{spec.name}, "):
                    raise
                raise type(error)(f"{spec.name}, {design.name}: {error}", error.problem) from None
            designs.append(made if plants is None else with_caging_claims(job, made, closed=design.name == spec.use))
        out.append(LoopOutcome(spec=spec, designs=tuple(designs), use=spec.use))
    return tuple(out)
