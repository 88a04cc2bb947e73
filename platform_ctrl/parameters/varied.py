"""A run with drawn numbers in their places."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from platform_ctrl.description import Platform, Rotor
from platform_ctrl.force_elements import Unbalance
from platform_ctrl.frozen import replaced
from platform_ctrl.parameters.known import Parameter, in_manoeuvre
from platform_ctrl.scenario import Fault, Scenario
from platform_ctrl.signatures import check_arguments


@check_arguments
def varied_scenario(
    scenario: Scenario,
    drawn: Sequence[tuple[Parameter, float, bool]],
    *,
    faults: tuple[Fault, ...] | None = None,
    seed: int | None = None,
    run: int = 0,
) -> Scenario:
    """Return the run with drawn numbers in their places; `scenario` stays as it is.

    Parameters
    ----------
    scenario
        The run as it stands.
    drawn
        Parameter, number, and whether the number is a factor of what stands there. What the run does not have is passed
        over: the rate of a half-cosine where there is none, a fault that does not happen.
    faults, seed, run
        What happens in it, and what its noise is drawn from, where these differ from `scenario`.

    Returns
    -------
    Scenario
        A new one.

    Raises
    ------
    ArgumentError
        An argument of another kind than annotated.

    References
    ----------
    See docs/campaign.md.
    """
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
            case "vibration":
                own["vibrations"] = tuple(
                    replaced(one, {"densities": one.densities * number**2}) for one in scenario.vibrations
                )
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
    """Return what stands under `key` once a number is drawn."""
    old = getattr(part, key)
    if isinstance(old, tuple):
        return tuple(x * number for x in old) if relative else (number,) * len(old)
    return old * number if relative else number
