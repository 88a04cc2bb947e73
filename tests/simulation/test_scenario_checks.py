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
    "a profile's rise": (lambda: profile(rise=-1.0), "HalfCosine: rise must be a number >= 0, got -1.0"),
    "a table's times": (
        lambda: table([1.0, 0.0], np.zeros((2, 3))),
        r"TimeTable: t must be times that increase, s, got \[1.0, 0.0\]",
    ),
    "a density of 0": (
        lambda: vibration(densities=np.array([0.0, 1.0])),
        r"Vibration: densities must be a density > 0 for each frequency",
    ),
    "a fault's kind": (
        lambda: fault("broken", "Q9"),
        'Fault: kind must be "rotor run-down" or "rotor run-up" or',
    ),
}


@pytest.mark.parametrize(("malformed", "message"), MALFORMED.values(), ids=MALFORMED.keys())
def test_what_makes_no_sense_by_itself_is_refused_when_it_is_made(malformed, message: str) -> None:
    with pytest.raises(ArgumentError, match=message) as caught:
        malformed()
    assert str(caught.value).isprintable()


REFUSED = {
    "an angle beyond a stop": ({"q": [1.0, 0, 0, 0, 0]}, "q: alpha4 starts at 1 rad, outside its stops"),
    "a prescribed Omega": (
        {"Omega": [0.1, 0.0, 0.0]},
        "Omega: has no effect in mode 'caged', where Omega is prescribed; give profile or Omega_table",
    ),
    "attitude": ({"attitude": [1.0, 1.0, 0.0, 0.0]}, "attitude must be a unit quaternion w, x, y, z, got a norm"),
    "profile": (
        {"mode": "stabilised", "profile": profile()},
        "profile: has no effect in mode 'stabilised', where the root is free; give torque or torque_table",
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
