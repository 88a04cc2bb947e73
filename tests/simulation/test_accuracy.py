"""How well the kernel integrates: its order, and what a torque-free run keeps."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from oracle_trees import rotation
from platform_ctrl import Platform, matrices
from platform_ctrl.simulation import rollout
from simulation.test_forces import furnished, three_gimbals
from simulation.test_plant import THREE_GYROS

FREE = dataclasses.replace(
    THREE_GYROS, rotors=tuple(dataclasses.replace(r, control="free") for r in THREE_GYROS.rotors)
)
SOME_FREE = dataclasses.replace(THREE_GYROS, rotors=(FREE.rotors[0], *THREE_GYROS.rotors[1:]))


def a_start(platform: Platform, runs: int = 1, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    return 0.3 * rng.normal(size=(runs, n)), 0.3 * rng.normal(size=(runs, n + 3))


def kept(platform: Platform, out: Any) -> tuple[np.ndarray, np.ndarray]:
    """T2 (runs, S) and the inertial angular momentum (runs, S, 3) along runs."""
    energies, momentum = [], []
    for run in zip(out.q_history, out.velocity_history, out.attitude_history, strict=True):
        found = [(u, matrices(platform, q, u), rotation(e)) for q, u, e in zip(*run, strict=True)]
        energies.append([0.5 * u @ m.A_star @ u for u, m, _ in found])
        momentum.append([R @ (m.A_star @ u + m.B.T @ m.L)[:3] for u, m, R in found])
    return np.array(energies), np.array(momentum)


def drifts(energies: np.ndarray, momentum: np.ndarray) -> tuple[float, float]:
    """Largest relative changes of either."""
    away = np.linalg.norm(momentum - momentum[:, :1], axis=-1) / np.linalg.norm(momentum[:, :1], axis=-1)
    return float(np.abs(energies / energies[:, :1] - 1.0).max()), float(away.max())


@pytest.mark.parametrize("platform", [THREE_GYROS, FREE], ids=["regulated", "free"])
def test_the_error_falls_with_the_fourth_power_of_the_step(platform):
    q, velocity = a_start(platform)
    counts = np.array([100, 200, 400, 800, 12800])
    ends = []
    for steps in counts:
        out = rollout(platform, q, velocity, step=0.4 / steps, steps=int(steps))
        ends.append(np.concatenate([out.q[0], out.velocity[0], out.attitude[0]]))
    error = np.linalg.norm(np.array(ends[:-1]) - ends[-1], axis=1)
    assert error[0] > 1e-6
    slopes = -np.diff(np.log(error)) / np.diff(np.log(counts[:-1]))
    assert slopes == pytest.approx(4.0, abs=0.25)
    assert slopes[-1] == pytest.approx(4.0, abs=0.05)


def test_servo_rotors_and_smooth_elements_are_integrated_with_the_fourth_order():
    # A cage without clearance and everything else that is smooth.
    platform = furnished(three_gimbals(), 12)
    cages = tuple(dataclasses.replace(c, clearance=0.0) for c in platform.cages)
    wheel = dataclasses.replace(platform.rotors[0], control="servo", speed_gain=2.0, speed_integral=9.0)
    frictions = tuple(dataclasses.replace(f, coulomb=(0.2, 0.2), breakaway=(0.4, 0.4)) for f in platform.frictions)
    platform = dataclasses.replace(platform, cages=cages, rotors=(wheel,), frictions=frictions, erections=())
    q, velocity = a_start(platform)
    counts = np.array([200, 400, 800, 12800])
    ends = []
    for steps in counts:
        out = rollout(platform, q, velocity, step=1.0 / steps, steps=int(steps), spin=[[wheel.spin + 1.0]])
        ends.append(np.concatenate([out.q[0], out.velocity[0], out.attitude[0], out.spin[0]]))
    error = np.linalg.norm(np.array(ends[:-1]) - ends[-1], axis=1)
    assert -np.diff(np.log(error)) / np.log(2.0) == pytest.approx(4.0, abs=0.3)


def test_many_torque_free_steps_lose_less_than_1e_10_of_energy_and_momentum():
    q, velocity = a_start(SOME_FREE, 8)
    out = rollout(SOME_FREE, q, velocity, step=1e-4, steps=100_000, every=10_000)
    assert np.ptp(out.q_history, axis=1).max(axis=0).min() > 0.003
    energy, momentum = drifts(*kept(SOME_FREE, out))
    assert energy < 1e-10
    assert momentum < 1e-10
