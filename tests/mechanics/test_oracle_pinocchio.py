"""Pinocchio, which knows nothing of rotors under speed control, against the method: every rotor is a body there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import cho_factor, cho_solve

from oracle_trees import (
    EPS,
    Motion,
    PinocchioTree,
    Run,
    agree,
    for_all,
    moments_carried,
    motions,
    rotation,
    rotation_vector,
    rounding,
    run,
    solved,
    unbalanced,
)
from platform_ctrl.mechanics.equations import forward_dynamics, inverse_dynamics
from platform_ctrl.mechanics.forces import element_forces
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.matrices import matrices
from platform_ctrl.mechanics.rotors import rotor_momenta
from platform_ctrl.plant.platform import Platform
from rotors_as_gimbals import with_rotors_as_gimbals

pin = pytest.importorskip("pinocchio", reason="Pinocchio (package pin) is not installed")

# Roundings in a row: a few for each joint between root and body.
FEW = 30 * EPS
# Relative accuracy that is asked of the adaptive integrator.
NEAR = 1e-10


@dataclasses.dataclass
class Bodies:
    """The motion with every rotor a body: free ones with the acceleration that leaves them without a torque."""

    tree: PinocchioTree
    configuration: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    spin: np.ndarray
    spin_acceleration: np.ndarray

    def force(self) -> np.ndarray:
        return pin.rnea(self.tree.model, self.tree.data, self.configuration, self.velocity, self.acceleration).copy()


def as_bodies(motion: Motion, **gravity) -> Bodies:
    platform = motion.platform
    tree = PinocchioTree(platform, **gravity)
    configuration = tree.configuration(motion.q, motion.attitude, motion.rng.uniform(-3, 3, len(platform.rotors)))
    pin.forwardKinematics(tree.model, tree.data, configuration, tree.vector(motion.velocity))
    # Joint i of Pinocchio is body i − 1; velocity place i + 1.
    carried = [
        tree.data.v[int(at) - 1].angular @ rotor.axis for at, rotor in zip(tree.rotors, platform.rotors, strict=True)
    ]
    spin = tree.spins(platform, np.array(carried))
    out = Bodies(
        tree=tree,
        configuration=configuration,
        velocity=tree.vector(motion.velocity, spin),
        acceleration=tree.vector(motion.acceleration),
        spin=spin,
        spin_acceleration=np.zeros(len(spin)),
    )
    axial = np.array([rotor.axial_inertia for rotor in platform.rotors])
    out.spin_acceleration = -np.where(free(platform), out.force()[tree.rotors] / axial, 0.0)
    out.acceleration = tree.vector(motion.acceleration, out.spin_acceleration)
    return out


def free(platform: Platform) -> np.ndarray:
    return np.array([rotor.control == "free" for rotor in platform.rotors], dtype=bool)


def mass_matrix(tree: PinocchioTree, configuration: np.ndarray) -> np.ndarray:
    """CRBA fills one triangle."""
    upper = np.triu(pin.crba(tree.model, tree.data, configuration))
    whole = upper + np.triu(upper, 1).T
    places = np.concatenate([tree.platform_places, tree.rotors])
    return whole[np.ix_(places, places)]


@for_all(motions(controls=("regulated", "free", "servo")), quick=60)
def test_inverse_dynamics_is_that_of_bodies_with_rotors_held_or_free(motion):
    bodies = as_bodies(motion)
    theirs = bodies.force()
    ours = inverse_dynamics(motion.platform, motion.q, motion.velocity, motion.acceleration)
    size = rounding(motion, bodies.spin, bodies.spin_acceleration)
    agree("[M, Q]", ours, theirs[bodies.tree.platform_places], FEW * size.torque[: len(ours)])


@for_all(motions(controls=("regulated", "free", "servo")), quick=30)
def test_matrices_give_the_same_forces(motion):
    bodies = as_bodies(motion)
    theirs = bodies.force()
    m = matrices(motion.platform, motion.q, motion.velocity)
    ours = m.A_star @ motion.acceleration + (m.G_A + m.G_R + m.G_root) @ motion.velocity
    size = rounding(motion, bodies.spin, bodies.spin_acceleration)
    agree("[M, Q]", ours, theirs[bodies.tree.platform_places], FEW * size.torque[: len(ours)])


@for_all(motions(), quick=30)
def test_the_drive_of_a_regulated_rotor_changes_its_axial_momentum(motion):
    """What Pinocchio's hinge shows is C d/dt(B u): by the package's own tree of bodies, and by p along the motion."""
    bodies = as_bodies(motion)
    drive = bodies.force()[bodies.tree.rotors]
    size = rounding(motion, bodies.spin, bodies.spin_acceleration)
    n = len(motion.velocity)
    rows = size.torque[n:]
    held = with_rotors_as_gimbals(motion.platform)
    ours = inverse_dynamics(
        held,
        np.concatenate([motion.q, np.zeros(len(drive))]),
        np.concatenate([motion.velocity, bodies.spin]),
        np.concatenate([motion.acceleration, bodies.spin_acceleration]),
    )
    agree("drive", ours[n:], drive, FEW * rows)
    agree("free rotor's torque", drive[free(motion.platform)], 0.0, FEW * rows[free(motion.platform)])
    # Fourth order along q(t), u(t) to second order: exact derivative + O(h⁴) of rates to the fifth.
    rate = np.abs(motion.velocity).sum() + np.sqrt(np.abs(motion.acceleration).sum())
    h = 1e-3 / rate
    momentum = {
        k: rotor_momenta(
            motion.platform,
            motion.q + motion.velocity[3:] * k * h + motion.acceleration[3:] * (k * h) ** 2 / 2,
            motion.velocity + motion.acceleration * k * h,
        ).p
        for k in (-2, -1, 1, 2)
    }
    slope = (8 * (momentum[1] - momentum[-1]) - (momentum[2] - momentum[-2])) / (12 * h)
    axial = np.array([rotor.axial_inertia for rotor in motion.platform.rotors])
    rotor_rate = rate + np.abs(bodies.spin)
    allowed = FEW * rows + axial * (h**4 * rate**6 + 4 * EPS * rotor_rate / h)
    agree("dp/dt", slope, drive, allowed)


@for_all(motions(), quick=30)
def test_both_mass_matrices_are_composites_of_bodies(motion):
    """CRBA of locked rotors is A*; of all bodies it is A + BᵀA_R B with A_R B beside it, and Schur takes rotors out."""
    platform, n = motion.platform, 3 + len(motion.q)
    allowed = FEW * rounding(motion).mass[:n, :n]
    m = matrices(platform, motion.q)
    locked = PinocchioTree(platform, rotors="locked")
    agree("A*", m.A_star, mass_matrix(locked, locked.configuration(motion.q, motion.attitude)), allowed)
    bodies = PinocchioTree(platform)
    whole = mass_matrix(bodies, bodies.configuration(motion.q, motion.attitude, 1.0))
    axial = np.array([rotor.axial_inertia for rotor in platform.rotors])
    inertia, coupling = whole[:n, :n], whole[n:, :n]
    agree("A_R", np.diag(m.A_R), np.diag(whole)[n:], FEW * axial)
    agree("C B", m.A_R @ m.B, coupling, 2 * FEW * axial[:, None])
    cut = [n + k for k in np.flatnonzero(free(platform))]
    without_free = inertia - whole[:n, cut] @ np.linalg.solve(whole[np.ix_(cut, cut)], whole[cut, :n])
    agree("A* by elimination", m.A_star, without_free, allowed)
    without_any = inertia - coupling.T @ np.linalg.solve(whole[n:, n:], coupling)
    agree("A by elimination", m.A, without_any, allowed)


@for_all(motions(), quick=30)
def test_energy_and_angular_momentum_are_those_of_all_bodies(motion):
    """T by (9), split by L or by p, and A u + Bᵀp of the root rows in inertial axes; its change is M."""
    platform, u = motion.platform, motion.velocity
    bodies = as_bodies(motion)
    model, data = bodies.tree.model, bodies.tree.data
    size = rounding(motion, bodies.spin, bodies.spin_acceleration)
    m, rotors = matrices(platform, motion.q), rotor_momenta(platform, motion.q, u)
    axial = np.diag(m.A_R)
    agree("spin", rotors.spin, bodies.spin, FEW * (np.abs(u).sum() + np.abs(bodies.spin)))
    energy = pin.computeKineticEnergy(model, data, bodies.configuration, bodies.velocity)
    agree("T by p", 0.5 * u @ m.A @ u + 0.5 * np.sum(rotors.p**2 / axial), energy, FEW * size.energy)
    whole = m.A + m.B.T @ m.A_R @ m.B
    by_L = 0.5 * u @ whole @ u + rotors.L @ m.B @ u + 0.5 * np.sum(rotors.L**2 / axial)
    agree("T by L", by_L, energy, FEW * size.energy)
    pin.computeCentroidalMomentumTimeVariation(model, data, bodies.configuration, bodies.velocity, bodies.acceleration)
    turned = rotation(motion.attitude)
    momentum = (m.A_star @ u + m.B.T @ m.L)[:3]
    agree("H", turned @ momentum, data.hg.angular, FEW * size.momentum)
    ours = inverse_dynamics(platform, motion.q, u, motion.acceleration)
    agree("dH/dt", turned @ ours[:3], data.dhg.angular, FEW * size.torque[0])


@for_all(motions(), quick=40)
def test_forward_dynamics_undoes_the_bodies_torques(motion):
    platform, n = motion.platform, 3 + len(motion.q)
    bodies = as_bodies(motion)
    tree, theirs = bodies.tree, bodies.force()
    ours = forward_dynamics(platform, motion.q, motion.velocity, theirs[tree.platform_places])
    size = rounding(motion, bodies.spin, bodies.spin_acceleration)
    A_star = matrices(platform, motion.q).A_star
    away = solved(A_star, size.torque[:n], size.mass[:n, :n], motion.acceleration)
    agree("acceleration", ours, motion.acceleration, FEW * away)
    # ABA gets the drives' torques that hold the spins. It eliminates joint by joint and is not backward stable: what it
    # loses in a small difference of inertias meets all torques, those that cancel each other too.
    drive = np.where(free(platform), 0.0, theirs[tree.rotors])
    force = tree.vector(theirs[tree.platform_places], drive)
    articulated = pin.aba(tree.model, tree.data, bodies.configuration, bodies.velocity, force)[tree.platform_places]
    whole = mass_matrix(tree, bodies.configuration)
    change = np.abs(np.linalg.inv(whole)) @ size.torque
    away = solved(whole, size.torque, size.mass, change)[:n]
    agree("ABA", articulated, motion.acceleration, FEW * away)


@for_all(motions(), quick=40)
def test_unbalance_under_gravity_is_a_force_element(motion):
    """Pinocchio moves the centres of mass and pulls at them; the root turns, its fixed point stays."""
    platform, masses, offsets, gravity = unbalanced(motion)
    bodies = as_bodies(motion, masses=masses, offsets=offsets, gravity=gravity)
    theirs = bodies.force()[bodies.tree.platform_places]
    up = -rotation(motion.attitude).T @ gravity
    ours = inverse_dynamics(platform, motion.q, motion.velocity, motion.acceleration)
    ours -= element_forces(platform, motion.q, motion.velocity, specific_force=up)
    size = rounding(motion, bodies.spin, bodies.spin_acceleration)
    weight = np.abs(moments_carried(motion, masses, offsets)) * np.linalg.norm(gravity)
    agree("[M, Q]", ours, theirs, FEW * (size.torque[: len(ours)] + weight))


@for_all(motions(controls=("regulated", "servo")), quick=40)
def test_linear_equations_are_the_derivatives_of_the_bodies_torques(motion):
    """M, G, K, M_Omega, G_Omega, Q0 with unbalance, against Pinocchio's analytic derivatives of inverse dynamics."""
    Omega = motion.velocity[:3]
    still = dataclasses.replace(
        motion,
        velocity=np.concatenate([Omega, 0.0 * motion.q]),
        acceleration=np.zeros(3 + len(motion.q)),
    )
    platform, masses, offsets, gravity = unbalanced(still)
    bodies = as_bodies(still, masses=masses, offsets=offsets, gravity=gravity)
    tree = bodies.tree
    by_angle, by_rate, by_acceleration = pin.computeRNEADerivatives(
        tree.model, tree.data, bodies.configuration, bodies.velocity, bodies.acceleration
    )
    up = -rotation(motion.attitude).T @ gravity
    model = linearise(platform, Omega, q=motion.q, specific_force=up)
    size = rounding(still, bodies.spin)
    weight = moments_carried(still, masses, offsets) * np.linalg.norm(gravity)
    rows, root = tree.gimbals, np.arange(3)
    mass = size.mass[3 : 3 + len(rows), : 3 + len(rows)]
    torque = (size.torque[: 3 + len(rows)] + weight)[3:]
    agree("Q0", model.Q0, bodies.force()[rows], FEW * torque)
    agree("K", model.stiffness, by_angle[np.ix_(rows, rows)], FEW * torque[:, None])
    inertia = np.triu(by_acceleration) + np.triu(by_acceleration, 1).T
    agree("M", model.M, inertia[np.ix_(rows, rows)], FEW * mass[:, 3:])
    agree("M_Omega", model.M_Omega, inertia[np.ix_(rows, root)], FEW * mass[:, :3])
    rate = np.linalg.norm(Omega) + max(np.abs(bodies.spin), default=0.0)
    agree("G", model.G, by_rate[np.ix_(rows, rows)], FEW * rate * mass[:, 3:])
    agree("G_Omega", model.G_Omega, by_rate[np.ix_(rows, root)], FEW * rate * mass[:, :3])


