"""The figures of a job: everything that can become better or worse, whether a limit is set on it or not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.judging import CheckResult, Sense
from platform_ctrl.job.requirements import FAULTS, SCOPE_WORDS, WORST_CASE
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.coupled import ALL_LOOPS, MARGIN, CoupledCheck
from platform_ctrl.verification.simulated import RUN_FIGURES, Run, largest

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

    All requirements and goals; and, whether or not anything is asked of them, of every caging loop bandwidth, disk
    margin, damping and torque noise, the worst disk margin and damping, worst case and with a fault; of all loops
    together the simultaneous disk margin, and disk margin and torque noise of every torquer; of every run the largest
    angles and the largest share of a torquer's limit. They belong to the closed designs: the name of a design is no
    part of them.
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
    bandwidth = measures.bandwidth / (2.0 * np.pi)
    yield Figure(subject=subject, name="bandwidth", value=bandwidth, unit="Hz", sense="at least")
    yield _least(subject, "disk margin", measures.disk_margin[0])
    yield _least(subject, "damping", measures.damping[0])
    noise = float(measures.torque_noise.max())
    yield Figure(subject=subject, name="torque noise, rms", value=noise, unit="N m", sense="at most")
    for groups, words in ((WORST_CASE, SCOPE_WORDS["worst_case"]), (FAULTS, SCOPE_WORDS["faults"])):
        plants = measures.of(groups)
        if plants.sum() > 1:
            yield _least(subject, f"disk margin{words}", measures.disk_margin[plants].min())
            yield _least(subject, f"damping{words}", measures.damping[plants].min())


def _least(subject: str, name: str, number: float) -> Figure:
    return Figure(subject=subject, name=name, value=float(number), unit="", sense="at least")


def _coupled(check: CoupledCheck) -> Iterator[Figure]:
    yield _least(ALL_LOOPS, MARGIN, check.simultaneous.guaranteed)
    for torquer, margin in zip(check.channels, check.coupled, strict=True):
        yield _least(ALL_LOOPS, f"disk margin, {torquer}", margin)
    for torquer, noise in zip(check.channels, check.torque_noise, strict=True):
        yield Figure(
            subject=ALL_LOOPS, name=f"torque noise, {torquer}", value=float(noise), unit="N m", sense="at most"
        )


def _flown(result: JobResult, run: Run) -> Iterator[Figure]:
    job, manoeuvre = result.job, run.manoeuvre
    for key, (number, _) in largest(job, run.trajectory).items():
        if key == "attitude" and manoeuvre.mode == "caged":
            continue  # prescribed
        if key == "torque_share" and all(torquer.limit is None for torquer in job.platform.torquers):
            continue
        name, unit = RUN_FIGURES[key]
        yield Figure(subject=manoeuvre.name, name=name, value=number, unit=unit, sense="at most")
