"""Rules over several tables of a job: loops, drives, runs, campaign and budget, with one another and with the plant.

Each table alone has been checked by then: keys and values by the reader, what fits in one table by its record.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from platform_ctrl.analysis.metrics import METRICS, RUN_METRICS
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.budget import budget_misfits, sight_misfits, too_large
from platform_ctrl.job.drive import Feedforward, drive_misfits
from platform_ctrl.job.faults import FAULT_KINDS, PART_WORDS, Fault, part_names
from platform_ctrl.job.job import OWN_RATES, Job, LoopSpec
from platform_ctrl.job.manoeuvre import Manoeuvre
from platform_ctrl.job.methods import WITH_SIGNALS, DesignSpec
from platform_ctrl.job.requirements import limit_keys
from platform_ctrl.job.scenario import Command
from platform_ctrl.plant.drives import ROOT_TORQUE_NAMES
from platform_ctrl.plant.fields import TURN
from platform_ctrl.plant.mistakes import (
    Misfit,
    Mistake,
    at,
    given,
    listed,
    missing,
    strange,
    suggestion,
    unknown,
    within,
    wrong,
)
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

# Sample periods from sample to torque at most: each is a state of every torquer in every plant.
LONGEST_DELAY = 100
# Samples at most after which the order of computations of all loops repeats, and how well rates of loops fit.
LONGEST_CYCLE, _SAME_RATE = 1000, 1e-5
# Combinations of gimbal angles at most: each is a plant for every corner of the uncertainty.
MOST_TRIMS = 200
# Samples of a run at most, all of which are recorded: hours of work.
MOST_SAMPLES = 1e7
# Largest command that can be meant, by the reading's unit: a turn; a hundred radians in a second. An attitude sensor
# reads the sine of an angle (see `plant.sensors`), 4 % less than this one.
_LARGEST_COMMAND, _SMALL_COMMAND = {"rad": 2.0 * math.pi, "rad/s": 100.0}, 0.5


def job_mistakes(job: Job) -> list[Mistake]:
    """Return the mistakes of a job over several of its tables."""
    own = [
        *at(("operation",), _operation(job)),
        *at(("sampling",), _delay(job)),
        *at(("loop",), _rates(job)),
        *(mistake for k in range(len(job.loops)) for mistake in at(("loop", k), _loop(job, k))),
    ]
    if own and any(loop.resolve for loop in job.loops):
        return own  # what runs may command depends on what the loops read
    platform = job.platform
    moved = any(one.kind == "stabilisation" or one.moves_root(platform) for one in job.loops)
    return [
        *own,
        *(one for k, drive in enumerate(job.drives) for one in at(("drive", k), drive_misfits(platform, drive, moved))),
        *(mistake for k in range(len(job.manoeuvres)) for mistake in at(("manoeuvre", k), _run(job, k))),
        *(mistake for k, one in enumerate(job.fault_events) for mistake in at(("fault", k), _fault(job, one))),
        *at((), _campaign(job)),
        *at(("budget",), () if job.budget is None else budget_misfits(job.budget, job.platform)),
    ]


def locked_mistakes(locked: tuple[str, ...], loops: tuple[LoopSpec, ...], platform: Platform) -> list[Mistake]:
    """Return mistakes about gimbals to be locked, and with loops on locked ones; `platform` still has them."""
    words = "is locked in [operation]; leave it out here, or do not lock it"
    held = [(k, name) for k, loop in enumerate(loops) for name in loop.gimbals if name in locked]
    return [
        *at(("operation",), strange("locked", locked, "gimbal of the plant", platform.gimbal_names)),
        *(Mistake(("loop", k, "gimbals"), f"gimbals: {given(name)} {words}") for k, name in held),
    ]


def _operation(job: Job) -> Iterator[Misfit]:
    """Yield what is wrong with the platform's rates and the gimbal angles at which the loops have to work."""
    platform = job.platform
    yield from too_large("Omega", job.Omega, "base-rate")
    for name, values in job.angles.items():
        if name not in platform.angle_names:
            of_gimbal = dict(zip(platform.gimbal_names, platform.angle_names, strict=True)).get(name)
            known = suggestion(name, platform.angle_names)
            hint = known if of_gimbal is None else f'that of gimbal "{name}" is "{of_gimbal}"'
            yield ("angles", name), f"{name} is no angle of the plant; {hint}"
            continue
        for words in _beyond(name, values, platform):
            yield ("angles", name), words
    count = math.prod(len(set(values)) for values in job.angles.values())
    if count > MOST_TRIMS:
        words = f"{count} combinations of gimbal angles are more than {MOST_TRIMS}; give fewer angles"
        yield "angles", f"angles: {words}"


