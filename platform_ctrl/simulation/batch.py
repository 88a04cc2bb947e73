"""Many scenarios at once: those that are alike are computed side by side, and only their metrics are kept.

The kernel is compiled once an installation: this takes a while, beside other work in its own process.
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.interconnection import COMMAND, interconnected_by_sample
from platform_ctrl.analysis.metrics import RUN_METRICS, attenuation_db
from platform_ctrl.common.arguments import whole
from platform_ctrl.common.processes import run_interruptibly
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, SimulationError
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.sensors import LOS_ANGLES, LOS_RATES
from platform_ctrl.simulation import run_plan as plans
from platform_ctrl.simulation.kernel.arrays import widths_of_metrics
from platform_ctrl.simulation.packing import sight_of
from platform_ctrl.simulation.scenarios import commanded_readings, expect_several, steps

if TYPE_CHECKING:
    import control

_NO_RECORD = np.zeros((0, 0))


@value
class BatchResult:
    """The metrics of N runs, over the sample instants until they ended.

    Attributes
    ----------
    angle : (N, n)
        Largest |q| of every gimbal, rad.
    attitude : (N, 3)
        Largest component of the platform's rotation vector against inertial axes, rad.
    torque_share : (N, torquers)
        Largest commanded torque as a share of the torquer's limit, or of what a motor's supply leaves at its rate.
    saturated : (N, torquers)
        Number of samples whose command reached the limit.
    stop_contacts : (N, n)
        How often each gimbal came up against a stop.
    samples : (N,)
        Number of samples before the run ended or diverged.
    gimbal_rate : (N, n)
        Largest |q̇| of every gimbal, rad/s.
    settled : (N,)
        Number of samples from the scenario's `settle` on, over which the means and rms below are taken. All of these
        are of plants with a line of sight: others have no samples and no columns.
    Omega_rms : (N, axes)
        Platform rate: rms about its mean, rad/s.
    line_of_sight_mean, line_of_sight_rms : (N, outputs)
        Line of sight: mean, and rms about it, of ``los_rate1``, ``los_rate2``, ``los_roll_rate``, rad/s, and of
        ``los_angle1``, ``los_angle2``, ``los_roll``, rad.
    following_error : (N, readings)
        Largest |reading − command| from `settle` on, without the sensor's bias, scale error and faults, rad or rad/s; 0
        where nothing is commanded.
    units
        Units of the readings by their names, in the order of these columns.
    requested : (N,)
        Number of samples of a complete run.
    period
        Sample period, s.
    """

    angle: FloatArray
    attitude: FloatArray
    torque_share: FloatArray
    saturated: NDArray[np.int64]
    stop_contacts: NDArray[np.int64]
    samples: NDArray[np.int64]
    requested: NDArray[np.int64]
    gimbal_rate: FloatArray
    settled: NDArray[np.int64]
    Omega_rms: FloatArray
    line_of_sight_mean: FloatArray
    line_of_sight_rms: FloatArray
    following_error: FloatArray
    units: dict[str, str]
    period: float

    @property
    def completed(self) -> NDArray[np.bool_]:
        """Which runs reached their ends, (N,)."""
        return np.asarray(self.samples == self.requested)

    @property
    def ended(self) -> tuple[str, ...]:
        """How each run ended."""
        return tuple(
            "completed" if done == requested else f"diverged at t = {done * self.period:.6g} s"
            for done, requested in zip(self.samples.tolist(), self.requested.tolist(), strict=True)
        )

    @property
    def angle_following_error(self) -> FloatArray:
        """The following errors of the readings of angles (N, k), rad."""
        return self.following_error[:, [unit == "rad" for unit in self.units.values()]]

    @property
    def rate_following_error(self) -> FloatArray:
        """The following errors of the readings of rates (N, k), rad/s."""
        return self.following_error[:, [unit == "rad/s" for unit in self.units.values()]]


def run_values(key: str, result: BatchResult, scenarios: Sequence[Scenario]) -> tuple[FloatArray, list[str]]:
    """Return a metric of runs by its key in `RUN_METRICS`, the worst of its signals.

    Parameters
    ----------
    key
        Of the metric.
    result, scenarios
        The N runs, as of `simulate_batch`.

    Returns
    -------
    values : (N,)
        In the metric's unit; the worst there is where a run diverged.
    names : N texts
        The signal of which the value is; how the run ended where it diverged.
    """
    values, names = _signals(key, result, scenarios)
    if not names:
        values, names = np.zeros((len(scenarios), 1)), ["none"]
    metric, done = RUN_METRICS[key], result.completed
    worst = values.argmin(axis=1) if metric.sense == "at least" else values.argmax(axis=1)
    found = np.where(done, values[np.arange(len(values)), worst], metric.worst)
    return found, [names[k] if yes else ended for k, yes, ended in zip(worst, done, result.ended, strict=True)]


def _signals(key: str, result: BatchResult, scenarios: Sequence[Scenario]) -> tuple[FloatArray, Sequence[str]]:
    """Return a metric of each of its signals (N, k), and their names."""
    platform, jitter = scenarios[0].platform, result.line_of_sight_rms
    match key:
        case "angle" | "gimbal_rate":
            return getattr(result, key), platform.angle_names
        case "angle_between_stops":
            stopped = [k for k, one in enumerate(platform.gimbals) if one.stops]
            return result.angle[:, stopped], [platform.angle_names[k] for k in stopped]
        case "attitude":
            return result.attitude, ("axis 1", "axis 2", "axis 3")
        case "torque_share":
            return result.torque_share, [torquer.name for torquer in platform.torquers]
        case "angle_following_error" | "rate_following_error":
            of_unit = [name for name, unit in result.units.items() if unit == RUN_METRICS[key].unit]
            return getattr(result, key), of_unit
        case "attenuation_db":
            each = [attenuation_db(result.Omega_rms, jitter[:, [k]]) for k in (0, 1)]
            return np.stack(each, axis=1), LOS_RATES[:2]
        case _:
            # Under a command the mean turns on purpose; without one it is an error like any other.
            commanded = np.array([bool(one.commands) for one in scenarios])[:, None]
            sight = np.where(commanded, jitter, np.hypot(jitter, result.line_of_sight_mean))
            return (sight[:, :2], LOS_RATES[:2]) if key == "los_rate_rms" else (sight[:, 3:5], LOS_ANGLES[:2])


def simulate_batch(
    scenarios: Sequence[Scenario],
    controllers: Sequence[control.StateSpace],
    *,
    period: float,
    step: float = 1e-4,
    noise: bool = True,
    threads: int = 1,
) -> BatchResult:
    """Simulate many scenarios and return their metrics.

    A run's metrics depend on its scenario alone, to the last bit: not on which others are computed beside it, on their
    order or on the number of threads.

    Parameters
    ----------
    scenarios
        The runs; all plants have the same gimbals, torquers and sensors.
    controllers
        As for `simulate`.
    period
        Sample period, s.
    step
        Longest substep, s.
    noise
        Whether the sensors' noise is simulated.
    threads
        Number of threads that share the scenarios.

    Returns
    -------
    BatchResult
        In the order of the scenarios.

    Raises
    ------
    ArgumentError
        As `simulate`; the plants differ in gimbals, torquers or sensors.

    References
    ----------
    R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 7.

    See docs/theory/simulation.md.
    """
    period, longest = steps(period, step)
    threads = whole("threads", threads, 1)
    expect_several("scenarios", scenarios, Scenario)
    expect_several("controllers", controllers)
    members = [plans.prepared_run(scenario, period, longest) for scenario in scenarios]
    if len({_kind(one.scenario.platform) for one in {member.skeleton: member for member in members}.values()}) > 1:
        raise ArgumentError(
            "scenarios: their plants differ in gimbals, torquers or sensors; simulate them one kind at a time"
        )
    # All batches are put together, and with that checked, before the first one is computed.
    batches = _batches(members, controllers, period, noise)
    return _gathered(members, [(places, batch_metrics(batched, threads)) for places, batched in batches], period)


def _gathered(
    members: Sequence[plans.PreparedRun], found: Sequence[tuple[Sequence[int], FloatArray]], period: float
) -> BatchResult:
    """Return the result of runs from the metrics (k, slots) of their batches, each with the places of its k runs."""
    shape = members[0].skeleton if members else None
    n, nu, sight = (shape.at.n, len(shape.targets), len(shape.sight)) if shape else (0, 0, 0)
    widths = widths_of_metrics(n, nu, sight)
    units: dict[str, str] = {}
    for places, _ in found:
        units |= members[places[0]].scenario.units
    rows, errors, names = np.empty((len(members), sum(widths))), np.zeros((len(members), len(units))), [*units]
    for places, metrics in found:
        commanded = [names.index(name) for name in commanded_readings(members[places[0]].scenario)]
        rows[places], errors[np.ix_(places, commanded)] = np.split(metrics, [sum(widths)], axis=1)
    angle, attitude, share, saturated, contacts, samples, rate, settled, mean, squares = np.split(
        rows, np.cumsum(widths[:-1]), axis=1
    )
    rms = np.sqrt(squares / np.maximum(settled, 1.0))
    return BatchResult(
        angle=angle,
        attitude=attitude,
        torque_share=share,
        saturated=np.rint(saturated).astype(np.int64),
        stop_contacts=np.rint(contacts).astype(np.int64),
        samples=np.rint(samples[:, 0]).astype(np.int64),
        requested=np.array([member.timing.samples for member in members], dtype=np.int64),
        gimbal_rate=rate,
        settled=np.rint(settled[:, 0]).astype(np.int64),
        Omega_rms=rms[:, :3],
        line_of_sight_mean=mean[:, 3:],
        line_of_sight_rms=rms[:, 3:],
        following_error=errors,
        units=units,
        period=period,
    )


def _batches(
    members: Sequence[plans.PreparedRun], controllers: Sequence[control.StateSpace], period: float, noise: bool
) -> list[tuple[list[int], plans.Batch]]:
    """Return the batches of scenarios that are computed side by side, each with the places of its scenarios."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for place, member in enumerate(members):
        groups.setdefault(member.key, []).append(place)
    modes: dict[tuple[object, ...], plans.ControllerRows] = {}

    def put_together(places: list[int]) -> plans.Batch:
        own = [members[place] for place in places]
        scenario = own[0].scenario
        commanded = commanded_readings(scenario)
        limited = tuple(torquer.limit is None for torquer in scenario.platform.torquers)
        weights = tuple(tuple(one.weights.items()) for one in scenario.drives)
        kind = scenario.mode, commanded, limited, weights, (*scenario.units,)
        if kind not in modes:
            modes[kind] = merged_controller(scenario, controllers, period)
        return plans.batch(own, modes[kind], period, noise)

    return [(places, put_together(places)) for places in groups.values()]


