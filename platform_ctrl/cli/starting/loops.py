"""Starting values of the loops of a plant, and runs that excite what they hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.cli.starting.purpose import PlannedLoop, disturbing_axes
from platform_ctrl.common.values import value
from platform_ctrl.job.requirements import WORST_CASE, loop_requirements

if TYPE_CHECKING:
    from platform_ctrl.analysis.plant_set import PlantSet
    from platform_ctrl.design.partition import Channels
    from platform_ctrl.job.job import Job, LoopSpec
    from platform_ctrl.mechanics.linearisation import LinearModel
    from platform_ctrl.plant.platform import Platform, Torquer

# How long the turn's rate rises, s.
RISE = 0.2
# Sample rate over the bandwidth that a loop is to have; slowest and fastest rate that is proposed, Hz.
_SAMPLES, _SLOWEST, _FASTEST = 20.0, 1000.0, 20000.0
# Fastest turn that is proposed, rad/s; share of the torque limits that it may take; rms of noise in the same share.
_TURN, _TURN_SHARE, _NOISE_SHARE = 0.1, 0.3, 0.1
# Rate of the base that shakes a body which is held still, rad/s.
BASE_RATE = 0.5
# Starting values are the method's defaults times this, again and again. They have this much to spare: the tuner's
# reserve, so that it need not move far.
_STEP, _STEPS, _ENOUGH = 0.5, 8, 0.95
# Of a loop without gyros: end of its lead over the crossover.
_ROLLOFF = 10.0
# Phase that lags take at the bandwidth that they leave, rad: of a rate loop, whose steps are finer, the first try.
_PHASE, _RATE_STEP, _RATE_STEPS = 0.8, 0.8, 20
_DISK_MARGIN, _STILL_MARGIN, _LEAST_DISK_MARGIN = 0.3, 0.5, 0.05
# Relative uncertainty of the inertias where a body is held still; largest gimbal angle at which the loops are checked.
_INERTIA, _ANGLE = 0.1, 0.35
# Of the platform servo: its crossover over the caging loops' slowest, and its position corner over its crossover.
_SERVO, _POSITION = 0.1, 0.3
# Angle by which a torque pushes the platform, rad, and the factor from the angle that the linear model gives to the
# limit of the run.
_PUSHED, _SPARE = 0.005, 2.0
# Of the motion of the base: the attenuation is that at this share of the crossover and below; slowest in a run, Hz: it
# has to last for periods.
_LOW, _SLOWEST_MOTION = 0.1, 0.5
# What a job asks for is so much less than the linear model gives, dB: of a loop, and of a run, in which friction is no
# describing function. Factor from the angles that the linear model gives to the limit of a run.
_LINEAR_SPARE, _RUN_SPARE, _ANGLE_SPARE = 1.0, 6.0, 2.0
# Least attenuation that is worth a limit, dB.
_LEAST_ATTENUATION = 3.0


@value
class StartingLoop:
    """A loop with starting values."""

    plan: PlannedLoop  # What it is for
    limits: dict[str, float] = field(default_factory=dict)  # By the keys of the job file
    torque_limit: float | None = None  # The weakest torquer's, N m; None where no torquer has a limit
    method: str = "classical"
    options: dict[str, float] = field(default_factory=dict)  # Of the method


@value
class StartingRun:
    """A run that excites what the loops hold."""

    name: str
    # "turn": the root turns and stops; "motion": it turns to and fro; "step": a torque acts on it
    form: Literal["turn", "motion", "step"]
    axes: tuple[int, ...]  # About which
    size: float  # rad/s, or N m
    frequency_hz: float = 0.0
    balanced: bool = True  # Whether no constant torque is needed at the start
    limits: dict[str, float] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Length, s: of a motion to and fro four periods at least."""
        return max(1.0, 4.0 / self.frequency_hz) if self.frequency_hz else 1.0


@value
class Start:
    """What a job for a plant can start from."""

    rate_hz: float  # Sample rate, Hz
    rate_reason: str  # Why that one
    rate: float  # Largest rate of the root about each axis, rad/s
    angles: dict[str, tuple[float, float]]  # Gimbal angles at which the loops are checked, rad
    inertia: float  # Relative uncertainty; 0: not part of the job
    loops: tuple[StartingLoop, ...]
    runs: tuple[StartingRun, ...]


