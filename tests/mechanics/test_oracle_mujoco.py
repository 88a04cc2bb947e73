"""MuJoCo against the method: every rotor is a body there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oracle_trees import (
    EPS,
    Motion,
    MujocoTree,
    agree,
    for_all,
    moments_carried,
    motions,
    rotation,
    rounding,
    sprung,
    unbalanced,
)
from platform_ctrl import Platform, element_forces, inverse_dynamics, matrices, rotor_momenta

mujoco = pytest.importorskip("mujoco", reason="MuJoCo (package mujoco) is not installed")

# Roundings in a row. MuJoCo turns by quaternions, and sums up in the world's axes.
FEW = 60 * EPS


@dataclasses.dataclass
class Bodies:
    """The motion with every rotor a body: free ones with the acceleration that leaves them without a torque."""

    tree: MujocoTree
    spin: np.ndarray
    spin_acceleration: np.ndarray
    force: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """[M, Q] of qfrc_inverse."""
        return self.force[self.tree.platform_places]


def as_bodies(motion: Motion, **options) -> Bodies:
    platform = motion.platform
    tree = MujocoTree(platform, **options)
    phi = motion.rng.uniform(-3, 3, len(platform.rotors))
    axial = np.array([rotor.axial_inertia for rotor in platform.rotors])
    tree.set(motion.q, motion.attitude, tree.vector(motion.velocity), phi)
    carried = (whole_mass_matrix(tree) @ tree.data.qvel)[tree.rotors] / axial
    spin = tree.spins(platform, carried)
    tree.set(motion.q, motion.attitude, tree.vector(motion.velocity, spin), phi)
    first = inverse(tree, tree.vector(motion.acceleration))
    spin_acceleration = -np.where(free(platform), first[tree.rotors] / axial, 0.0)
    return Bodies(tree, spin, spin_acceleration, inverse(tree, tree.vector(motion.acceleration, spin_acceleration)))


def free(platform: Platform) -> np.ndarray:
    return np.array([rotor.control == "free" for rotor in platform.rotors], dtype=bool)


def whole_mass_matrix(tree: MujocoTree) -> np.ndarray:
    """In MuJoCo's order."""
    mujoco.mj_fwdPosition(tree.model, tree.data)
    out = np.zeros((tree.size, tree.size))
    mujoco.mj_fullM(tree.model, tree.data, out)
    return out


def inverse(tree: MujocoTree, acceleration: np.ndarray) -> np.ndarray:
    tree.data.qacc[:] = acceleration
    mujoco.mj_inverse(tree.model, tree.data)
    return tree.data.qfrc_inverse.copy()


@for_all(motions(controls=("regulated", "free", "servo")), 60)
def test_inverse_dynamics_is_that_of_bodies_with_rotors_held_or_free(motion):
    bodies = as_bodies(motion)
    ours = inverse_dynamics(motion.platform, motion.q, motion.velocity, motion.acceleration)
    size = rounding(motion, bodies.spin, bodies.spin_acceleration)
    agree("[M, Q]", ours, bodies.rows, FEW * size.torque[: len(ours)])


@for_all(motions(), 30)
def test_both_mass_matrices_are_composites_of_bodies(motion):
    """Of locked rotors A*; of all bodies A + BᵀA_R B with A_R B beside it, and Schur takes the free rotors out."""
    platform, n = motion.platform, 3 + len(motion.q)
    allowed = FEW * rounding(motion).mass
    m = matrices(platform, motion.q)
    locked = MujocoTree(platform, rotors="locked")
    locked.set(motion.q, motion.attitude, np.zeros(n))
    places = locked.platform_places
    agree("A*", m.A_star, whole_mass_matrix(locked)[np.ix_(places, places)], allowed[:n, :n])
    bodies = MujocoTree(platform)
    bodies.set(motion.q, motion.attitude, np.zeros(bodies.size), 1.0)
    places = np.concatenate([bodies.platform_places, bodies.rotors])
    whole = whole_mass_matrix(bodies)[np.ix_(places, places)]
    agree("A_R B", m.A_R @ m.B, whole[n:, :n], allowed[n:, :n])
    agree("A_R", m.A_R, whole[n:, n:], allowed[n:, n:] + FEW * EPS)
    cut = n + np.flatnonzero(free(platform))
    without_free = whole[:n, :n] - whole[:n, cut] @ np.linalg.solve(whole[np.ix_(cut, cut)], whole[cut, :n])
    agree("A* by elimination", m.A_star, without_free, allowed[:n, :n])


@for_all(motions(controls=("regulated", "servo")), 30)
def test_gyroscopic_and_coriolis_terms_are_the_bias_of_bodies(motion):
    still = dataclasses.replace(motion, acceleration=0.0 * motion.acceleration)
    bodies = as_bodies(still)
    mujoco.mj_forward(bodies.tree.model, bodies.tree.data)
    m = matrices(motion.platform, motion.q, motion.velocity)
    ours = (m.G_A + m.G_R + m.G_root) @ motion.velocity
    bias = bodies.tree.data.qfrc_bias[bodies.tree.platform_places]
    agree("G u", ours, bias, FEW * rounding(still, bodies.spin).torque[: len(ours)])


@for_all(motions(), 30)
def test_energy_and_angular_momentum_are_those_of_all_bodies(motion):
    platform, u = motion.platform, motion.velocity
    bodies = as_bodies(motion)
    model, data = bodies.tree.model, bodies.tree.data
    mujoco.mj_forward(model, data)
    mujoco.mj_energyVel(model, data)
    mujoco.mj_subtreeVel(model, data)
    size = rounding(motion, bodies.spin, bodies.spin_acceleration)
    m, rotors = matrices(platform, motion.q), rotor_momenta(platform, motion.q, u)
    energy = 0.5 * u @ m.A @ u + 0.5 * np.sum(rotors.p**2 / np.diag(m.A_R))
    agree("T", energy, data.energy[1], FEW * size.energy)
    momentum = rotation(motion.attitude) @ (m.A_star @ u + m.B.T @ m.L)[:3]
    agree("H", momentum, data.subtree_angmom[1], FEW * size.momentum)


@for_all(motions(), 40)
def test_springs_friction_and_unbalance_are_passive_forces_and_gravity(motion):
    platform, masses, offsets, gravity = unbalanced(sprung(motion))
    bodies = as_bodies(motion, masses=masses, offsets=offsets, gravity=gravity, elements=platform)
    up = -rotation(motion.attitude).T @ gravity
    ours = inverse_dynamics(platform, motion.q, motion.velocity, motion.acceleration)
    forces = element_forces(platform, motion.q, motion.velocity, specific_force=up)
    size = rounding(motion, bodies.spin, bodies.spin_acceleration).torque[: len(ours)]
    size = size + moments_carried(motion, masses, offsets) * np.linalg.norm(gravity)
    for spring, friction in zip(platform.springs, platform.frictions, strict=True):
        k = platform.gimbal_names.index(spring.gimbal)
        size[3 + k] += abs(spring.stiffness) * (abs(motion.q[k]) + abs(spring.rest))
        size[3 + k] += friction.viscous * abs(motion.velocity[3 + k])
    agree("[M, Q]", ours - forces, bodies.rows, FEW * size)
