"""The shipped models read, and those of the paper's devices do what theory says."""

from __future__ import annotations

import dataclasses
import re
from math import cos, radians, sin, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import platform_ctrl as pc
from platform_ctrl import platform_source
from platform_ctrl.errors import MechanicsError

ROOT = Path(__file__).resolve().parents[2]
MODELS = sorted(file.stem for file in (ROOT / "models").glob("*.toml"))
MODEL = pytest.mark.parametrize("name", MODELS)


# ---------------------------------------------------------------------------------------------------- every model


@MODEL
def test_a_model_reads_and_goes_all_the_way_to_a_state_space(name: str) -> None:
    platform = pc.read_platform(name)
    n = len(platform.gimbals)
    m = pc.matrices(platform)
    assert np.all(np.linalg.eigvalsh(m.A_star) > 0.0)
    assert np.allclose(m.G_R, -m.G_R.T)
    model = pc.linearise(platform, Omega=(0.1, -0.2, 0.3))
    assert sorted(sum(pc.subsystems(model), ())) == sorted(platform.gimbal_names)
    # A mode of the structure has two states more, the root's attitude under gravity three.
    more, turned = 2 * len(platform.modes), 3 * bool(platform.gravity.any())
    for root, states in (("prescribed", 2 * n + more + turned), ("free", 2 * n + 3 + more + turned)):
        system = pc.state_space(model, root=root)  # type: ignore[arg-type]
        assert system.nstates == states
        assert np.all(np.isfinite(system.A))
    assert platform.torquers
    assert platform.pickoffs


# ---------------------------------------------------------------------------------------------------- what they share


def held(platform: pc.Platform) -> pc.Platform:
    """The device in a vehicle so heavy that nothing changes the vehicle's rates."""
    return dataclasses.replace(platform, root_inertia=1e5 * np.eye(3))


def poles(model: Any) -> np.ndarray:
    return pc.state_space(model).poles()


@pytest.mark.parametrize("name", ["gimballed_gyro", "rate_gyro", "gyro_horizon", "suspended_platform"])
def test_the_frequencies_in_the_head_of_a_model_are_those_of_its_poles(name: str) -> None:
    text = platform_source(name)
    quoted = [float(x) for x in re.findall(r"([\d.]+) rad/s\b", text[: text.index("schema")])]
    assert quoted
    found = np.abs(poles(pc.linearise(pc.read_platform(name))))
    for frequency in quoted:
        assert np.abs(found / frequency - 1.0).min() < 1e-3


# ---------------------------------------------------------------------------------------------------- gimballed gyro


def ideal_gyro() -> pc.Platform:
    return dataclasses.replace(pc.read_platform("gimballed_gyro"), frictions=(), unbalances=())


@pytest.mark.parametrize("beta", [-60.0, 0.0, 30.0])
def test_nutation_slows_down_as_the_spin_axis_nears_the_outer_axis(beta: float) -> None:
    # J_outer(beta) = 4e-4 + (1.5e-4 + C) sin2 + 3.8e-4 cos2: the regulated rotor adds C = 3e-4.
    b = radians(beta)
    J_outer = 4.0e-4 + 4.5e-4 * sin(b) ** 2 + 3.8e-4 * cos(b) ** 2
    found = np.abs(poles(pc.linearise(ideal_gyro(), q=(0.0, b)))).max()
    assert found == pytest.approx(0.6 * cos(b) / sqrt(J_outer * 3.8e-4), rel=1e-9)


# ---------------------------------------------------------------------------------------------------- rate gyro


@pytest.mark.parametrize("Omega", [(0.0, 0.6, 0.0), (2.0, -0.5, 0.0), (-4.0, 0.4, 0.0)])
def test_a_rate_gyro_comes_to_rest_where_spring_and_gyroscopic_torque_balance(Omega: tuple[float, ...]) -> None:
    gyro = dataclasses.replace(pc.read_platform("rate_gyro"), unbalances=())
    theta = pc.simulation.rollout(held(gyro), [[0.0]], [[*Omega, 0.0]], 2e-5, 15000).q[0, 0]
    L = 4.0e-6 * 2513.0
    assert 0.14 * theta == pytest.approx(L * (Omega[1] * cos(theta) - Omega[0] * sin(theta)), rel=1e-3)


