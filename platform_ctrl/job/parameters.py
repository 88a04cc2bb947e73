"""The numbers of a run by their paths: which there are, where they stand, what they may be, and what they are now."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, get_args

import numpy as np

from platform_ctrl.common.values import replaced, value
from platform_ctrl.job.drive import Drive
from platform_ctrl.job.faults import FAULT_KINDS, Fault
from platform_ctrl.job.scenario import Command, Scenario
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Expected, Unfit
from platform_ctrl.plant.force_elements import Unbalance
from platform_ctrl.plant.mistakes import suggestion
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform, Rotor, Torquer
from platform_ctrl.plant.tables import shape

# What is expected of a number when it is drawn, by what a file expects of it: zeros and ends of ranges may be drawn.
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
        ``"initial"``, ``"manoeuvre"``, ``"commands"``, ``"drives"``, ``"fault"``, ``"vibration"``; `index` is −1 for an
        unbalance that the plant lacks, and counts the commands of a reading.
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
    """Return what may be varied, by its path."""
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
        key = f"specific_force{axis}"
        yield RunParameter(path=f"root.{key}", group="root", key=key, index=axis - 1)
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
    having = {one.body: k for k, one in reversed([*enumerate(platform.unbalances)])}
    for body in (platform.root_name, *platform.gimbal_names):
        for axis in (1, 2, 3):
            yield RunParameter(
                path=f"unbalance.{body}.moment{axis}",
                group="unbalances",
                part=body,
                key=f"moment{axis}",
                index=having.get(body, -1),
            )


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
        if any(in_manoeuvre(key, one) is not None for one in scenarios):
            scale = key.endswith("_scale")
            yield RunParameter(path=f"manoeuvre.{key}", group="manoeuvre", key=key, factor=scale)
    if any(one.vibrations or one.sines for one in scenarios):
        yield RunParameter(path="vibration.scale", group="vibration", key="scale", factor=True)


def _of_drives(scenario: Scenario) -> Iterator[RunParameter]:
    """Walk the numbers of drives: of friction where some is fed forward, of the gain where it follows an angle."""
    for k, law in enumerate(scenario.drives):
        for key in _numbers(Drive):
            if law.secant_of is not None if key == "secant_limit" else law.friction:
                path = f"drive.{law.torquer}.{key}"
                yield RunParameter(path=path, group="drives", part=law.torquer, key=key, index=k)


def _of_commands(scenarios: Sequence[Scenario]) -> Iterator[RunParameter]:
    """Walk the numbers of commands, the k-th of its reading in every run that has it."""
    for reading in dict.fromkeys(one.reading for scenario in scenarios for one in scenario.commands):
        most = max(len(_commands_of(scenario, reading)) for scenario in scenarios)
        for k in range(most):
            title = reading if k == 0 else f"{reading}#{k + 1}"
            for key in _numbers(Command):
                found = RunParameter(path=f"command.{title}.{key}", group="commands", part=reading, key=key, index=k)
                if any(_of_command(found, scenario) is not None for scenario in scenarios):
                    yield found


def _commands_of(scenario: Scenario, reading: str) -> list[int]:
    return [k for k, one in enumerate(scenario.commands) if one.reading == reading]


def _of_command(parameter: RunParameter, scenario: Scenario) -> float | None:
    """Return the number of a command; None where the run has no such command, or the command no such part."""
    places = _commands_of(scenario, parameter.part)
    if parameter.index >= len(places):
        return None
    one = scenario.commands[places[parameter.index]]
    there = {"at": one.step or one.ramp, "phase": one.amplitude}.get(parameter.key, getattr(one, parameter.key))
    return float(getattr(one, parameter.key)) if there else None


def unknown_parameter(path: str, known: Iterable[str]) -> str:
    """Return what exists in the place of a path that does not: its nearest relative, or names at the first step."""
    heads = {one: one.partition(".")[0] for one in known}
    alike = [one for one, head in heads.items() if head == path.partition(".")[0]]
    return suggestion(path, alike or dict.fromkeys(heads.values()))


def allowed(parameter: RunParameter, scenario: Scenario) -> Expected:
    """Return what is expected of a drawn number; of a factor: what is expected of the factor."""
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


def nominal(parameter: RunParameter, scenario: Scenario, faults: Sequence[Fault]) -> float | None:
    """Return the nominal value; None where the run or the plant does not have the parameter."""
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
        case "commands":
            return _of_command(parameter, scenario)
        case "drives":
            return float(getattr(scenario.drives[k], key))
        case "vibration":
            return 1.0 if scenario.vibrations or scenario.sines else None
        case "fault":
            found = float(getattr(next(one for one in faults if one.name == parameter.part), key))
            return found if math.isfinite(found) else None
        case _:
            number = getattr(getattr(platform, parameter.group)[k], key)
            # The larger of two directions.
            return None if number is None else float(np.max(number))


def in_manoeuvre(key: str, scenario: Scenario) -> float | None:
    """Return a nominal value of the manoeuvre itself; None where the run does not have it."""
    match key:
        case "torque":
            return float(scenario.torque[np.argmax(np.abs(scenario.torque))]) if scenario.torque.any() else None
        case "Omega_scale":
            return None if scenario.Omega_table is None else 1.0
        case "torque_scale":
            return None if scenario.torque_table is None else 1.0
        case _:
            return None if scenario.profile is None else float(getattr(scenario.profile, key))


def varied_scenario(
    scenario: Scenario,
    drawn: Sequence[tuple[RunParameter, float, bool]],
    *,
    faults: tuple[Fault, ...] | None = None,
    seed: int | None = None,
    run: int = 0,
) -> Scenario:
    """Return the run with drawn numbers in their places; `scenario` stays as it is."""
    parts: dict[tuple[str, int, str], dict[str, Any]] = {}
    own: dict[str, Any] = {"faults": scenario.faults if faults is None else faults}
    own |= {"seed": scenario.seed if seed is None else seed, "run": run}
    root: dict[str, Any] = {}
    for parameter, number, relative in drawn:
        key, k = parameter.key, parameter.index
        match parameter.group:
            case "root" if key == "inertia":
                root["root_inertia"] = scenario.platform.root_inertia * number
            case "root":
                force = root.setdefault("specific_force", scenario.platform.specific_force.copy())
                force[k] = number * (scenario.platform.specific_force[k] if relative else 1.0)
            case "sampling":
                own["delay"] = number * (scenario.delay if relative else 1.0)
            case "initial" if key != "Omega" or scenario.mode == "stabilised":
                start = own.setdefault(key, getattr(scenario, key).copy())
                start[k] = number * (getattr(scenario, key)[k] if relative else 1.0)
            case "manoeuvre":
                own |= _moved(key, number, relative, own, scenario)
            case "drives" | "commands" as group:
                own[group] = _with_part(own.get(group, getattr(scenario, group)), parameter, scenario, number, relative)
            case "vibration":
                own["vibrations"] = tuple(
                    replaced(one, {"densities": one.densities * number**2}) for one in scenario.vibrations
                )
                own["sines"] = tuple(replaced(one, {"amplitude": one.amplitude * number}) for one in scenario.sines)
            case "fault":
                own["faults"] = tuple(
                    one if one.name != parameter.part else replaced(one, {key: drawn_value(one, key, number, relative)})
                    for one in own["faults"]
                )
            case "torquers" if key == "gain":
                weak = Fault(name=parameter.path, kind="torquer weak", part=parameter.part, at=0.0, share=number)
                own["faults"] = (weak, *own["faults"])
            case "initial":
                pass
            case group:
                parts.setdefault((group, k, parameter.part), {})[key] = (number, relative)
    if parts or root:
        own["platform"] = _varied_platform(scenario.platform, parts, root)
    return replaced(scenario, own)


def _with_part(
    parts: tuple[Any, ...], parameter: RunParameter, scenario: Scenario, number: float, relative: bool
) -> tuple[Any, ...]:
    """Return drives or commands with a drawn number in one of them, if the run has it."""
    k = parameter.index
    if parameter.group == "commands":
        if _of_command(parameter, scenario) is None:
            return parts
        k = _commands_of(scenario, parameter.part)[k]
    part = parts[k]
    changed = replaced(part, {parameter.key: drawn_value(part, parameter.key, number, relative)})
    return (*parts[:k], changed, *parts[k + 1 :])


def _moved(key: str, number: float, relative: bool, own: dict[str, Any], scenario: Scenario) -> dict[str, Any]:
    """Return what a drawn number of the manoeuvre changes in the run."""
    as_it_stands = in_manoeuvre(key, scenario)
    if as_it_stands is None:
        return {}
    if key == "torque":
        return {"torque": scenario.torque * (number if relative else number / as_it_stands)}
    if key.endswith("_scale"):
        name = key.replace("_scale", "_table")
        table = getattr(scenario, name)
        # Runs whose tables differ in the scale alone fly side by side.
        return {name: replaced(table, {"scale": table.scale * number})}
    profile: Any = own.get("profile", scenario.profile)
    return {"profile": replaced(profile, {key: number * (as_it_stands if relative else 1.0)})}


def _varied_platform(
    platform: Platform, parts: dict[tuple[str, int, str], dict[str, Any]], root: dict[str, Any]
) -> Platform:
    arrays: dict[str, list[Any]] = {}
    for (group, k, body), changes in parts.items():
        if group not in arrays:
            arrays[group] = list(getattr(platform, group))
        array = arrays[group]
        if group == "unbalances":
            moment = array[k].moment.copy() if k >= 0 else np.zeros(3)
            for key, (number, relative) in changes.items():
                axis = int(key[-1]) - 1
                moment[axis] = number * (moment[axis] if relative else 1.0)
            if k >= 0:
                array[k] = replaced(array[k], {"moment": moment})
            else:
                array.append(Unbalance(body=body, moment=moment))
            continue
        part = array[k]
        if group == "rotors":
            array[k] = _varied_rotor(part, changes)
        else:
            # An inertia is scaled as a whole whatever was said: a matrix has no other number.
            array[k] = replaced(
                part,
                {
                    key: drawn_value(part, key, x, relative or key == "inertia")
                    for key, (x, relative) in changes.items()
                },
            )
    changed: dict[str, Any] = root | {group: tuple(array) for group, array in arrays.items()}
    return replaced(platform, changed)


def _varied_rotor(rotor: Rotor, changes: dict[str, tuple[float, bool]]) -> Rotor:
    """Return a rotor with other numbers; another axial inertia keeps its spin: L follows."""
    new = {key: drawn_value(rotor, key, number, relative) for key, (number, relative) in changes.items()}
    spin = new.pop("spin", rotor.spin)
    if "angular_momentum" not in new and ("spin" in changes or "axial_inertia" in changes):
        new["angular_momentum"] = new.get("axial_inertia", rotor.axial_inertia) * spin
    return replaced(rotor, new)


def drawn_value(part: Any, key: str, number: float, relative: bool) -> Any:
    """Return the value of `key` once a number is drawn."""
    old = getattr(part, key)
    if isinstance(old, tuple):
        return tuple(x * number for x in old) if relative else (number,) * len(old)
    return old * number if relative else number
