"""What must fit together about simulated runs of a job file: manoeuvres, how they begin, what shakes, what fails."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import Any

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.job.budget import SOURCE_KINDS
from platform_ctrl.job.faults import FAULT_KINDS, FAULT_NUMBERS, PART_WORDS, PartKind, part_names
from platform_ctrl.job.variation import Campaign
from platform_ctrl.plant.checks import number_of
from platform_ctrl.plant.fields import ROUNDING, TURN
from platform_ctrl.plant.mistakes import Mistake, Path, given, suggestion, tables, text_of
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

Data = dict[str, Any]

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


def run_mistakes(data: Data, platform: Platform | None) -> Iterator[Mistake]:
    """Walk what does not fit together; without a platform, what can be said without it."""
    operation = data.get("operation")
    if isinstance(operation, dict):
        yield from _sizes(operation, ("Omega",), "base-rate", ("operation",))
    faults = dict.fromkeys(name for _, table in tables(data, "fault") if (name := text_of(table, "name")) is not None)
    for k, table in tables(data, "manoeuvre"):
        path: Path = ("manoeuvre", k)
        mode = text_of(table, "mode")
        if mode in MOTION:
            yield from _motion(table, path, mode)
            yield from _initial(table, path, mode, platform)
        yield from _sizes(table, ("rate",), "base-rate", path)
        yield from _length(table, path, data)
        yield from _tables(table, path)
        yield from _vibrations(table, path, mode, platform)
        yield from _limits(table, path, mode, platform)
        yield from _commands(data, table, path, platform)
        yield from _names_of_faults(table, path, faults)
    for k, table in tables(data, "fault"):
        yield from _fault(table, ("fault", k), platform)


def _motion(table: Data, path: Path, mode: str) -> Iterator[Mistake]:
    keys, instead = MOTION[mode], MOTION_TABLE[mode]
    needed = f"a {mode} manoeuvre needs {', '.join(keys)} and axis, or {instead}"
    if any(key in table for key in keys):
        for key in (*keys, "axis"):
            if key not in table:
                yield Mistake.missing(path, key, needed)
    elif not any(table.get(key) for key in (instead, *EVENTS)):
        yield Mistake.missing(path, keys[0], needed)
    for other in MOTION:
        for key in (*MOTION[other], MOTION_TABLE[other]):
            if other != mode and key in table:
                words = (
                    f"{key} = {given(table[key])} is for a {other} manoeuvre; leave it out with mode = {given(mode)}"
                )
                yield Mistake((*path, key), words)
    duration, rise, hold = (number_of(table, key) for key in ("duration", "rise", "hold"))
    if mode == "caged" and duration is not None and rise is not None and hold is not None:
        least = 2 * rise + hold
        if rise > 0 and hold >= 0 and 0 < duration < least * (1 - ROUNDING):
            yield Mistake.wrong(table, path, "duration", f"at least 2 rise + hold, {least:.6g} s")


def _sizes(table: Data, keys: Sequence[str], kind: str, path: Path) -> Iterator[Mistake]:
    """Walk numbers of a kind of base motion that are larger than can be meant."""
    most, unit = SOURCE_KINDS[kind].largest_rms, next(iter(SOURCE_KINDS[kind].units))
    for key in keys:
        given_values = table.get(key)
        values = given_values if isinstance(given_values, list) else [given_values]
        worst = max((abs(x) for item in values if (x := number_of({key: item}, key)) is not None), default=0.0)
        if worst > most:
            words = f"{key}: {worst:.6g} {unit} cannot be meant, at most {most:g}; write it in {unit}"
            yield Mistake((*path, key), words)


def _length(table: Data, path: Path, data: Data) -> Iterator[Mistake]:
    duration, sampling, campaign = number_of(table, "duration"), data.get("sampling"), data.get("campaign")
    if duration is None:
        return
    rate = number_of(sampling, "rate_hz") if isinstance(sampling, dict) else None
    step = number_of(campaign, "step") if isinstance(campaign, dict) and "step" in campaign else LONGEST_STEP
    if rate is not None and rate > 0.0 and duration * rate > MOST_SAMPLES:
        words = f"duration must be at most {MOST_SAMPLES:.0e} sample periods, got {given(duration)} s"
        cure = f"give at most {MOST_SAMPLES / rate:.6g} s"
        yield Mistake((*path, "duration"), f"{words}, {duration * rate:.4g} of them; {cure}")
    elif duration / LONGEST_STEP > MOST_STEPS:
        words = f"duration must be at most {MOST_STEPS:.0e} integration steps, got {given(duration)} s"
        cure = f"give at most {MOST_STEPS * LONGEST_STEP:.6g} s"
        yield Mistake((*path, "duration"), f"{words}, {duration / LONGEST_STEP:.4g} of them; {cure}")
    elif step is not None and step > 0.0 and duration / step > MOST_STEPS:
        words = f"step must leave [[manoeuvre]] {int(path[1]) + 1} at most {MOST_STEPS:.0e} steps, got {given(step)} s"
        yield Mistake(("campaign", "step"), f"{words}, {duration / step:.4g} steps")


def _tables(table: Data, path: Path) -> Iterator[Mistake]:
    for key, columns in (("Omega_table", OMEGA_NAMES), ("torque_table", ("M1", "M2", "M3"))):
        over_time = table.get(key)
        if not isinstance(over_time, dict):
            continue
        if not any(column in over_time for column in columns):
            first, second, third = columns
            yield Mistake.missing((*path, key), first, f"the table needs {first}, {second} or {third} beside the times")
        for column in columns:
            yield from of_length(over_time, column, "t", (*path, key))
        if columns is OMEGA_NAMES:
            yield from _sizes(over_time, columns, "base-rate", (*path, key))


def of_length(table: Data, key: str, beside: str, path: Path) -> Iterator[Mistake]:
    """Judge that two lists have as many elements."""
    one, other = table.get(key), table.get(beside)
    if isinstance(one, list) and isinstance(other, list) and len(one) != len(other):
        words = f"{key} must have as many elements as {beside}, {len(other)}, got {len(one)}"
        yield Mistake((*path, key), words)


def _limits(table: Data, path: Path, mode: str | None, platform: Platform | None) -> Iterator[Mistake]:
    duration = number_of(table, "duration")
    for key in ("settle", "fade"):
        time = number_of(table, key)
        if duration is not None and time is not None and time >= duration > 0.0:
            yield Mistake.wrong(table, path, key, f"less than duration, {duration:.6g} s")
    if number_of(table, "fade") and not (table.get("vibration") or table.get("sine")):
        words = "fade is the time over which a vibration or a sine rises, and this manoeuvre has neither: leave it out"
        yield Mistake((*path, "fade"), words)
    limits = table.get("limits")
    for key in limits if isinstance(limits, dict) else ():
        metric = RUN_METRICS.get(key)
        if metric is not None and metric.sight and platform is not None and platform.line_of_sight is None:
            words = f"{key} has no effect: the plant has no line of sight; add [line_of_sight] to it"
            yield Mistake((*path, "limits", key), words)
        elif metric is not None and metric.commanded and platform is not None and not _commanded(table, key, platform):
            words = f"{key} has no effect: no [[manoeuvre.command]] is of a reading in {metric.unit}; add one"
            yield Mistake((*path, "limits", key), words)
        elif key == "attenuation_db" and mode == "stabilised":
            words = f"{key} is for a caged manoeuvre, whose base moves as prescribed; leave it out"
            yield Mistake((*path, "limits", key), words)


def _commanded(table: Data, key: str, platform: Platform) -> bool:
    """Return whether the manoeuvre commands a reading in the metric's unit."""
    units = {sensor.name: sensor.unit for sensor in platform.sensors}
    readings = [text_of(one, "reading") for _, one in tables(table, "command")]
    return any(units.get(reading or "") == RUN_METRICS[key].unit for reading in readings)


