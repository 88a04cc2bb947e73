"""A commented plant and a job for it to start from: one of our own, or like a plant that exists."""

from __future__ import annotations

import json
import textwrap
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.errors import InputError
from platform_ctrl.frozen import value

if TYPE_CHECKING:
    from platform_ctrl.cli.starting_loops import Start

# Where comments begin in the files.
_COMMENT = 39
_WIDTH = 118


@value
class StartingFiles:
    """Two files that belong together.

    Attributes
    ----------
    plant, job
        Their texts; the job names the plant's file.
    loops
        Names of the job's loops.
    added
        What was added to the plant that it was taken from, a line each.
    """

    plant: str
    job: str
    loops: tuple[str, ...]
    added: tuple[str, ...] = ()


def own_start(name: str, plant_file: str, job_file: str) -> StartingFiles:
    """Return one gyro in two gimbals and its caging loop, with limits, a manoeuvre and a campaign.

    Parameters
    ----------
    name
        Title of both.
    plant_file, job_file
        What the files will be called.
    """
    words = {"name": name, "plant_file": plant_file, "job_file": job_file}
    job = _filled("job.toml.j2", **words)
    names = tuple(loop["name"] for loop in tomllib.loads(job)["loop"])
    return StartingFiles(plant=_filled("plant.toml.j2", **words), job=job, loops=names)


def start_like(
    model: str, name: str, plant_file: str, job_file: str, say: Callable[[str], None] = lambda line: None
) -> StartingFiles:
    """Return the text of a plant that exists, and a job with a caging loop for each of its subsystems.

    A caging loop needs a torquer and a pick-off on each of its gimbals: those that the plant does not have are added.

    Parameters
    ----------
    model
        A shipped plant's name, or the path of a plant file.
    name, plant_file, job_file
        As in `own_start`.
    say
        Called with a line before the longer part of the work.

    Raises
    ------
    InputError
        There is no such plant, it makes no sense, or has no gimbals.
    """
    from platform_ctrl.cli.starting_loops import starting_loops
    from platform_ctrl.reading import read_job, read_platform

    platform = read_platform(model)
    if not platform.gimbals:
        raise InputError(f"--like {model}: this plant has no gimbals; expected one with something to cage")
    text = _text_of(model)
    plain = tomllib.loads(text)
    text, added = _with_instruments(text, plain)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise InputError(
            f"--like {model}: {', '.join(added)} would have to be added; expected every [[torquer]] and [[pickoff]] as "
            "a table of its own"
        ) from None
    say(f"starting values of the loops: {platform.name}")
    start = starting_loops(data)
    names = ["caging " + "-".join(loop.gimbals) for loop in start.loops]
    job = _job_like(start, names, data, name=name, plant_file=plant_file, job_file=job_file)
    # What is handed out has been read.
    read_job(tomllib.loads(job) | {"plant": data})
    return StartingFiles(plant=text, job=job, loops=tuple(names), added=added)


def _text_of(model: str) -> str:
    from platform_ctrl.reading import platform_source
    from platform_ctrl.reading.source import is_shipped_name, read_text

    if is_shipped_name(model):
        return platform_source(model)
    return read_text(Path(model), "a TOML file").replace("\r\n", "\n")


def _with_instruments(text: str, plant: dict[str, Any]) -> tuple[str, tuple[str, ...]]:
    """Return a plant's text with a torquer and a pick-off on every gimbal, and what was added."""
    added, more = [], []
    for kind, word in (("torquer", "torquer"), ("pickoff", "pick-off")):
        there = {table.get("gimbal") for table in plant.get(kind, [])}
        for gimbal in plant["gimbal"]:
            if gimbal["name"] not in there:
                added.append(f"a {word} on {gimbal['name']}")
                more.append(f"[[{kind}]]\ngimbal = {_text(gimbal['name'])}\nadded = true\n")
    if not added:
        return text, ()
    reason = (
        "# Added by `platform-ctrl new`, not part of the plant that this file was taken from: a caging loop needs a\n"
        "# torquer and a pick-off on each of its gimbals. `added` makes every verdict and report say so.\n"
    )
    return f"{text.rstrip()}\n\n{reason}" + "\n".join(more), tuple(added)


def _job_like(start: Start, names: list[str], plant: dict[str, Any], **words: str) -> str:
    from platform_ctrl.cli.starting_loops import RISE

    fast = f"{start.fastest_hz:.3g} Hz"
    spinning = [rotor for rotor in plant.get("rotor", []) if rotor.get("spin") or rotor.get("angular_momentum")]
    varied = [(r["name"], "spin" if "spin" in r else "angular_momentum") for r in spinning]
    loops = [
        {
            "name": _text(name),
            "gimbals": ", ".join(map(_text, loop.gimbals)),
            "disk_margin": f"{loop.disk_margin:g}",
            "allowed": _allowed(loop.disk_margin),
            "torque_limit": None if loop.torque_limit is None else f"{loop.torque_limit:g}",
            "torque_noise": None if loop.torque_noise is None else f"{loop.torque_noise:g}",
            "options": [(option, f"{number:g}") for option, number in loop.options.items()],
        }
        for name, loop in zip(names, start.loops, strict=True)
    ]
    return _filled(
        "job_like.toml.j2",
        **words,
        root=plant["root"]["name"],
        rate=f"{start.rate:g}",
        rate_hz=f"{start.rate_hz:.0f}",
        rate_reason=f"the fastest mode of the plant has {fast}" if start.fastest_hz > 0.0 else "assumed",
        delay=f"{1.0 / start.rate_hz:g}",
        axis=str(start.axis),
        axis_reason="where a turn asks the most torque of the gimbals",
        rise=f"{RISE:g}",
        loops=loops,
        rotors=[_text(f"rotor.{rotor}.{key}") for rotor, key in varied],
    )


def _allowed(margin: float) -> str:
    """Say what a disk margin allows in every channel, in ASCII."""
    from platform_ctrl.report.quantities import disk_words

    return disk_words(margin).replace("×", "x").replace("±", "+-").replace("°", " degrees")


def _text(item: str) -> str:
    """Return a name as TOML: of printable characters, what JSON writes is that."""
    return json.dumps(item, ensure_ascii=False)


def _filled(template: str, **words: object) -> str:
    import jinja2

    environment = jinja2.Environment(
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["noted"] = _noted
    source = (resources.files("platform_ctrl.cli") / "templates" / template).read_text(encoding="utf-8")
    return environment.from_string(source).render(words)


def _noted(code: str, comment: str, mark: str = "# ", column: int = _COMMENT) -> str:
    """Return a line with a comment that begins in a column, or behind what is too long; a long one is wrapped."""
    room = max(_WIDTH - max(len(code) + 1, column), _WIDTH // 2)
    first, *more = textwrap.wrap(comment, room) if mark == "# " else [comment]
    return "\n".join([f"{code:<{column - 1}} {mark}{first}", *(f"{'':<{column}}{mark}{line}" for line in more)])
