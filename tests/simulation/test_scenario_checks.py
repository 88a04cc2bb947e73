"""What is no scenario that can be flown is refused in one line, alone and in a batch, before the kernel sees it."""

from __future__ import annotations

import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation import Fault, HalfCosine, Scenario, TimeTable, Vibration, simulate, simulate_batch

PERIOD = 5e-4


def scenario(**other) -> Scenario:
    given = {"platform": pc.read_platform("three_gyro_platform"), "mode": "caged", "duration": 0.0, "delay": 0.0}
    return Scenario(**(given | other))


def profile(**other) -> HalfCosine:
    return HalfCosine(**({"axis": 1, "rate": 1.0, "rise": 0.1, "hold": 0.0} | other))


def fault(kind: str, part: str | None, **numbers) -> Fault:
    return Fault(**({"name": "it", "kind": kind, "part": part, "at": 0.0} | numbers))


def vibration(**other) -> Vibration:
    given = {"kind": "rate", "axis": 1, "frequencies_hz": np.array([1.0, 9.0]), "densities": np.array([1.0, 1.0])}
    return Vibration(**(given | other))


def table(t, values, **other) -> TimeTable:
    return TimeTable(t=np.array(t), values=np.array(values), **other)


MALFORMED = {
    "a mode": (lambda: scenario(mode="free"), "Scenario: mode must be 'caged' or 'stabilised', got 'free'"),
    "rates": (
        lambda: scenario(rate=[np.nan] * 5),
        "Scenario: rate must be real numbers, got NaN among them",
    ),
    "spins in words": (
        lambda: scenario(spin=["fast"]),
        r"Scenario: spin must be real numbers, got \['fast'\]",
    ),
    "a profile's axis": (lambda: profile(axis=4), "HalfCosine: axis must be a whole number from 1 to 3, got 4"),
    "a profile's rate": (lambda: profile(rate=np.inf), "HalfCosine: rate must be a finite number, got inf"),
    "a profile's rise": (lambda: profile(rise=-1.0), "HalfCosine: rise must be a finite number >= 0, got -1.0"),
    "a table's rows": (
        lambda: table([0.0, 1.0], np.zeros((3, 3))),
        r"TimeTable: values must have shape \(2, 3\), got \(3, 3\)",
    ),
    "a table's times": (
        lambda: table([1.0, 0.0], np.zeros((2, 3))),
        r"TimeTable: t must be times that increase, s, got \[1.0, 0.0\]",
    ),
    "one point of a spline": (
        lambda: table([0.0], np.zeros((1, 3)), smooth=True),
        "TimeTable: t must be two times or more that increase",
    ),
    "a vibration's axis": (lambda: vibration(axis=5), "Vibration: axis must be a whole number from 1 to 3, got 5"),
    "a vibration's kind": (
        lambda: vibration(kind="angle"),
        "Vibration: kind must be 'rate', 'force' or 'torque', got 'angle'",
    ),
    "a vibration from 0 Hz": (
        lambda: vibration(frequencies_hz=np.array([0.0, 9.0])),
        "frequencies_hz must be two or more that increase, > 0",
    ),
    "a density of 0": (
        lambda: vibration(densities=np.array([0.0, 1.0])),
        r"Vibration: densities must be numbers > 0, or all of them 0",
    ),
    "lines": (lambda: vibration(lines=0), "Vibration: lines must be a whole number from 1 to 10000, got 0"),
    "a fault's kind": (
        lambda: fault("broken", "Q9"),
        "Fault: kind must be 'rotor run-down', 'rotor run-up', 'speed ripple', 'torquer dead', 'torquer ",
    ),
    "a fault's end": (
        lambda: fault("torquer dead", "Q9", at=1.0, until=0.5),
        "fault 'it': until must be after at = 1 s, got 0.5",
    ),
    "a time constant": (
        lambda: fault("rotor run-down", "11"),
        "time_constant must be a finite number > 0, got 0.0",
    ),
    "a probability": (
        lambda: fault("controller overrun", None, probability=1.5),
        "fault 'it': probability must be a number from 0 to 1, got 1.5",
    ),
    "an end": (lambda: fault("torquer dead", "Q9", until="late"), "Fault: until must be a number, got 'late'"),
    "a rate": (lambda: fault("pick-off drift", "alpha9", rate="fast"), "Fault: rate must be a number, got 'fast'"),
    "a share": (lambda: fault("torquer weak", "Q9", share=np.nan), "Fault: share must be a number, got nan"),
}


@pytest.mark.parametrize(("malformed", "message"), MALFORMED.values(), ids=MALFORMED.keys())
def test_what_makes_no_sense_by_itself_is_refused_when_it_is_made(malformed, message: str) -> None:
    with pytest.raises(ArgumentError, match=message) as caught:
        malformed()
    assert str(caught.value).isprintable()


