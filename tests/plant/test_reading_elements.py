"""Force elements and servo rotors of a plant file: read, refused in one line, and written back to the last bit."""

import copy
import tomllib

import pytest

from every_key import every_plant_key
from platform_ctrl import read_platform
from platform_ctrl.errors import InputError

# What tests of wrong files begin with.
PLANT = {
    "schema": 1,
    "name": "everything",
    "root": {"name": "base", "inertia": [1.0, 1.0, 1.0], "specific_force": [0.1, 0.0, 9.81]},
    "gimbal": [
        {
            "name": "outer",
            "parent": "base",
            "axis": [1, 0, 0],
            "inertia": [1e-3, 1e-3, 1e-3],
            "stops": [-0.2, 0.3],
            "restitution": 0.4,
        },
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
    "torquer": [{"gimbal": "outer", "limit": 0.2, "rate_limit": 30.0}, {"root_axis": 2}],
    "rate_sensor": [
        {"root_axis": 3, "noise_rms": 1e-5, "noise_bandwidth_hz": 200.0, "quantisation": 1e-7},
        {"gimbal": "inner"},
    ],
    "spring": [{"gimbal": "outer", "stiffness": -0.2, "rest": 0.01}, {"gimbal": "outer", "stiffness": 0.7}],
    "friction": [
        {"gimbal": "inner", "viscous": 0.1, "coulomb": [0.01, 0.02], "breakaway": [0.01, 0.05], "stribeck_rate": 0.2},
        {"gimbal": "outer", "coulomb": 0.03},
    ],
    "cage": [{"gimbal": "inner", "stiffness": 50.0, "damping": 0.1, "clearance": 0.002, "angle": 0.05}],
    "unbalance": [{"body": "base", "moment": [0.0, 0.0, -0.3]}, {"body": "inner", "moment": [1e-5, 0, 0]}],
    "erection": [{"gimbal": "outer", "senses": "inner", "axis": [0, 2, 0], "gain": 1e-3, "limit": 5e-4}],
}

# A plant as the drawing has it: masses, centres, joints.
MASSES = {
    "schema": 1,
    "name": "two offsets",
    "root": {"name": "base", "inertia": [0.1, 0.1, 0.1], "mass": 2.0, "centre": [0, 0, -0.1], "gravity": [0, 0, -9.81]},
    "gimbal": [
        {
            "name": "outer",
            "parent": "base",
            "axis": [1, 0, 0],
            "inertia": [1e-3, 1e-3, 1e-3],
            "mass": 0.5,
            "centre": [0.01, 0, 0],
            "origin": [0.02, 0.03, 0],
        },
        {
            "name": "inner",
            "parent": "outer",
            "axis": [0, 1, 0],
            "inertia": [1e-3, 1e-3, 1e-3],
            "mass": 0.3,
            "centre": [0, 0, 0],
            "origin": [0, 0.01, 0],
        },
    ],
    "rotor": [
        {
            "name": "wheel",
            "carrier": "inner",
            "axis": [0, 0, 1],
            "axial_inertia": 2e-4,
            "transverse_inertia": 1.1e-4,
            "spin": 900.0,
        }
    ],
    "torquer": [{"gimbal": "outer"}],
    "motor": [{"gimbal": "inner", "rotor_inertia": 1e-6, "gear": -20.0}],
}


def test_a_body_without_mass_needs_its_joint_at_the_origin_at_every_angle():
    plant = copy.deepcopy(MASSES)
    del plant["gimbal"][1]["mass"], plant["gimbal"][1]["centre"]
    # The outer gimbal turns about an axis through the origin, and the inner joint is back at the origin.
    plant["gimbal"][0]["origin"], plant["gimbal"][1]["origin"] = [0.02, 0, 0], [-0.02, 0, 0]
    assert not read_platform(plant).gimbals[1].mass
    plant["gimbal"][0]["axis"] = [1, 0, 0.1]
    with pytest.raises(InputError, match="not at the root's origin"):
        read_platform(plant)


def test_a_job_file_in_place_of_a_plant_is_recognised():
    with pytest.raises(InputError, match=r'this is a job file; give its plant instead, "three_gyro_platform"'):
        read_platform("examples/three_gyro_platform.toml")


PARTS = [kind for kind, tables in every_plant_key().items() if isinstance(tables, list)]


@pytest.mark.parametrize("kind", PARTS)
def test_every_kind_of_part_in_the_register_is_read_written_and_refused_by_its_name(kind):
    platform = read_platform(every_plant_key())
    parts = getattr(platform, f"{kind}s")
    assert len(parts) == len(every_plant_key()[kind]) + (kind in ("gimbal", "torquer"))  # a motor side; a servo
    assert len({type(part) for part in parts}) == 1
    assert len(tomllib.loads(platform.to_toml())[kind]) == len(every_plant_key()[kind])
    assert [repr(copy.deepcopy(part)) for part in parts] == [repr(part) for part in parts]
    for key in {key: None for part in every_plant_key()[kind] for key in part}:
        wrong = copy.deepcopy(every_plant_key())
        wrong[kind][0][key] = {} if key != "current_loop" else "fast"
        refused = f"{key}( must be .*, got|.* one of them is needed)|must be a table|has no effect|give (either|one of)"
        with pytest.raises(InputError, match=rf"\[\[{kind}\]\] 1.*{refused}"):
            read_platform(wrong)