def end_of_bodies(
    motion: Motion, bodies: Bodies, ours: Run, part: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Integrate the bodies to q, [Omega, q̇], attitude and spins; regulated rotors are held, servo rotors have loops.

    u̇ comes from CRBA and Cholesky, not from ABA: that loses up to four digits more, and the integrator chases them.
    """
    platform, tree, size = motion.platform, bodies.tree, bodies.tree.size
    kinds = np.array([rotor.control for rotor in platform.rotors], dtype=str)
    others = np.setdiff1d(np.arange(size), tree.rotors[kinds == "regulated"])
    servo = kinds == "servo"
    motors = tree.rotors[servo]
    loops = [rotor for rotor in platform.rotors if rotor.control == "servo"]
    gain, integral, wanted = (
        np.array([getattr(rotor, name) for rotor in loops]) for name in ("speed_gain", "speed_integral", "spin")
    )
    left = 20_000

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        nonlocal left
        left -= 1
        assert left, "the adaptive integrator does not get on: rounding is larger than its tolerance"
        configuration, velocity, summed = np.split(state, [1 + size, 1 + 2 * size])
        configuration = np.concatenate([configuration[:4] / np.linalg.norm(configuration[:4]), configuration[4:]])
        force = tree.vector(ours.force)
        force[motors] = -gain * (velocity[motors] - wanted) - integral * summed
        inertia = np.triu(pin.crba(tree.model, tree.data, configuration))[np.ix_(others, others)]
        bias = pin.nonLinearEffects(tree.model, tree.data, configuration, velocity)
        scale = 1.0 / np.sqrt(np.diag(inertia))
        factor = cho_factor(scale[:, None] * inertia * scale)
        change = np.zeros(size)
        change[others] = scale * cho_solve(factor, scale * (force - bias)[others])
        x, y, z, w = configuration[:4]
        turning = 0.5 * np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]]) @ velocity[:3]
        return np.concatenate([turning, velocity[3:], change, velocity[motors] - wanted])

    # `part` of what is allowed: where rounding of spin² dominates, a smaller tolerance would chase noise.
    atol = [
        np.full(4, ours.turn_error),
        tree.vector(np.concatenate([np.zeros(3), ours.q_error]), 1.0)[3:],
        tree.vector(ours.velocity_error, ours.velocity_error.sum()),
        np.full(len(motors), ours.velocity_error.sum() * ours.step * ours.steps),
    ]
    done = solve_ivp(
        rates,
        (0.0, ours.step * ours.steps),
        np.concatenate([bodies.configuration, bodies.velocity, np.zeros(len(motors))]),
        method="DOP853",
        rtol=part * NEAR,
        atol=part * np.concatenate(atol),
    )
    assert done.success
    configuration, velocity, _ = np.split(done.y[:, -1], [1 + size, 1 + 2 * size])
    attitude = np.roll(configuration[:4], 1) / np.linalg.norm(configuration[:4])
    return configuration[1 + tree.gimbals], velocity[tree.platform_places], rotation(attitude), velocity[motors]


def check_run(motion: Motion, bodies: Bodies, ours: Run) -> None:
    """Compare the ends; the adaptive integrator's own error shows with tolerances ten times as wide."""
    q, velocity, turned, spin = end_of_bodies(motion, bodies, ours, 0.1)
    q_wide, velocity_wide, turned_wide, spin_wide = end_of_bodies(motion, bodies, ours, 1.0)
    near, duration, size = NEAR * np.linalg.norm(ours.velocity), ours.step * ours.steps, np.linalg.norm
    agree("q", ours.q, q, ours.q_error + NEAR * np.abs(ours.q) + near * duration + size(q - q_wide))
    agree("u", ours.velocity, velocity, ours.velocity_error + near + size(velocity - velocity_wide))
    turn = size(rotation_vector(turned @ turned_wide.T))
    agree("attitude", rotation_vector(ours.turned @ turned.T), 0.0, ours.turn_error + NEAR + turn)
    # What a servo rotor gains its carriers lose: its error is theirs of rate, and of momentum.
    axial = np.array([rotor.axial_inertia for rotor in motion.platform.rotors if rotor.control == "servo"])
    lost = np.abs(matrices(motion.platform, motion.q).A_star) @ ours.velocity_error
    allowed = ours.velocity_error.sum() + lost.max() / axial + NEAR * (1 + np.abs(spin)) + size(spin - spin_wide)
    agree("spin", ours.spin, spin, allowed)


@for_all(st.one_of(motions(), motions(min_size=0.1)), quick=15)
def test_runs_are_those_of_bodies_under_an_adaptive_integrator(motion):
    check_run(motion, as_bodies(motion), run(motion))


@for_all(motions(controls=("servo", "servo", "regulated", "free"), min_size=1e-3), quick=15)
def test_servo_rotors_are_bodies_with_motors(motion):
    """Off their nominal spins at the start; the motor of each turns its carrier the other way."""
    rng = motion.rng
    rotors = tuple(
        dataclasses.replace(
            rotor,
            speed_gain=rotor.axial_inertia * 10 ** rng.uniform(0, 3),
            speed_integral=rotor.axial_inertia * 10 ** rng.uniform(0, 6),
        )
        for rotor in motion.platform.rotors
    )
    motion = dataclasses.replace(motion, platform=dataclasses.replace(motion.platform, rotors=rotors))
    servo = np.array([rotor.control == "servo" for rotor in rotors], dtype=bool)
    bodies = as_bodies(motion)
    spin = bodies.spin.copy()
    spin[servo] += rng.normal(size=servo.sum()) * 10 ** rng.uniform(-1, 2)
    bodies.velocity = bodies.tree.vector(motion.velocity, spin)
    check_run(motion, bodies, run(motion, spin=spin[servo]))