def starting_loops(plant: dict[str, Any], plans: tuple[PlannedLoop, ...]) -> Start:
    """Return a start for the plant in a file's tables, which has the torquers and sensors of its loops.

    The starting values are the first, from fast to slow, with which a loop is stable and near its limits, or else the
    best: what the tuner finds its way from.
    """
    from platform_ctrl.job.reading import read_job
    from platform_ctrl.mechanics.linearisation import linearise
    from platform_ctrl.mechanics.state_space import state_space
    from platform_ctrl.plant.reading import read_platform

    platform = read_platform(plant)
    model = linearise(platform)
    # What oscillates has to be damped or held; a pole b/J of a damped axis asks nothing of the loop.
    oscillation = float(np.abs(np.linalg.eigvals(state_space(model).A).imag).max(initial=0.0)) / (2.0 * math.pi)
    rate_hz, reason = max(_rate_of(platform, plan, oscillation) for plan in plans)
    axis, turn = safe_turn(model, _limits(platform))
    still = any(plan.still for plan in plans)
    start = Start(
        rate_hz=rate_hz,
        rate_reason=reason,
        rate=BASE_RATE if still else turn,
        angles={name: pair for plan in plans if plan.against == "inertial" for name, pair in _angles(platform, plan)},
        inertia=_INERTIA if still else 0.0,
        loops=(),
        runs=(),
    )
    designed = [plan for plan in plans if plan.kind != "stabilisation"]
    job = read_job(_bare(plant, platform, start, designed))
    found = [_started(job, spec, model, plan) for spec, plan in zip(job.loops, designed, strict=True)]
    loops = [one for one, _ in found]
    if len(designed) < len(plans):
        loops.append(_servo(plans[-1], loops, platform))
    runs = [run for _, run in found if run is not None]
    if any(plan.kind == "caging" for plan in plans):
        runs.insert(0, StartingRun(name="turn", form="turn", axes=(axis,), size=turn, limits={"torque_share": 1.0}))
    if plans[-1].kind == "stabilisation":
        runs.append(_step(platform, model, loops[-1]))
    used = [one for plan in plans for one in _torquers(platform, plan)]
    for k, run in enumerate(runs):
        # A share of a limit that there is not says nothing; caged runs do not use torquers on the root.
        if any(one.limit is None for one in used if run.form == "step" or one.gimbal is not None):
            limits = {key: limit for key, limit in run.limits.items() if key != "torque_share"}
            runs[k] = replace(run, limits=limits)
    return replace(start, loops=tuple(loops), runs=tuple(runs))


def _limits(platform: Platform) -> dict[str, float]:
    return {one.gimbal: one.limit for one in platform.torquers if one.gimbal is not None and one.limit is not None}


def _rate_of(platform: Platform, plan: PlannedLoop, oscillation: float) -> tuple[float, str]:
    """Return the sample rate that a loop needs, Hz, and why: `oscillation` is the plant's fastest, Hz."""
    lag = _lag(platform, plan)
    left = _PHASE / (2.0 * math.pi * lag) if lag > 0.0 else math.inf
    if left < math.inf and (plan.kind != "caging" or left < oscillation):
        bandwidth, reason = (
            left,
            f"torquers and sensors lag by {1e3 * lag:.3g} ms: a few samples",
        )
    else:
        bandwidth = oscillation
        reason = f"the fastest mode of the plant has {oscillation:.3g} Hz" if oscillation > 0.0 else "assumed"
    rate = min(max(rounded(_SAMPLES * bandwidth, up=True), _SLOWEST), _FASTEST)
    given = [sensor.rate_hz for sensor in platform.sensors if sensor.name in plan.sensors and sensor.rate_hz]
    return (min(given), "what its sensors give") if given and min(given) < rate else (rate, reason)


def _lag(platform: Platform, plan: PlannedLoop) -> float:
    """Return how late the torques of a loop come, the computer apart, s."""
    sensors = [sensor for sensor in platform.sensors if sensor.name in plan.sensors]
    late = [
        sensor.delay + (1.0 / (2.0 * math.pi * sensor.bandwidth_hz) if sensor.bandwidth_hz else 0.0)
        for sensor in sensors
    ]
    lags = [torquer.lag for torquer in platform.torquers if torquer.gimbal in plan.gimbals]
    return max(late, default=0.0) + max(lags, default=0.0)


