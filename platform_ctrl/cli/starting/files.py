"""The text of the files that ``platform-ctrl new`` writes."""

from __future__ import annotations

import json
import re
import textwrap
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl.cli.starting.kinds import KINDS, known_kinds
from platform_ctrl.cli.starting.loops import RISE
from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.cli.starting.loops import Start, StartingLoop, StartingRun
    from platform_ctrl.cli.starting.purpose import PlannedLoop

# Where comments begin in the files.
_COMMENT = 39
_WIDTH = 118


@value
class StartingFiles:
    """Two files that belong together."""

    # plant, job: Their texts; the job names the plant's file
    plant: str
    job: str
    loops: tuple[str, ...]  # Names of the job's loops
    run: str  # Name of its first manoeuvre
    added: tuple[str, ...] = ()  # What was added to the plant that it was taken from, a line each


def own_start(name: str, plant_file: str, job_file: str) -> StartingFiles:
    """Return a plant with one gyro in two gimbals and its job: a caging loop, limits, a manoeuvre and a campaign."""
    words = {"name": name, "plant_file": plant_file, "job_file": job_file}
    job = _filled("job.toml.j2", **words)
    read = tomllib.loads(job)
    names = tuple(loop["name"] for loop in read["loop"])
    return StartingFiles(
        plant=_filled("plant.toml.j2", **words), job=job, loops=names, run=read["manoeuvre"][0]["name"]
    )


def start_of(
    kind: str, name: str, plant_file: str, job_file: str, say: Callable[[str], None] = lambda line: None
) -> StartingFiles:
    """Return a start of a kind: the plant of `KINDS` and a job for it."""
    if kind not in KINDS:
        raise InputError(f"--kind {kind}: must be one of {known_kinds()}")
    plant = KINDS[kind].plant
    if plant is None:
        return own_start(name, plant_file, job_file)
    return start_like(plant, name, plant_file, job_file, say)


def start_like(
    model: str, name: str, plant_file: str, job_file: str, say: Callable[[str], None] = lambda line: None
) -> StartingFiles:
    """Return the text of an existing plant, shipped or a file, and a job with the loops that it is for.

    Torquers and sensors that these loops need and the plant does not have are added.
    """
    from platform_ctrl.cli.starting.loops import starting_loops
    from platform_ctrl.cli.starting.purpose import planned_loops
    from platform_ctrl.job.reading import read_job
    from platform_ctrl.plant.reading import read_platform

    platform = read_platform(model)
    if not platform.gimbals:
        raise InputError(f"--like {model}: this plant has no gimbals to control; choose another one")
    text = _text_of(model)
    plain = tomllib.loads(text)
    plans = planned_loops(platform)
    text, added = _with_instruments(text, plain, plans)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise InputError(
            f"--like {model}: {', '.join(added)} must be added, but cannot; write every [[torquer]] and [[pickoff]] "
            "as its own table"
        ) from None
    say(f"starting values of the loops: {platform.name}")
    start = starting_loops(data, plans)
    job = _job_like(start, data, name=name, plant_file=plant_file, job_file=job_file)
    # What is handed out has been read.
    made = read_job(tomllib.loads(job) | {"plant": data})
    return StartingFiles(
        plant=text, job=job, loops=tuple(loop.name for loop in made.loops), run=made.manoeuvres[0].name, added=added
    )


def job_alone(model: str, folder: Path, say: Callable[[str], None] = lambda line: None) -> str:
    """Return the job of `start_like` for a file in `folder`: it names the plant, or has it where parts were added."""
    import os

    import tomlkit

    from platform_ctrl.plant.source import is_shipped_name

    shipped = is_shipped_name(model)
    name = model if shipped else Path(model).stem
    plant = model if shipped else Path(os.path.relpath(Path(model).resolve(), folder.resolve())).as_posix()
    made = start_like(model, name, plant, f"{name}.toml", say)
    if not made.added:
        return made.job
    document = tomlkit.parse(made.job)
    # At the end: keys of the job after it would belong to the plant.
    del document["plant"]
    document.add("plant", tomlkit.item(tomllib.loads(made.plant)))
    return str(tomlkit.dumps(document))