def _beyond(name: str, values: Iterable[float], platform: Platform) -> Iterator[str]:
    """Yield what is wrong with the first of some angles that lies beyond the stops, or a turn."""
    stops = platform.gimbals[platform.angle_names.index(name)].stops
    low, high = stops or (-TURN, TURN)
    for x in [x for x in values if not low <= x <= high][:1]:
        beyond = f"outside the stops, {low:.6g} to {high:.6g} rad" if stops else "more than a turn"
        degrees = f"angles are in rad: {x:g} degrees are {math.radians(x):.4g}"
        yield f"{name}: {x:g} rad is {beyond}; {degrees if abs(x) > TURN else 'choose an angle between them'}"


def _delay(job: Job) -> Iterator[Misfit]:
    delay = job.sampling.delay
    periods = delay / job.sampling.period
    if not periods <= LONGEST_DELAY:
        unit, scale = ("ms", 1e-3) if periods * 1e-3 <= LONGEST_DELAY else ("µs", 1e-6)
        more = f" s, {periods:.4g} of them; give a shorter delay, in s: {delay:g} {unit} is {delay * scale:g}"
        yield wrong(job.sampling, "delay", f"at most {LONGEST_DELAY} sample periods", more)


def _rates(job: Job) -> Iterator[Misfit]:
    """Yield the rates of loops that are not computed at every sample."""
    every: dict[str, int] = {}
    cycle, rate = 1, 1.0 / job.sampling.period
    for k, loop in enumerate(job.loops):
        own, inner = loop.rate_hz, every.get(loop.around or "", 1)
        if own is None:
            if inner > 1 and loop.kind in OWN_RATES:
                words = f"the loop inside has {rate / inner:.6g} Hz, and one around it cannot be faster"
                cure = "give it that rate, or a whole fraction of it"
                yield from within((k,), [missing("rate_hz", f"{words}; {cure}")])
            continue
        n = max(round(rate / own), 1)
        if abs(rate / own / n - 1.0) > _SAME_RATE:
            near = sorted({max(math.floor(rate / own), 1), math.ceil(rate / own)})
            words = f"{rate:.6g} Hz, the rate_hz of [sampling], over a whole number"
            fitting = f"; the nearest: {' or '.join(f'{rate / one:.6g}' for one in near)}"
            yield from within((k,), [wrong(loop, "rate_hz", words, fitting)])
            continue
        if n % inner:
            words = f"that of the loop inside, {rate / inner:.6g} Hz, over a whole number"
            fitting = f"; try {rate / (inner * math.ceil(n / inner)):.6g}"
            yield from within((k,), [wrong(loop, "rate_hz", words, fitting)])
        every[loop.name], cycle = n, math.lcm(cycle, n)
        if cycle > LONGEST_CYCLE:
            words = f"rate_hz = {own:g}: the computations of all loops repeat after {cycle} samples"
            cure = "choose rates that divide one another, or a lower rate_hz of [sampling]"
            yield (k, "rate_hz"), f"{words}, more than {LONGEST_CYCLE}; {cure}"
            return