def _angles(platform: Platform, plan: PlannedLoop) -> Iterator[tuple[str, tuple[float, float]]]:
    """Walk the gimbals of a loop inside its outermost one, whose angles change what the torquers do."""
    for name in plan.gimbals[1:]:
        gimbal = platform.gimbals[platform.gimbal(name)]
        low, high = gimbal.stops or (-math.inf, math.inf)
        yield gimbal.angle, (float(f"{max(-_ANGLE, 0.5 * low):.2g}"), float(f"{min(_ANGLE, 0.5 * high):.2g}"))


def _bare(plant: dict[str, Any], platform: Platform, start: Start, plans: list[PlannedLoop]) -> dict[str, Any]:
    return {
        "schema": 2,
        "name": "start",
        "plant": plant,
        "operation": {"Omega": [start.rate] * 3, "angles": {name: list(pair) for name, pair in start.angles.items()}},
        "uncertainty": {"inertia": start.inertia},
        "sampling": {"rate_hz": start.rate_hz, "delay": 1.0 / start.rate_hz},
        "loop": [_bare_loop(platform, plan, str(k)) for k, plan in enumerate(plans)],
    }


def _bare_loop(platform: Platform, plan: PlannedLoop, name: str) -> dict[str, Any]:
    method = "pi" if plan.kind == "rate" else "classical"
    margin = {"disk_margin_worst_case": _STILL_MARGIN} if plan.still else {"disk_margin": _DISK_MARGIN}
    signals = {"sensors": list(plan.sensors)} if plan.sensors else {}
    signals |= {"torquers": list(plan.torquers)} if plan.torquers else {}
    return {
        "name": name,
        "kind": plan.kind,
        "gimbals": list(plan.gimbals),
        **signals,
        "use": method,
        "limits": margin | _noise_limit(platform, plan),
        "design": [{"name": method, "method": method}],
    }


def _noise_limit(platform: Platform, plan: PlannedLoop) -> dict[str, float]:
    weakest = _weakest(platform, plan)
    read = [one for one in platform.sensors if one.name in plan.sensors or not plan.sensors]
    if plan.kind == "caging":
        read = [platform.pickoff_on(name) for name in plan.gimbals]
    if weakest is None or not any(one.noise_rms > 0.0 for one in read):
        return {}
    return {"torque_noise": rounded(_NOISE_SHARE * weakest, up=False)}


def _torquers(platform: Platform, plan: PlannedLoop) -> list[Torquer]:
    """Return the torquers that a loop sets."""
    if plan.kind == "stabilisation":
        return [one for one in platform.torquers if one.root_axis is not None]
    own = plan.torquers or [platform.torquer_on(name).name for name in plan.gimbals]
    return [one for one in platform.torquers if one.name in own]


def _weakest(platform: Platform, plan: PlannedLoop) -> float | None:
    """Return the smallest limit of the loop's torquers, N m; None where none has a limit."""
    limits = (one.limit for one in _torquers(platform, plan))
    return min((limit for limit in limits if limit is not None), default=None)


def safe_turn(model: LinearModel, limits: dict[str, float]) -> tuple[int, float]:
    """Return the axis about which a turn needs the most torque, and a rate for which the torquers have enough.

    The torques for each rad/s: of the rotors at the rate itself, of the inertias while it rises along half a cosine.
    """
    torques = np.abs(model.G_Omega) + 0.5 * math.pi / RISE * np.abs(model.M_Omega)
    axis = int(torques.sum(axis=0).argmax())
    rates = [
        _TURN_SHARE * limits[name] / torque
        for name, torque in zip(model.gimbal_names, torques[:, axis], strict=True)
        if name in limits and torque > 0.0
    ]
    return axis + 1, rounded(min([_TURN, *rates]), up=False)