REFUSED = {
    "angles": ({"q": [0.0]}, r"q must have shape \(5,\), got \(1,\)"),
    "an angle beyond a stop": ({"q": [1.0, 0, 0, 0, 0]}, "q: alpha4 starts at 1 rad, outside its stops"),
    "rates": ({"rate": [np.inf] * 5}, r"rate must be finite numbers of shape \(5,\), got one that is not"),
    "Omega": ({"mode": "stabilised", "Omega": [0.1]}, r"Omega must have shape \(3,\), got \(1,\)"),
    "a prescribed Omega": (
        {"Omega": [0.1, 0.0, 0.0]},
        "Omega: has no effect in mode 'caged', where Omega is prescribed; give profile or Omega_table",
    ),
    "spins": ({"spin": [1.0]}, r"spin must have shape \(0,\), got \(1,\)"),
    "attitude": ({"attitude": [1.0, 1.0, 0.0, 0.0]}, "attitude must be a unit quaternion w, x, y, z, got a norm"),
    "duration": ({"duration": -1.0}, "duration must be a finite number >= 0, got -1.0"),
    "delay": ({"delay": np.inf}, "delay must be a finite number >= 0, got inf"),
    "run": ({"run": -1}, "run must be a whole number from 0 to 18446744073709551615, got -1"),
    "torque": (
        {"torque": [0.1, 0.0, 0.0]},
        "torque: has no effect in mode 'caged', where Omega is prescribed; give profile or Omega_table",
    ),
    "profile": (
        {"mode": "stabilised", "profile": profile()},
        "profile: has no effect in mode 'stabilised', where the root is free; give torque or torque_table",
    ),
    "a vibration's mode": (
        {"mode": "stabilised", "vibrations": (vibration(),)},
        "kind 'rate' has no effect in mode 'stabilised'",
    ),
    "a fault's part": (
        {"faults": (fault("torquer dead", "Q3"),)},
        "fault 'it': there is no torquer 'Q3', only Q4, Q5, Q7, Q9, Q10, M1, M2, M3",
    ),
}


@pytest.mark.parametrize(("other", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_flown_is_refused_in_one_line(other: dict, message: str) -> None:
    for refused in (
        lambda: simulate(scenario(**other), [], period=PERIOD),
        lambda: simulate_batch([scenario(**other)], [], period=PERIOD),
    ):
        with pytest.raises(ArgumentError, match=message) as caught:
            refused()
        assert str(caught.value).isprintable()


def single(one, controllers, period=PERIOD, **options) -> object:
    return simulate(one, controllers, period=period, **options)


def batch(several, controllers, **options) -> object:
    return simulate_batch(several, controllers, period=PERIOD, **options)


@pytest.mark.parametrize(
    ("refused", "message"),
    [
        (lambda: single(3, []), "scenario must be a Scenario, got 3"),
        (lambda: batch(scenario(), []), "scenarios must be a sequence, got one Scenario"),
        (
            lambda: simulate_batch([scenario()], [3], period=PERIOD),
            "controllers must be a sequence, each a control.StateSpace, got 3 among them",
        ),
        (lambda: batch(None, []), "scenarios must be a sequence, got None"),
        (lambda: batch([], None), "controllers must be a sequence, got None"),
        (lambda: single(scenario(), 3), "controllers must be a sequence, got 3"),
        (lambda: single(scenario(), [], period=1e300), "step: 0.0001 s is too short for a period of 1e[+]300 s"),
        (
            lambda: simulate_batch([scenario()], [], period=PERIOD, step=1e-320),
            "step: .* s is too short for a period of 0.0005 s",
        ),
        (
            lambda: simulate_batch([scenario()], [], period=PERIOD, threads=0),
            "threads must be a whole number >= 1, got 0",
        ),
        (lambda: single(scenario(), [], period=0.0), "period must be a finite number > 0, got 0.0"),
        (lambda: single(scenario(), [], step=-1.0), "step must be a finite number > 0, got -1.0"),
        (
            lambda: scenario(platform="three_gyro_platform"),
            "Scenario: platform must be a Platform, for example from read_platform, got 'three_gyro_platform",
        ),
    ],
)
def test_arguments_that_mean_nothing_are_refused(refused, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        refused()


def test_a_vibration_scaled_to_nothing_moves_nothing() -> None:
    still = Vibration(kind="rate", axis=1, frequencies_hz=np.array([1.0, 9.0]), densities=np.zeros(2))
    omega, amplitude = still.amplitudes
    assert np.all(omega > 0.0)
    assert not amplitude.any()