def _kind(platform: Platform) -> tuple[object, ...]:
    """Return the names of all columns of metrics and signals of controllers."""
    return (
        platform.gimbal_names,
        tuple((t.name, t.gimbal, t.root_axis) for t in platform.torquers),
        tuple(s.name for s in platform.sensors),
        sight_of(platform),
    )


def merged_controller(
    scenario: Scenario, controllers: Sequence[control.StateSpace], period: float
) -> plans.ControllerRows:
    """Return one state space from all readings, and commands of some, to all torquers, in the kernel's form.

    Where Omega is prescribed controllers that act on the root are left out. Behind it are the rates of drives. The last
    inputs are the excesses of the torques over their limits, if there are limits.
    """
    platform = scenario.platform
    roots = set(platform.root_torquers) if scenario.mode != "stabilised" else set()
    # Anything that is no controller stays: `interconnected_by_sample` refuses it.
    active = [K for K in controllers if not roots & set(getattr(K, "output_labels", ()))]
    readings, torquers = [*scenario.units], [t.name for t in platform.torquers]
    commands = [f"{name}{COMMAND}" for name in commanded_readings(scenario)]
    taken = {name for system in active for name in system.input_labels}
    useless = [name.removesuffix(COMMAND) for name in commands if name not in taken]
    if useless:
        words = f"commands: no controller takes a command of {useless[0]!r}"
        raise ArgumentError(f"{words}; design the loop that reads it again, in a job whose manoeuvre commands it")
    limited = [t.name for t in platform.torquers if t.limit is not None]
    by_sample = interconnected_by_sample(active, [*readings, *commands], torquers, period, limited)
    rates = np.zeros((len(scenario.drives), by_sample[0].B.shape[1]))
    for row, one in zip(rates, scenario.drives, strict=True):
        row[: len(readings)] = [one.weights.get(name, 0.0) for name in readings]
    return plans.controller_rows(by_sample, rates)


