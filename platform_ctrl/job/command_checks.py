"""What must fit together about the commands of a simulated run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from platform_ctrl.plant.checks import number_of
from platform_ctrl.plant.mistakes import Mistake, Path, given, suggestion, tables, text_of
from platform_ctrl.plant.platform import Platform

Data = dict[str, Any]

# The keys that make a command: each with what it needs beside it, and what may stand there too.
_PARTS = {"step": (), "ramp": (), "amplitude": ("frequency_hz",), "value": ("t",)}
_WITH = {
    "at": ("step", "ramp"),
    "frequency_hz": ("amplitude",),
    "phase": ("amplitude",),
    "t": ("value",),
    "smooth": ("value",),
}
# Largest command that can be meant, by the reading's unit: a turn; a hundred radians in a second. An attitude sensor
# reads the sine of an angle (see `plant.sensors`), 4 % less than this one.
_LARGEST, _SMALL = {"rad": 2.0 * math.pi, "rad/s": 100.0}, 0.5


def command_mistakes(data: Data, manoeuvre: Data, path: Path, platform: Platform | None) -> Iterator[Mistake]:
    """Walk what is wrong with the commands of a manoeuvre."""
    for k, command in tables(manoeuvre, "command"):
        own: Path = (*path, "command", k)
        yield from _parts(command, own)
        yield from _times(data, manoeuvre, command, own)
        yield from _reading(data, command, own, platform)


def _parts(command: Data, path: Path) -> Iterator[Mistake]:
    if not any(key in command for key in _PARTS):
        words = "a command needs step, ramp, amplitude with frequency_hz, or value with t"
        yield Mistake((*path, "step"), f'the key "step" is missing; {words}')
    for key, beside in _PARTS.items():
        for needed in beside if key in command else ():
            if needed not in command:
                yield Mistake((*path, needed), f'the key "{needed}" is missing; {key} has no effect without it')
    if any(key in command for key in _PARTS):
        for key, of in _WITH.items():
            if key in command and not any(one in command for one in of):
                words = f"{key} = {given(command[key])} has no effect without {' or '.join(of)}"
                yield Mistake((*path, key), f"{words}; add it, or leave the key out")
    t, value = command.get("t"), command.get("value")
    if isinstance(t, list) and isinstance(value, list) and len(t) != len(value):
        words = f"value must have as many elements as t, {len(t)}, got {len(value)}"
        yield Mistake((*path, "value"), words)


def _times(data: Data, manoeuvre: Data, command: Data, path: Path) -> Iterator[Mistake]:
    duration, at = number_of(manoeuvre, "duration"), number_of(command, "at")
    if duration is not None and at is not None and at >= duration > 0.0:
        words = f"at must be before the end of the run, {duration:.6g} s, got {given(command['at'])}"
        yield Mistake((*path, "at"), words)
    sampling = data.get("sampling")
    rate = number_of(sampling, "rate_hz") if isinstance(sampling, dict) else None
    frequency = number_of(command, "frequency_hz")
    if rate is not None and frequency is not None and frequency >= 0.5 * rate > 0.0:
        words = f"frequency_hz must be below half the sample rate, {0.5 * rate:.6g} Hz, got {given(frequency)}"
        yield Mistake((*path, "frequency_hz"), words)


def _reading(data: Data, command: Data, path: Path, platform: Platform | None) -> Iterator[Mistake]:
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
    words = f"reading: {given(reading)} is"
    if reading not in by_name:
        yield Mistake((*path, "reading"), f"{words} no sensor of the plant; {suggestion(reading, by_name)}")
        return
    if reading not in read:
        use = suggestion(reading, read) if read else "add a rate or pointing loop that reads it"
        why = "read by no rate, pointing or tracking loop, and a caging loop holds its gimbals at zero"
        yield Mistake((*path, "reading"), f"{words} {why}; {use}")
    unit = by_name[reading].unit
    attitude = any(sensor.name == reading for sensor in platform.attitude_sensors)
    most = _SMALL if attitude else _LARGEST[unit]
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