def _started(
    job: Job, spec: LoopSpec, model: LinearModel, plan: PlannedLoop
) -> tuple[StartingLoop, StartingRun | None]:
    """Return a loop with its starting values, and the run that excites what it holds: none of caged gyros."""
    from platform_ctrl.design.loop_signals import loop_channels, loop_signals
    from platform_ctrl.design.plants import plants_of

    plants = plants_of(job, spec)
    assert plants is not None, "a loop that is designed by itself has plants"
    channel = loop_channels(model, loop_signals(job.platform, spec), plants.period)
    if channel.sense is not None:
        plants = plants.in_directions(channel.sense)
    # What the tries are: the options that are given, and the controller that they make.
    lag = _lag(job.platform, plan) + job.sampling.delay + 0.5 * job.sampling.period
    tries, build = (_rate_tries if plan.kind == "rate" else _classical_tries)(channel, plants, lag)
    options, controller, reached = _first_that_holds(tries, build, plants, loop_requirements(spec.limits))
    margin = next(key for key in spec.limits if key.startswith("disk_margin"))
    limits = dict(spec.limits)
    if reached > 1.0:
        limits[margin] = max(rounded(_ENOUGH * limits[margin] / reached, up=False), _LEAST_DISK_MARGIN)
    loop = StartingLoop(
        plan=plan,
        limits=limits,
        torque_limit=_weakest(job.platform, plan),
        method=spec.designs[0].method,
        options=options,
    )
    if plan.kind == "caging":
        return loop, None
    return motion_of_the_base(job, loop, plants, controller, disturbing_axes(job.platform, plan))


Tries = Iterator[dict[str, float]]
Build = Callable[[dict[str, float]], StateArrays]


def _classical_tries(channel: Channels, plants: PlantSet, lag: float) -> tuple[Tries, Build]:
    from platform_ctrl.design.classical.caging import classical_controller, starting_values

    def complete(given: dict[str, float]) -> dict[str, float]:
        return starting_values(given, channel, plants.nutation, plants.period)

    # The roll-off of gyros stays where it is; without gyros nothing crosses over across, and the lead ends a decade
    # above the crossover: an angle's noise is differentiated up to there.
    if len(channel.momenta):
        default = {name: x for name, x in complete({}).items() if "rolloff" not in name}
    else:
        default = {name: x for name, x in complete({}).items() if name != "crossover_hz"}
        highest = _ROLLOFF * default["inertial_crossover_hz"]
        default["inertial_rolloff_hz"] = min(default["inertial_rolloff_hz"], highest)
    tries = ({name: _two_digits(x * _STEP**k) for name, x in default.items()} for k in range(_STEPS + 1))
    return tries, lambda given: classical_controller(complete(given), channel, plants.period)


def _rate_tries(channel: Channels, plants: PlantSet, lag: float) -> tuple[Tries, Build]:
    from platform_ctrl.design.classical.rate import rate_controller, rate_options
    from platform_ctrl.job.job import DesignSpec

    def complete(given: dict[str, float]) -> dict[str, float]:
        design = DesignSpec(name="PI", method="pi", options=given)
        return rate_options(design, channel, plants.nutation, plants.period)

    crossover = _PHASE / (2.0 * math.pi * lag)
    faster = (_two_digits(crossover * _RATE_STEP**k) for k in range(_RATE_STEPS + 1))
    tries = (
        {"crossover_hz": hz, "integral_hz": _two_digits(complete({"crossover_hz": hz})["integral_hz"])} for hz in faster
    )
    return tries, lambda given: rate_controller(complete(given), channel, plants.period)


def _first_that_holds(
    tries: Tries, build: Build, plants: PlantSet, requirements: Any
) -> tuple[dict[str, float], StateArrays, float]:
    """Return the first options, from fast to slow, that meet the requirements, or the best; their controller; ratio."""
    from platform_ctrl.design.tuning import worst_ratio

    best: tuple[dict[str, float], StateArrays, float] | None = None
    for given in tries:
        controller = build(given)
        ratio = worst_ratio(controller, plants, requirements)
        if best is None or ratio < best[2]:
            best = given, controller, ratio
        if ratio <= _ENOUGH:
            break
    assert best is not None, "there is a first try"
    return best


def _servo(plan: PlannedLoop, loops: list[StartingLoop], platform: Platform) -> StartingLoop:
    """Return the platform servo, a decade below the caging loops whose torques it reads."""
    crossovers = [x for loop in loops for name, x in loop.options.items() if name.endswith("crossover_hz")]
    crossover = rounded(_SERVO * min(crossovers), up=False)
    roots = [one.limit for one in platform.torquers if one.root_axis is not None and one.limit is not None]
    return StartingLoop(
        plan=plan,
        torque_limit=min(roots, default=None),
        method="platform-servo",
        options={"crossover_hz": crossover, "position_hz": _two_digits(_POSITION * crossover)},
    )