def _text_of(model: str) -> str:
    from platform_ctrl.plant.source import is_shipped_name, platform_source, read_text

    if is_shipped_name(model):
        return platform_source(model)
    return read_text(Path(model), "a TOML file").replace("\r\n", "\n")


def _with_instruments(text: str, plant: dict[str, Any], plans: tuple[PlannedLoop, ...]) -> tuple[str, tuple[str, ...]]:
    """Return a plant's text with the torquers and pick-offs that its loops need, and what was added.

    A loop that reads inertial sensors needs no pick-offs; one with torquers of its own needs these alone.
    """
    turned = {f"Q{name}": name for plan in plans for name in plan.gimbals}
    read = {name for plan in plans if plan.against == "base" for name in plan.gimbals}
    driven = {name for plan in plans if not plan.torquers for name in plan.gimbals}
    driven |= {turned[name] for plan in plans for name in plan.torquers if name in turned}
    added, more = [], []
    for kind, word, needed in (("torquer", "torquer", driven), ("pickoff", "pick-off", read)):
        there = {table.get("gimbal") for table in plant.get(kind, [])}
        for gimbal in plant["gimbal"]:
            if gimbal["name"] in needed - there:
                added.append(f"a {word} on {gimbal['name']}")
                more.append(f"[[{kind}]]\ngimbal = {_text(gimbal['name'])}\nadded = true\n")
    if not added:
        return text, ()
    reason = (
        "# Added by `platform-ctrl new`, not part of the plant that this file was taken from: its loops need them.\n"
        "# `added` makes every verdict and report say so.\n"
    )
    return f"{text.rstrip()}\n\n{reason}" + "\n".join(more), tuple(added)


def _job_like(start: Start, plant: dict[str, Any], **words: str) -> str:
    spinning = [rotor for rotor in plant.get("rotor", []) if rotor.get("spin") or rotor.get("angular_momentum")]
    varied = [(f"rotor.{r['name']}.{'spin' if 'spin' in r else 'angular_momentum'}") for r in spinning]
    held = [name for loop in start.loops if loop.plan.kind in ("rate", "pointing") for name in loop.plan.gimbals]
    return _filled(
        "job_like.toml.j2",
        **words,
        root=plant["root"]["name"],
        start=start,
        rate=f"{start.rate:g}",
        rate_hz=f"{start.rate_hz:.0f}",
        rate_reason=start.rate_reason,
        delay=f"{1.0 / start.rate_hz:g}",
        angles=[f"{_key(name)} = [{low:g}, {high:g}]" for name, (low, high) in start.angles.items()],
        loops=[_shown_loop(loop) for loop in start.loops],
        runs=[_shown_run(run) for run in start.runs],
        rise=f"{RISE:g}",
        spinning=bool(spinning),
        parameters=[_text(path) for path in (*varied, *(f"gimbal.{name}.inertia" for name in held))],
        turns=start.runs[0].form == "turn",
        shaken=next((run.axes for run in start.runs if "attenuation_db" in run.limits), ()),
    )


def _shown_run(run: StartingRun) -> dict[str, Any]:
    return {
        "name": run.name,
        "form": run.form,
        "axes": run.axes,
        "number": f"{run.size:g}",
        "frequency": f"{run.frequency_hz:g}",
        "balanced": run.balanced,
        "settled": f"{0.5 * run.duration:g}",
        "length": f"{run.duration:g}",
        "limits": [(key, f"{number:g}", _LIMITS[key]) for key, number in run.limits.items()],
    }


_LIMITS = {
    "angle": "at most: gimbal angle, rad",
    "attitude": "at most: angle of the platform, rad",
    "torque_share": "at most: torque over the torquer's limit",
    "attenuation_db": "at least: motion of the base over what is left of it in the line of sight, rms",
}


