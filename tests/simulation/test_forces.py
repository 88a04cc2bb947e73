"""Force elements in the compiled kernel: against the Python route on random trees, and by energies and rest points."""

from __future__ import annotations

import dataclasses

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from body_geometry import directions
from first_instants import first_slopes
from plant_parts import Cage, Erection, Friction, PickOff, Spring, Torquer, Unbalance
from platform_ctrl import Platform, element_forces, forward_dynamics, inverse_dynamics, matrices
from platform_ctrl.simulation import rollout
from single_runs import simulated
from small_trees import tree
from tree_cases import platforms

J, L, GRAVITY = 2e-3, 0.15, 9.81
seeds = st.integers(0, 2**32 - 1)


def furnished(platform: Platform, seed: int) -> Platform:
    """The platform with any number of elements anywhere."""
    rng = np.random.default_rng(seed)
    names = platform.gimbal_names
    bodies = (platform.root_name, *names)

    def some(of, at_most=2):
        return [of[k] for k in rng.integers(len(of), size=rng.integers(at_most + 1) * len(of))]

    def unit():
        axis = rng.normal(size=3)
        return axis / np.linalg.norm(axis)

    return dataclasses.replace(
        platform,
        springs=tuple(Spring(gimbal=g, stiffness=rng.normal(), rest=rng.normal()) for g in some(names)),
        frictions=tuple(
            Friction(
                gimbal=g,
                viscous=rng.uniform(),
                coulomb=tuple(rng.uniform(size=2)),
                coulomb_rate=0.3,
                breakaway=tuple(rng.uniform(1.0, 2.0, size=2)),
                stribeck_rate=rng.choice([0.5, np.inf]),
            )
            for g in names[::2]
        ),
        cages=tuple(
            Cage(gimbal=g, stiffness=3.0, damping=1.5, clearance=rng.choice([0.0, 0.3]), angle=rng.normal())
            for g in set(some(names))
        ),
        unbalances=tuple(Unbalance(body=b, moment=rng.normal(size=3)) for b in some(bodies)),
        erections=tuple(
            Erection(gimbal=g, senses=str(rng.choice(bodies)), axis=unit(), gain=rng.normal(), limit=limit)
            for g in some(names, 1)
            for limit in (None, 0.1)
        ),
        specific_force=rng.normal(size=3),
    )


def along_coordinates(platform: Platform, seed: int) -> Platform:
    """The platform with some of its gimbals' axes, possibly all or none, along coordinate axes of either sign."""
    rng = np.random.default_rng(seed)
    share = rng.choice([0.0, 0.7, 1.0])
    gimbals = tuple(
        dataclasses.replace(g, axis=rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]) if rng.random() < share else g
        for g in platform.gimbals
    )
    return dataclasses.replace(platform, gimbals=gimbals)


def a_state(platform, seed):
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    return rng.normal(size=n), rng.normal(size=n + 3), rng.normal(size=n + 3)


trees = st.builds(along_coordinates, platforms(), seeds)


@settings(max_examples=25, deadline=None)
@given(trees, seeds, st.booleans())
def test_elements_accelerate_the_bodies_as_their_forces_do(platform, seed, free):
    platform = furnished(platform, seed)
    q, u, force = a_state(platform, seed + 1)
    acting = force + element_forces(platform, q, u)
    if free:
        expected = forward_dynamics(platform, q, u, acting)
    else:
        acting -= inverse_dynamics(platform, q, u, np.zeros(len(u)))
        expected = np.r_[np.zeros(3), np.linalg.solve(matrices(platform, q).A_star[3:, 3:], acting[3:])]
    found = first_slopes(platform, q, u, force, free)[len(q) :]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def three_gimbals(**elements) -> Platform:
    chain = [("a", "base", 3), ("b", "a", 1), ("c", "b", [0.0, 0.6, 0.8])]
    return tree(
        [2.0, 3.0, 4.0], [(*one, [0.5, 0.6, 0.4]) for one in chain], [("r", "c", 1, 0.2, 0.15, 1.5)], **elements
    )


