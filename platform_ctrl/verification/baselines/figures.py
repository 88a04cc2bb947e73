"""The figures of a job: everything that can become better or worse, whether a limit is set on it or not."""

from __future__ import annotations

from collections.abc import Iterator

from platform_ctrl.analysis.loop_metrics import ALWAYS_MEASURED
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.analysis.metrics import COUPLED_METRICS, METRICS, RUN_METRICS, Quantity
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.judging import CheckResult, Sense
from platform_ctrl.job.requirements import SCOPE_WORDS, SCOPES
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.coupled import ALL_LOOPS, CoupledCheck
from platform_ctrl.verification.simulated import Run, largest

_GOAL = "goal: "


@value
class Figure:
    """A measured figure of a job.

    Attributes
    ----------
    subject
        Loop, manoeuvre, or ``all loops closed``.
    name
        The figure, in the words of the requirement that would be asked of it.
    value
        As measured, in `unit`; not finite where there is none (the loop is unstable, the run diverged).
    unit
        SI, and Hz for bandwidths; empty for a plain number.
    sense
        ``"at least"``: more is better; ``"at most"``: less is better.
    limit
        What the job asks of it, in `unit`; None where nothing is asked.
    """

    subject: str
    name: str
    value: float
    unit: str
    sense: Sense
    limit: float | None = None

    @property
    def key(self) -> tuple[str, str, str, Sense]:
        """What it is recognised by: a figure in another unit is another figure."""
        return self.subject, self.name, self.unit, self.sense


@check_arguments
def figures_of(result: JobResult) -> tuple[Figure, ...]:
    """Return the figures of a job, each once, in the order loops, all loops closed, manoeuvres.

    All requirements and goals; and, with or without a limit, of every caging loop the metrics that are always measured,
    nominal, worst case and with a fault; of all loops together the simultaneous disk margin, and the disk margin and
    the metrics of every torquer; of every run its `RUN_METRICS`. They are those of the closed designs.
    """
    found: dict[tuple[str, str], Figure] = {}
    for figure in _all(result):
        known = found.get((figure.subject, figure.name))
        if known is None:
            found[figure.subject, figure.name] = figure
    return tuple(found.values())


def _all(result: JobResult) -> Iterator[Figure]:
    """Walk the figures of a job; what a requirement names comes first, what was measured besides may repeat it."""
    loops = {outcome.spec.name: outcome.closed for outcome in result.loops}
    runs = {run.manoeuvre.name: run for run in result.runs}
    asked: dict[str, list[CheckResult]] = {name: [] for name in (*loops, ALL_LOOPS, *runs)}
    for one in result.requirements:
        asked.setdefault(one.subject, []).append(one)
    for subject, requirements in asked.items():
        yield from map(_judged, requirements)
        if subject in loops:
            yield from _goals(loops[subject])
            yield from _measured(loops[subject])
        elif subject == ALL_LOOPS:
            yield from _coupled(result.coupled)
        elif subject in runs:
            yield from _flown(result, runs[subject])


def _judged(one: CheckResult) -> Figure:
    return Figure(subject=one.subject, name=one.name, value=one.value, unit=one.unit, sense=one.sense, limit=one.limit)


def _goals(design: LoopDesign) -> Iterator[Figure]:
    """Walk the goals; one on a figure that a limit is set on too repeats it, unless its band differs."""
    limited = {one.name: one.value for one in design.results}
    for goal in design.goals:
        name = goal.name.removeprefix(_GOAL)
        differs = name in limited and limited[name] != goal.value
        yield Figure(
            subject=goal.subject,
            name=goal.name if differs else name,
            value=goal.value,
            unit=goal.unit,
            sense=goal.sense,
        )


def _measured(design: LoopDesign) -> Iterator[Figure]:
    measures, subject = design.measures, design.loop
    if measures is None:
        return
    for scope, groups in SCOPES.items():
        if scope and measures.of(groups).sum() < 2:
            continue
        for kind in ALWAYS_MEASURED:
            metric = METRICS[kind]
            if scope in metric.scopes:
                values = measures.values(MetricRequest(kind=kind, over=groups)) / metric.scale
                worst = values.min() if metric.sense == "at least" else values.max()
                yield _figure(subject, metric, worst, metric.name + SCOPE_WORDS[scope])


def _figure(subject: str, metric: Quantity, number: float, name: str) -> Figure:
    return Figure(subject=subject, name=name, value=float(number), unit=metric.unit, sense=metric.sense)


def _coupled(check: CoupledCheck) -> Iterator[Figure]:
    simultaneous = COUPLED_METRICS["simultaneous disk margin"]
    yield _figure(ALL_LOOPS, simultaneous, check.simultaneous.guaranteed, simultaneous.name)
    for kind, values in {"disk margin": check.coupled, **check.of_torquers}.items():
        for torquer, number in zip(check.channels, values, strict=True):
            yield _figure(ALL_LOOPS, METRICS[kind], number, f"{kind}, {torquer}")


def _flown(result: JobResult, run: Run) -> Iterator[Figure]:
    job, manoeuvre = result.job, run.manoeuvre
    for key, (number, _) in largest(job, run.trajectory).items():
        if key == "attitude" and manoeuvre.mode == "caged":
            continue  # prescribed
        if key == "torque_share" and all(torquer.limit is None for torquer in job.platform.torquers):
            continue
        yield _figure(manoeuvre.name, RUN_METRICS[key], number, RUN_METRICS[key].name)
