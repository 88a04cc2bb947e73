"""The files that ``platform-ctrl new`` writes, and the starting values of a job like a plant."""

from __future__ import annotations

import json
import math
import textwrap
import tomllib
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.job.job import Job, LoopSpec
    from platform_ctrl.mechanics.linearisation import LinearModel

# How long the turn's rate rises, s.
RISE = 0.2
# Samples in a period of the fastest mode, and the slowest rate that is proposed, Hz.
_SAMPLES, _SLOWEST = 12.0, 1000.0
# Fastest turn that is proposed, rad/s; share of the torque limits that it may take; rms of noise in the same share.
_TURN, _TURN_SHARE, _NOISE_SHARE = 0.1, 0.3, 0.1
# Starting values are the method's defaults times halves of one, down to here. They have this much to spare: the tuner's
# reserve, so that it need not move far.
_HALVINGS, _ENOUGH = 8, 0.95
# Platform rates about each axis at which subsystems are looked for: both ends, as in a job.
_RATES = 2
_DISK_MARGIN, _LEAST_DISK_MARGIN = 0.3, 0.05


@value
class StartingLoop:
    """A caging loop with starting values."""

    gimbals: tuple[str, ...]  # A subsystem
    disk_margin: float  # Limit: 0.3, or what the starting values reach where that is less
    # torque_limit, torque_noise: The weakest torquer's limit and what noise may take of it, N m; None where no torquer
    # has a limit
    torque_limit: float | None
    torque_noise: float | None
    options: dict[str, float]  # Of the classical method, Hz


@value
class Start:
    """What a job for a plant can start from."""

    fastest_hz: float  # The plant's fastest mode, Hz
    rate_hz: float  # Sample rate, Hz
    # axis, rate: Root axis about which a turn torques the gyros most, and a rate for it, rad/s
    axis: int
    rate: float
    loops: tuple[StartingLoop, ...]  # One for each subsystem


def starting_loops(plant: dict[str, Any]) -> Start:
    """Return a start for the plant in a file's tables; all its gimbals have torquers and pick-offs.

    The starting values are the first, from fast to slow, with which a loop is stable and near its limits, or else the
    best: what the tuner finds its way from.
    """
    from platform_ctrl.design.cases import subsystems_over
    from platform_ctrl.job.reading import read_job
    from platform_ctrl.mechanics.linearisation import linearise
    from platform_ctrl.mechanics.state_space import state_space
    from platform_ctrl.plant.reading import read_platform

    platform = read_platform(plant)
    model = linearise(platform)
    fastest = float(np.abs(np.linalg.eigvals(state_space(model).A)).max(initial=0.0)) / (2.0 * math.pi)
    rate_hz = max(_round(_SAMPLES * fastest, up=True), _SLOWEST)
    limits = {one.gimbal: one.limit for one in platform.torquers if one.gimbal is not None and one.limit is not None}
    axis, rate = _turn(model, limits)
    bare = {
        "schema": 1,
        "name": "start",
        "plant": plant,
        "operation": {"Omega": [rate] * 3},
        "sampling": {"rate_hz": rate_hz, "delay": 1.0 / rate_hz},
        "loop": [
            {
                "name": " ".join(gimbals),
                "kind": "caging",
                "gimbals": list(gimbals),
                "use": "classical",
                "limits": {"disk_margin": _DISK_MARGIN} | _noise_limit(gimbals, limits),
                "design": [{"name": "classical", "method": "classical"}],
            }
            for gimbals in subsystems_over(platform, np.full(3, rate), _RATES)
        ],
    }
    job = read_job(bare)
    loops = tuple(_loop(job, spec, model, limits) for spec in job.loops)
    return Start(fastest_hz=fastest, rate_hz=rate_hz, axis=axis, rate=rate, loops=loops)


def _turn(model: LinearModel, limits: dict[str, float]) -> tuple[int, float]:
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
    return axis + 1, _round(min([_TURN, *rates]), up=False)


def _noise_limit(gimbals: tuple[str, ...], limits: dict[str, float]) -> dict[str, float]:
    known = [limits[name] for name in gimbals if name in limits]
    return {"torque_noise": _round(_NOISE_SHARE * min(known), up=False)} if known else {}