def batch_metrics(batched: plans.Batch, threads: int = 1, record: FloatArray = _NO_RECORD) -> FloatArray:
    """Return the metrics (N, slots) of a batch; of a single run its samples are written into the rows of `record`."""
    from platform_ctrl.common.simd import LANES, memory
    from platform_ctrl.simulation.kernel.loop import simulate_groups

    while _compiling:  # in another process, which leaves what this one needs
        _compiling.pop().wait()
    runs = len(batched.given)
    groups = math.ceil(runs / LANES)
    # The last group is filled up with scenarios that are repeated.
    padded = np.minimum(np.arange(groups * LANES), runs - 1)

    def by_group(rows: FloatArray) -> FloatArray:
        return np.ascontiguousarray(rows[padded].reshape(groups, LANES, -1).transpose(0, 2, 1))

    plants, given = by_group(batched.plants), by_group(batched.given)
    keys = batched.keys[padded].reshape(groups, LANES, 2)
    slots = batched.layout.end - batched.layout.metrics
    metrics = np.empty((groups, slots, LANES))
    share = math.ceil(groups / threads)

    def move(first: int) -> None:
        part = slice(first, first + share)
        simulate_groups(
            batched.packed.links,
            batched.shared,
            keys[part],
            memory(batched.layout.end),
            batched.packed.at,
            batched.layout,
            batched.free,
            plants[part],
            given[part],
            metrics[part],
            record,
        )

    def move_all() -> None:
        with ThreadPoolExecutor(max_workers=threads) as pool:
            list(pool.map(move, range(0, groups, share)))

    run_interruptibly(move_all)
    return metrics.transpose(0, 2, 1).reshape(groups * LANES, slots)[:runs]