def _loop(job: Job, k: int) -> Iterator[Misfit]:
    loop = job.loops[k]
    for name in ("limits", "soft"):
        yield from within((name,), _limits(job, loop, getattr(loop, name)))
    match loop.kind:
        case "caging":
            found = _caging(job, k)
        case "rate" | "pointing":
            found = _signals(job.platform, loop)
        case "tracking":
            found = _tracking(job, k)
        case "stabilisation":
            found = _stabilising(job, k)
    mistakes = list(found)
    yield from mistakes
    if not mistakes:
        try:
            job.resolver(loop)
        except ArgumentError as error:
            yield "resolve", str(error)
    rate = loop.rate_hz or 1.0 / job.sampling.period
    for i, design in enumerate(loop.designs):
        yield from within(("design", i), _design(job, loop, design, rate))


def _limits(job: Job, loop: LoopSpec, limits: Mapping[str, float]) -> Iterator[Misfit]:
    """Yield limits or goals of a loop that the plant or the kind of the loop does not have."""
    own = all(job.every(one) == 1 and one.kind in ("caging", "rate", "pointing") for one in job.loops)
    yield from sight_misfits(limits, job.budget, job.platform, own or (len(job.loops) == 1 and job.every(loop) == 1))
    known = limit_keys()
    faulty = job.faults.slow_rotor is not None or job.faults.weak_torquer is not None
    for key in sorted(limits):
        if known[key][1] == "faults" and not faulty:
            yield key, f"{key} needs plants with faults; add [faults] with slow_rotor or weak_torquer"
    named = [key for key in limits if key.startswith("attenuation_db")]
    if named and loop.kind not in WITH_SIGNALS:
        yield named[0], f"{named[0]} is a limit of rate and pointing loops alone; leave it out of this loop"
    elif named and job.platform.line_of_sight is None:
        yield named[0], f"{named[0]} needs a line of sight; add [line_of_sight] to the plant"


def _caging(job: Job, k: int) -> Iterator[Misfit]:
    loop, platform = job.loops[k], job.platform
    if not loop.gimbals:
        yield _no_names("gimbals", "the gimbals that the loop cages", platform.gimbal_names)
    before = [j for j, one in enumerate(job.loops[:k]) if one.kind == "stabilisation"]
    if before:
        words = f"kind: a caging loop must be before the stabilisation loop, [[loop]] {before[0] + 1}"
        yield "kind", f"{words}, which uses the torques of the caged gyros"
    taken = {name: j for j, one in enumerate(job.loops[:k]) if one.kind == "caging" for name in one.gimbals}
    for name in loop.gimbals:
        if name in taken:
            words = f"is caged by [[loop]] {taken[name] + 1} already; leave it out of one of them"
            yield "gimbals", f"gimbals: {given(name)} {words}"
        taken[name] = k
        if name not in platform.gimbal_names:
            yield unknown("gimbals", name, "gimbal of the plant", platform.gimbal_names)
            continue
        for part, parts in (("torquer", platform.torquers), ("pick-off", platform.pickoffs)):
            if all(one.gimbal != name for one in parts):
                words = f"has no {part} in the plant; every caged gimbal needs one{_by_motor_side(platform, name)}"
                yield "gimbals", f"gimbals: {given(name)} {words}"


def _by_motor_side(platform: Platform, name: str) -> str:
    """Return what turns a gimbal behind a drive that gives way, in words; empty of others."""
    sides = [one.motor_side for one in platform.compliances if name in (one.gimbal, one.motor_side)]
    if not sides:
        return ""
    return f"; [[compliance]] has its torquer on {given(sides[0])}: take a rate or pointing loop that turns that"


