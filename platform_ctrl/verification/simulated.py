"""Runs of the exact non-linear plant with sampled controllers, limits, stops and noise: manoeuvres, and the budget.

For the line of sight's budget the sources are sums of sines with random phases, the sensors' noise and quantisation as
in every run; bearings slide and stick, drives feed friction forward. The motion rises from rest, before the run is
observed: a base that had its rate at once would be a step, which saturates motors. A run that is observed for T shows
the rms about its mean, which is what the linear budget has as smear and jitter within an exposure T, from the same
sources.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.metrics import RUN_METRICS, run_metrics
from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.common.arguments import positive, whole
from platform_ctrl.common.processes import processors
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import moves_freely
from platform_ctrl.errors import SimulationError
from platform_ctrl.job.budget import BudgetLimits, BudgetSpec, Source
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult, Requirement
from platform_ctrl.job.manoeuvre import Manoeuvre
from platform_ctrl.job.resolve import KEYHOLE
from platform_ctrl.job.scenario import SOURCE_KIND, Scenario, Sine, Vibration
from platform_ctrl.simulation import simulate
from platform_ctrl.simulation.batch import run_values, simulate_batch
from platform_ctrl.simulation.closed_loop import Trajectory
from platform_ctrl.simulation.scenarios import equilibrium_torques
from platform_ctrl.simulation.step_limit import longest_step
from platform_ctrl.verification.budget import expect_budget, line_of_sight_budget
from platform_ctrl.verification.budget_result import SimulatedBudget

# Window over which a state is counted: fewest samples, and share of a run. Share of a run, up to its end, over which a
# state counts as permanent.
_FEWEST, _WINDOW, _REST = 20, 0.02, 0.1
# Longest substep, s: shorter where springs, cages or friction need it, but never shorter than the second.
_STEP, _SHORTEST = 1e-4, 1e-6
# Samples of a run, about, at which it is asked whether it comes near a keyhole.
_LOOKS = 500


@value
class Run:
    """A simulated manoeuvre.

    Attributes
    ----------
    manoeuvre
        As in the job.
    trajectory
        The run, sample by sample.
    results
        The metrics of the run compared with the limits of the manoeuvre.
    largest
        Metrics of the run by the names of limits: value, in the unit of its limit, and the signal that it is of.
    lost
        When the run diverged, or from when on a torquer stays at its limit or a gimbal beyond half a turn; empty where
        none of this happens.
    """

    manoeuvre: Manoeuvre
    trajectory: Trajectory
    results: tuple[CheckResult, ...]
    largest: dict[str, tuple[float, str]] = field(default_factory=dict)
    lost: str = ""


def simulate_manoeuvre(job: Job, manoeuvre: Manoeuvre, controllers: Sequence[StateSpace]) -> Run:
    """Run one manoeuvre: caged with the caging loops alone and Omega prescribed, stabilised with all loops."""
    scenario = job.scenario(manoeuvre)
    step = max(min(_STEP, longest_step(job.platform, manoeuvre.mode == "stabilised")), _SHORTEST)
    trajectory = simulate(scenario, controllers, period=job.sampling.period, step=step)
    return run_of(job, manoeuvre, trajectory)


def run_of(job: Job, manoeuvre: Manoeuvre, trajectory: Trajectory) -> Run:
    """Return a trajectory as a run of a manoeuvre, with its verdicts."""
    found, lost = {}, _lost(job, trajectory)
    for key in run_metrics([manoeuvre.limits]):
        [worst], [signal] = run_values(key, trajectory.metrics, [job.scenario(manoeuvre)])
        found[key] = float(worst), signal
    results = _judged(job, manoeuvre, trajectory, found, lost)
    return Run(manoeuvre=manoeuvre, trajectory=trajectory, results=results, largest=found, lost=lost)


def _lost(job: Job, trajectory: Trajectory) -> str:
    """Return when a run diverged, or from when on a torquer stays at its limit or a gimbal beyond half a turn."""
    if not trajectory.completed:
        return trajectory.ended
    # Wheels that turn the root run on.
    wheels = {name for spec in job.loops if spec.moves_root(job.platform) for name in spec.gimbals}
    endless = [one.name in wheels and one.stops is None for one in job.platform.gimbals]
    parts = (
        (trajectory.torquer_names, np.abs(trajectory.command) >= _reach(job, trajectory), "at its limit"),
        (
            trajectory.angle_names,
            (np.abs(trajectory.q) > math.pi) & ~np.array(endless, dtype=bool),
            "beyond half a turn",
        ),
    )
    for names, there, words in parts:
        since = [_for_good(column) for column in there.T]
        found = [
            f"{name} {words} from t = {trajectory.t[k]:.4g} s on"
            for name, k in zip(names, since, strict=True)
            if k is not None
        ]
        if found:
            return ", ".join(found)
    return ""


def _reach(job: Job, trajectory: Trajectory) -> FloatArray:
    """Return the torque that each torquer has at each sample in the direction of its command, N m.

    The supply of a motor leaves less of it the faster the motor turns that way, at last nothing.
    """
    out = np.full(trajectory.command.shape, np.inf)
    for k, one in enumerate(job.platform.torquers):
        if one.limit is not None:
            out[:, k] = one.limit
        if one.limit is not None and one.gimbal is not None and one.stall is not None:
            turning = np.sign(trajectory.command[:, k]) * trajectory.rate[:, job.platform.gimbal(one.gimbal)]
            out[:, k] = np.clip(one.stall - one.back_emf * turning, 1e-9 * one.limit, one.limit)
    return out


def _for_good(there: NDArray[np.bool_]) -> int | None:
    """Return the first sample from which on something is there more often than not, to the end; None without one."""
    size = max(_FEWEST, round(_WINDOW * len(there)))
    if len(there) < size:
        return None
    sums = np.concatenate([[0], np.cumsum(there)])
    rarely = np.flatnonzero(2 * (sums[size:] - sums[:-size]) < size)
    begin = int(rarely[-1]) + 1 if len(rarely) else 0
    first = begin + int(np.argmax(there[begin:])) if begin < len(there) and there[begin:].any() else len(there)
    return first if len(there) - first >= _REST * len(there) else None


def _judged(
    job: Job, manoeuvre: Manoeuvre, trajectory: Trajectory, found: dict[str, tuple[float, str]], lost: str
) -> tuple[CheckResult, ...]:
    """Compare a run with the limits of its manoeuvre; one that diverges fails without limits too."""
    out = []
    if not trajectory.completed and not manoeuvre.limits:
        completed = Requirement(name="share of the run that was simulated", limit=1.0, unit="", sense="at least")
        share = len(trajectory.t) * trajectory.period / manoeuvre.duration
        out.append(completed.judge(share, subject=manoeuvre.name, stage="simulated", evidence=trajectory.ended))
    shown = trajectory.q[:: max(len(trajectory.q) // _LOOKS, 1)]
    near = any(law.limited(q) for law in job.resolvers for q in shown)
    carried = manoeuvre.mode == "caged" and job.platform.mode in ("floating", "pivot")
    for key, limit in manoeuvre.limits.items():
        metric, (number, signal) = RUN_METRICS[key], found[key]
        evidence = (
            f"{signal}; non-linear plant{_start(job, manoeuvre)}, {trajectory.ended}, seed {trajectory.seed}, "
            f"substep {trajectory.step:g} s"
        ) + ("; with dry friction" if job.platform.dry_frictions else "")
        evidence += f"; the rate of {job.platform.root_name} is prescribed" if carried else ""
        evidence += f"; {KEYHOLE} on the way" if near else ""
        wanted = Requirement.of(metric, limit)
        result = wanted.judge(number, subject=manoeuvre.name, stage="simulated", evidence=evidence)
        reasons = (lost, _filter_words(job, signal) if metric.commanded and not lost else "")
        out.append(result if result.passed else result.because("; ".join(filter(None, reasons))))
    return (*out, *_heat(job, manoeuvre, trajectory))


def _heat(job: Job, manoeuvre: Manoeuvre, trajectory: Trajectory) -> Iterator[CheckResult]:
    """Yield the rms current of each motor of which the plant says what it bears, over that.

    A run from equilibrium begins as warm as the current that holds it makes the motor.
    """
    from scipy.signal import lfilter

    for motor in job.platform.motors:
        if motor.continuous_current is not None:
            place, over = trajectory.torquer_names.index(motor.name), "over the run"
            heat = (trajectory.torque[:, place] / motor.per_ampere) ** 2
            square = float(np.mean(heat))
            if motor.thermal_time is not None:
                kept, warm = math.exp(-trajectory.period / motor.thermal_time), 0.0
                if manoeuvre.start == "equilibrium":
                    warm = (equilibrium_torques(job.scenario(manoeuvre))[place] / motor.per_ampere) ** 2
                square = float(lfilter([1.0 - kept], [1.0, -kept], heat, zi=[kept * warm])[0].max())
                over = f"over {motor.thermal_time:g} s, at its largest"
            rms = math.sqrt(square)
            words = f"motor {motor.name}: {rms:.3g} A rms {over}, it bears {motor.continuous_current:.3g} A"
            name = f"rms current of {motor.name} over its continuous one"
            wanted = Requirement(name=name, limit=1.0, unit="", sense="at most")
            share = rms / motor.continuous_current
            found = wanted.judge(share, subject=manoeuvre.name, stage="simulated", evidence=words)
            yield found if found.passed else found.because("take a larger motor or gear, or let it cool")


def _filter_words(job: Job, reading: str) -> str:
    """Name the reference filter behind which a commanded reading is."""
    for spec in job.loops:
        shaping = spec.closed.command
        if shaping is not None and reading in job.readings_of(spec.read_by(spec.closed)):
            hz = shaping.filter_hz
            return (
                f"behind the reference filter of {spec.name} (filter_hz = {hz:g}), which smooths steps and corners "
                f"over {1.0 / (math.pi * hz):.3g} s"
            )
    return ""


def _start(job: Job, manoeuvre: Manoeuvre) -> str:
    """Return the assumptions of a run that begins in equilibrium."""
    if manoeuvre.start == "rest":
        return ""
    held = equilibrium_torques(job.scenario(manoeuvre))
    torques = ", ".join(f"{t.name} {Q:.3g} N m" for t, Q in zip(job.platform.torquers, held, strict=True) if Q)
    return f" from equilibrium, held by constant torques besides the controllers' ({torques or 'none is needed'})"


# Sines to a density, and points to a decade of its table.
_LINES, _PER_DECADE = 96, 40
# Share of the time to settle in which the motion rises.
_RISING = 0.5
# Probability of the intervals.
_CONFIDENCE = 0.95
_KINDS = {source: kind for kind, source in SOURCE_KIND.items()}


def simulated_budget(
    job: Job,
    controllers: Sequence[StateSpace],
    runs: int,
    *,
    seed: int = 0,
    time: float | None = None,
) -> SimulatedBudget:
    """Simulate the sources of a job's budget on the non-linear plant, on all processors.

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
    free = moves_freely(job, controllers)
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
            resolvers=job.resolvers,
            start="equilibrium",
            seed=seed,
            run=k,
            settle=length,
            fade=_RISING * length,
        )
        for k in range(runs)
    ]
    same = dataclasses.replace(
        budget, correlations=(), limits=BudgetLimits(), exposure=(length,), spatial_frequencies=()
    )
    at_rest = dataclasses.replace(job, budget=same, angles={})
    linear = line_of_sight_budget(at_rest, controllers).windows[0].about_mean
    found = simulate_batch(scenarios, controllers, period=job.sampling.period, threads=processors())
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
        left_out=tuple(
            words
            for words, has in (
                ("correlations: the sources of a run are independent", budget.correlations),
                ("turning: gimbals are at rest but for what the sources do", budget.turning),
            )
            if has
        ),
    )


def _vibrations(source: Source, budget: BudgetSpec) -> list[Vibration]:
    """Return a source's density within the band as a sum of sines."""
    knots = source.spectrum.within(budget.from_hz, budget.to_hz)
    if not knots.size:
        return []
    low, high = map(float, knots[[0, -1]])
    grid = np.geomspace(low, high, max(2, math.ceil(_PER_DECADE * math.log10(high / low))))
    f = np.unique(np.concatenate([grid[1:-1], knots]))
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