def _vibrations(table: Data, path: Path, mode: str | None, platform: Platform | None) -> Iterator[Mistake]:
    shaking = [(kind, *one) for kind in ("vibration", "sine") for one in tables(table, kind)]
    for table_of, k, vibration in shaking:
        own: Path = (*path, table_of, k)
        if vibration.get("kind") == "rate" and mode == "stabilised":
            words = (
                'kind must be "force" with mode = "stabilised", got "rate": only a caged platform has a prescribed rate'
            )
            yield Mistake((*own, "kind"), words)
        kind = text_of(vibration, "kind")
        needed, other = ("gimbal", "axis") if kind == "torque" else ("axis", "gimbal")
        if needed not in vibration and kind in _KINDS:
            yield Mistake.missing(own, needed, f"kind = {given(kind)} needs it")
        if other in vibration and kind in _KINDS:
            yield Mistake.useless(vibration, own, other, f"with kind = {given(kind)}; leave the key out")
        gimbal = text_of(vibration, "gimbal")
        if gimbal is not None and platform is not None and gimbal not in platform.gimbal_names:
            yield Mistake.unknown_name(own, "gimbal", gimbal, "gimbal of the plant", platform.gimbal_names)
        of_kind = _KINDS.get(kind or "")
        if of_kind is not None:
            yield from _sizes(vibration, ("amplitude",), of_kind, own)
        yield from of_length(vibration, "densities", "frequencies_hz", own)