def _stabilising(job: Job, k: int) -> Iterator[Misfit]:
    loop, known = job.loops[k], limit_keys()
    fitting = ", ".join(sorted(key for key, (metric, _) in known.items() if METRICS[metric].of_torquers))
    for key in loop.limits:
        if key in known and not METRICS[known[key][0]].of_torquers:
            words = f"{key} is no limit of a stabilisation loop, which is checked in the coupled system"
            yield ("limits", key), f"{words}; use {fitting}, or a limit of [coupled]"
    before = [j for j, one in enumerate(job.loops[:k]) if one.kind == "stabilisation"]
    if before:
        yield "kind", f"kind: [[loop]] {before[0] + 1} stabilises the root already; leave one of them out"
        return
    axes = {torquer.root_axis for torquer in job.platform.torquers}
    if lacking := [name for axis, name in enumerate(ROOT_TORQUE_NAMES, 1) if axis not in axes]:
        words = f'kind = "stabilisation" needs root torquers; the plant has no {", ".join(lacking)}'
        yield "kind", f"{words}; add [[torquer]] with root_axis 1, 2 and 3"


def _fitting_sensors(platform: Platform, kind: str) -> list[str]:
    unit = "rad/s" if kind == "rate" else "rad"
    return [sensor.name for sensor in platform.sensors if sensor.unit == unit]


def _no_names(key: str, words: str, known: Iterable[str]) -> Misfit:
    return key, f"{key} must be a list of names, {words}; {listed(known)}"


def _signals(platform: Platform, loop: LoopSpec) -> Iterator[Misfit]:
    """Yield what is wrong with what a rate or pointing loop turns, reads and sets."""
    if not loop.gimbals:
        yield _no_names("gimbals", "the gimbals that the loop turns", platform.gimbal_names)
    if not loop.sensors:
        yield _no_names("sensors", "what the loop reads", _fitting_sensors(platform, loop.kind))
    torquers = {t.name: t.gimbal for t in platform.torquers if t.gimbal is not None}
    yield from strange("gimbals", loop.gimbals, "gimbal of the plant", platform.gimbal_names)
    for name in loop.gimbals:
        if name in platform.gimbal_names and not loop.torquers and name not in torquers.values():
            hint = _by_motor_side(platform, name) or "; add a [[torquer]]"
            yield "gimbals", f"gimbals: {given(name)} has no torquer in the plant{hint}"
    yield from _sensors(platform, loop.kind, loop.sensors)
    for name in loop.torquers:
        if torquers.get(name) not in loop.gimbals:
            yield unknown("torquers", name, "torquer on a gimbal of the loop", torquers)


def _sensors(platform: Platform, kind: str, names: tuple[str, ...]) -> Iterator[Misfit]:
    """Yield sensors that a rate or pointing loop, or one of its designs, cannot read; one of its own unit is needed."""
    fitting, every = _fitting_sensors(platform, kind), [sensor.name for sensor in platform.sensors]
    other, wanted = ("an angle", "rates") if kind == "rate" else ("a rate", "angles")
    for name in names:
        if name not in every or not set(names) & set(fitting):
            what = f"measures {other}" if name in every else "is no sensor of the plant"
            words = f"sensors: {given(name)} {what}; a {kind} loop keeps what sensors of {wanted} measure"
            yield "sensors", f"{words}; {suggestion(name, fitting)}"


def _tracking(job: Job, k: int) -> Iterator[Misfit]:
    """Yield what is wrong with what a tracking loop reads, and with the rate loop that it commands."""
    loop, fitting = job.loops[k], _fitting_sensors(job.platform, "tracking")
    if not loop.sensors:
        yield _no_names("sensors", "what the loop reads", fitting)
    yield from strange("sensors", loop.sensors, "sensor of an angle", fitting)
    inner = [one.name for one in job.loops[:k] if one.kind == "rate"]
    if loop.around not in inner:
        more = f"; {suggestion(loop.around or '', inner)}"
        yield wrong(loop, "around", "the name of a rate loop before this one", more)


