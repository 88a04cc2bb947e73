"""The numbers of a run by their paths: their places, allowed values and present values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, get_args

import numpy as np

from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.job.drive import Drive
from platform_ctrl.job.faults import FAULT_KINDS, Fault
from platform_ctrl.job.scenario import Command, Scenario
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Expected, Unfit
from platform_ctrl.plant.force_elements import Unbalance
from platform_ctrl.plant.mistakes import suggestion
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform, Rotor, Torquer
from platform_ctrl.plant.tables import shape

# Rules for drawn numbers, by the rules for numbers of a file: zeros and ends of ranges may be drawn.
_DRAWN: dict[Any, Expected] = {
    get_args(kind)[1]: expected
    for kind, expected in (
        (fields.Number, fields.NUMBER),
        (fields.NotZero, fields.NUMBER),
        (fields.Positive, fields.POSITIVE),
        (fields.NotNegative, fields.NOT_NEGATIVE),
        (fields.AtLeastOne, get_args(fields.AtLeastOne)[1]),
        (fields.Part, get_args(fields.Part)[1]),
        (fields.SomePart, get_args(fields.Part)[1]),
        (fields.Coulomb, fields.NOT_NEGATIVE),
        (fields.Inertia, fields.POSITIVE),
    )
} | {fields.FREQUENCY: fields.POSITIVE}
# Of the servo's speed loop, and what decides how many readings of a sensor are kept: campaigns do not vary them.
_NOT_VARIED = frozenset({"speed_gain", "speed_integral", "torque_limit", "delay", "rate_hz", "noise_density"})
_OF_MANOEUVRES = {
    "rate": fields.NUMBER,
    "rise": fields.POSITIVE,
    "hold": fields.NOT_NEGATIVE,
    "torque": fields.NUMBER,
    "Omega_scale": fields.NUMBER,
    "torque_scale": fields.NUMBER,
}


def _numbers(record: type) -> dict[str, Expected]:
    """Return the numbers of a record that may be varied, and what is expected of a drawn one."""
    keys = shape(record).keys.items()
    drawn = {name: _DRAWN[key.holds] for name, key in keys if key.holds in _DRAWN and name not in _NOT_VARIED}
    return drawn | ({"gain": fields.NOT_NEGATIVE} if record is Torquer else {})


@value
class RunParameter:
    """A number of a run.

    Attributes
    ----------
    path
        What a job file calls it.
    group, index
        Where it is: the plant's array and the index in it, or one of ``"root"``, ``"unbalances"``, ``"sampling"``,
        ``"initial"``, ``"manoeuvre"``, ``"commands"``, ``"drives"``, ``"fault"``, ``"vibration"``; `index` counts the
        commands of a reading, and the axes of a vector.
    part, key
        Name of the part or fault; the number of it that is meant.
    factor
        Whether it multiplies something that is more than a number (an inertia matrix, a table) and is nominally 1.
    """

    path: str
    group: str
    key: str
    part: str = ""
    index: int = 0
    factor: bool = False


def parameters(scenarios: Sequence[Scenario], faults: Sequence[Fault]) -> dict[str, RunParameter]:
    """Return the parameters that may be varied, by their paths."""
    if not scenarios:
        return {}
    found = [
        *_of_plant(scenarios[0].platform),
        RunParameter(path="sampling.delay", group="sampling", key="delay"),
        *_initial(scenarios),
        *_of_manoeuvres(scenarios),
        *_of_drives(scenarios[0]),
        *_of_commands(scenarios),
        *(
            RunParameter(path=f"fault.{f.name}.{key}", group="fault", part=f.name, key=key)
            for f in faults
            for key in ("at", *FAULT_KINDS[f.kind].keys)
        ),
    ]
    return {one.path: one for one in found}


def _of_plant(platform: Platform) -> Iterator[RunParameter]:
    yield RunParameter(path="root.inertia", group="root", key="inertia", factor=True)
    for axis in (1, 2, 3):
        yield RunParameter(path=f"root.specific_force{axis}", group="root", key="specific_force", index=axis - 1)
    parts = {word: key for word, key in shape(Platform).keys.items() if key.array is not None}
    for word, of in parts.items():
        group, numbers = of.field, _numbers(of.holds.make)  # type: ignore[union-attr, arg-type]
        taken: dict[str, int] = {}
        for k, part in enumerate(getattr(platform, group) if numbers else ()):
            name = part.name if hasattr(part, "name") else part.gimbal
            taken[name] = taken.get(name, 0) + 1
            title = name if taken[name] == 1 else f"{name}#{taken[name]}"
            for key in numbers:
                if not _there(part, key):
                    continue
                yield RunParameter(
                    path=f"{word}.{title}.{key}",
                    group=group,
                    part=name,
                    key=key,
                    index=k,
                    factor=key == "inertia" or (group, key) == ("torquers", "gain"),
                )
    for body in (platform.root_name, *platform.gimbal_names):
        for axis in (1, 2, 3):
            path = f"unbalance.{body}.moment{axis}"
            yield RunParameter(path=path, group="unbalances", part=body, key="moment", index=axis - 1)


def _there(part: Any, key: str) -> bool:
    """Whether a part has what a number is about: a Stribeck curve, stops to bounce off."""
    match key:
        case "breakaway" | "stribeck_rate":
            return math.isfinite(part.stribeck_rate)
        case "restitution":
            return part.stops is not None
        case "bandwidth_hz":
            return part.bandwidth_hz is not None
        case _:
            return True


def _initial(scenarios: Sequence[Scenario]) -> Iterator[RunParameter]:
    gimbals = scenarios[0].platform.gimbals
    for k, gimbal in enumerate(gimbals):
        yield RunParameter(path=f"initial.{gimbal.angle}_rate", group="initial", key="rate", index=k)
        yield RunParameter(path=f"initial.{gimbal.angle}", group="initial", key="q", index=k)
    if any(one.mode == "stabilised" for one in scenarios):
        for k, name in enumerate(OMEGA_NAMES):
            yield RunParameter(path=f"initial.{name}", group="initial", key="Omega", index=k)


def _of_manoeuvres(scenarios: Sequence[Scenario]) -> Iterator[RunParameter]:
    for key in _OF_MANOEUVRES:
        found = RunParameter(path=f"manoeuvre.{key}", group="manoeuvre", key=key, factor=key.endswith("_scale"))
        if any(_place(found, one) is not None for one in scenarios):
            yield found
    if any(one.vibrations or one.sines for one in scenarios):
        yield RunParameter(path="vibration.scale", group="vibration", key="scale", factor=True)


def _of_drives(scenario: Scenario) -> Iterator[RunParameter]:
    """Yield the numbers of drives: of friction where some is fed forward, of the gain where it follows an angle."""
    for k, law in enumerate(scenario.drives):
        for key in _numbers(Drive):
            if law.secant_of is not None if key == "secant_limit" else law.friction:
                path = f"drive.{law.torquer}.{key}"
                yield RunParameter(path=path, group="drives", part=law.torquer, key=key, index=k)


def _of_commands(scenarios: Sequence[Scenario]) -> Iterator[RunParameter]:
    """Yield the numbers of commands, the k-th of its reading in every run that has it."""
    for reading in dict.fromkeys(one.reading for scenario in scenarios for one in scenario.commands):
        most = max(len(_commands_of(scenario, reading)) for scenario in scenarios)
        for k in range(most):
            title = reading if k == 0 else f"{reading}#{k + 1}"
            for key in _numbers(Command):
                found = RunParameter(path=f"command.{title}.{key}", group="commands", part=reading, key=key, index=k)
                if any(_place(found, scenario) is not None for scenario in scenarios):
                    yield found


def _commands_of(scenario: Scenario, reading: str) -> list[int]:
    return [k for k, one in enumerate(scenario.commands) if one.reading == reading]


def unknown_parameter(path: str, known: Iterable[str]) -> str:
    """Return a hint for a path that does not exist: its nearest relative, or names at the first step."""
    heads = {one: one.partition(".")[0] for one in known}
    alike = [one for one, head in heads.items() if head == path.partition(".")[0]]
    return suggestion(path, alike or dict.fromkeys(heads.values()))


def allowed(parameter: RunParameter, scenario: Scenario) -> Expected:
    """Return the rule for a drawn number, or for a drawn factor."""
    key, k = parameter.key, parameter.index
    match parameter.group:
        case "initial" if key == "q" and (stops := scenario.platform.gimbals[k].stops) is not None:
            return _between(*stops)
        case "root" | "unbalances" | "initial":
            return fields.POSITIVE if parameter.factor else fields.NUMBER
        case "sampling" | "vibration":
            return fields.NOT_NEGATIVE
        case "manoeuvre":
            return _OF_MANOEUVRES[key]
        case "drives" | "commands" | "fault" as group:
            return _numbers({"drives": Drive, "commands": Command, "fault": Fault}[group])[key]
        case group:
            return _numbers(type(getattr(scenario.platform, group)[k]))[key]


def _between(low: float, high: float) -> Expected:
    def judge(angle: float) -> float:
        if not low <= angle <= high:
            raise Unfit
        return angle

    return Expected(f"an angle between the stops, {low:.6g} to {high:.6g} rad", judge)


# Steps from a run to a number of it: names of fields, and places in tuples and arrays.
_Place = tuple[str | int, ...]


def _place(parameter: RunParameter, scenario: Scenario) -> _Place | None:
    """Return where a number is; None where the run does not have it."""
    key, k = parameter.key, parameter.index
    match parameter.group:
        case "root":
            return ("platform", "root_inertia") if key == "inertia" else ("platform", key, k)
        case "unbalances":
            bodies = [one.body for one in scenario.platform.unbalances]
            if parameter.part not in bodies:
                return None
            return ("platform", "unbalances", bodies.index(parameter.part), key, k)
        case "sampling":
            return (key,)
        case "initial":
            return None if key == "Omega" and scenario.mode == "caged" else (key, k)
        case "manoeuvre" if key == "torque":
            return (key, int(np.argmax(np.abs(scenario.torque)))) if scenario.torque.any() else None
        case "manoeuvre":
            part, own = (key.replace("_scale", "_table"), "scale") if parameter.factor else ("profile", key)
            return None if getattr(scenario, part) is None else (part, own)
        case "commands":
            places = _commands_of(scenario, parameter.part)
            if k >= len(places):
                return None
            one = scenario.commands[places[k]]
            there = {"at": one.step or one.ramp, "phase": one.amplitude}.get(key, getattr(one, key))
            return ("commands", places[k], key) if there else None
        case "drives":
            return ("drives", k, key)
        case "fault":
            names = [one.name for one in scenario.faults]
            return ("faults", names.index(parameter.part), key) if parameter.part in names else None
        case group:
            return ("platform", group, k, key)


def _number_at(item: Any, place: _Place) -> Any:
    for step in place:
        item = getattr(item, step) if isinstance(step, str) else item[step]
    return item


def nominal(parameter: RunParameter, scenario: Scenario, faults: Sequence[Fault]) -> float | None:
    """Return the nominal value; None where the run or the plant does not have the parameter."""
    if parameter.group == "vibration":
        return 1.0 if scenario.vibrations or scenario.sines else None
    scenario = replaced(scenario, {"faults": tuple(faults)})
    place = _place(parameter, scenario)
    if place is None:
        return 0.0 if parameter.group == "unbalances" else None
    if parameter.factor:
        return 1.0
    number = _number_at(scenario, place)
    # The larger of two directions.
    return None if number is None or not np.isfinite(np.max(number)) else float(np.max(number))


def varied_scenario(
    scenario: Scenario,
    drawn: Sequence[tuple[RunParameter, float, bool]],
    *,
    faults: tuple[Fault, ...] | None = None,
    seed: int | None,
    run: int = 0,
) -> Scenario:
    """Return the run with drawn numbers in their places; `scenario` stays as it is.

    `drawn`: parameters with their numbers, and whether these multiply what is there.
    """
    own: dict[str, Any] = {"seed": scenario.seed if seed is None else seed, "run": run}
    scenario = scenario if faults is None else replaced(scenario, {"faults": faults})
    changes: dict[str | int, Any] = {}
    weak: list[Fault] = []
    moments: dict[str, FloatArray] = {}
    for parameter, number, relative in drawn:
        key, place = parameter.key, _place(parameter, scenario)
        if parameter.group == "vibration":
            densities = [replaced(one, {"densities": one.densities * number**2}) for one in scenario.vibrations]
            sines = [replaced(one, {"amplitude": one.amplitude * number}) for one in scenario.sines]
            own |= {"vibrations": tuple(densities), "sines": tuple(sines)}
        elif (parameter.group, key) == ("torquers", "gain"):
            lost = Fault(name=parameter.path, kind="torquer weak", part=parameter.part, at=0.0, share=number)
            weak.insert(0, lost)
        elif parameter.group == "unbalances" and place is None:
            moments.setdefault(parameter.part, np.zeros(3))[parameter.index] = 0.0 if relative else number
        elif place is not None:
            old, within = _number_at(scenario, place), changes
            for step in place[:-1]:
                within = within.setdefault(step, {})
            within[place[-1]] = drawn_value(old, number, relative or parameter.factor)
    out: Scenario = _changed(scenario, changes)
    if moments:
        added = tuple(Unbalance(body=body, moment=moment) for body, moment in moments.items())
        own["platform"] = replaced(out.platform, {"unbalances": (*out.platform.unbalances, *added)})
    return replaced(out, own | {"faults": (*weak, *out.faults)})


def _changed(item: Any, changes: Any) -> Any:
    """Return a value with others in places further in: fields of records, elements of tuples and arrays."""
    if not isinstance(changes, dict):
        return changes
    if isinstance(item, tuple):
        return tuple(_changed(one, changes.get(k, {})) for k, one in enumerate(item))
    if isinstance(item, np.ndarray):
        out = item.copy()
        out[list(changes)] = list(changes.values())
        return out
    if not changes:
        return item
    own = {name: _changed(getattr(item, name), inner) for name, inner in changes.items()}
    if isinstance(item, Rotor) and {"spin", "axial_inertia"} & own.keys():
        # L follows from the spin, which another axial inertia leaves as it is.
        spin = own.pop("spin", item.spin)
        own.setdefault("angular_momentum", own.get("axial_inertia", item.axial_inertia) * spin)
    return replaced(item, own)


def drawn_value(old: Any, number: float, relative: bool) -> Any:
    """Return the value in the place of an old one once a number is drawn."""
    if isinstance(old, tuple):
        return tuple(x * number for x in old) if relative else (number,) * len(old)
    return old * number if relative else number
