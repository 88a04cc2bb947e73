"""The figures of a job, whether they have a limit or not, and a baseline: figures that were accepted, as values."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.loop_metrics import ALWAYS_MEASURED
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.analysis.metrics import COUPLED_METRICS, METRICS, Quantity
from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import input_value, value
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.judging import CheckResult, Sense
from platform_ctrl.job.requirements import SCOPE_WORDS, SCOPES
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.coupled import ALL_LOOPS, CoupledCheck
from platform_ctrl.verification.simulated import Run, largest

# The same loop on another machine: what differs by less has not changed, and its text stays as it is.
_ROUNDING = 1e-6
_GOAL = "goal: "


@value
class Figure:
    """A measured figure of a job.

    Attributes
    ----------
    subject
        Loop, manoeuvre, or ``all loops closed``.
    name
        The name that a requirement on it has.
    value
        As measured, in `unit`; not finite where there is none (the loop is unstable, the run diverged).
    unit
        SI, and Hz for bandwidths; empty for a plain number.
    sense
        ``"at least"``: more is better; ``"at most"``: less is better.
    limit
        The limit in the job, in `unit`; None without one.
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


@input_value
class Tolerance:
    """How much worse a figure may become: the larger of a share of the accepted value and a plain number.

    Attributes
    ----------
    relative
        Share of the accepted value's magnitude.
    absolute
        In the figure's unit.

    Raises
    ------
    ArgumentError
        A number that is not finite, or below zero.
    """

    relative: float = 0.02
    absolute: float = 1e-12

    def __post_init__(self) -> None:
        positive("Tolerance: relative", self.relative, zero=True)
        positive("Tolerance: absolute", self.absolute, zero=True)

    @check_arguments
    def allowed(self, accepted: float) -> float:
        """Return how much worse a figure of an accepted value may be, in its unit."""
        return max(self.relative * abs(accepted), self.absolute)


# What a new figure is given where the default would be wrong: a difference of two margins, each with a tolerance of its
# own, lies near zero.
_OWN_TOLERANCE = {
    COUPLED_METRICS["coupling cost"].name: Tolerance(relative=0.0, absolute=0.01),
}


@value
class AcceptedFigure(Figure):
    """A figure of a baseline; its `value` is infinite where the file has ``null``."""

    tolerance: Tolerance | None = None  # None: the baseline's


@value
class LoopMatrices:
    """A closed loop as it was accepted: what its curves are drawn from.

    Attributes
    ----------
    loop, design, method
        As in the job.
    delay
        From sample to torque, s.
    controller
        u = K y, sampled.
    inputs, outputs
        Names of the controller's signals.
    plant
        The nominal sampled plant, from `outputs` to `inputs`; None for a loop that is checked in the coupled system
        alone.
    """

    loop: str
    design: str
    method: str
    delay: float
    controller: StateArrays
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    plant: StateArrays | None

    @check_arguments
    def agrees(self, other: LoopMatrices) -> bool:
        """Return whether plant and controller agree to a millionth of each matrix's largest number."""
        return self.same_controller(other) and self.same_plant(other)

    @check_arguments
    def same_controller(self, other: LoopMatrices) -> bool:
        """Return whether the controllers agree likewise."""
        signals = (self.inputs, self.outputs) == (other.inputs, other.outputs)
        timing = math.isclose(self.delay, other.delay, rel_tol=_ROUNDING, abs_tol=1e-15)
        return signals and timing and _near(self.controller, other.controller)

    @check_arguments
    def same_plant(self, other: LoopMatrices) -> bool:
        """Return whether the plants agree likewise."""
        if self.plant is None or other.plant is None:
            return self.plant is other.plant
        return _near(self.plant, other.plant)


