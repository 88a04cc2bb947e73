"""The numbers of a run by their paths: their places, allowed values and present values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, get_args

import numpy as np

from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.job.drive import Drive
from platform_ctrl.job.faults import FAULT_KINDS, Fault
from platform_ctrl.job.scenario import Command, Scenario
from platform_ctrl.plant import fields
from platform_ctrl.plant.drives import Torquer
from platform_ctrl.plant.fields import Expected
from platform_ctrl.plant.flexible import FlexibleMode
from platform_ctrl.plant.force_elements import Unbalance
from platform_ctrl.plant.gimbals import Rotor
from platform_ctrl.plant.mistakes import suggestion
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
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
# Of the motion of a manoeuvre: the rule, and where the number is in the run.
_OF_MANOEUVRES: dict[str, tuple[Expected, tuple[str, ...]]] = {
    "rate": (fields.NUMBER, ("profile", "rate")),
    "rise": (fields.POSITIVE, ("profile", "rise")),
    "hold": (fields.NOT_NEGATIVE, ("profile", "hold")),
    "torque": (fields.NUMBER, ("torque",)),
    "Omega_scale": (fields.NUMBER, ("Omega_table", "scale")),
    "torque_scale": (fields.NUMBER, ("torque_table", "scale")),
}
# What multiplies all that shakes the base.
_SHAKING = "vibration.scale"


class Chosen(NamedTuple):
    """The k-th of several records that has this name under this key."""

    key: str
    name: str
    k: int = 0


@value
class RunParameter:
    """A number of a run.

    Attributes
    ----------
    path
        What a job file calls it.
    place
        Steps from the run to the number: names of fields, and elements of tuples and arrays.
    factor
        Whether it multiplies something that is more than a number (an inertia matrix, a table) and is nominally 1.
    """

    path: str
    place: tuple[str | int | Chosen, ...]
    factor: bool = False

    @property
    def key(self) -> str:
        """Name of the field that is or has the number."""
        return next(step for step in reversed(self.place) if isinstance(step, str))


def _numbers(record: type) -> dict[str, Expected]:
    """Return the numbers of a record that may be varied, and what is expected of a drawn one."""
    keys = shape(record).keys.items()
    own = ((name, key) for name, key in keys if name == key.field or hasattr(record, name))
    factors = {Torquer: {"gain": fields.NOT_NEGATIVE}, FlexibleMode: {"participation": fields.NUMBER}}
    return {
        name: _DRAWN[key.holds] for name, key in own if key.holds in _DRAWN and name not in _NOT_VARIED
    } | factors.get(record, {})


def parameters(scenarios: Sequence[Scenario], faults: Sequence[Fault]) -> dict[str, RunParameter]:
    """Return the parameters that may be varied, by their paths."""
    return {
        one.path: one
        for one, _ in _ruled(scenarios, faults)
        if one.path.startswith(("unbalance.", "fault.")) or any(_place(one, of) is not None for of in scenarios)
    }


def allowed(scenarios: Sequence[Scenario], faults: Sequence[Fault]) -> dict[str, Expected]:
    """Return the rules for drawn numbers, or for drawn factors, by the paths of parameters."""
    return {one.path: expected for one, expected in _ruled(scenarios, faults)}


_Ruled = tuple[RunParameter, Expected]


def _ruled(scenarios: Sequence[Scenario], faults: Sequence[Fault]) -> Iterator[_Ruled]:
    """Yield the parameters with the rules for drawn numbers."""
    if not scenarios:
        return
    scenario = scenarios[0]
    yield from _of_plant(scenario.platform)
    yield _one("sampling.delay", fields.NOT_NEGATIVE, "delay")
    for k, gimbal in enumerate(scenario.platform.gimbals):
        yield _one(f"initial.{gimbal.angle}_rate", fields.NUMBER, "rate", k)
        yield _one(f"initial.{gimbal.angle}", _between(gimbal.stops) if gimbal.stops else fields.NUMBER, "q", k)
    for k, name in enumerate(OMEGA_NAMES):
        yield _one(f"initial.{name}", fields.NUMBER, "Omega", k)
    for key, (expected, place) in _OF_MANOEUVRES.items():
        yield _one(f"manoeuvre.{key}", expected, *place, factor=key.endswith("_scale"))
    yield _one(_SHAKING, fields.NOT_NEGATIVE, "vibrations", factor=True)
    for k, law in enumerate(scenario.drives):
        for key, expected in _numbers(Drive).items():
            if law.friction:
                yield _one(f"drive.{law.torquer}.{key}", expected, "drives", k, key)
    for reading in dict.fromkeys(one.reading for of in scenarios for one in of.commands):
        for k in range(max(sum(one.reading == reading for one in of.commands) for of in scenarios)):
            for key, expected in _numbers(Command).items():
                path = f"command.{_numbered(reading, k)}.{key}"
                yield _one(path, expected, "commands", Chosen("reading", reading, k), key)
    for fault in faults:
        for key in ("at", *FAULT_KINDS[fault.kind].keys):
            path = f"fault.{fault.name}.{key}"
            yield _one(path, _numbers(Fault)[key], "faults", Chosen("name", fault.name), key)


def _one(path: str, expected: Expected, *place: str | int | Chosen, factor: bool = False) -> _Ruled:
    return RunParameter(path=path, place=place, factor=factor), expected


def _numbered(name: str, k: int) -> str:
    """Return how a path names the k-th part of a name."""
    return name if k == 0 else f"{name}#{k + 1}"


def _of_plant(platform: Platform) -> Iterator[_Ruled]:
    yield _one("root.inertia", fields.POSITIVE, "platform", "root_inertia", factor=True)
    for axis in (1, 2, 3):
        yield _one(f"root.specific_force{axis}", fields.NUMBER, "platform", "specific_force", axis - 1)
    parts = {word: key for word, key in shape(Platform).keys.items() if key.array is not None}
    for word, of in parts.items():
        group, numbers = of.field, _numbers(of.holds.make)  # type: ignore[union-attr, arg-type]
        taken: list[str] = []
        for k, part in enumerate(getattr(platform, group) if numbers else ()):
            name = part.name if hasattr(part, "name") else part.gimbal
            title = _numbered(name, taken.count(name))
            taken.append(name)
            of_motor = getattr(part, "stall", None) is not None  # a torquer whose numbers are the motor's
            for key, expected in numbers.items():
                if _there(part, key) and (key == "gain" or not of_motor):
                    factor = key in ("inertia", "participation") or (group, key) == ("torquers", "gain")
                    yield _one(f"{word}.{title}.{key}", expected, "platform", group, k, key, factor=factor)
    for body in (platform.root_name, *platform.gimbal_names):
        for axis in (1, 2, 3):
            place = ("platform", "unbalances", Chosen("body", body), "moment", axis - 1)
            yield _one(f"unbalance.{body}.moment{axis}", fields.NUMBER, *place)


def _there(part: Any, key: str) -> bool:
    """Whether a part has what a number is about: a Stribeck curve, stops to bounce off."""
    match key:
        case "breakaway" | "stribeck_rate":
            return math.isfinite(part.stribeck_rate)
        case "restitution":
            return part.stops is not None
        case "mass":
            return bool(part.mass)
        case "bandwidth_hz" | "frequency":
            return getattr(part, key) is not None
        case _:
            return True


def unknown_parameter(path: str, known: Iterable[str]) -> str:
    """Return a hint for a path that does not exist: its nearest relative, or names at the first step."""
    heads = {one: one.partition(".")[0] for one in known}
    alike = [one for one, head in heads.items() if head == path.partition(".")[0]]
    return suggestion(path, alike or dict.fromkeys(heads.values()))


def _between(stops: tuple[float, float]) -> Expected:
    low, high = stops
    judge = fields.where(lambda angle: low <= angle <= high)
    return Expected(f"an angle between the stops, {low:.6g} to {high:.6g} rad", judge)


# Steps from a run to a number of it: names of fields, and places in tuples and arrays.
_Place = tuple[str | int, ...]


def _place(parameter: RunParameter, scenario: Scenario) -> _Place | None:
    """Return where a number is; None where the run does not have it."""
    item: Any = scenario
    place: list[str | int] = []
    for step in parameter.place:
        if item is None:
            return None
        if isinstance(step, Chosen):
            found = [k for k, one in enumerate(item) if getattr(one, step.key) == step.name]
            if step.k >= len(found):
                return None
            step = found[step.k]
        place.append(step)
        if len(place) < len(parameter.place):
            item = _number_at(item, (step,))
    match place[0]:
        case "Omega":
            there = scenario.mode == "stabilised"
        case "torque":
            there = bool(scenario.torque.any())
        case "vibrations":
            there = bool(scenario.vibrations or scenario.sines)
        case "commands":
            key = parameter.key
            there = bool({"at": item.step or item.ramp, "phase": item.amplitude}.get(key, getattr(item, key)))
        case _:
            there = item is not None
    return tuple(place) if there else None


def _number_at(item: Any, place: _Place) -> Any:
    for step in place:
        item = getattr(item, step) if isinstance(step, str) else item[step]
    return item


def part_of(parameter: RunParameter, scenario: Scenario) -> Any:
    """Return the record that a number is of; None where the run does not have it."""
    place = _place(parameter, scenario)
    return None if place is None else _number_at(scenario, place[:-1])


def nominal(parameter: RunParameter, scenario: Scenario) -> float | None:
    """Return the nominal value; None where the run or the plant does not have the parameter."""
    place = _place(parameter, scenario)
    if place is None:
        return 0.0 if "unbalances" in parameter.place else None
    if parameter.factor:
        return 1.0
    if (number := _number_at(scenario, place)) is None:
        return None
    # Of a vector the one that is not zero, of two directions the larger one.
    numbers = np.ravel(number)
    largest = float(numbers[np.abs(numbers).argmax()])
    return largest if math.isfinite(largest) else None


def varied_scenario(
    scenario: Scenario,
    drawn: Sequence[tuple[RunParameter, float, bool]],
    *,
    faults: tuple[Fault, ...],
    seed: int,
    run: int,
) -> Scenario:
    """Return the run with drawn numbers in their places; `scenario` stays as it is.

    `drawn`: parameters with their numbers, and whether these multiply what is there.
    """
    own: dict[str, Any] = {"seed": seed, "run": run}
    scenario = replaced(scenario, {"faults": faults})
    changes: dict[str | int, Any] = {}
    weak: list[Fault] = []
    moments: dict[str, FloatArray] = {}
    for parameter, number, relative in drawn:
        place = _place(parameter, scenario)
        if parameter.path == _SHAKING:
            densities = [replaced(one, {"densities": one.densities * number**2}) for one in scenario.vibrations]
            sines = [replaced(one, {"amplitude": one.amplitude * number}) for one in scenario.sines]
            own |= {"vibrations": tuple(densities), "sines": tuple(sines)}
        elif parameter.place[1:2] == ("torquers",) and parameter.key == "gain":  # no field: another one is a fault
            part = part_of(parameter, scenario).name
            weak.insert(0, Fault(name=parameter.path, kind="torquer weak", part=part, at=0.0, share=number))
        elif place is None and "unbalances" in parameter.place:
            *_, body, _, axis = parameter.place
            assert isinstance(body, Chosen)
            assert isinstance(axis, int)
            moments.setdefault(body.name, np.zeros(3))[axis] = 0.0 if relative else number
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
    if not isinstance(changes, dict) or isinstance(item, Mapping):
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
    if isinstance(old, np.ndarray) and not relative:
        return np.where(old, number, 0.0)
    if isinstance(old, tuple):
        return tuple(x * number for x in old) if relative else (number,) * len(old)
    if isinstance(old, Mapping):
        return {name: x * number for name, x in old.items()}
    return old * number if relative else number
