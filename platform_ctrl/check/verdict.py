"""The whole job: designs, coupled check, simulated runs, and one verdict over all requirements."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from platform_ctrl.check.coupled import CoupledCheck, coupled_check
from platform_ctrl.check.proofs import Proofs, coupled_proofs, proofs_of
from platform_ctrl.check.simulated import Run, fly
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.plants import subsystems_over
from platform_ctrl.frozen import value
from platform_ctrl.job import Job
from platform_ctrl.linearisation import LinearModel, linearise
from platform_ctrl.requirements import CheckResult
from platform_ctrl.signatures import check_arguments

Progress = Callable[[str], None]


@value
class JobResult:
    """Everything that a job came to.

    Attributes
    ----------
    job
        The job.
    model
        Linear model at rest.
    subsystems
        Groups of gimbals that are coupled at rest or at one of the job's platform rates.
    loops
        For every loop all designs, and which of them is closed.
    coupled, runs
        The checks of the whole.
    proofs
        Of every design by (loop, design), and of the coupled system by ("", ""): its certificates, verified.
    requirements
        All results that the verdict rests on: the closed designs', the coupled system's, the runs'.

    References
    ----------
    See docs/result-file.md.
    """

    job: Job
    model: LinearModel
    subsystems: tuple[tuple[str, ...], ...]
    loops: tuple[LoopOutcome, ...]
    coupled: CoupledCheck
    runs: tuple[Run, ...]
    proofs: dict[tuple[str, str], Proofs]
    requirements: tuple[CheckResult, ...]

    @property
    def passed(self) -> bool:
        """Whether every requirement is met; goals do not count."""
        return all(result.passed or not result.hard for result in self.requirements)


@check_arguments
def checked(job: Job, loops: Sequence[LoopOutcome], progress: Progress | None = None) -> JobResult:
    """Close the chosen designs of `loops`, check the whole, and return the verdict.

    Parameters
    ----------
    job
        The job.
    loops
        From `platform_ctrl.design.loops`, or from controllers that exist already.
    progress
        Called with a line before each step.

    Returns
    -------
    JobResult
        With every requirement held against its measured value.

    Raises
    ------
    ArgumentError
        The controllers do not fit the plant.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).

    References
    ----------
    See docs/loops.md.
    """
    say = progress or (lambda line: None)
    model = linearise(job.platform)
    controllers = [outcome.closed.controller for outcome in loops]
    say("coupled check: all loops on the coupled sampled model")
    coupled = coupled_check(job, model, controllers)
    say("certificates: every claim proved in interval arithmetic")
    proofs = {(d.loop, d.name): proofs_of(d) for outcome in loops for d in outcome.designs}
    together = coupled_proofs(coupled, controllers)
    runs = []
    for manoeuvre in job.manoeuvres:
        say(f"simulated run: {manoeuvre.name}")
        runs.append(fly(job, manoeuvre, controllers))
    requirements: list[CheckResult] = []
    for outcome in loops:
        design = outcome.closed
        shown = proofs[design.loop, design.name].judged(design.loop, design.name, "decoupled")
        requirements += [*design.results, *shown]
    requirements += [*coupled.results, *together.judged("all loops closed", "", "coupled")]
    requirements += [result for run in runs for result in run.results]
    return JobResult(
        job=job,
        model=model,
        subsystems=subsystems_over(job.platform, job.Omega, job.Omega_grid),
        loops=tuple(loops),
        coupled=coupled,
        runs=tuple(runs),
        proofs=proofs | {("", ""): together},
        requirements=tuple(requirements),
    )
