"""Force elements and servo rotors of a plant file: read, refused in one line, and written back to the last bit."""

import copy
import tomllib

import numpy as np
import pytest

from platform_ctrl.errors import InputError
from platform_ctrl.reading import read_platform
from platform_ctrl.report.record import plant_data, toml

PLANT = {
    "schema": 1,
    "name": "everything",
    "root": {"name": "base", "inertia": [1.0, 1.0, 1.0], "specific_force": [0.1, 0.0, 9.81]},
    "gimbal": [
        {"name": "outer", "parent": "base", "axis": [1, 0, 0], "inertia": [1e-3, 1e-3, 1e-3]},
        {"name": "inner", "parent": "outer", "axis": [0, 1, 0], "inertia": [1e-3, 1e-3, 1e-3]},
    ],
    "rotor": [
        {
            "name": "wheel",
            "carrier": "inner",
            "axis": [0, 0, 1],
            "axial_inertia": 2e-4,
            "transverse_inertia": 1.1e-4,
            "spin": 900.0,
            "control": "servo",
            "speed_gain": 0.02,
            "speed_integral": 0.3,
            "torque_limit": 0.05,
        }
    ],
    "spring": [{"gimbal": "outer", "stiffness": -0.2, "rest": 0.01}, {"gimbal": "outer", "stiffness": 0.7}],
    "friction": [{"gimbal": "inner", "viscous": 0.1, "coulomb": [0.01, 0.02]}, {"gimbal": "outer", "coulomb": 0.03}],
    "cage": [{"gimbal": "inner", "stiffness": 50.0, "damping": 0.1, "clearance": 0.002, "angle": 0.05}],
    "unbalance": [{"body": "base", "moment": [0.0, 0.0, -0.3]}, {"body": "inner", "moment": [1e-5, 0, 0]}],
    "erection": [{"gimbal": "outer", "senses": "inner", "axis": [0, 2, 0], "gain": 1e-3, "limit": 5e-4}],
}


def test_everything_is_read():
    platform = read_platform(PLANT)
    np.testing.assert_array_equal(platform.specific_force, [0.1, 0.0, 9.81])
    assert [(s.gimbal, s.stiffness, s.rest) for s in platform.springs] == [("outer", -0.2, 0.01), ("outer", 0.7, 0.0)]
    assert [f.coulomb for f in platform.frictions] == [(0.01, 0.02), (0.03, 0.03)]
    assert platform.cages[0].clearance == 0.002
    assert [u.body for u in platform.unbalances] == ["base", "inner"]
    np.testing.assert_array_equal(platform.erections[0].axis, [0, 1, 0])
    wheel = platform.rotors[0]
    assert (wheel.control, wheel.speed_gain, wheel.speed_integral, wheel.torque_limit) == ("servo", 0.02, 0.3, 0.05)


def test_the_record_of_a_plant_reads_back_to_the_last_bit():
    platform = read_platform(PLANT)
    again = read_platform(tomllib.loads(toml(plant_data(platform))))
    assert plant_data(again) == plant_data(platform)
    assert again.cages[0].angle == 0.05
    assert again.rotors[0].torque_limit == 0.05


def changed(*path, to):
    data = copy.deepcopy(PLANT)
    table = data
    for step in path[:-1]:
        table = table[step]
    table[path[-1]] = to
    return data


def dropped(*path):
    data = copy.deepcopy(PLANT)
    table = data
    for step in path[:-1]:
        table = table[step]
    del table[path[-1]]
    return data


WRONG = {
    "no such gimbal": (changed("spring", 0, "gimbal", to="outr"), '[[spring]] 1 (gimbal "outr")', 'mean "outer"?'),
    "spring on the root": (changed("spring", 0, "gimbal", to="base"), "does not exist", "a gimbal"),
    "stiffness zero": (changed("spring", 0, "stiffness", to=0), "stiffness = 0", "a number other than 0"),
    "two frictions": (changed("friction", 1, "gimbal", to="inner"), "has a friction already", "expected one"),
    "negative viscous": (changed("friction", 0, "viscous", to=-1), "viscous = -1", "a number >= 0"),
    "negative coulomb": (changed("friction", 0, "coulomb", to=[0.1, -0.1]), "negative", "N m, or two"),
    "three coulombs": (changed("friction", 0, "coulomb", to=[1, 2, 3]), "has 3 elements", "or two"),
    "no rate": (changed("friction", 0, "coulomb_rate", to=0), "coulomb_rate = 0", "a number > 0"),
    "cage without stiffness": (dropped("cage", 0, "stiffness"), 'missing key "stiffness"', "a number > 0"),
    "unbalance of nobody": (changed("unbalance", 1, "body", to="x"), '(body "x")', "the root or a gimbal"),
    "moment too short": (changed("unbalance", 0, "moment", to=[1, 2]), "has 2 elements", "three numbers"),
    "senses nothing": (changed("erection", 0, "senses", to="innr"), 'senses = "innr"', 'mean "inner"?'),
    "axis zero": (changed("erection", 0, "axis", to=[0, 0, 0]), "of length zero", "three numbers"),
    "gain zero": (changed("erection", 0, "gain", to=0), "gain = 0", "other than 0"),
    "unknown key": (changed("cage", 0, "damp", to=1), 'unknown key "damp"', 'mean "damping"?'),
    "force too short": (changed("root", "specific_force", to=[9.81]), "[root]", "three numbers"),
    "servo without gain": (dropped("rotor", 0, "speed_gain"), 'control = "servo"', '"speed_gain"'),
    "loop without servo": (changed("rotor", 0, "control", to="free"), "speed_gain = 0.02", 'control = "servo"'),
    "gain negative": (changed("rotor", 0, "speed_gain", to=-1), "speed_gain = -1", "a number > 0"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_mistake_is_one_line_that_names_place_and_cure(case):
    data, *words = WRONG[case]
    with pytest.raises(InputError) as caught:
        read_platform(data)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


def test_a_job_file_in_place_of_a_plant_is_recognised():
    with pytest.raises(InputError, match=r'is a job file; expected a plant: its own is "three_gyro_platform"'):
        read_platform("examples/three_gyro_platform.toml")
