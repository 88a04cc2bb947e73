"""Masses, offsets, gears and the root's modes: reference values, and what two routes must agree on."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from offset_trees import MODES, offset_plant, offset_platform, turned
from oracle_trees import rotation
from platform_ctrl import (
    equations,
    forward_dynamics,
    inverse_dynamics,
    linearise,
    matrices,
    parameter_varying,
    read_platform,
    state_space,
)

CASES = json.loads((Path(__file__).parents[1] / "data" / "offset-cases.json").read_text())["cases"]
SEEDS = range(6)


def near(found, expected, allowed):
    assert np.abs(np.asarray(found) - expected).max(initial=0.0) <= allowed * np.abs(expected).max(initial=1e-12)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["tag"])
def test_reference_cases_of_masses_and_offsets(case):
    platform = read_platform(case["plant"])
    for state in case["states"]:
        q, u, change, force = (state[key] for key in ("q", "velocity", "acceleration", "force"))
        field = {key: state[key] for key in ("specific_force", "gravity", "attitude") if key in state}
        near(inverse_dynamics(platform, q, u, change, **field), force, 1e-11)
        m = matrices(platform, q, u)
        f = np.array(state.get("specific_force", platform.specific_force))
        if "specific_force" not in state:
            f = f - rotation(state.get("attitude", [1, 0, 0, 0])).T @ state.get("gravity", platform.gravity)
        weight = 0.0 if platform.mode == "floating" else m.P.T @ f
        near(m.A_star @ change + (m.G_A + m.G_R + m.G_root) @ u + weight, force, 1e-11)  # (11)
        near(m.A_star, state["A_star"], 1e-13)
        near(m.B, np.array(state["B"]).reshape(m.B.shape), 1e-13)
        found = forward_dynamics(platform, q, u, force, **field)
        still = forward_dynamics(platform, q, u, np.zeros(len(u)), **field)
        assert np.abs(found - change).max() <= 1e-9 * (np.abs(change).max() + np.abs(still).max())


def rows(platform, f, q, Omega, rate=None, change=None):
    """Return [M, Q] that hold or cause a motion, by Newton and Euler, as a function of small deviations."""
    n = len(platform.gimbals)
    u = np.r_[Omega, np.zeros(n) if rate is None else rate]
    return inverse_dynamics(platform, q, u, np.zeros(3 + n) if change is None else change, specific_force=f)


def slopes(function, size, step=1e-6):
    return np.array([(function(step * e) - function(-step * e)) / (2 * step) for e in np.eye(size)]).T


@pytest.mark.parametrize("seed", range(9))
def test_every_term_of_19_is_the_slope_of_newton_and_euler(seed):
    """Both rows of the linear equations, of gimbals and of the root, at any trim."""
    rng = np.random.default_rng(seed)
    platform = offset_platform(rng, MODES[seed % 3])
    n = len(platform.gimbals)
    q, Omega, f = rng.uniform(-3, 3, n), rng.normal(size=3), rng.normal(size=3) * 9.81
    model = linearise(platform, Omega, q=q, specific_force=f)
    still = rows(platform, f, q, Omega)
    size = np.abs(still).max() + np.abs(model.M).max() + np.abs(model.G).max()

    def same(found, expected):
        assert np.abs(found - expected).max(initial=0.0) < 3e-8 * (size + np.abs(expected).max(initial=0.0))

    same(model.Q0, still[3:])
    angle = slopes(lambda d: rows(platform, f, q + d, Omega), n)
    rate = slopes(lambda d: rows(platform, f, q, Omega, rate=d), n)
    turn = slopes(lambda d: rows(platform, f, q, Omega + d), 3)
    change = slopes(lambda d: rows(platform, f, q, Omega, change=d), 3 + n)
    force = slopes(lambda d: rows(platform, f + d, q, Omega), 3)
    same(model.stiffness, angle[3:])
    same(model.damping, rate[3:])
    same(model.G_Omega, turn[3:])
    same(np.block([[model.root_inertia, model.M_Omega.T], [model.M_Omega, model.M]]), change)
    same(-np.vstack([model.M_force, model.Q_force]), force)
    # The root's rows: J ω' + M_Omegaᵀ q̈ + G_r q̇ + K_r q + D ω.
    x = np.array([[0, -Omega[2], Omega[1]], [Omega[2], 0, -Omega[0]], [-Omega[1], Omega[0], 0]])
    same(-model.G_Omega.T + x @ model.M_Omega.T, rate[:3])
    same(-x @ model.G_Omega.T - model.M_angle, angle[:3])
    H = model.root_momentum
    same(x @ model.root_inertia - np.array([[0, -H[2], H[1]], [H[2], 0, -H[0]], [-H[1], H[0], 0]]), turn[:3])


@pytest.mark.parametrize("mode", MODES)
def test_a_free_root_under_gravity_has_the_poles_of_its_finite_differences(mode):
    """Its rotations are states: gravity is fixed in space, and a pendulum swings back."""
    rng = np.random.default_rng(3)
    platform = offset_platform(rng, mode, 2)
    while not platform.rotors:  # without any a floating plant has no poles but 0
        platform = offset_platform(rng, mode, 2)
    model = linearise(platform)
    system = state_space(model, root="free")
    n = len(platform.gimbals)
    x0, step = np.zeros(2 * n + 6), 1e-6

    def rates(x):
        """[q, θ, u]' of the non-linear equations."""
        q, theta, u = x[:n], x[n : n + 3], x[n + 3 :]
        attitude = np.r_[1.0, theta / 2] / np.linalg.norm(np.r_[1.0, theta / 2])
        field = {"gravity": platform.gravity, "attitude": attitude}
        return np.r_[u[3:], u[:3], forward_dynamics(platform, q, u, np.r_[np.zeros(3), model.Q0] + hold, **field)]

    hold = np.zeros(3 + n)
    if mode != "floating":
        hold[:3] = inverse_dynamics(platform, np.zeros(n), np.zeros(3 + n), np.zeros(3 + n))[:3]
    A = slopes(lambda d: rates(x0 + d), len(x0), step)
    ours, theirs = np.linalg.eigvals(system.A), np.linalg.eigvals(A)
    assert (system.nstates == 2 * n + 6) == (mode != "floating")
    for pole in ours:
        assert np.abs(theirs - pole).min() < 1e-4 * np.abs(theirs).max(), pole