SPRINGS = (
    Spring(gimbal="a", stiffness=4.0, rest=0.2),
    Spring(gimbal="c", stiffness=2.0),
    Spring(gimbal="c", stiffness=1),
)
UNBALANCES = (
    Unbalance(body="b", moment=np.array([0.02, -0.05, 0.1])),
    Unbalance(body="c", moment=np.array([0.1, 0.0, 0.05])),
)


def energy(platform, q, u):
    """T2 + V, with V of the springs and of the weight of the unbalances."""
    m = matrices(platform, q)
    index = {name: k for k, name in enumerate(platform.gimbal_names)}
    V = sum(0.5 * s.stiffness * (q[index[s.gimbal]] - s.rest) ** 2 for s in platform.springs)
    rotations = directions(platform, q).rotations
    V += sum(platform.specific_force @ rotations[1 + index[b.body]] @ b.moment for b in platform.unbalances)
    return 0.5 * u @ m.A_star @ u + V


def energies(platform, q, u):
    return np.array([energy(platform, *at) for at in zip(q, u, strict=True)])


def test_a_gimballed_pendulum_keeps_its_energy_in_gravity():
    platform = three_gimbals(springs=SPRINGS, unbalances=UNBALANCES, specific_force=np.array([1.0, 2.0, GRAVITY]))
    run = {"period": 0.02, "delay": 0.0, "duration": 3.0, "step": 5e-4}
    out = simulated(platform, [], mode="caged", q=[0.6, -0.3, 0.5], rate=[0.5, 0.0, 1.0], **run)
    kept = energies(platform, out.q, np.hstack([out.Omega, out.rate]))
    kinetic = energies(
        dataclasses.replace(platform, springs=(), unbalances=()), out.q, np.hstack([out.Omega, out.rate])
    )
    assert np.ptp(kinetic) > 0.3
    assert kept == pytest.approx(kept[0], rel=1e-8)


def test_viscous_friction_takes_out_its_power():
    frictions = (Friction(gimbal="a", viscous=0.3), Friction(gimbal="c", viscous=0.1))
    platform = three_gimbals(springs=SPRINGS, frictions=frictions)
    out = rollout(platform, [[0.6, -0.3, 0.5]], [[0.1, 0.2, 0.0, 0.5, 0.0, 1.0]], step=5e-4, steps=4000, every=4)
    kept = energies(platform, out.q_history[0, ::100], out.velocity_history[0, ::100])
    power = 0.3 * out.velocity_history[0, :, 3] ** 2 + 0.1 * out.velocity_history[0, :, 5] ** 2
    from scipy.integrate import simpson

    lost = simpson(power, x=out.t)
    assert lost > 0.2
    assert kept[0] - kept[-1] == pytest.approx(lost, rel=1e-8)


def one_gimbal(**more) -> Platform:
    return tree(
        1.0,
        [("g", "base", 3, J, "alpha")],
        torquers=(Torquer(name="Qg", gimbal="g"),),
        pickoffs=(PickOff(name="alpha", gimbal="g"),),
        **more,
    )


def caged(platform, duration, q=0.0, rate=0.0, gain=None):
    gains = [] if gain is None else [control.ss([], [], [], [[gain]], 1e-3, inputs="alpha", outputs="Qg", name="K")]
    return simulated(platform, gains, period=1e-3, delay=0.0, duration=duration, mode="caged", q=[q], rate=[rate])


def test_a_run_with_a_singular_mass_matrix_is_nan_in_a_rollout_and_ends_a_simulation_at_its_start():
    platform = one_gimbal(springs=(Spring(gimbal="g", stiffness=1.0),))
    nothing = dataclasses.replace(platform.gimbals[0], inertia=np.zeros((3, 3)))
    platform = dataclasses.replace(platform, gimbals=(nothing,))
    assert np.isnan(rollout(platform, [[0.1]], np.zeros((1, 4)), steps=2).q).all()
    assert caged(platform, 0.1, q=0.1).ended == "diverged at t = 0 s"