def _step(platform: Platform, model: LinearModel, servo: StartingLoop) -> StartingRun:
    """Return a torque on the platform, and the angle that the servo leaves of it: torque over its stiffness."""
    crossover, position = (2.0 * math.pi * servo.options[f"{name}_hz"] for name in ("crossover", "position"))
    stiffness = float(model.root_inertia[0, 0]) * crossover * position
    torque = min(_PUSHED * stiffness, math.inf if servo.torque_limit is None else _TURN_SHARE * servo.torque_limit)
    torque = rounded(torque, up=False)
    limits = {"attitude": rounded(_SPARE * torque / stiffness, up=True), "torque_share": 1.0}
    return StartingRun(name="torque on the platform", form="step", axes=(1,), size=torque, limits=limits)


def _two_digits(number: float) -> float:
    return float(f"{number:.2g}")


def rounded(number: float, *, up: bool) -> float:
    """Return the next of 1, 2, 5, 10, ... above or below a positive number, in its decade."""
    if not number > 0.0:
        return 0.0
    decade = 10.0 ** math.floor(math.log10(number))
    steps, slack = [step * decade for step in (0.5, 1.0, 2.0, 5.0, 10.0)], 1e-9 * number
    chosen = min(x for x in steps if x >= number - slack) if up else max(x for x in steps if x <= number + slack)
    return float(f"{chosen:.1g}")


def motion_of_the_base(
    job: Job, loop: StartingLoop, plants: PlantSet, controller: StateArrays, axes: tuple[int, ...]
) -> tuple[StartingLoop, StartingRun]:
    """Return a loop with limits on what the motion of the base does to it, and the run that shows it.

    `plants` are those of `controller`, `axes` the root axes about which the base moves.
    """
    crossover = min(x for name, x in loop.options.items() if name.endswith("crossover_hz"))
    low = float(f"{_LOW * crossover:.2g}")
    limits: dict[str, float] = {}
    allowed: dict[str, float] = {}
    frequency = max(rounded(low, up=False), _SLOWEST_MOTION)
    if loop.plan.still and plants.sight:
        reached = _attenuation(plants, controller, low) - _LINEAR_SPARE
        if reached >= _LEAST_ATTENUATION:
            limits = {"attenuation_db_worst_case": float(math.floor(reached)), "attenuation_hz": low}
        reached = _attenuation(plants, controller, frequency) - _RUN_SPARE
        allowed = {"attenuation_db": float(math.floor(reached))} if reached >= _LEAST_ATTENUATION else {}
    else:
        bandwidth = _value(plants, controller, "bandwidth", ("nominal",)) / (2.0 * math.pi)
        limits = {"bandwidth_hz": rounded(bandwidth, up=False)} if bandwidth > 0.0 else {}
        dry = {one.gimbal for one in job.platform.frictions if max(one.breakaway) > 0.0}
        if not loop.plan.still and dry.isdisjoint(loop.plan.gimbals):
            gain = _value(plants, controller, "Omega rejection", ("nominal",))
            angle = _ANGLE_SPARE * gain * float(np.max(job.Omega)) * math.sqrt(len(axes))
            allowed = {"angle": rounded(angle, up=True)} if math.isfinite(angle) else {}
    balanced = not job.platform.unbalances or not np.any(job.platform.specific_force)
    run = StartingRun(
        name="motion of the base",
        form="motion",
        axes=axes,
        size=float(np.max(job.Omega)),
        frequency_hz=frequency,
        balanced=balanced,
        limits=allowed | {"torque_share": 1.0},
    )
    return replace(loop, limits=loop.limits | limits), run


def _attenuation(plants: PlantSet, controller: StateArrays, hz: float) -> float:
    """Return the attenuation up to a frequency, dB, dry friction and all angles included."""
    return 20.0 * math.log10(max(_value(plants, controller, "attenuation", WORST_CASE, 2.0 * math.pi * hz), 1e-3))


def _value(
    plants: PlantSet, controller: StateArrays, kind: str, over: tuple[str, ...], frequency: float | None = None
) -> float:
    """Return the worst value of a metric, in SI units: exact, since a limit is put right below it."""
    request = MetricRequest(kind=kind, over=over, frequency=frequency)
    metrics = measure(plants, controller._replace(dt=plants.period), [request], exact=True)
    values = metrics.values(request)
    return float(values.max() if kind == "Omega rejection" else values.min())