def test_a_rate_gyro_topples_when_the_vehicle_rolls_too_fast_against_its_spin() -> None:
    gyro = pc.read_platform("rate_gyro")
    limit = -0.14 / (4.0e-6 * 2513.0)
    for factor, stable in ((0.98, True), (1.02, False)):
        assert bool(poles(pc.linearise(gyro, (factor * limit, 0.0, 0.0))).real.max() < 0.0) is stable


def test_an_acceleration_along_the_input_axis_looks_like_a_rate() -> None:
    system = pc.state_space(pc.linearise(pc.read_platform("rate_gyro")), specific_force=True)
    rate_per_g = system["theta", "f2"].dcgain() / system["theta", "Omega2"].dcgain()
    assert np.real(rate_per_g) == pytest.approx(-1e-7 / (4.0e-6 * 2513.0), rel=1e-9)
    # Along the spin axis and along the output axis it does nothing.
    assert system["theta", "f1"].dcgain() == pytest.approx(0.0, abs=1e-12)
    assert system["theta", "f3"].dcgain() == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------------------------------------------- gyro horizon


def flown(horizon: pc.Platform, q: tuple[float, float], Omega: tuple[float, ...], duration: float) -> tuple:
    """Time and angles, every second."""
    out = pc.simulation.rollout(held(horizon), [q], [[*Omega, 0.0, 0.0]], 1e-3, round(duration * 1e3), every=1000)
    return out.t, out.q_history[0].T


def test_a_horizon_rights_itself_in_roll_and_in_pitch() -> None:
    horizon = pc.read_platform("gyro_horizon")
    kappa, start = 3.142e-3 / (2.0e-4 * 1571.0), radians(20.0)
    t, (roll, _) = flown(horizon, (-start, 0.0), (0.0, 0.0, 0.0), 150.0)
    assert np.tan(roll / 2.0) == pytest.approx(-tan(start / 2.0) * np.exp(-kappa * t), abs=2e-3 * start)
    t, (_, pitch) = flown(horizon, (0.0, start), (0.0, 0.0, 0.0), 150.0)
    assert np.sin(pitch) == pytest.approx(sin(start) * np.exp(-kappa * t), abs=2e-3 * start)


def test_beyond_the_limit_a_horizon_rights_itself_at_a_constant_rate() -> None:
    rate = 1.571e-3 / (2.0e-4 * 1571.0)
    _, (roll, _) = flown(pc.read_platform("gyro_horizon"), (radians(60.0), 0.0), (0.0, 0.0, 0.0), 90.0)
    assert np.diff(roll) == pytest.approx(-rate, rel=5e-3)


# ---------------------------------------------------------------------------------------------------- satellite


def satellite(h: float, inertia: tuple[float, ...] = (800, 1000, 1150), locked: bool = False) -> pc.Platform:
    platform = pc.read_platform("momentum_wheel_satellite")
    wheel = dataclasses.replace(platform.rotors[0], angular_momentum=h)
    platform = dataclasses.replace(platform, rotors=(wheel,), root_inertia=np.diag(np.array(inertia, dtype=float)))
    if not locked:
        return platform
    stiff = tuple(dataclasses.replace(spring, stiffness=1e6) for spring in platform.springs)
    return dataclasses.replace(platform, springs=stiff, frictions=())


def growth_of(platform: pc.Platform, Omega0: float) -> float:
    found = pc.state_space(pc.linearise(platform, (0.0, Omega0, 0.0)), root="free").poles()
    return float(np.delete(found, np.abs(found).argmin()).real.max())


def momenta(platform: pc.Platform) -> np.ndarray:
    """J1, J2, J3 of all bodies together."""
    return np.diag(pc.linearise(platform).root_inertia)


@settings(max_examples=8, deadline=None)
@given(
    h=st.floats(-30.0, 30.0),
    Omega0=st.floats(0.02, 0.1),
    inertia=st.sampled_from([(800, 1000, 1150), (1150, 800, 1000), (800, 1150, 1000)]),
)
def test_a_wheel_in_locked_gimbals_stabilises_where_the_two_factors_agree(
    h: float, Omega0: float, inertia: tuple[float, ...]
) -> None:
    platform = satellite(h, inertia, locked=True)
    J1, J2, J3 = momenta(platform)
    product = (h + (J2 - J1) * Omega0) * (h + (J2 - J3) * Omega0)
    rate = growth_of(platform, Omega0)
    if product > 1e-2:
        assert rate < 1e-6
    elif product < -1e-2:
        assert rate == pytest.approx(sqrt(-product / (J1 * J3)), rel=1e-2)