def _names_of_faults(table: Data, path: Path, known: Collection[str]) -> Iterator[Mistake]:
    names = table.get("faults")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return
    taken = Counter(names)
    for name in taken:
        if name in known and taken[name] == 1:
            continue
        if name not in known:
            yield Mistake.unknown_name(path, "faults", name, "[[fault]] of the job", known)
        else:
            yield Mistake((*path, "faults"), f"faults: {given(name)} is listed twice; leave one of them out")
        return


def _initial(table: Data, path: Path, mode: str, platform: Platform | None) -> Iterator[Mistake]:
    initial = table.get("initial")
    if not isinstance(initial, dict) or platform is None:
        return
    stops = {gimbal.angle: gimbal.stops for gimbal in platform.gimbals}
    known = [*stops, *(f"{angle}_rate" for angle in stops), *(OMEGA_NAMES if mode == "stabilised" else ())]
    for key in initial:
        number, own = number_of(initial, key), (*path, "initial", key)
        if key not in known and key in OMEGA_NAMES:
            words = f"{key} = {given(initial[key])} has no effect: the rate of a caged platform is prescribed"
            yield Mistake(own, f'{words}; use Omega_table, or mode = "stabilised"')
        elif key not in known:
            yield Mistake(own, f"unknown key {given(key)}; {suggestion(key, known)}")
        elif key in OMEGA_NAMES:
            yield from _sizes(initial, (key,), "base-rate", (*path, "initial"))
        elif key in stops and stops[key] is None and number is not None and abs(number) > TURN:
            words = f"{key}: {number:g} rad is more than a turn"
            yield Mistake(own, f"{words}; angles are in rad: {number:g} degrees are {math.radians(number):.4g}")
        elif (bounds := stops.get(key)) is not None and number is not None and not bounds[0] <= number <= bounds[1]:
            words = f"{key} must be between the stops of the gimbal, {bounds[0]:.6g} to {bounds[1]:.6g} rad"
            yield Mistake(own, f"{words}, got {given(number)}")


def _fault(table: Data, path: Path, platform: Platform | None) -> Iterator[Mistake]:
    at, until = number_of(table, "at"), number_of(table, "until")
    if at is not None and until is not None and at >= until > 0:
        yield Mistake.wrong(table, path, "until", f"after at = {given(at)}")
    kind = text_of(table, "kind")
    if kind not in FAULT_KINDS:
        return
    keys = FAULT_KINDS[kind]
    for key in keys.needed:
        if key not in table:
            yield Mistake.missing(path, key, f"kind = {given(kind)} needs {', '.join(keys.needed)}")
    for key in sorted(FAULT_NUMBERS.keys() - {"at", *keys.keys}):
        if key in table:
            allowed = ", ".join(keys.keys) or "at alone"
            yield Mistake.useless(table, path, key, f"with kind = {given(kind)}, which takes {allowed}")
    part = text_of(table, "part")
    if keys.part is None:
        if "part" in table:
            words = f"part = {given(table['part'])} has no effect: kind = {given(kind)} is of all controllers"
            yield Mistake((*path, "part"), f"{words}; leave the key out")
    elif "part" not in table:
        yield Mistake.missing(path, "part", f"kind = {given(kind)} needs the name of {PART_WORDS[keys.part]}")
    elif part is not None and platform is not None:
        yield from _part(part, keys.part, path, platform)