def recorded(
    member: plans.PreparedRun, controller: plans.ControllerRows, period: float, noise: bool
) -> tuple[FloatArray, BatchResult]:
    """Simulate one scenario alone; return its record, a row a sample, and its metrics."""
    batched = plans.batch([member], controller, period, noise)
    at, shared = batched.packed.at, batched.shared
    # q, rates, Omega, p, attitude, readings, commands, torques, servo rotors' spins and torques, line of sight.
    resolved = batched.layout.readings - batched.layout.sensors
    columns = 3 * at.n + 7 + len(shared.sensors) + resolved + 2 * len(shared.targets) + 2 * at.servos
    samples = batched.layout.samples
    try:
        record = np.zeros((samples, columns))
    except MemoryError:
        takes = f"the record of {samples} samples takes {samples * columns * 8 / 1e9:.3g} GB"
        raise SimulationError(f"{takes}, more memory than there is; simulate a shorter run") from None
    return record, _gathered([member], [([0], batch_metrics(batched, record=record))], period)


def compile_kernel() -> None:
    """Simulate one scenario for an instant, for which the kernel is compiled or taken from its cache."""
    from platform_ctrl.plant.reading import read_platform

    platform = read_platform("gimballed_gyro")
    simulate_batch([Scenario(platform=platform, mode="caged", duration=0.0, delay=0.0)], [], period=1e-3)


# By the paths of this process, for there may be another checkout in the working directory; it ends without clearing up.
_SOURCE = """
import os, sys
sys.path[:] = {paths!r}
from platform_ctrl.common.processes import collect_seldom
collect_seldom()
from platform_ctrl.simulation.batch import compile_kernel
compile_kernel()
os._exit(0)
"""
_compiling: list[subprocess.Popen[bytes]] = []


def start_compilation() -> None:
    """Begin to compile what designs, runs and the coupled check need, unless the kernel has been or is being compiled.

    The other process keeps what it has compiled where this one will look for it. If it fails, nothing is lost but time.
    """
    if _compiling or is_compiled():
        return
    command = [sys.executable, "-P", "-c", _SOURCE.format(paths=sys.path)]
    quiet = subprocess.DEVNULL
    try:
        _compiling.append(subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet))
    except OSError:
        return


def is_compiled() -> bool:
    """Return whether the kernel has been compiled in this installation.

    By the name that numba gives its index files, which is not documented: loading numba to ask would take longer than
    what this is for. A test fails when the name changes.
    """
    return any((Path(__file__).parent / "kernel" / "__pycache__").glob("loop.simulate_groups*.nbi"))