@settings(max_examples=8, deadline=None)
@given(h=st.floats(-30.0, 30.0), Omega0=st.floats(0.02, 0.1), inertia=st.permutations((800, 1000, 1150)))
def test_damped_gimbals_leave_it_stable_only_where_its_energy_is_least(
    h: float, Omega0: float, inertia: list[float]
) -> None:
    platform = satellite(h, tuple(inertia))
    J1, J2, J3 = momenta(platform)
    k, H = 8.0, J2 * Omega0 + h
    # Energy at constant momentum H over the tilt of the satellite and of the wheel, about axes 1 and 3.
    energy = [[[H * H / J - Omega0 * H, -H * h / J], [-H * h / J, h * h / J + h * Omega0 + k]] for J in (J1, J3)]
    least = np.linalg.eigvalsh(np.array(energy))[:, 0]
    assume(np.abs(least).min() > 1e-2)
    assume(abs(h) > 0.1)  # without momentum the wheel hardly moves its gimbals, and the dampers take no energy
    assert bool(growth_of(platform, Omega0) < 0.0) is bool(np.all(least > 0.0))


@pytest.mark.parametrize(("h", "factor"), [(20.0, (0.0, 1.5)), (0.0, (20.0, np.inf))])
def test_the_non_linear_satellite_keeps_its_axis_with_the_wheel_and_loses_it_without(
    h: float, factor: tuple[float, float]
) -> None:
    platform = satellite(h)
    steps = round(500.0 / 2e-3)
    start = [[1e-4, 0.05, 0.0, 0.0, 0.0]]
    out = pc.simulation.rollout(platform, [[0.0, 0.0]], start, 2e-3, steps, every=steps // 200)
    across = np.abs(out.velocity_history[0][:, [0, 2]]).max() / 1e-4
    assert factor[0] < across < factor[1]


# ---------------------------------------------------------------------------------------------------- suspension


def at_pitch(angle: float) -> np.ndarray:
    q = np.zeros(8)
    q[1] = radians(angle)
    return q


def test_the_gyros_in_the_suspension_are_those_of_the_platform_alone() -> None:
    alone = pc.linearise(pc.read_platform("three_gyro_platform"))
    suspended = pc.linearise(pc.read_platform("suspended_platform"))
    for matrix in ("M", "G", "K"):
        assert getattr(suspended, matrix)[3:, 3:] == pytest.approx(getattr(alone, matrix), abs=1e-15)
    # At zero angles the suspension's rates are the platform's.
    assert suspended.M[3:, :3] == pytest.approx(alone.M_Omega, abs=1e-15)
    assert suspended.G[3:, :3] == pytest.approx(alone.G_Omega, abs=1e-15)
    assert np.linalg.matrix_rank(alone.G_Omega) == 3


def massless(platform: pc.Platform) -> pc.Platform:
    frames = tuple(
        dataclasses.replace(g, inertia=np.zeros((3, 3))) if g.name in ("roll", "pitch") else g for g in platform.gimbals
    )
    return dataclasses.replace(platform, gimbals=frames)


def test_gimbal_lock_is_an_error_that_names_the_two_axes() -> None:
    platform = massless(pc.read_platform("suspended_platform"))
    q = at_pitch(90.0)
    with pytest.raises(MechanicsError, match=r"roll, azimuth can move without moving any inertia \(gimbal lock\)"):
        pc.state_space(pc.linearise(platform, q=q))
    with pytest.raises(MechanicsError, match="gimbal lock"):
        pc.forward_dynamics(platform, q, np.zeros(11), np.zeros(11))
    assert np.all(np.isfinite(pc.forward_dynamics(platform, at_pitch(89.0), np.zeros(11), np.ones(11))))


def test_frames_of_finite_inertia_keep_the_mass_matrix_regular_and_turn_the_platform_instead() -> None:
    platform = pc.read_platform("suspended_platform")
    q = at_pitch(90.0)
    assert np.linalg.cond(pc.matrices(platform, q).A_star[3:6, 3:6]) < 20.0
    model = pc.linearise(platform, q=q)
    rates = -np.linalg.solve(model.M, model.M_Omega[:, 2])
    # No bearing of the suspension can take up a yaw of the vehicle: the whole platform goes along.
    assert rates[:3] == pytest.approx(0.0, abs=0.03)  # but for its products of inertia