def _loop(job: Job, spec: LoopSpec, model: LinearModel, limits: dict[str, float]) -> StartingLoop:
    from platform_ctrl.design.cases import rows_of
    from platform_ctrl.design.classical.caging import classical_controller, starting_values
    from platform_ctrl.design.partition import channels
    from platform_ctrl.design.plants import plants_of
    from platform_ctrl.design.tuning import worst_ratio
    from platform_ctrl.job.requirements import loop_requirements

    plants = plants_of(job, spec)
    assert plants is not None, "a caging loop has plants"
    channel = channels(model, rows_of(model, spec.gimbals))
    requirements = loop_requirements(spec.limits)
    best: tuple[float, dict[str, float]] = (math.inf, {})
    for given in _tried(starting_values({}, channel, plants.nutation, plants.period)):
        complete = starting_values(given, channel, plants.nutation, plants.period)
        ratio = worst_ratio(classical_controller(complete, channel, plants.period), plants, requirements)
        if ratio < best[0]:
            best = (ratio, given)
        if ratio <= _ENOUGH:
            break
    reached = _DISK_MARGIN if best[0] <= 1.0 else _round(_ENOUGH * _DISK_MARGIN / best[0], up=False)
    return StartingLoop(
        gimbals=spec.gimbals,
        torque_limit=min((limits[name] for name in spec.gimbals if name in limits), default=None),
        torque_noise=spec.limits.get("torque_noise"),
        disk_margin=max(reached, _LEAST_DISK_MARGIN),
        options=best[1],
    )


def _tried(default: dict[str, float]) -> Iterator[dict[str, float]]:
    """Go through starting values, from fast to slow: the roll-off stays where it is."""
    moved = [name for name in default if "rolloff" not in name]
    for halvings in range(_HALVINGS + 1):
        yield {name: float(f"{default[name] * 0.5**halvings:.2g}") for name in moved}


def _round(number: float, *, up: bool) -> float:
    """Return the next of 1, 2, 5, 10, ... above or below a positive number, in its decade."""
    if not number > 0.0:
        return 0.0
    decade = 10.0 ** math.floor(math.log10(number))
    steps, slack = [step * decade for step in (0.5, 1.0, 2.0, 5.0, 10.0)], 1e-9 * number
    chosen = min(x for x in steps if x >= number - slack) if up else max(x for x in steps if x <= number + slack)
    return float(f"{chosen:.1g}")


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
    added: tuple[str, ...] = ()  # What was added to the plant that it was taken from, a line each


def own_start(name: str, plant_file: str, job_file: str) -> StartingFiles:
    """Return a plant with one gyro in two gimbals and its job: a caging loop, limits, a manoeuvre and a campaign."""
    words = {"name": name, "plant_file": plant_file, "job_file": job_file}
    job = _filled("job.toml.j2", **words)
    names = tuple(loop["name"] for loop in tomllib.loads(job)["loop"])
    return StartingFiles(plant=_filled("plant.toml.j2", **words), job=job, loops=names)


def start_like(
    model: str, name: str, plant_file: str, job_file: str, say: Callable[[str], None] = lambda line: None
) -> StartingFiles:
    """Return the text of an existing plant, shipped or a file, and a job with a caging loop for each of its subsystems.

    A caging loop needs a torquer and a pick-off on each of its gimbals: missing ones are added.
    """
    from platform_ctrl.job.reading import read_job
    from platform_ctrl.plant.reading import read_platform

    platform = read_platform(model)
    if not platform.gimbals:
        raise InputError(f"--like {model}: this plant has no gimbals to cage; choose another one")
    text = _text_of(model)
    plain = tomllib.loads(text)
    text, added = _with_instruments(text, plain)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise InputError(
            f"--like {model}: {', '.join(added)} must be added, but cannot; write every [[torquer]] and [[pickoff]] "
            "as its own table"
        ) from None
    say(f"starting values of the loops: {platform.name}")
    start = starting_loops(data)
    names = ["caging " + "-".join(loop.gimbals) for loop in start.loops]
    job = _job_like(start, names, data, name=name, plant_file=plant_file, job_file=job_file)
    # What is handed out has been read.
    read_job(tomllib.loads(job) | {"plant": data})
    return StartingFiles(plant=text, job=job, loops=tuple(names), added=added)


def _text_of(model: str) -> str:
    from platform_ctrl.plant.source import is_shipped_name, platform_source, read_text

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
        axis_reason="where a turn needs the most torque of the gimbals",
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