def _part(part: str, kind: PartKind, path: Path, platform: Platform) -> Iterator[Mistake]:
    known = part_names(platform, kind)
    if part not in known:
        words = f"part must be the name of {PART_WORDS[kind]}, got {given(part)}; {suggestion(part, known)}"
        yield Mistake((*path, "part"), words)
    elif kind == "gimbal" and platform.gimbals[platform.gimbal(part)].stops is None:
        having = [gimbal.name for gimbal in platform.gimbals if gimbal.stops is not None]
        words = f"part must be a gimbal with stops, got {given(part)}; {suggestion(part, having)}"
        yield Mistake((*path, "part"), words)


def _commands(data: Data, manoeuvre: Data, path: Path, platform: Platform | None) -> Iterator[Mistake]:
    """Walk what is wrong with the commands of a manoeuvre."""
    for k, command in tables(manoeuvre, "command"):
        own: Path = (*path, "command", k)
        yield from _command_parts(command, own)
        yield from _command_times(data, manoeuvre, command, own)
        yield from _command_reading(data, command, own, platform)


def _command_parts(command: Data, path: Path) -> Iterator[Mistake]:
    if not any(key in command for key in _COMMANDS):
        yield Mistake.missing(path, "step", "a command needs step, ramp, amplitude with frequency_hz, or value with t")
    for key, beside in _COMMANDS.items():
        for needed in beside if key in command else ():
            if needed not in command:
                yield Mistake.missing(path, needed, f"{key} has no effect without it")
    if any(key in command for key in _COMMANDS):
        for key, of in _BESIDE.items():
            if key in command and not any(one in command for one in of):
                yield Mistake.useless(command, path, key, f"without {' or '.join(of)}; add it, or leave the key out")
    yield from of_length(command, "value", "t", path)


def _command_times(data: Data, manoeuvre: Data, command: Data, path: Path) -> Iterator[Mistake]:
    duration, at = number_of(manoeuvre, "duration"), number_of(command, "at")
    if duration is not None and at is not None and at >= duration > 0.0:
        yield Mistake.wrong(command, path, "at", f"before the end of the run, {duration:.6g} s")
    sampling = data.get("sampling")
    rate = number_of(sampling, "rate_hz") if isinstance(sampling, dict) else None
    frequency = number_of(command, "frequency_hz")
    if rate is not None and frequency is not None and frequency >= 0.5 * rate > 0.0:
        yield Mistake.wrong(command, path, "frequency_hz", f"below half the sample rate, {0.5 * rate:.6g} Hz")


def _command_reading(data: Data, command: Data, path: Path, platform: Platform | None) -> Iterator[Mistake]:
    reading = text_of(command, "reading")
    if reading is None or platform is None:
        return
    by_name = {sensor.name: sensor for sensor in platform.sensors}
    read = [
        name
        for _, loop in tables(data, "loop")
        if loop.get("kind") in ("rate", "pointing", "tracking") and isinstance(loop.get("sensors"), list)
        for name in loop["sensors"]
        if isinstance(name, str)
    ]
    if reading not in by_name:
        yield Mistake.unknown_name(path, "reading", reading, "sensor of the plant", by_name)
        return
    if reading not in read:
        use = suggestion(reading, read) if read else "add a rate or pointing loop that reads it"
        why = "read by no rate, pointing or tracking loop, and a caging loop holds its gimbals at zero"
        yield Mistake((*path, "reading"), f"reading: {given(reading)} is {why}; {use}")
    unit = by_name[reading].unit
    attitude = any(sensor.name == reading for sensor in platform.attitude_sensors)
    most = _SMALL_COMMAND if attitude else _LARGEST_COMMAND[unit]
    for key in ("step", "amplitude", "value"):
        values = command.get(key) if key == "value" else [command.get(key)]
        numbers = (
            [x for item in values if (x := number_of({"x": item}, "x")) is not None] if isinstance(values, list) else []
        )
        worst = max(map(abs, numbers), default=0.0)
        if worst > most:
            words = f"{key}: {worst:.6g} {unit} cannot be meant, at most {most:.4g} {unit}"
            why = "which reads small rotations" if attitude else "not in degrees"
            yield Mistake((*path, key), f"{words}; commands of {given(reading)} are in {unit}, {why}")