def _design(job: Job, loop: LoopSpec, design: DesignSpec, rate: float) -> Iterator[Misfit]:
    yield from _below_half(design.options, [key for key in design.options if key.endswith("_hz")], rate)
    if design.command is not None:
        yield from within(("command",), _below_half(design.command, ["filter_hz"], rate))
    yield from _sensors(job.platform, loop.kind, design.sensors)
    if design.feedforward is not None and loop.moves_root(job.platform):
        words = f"feedforward: its rates are those of {job.platform.root_name!r}, which this loop moves itself"
        yield "feedforward", f"{words}; leave it out"
    elif design.feedforward is not None:
        yield from within(("feedforward",), _feedforward(job, design.feedforward))


def _below_half(table: object, keys: Iterable[str], rate: float) -> Iterator[Misfit]:
    """Yield frequencies of a table or record that a loop sampled at `rate`, Hz, does not have."""
    for key in keys:
        f = table[key] if isinstance(table, Mapping) else getattr(table, key)
        if f is not None and f >= 0.5 * rate:
            yield wrong(table, key, f"below half the sample rate, {0.5 * rate:.6g} Hz")


def _feedforward(job: Job, fed: Feedforward) -> Iterator[Misfit]:
    yield from _below_half(fed, ["bandwidth_hz"], 1.0 / job.sampling.period)
    platform, every = job.platform, [sensor.name for sensor in job.platform.sensors]
    rates = [one for one in platform.sensors if one.unit == "rad/s"]
    # Those of the root, which no torquer on a gimbal moves.
    fitting = [one.name for one in rates if set(one.signals(platform)) <= set(OMEGA_NAMES)]
    for name in fed.sensors:
        if name not in every:
            yield unknown("sensors", name, "sensor of the plant", fitting)
        elif name not in fitting:
            words = f"sensors: {given(name)} does not measure a rate of the root alone: torquers move what it reads"
            yield "sensors", f"{words}; {suggestion(name, fitting)}"


def _run(job: Job, k: int) -> Iterator[Misfit]:
    run, gimbals = job.manoeuvres[k], job.platform.gimbal_names
    if run.duration > MOST_SAMPLES * job.sampling.period:
        more = f" s; give at most {MOST_SAMPLES * job.sampling.period:.6g} s"
        yield wrong(run, "duration", f"at most {MOST_SAMPLES:.0e} sample periods", more)
    yield from within(("initial",), _initial(run, job.platform))
    yield from within(("limits",), _run_limits(run, job.platform, job.units))
    if run.mode == "caged" and (moving := [one.name for one in job.loops if one.moves_root(job.platform)]):
        words = f'mode = "caged" prescribes the rate of {job.platform.root_name!r}, which loop {moving[0]!r} moves'
        yield "mode", f'{words}; use "stabilised"'
    if run.mode == "stabilised" and job.platform.mode == "held":
        words = 'frees the root, which mode = "held" of the plant holds'
        yield "mode", f'mode = "stabilised" {words}; use "caged", or another mode of the plant'
    if job.platform.mode == "floating":
        words = "a specific force has no effect on a plant that floats: its acceleration follows from the forces"
        kinds = {"vibration": [one.kind for one in run.vibrations], "sine": [one.kind for one in run.sines]}
        for key, found in kinds.items():
            yield from (((key, i, "kind"), f"kind: {words}") for i, kind in enumerate(found) if kind == "force")
    shaken = {"vibration": [one.gimbal for one in run.vibrations], "sine": [one.gimbal for one in run.sines]}
    shaken["gimbal_torque"] = [one.gimbal for one in run.gimbal_torques]
    for key, names in shaken.items():
        for i, name in enumerate(names):
            yield from within((key, i), strange("gimbal", [name], "gimbal of the plant", gimbals))
    for i, command in enumerate(run.commands):
        yield from within(("command", i), _command(job, command))
    yield from strange("faults", run.faults, "[[fault]] of the job", [fault.name for fault in job.fault_events])