def test_gravity_stays_where_it_is_while_a_held_root_turns():
    """What small rotations do to the momenta is the slope of the non-linear torques; they are the rates' integrals."""
    rng = np.random.default_rng(5)
    platform = offset_platform(rng, "held", 3)
    q, n = rng.uniform(-3, 3, 3), 3
    model = linearise(platform, q=q)
    system, turning = state_space(model), state_space(model, specific_force=True)

    def weight(theta):
        attitude = np.r_[1.0, theta / 2] / np.linalg.norm(np.r_[1.0, theta / 2])
        return -inverse_dynamics(platform, q, np.zeros(3 + n), np.zeros(3 + n), attitude=attitude)[3:]

    assert system.state_labels[2 * n :] == turning.state_labels[2 * n :] == ["theta1", "theta2", "theta3"]
    falling = slopes(weight, 3, 1e-5)
    np.testing.assert_allclose(system.A[n : 2 * n, 2 * n :], falling, atol=1e-8 * np.abs(falling).max())
    np.testing.assert_array_equal(system.B[2 * n :], np.eye(3, system.ninputs, system.ninputs - 3))
    assert state_space(linearise(dataclasses.replace(platform, gravity=np.zeros(3)), q=q)).nstates == 2 * n


@pytest.mark.parametrize("tag", ["elevation over azimuth", "camera gimbal, floating", "camera gimbal, held", "pivot"])
def test_matrices_in_symbols_are_those_of_the_numeric_route(tag):
    rng = np.random.default_rng(1)
    plant = next(case["plant"] for case in CASES if tag in case["tag"])
    if tag == "pivot":  # two of the three-gyro platform's five gimbals, with their rotor
        kept = {"4", "5", "6"}
        chosen = {key: [one for one in plant[key] if one["name"] in kept] for key in ("gimbal", "rotor")}
        plant = plant | chosen
    platform = read_platform(plant | {"root": plant["root"] | {"gravity": [1.0, 2.0, -9.0]}})
    n = len(platform.gimbals)
    velocity, q = rng.normal(size=3 + n), rng.uniform(-3, 3, n)
    exact = equations(platform, "sympy", order=None) if n < 3 else None
    first = equations(platform, "sympy", terms="exact")
    for found, angles in ((first, np.zeros(n)), (exact, q)):
        if found is not None:
            expected = matrices(platform, angles, velocity)
            for name in ("A", "A_star", "B", "G_A", "G_R", "G_root"):
                ours = found.evaluate(getattr(found, name), q=angles, velocity=velocity)
                near(ours, getattr(expected, name), 1e-11)
    # (27), weight included.
    Omega = rng.normal(size=3)
    model = linearise(platform, Omega)
    stiffness = np.zeros((n, n))
    constant = np.zeros(n)
    for row, terms in enumerate(first.rows["partially_linear"]):
        for coefficient, variable in terms:
            number = first.evaluate(coefficient, velocity=np.r_[Omega, np.zeros(n)])
            if variable == 1:
                constant[row] = number
            if variable in list(first.q):
                stiffness[row, list(first.q).index(variable)] = number
    near(stiffness, model.stiffness, 1e-10)
    near(constant, model.Q0, 1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_parameter_varying_form_is_the_linear_model_at_every_rate(seed):
    rng = np.random.default_rng(seed)
    platform = offset_platform(rng, MODES[seed % 3])
    Omega, change = rng.normal(size=3), rng.normal(size=3)
    frozen, model = parameter_varying(platform).at(Omega, change), linearise(platform, Omega)
    size = np.abs(model.stiffness).max() + np.abs(model.M).max()
    for found, expected in (
        (frozen.M, model.M),
        (frozen.G, model.damping),
        (frozen.K, model.stiffness + np.einsum("iaj,a->ij", model.M_Omega_q, change)),
        (frozen.forcing, model.M_Omega @ change + model.Q0),
    ):
        assert np.abs(found - expected).max() < 1e-9 * (size + np.abs(expected).max())


def test_one_body_of_a_floating_pair_has_the_closed_form():
    """Parallel axes 3, the joint d1, d2 from the centres of mass: a double pendulum in free space."""
    m1, m2, d1, d2, I1, I2 = 3.0, 1.5, 0.4, 0.25, 0.2, 0.05
    plant = {
        "schema": 1,
        "name": "pair",
        "root": {"name": "one", "mode": "floating", "mass": m1, "centre": [0, 0, 0], "inertia": [0.2, 0.2, I1]},
        "gimbal": [
            {"name": "two", "parent": "one", "axis": [0, 0, 1], "origin": [d1, 0, 0], "mass": m2, "centre": [d2, 0, 0]}
            | {"inertia": [0.04, 0.04, I2]}
        ],
    }
    mu = m1 * m2 / (m1 + m2)
    for q in (0.0, 0.7, 2.5):
        A = matrices(read_platform(plant), [q]).A_star[np.ix_([2, 3], [2, 3])]
        one, both = I2 + mu * (d2**2 + d1 * d2 * np.cos(q)), I2 + mu * d2**2
        whole = I1 + I2 + mu * (d1**2 + d2**2 + 2 * d1 * d2 * np.cos(q))
        np.testing.assert_allclose(A, [[whole, one], [one, both]], rtol=1e-13)


@pytest.mark.parametrize(("N", "share"), [(1, 0), (4, 0.5357), (20, 0.6786), (100, 0.7071), (-4, 0.8929)])
def test_a_free_load_takes_the_share_of_its_gear_of_the_base_acceleration(N, share):
    J, Nn = 0.02, 0.05
    plant = {
        "schema": 1,
        "name": "gear",
        "root": {"name": "base", "mode": "held", "inertia": [1, 1, 1]},
        "gimbal": [{"name": "load", "parent": "base", "axis": [0, 0, 1], "inertia": [0.015, 0.016, J]}],
        "motor": [{"gimbal": "load", "gear": N, "rotor_inertia": Nn / N**2}],
    }
    A = matrices(read_platform(plant)).A_star
    assert 1.0 - A[3, 2] / A[3, 3] == pytest.approx(share, abs=6e-5)


def test_a_uniform_field_falls_out_of_a_floating_root():
    plant = offset_plant(np.random.default_rng(2), "floating")
    with_field, without = read_platform(plant), read_platform(plant | {"root": plant["root"] | {"gravity": [0, 0, 0]}})
    n = len(with_field.gimbals)
    q, u, change = np.full(n, 0.3), np.full(3 + n, 0.2), np.full(3 + n, 0.1)
    attitude = turned(np.random.default_rng(1))
    expected = inverse_dynamics(without, q, u, change)
    np.testing.assert_allclose(inverse_dynamics(with_field, q, u, change, attitude=attitude), expected, rtol=1e-12)
