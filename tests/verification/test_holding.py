"""Torquers that cannot hold a weight, or overcome dry friction: no linear loop shows it, and nothing passes."""

import control
import numpy as np
import pytest

import platform_ctrl as pc
from given_controllers import verdict
from one_axis import job_of, loop_of
from platform_ctrl import design
from platform_ctrl.design.plants import plants_of
from platform_ctrl.verification import check_job

MASS, ARM, G = 2.0, 0.1, 9.81


def job(plant, **operation):
    gimbal = {"name": "g", "parent": "base", "axis": [0, 1, 0], "inertia": [0.02] * 3, "angle": "q"}
    weight = {"mass": MASS, "centre": [ARM, 0, 0]}
    data = {
        "schema": 1,
        "name": "arm",
        "root": {"name": "base", "inertia": [1.0, 1.0, 1.0], "mode": "held", "gravity": [0, 0, -G]},
        "gimbal": [gimbal | weight],
        "pickoff": [{"gimbal": "g"}],
    }
    loop = loop_of(["g_motor" if "compliance" in plant else "g"], ["q"], limits={"disk_margin": 0.3})
    operation = {"Omega": [0.1, 0.1, 0.1]} | operation
    return pc.read_job(job_of(data | plant, loop, rate_hz=2000.0, delay=1e-4, operation=operation))


def motor(**numbers):
    own = {"gimbal": "g", "rotor_inertia": 1e-5, "torque_constant": 0.05, "resistance": 2.0, "supply": 1e3}
    return {"motor": [own | {"current_loop": {"bandwidth_hz": 1000.0}} | numbers]}


def at_rest(read):
    weak = control.ss([], [], [], [[-1.0]], 5e-4, inputs=["q"], outputs=["Qg"])
    return [one for one in verdict(read, [weak]).requirements if one.name.startswith("torque at rest")]


WEIGHT = MASS * G * ARM
WEAK = motor(current_limit=0.5 * WEIGHT / 0.05)
ENOUGH = {"current_limit": 1.1 * WEIGHT / 0.05}
SAMPLED = {"inductance": 1e-3, "current_loop": {"bandwidth_hz": 1000.0, "rate_hz": 20000.0}}
TORQUER = {"torquer": [{"gimbal": "g", "limit": 1.1 * WEIGHT}]}


@pytest.mark.parametrize(
    ("plant", "share"),
    [
        (WEAK, 2.0),
        (motor(supply=0.8 * WEIGHT / 0.05 * 2.0), 1.25),  # stall current times the torque constant
        (motor(current_limit=1.1 * WEIGHT / 0.05), None),
        ({"torquer": [{"gimbal": "g"}]}, None),
        (TORQUER, None),
        (TORQUER | {"friction": [{"gimbal": "g", "coulomb": 0.2 * WEIGHT}]}, 1.2 / 1.1),
        (WEAK | {"spring": [{"gimbal": "g", "stiffness": 1.0, "rest": WEIGHT}]}, 4.0),
        (WEAK | {"compliance": [{"gimbal": "g", "stiffness": 200, "inertia": 1e-3}]}, 2.0),
        (motor(**ENOUGH, **SAMPLED, ripple=[[7, 0.2, 0.0], [9, 0.1, 0.0]]), 1.0 / (1.1 * 0.7)),
        (motor(**ENOUGH, gear=2.0, torque_constant=0.025, cogging=[[7, 0.1 * WEIGHT, 0.0]]), 1.2 / 1.1),
        (motor(**ENOUGH, continuous_torque=0.8 * WEIGHT, thermal_time=60.0), 1.25),
        (motor(**SAMPLED, continuous_torque=1.01 * WEIGHT, ripple=[[7, 0.2, 0.0]]), 1.0 / (1.01 * 0.8)),
        (motor(**ENOUGH, continuous_torque=1.01 * WEIGHT), None),
    ],
)
def test_a_weight_that_no_torque_holds_is_a_requirement_that_is_missed(plant, share):
    read = job(plant)
    found = at_rest(read)
    assert [one.value for one in found] == ([] if share is None else [pytest.approx(share)])
    assert not any(one.passed for one in found)


def test_a_loop_has_the_limit_that_ripple_leaves():
    read = job(motor(**ENOUGH, **SAMPLED, ripple=[[7, 0.2, 0.0], [9, 0.1, 0.0]]))
    assert plants_of(read, read.loops[0]).torque_limit == pytest.approx([0.7 * 1.1 * WEIGHT])


def test_the_worst_angle_of_the_job_counts():
    read = job(
        motor(current_limit=1.05 * WEIGHT / 0.05) | {"unbalance": [{"body": "g", "moment": [0, 0, 0.1]}]},
        angles={"q": [0.5]},
    )
    [one] = at_rest(read)
    torques = [abs(G * (MASS * ARM * np.cos(q) + 0.1 * np.sin(q))) for q in (0.0, 0.5)]
    assert one.value == pytest.approx(max(torques) / (1.05 * WEIGHT))
    assert one.evidence.endswith("q = 0.5 rad")


def test_a_loop_that_cannot_hold_the_weight_is_no_pass():
    read = job(WEAK)
    result = check_job(read, design.loops(read))
    assert result.coupled.stable
    assert not result.passed
    assert [one.name for one in result.requirements if not one.passed] == ["torque at rest over its limit"]
