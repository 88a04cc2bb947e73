"""What must fit together in what a design reads: its own sensors, and feedforward of the platform's rate."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path as FilePath
from typing import Any

from platform_ctrl.common.values import replaced
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.job import Job
from platform_ctrl.job.methods import METHODS, resolved
from platform_ctrl.plant.checks import number_of
from platform_ctrl.plant.mistakes import Mistake, Path, given, one_line, suggestion, tables, text_of
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.source import read_text

Data = dict[str, Any]

# Keys of a design that are about signals, and the loops whose designs have them.
DESIGN_SIGNALS = ("sensors", "feedforward")
_KINDS = ("rate", "pointing")


def names_of(table: Data, key: str) -> list[str]:
    """Return the names that stand under a key, as far as they are text."""
    names = table.get(key, [])
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def sensor_mistakes(table: Data, path: Path, kind: str, platform: Platform) -> Iterator[Mistake]:
    """Judge the sensors that a rate or pointing loop, or one of its designs, reads."""
    unit = "rad/s" if kind == "rate" else "rad"
    fitting = [sensor.name for sensor in platform.sensors if sensor.unit == unit]
    every = [sensor.name for sensor in platform.sensors]
    for name in names_of(table, "sensors"):
        if name in fitting:
            continue
        what = (
            f"measures {'an angle' if unit == 'rad/s' else 'a rate'}" if name in every else "is no sensor of the plant"
        )
        wanted = f"a {kind} loop reads sensors of {'rates' if unit == 'rad/s' else 'angles'}"
        yield Mistake((*path, "sensors"), f"sensors: {given(name)} {what}; {wanted}; {suggestion(name, fitting)}")


def design_signal_mistakes(data: Data, platform: Platform | None) -> Iterator[Mistake]:
    """Judge the signals of all designs of a job."""
    for i, loop in tables(data, "loop"):
        kind = text_of(loop, "kind")
        for k, design in tables(loop, "design"):
            path: Path = ("loop", i, "design", k)
            given_keys = [key for key in DESIGN_SIGNALS if key in design]
            if kind is not None and kind not in _KINDS:
                for key in given_keys:
                    words = (
                        f"{key} belongs to designs of rate and pointing loops alone; leave it out of this {kind} loop"
                    )
                    yield Mistake((*path, key), words)
                continue
            if kind is None:
                continue
            if platform is not None:
                yield from sensor_mistakes(design, path, kind, platform)
            fed = design.get("feedforward")
            if isinstance(fed, dict):
                yield from _feedforward(fed, (*path, "feedforward"), platform, data)


def with_responses(job: Job, folder: FilePath) -> tuple[Job, list[Mistake]]:
    """Return a job with the texts of its files of measured responses, and what is wrong with them.

    What has more than one line is such a text already, as in a job that was written with all its inputs.
    """
    mistakes: list[Mistake] = []
    loops = []
    for i, spec in enumerate(job.loops):
        designs = []
        for k, design in enumerate(spec.designs):
            given_text, judge = design.responses, METHODS[design.method].responses
            if given_text is not None and judge is not None:
                try:
                    inside = "\n" in given_text
                    label = "the text" if inside else one_line(str(folder / given_text))
                    text = given_text if inside else read_text(folder / given_text, "a CSV file")
                    resolved(judge)(job, spec, design, text, label)
                    design = replaced(design, {"responses": text})
                except (InputError, ArgumentError) as error:
                    mistakes.append(Mistake(("loop", i, "design", k, "responses"), f"responses: {error}"))
            designs.append(design)
        loops.append(replaced(spec, {"designs": tuple(designs)}))
    return replaced(job, {"loops": tuple(loops)}), mistakes


def _feedforward(fed: Data, path: Path, platform: Platform | None, data: Data) -> Iterator[Mistake]:
    if "sensors" in fed and not names_of(fed, "sensors"):
        yield Mistake((*path, "sensors"), "sensors must be a list of names, rate sensors of the root")
    if text_of(fed, "into") == "reading" and "bandwidth_hz" in fed:
        yield Mistake.useless(fed, path, "bandwidth_hz", 'with into = "reading"; leave the key out')
    sampling = data.get("sampling")
    rate = number_of(sampling, "rate_hz") if isinstance(sampling, dict) else None
    bandwidth = number_of(fed, "bandwidth_hz")
    if rate is not None and bandwidth is not None and bandwidth >= 0.5 * rate > 0.0:
        yield Mistake.wrong(fed, path, "bandwidth_hz", f"below half the sample rate, {0.5 * rate:g} Hz")
    if platform is None:
        return
    sensors = {sensor.name: sensor for sensor in platform.sensors}
    fitting = [
        sensor.name
        for sensor in platform.sensors
        if sensor.unit == "rad/s" and set(sensor.signals(platform)) <= set(OMEGA_NAMES)
    ]
    names = names_of(fed, "sensors")
    for k, name in enumerate(names):
        if name not in sensors:
            yield Mistake.unknown_name(path, "sensors", name, "sensor of the plant", fitting)
        elif name not in fitting:
            words = f"sensors: {given(name)} does not measure a rate of the root alone: torquers move what it reads"
            yield Mistake((*path, "sensors"), f"{words}; {suggestion(name, fitting)}")
        elif name in names[:k]:
            yield Mistake((*path, "sensors"), f"sensors: {given(name)} is in the list twice; leave one of them out")
