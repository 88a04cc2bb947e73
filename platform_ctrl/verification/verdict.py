"""The whole job: designs, coupled check, simulated runs, and one verdict over all requirements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from platform_ctrl.common.arguments import instance
from platform_ctrl.common.progress import Progress, shown
from platform_ctrl.common.values import replaced, value
from platform_ctrl.design.cases import subsystems_over
from platform_ctrl.design.loop import FailedDesign, LoopOutcome, with_resolvers
from platform_ctrl.errors import NotFoundError, reason
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult, Requirement
from platform_ctrl.job.quantities import assumed_words
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.verification import budget_result as budgets
from platform_ctrl.verification.budget import line_of_sight_budget
from platform_ctrl.verification.coupled import ALL_LOOPS, CoupledCheck, coupled_check
from platform_ctrl.verification.proofs import Proofs, coupled_proofs, flint, proofs_of, with_proofs
from platform_ctrl.verification.simulated import Run, simulate_manoeuvre, simulated_budget

FOUND = Requirement(name="controller found", limit=1.0, unit="", sense="at least")


@value
class JobResult:
    """The result of a job.

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
        The checks of the whole; None and empty where a loop has no controller.
    proofs
        Of every design by (loop, design), and of the coupled system by ("", ""); empty unless they were asked for.
    requirements
        All results that the verdict rests on: the closed designs', the coupled system's, the budget's, the runs'.
    budget
        Of the line of sight, where the job limits it or simulates its sources.
    simulated_budget
        The same from runs of the non-linear plant, where the job's budget has `runs`.
    failed
        Designs that were not found, or whose closed loop is unstable.
    """

    job: Job
    model: LinearModel
    subsystems: tuple[tuple[str, ...], ...]
    loops: tuple[LoopOutcome, ...]
    coupled: CoupledCheck | None
    runs: tuple[Run, ...]
    proofs: dict[tuple[str, str], Proofs]
    requirements: tuple[CheckResult, ...]
    budget: budgets.LineOfSightBudget | None = None
    simulated_budget: budgets.SimulatedBudget | None = None
    failed: tuple[FailedDesign, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every requirement is met; goals do not count."""
        return all(result.passed or not result.hard for result in self.requirements)

    @property
    def assumptions(self) -> str:
        """Assumptions of the verdict, in words that are printed with it; empty where there are none."""
        coupled = self.coupled
        return assumed_words(self.job, *(() if coupled is None else (coupled.free_angles, coupled.uncontrolled)))

    def inner(self, outcome: LoopOutcome) -> LoopOutcome | None:
        """Return the rate loop that a tracking loop commands; None for other loops."""
        return next((one for one in self.loops if one.spec.name == outcome.spec.around), None)


def check_job(
    job: Job, loops: Sequence[LoopOutcome], progress: Progress | bool | None = None, *, prove: bool = False
) -> JobResult:
    """Close the chosen designs of `loops`, check the whole, and return the verdict.

    Parameters
    ----------
    job
        The job.
    loops
        From `platform_ctrl.design.loops`, or from controllers that exist already. Where one has no design at all, the
        others are not closed together.
    progress
        Called with a line before each step; True shows the lines, in a notebook or on a terminal.
    prove
        Whether stability and disk margins are proved in interval arithmetic as well, which takes minutes and the extra
        ``proofs``. Without it they rest on the poles and on the exact norm, computed in floating point.

    Returns
    -------
    JobResult
        With every requirement compared with its measured value.

    Raises
    ------
    ArgumentError
        The controllers do not fit the plant.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).
    """
    instance("job", job, Job)
    if prove:
        flint()  # before the work, where it is missing
    with shown(progress) as say:
        return _checked(job, loops, say, prove)


def _checked(job: Job, outcomes: Sequence[LoopOutcome], say: Progress, prove: bool) -> JobResult:
    model = linearise(job.platform)
    loops = [one for one in outcomes if one.designs]
    complete = len(loops) == len(outcomes)
    controllers = [outcome.closed.controller for outcome in loops]
    coupled, budget, simulated, runs = None, None, None, []
    unjudged = "the loop is not stable"
    if complete:
        say("coupled check: all loops on the coupled sampled model")
        coupled = coupled_check(job, model, controllers)
    proofs: dict[tuple[str, str], Proofs] = {}
    if prove:
        say("proofs in interval arithmetic: stability and disk margins")
        proofs = {(d.loop, d.name): proofs_of(outcome.spec, d) for outcome in loops for d in outcome.designs}
        if coupled is not None:
            proofs["", ""] = coupled_proofs(coupled, with_resolvers(job, controllers, job.trims[0]))
    shaken = job.budget.runs if job.budget is not None else None
    if coupled is not None and coupled.stable_at_all_angles and (budgets.budget_requirements(job.budget) or shaken):
        say("budget: every source through the coupled sampled model")
        try:
            budget = line_of_sight_budget(job, controllers)
        except NotFoundError as error:  # dry friction; everything else has its verdict
            unjudged = reason(error)
        if shaken and budget is not None:
            say(f"budget: {shaken} runs of the non-linear plant")
            simulated = simulated_budget(job, controllers, shaken, seed=job.seed)
            budget = replaced(budget, {"results": budgets.by_simulation(budget.results, simulated)})
    for manoeuvre in job.manoeuvres if complete else ():
        say(f"simulated run: {manoeuvre.name}")
        runs.append(simulate_manoeuvre(job, manoeuvre, controllers))
    requirements = [*_not_found(outcomes)]
    for outcome in loops:
        design = outcome.closed
        requirements += with_proofs(design.results, proofs.get((design.loop, design.name)), design.loop, design.name)
    if coupled is not None:
        requirements += with_proofs(coupled.results, proofs.get(("", "")), ALL_LOOPS)
        requirements += budgets.unstable_results(job, unjudged) if budget is None else budget.results
    requirements += [result for run in runs for result in run.results]
    return JobResult(
        job=job,
        model=model,
        subsystems=subsystems_over(job.platform, job.Omega, job.Omega_grid),
        loops=tuple(loops),
        coupled=coupled,
        runs=tuple(runs),
        proofs=proofs,
        requirements=tuple(requirements),
        budget=budget,
        simulated_budget=simulated,
        failed=tuple(one for outcome in outcomes for one in outcome.failed),
    )


def _not_found(outcomes: Sequence[LoopOutcome]) -> Iterator[CheckResult]:
    """Yield a result that is missed for each design that a loop uses and that was not found."""
    for outcome in outcomes:
        failure = outcome.failure
        if failure is not None and failure.name not in [one.name for one in outcome.designs]:
            closed = f"; “{outcome.use}” is closed in its place" if outcome.designs else "; the whole is not checked"
            yield FOUND.judge(
                0.0,
                subject=failure.loop,
                design=failure.name,
                stage="decoupled",
                evidence=f"{failure.sentence}{closed}",
                method="exact",
            )
