"""What a scenario has to be before it is flown: the kernel trusts every number that it is given."""

from __future__ import annotations

from collections.abc import Iterable

from platform_ctrl.arguments import positive, real_array, whole
from platform_ctrl.description import Platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.scenario import FAULT_KEYS, Fault, Scenario
from platform_ctrl.signatures import short

# What a run may take of memory and time.
_SAMPLES, _PERIODS, _SUBSTEPS = 1e8, 1e3, 1e8
_WORDS = {"rotor": "rotor", "torquer": "torquer", "pick-off": "sensor", "gimbal": "gimbal"}


def expect_scenario(scenario: object) -> None:
    """Judge an argument that has to be a scenario, and all that is in it but the sizes of steps.

    Raises
    ------
    ArgumentError
        It is something else; initial values, tables or numbers of the wrong shape or out of range; what moves the
        platform does not belong to the mode; a fault is of a part that the plant does not have.
    """
    if not isinstance(scenario, Scenario):
        raise ArgumentError(f"scenario: given {short(scenario)}; expected a Scenario")
    positive("duration", scenario.duration, zero=True)
    positive("delay", scenario.delay, zero=True)
    whole("seed", scenario.seed, 0, 2**64 - 1)
    whole("run", scenario.run, 0, 2**64 - 1)
    _start(scenario)
    _motion(scenario)
    for fault in scenario.faults:
        part_of(scenario.platform, fault)


def expect_size(scenario: object, period: float) -> None:
    """Judge how many samples a scenario has, and over how many its delay reaches.

    Raises
    ------
    ArgumentError
        There are too many of them, or it is no scenario at all.
    """
    if not isinstance(scenario, Scenario):
        raise ArgumentError(f"scenario: given {short(scenario)}; expected a Scenario")
    for name, most in (("duration", _SAMPLES), ("delay", _PERIODS)):
        time = positive(name, getattr(scenario, name), zero=True)
        if time > most * period:
            raise ArgumentError(
                f"{name}: {time:.6g} s are {time / period:.3g} periods; expected at most {most:.0e} of them"
            )


def steps(period: float, step: float) -> tuple[float, float]:
    """Return the sample period and the longest substep.

    Raises
    ------
    ArgumentError
        They are no times, or there are too many substeps in a period.
    """
    period, step = positive("period", period), positive("step", step)
    if period > _SUBSTEPS * step:
        raise ArgumentError(f"step: {step:.3g} s is too short for a period of {period:.3g} s; expected a longer one")
    return period, step


def expect_several(name: str, given: object, kind: type | None = None) -> None:
    """Judge an argument that has to be several things: not one of a `kind`.

    Raises
    ------
    ArgumentError
        It is a single thing.
    """
    if kind is not None and isinstance(given, kind):
        raise ArgumentError(f"{name}: given one {kind.__name__}; expected a sequence of them")
    if not isinstance(given, Iterable):
        raise ArgumentError(f"{name}: given {short(given)}; expected a sequence")


def _start(scenario: Scenario) -> None:
    gimbals = scenario.platform.gimbals
    real_array("q", scenario.q, (len(gimbals),))
    real_array("rate", scenario.rate, (len(gimbals),))
    real_array("Omega", scenario.Omega, (3,))
    for gimbal, angle in zip(gimbals, scenario.q, strict=True):
        if gimbal.stops is not None and not gimbal.stops[0] <= angle <= gimbal.stops[1]:
            raise ArgumentError(
                f"q: {gimbal.angle} starts at {angle:.6g} rad; expected it between its stops {gimbal.stops}"
            )


def _motion(scenario: Scenario) -> None:
    real_array("torque", scenario.torque, (3,))
    if scenario.mode == "stabilised":
        given = {"profile": scenario.profile is not None, "Omega_table": scenario.Omega_table is not None}
        why = "where the root is free; expected torque or torque_table"
    else:
        given = {name: bool(getattr(scenario, name).any()) for name in ("torque", "Omega")}
        given["torque_table"] = scenario.torque_table is not None
        why = "where Omega is prescribed; expected profile or Omega_table"
    for name, there in given.items():
        if there:
            raise ArgumentError(f"{name}: given in mode {scenario.mode!r}, {why}")
    if scenario.mode == "stabilised" and any(vibration.kind == "rate" for vibration in scenario.vibrations):
        raise ArgumentError("vibration: of kind 'rate' in mode 'stabilised', where the root is free; expected 'force'")


def part_of(platform: Platform, fault: Fault) -> int:
    """Return the index of the part that a fault happens to; 0 where it is of all controllers.

    Raises
    ------
    ArgumentError
        The plant has no such part.
    """
    kind = FAULT_KEYS[fault.kind].part
    if kind is None:
        return 0
    names = {
        "rotor": [rotor.name for rotor in platform.rotors],
        "torquer": [torquer.name for torquer in platform.torquers],
        "pick-off": [sensor.name for sensor in platform.sensors],
        "gimbal": list(platform.gimbal_names),
    }[kind]
    if fault.part not in names:
        raise ArgumentError(
            f"fault {fault.name!r}: given {_WORDS[kind]} {fault.part!r}; expected one of {', '.join(names)}"
        )
    return names.index(fault.part)