def _run_limits(run: Manoeuvre, platform: Platform, units: Mapping[str, str]) -> Iterator[Misfit]:
    commanded = {units.get(command.reading) for command in run.commands}
    for key in run.limits:
        metric = RUN_METRICS[key]
        if metric.sight and platform.line_of_sight is None:
            yield key, f"{key} has no effect: the plant has no line of sight; add [line_of_sight] to it"
        elif metric.stops and not any(one.stops for one in platform.gimbals):
            yield key, f"{key} has no effect: no gimbal of the plant has stops; add stops, or use angle"
        elif metric.commanded and metric.unit not in commanded:
            yield key, f"{key} has no effect: no [[manoeuvre.command]] is of a reading in {metric.unit}; add one"


def _initial(run: Manoeuvre, platform: Platform) -> Iterator[Misfit]:
    free = run.mode == "stabilised"
    angles = platform.angle_names
    known = [*angles, *(f"{angle}_rate" for angle in angles), *(OMEGA_NAMES if free else ())]
    for key, number in run.initial.items():
        if key in OMEGA_NAMES and not free:
            words = "the rate of a caged platform is prescribed; use Omega_table, or"
            yield key, f'{key} = {number:g} has no effect: {words} mode = "stabilised"'
        elif key not in known:
            yield key, f"unknown key {given(key)}; {suggestion(key, known)}"
        elif key in OMEGA_NAMES:
            yield from too_large(key, number, "base-rate")
        elif key in angles:
            yield from ((key, words) for words in _beyond(key, [number], platform))


def _command(job: Job, command: Command) -> Iterator[Misfit]:
    yield from _below_half(command, ["frequency_hz"], 1.0 / job.sampling.period)
    reading, units = command.reading, job.units
    if reading not in units:
        yield unknown("reading", reading, "sensor of the plant", units)
        return
    read = [name for loop in job.loops if loop.kind in OWN_RATES for name in job.readings_of(loop, kept=True)]
    if reading not in read:
        use = suggestion(reading, read) if read else "add a rate or pointing loop that reads it"
        why = "read by no rate, pointing or tracking loop, and a caging loop holds its gimbals at zero"
        yield "reading", f"reading: {given(reading)} is {why}; {use}"
    unit = units[reading]
    sensors = [reading, *(name for law in job.resolvers if reading in law.names for name in law.sensors)]
    small = any(one.name in sensors for one in job.platform.attitude_sensors)
    most = _SMALL_COMMAND if small else _LARGEST_COMMAND[unit]
    for key in ("step", "amplitude", "value"):
        worst = float(np.abs(getattr(command, key)).max(initial=0.0))
        if worst > most:
            why = "which reads small rotations" if small else "not in degrees"
            words = f"{worst:.6g} {unit} cannot be meant, at most {most:.4g} {unit}"
            yield key, f"{key}: {words}; commands of {given(reading)} are in {unit}, {why}"


def _fault(job: Job, fault: Fault) -> Iterator[Misfit]:
    kind, platform = FAULT_KINDS[fault.kind].part, job.platform
    if kind is None:
        return
    known, what = part_names(platform, kind), f"the name of {PART_WORDS[kind]}"
    if kind == "gimbal" and fault.part in known:
        known, what = [one.name for one in platform.gimbals if one.stops is not None], "a gimbal with stops"
    if fault.part not in known:
        yield wrong(fault, "part", what, f"; {suggestion(fault.part or '', known)}")


def _campaign(job: Job) -> Iterator[Misfit]:
    campaign = job.campaign
    if campaign is None:
        return
    if not job.manoeuvres:
        yield "campaign", "[campaign] has no manoeuvre to simulate; add a [[manoeuvre]] to the job"
    runs, faults = [one.name for one in job.manoeuvres], [one.name for one in job.fault_events]
    for kind, key, known, tables in (
        ("manoeuvre", "name", runs, campaign.manoeuvres),
        ("fault", "fault", faults, campaign.faults),
    ):
        for k, one in enumerate(tables):
            name = getattr(one, key)
            if name not in known:
                misfit = wrong(one, key, f"the name of a [[{kind}]] of the job", f"; {suggestion(name, known)}")
                yield from within(("campaign", kind, k), [misfit])
