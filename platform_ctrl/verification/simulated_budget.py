"""The line of sight's budget by simulation: runs of the non-linear plant beside the linear value for the same time.

The sources are realised as sums of sines with random phases, the sensors' noise and quantisation as in every run;
bearings slide and stick, drives feed friction forward. The motion rises from rest, before the run is observed: a base
that had its rate at once would be a step, which saturates motors. A run that is observed for T shows the rms about its
mean, which is what the linear budget has as smear and jitter within an exposure T, from the same sources.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.common.arguments import positive, whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import SimulationError
from platform_ctrl.job.budget import BudgetLimits, BudgetSpec, Source
from platform_ctrl.job.job import Job
from platform_ctrl.job.scenario import Scenario, Sine, Vibration
from platform_ctrl.simulation.batch import simulate_batch
from platform_ctrl.verification.budget import expect_budget, line_of_sight_budget
from platform_ctrl.verification.budget_result import across
from platform_ctrl.verification.coupled import acts_on_root

if TYPE_CHECKING:
    import control

    from platform_ctrl.job.scenario import VibrationKind

# Sines to a density, and points to a decade of its table.
_LINES, _PER_DECADE = 96, 40
# Share of the time to settle in which the motion rises.
_RISING = 0.5
# Probability of the intervals.
_CONFIDENCE = 0.95
_KINDS: dict[str, VibrationKind] = {"base-rate": "rate", "specific-force": "force", "torque": "torque"}


@value
class SimulatedBudget:
    """What runs of the non-linear plant show of the line of sight, and the linear budget for the same.

    Attributes
    ----------
    runs, seed
        Number of runs; they are numbered from 0, and their noise and phases are drawn from the seed and the number.
    time, settle
        Length over which the line of sight is observed, after `settle`, s.
    rms, low, high : (3,)
        Rms about the mean within that time, by axis, and its 95 % interval by the spread of the runs, rad.
    linear : (3,)
        The same by the linear budget, rad.
    left_out
        A line for everything that the runs do not have.
    """

    runs: int
    seed: int
    time: float
    settle: float
    rms: FloatArray
    low: FloatArray
    high: FloatArray
    linear: FloatArray
    left_out: tuple[str, ...]

    @property
    def ratio(self) -> float:
        """Simulated over linear rms of both axes across the line of sight together, dimensionless."""
        return across(self.rms) / across(self.linear)


def simulated_budget(
    job: Job,
    controllers: Sequence[control.StateSpace],
    runs: int,
    *,
    seed: int = 0,
    time: float | None = None,
    threads: int = 1,
) -> SimulatedBudget:
    """Simulate the sources of a job's budget on the non-linear plant.

    Parameters
    ----------
    job
        With a budget, and a plant with a line of sight; the gimbals are at zero.
    controllers
        u = K y in the order in which they are computed, with the job's sample period.
    runs
        At least 2.
    seed
        Of phases and noise.
    time
        Length over which each run is observed, s; before that the motion rises
        and the loop settles for as long. Default: a period of the budget's
        lowest frequency.
    threads
        Number of threads that share the runs.

    Returns
    -------
    SimulatedBudget
        With the linear rms about the mean over the same time.

    Raises
    ------
    ArgumentError
        As `line_of_sight_budget`.
    SimulationError
        A run diverged.

    References
    ----------
    M. Shinozuka, Journal of the Acoustical Society of America 49, 1971.
    """
    from scipy.stats import t as student

    budget, runs = expect_budget(job), whole("runs", runs, 2)
    seed = whole("seed", seed, 0)
    length = 1.0 / budget.from_hz if time is None else positive("time", time)
    free = acts_on_root(job, controllers)
    vibrations = tuple(one for source in budget.sources for one in _vibrations(source, budget))
    scenarios = [
        Scenario(
            platform=job.platform,
            mode="stabilised" if free else "caged",
            duration=2.0 * length,
            delay=job.sampling.delay,
            vibrations=vibrations,
            sines=tuple(
                one for source in budget.sources for one in _sines(source, budget, np.random.default_rng([seed, k]))
            ),
            drives=job.drive_laws,
            start="equilibrium",
            seed=seed,
            run=k,
            settle=length,
            fade=_RISING * length,
        )
        for k in range(runs)
    ]
    linear = _linear(job, budget, controllers, length)
    found = simulate_batch(scenarios, controllers, period=job.sampling.period, threads=threads)
    if not found.completed.all():
        k = int(np.argmin(found.completed))
        raise SimulationError(
            f"budget: run {k} of seed {seed} {found.ended[k]}; look at it with a manoeuvre of the job"
        )
    squares = found.line_of_sight_rms[:, 3:] ** 2
    mean = squares.mean(axis=0)
    reach = float(student.ppf(0.5 + 0.5 * _CONFIDENCE, runs - 1)) * squares.std(axis=0, ddof=1) / math.sqrt(runs)
    return SimulatedBudget(
        runs=runs,
        seed=seed,
        time=length,
        settle=length,
        rms=np.sqrt(mean),
        low=np.sqrt(np.maximum(mean - reach, 0.0)),
        high=np.sqrt(mean + reach),
        linear=linear,
        left_out=_left_out(budget),
    )


def _linear(job: Job, budget: BudgetSpec, controllers: Sequence[control.StateSpace], length: float) -> FloatArray:
    """Return the linear rms about the mean within a length of time from sources that are independent, rad."""
    same = dataclasses.replace(
        budget, correlations=(), limits=BudgetLimits(), exposure=(length,), spatial_frequencies=()
    )
    at_rest = dataclasses.replace(job, budget=same, angles={})
    return line_of_sight_budget(at_rest, controllers).windows[0].about_mean


def _vibrations(source: Source, budget: BudgetSpec) -> list[Vibration]:
    """Return a source's density within the band as a sum of sines."""
    knots = source.knots_hz
    if not knots.size or max(budget.from_hz, knots[0]) >= min(budget.to_hz, knots[-1]):
        return []
    low, high = max(budget.from_hz, float(knots[0])), min(budget.to_hz, float(knots[-1]))
    grid = np.geomspace(low, high, max(2, math.ceil(_PER_DECADE * math.log10(high / low))))
    f = np.unique(np.concatenate([grid[1:-1], knots[(knots > low) & (knots < high)], [low, high]]))
    density = source.density(f)
    inside = density > 0.0
    return [
        Vibration(
            kind=_KINDS[source.kind],
            axis=source.axis,
            gimbal=source.gimbal,
            frequencies_hz=f[inside],
            densities=density[inside],
            lines=_LINES,
        )
    ]


def _sines(source: Source, budget: BudgetSpec, rng: np.random.Generator) -> list[Sine]:
    """Return a source's sines within the band; phases that are not given are drawn."""
    lines = source.lines
    drawn = rng.uniform(0.0, 2.0 * math.pi, len(lines.frequencies_hz))
    phases = drawn if lines.phases is None else lines.phases
    return [
        Sine(
            kind=_KINDS[source.kind],
            axis=source.axis,
            gimbal=source.gimbal,
            frequency_hz=float(f),
            amplitude=float(a),
            phase=float(phi),
        )
        for f, a, phi in zip(lines.frequencies_hz, lines.amplitudes, phases, strict=True)
        if budget.from_hz <= f <= budget.to_hz
    ]


def _left_out(budget: BudgetSpec) -> tuple[str, ...]:
    return ("correlations: the sources of a run are independent",) if budget.correlations else ()