@value
class Baseline:
    """Figures of a job that were accepted.

    Attributes
    ----------
    job
        Title of the job.
    tolerance
        Of every figure without a separate one.
    figures
        Each subject and name once.
    loops
        The closed loops that they were measured on.
    """

    job: str
    tolerance: Tolerance
    figures: tuple[AcceptedFigure, ...]
    loops: tuple[LoopMatrices, ...]


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
    required: dict[str, list[CheckResult]] = {name: [] for name in (*loops, ALL_LOOPS, *runs)}
    for one in result.requirements:
        required.setdefault(one.subject, []).append(one)
    for subject, requirements in required.items():
        yield from map(_judged, requirements)
        if subject in loops:
            yield from _goals(loops[subject])
            yield from _measured(loops[subject])
        elif subject == ALL_LOOPS and result.coupled is not None:
            yield from _coupled(result.coupled)
        elif subject in runs:
            yield from _of_run(result, runs[subject])


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
                values = metric.in_unit(measures.values(MetricRequest(kind=kind, over=groups)))
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


def _of_run(result: JobResult, run: Run) -> Iterator[Figure]:
    job, manoeuvre = result.job, run.manoeuvre
    for key, (number, _) in largest(job, manoeuvre, run.trajectory).items():
        if key == "attitude" and manoeuvre.mode == "caged":
            continue  # prescribed
        if key == "torque_share" and all(torquer.limit is None for torquer in job.platform.torquers):
            continue
        yield _figure(manoeuvre.name, RUN_METRICS[key], number, RUN_METRICS[key].name)


@check_arguments
def accepted(result: JobResult, before: Baseline | None = None) -> Baseline:
    """Return the baseline that accepts `result` as it is.

    Parameters
    ----------
    result
        From `verification.check_job`.
    before
        What was accepted until now: its tolerances stay, and so does every number that has changed by rounding alone.

    Returns
    -------
    Baseline
        With the figures of `result`, in their order; those that `before` alone has are left out.
    """
    known = {} if before is None else {figure.key: figure for figure in before.figures}
    loops = {} if before is None else {loop.loop: loop for loop in before.loops}
    now = [_kept(loop, loops.get(loop.loop)) for loop in loops_of(result)]
    return Baseline(
        job=result.job.name,
        tolerance=Tolerance() if before is None else before.tolerance,
        figures=tuple(_accepted(figure, known.get(figure.key)) for figure in figures_of(result)),
        loops=tuple(now),
    )


def loops_of(result: JobResult) -> tuple[LoopMatrices, ...]:
    """Return the closed loops of a job."""
    out = []
    for outcome in result.loops:
        design = outcome.closed
        K, plants = design.controller, design.plants
        if plants is None:
            plant, arrays = None, state_arrays(K, "controller")
            inputs, outputs = tuple(K.input_labels), tuple(K.output_labels)
        else:
            plant = plants.arrays.at(0)
            arrays, inputs, outputs = plants.joined(K), plants.angles, plants.torques
        out.append(
            LoopMatrices(
                loop=design.loop,
                design=design.name,
                method=design.method,
                delay=result.job.sampling.delay,
                controller=arrays,
                inputs=inputs,
                outputs=outputs,
                plant=plant,
            )
        )
    return tuple(out)


def _accepted(figure: Figure, before: AcceptedFigure | None) -> AcceptedFigure:
    number = float(f"{figure.value:.9g}") if math.isfinite(figure.value) else math.inf
    if before is not None and math.isclose(before.value, number, rel_tol=_ROUNDING, abs_tol=1e-15):
        number = before.value
    return AcceptedFigure(
        subject=figure.subject,
        name=figure.name,
        value=number,
        unit=figure.unit,
        sense=figure.sense,
        tolerance=_OWN_TOLERANCE.get(figure.name) if before is None else before.tolerance,
    )


def _kept(now: LoopMatrices, before: LoopMatrices | None) -> LoopMatrices:
    if before is None or not before.agrees(now):
        return now
    return before if (before.design, before.method) == (now.design, now.method) else now


def _near(one: StateArrays, other: StateArrays) -> bool:
    pairs: list[tuple[Any, Any]] = [(getattr(one, name), getattr(other, name)) for name in "ABCD"]
    return math.isclose(one.dt, other.dt, rel_tol=_ROUNDING) and all(
        a.shape == b.shape and bool(np.all(np.abs(a - b) <= _ROUNDING * np.abs(b).max(initial=0.0))) for a, b in pairs
    )
