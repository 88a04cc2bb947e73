"""The compiled non-linear plant against published-style cases, independent energies, and conservation laws."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from kernel_entries import momenta, state_derivative, whole_state
from oracle_trees import turn
from platform_ctrl import Platform, inverse_dynamics, matrices
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation import rollout
from small_trees import tree
from tree_cases import platform_of_case

CASES = json.loads((Path(__file__).parents[1] / "data" / "dynamics-cases.json").read_text())["groups"]


PLATFORMS = {group["tree"]["name"]: platform_of_case(group["tree"]) for group in CASES}
THREE_GYROS = PLATFORMS["three_gyro_full_tensors"]


def some_free(platform: Platform) -> Platform:
    """The same platform with every other rotor free-running."""
    rotors = [dataclasses.replace(r, control="free") if k % 2 == 0 else r for k, r in enumerate(platform.rotors)]
    return dataclasses.replace(platform, rotors=tuple(rotors))


def momentum(platform, q, velocity):
    """[H, p] = A* u + BᵀL."""
    return momenta(platform, whole_state(q, velocity))[0]


def joint_momenta(platform, q, velocity):
    return momentum(platform, q, velocity)[3:]


def kinetic_energy(platform, q, velocity):
    """T2 + T1 of (9), body by body in the bodies' own axes, for gimbals that are listed after their parents."""
    rate = {platform.root_name: np.asarray(velocity[:3])}
    for k, gimbal in enumerate(platform.gimbals):
        rate[gimbal.name] = turn(gimbal.axis, q[k]).T @ rate[gimbal.parent] + gimbal.axis * velocity[3 + k]
    energy = 0.5 * rate[platform.root_name] @ platform.root_inertia @ rate[platform.root_name]
    energy += sum(0.5 * rate[g.name] @ g.inertia @ rate[g.name] for g in platform.gimbals)
    for rotor in platform.rotors:
        w = rate[rotor.carrier]
        axial = rotor.axis @ w
        energy += 0.5 * rotor.transverse_inertia * (w @ w - axial**2) + rotor.angular_momentum * axial
        energy += 0.5 * rotor.axial_inertia * axial**2 if rotor.control == "regulated" else 0.0
    return energy


def random_state(platform, seed, size=1.0):
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    return size * rng.standard_normal(n), size * rng.standard_normal(n + 3), rng.standard_normal(n + 3)


@pytest.mark.parametrize("k", range(5))
def test_a_locked_gimbal_stays_where_it_is_and_the_others_move_as_if_it_were_no_joint(k):
    q, velocity, force = random_state(THREE_GYROS, 7)
    moving = np.delete(np.arange(8), 3 + k)
    mass = matrices(THREE_GYROS, q).A_star[np.ix_(moving, moving)]
    # Free root: a rate that is left to the gimbal stays in v, and does not turn it.
    rates, acceleration = state_derivative(THREE_GYROS, q, velocity, force, held=[k])
    needed = force - inverse_dynamics(THREE_GYROS, q, velocity, np.zeros(8))
    assert acceleration[moving] == pytest.approx(np.linalg.solve(mass, needed[moving]), rel=1e-9, abs=1e-10)
    assert (rates[k], acceleration[3 + k]) == (0.0, 0.0)
    assert np.delete(rates, k) == pytest.approx(np.delete(velocity[3:], k))
    # Prescribed Omega: the others' rates follow from their momenta alone.
    velocity[3 + k] = 0.0
    p = joint_momenta(THREE_GYROS, q, velocity)
    p[k] = 1e3
    rates, _ = state_derivative(THREE_GYROS, q, np.concatenate([velocity[:3], p]), force, free=False, held=[k])
    assert rates == pytest.approx(velocity[3:], rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("group", CASES, ids=lambda group: group["tree"]["name"])
def test_forward_dynamics_gives_back_the_accelerations_of_the_reference_cases(group):
    platform = platform_of_case(group["tree"])
    for state in group["states"]:
        rates, acceleration = state_derivative(platform, state["q"], state["u"], state["tau"])
        assert rates == pytest.approx(state["u"][3:])
        assert acceleration == pytest.approx(state["u_dot"], abs=1e-10, rel=1e-10)


@pytest.mark.parametrize("change", [lambda p: p, some_free], ids=["regulated", "some free"])
@pytest.mark.parametrize("name", PLATFORMS)
def test_joint_momenta_are_the_derivatives_of_the_kinetic_energy(name, change):
    platform = change(PLATFORMS[name])
    q, velocity, _ = random_state(platform, 1)
    step = np.eye(len(velocity))[3:]
    # T is quadratic in the rates: central differences are exact.
    expected = [
        0.5 * (kinetic_energy(platform, q, velocity + e) - kinetic_energy(platform, q, velocity - e)) for e in step
    ]
    assert joint_momenta(platform, q, velocity) == pytest.approx(np.array(expected), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("change", [lambda p: p, some_free], ids=["regulated", "some free"])
@pytest.mark.parametrize("name", PLATFORMS)
def test_momenta_change_by_the_torques_and_the_angle_derivative_of_the_kinetic_energy(name, change):
    platform = change(PLATFORMS[name])
    q, velocity, force = random_state(platform, 2)
    state = np.concatenate([velocity[:3], joint_momenta(platform, q, velocity)])
    rates, change_of_momenta = state_derivative(platform, q, state, force, free=False)
    size = 1e-5
    slope = [
        (kinetic_energy(platform, q + e, velocity) - kinetic_energy(platform, q - e, velocity)) / (2 * size)
        for e in size * np.eye(len(q))
    ]
    scale = np.abs(slope).max() + 1.0
    assert rates == pytest.approx(velocity[3:], rel=1e-9, abs=1e-9)
    assert change_of_momenta[3:] == pytest.approx(force[3:] + slope, abs=1e-8 * scale)


def test_a_torque_on_a_lone_root_turns_it_as_a_rigid_body():
    block = Platform(name="block", root_name="root", root_inertia=np.diag([2.0, 3.0, 4.0]), gimbals=())
    out = rollout(block, np.zeros((1, 0)), np.zeros((1, 3)), step=1e-2, steps=100, force=[[0.0, 0.6, 0.0]])
    assert out.velocity[0] == pytest.approx([0.0, 0.2, 0.0])
    assert out.attitude[0] == pytest.approx([np.cos(0.05), 0.0, np.sin(0.05), 0.0])


def test_recording_does_not_change_a_rollout():
    rng = np.random.default_rng(7)
    q, velocity = 0.3 * rng.standard_normal((5, 5)), 0.3 * rng.standard_normal((5, 8))
    plain = rollout(THREE_GYROS, q, velocity, steps=50)
    watched = rollout(THREE_GYROS, q, velocity, steps=50, every=7)
    assert watched.t == pytest.approx(1e-3 * np.array([0, 7, 14, 21, 28, 35, 42, 49, 50]))
    for name in ("q", "velocity", "attitude"):
        assert np.array_equal(getattr(plain, name), getattr(watched, name))
        history = getattr(watched, name + "_history")
        assert np.array_equal(history[:, -1], getattr(plain, name))
        assert np.array_equal(history[:, 2], getattr(rollout(THREE_GYROS, q, velocity, steps=14), name))
    assert np.array_equal(watched.q_history[:, 0], q)


def test_gimbals_that_carry_each_other_in_a_ring_are_refused():
    with pytest.raises(ArgumentError, match="must form a tree"):
        rollout(tree(1.0, [("a", "b", 1, 1.0), ("b", "a", 1, 1.0)]), [[0.0, 0.0]], [np.zeros(5)])
