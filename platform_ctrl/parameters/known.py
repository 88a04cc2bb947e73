"""The numbers of a run by their paths: which there are, where they stand, what they may be, and what they are now."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from platform_ctrl.arguments import nearest
from platform_ctrl.description import OMEGA_NAMES, Platform
from platform_ctrl.frozen import value
from platform_ctrl.scenario import FAULT_KEYS, Fault, Scenario
from platform_ctrl.signatures import check_arguments
from platform_ctrl.variation import ANY, NOT_NEGATIVE, POSITIVE, SHARE, Range

_SENSOR = {"noise_rms": NOT_NEGATIVE, "noise_bandwidth_hz": POSITIVE, "quantisation": NOT_NEGATIVE}
# Arrays of the plant: (the path's first word, field of Platform, what a part is called by, its numbers).
_PARTS: tuple[tuple[str, str, str, dict[str, Range]], ...] = (
    ("gimbal", "gimbals", "name", {"inertia": POSITIVE, "restitution": SHARE}),
    (
        "rotor",
        "rotors",
        "name",
        {"spin": ANY, "angular_momentum": ANY, "axial_inertia": POSITIVE, "transverse_inertia": POSITIVE},
    ),
    (
        "torquer",
        "torquers",
        "name",
        {"limit": POSITIVE, "lag": NOT_NEGATIVE, "rate_limit": POSITIVE, "gain": NOT_NEGATIVE},
    ),
    ("pickoff", "pickoffs", "name", _SENSOR),
    ("rate_sensor", "rate_sensors", "name", _SENSOR),
    ("spring", "springs", "gimbal", {"stiffness": ANY, "rest": ANY}),
    (
        "friction",
        "frictions",
        "gimbal",
        {
            "viscous": NOT_NEGATIVE,
            "coulomb": NOT_NEGATIVE,
            "coulomb_rate": POSITIVE,
            "breakaway": NOT_NEGATIVE,
            "stribeck_rate": POSITIVE,
        },
    ),
    (
        "cage",
        "cages",
        "gimbal",
        {"stiffness": POSITIVE, "damping": NOT_NEGATIVE, "clearance": NOT_NEGATIVE, "angle": ANY},
    ),
    ("erection", "erections", "gimbal", {"gain": ANY, "limit": POSITIVE}),
)
_FAULT_RANGES = {
    "at": NOT_NEGATIVE,
    "until": POSITIVE,
    "share": NOT_NEGATIVE,
    "time_constant": POSITIVE,
    "amplitude": POSITIVE,
    "frequency_hz": POSITIVE,
    "rate": ANY,
    "probability": SHARE,
    "impulse": ANY,
}
_MANOEUVRE_RANGES = {
    "rate": ANY,
    "rise": POSITIVE,
    "hold": NOT_NEGATIVE,
    "torque": ANY,
    "Omega_scale": ANY,
    "torque_scale": ANY,
}


@value
class Parameter:
    """A number of a run.

    Attributes
    ----------
    path
        What a job file calls it.
    group, index
        Where it stands: the plant's array and the place in it, or one of ``"root"``, ``"unbalances"``, ``"sampling"``,
        ``"initial"``, ``"manoeuvre"``, ``"fault"``, ``"vibration"``; `index` is −1 for an unbalance that the plant
        lacks.
    part, key
        Name of the part or fault; the number of it that is meant.
    allowed
        What it may be; of a factor: what the factor may be.
    factor
        Whether it multiplies something that is more than a number (an inertia matrix, a table) and is 1 as it stands.

    References
    ----------
    See docs/job-file.md.
    """

    path: str
    group: str
    key: str
    part: str = ""
    index: int = 0
    allowed: Range
    factor: bool = False


@check_arguments
def parameters(scenarios: Sequence[Scenario], faults: Sequence[Fault]) -> dict[str, Parameter]:
    """Return what may be varied, by its path.

    Parameters
    ----------
    scenarios
        The runs as they stand, all of one plant: one for each manoeuvre that is flown.
    faults
        What may fail in them.

    Returns
    -------
    dict
        What the number is and what it may be, by its path.

    Raises
    ------
    ArgumentError
        An argument of another kind than annotated.

    References
    ----------
    See docs/job-file.md.
    """
    if not scenarios:
        return {}
    found = [
        *_of_plant(scenarios[0].platform),
        Parameter(path="sampling.delay", group="sampling", key="delay", allowed=NOT_NEGATIVE),
        *_initial(scenarios),
        *_of_manoeuvres(scenarios),
        *(
            Parameter(path=f"fault.{f.name}.{key}", group="fault", part=f.name, key=key, allowed=_FAULT_RANGES[key])
            for f in faults
            for key in ("at", *FAULT_KEYS[f.kind].needed, *FAULT_KEYS[f.kind].optional)
        ),
    ]
    return {one.path: one for one in found}


def _of_plant(platform: Platform) -> Iterator[Parameter]:
    yield Parameter(path="root.inertia", group="root", key="inertia", allowed=POSITIVE, factor=True)
    for axis in (1, 2, 3):
        key = f"specific_force{axis}"
        yield Parameter(path=f"root.{key}", group="root", key=key, index=axis - 1, allowed=ANY)
    for word, group, called, numbers in _PARTS:
        taken: dict[str, int] = {}
        for k, part in enumerate(getattr(platform, group)):
            name = getattr(part, called)
            taken[name] = taken.get(name, 0) + 1
            title = name if taken[name] == 1 else f"{name}#{taken[name]}"
            for key, allowed in numbers.items():
                if not _there(part, key):
                    continue
                yield Parameter(
                    path=f"{word}.{title}.{key}",
                    group=group,
                    part=name,
                    key=key,
                    index=k,
                    allowed=allowed,
                    factor=key == "inertia" or (group, key) == ("torquers", "gain"),
                )
    having = {one.body: k for k, one in reversed([*enumerate(platform.unbalances)])}
    for body in (platform.root_name, *platform.gimbal_names):
        for axis in (1, 2, 3):
            yield Parameter(
                path=f"unbalance.{body}.moment{axis}",
                group="unbalances",
                part=body,
                key=f"moment{axis}",
                index=having.get(body, -1),
                allowed=ANY,
            )


def _there(part: Any, key: str) -> bool:
    """Whether a part has what a number is about: a Stribeck curve, stops to bounce off."""
    match key:
        case "breakaway" | "stribeck_rate":
            return math.isfinite(part.stribeck_rate)
        case "restitution":
            return part.stops is not None
        case _:
            return True


def _initial(scenarios: Sequence[Scenario]) -> Iterator[Parameter]:
    gimbals = scenarios[0].platform.gimbals
    for k, gimbal in enumerate(gimbals):
        within = ANY
        if gimbal.stops is not None:
            low, high = gimbal.stops
            within = Range(words=f"an angle between the stops, {low:.6g} to {high:.6g} rad", low=low, high=high)
        yield Parameter(path=f"initial.{gimbal.angle}_rate", group="initial", key="rate", index=k, allowed=ANY)
        yield Parameter(path=f"initial.{gimbal.angle}", group="initial", key="q", index=k, allowed=within)
    if any(one.mode == "stabilised" for one in scenarios):
        for k, name in enumerate(OMEGA_NAMES):
            yield Parameter(path=f"initial.{name}", group="initial", key="Omega", index=k, allowed=ANY)


def _of_manoeuvres(scenarios: Sequence[Scenario]) -> Iterator[Parameter]:
    for key, allowed in _MANOEUVRE_RANGES.items():
        if any(in_manoeuvre(key, one) is not None for one in scenarios):
            scale = key.endswith("_scale")
            yield Parameter(path=f"manoeuvre.{key}", group="manoeuvre", key=key, allowed=allowed, factor=scale)
    if any(one.vibrations for one in scenarios):
        yield Parameter(path="vibration.scale", group="vibration", key="scale", allowed=NOT_NEGATIVE, factor=True)


def unknown_parameter(path: str, known: Iterable[str]) -> str:
    """Return what exists in the place of a path that does not: its nearest relative, or names at the first step."""
    known = list(known)
    close = nearest(path, known)
    if close is not None and path.partition(".")[0] == close.partition(".")[0]:
        return f'did you mean "{close}"?'
    # Everything up to where the path leaves those that exist.
    steps = path.split(".")
    for depth in range(len(steps) - 1, -1, -1):
        head = "".join(f"{step}." for step in steps[:depth])
        if any(one.startswith(head) for one in known):
            # A name may hold dots: what is listed are whole paths once one step is settled.
            rest = [one if depth else one.partition(".")[0] for one in known if one.startswith(head)]
            return "known: " + ", ".join(f'"{one}"' for one in dict.fromkeys(rest))
    return "none is known"


def nominal(parameter: Parameter, scenario: Scenario, faults: Sequence[Fault]) -> float | None:
    """Return the number as it stands; None where there is none, because the run or the plant does not have it."""
    if parameter.factor and parameter.group not in ("manoeuvre", "vibration"):
        return 1.0
    platform, k, key = scenario.platform, parameter.index, parameter.key
    match parameter.group:
        case "root":
            return float(platform.specific_force[k])
        case "unbalances":
            return float(platform.unbalances[k].moment[int(key[-1]) - 1]) if k >= 0 else 0.0
        case "sampling":
            return scenario.delay
        case "initial":
            return None if key == "Omega" and scenario.mode == "caged" else float(getattr(scenario, key)[k])
        case "manoeuvre":
            return in_manoeuvre(key, scenario)
        case "vibration":
            return 1.0 if scenario.vibrations else None
        case "fault":
            found = float(getattr(next(one for one in faults if one.name == parameter.part), key))
            return found if math.isfinite(found) else None
        case _:
            number = getattr(getattr(platform, parameter.group)[k], key)
            # Of two directions the larger stands for both.
            return None if number is None else float(np.max(number))


def in_manoeuvre(key: str, scenario: Scenario) -> float | None:
    """Return a number of the manoeuvre itself as it stands; None where the run does not have it."""
    match key:
        case "torque":
            return float(scenario.torque[np.argmax(np.abs(scenario.torque))]) if scenario.torque.any() else None
        case "Omega_scale":
            return None if scenario.Omega_table is None else 1.0
        case "torque_scale":
            return None if scenario.torque_table is None else 1.0
        case _:
            return None if scenario.profile is None else float(getattr(scenario.profile, key))
