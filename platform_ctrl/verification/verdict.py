"""The whole job: designs, coupled check, simulated runs, and one verdict over all requirements."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.certificate import Verification
from platform_ctrl.analysis.certificates.makers import stability_certificate
from platform_ctrl.analysis.certificates.plant_set import MOST_STATES
from platform_ctrl.analysis.interconnection import interconnected_by_sample
from platform_ctrl.analysis.periodic import lifted
from platform_ctrl.common.progress import Progress, shown
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import replaced, value
from platform_ctrl.design.cases import subsystems_over
from platform_ctrl.design.jobs import FailedDesign, LoopOutcome
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.errors import NotCertifiedError
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import STABLE, CheckResult, Requirement, Stage
from platform_ctrl.job.quantities import assumed_words
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.verification.budget import line_of_sight_budget
from platform_ctrl.verification.budget_limits import by_simulation, is_limited, unstable_results
from platform_ctrl.verification.budget_result import LineOfSightBudget
from platform_ctrl.verification.coupled import ALL_LOOPS, CoupledCheck, coupled_check
from platform_ctrl.verification.simulated import Run, simulate_manoeuvre
from platform_ctrl.verification.simulated_budget import SimulatedBudget, simulated_budget

if TYPE_CHECKING:
    import control

_SIGNS = {"at most": "≤", "at least": "≥"}
# Samples of a cycle up to which stability is proved.
_MOST_SAMPLES = 32
PROVED = Requirement(name="certified properties", limit=1.0, unit="", sense="at least")
FOUND = Requirement(name="controller found", limit=1.0, unit="", sense="at least")


@value
class Proofs:
    """What became of the certificates of one design, or of the coupled system.

    Attributes
    ----------
    certificates, verifications
        One to one.
    unproved
        A line for each claim that has no certificate.
    left_out
        Why nothing is claimed; empty where something is.
    """

    certificates: tuple[Certificate, ...]
    verifications: tuple[Verification, ...]
    unproved: tuple[str, ...]
    left_out: str = ""

    @property
    def proved(self) -> int:
        """Number of certified properties."""
        return sum(one.proved for one in self.verifications)

    @property
    def of(self) -> int:
        """Number of claims."""
        return len(self.verifications) + len(self.unproved)

    def results(self, subject: str, design: str, stage: Stage) -> tuple[CheckResult, ...]:
        """Return the share of the claims that is proved as a requirement; nothing where nothing is claimed."""
        if self.of == 0:
            return ()
        failed = [f"{one.statement}: {one.reason}" for one in self.verifications if not one.proved] + [*self.unproved]
        bits = max((one.precision for one in self.verifications), default=0)
        many = "" if self.of == 1 else "s"
        evidence = failed[0] if failed else f"{self.of} certificate{many} in interval arithmetic, {bits} bits"
        return (
            PROVED.judge(
                self.proved / self.of,
                subject=subject,
                design=design,
                stage=stage,
                evidence=evidence,
                method="proved",
            ),
        )


def _noted(results: Sequence[CheckResult], proofs: Proofs) -> list[CheckResult]:
    """Return results, in that on stability why nothing is proved where that is left out."""
    words = f"; no proof in interval arithmetic: {proofs.left_out}"
    return [
        replaced(one, {"evidence": one.evidence + words}) if proofs.left_out and one.name == STABLE.name else one
        for one in results
    ]


def _too_many(states: int) -> str:
    return f"{states} states, more than {MOST_STATES}" if states > MOST_STATES else ""


def proofs_of(design: LoopDesign) -> Proofs:
    """Return what becomes of the certificates that `design` carries; those of other loops prove nothing of it."""
    K = state_arrays(design.own_controller, "controller")
    left_out = "" if design.plants is None else _too_many(design.plants.A.shape[-1] + len(K.A))
    if left_out:
        return Proofs(certificates=(), verifications=(), unproved=(), left_out=left_out)
    own: list[Certificate] = []
    others: list[str] = []
    for one in design.certificates:
        if _is_of(one, design, K):
            own.append(one)
        else:
            others.append(f"{one.statement}: of another loop")
    return _verified(own, [*design.unproved, *others])


def _is_of(certificate: Certificate, design: LoopDesign, controller: StateArrays) -> bool:
    """Return whether every loop of `certificate` is a plant of `design` with its own controller, to the last bit."""
    return design.plants is not None and all(
        loop.controller is not None
        and all(np.array_equal(*pair) for pair in zip(loop.controller, controller[:4], strict=True))
        and loop.dt == design.plants.period
        and any(np.array_equal(loop.A, A) for A in design.plants.A)
        for loop in certificate.loops
    )


def coupled_proofs(check: CoupledCheck, controllers: Sequence[control.StateSpace]) -> Proofs:
    """Return the proof that the coupled system is stable with all `controllers`; empty where it is not stable."""
    if not check.stable or set(check.free_angles) & set(check.plant.state_labels):
        # An equilibrium that nothing holds is a pole at z = 1, which no interval shows to be stable.
        return _verified((), ())
    together = _side_by_side if check.controller is not None else _over_a_period
    # Over a cycle every sample has inputs and outputs of its own.
    samples = round(check.period / check.plant.dt)
    states = check.plant.nstates + sum(K.nstates for K in controllers)
    left_out = _too_many(states) or ("" if samples <= _MOST_SAMPLES else f"a cycle of {samples} samples")
    if left_out:
        return Proofs(certificates=(), verifications=(), unproved=(), left_out=left_out)
    plant, K = together(check.plant, controllers)
    try:
        found = stability_certificate(
            plant.A, plant.dt, B=plant.B, C=plant.C, D=plant.D, controller=K, label="all loops closed"
        )
    except NotCertifiedError as error:
        return _verified((), (str(error),))
    return _verified((found,), ())


def _verified(certificates: Sequence[Certificate], unproved: Sequence[str]) -> Proofs:
    return Proofs(
        certificates=tuple(certificates),
        verifications=tuple(one.verify() for one in certificates),
        unproved=tuple(unproved),
    )


def _side_by_side(
    plant: control.StateSpace, controllers: Sequence[control.StateSpace]
) -> tuple[StateArrays, StateArrays]:
    """Return plant and controllers such that closing them rounds nothing.

    Controllers stand side by side. What one takes from an earlier one is fed through the plant, whose measurement
    then contains that control itself.
    """
    from scipy.linalg import block_diag

    P = state_arrays(plant, "coupled plant")
    parts = [state_arrays(K, "controller") for K in controllers]
    made = [name for K in controllers for name in K.output_labels]
    taken = [name for K in controllers for name in K.input_labels]
    inputs, outputs = list(plant.input_labels), list(plant.output_labels)
    B = np.zeros((len(P.A), len(made)))
    C = np.zeros((len(taken), len(P.A)))
    D = np.zeros((len(taken), len(made)))
    acting = [j for j, name in enumerate(made) if name in inputs]
    columns = [inputs.index(made[j]) for j in acting]
    B[:, acting] = P.B[:, columns]
    for i, name in enumerate(taken):
        if name in outputs:
            row = outputs.index(name)
            C[i], D[i, acting] = P.C[row], P.D[row, columns]
        elif name in made:  # else nobody commands it: zero
            D[i, made.index(name)] = 1.0
    A_K, B_K, C_K, D_K = (np.asarray(block_diag(*(part[i] for part in parts)), dtype=np.float64) for i in range(4))
    return StateArrays(P.A, B, C, D, P.dt), StateArrays(A_K, B_K, C_K, D_K, P.dt)


def _over_a_period(
    plant: control.StateSpace, controllers: Sequence[control.StateSpace]
) -> tuple[StateArrays, StateArrays]:
    """Return plant and all controllers over the samples after which their order repeats, as one step each."""
    P = state_arrays(plant, "coupled plant")
    by_sample = interconnected_by_sample(controllers, plant.output_labels, plant.input_labels, P.dt)
    return lifted([P] * len(by_sample)), lifted(by_sample)


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
        Of every design by (loop, design), and of the coupled system by ("", ""): its certificates, verified.
    requirements
        All results that the verdict rests on: the closed designs', the coupled system's, the budget's, the runs'.
    budget
        Of the line of sight, where the job limits it or simulates its sources.
    simulated_budget
        What runs of the non-linear plant show of it, where the job's budget has `runs`.
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
    budget: LineOfSightBudget | None = None
    simulated_budget: SimulatedBudget | None = None
    failed: tuple[FailedDesign, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every requirement is met; goals do not count."""
        return all(result.passed or not result.hard for result in self.requirements)

    @property
    def assumptions(self) -> str:
        """What the verdict rests on, in words that go with it; empty where that is nothing."""
        coupled = self.coupled
        return assumed_words(self.job, *(() if coupled is None else (coupled.free_angles, coupled.uncontrolled)))

    def _repr_html_(self) -> str:
        """Return the verdict and all requirements, the tightest first: what notebooks show."""
        by_margin = sorted(self.requirements, key=lambda one: (one.passed or not one.hard, one.margin))
        cells = [
            (
                f"{one.subject} {one.design}".strip(),
                one.name,
                f"{one.value:.4g}",
                f"{_SIGNS[one.sense]} {one.limit:.4g} {one.unit}",
                f"{one.margin:+.0%}",
                "met" if one.passed else "not met" if one.hard else "goal missed",
            )
            for one in by_margin
        ]
        rows = ("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in cells)
        head = "".join(f"<th>{name}</th>" for name in ("of", "requirement", "value", "limit", "margin", ""))
        verdict = f"{escape(self.job.name)}: {'PASSED' if self.passed else 'FAILED'}"
        return f"<table><caption>{verdict}</caption><tr>{head}</tr>{''.join(rows)}</table>"


@check_arguments
def check_job(job: Job, loops: Sequence[LoopOutcome], progress: Progress | bool | None = None) -> JobResult:
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
    with shown(progress) as say:
        return _checked(job, loops, say)


def _checked(job: Job, outcomes: Sequence[LoopOutcome], say: Progress) -> JobResult:
    model = linearise(job.platform)
    loops = [one for one in outcomes if one.designs]
    complete = len(loops) == len(outcomes)
    controllers = [outcome.closed.controller for outcome in loops]
    coupled, budget, simulated, runs = None, None, None, []
    if complete:
        say("coupled check: all loops on the coupled sampled model")
        coupled = coupled_check(job, model, controllers)
    say("certificates: every claim proved in interval arithmetic")
    proofs = {(d.loop, d.name): proofs_of(d) for outcome in loops for d in outcome.designs}
    together = _verified((), ()) if coupled is None else coupled_proofs(coupled, controllers)
    shaken = job.budget.runs if job.budget is not None else None
    if coupled is not None and coupled.stable and (is_limited(job) or shaken):
        say("budget: every source through the coupled sampled model")
        budget = line_of_sight_budget(job, controllers)
        if shaken:
            say(f"budget: {shaken} runs of the non-linear plant")
            simulated = simulated_budget(job, controllers, shaken, seed=job.seed, threads=os.cpu_count() or 1)
            budget = replaced(budget, {"results": by_simulation(budget.results, simulated)})
    for manoeuvre in job.manoeuvres if complete else ():
        say(f"simulated run: {manoeuvre.name}")
        runs.append(simulate_manoeuvre(job, manoeuvre, controllers))
    requirements = [*_not_found(outcomes)]
    for outcome in loops:
        design = outcome.closed
        certified = proofs[design.loop, design.name].results(design.loop, design.name, "decoupled")
        requirements += [*_noted(design.results, proofs[design.loop, design.name]), *certified]
    if coupled is not None:
        requirements += [*_noted(coupled.results, together), *together.results(ALL_LOOPS, "", "coupled")]
        requirements += unstable_results(job) if budget is None else budget.results
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
        budget=budget,
        simulated_budget=simulated,
        failed=tuple(one for outcome in outcomes for one in outcome.failed),
    )


def _not_found(outcomes: Sequence[LoopOutcome]) -> Iterator[CheckResult]:
    """Walk a result that is missed for each design that a loop uses and that was not found."""
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
