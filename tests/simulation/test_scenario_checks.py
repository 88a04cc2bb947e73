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
    "a mode": (lambda: scenario(mode="free"), "Scenario: mode: given 'free'; expected 'caged' or 'stabilised'"),
    "a seed": (lambda: scenario(seed=1.5), "Scenario: seed: given 1.5; expected a whole number"),
    "rates": (lambda: scenario(rate=[np.nan] * 5), "Scenario: rate: given a number that is not finite"),
    "spins in words": (lambda: scenario(spin=["fast"]), "Scenario: spin: given .'fast'.; expected an array"),
    "a profile's axis": (lambda: profile(axis=4), "HalfCosine: axis: given 4; expected a whole number from 1 to 3"),
    "a profile's rate": (lambda: profile(rate=np.inf), "HalfCosine: rate: given inf; expected a finite number"),
    "a profile's rise": (lambda: profile(rise=-1.0), "HalfCosine: rise: given -1.0; expected a finite number >= 0"),
    "a table's rows": (
        lambda: table([0.0, 1.0], np.zeros((3, 3))),
        r"TimeTable: values: given shape \(3, 3\); expected \(2, 3\)",
    ),
    "a table's times": (
        lambda: table([1.0, 0.0], np.zeros((2, 3))),
        r"TimeTable: t is \[1.0, 0.0\]; expected times that increase",
    ),
    "one point of a spline": (
        lambda: table([0.0], np.zeros((1, 3)), smooth=True),
        "TimeTable: t is .*; expected two times or more",
    ),
    "a vibration's axis": (lambda: vibration(axis=5), "Vibration: axis: given 5; expected a whole number from 1 to 3"),
    "a vibration's kind": (
        lambda: vibration(kind="angle"),
        "Vibration: kind: given 'angle'; expected 'rate' or 'force'",
    ),
    "a vibration from 0 Hz": (
        lambda: vibration(frequencies_hz=np.array([0.0, 9.0])),
        "expected two or more that increase, > 0",
    ),
    "a density of 0": (lambda: vibration(densities=np.array([0.0, 1.0])), "expected numbers > 0, or all of them 0"),
    "lines": (lambda: vibration(lines=0), "Vibration: lines: given 0; expected a whole number from 1 to 10000"),
    "faults": (
        lambda: scenario(faults=fault("torquer dead", "Q9")),
        "faults: given a Fault; expected a sequence, each a Fault",
    ),
    "a fault's kind": (
        lambda: fault("broken", "Q9"),
        "Fault: kind: given 'broken'; expected 'rotor run-down'",
    ),
    "a fault's end": (
        lambda: fault("torquer dead", "Q9", at=1.0, until=0.5),
        "fault 'it': until is 0.5; expected a time after at = 1 s",
    ),
    "a time constant": (
        lambda: fault("rotor run-down", "11"),
        "time_constant: given 0.0; expected a finite number > 0",
    ),
    "a probability": (
        lambda: fault("controller overrun", None, probability=1.5),
        "fault 'it': probability must be a number from 0 to 1, got 1.5",
    ),
    "an end": (lambda: fault("torquer dead", "Q9", until="late"), "Fault: until: given 'late'; expected a number"),
    "a rate": (lambda: fault("pick-off drift", "alpha9", rate="fast"), "Fault: rate: given 'fast'; expected a number"),
    "a share": (lambda: fault("torquer weak", "Q9", share=np.nan), "Fault: share: given nan; expected a number"),
}


@pytest.mark.parametrize(("malformed", "message"), MALFORMED.values(), ids=MALFORMED.keys())
def test_what_makes_no_sense_by_itself_is_refused_when_it_is_made(malformed, message: str) -> None:
    with pytest.raises(ArgumentError, match=message) as caught:
        malformed()
    assert str(caught.value).isprintable()


REFUSED = {
    "angles": ({"q": [0.0]}, r"q: given shape \(1,\); expected \(5,\)"),
    "an angle beyond a stop": ({"q": [1.0, 0, 0, 0, 0]}, "q: alpha4 starts at 1 rad; expected it between its stops"),
    "rates": ({"rate": [np.inf] * 5}, "rate: given a number that is not finite"),
    "Omega": ({"mode": "stabilised", "Omega": [0.1]}, r"Omega: given shape \(1,\); expected \(3,\)"),
    "a prescribed Omega": ({"Omega": [0.1, 0.0, 0.0]}, "Omega: given in mode 'caged', where Omega is prescribed"),
    "spins": ({"spin": [1.0]}, r"spin: given shape \(1,\); expected \(0,\)"),
    "attitude": ({"attitude": [1.0, 1.0, 0.0, 0.0]}, "attitude: given a norm of 1.41421; expected unit quaternions"),
    "duration": ({"duration": -1.0}, "duration: given -1.0; expected a finite number >= 0"),
    "delay": ({"delay": np.inf}, "delay: given inf; expected a finite number >= 0"),
    "run": ({"run": -1}, "run: given -1; expected a whole number"),
    "torque": ({"torque": [0.1, 0.0, 0.0]}, "torque: given in mode 'caged'"),
    "profile": (
        {"mode": "stabilised", "profile": profile()},
        "profile: given in mode 'stabilised', where the root is free; expected torque or torque_table",
    ),
    "a vibration's mode": ({"mode": "stabilised", "vibrations": (vibration(),)}, "of kind 'rate' in mode 'stabilised'"),
    "a fault's part": (
        {"faults": (fault("torquer dead", "Q3"),)},
        "fault 'it': given torquer 'Q3'; expected one of Q4",
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
        (lambda: single(3, []), "scenario: given 3; expected a Scenario"),
        (lambda: batch(scenario(), []), "scenarios: given a Scenario; expected a sequence"),
        (
            lambda: simulate_batch([scenario()], [3], period=PERIOD),
            "controllers: given 3 among the items; expected a seq",
        ),
        (lambda: batch(None, []), "scenarios: given None; expected a sequence"),
        (lambda: batch([], None), "controllers: given None; expected a sequence"),
        (lambda: single(scenario(), 3), "controllers: given 3; expected a sequence"),
        (lambda: single(scenario(), [], period=1e300), "step: 0.0001 s is too short for a period of 1e[+]300 s"),
        (
            lambda: simulate_batch([scenario()], [], period=PERIOD, step=1e-320),
            "step: .* s is too short for a period of 0.0005 s",
        ),
        (
            lambda: simulate_batch([scenario()], [], period=PERIOD, threads=0),
            "threads: given 0; expected a whole number >= 1",
        ),
        (lambda: single(scenario(), [], period=0.0), "period: given 0.0; expected a finite number > 0"),
        (lambda: single(scenario(), [], step=-1.0), "step: given -1.0; expected a finite number > 0"),
        (
            lambda: scenario(platform="three_gyro_platform"),
            "platform: given 'three_gyro_platform'; expected a Platform",
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
