"""Masses, lengths and inertias in other units are refused, and no sound body is."""

import re
import tomllib
from pathlib import Path

import pytest

from platform_ctrl import platform_source, read_platform, shipped_models
from platform_ctrl.errors import InputError
from platform_ctrl.export import import_robot

ROBOTS = Path("tests/data/robots")
FACTORS = {
    "mm": {"centre": 1e3, "origin": 1e3},
    "g": {"mass": 1e3},
    "kg mm2": {"inertia": 1e6},
    "g mm2": {"inertia": 1e9},
}


def scaled(item, factors):
    """A plant whose gimbals have numbers under the keys of `factors` in other units."""
    if isinstance(item, list):
        return [scaled(one, factors) for one in item]
    return item * factors if isinstance(item, float | int) else item


def in_units(data, unit):
    keys = FACTORS[unit]
    gimbals = [
        {key: scaled(item, keys.get(key, 1.0)) if key in keys else item for key, item in g.items()}
        for g in data["gimbal"]
    ]
    return data | {"gimbal": gimbals}


MASSIVE = [name for name in shipped_models() if re.search(r"^mass =", platform_source(name), re.MULTILINE)]


@pytest.mark.parametrize("unit", FACTORS)
@pytest.mark.parametrize("name", [*MASSIVE, *sorted(one.name for one in ROBOTS.iterdir())])
def test_other_units_are_refused_with_the_right_ones(name, unit):
    data = tomllib.loads(platform_source(name) if name in MASSIVE else import_robot(ROBOTS / name).text)
    read_platform(data)
    if unit == "mm" and name == "double_gimbal_wheel_satellite":
        return  # its gimbals have no lengths within
    with pytest.raises(InputError, match=r"masses are in kg, lengths in m, inertias in kg m2") as error:
        read_platform(in_units(data, unit))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "body",
    [
        {"mass": 80.0, "inertia": [4.0, 4.0, 4.0], "centre": [20.0, 0.0, 0.0]},  # a head at the end of a crane
        {"mass": 90.0, "inertia": [9e3, 9e3, 18e3], "centre": [0.0, 0.0, 0.0]},  # a solar sail of 1600 m2
        {"mass": 2e-7, "inertia": [3e-14, 3e-14, 6e-14], "centre": [0.0, 0.0, 2e-4]},  # a micromirror
        {"mass": 3e6, "inertia": [1e9, 1e9, 2e9], "centre": [0.0, 0.0, 15.0]},  # a radio telescope of 100 m
        {"mass": 0.4, "inertia": [2e-6, 2e-6, 2e-7], "centre": [0.0, 0.0, 0.0]},  # a slug of tungsten
        {"mass": 1.0, "inertia": [1e-6, 1e-6, 1e-6], "centre": [0.1, 0.0, 0.0]},  # a placeholder of a robot description
    ],
)
def test_extreme_bodies_are_accepted(body):
    gimbal = {"name": "one", "parent": "root", "axis": [0, 0, 1]} | body
    root = {"name": "root", "inertia": [1.0, 1.0, 1.0]}
    assert read_platform({"schema": 1, "name": "x", "source": "assumed", "root": root, "gimbal": [gimbal]}).gimbals
