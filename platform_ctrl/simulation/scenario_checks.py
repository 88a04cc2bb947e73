"""What a scenario has to be before it is flown: the kernel trusts every number that it is given."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from platform_ctrl.arguments import one_of, positive, real_array, whole
from platform_ctrl.description import Platform, expect_platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.scenario import FAULT_KEYS, Fault, HalfCosine, Scenario, TimeTable, Vibration
from platform_ctrl.signatures import short

# Numbers of a fault that divide, or would stand still at zero.
_POSITIVE = ("time_constant", "frequency_hz")
# What a run may take of memory and time.
_SAMPLES, _PERIODS, _LINES, _SUBSTEPS = 1e8, 1e3, 10_000, 1e8
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
    expect_platform(scenario.platform)
    one_of("mode", scenario.mode, ("caged", "stabilised"))
    positive("duration", scenario.duration, zero=True)
    positive("delay", scenario.delay, zero=True)
    whole("seed", scenario.seed, 0, 2**64 - 1)
    whole("run", scenario.run, 0, 2**64 - 1)
    _start(scenario)
    _motion(scenario)
    for name in ("vibrations", "faults"):
        if not isinstance(getattr(scenario, name), tuple | list):
            raise ArgumentError(f"{name}: given {short(getattr(scenario, name))}; expected a tuple of them")
    for vibration in scenario.vibrations:
        _vibration(vibration, scenario.mode == "stabilised")
    for fault in scenario.faults:
        _fault(fault)
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
    if scenario.profile is not None:
        packed_profile(scenario.profile)
    for name, table in (("Omega_table", scenario.Omega_table), ("torque_table", scenario.torque_table)):
        if table is not None:
            _table(name, table)


def packed_profile(profile: HalfCosine) -> FloatArray:
    """Return the rate vector, the rise and the hold of a half-cosine.

    Raises
    ------
    ArgumentError
        It is something else, or one of its numbers is out of range.
    """
    if not isinstance(profile, HalfCosine):
        raise ArgumentError(f"Omega_profile: given {profile!r}; expected a HalfCosine")
    if profile.axis not in (1, 2, 3):
        raise ArgumentError(f"Omega_profile: axis is {profile.axis!r}; expected 1, 2 or 3")
    if not math.isfinite(profile.rate):
        raise ArgumentError(f"Omega_profile: rate is {profile.rate!r}; expected a finite number")
    packed = np.zeros(5)
    packed[profile.axis - 1] = profile.rate
    packed[3] = positive("Omega_profile: rise", profile.rise, zero=True)
    packed[4] = positive("Omega_profile: hold", profile.hold, zero=True)
    return packed


def _table(name: str, table: TimeTable) -> None:
    if not isinstance(table, TimeTable):
        raise ArgumentError(f"{name}: given {short(table)}; expected a TimeTable")
    points = np.size(table.t)
    t = real_array(f"{name}: t", table.t, (points,))
    real_array(f"{name}: values", table.values, (points, 3))
    if points < (2 if table.smooth else 1) or np.any(np.diff(t) <= 0.0):
        least = "two times or more" if table.smooth else "times"
        raise ArgumentError(f"{name}: t is {short(t.tolist())}; expected {least} that increase, s")
    if not math.isfinite(table.scale):
        raise ArgumentError(f"{name}: scale is {table.scale!r}; expected a finite number")


def _vibration(vibration: Vibration, free: bool) -> None:
    if not isinstance(vibration, Vibration):
        raise ArgumentError(f"vibration: given {short(vibration)}; expected a Vibration")
    one_of("vibration: kind", vibration.kind, ("rate", "force"))
    if vibration.kind == "rate" and free:
        raise ArgumentError("vibration: of kind 'rate' in mode 'stabilised', where the root is free; expected 'force'")
    if vibration.axis not in (1, 2, 3):
        raise ArgumentError(f"vibration: axis is {vibration.axis!r}; expected 1, 2 or 3")
    whole("vibration: lines", vibration.lines, 1, _LINES)
    points = np.size(vibration.frequencies_hz)
    frequencies = real_array("vibration: frequencies_hz", vibration.frequencies_hz, (points,))
    densities = real_array("vibration: densities", vibration.densities, (points,))
    if points < 2 or frequencies[0] <= 0.0 or np.any(np.diff(frequencies) <= 0.0):
        given = short(frequencies.tolist())
        raise ArgumentError(f"vibration: frequencies_hz is {given}; expected two or more that increase, > 0")
    if densities.any() and densities.min() <= 0.0:
        given = short(densities.tolist())
        raise ArgumentError(f"vibration: densities is {given}; expected numbers > 0, or all of them 0")


def _fault(fault: Fault) -> None:
    if not isinstance(fault, Fault):
        raise ArgumentError(f"fault: given {short(fault)}; expected a Fault")
    called = f"fault {fault.name!r}"
    one_of(f"{called}: kind", fault.kind, tuple(FAULT_KEYS))
    positive(f"{called}: at", fault.at, zero=True)
    if not _number(fault.until) or not fault.until > fault.at:
        raise ArgumentError(f"{called}: until is {fault.until!r}; expected a time after at = {fault.at:.6g} s")
    keys = FAULT_KEYS[fault.kind]
    for key in (*keys.needed, *keys.optional):
        number = getattr(fault, key)
        if key == "until":
            continue
        if key in _POSITIVE:
            positive(f"{called}: {key}", number)
        elif not _number(number) or not math.isfinite(number):
            raise ArgumentError(f"{called}: {key} is {number!r}; expected a finite number")
        elif key == "probability" and not 0.0 <= number <= 1.0:
            raise ArgumentError(f"{called}: probability is {number!r}; expected a number from 0 to 1")


def _number(given: object) -> bool:
    return isinstance(given, int | float | np.integer | np.floating)


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
