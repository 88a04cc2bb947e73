"""Many free runs of the compiled plant: what is recorded of them, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from platform_ctrl import Platform
from platform_ctrl.simulation import rollout
from tree_cases import platform_of_case

CASES = json.loads((Path(__file__).parents[1] / "data" / "dynamics-cases.json").read_text())["groups"]


PLATFORMS = {group["tree"]["name"]: platform_of_case(group["tree"]) for group in CASES}
THREE_GYROS = PLATFORMS["three_gyro_full_tensors"]


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