# What a loop does, by its kind and what it reads.
_TASKS = {
    "caging": "holds its gimbals at zero",
    "rate": "holds still against inertial space what the sensors are on",
    "pointing": "holds the angles that it reads at zero",
    "stabilisation": "holds the platform still: rates from the torques of the caged gyros, angles by integration",
}


def _shown_loop(loop: StartingLoop) -> dict[str, Any]:
    """Return a loop's keys, each with what it is."""
    plan, weakest = loop.plan, loop.torque_limit
    lines = [("kind", _text(plan.kind), _TASKS[plan.kind])]
    for key, names in (("gimbals", plan.gimbals), ("torquers", plan.torquers), ("sensors", plan.sensors)):
        if names:
            what = {"gimbals": "whose torquers it uses", "torquers": "that it uses", "sensors": "that it reads"}[key]
            lines.append((key, f"[{', '.join(map(_text, names))}]", what if plan.kind != "caging" else ""))
    title = {"caging": "caging", "rate": "rate", "pointing": "pointing"}.get(plan.kind)
    name = plan.kind if title is None else f"{title} {'-'.join(plan.gimbals)}"
    use = "servo" if title is None else "PI" if loop.method == "pi" else "classical"
    return {
        "name": _text(name),
        "lines": lines,
        "use": _text(use),
        "method": _text(loop.method),
        "tuned": plan.kind != "stabilisation",
        "limits": [(key, f"{number:g}", _meaning(key, number, weakest)) for key, number in loop.limits.items()],
        "options": [(option, f"{number:g}", _OPTIONS.get(option, "")) for option, number in loop.options.items()],
    }


_OPTIONS = {
    "integral_hz": "below it the integral acts",
    "crossover_hz": "where the loop crosses over",
    "damping_hz": "direct-axis gain on the first axis: damps nutation",
    "damping2_hz": "on the second axis",
    "lead_hz": "zero of the direct-axis lead",
    "inertial_crossover_hz": "where the loop crosses over that no gyro stiffens",
    "inertial_lead_hz": "zero of its lead",
    "inertial_rolloff_hz": "pole of its lead",
    "position_hz": "below it the angle is held, above it the rate",
}


def _meaning(key: str, number: float, weakest: float | None) -> str:
    if key.startswith("disk_margin"):
        worst = ", with every plant of the uncertainty and all angles" if key.endswith("worst_case") else ""
        return f"at least: {_allowed(number)}{worst}"
    return {
        "torque_noise": f"at most, N m rms; the weakest torquer has {weakest or 0.0:g} N m",
        "attenuation_db_worst_case": "at least: base motion over what is left of it in the line of sight",
        "attenuation_hz": "up to this frequency",
        "bandwidth_hz": "at least",
    }[key]


def _allowed(margin: float) -> str:
    """Say what a disk margin allows in every channel, in ASCII."""
    from platform_ctrl.job.quantities import disk_words

    return disk_words(margin).replace("×", "x").replace("±", "+-").replace("°", " degrees")


def _text(item: str) -> str:
    """Return a name as TOML: of printable characters, what JSON writes is that."""
    return json.dumps(item, ensure_ascii=False)


def _key(name: str) -> str:
    """Return a name as a TOML key."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)


def _filled(template: str, **words: object) -> str:
    import jinja2

    environment = jinja2.Environment(
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["noted"] = _noted
    environment.filters["toml"] = _text
    source = (resources.files("platform_ctrl.cli") / "templates" / template).read_text(encoding="utf-8")
    return environment.from_string(source).render(words)


def _noted(code: str, comment: str, mark: str = "# ", column: int = _COMMENT) -> str:
    """Return a line with a comment, if any, in a column or behind what is too long; a long one is wrapped."""
    if not comment:
        return code
    room = max(_WIDTH - max(len(code) + 1, column), _WIDTH // 2)
    first, *more = textwrap.wrap(comment, room) if mark == "# " else [comment]
    return "\n".join([f"{code:<{column - 1}} {mark}{first}", *(f"{'':<{column}}{mark}{line}" for line in more)])
