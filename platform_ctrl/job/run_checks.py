"""What must fit together about simulated runs of a job file: manoeuvres, how they begin, what shakes, what fails."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.job.budget import SOURCE_KINDS
from platform_ctrl.job.faults import FAULT_KINDS, FAULT_NUMBERS, PART_WORDS, part_names
from platform_ctrl.job.variation import Campaign
from platform_ctrl.plant.entry import Entry
from platform_ctrl.plant.fields import ROUNDING, TURN
from platform_ctrl.plant.mistakes import Mistake, given, suggestion
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

# The keys that make a motion of each mode: all of them or none; and the table that adds to it or replaces it.
MOTION = {"caged": ("rate", "rise", "hold"), "stabilised": ("torque",)}
MOTION_TABLE = {"caged": "Omega_table", "stabilised": "torque_table"}
# Samples of a run, all of which are recorded, and integration steps: hours of work.
MOST_SAMPLES, MOST_STEPS = 1e7, 1e9
LONGEST_STEP = Campaign().step  # that of manoeuvres, too
# What shakes in a run, by the kinds of a budget's sources.
_KINDS = {"rate": "base-rate", "force": "specific-force", "torque": "torque"}
# What may happen to a platform that is not moved: one of these is enough of a manoeuvre.
EVENTS = ("vibration", "sine", "command", "faults", "initial")
# The keys that make a command: each with what it needs beside it, and what may stand there too.
_COMMANDS = {"step": (), "ramp": (), "amplitude": ("frequency_hz",), "value": ("t",)}
_BESIDE = {
    "at": ("step", "ramp"),
    "frequency_hz": ("amplitude",),
    "phase": ("amplitude",),
    "t": ("value",),
    "smooth": ("value",),
}
# Largest command that can be meant, by the reading's unit: a turn; a hundred radians in a second. An attitude sensor
# reads the sine of an angle (see `plant.sensors`), 4 % less than this one.
_LARGEST_COMMAND, _SMALL_COMMAND = {"rad": 2.0 * math.pi, "rad/s": 100.0}, 0.5


def run_mistakes(job: Entry, platform: Platform | None) -> Iterator[Mistake]:
    """Walk what does not fit together; without a platform, what can be said without it."""
    yield from _sizes(job.table("operation"), ("Omega",), "base-rate")
    faults = job.named("fault")
    for run in job.tables("manoeuvre"):
        mode = run.text("mode")
        if mode in MOTION:
            yield from _motion(run, mode)
            yield from _initial(run, mode, platform)
        yield from _sizes(run, ("rate",), "base-rate")
        yield from _length(job, run)
        yield from _tables(run)
        yield from _vibrations(run, mode, platform)
        yield from _limits(run, mode, platform)
        for command in run.tables("command"):
            yield from _command(job, run, command)
            yield from _command_reading(job, command, platform)
        names = run.names("faults")
        wrong = [name for name in dict.fromkeys(names) if name not in faults or names.count(name) > 1]
        if wrong and wrong[0] in faults:
            yield run.says("faults", f"{given(wrong[0])} is listed twice; leave one of them out")
        elif wrong:
            yield run.unknown("faults", wrong[0], "[[fault]] of the job", faults)
    for fault in job.tables("fault"):
        yield from _fault(fault, platform)


def _motion(run: Entry, mode: str) -> Iterator[Mistake]:
    keys, instead = MOTION[mode], MOTION_TABLE[mode]
    needed = f"a {mode} manoeuvre needs {', '.join(keys)} and axis, or {instead}"
    if any(key in run for key in keys):
        yield from (run.missing(key, needed) for key in (*keys, "axis") if key not in run)
    elif not any(run.data.get(key) for key in (instead, *EVENTS)):
        yield run.missing(keys[0], needed)
    for other in MOTION:
        for key in (*MOTION[other], MOTION_TABLE[other]):
            if other != mode and key in run:
                words = f"{key} = {given(run.data[key])} is for a {other} manoeuvre"
                yield run.text_at(key, f"{words}; leave it out with mode = {given(mode)}")
    duration, rise, hold = (run.number(key) for key in ("duration", "rise", "hold"))
    if mode == "caged" and duration is not None and rise is not None and hold is not None:
        least = 2 * rise + hold
        if rise > 0 and hold >= 0 and 0 < duration < least * (1 - ROUNDING):
            yield run.wrong("duration", f"at least 2 rise + hold, {least:.6g} s")


def _sizes(table: Entry, keys: Sequence[str], kind: str) -> Iterator[Mistake]:
    """Walk numbers of a kind of base motion that are larger than can be meant."""
    most, unit = SOURCE_KINDS[kind].largest_rms, next(iter(SOURCE_KINDS[kind].units))
    for key in keys:
        worst = max(map(abs, _numbers(table, key)), default=0.0)
        if worst > most:
            yield table.says(key, f"{worst:.6g} {unit} cannot be meant, at most {most:g}; write it in {unit}")


def _numbers(table: Entry, key: str) -> list[float]:
    """Return the number under a key, or those in its list."""
    items = table.data.get(key)
    found = (Entry({key: item}).number(key) for item in (items if isinstance(items, list) else [items]))
    return [x for x in found if x is not None]


def _length(job: Entry, run: Entry) -> Iterator[Mistake]:
    duration, rate = run.number("duration"), job.table("sampling").number("rate_hz")
    campaign = job.table("campaign")
    step = campaign.number("step") if "step" in campaign else LONGEST_STEP
    if duration is None:
        return
    samples = 0.0 if rate is None else duration * rate
    for number, most, words, longest in (
        (samples, MOST_SAMPLES, "sample periods", MOST_SAMPLES / rate if rate else 0.0),
        (duration / LONGEST_STEP, MOST_STEPS, "integration steps", MOST_STEPS * LONGEST_STEP),
    ):
        if number > most:
            words = f"at most {most:.0e} {words}"
            yield run.wrong("duration", words, f" s, {number:.4g} of them; give at most {longest:.6g} s")
            return
    if step is not None and step > 0.0 and duration / step > MOST_STEPS:
        words = f"step must leave [[manoeuvre]] {run.place} at most {MOST_STEPS:.0e} steps, got {given(step)} s"
        yield campaign.text_at("step", f"{words}, {duration / step:.4g} steps")


def _tables(run: Entry) -> Iterator[Mistake]:
    for key, columns in (("Omega_table", OMEGA_NAMES), ("torque_table", ("M1", "M2", "M3"))):
        if not isinstance(run.data.get(key), dict):
            continue
        table = run.table(key)
        if not any(column in table for column in columns):
            first, second, third = columns
            yield table.missing(first, f"the table needs {first}, {second} or {third} beside the times")
        for column in columns:
            yield from table.of_length(column, "t")
        if columns is OMEGA_NAMES:
            yield from _sizes(table, columns, "base-rate")


def _limits(run: Entry, mode: str | None, platform: Platform | None) -> Iterator[Mistake]:
    duration = run.number("duration")
    for key in ("settle", "fade"):
        time = run.number(key)
        if duration is not None and time is not None and time >= duration > 0.0:
            yield run.wrong(key, f"less than duration, {duration:.6g} s")
    if run.number("fade") and not (run.data.get("vibration") or run.data.get("sine")):
        words = "fade is the time over which a vibration or a sine rises, and this manoeuvre has neither: leave it out"
        yield run.text_at("fade", words)
    limits = run.table("limits")
    units = {} if platform is None else {sensor.name: sensor.unit for sensor in platform.sensors}
    commanded = {units.get(command.text("reading") or "") for command in run.tables("command")}
    for key in limits.data:
        metric = RUN_METRICS.get(key)
        if metric is not None and metric.sight and platform is not None and platform.line_of_sight is None:
            words = "has no effect: the plant has no line of sight; add [line_of_sight] to it"
        elif metric is not None and metric.commanded and platform is not None and metric.unit not in commanded:
            words = f"has no effect: no [[manoeuvre.command]] is of a reading in {metric.unit}; add one"
        elif key == "attenuation_db" and mode == "stabilised":
            words = "is for a caged manoeuvre, whose base moves as prescribed; leave it out"
        else:
            continue
        yield limits.text_at(key, f"{key} {words}")


def _vibrations(run: Entry, mode: str | None, platform: Platform | None) -> Iterator[Mistake]:
    for one in (*run.tables("vibration"), *run.tables("sine")):
        kind, gimbal = one.text("kind"), one.text("gimbal")
        if kind == "rate" and mode == "stabilised":
            words = 'kind must be "force" with mode = "stabilised", got "rate"'
            yield one.text_at("kind", f"{words}: only a caged platform has a prescribed rate")
        if kind in _KINDS:
            needed, other = ("gimbal", "axis") if kind == "torque" else ("axis", "gimbal")
            if needed not in one:
                yield one.missing(needed, f"kind = {given(kind)} needs it")
            if other in one:
                yield one.useless(other, f"with kind = {given(kind)}; leave the key out")
            yield from _sizes(one, ("amplitude",), _KINDS[kind])
        if gimbal is not None and platform is not None and gimbal not in platform.gimbal_names:
            yield one.unknown("gimbal", gimbal, "gimbal of the plant", platform.gimbal_names)
        yield from one.of_length("densities", "frequencies_hz")


def _initial(run: Entry, mode: str, platform: Platform | None) -> Iterator[Mistake]:
    initial = run.table("initial")
    if platform is None:
        return
    stops = {gimbal.angle: gimbal.stops for gimbal in platform.gimbals}
    known = [*stops, *(f"{angle}_rate" for angle in stops), *(OMEGA_NAMES if mode == "stabilised" else ())]
    for key in initial.data:
        number, bounds = initial.number(key), stops.get(key)
        if key not in known and key in OMEGA_NAMES:
            words = "the rate of a caged platform is prescribed; use Omega_table, or"
            found = f"{key} = {given(initial.data[key])} has no effect"
            yield initial.text_at(key, f'{found}: {words} mode = "stabilised"')
        elif key not in known:
            yield initial.text_at(key, f"unknown key {given(key)}; {suggestion(key, known)}")
        elif key in OMEGA_NAMES:
            yield from _sizes(initial, (key,), "base-rate")
        elif key in stops and bounds is None and number is not None and abs(number) > TURN:
            words = f"angles are in rad: {number:g} degrees are {math.radians(number):.4g}"
            yield initial.says(key, f"{number:g} rad is more than a turn; {words}")
        elif bounds is not None and number is not None and not bounds[0] <= number <= bounds[1]:
            yield initial.wrong(key, f"between the stops of the gimbal, {bounds[0]:.6g} to {bounds[1]:.6g} rad")


def _fault(fault: Entry, platform: Platform | None) -> Iterator[Mistake]:
    at, until, name = fault.number("at"), fault.number("until"), fault.text("kind")
    if at is not None and until is not None and at >= until > 0:
        yield fault.wrong("until", f"after at = {given(at)}")
    if name not in FAULT_KINDS:
        return
    kind, of, part = FAULT_KINDS[name], f"kind = {given(name)}", fault.text("part")
    others = [key for key in kind.keys if key not in kind.needed]
    yield from fault.takes(of, kind.needed, others, sorted(FAULT_NUMBERS.keys() - {"at"}))
    if kind.part is None:
        if "part" in fault:
            words = f"part = {given(fault.data['part'])} has no effect: {of} is of all controllers; leave the key out"
            yield fault.text_at("part", words)
    elif "part" not in fault:
        yield fault.missing("part", f"{of} needs the name of {PART_WORDS[kind.part]}")
    elif part is not None and platform is not None:
        known, what = part_names(platform, kind.part), f"the name of {PART_WORDS[kind.part]}"
        if kind.part == "gimbal" and part in known:
            known = [gimbal.name for gimbal in platform.gimbals if gimbal.stops is not None]
            what = "a gimbal with stops"
        if part not in known:
            yield fault.wrong("part", what, f"; {suggestion(part, known)}")


def _command(job: Entry, run: Entry, command: Entry) -> Iterator[Mistake]:
    """Judge the keys of a command, and when it acts."""
    made = [key for key in _COMMANDS if key in command]
    if not made:
        yield command.missing("step", "a command needs step, ramp, amplitude with frequency_hz, or value with t")
    for key in made:
        for needed in _COMMANDS[key]:
            if needed not in command:
                yield command.missing(needed, f"{key} has no effect without it")
    for key, of in _BESIDE.items():
        if made and key in command and not any(one in command for one in of):
            yield command.useless(key, f"without {' or '.join(of)}; add it, or leave the key out")
    yield from command.of_length("value", "t")
    duration, at = run.number("duration"), command.number("at")
    if duration is not None and at is not None and at >= duration > 0.0:
        yield command.wrong("at", f"before the end of the run, {duration:.6g} s")
    rate, frequency = job.table("sampling").number("rate_hz"), command.number("frequency_hz")
    if rate is not None and frequency is not None and frequency >= 0.5 * rate > 0.0:
        yield command.wrong("frequency_hz", f"below half the sample rate, {0.5 * rate:.6g} Hz")


def _command_reading(job: Entry, command: Entry, platform: Platform | None) -> Iterator[Mistake]:
    reading = command.text("reading")
    if reading is None or platform is None:
        return
    by_name = {sensor.name: sensor for sensor in platform.sensors}
    loops = [loop for loop in job.tables("loop") if loop.text("kind") in ("rate", "pointing", "tracking")]
    read = [name for loop in loops for name in loop.names("sensors")]
    if reading not in by_name:
        yield command.unknown("reading", reading, "sensor of the plant", by_name)
        return
    if reading not in read:
        use = suggestion(reading, read) if read else "add a rate or pointing loop that reads it"
        why = "read by no rate, pointing or tracking loop, and a caging loop holds its gimbals at zero"
        yield command.says("reading", f"{given(reading)} is {why}; {use}")
    unit = by_name[reading].unit
    attitude = any(sensor.name == reading for sensor in platform.attitude_sensors)
    most = _SMALL_COMMAND if attitude else _LARGEST_COMMAND[unit]
    for key in ("step", "amplitude", "value"):
        worst = max(map(abs, _numbers(command, key)), default=0.0)
        if worst > most:
            why = "which reads small rotations" if attitude else "not in degrees"
            words = f"{worst:.6g} {unit} cannot be meant, at most {most:.4g} {unit}"
            yield command.says(key, f"{words}; commands of {given(reading)} are in {unit}, {why}")
