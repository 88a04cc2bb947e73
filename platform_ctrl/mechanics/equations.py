"""The equations of motion (11), with Boltzmann-Hamel rows for the root, as a recursion over the tree; rotors' momenta.

The recursion balances forces and moments body by body (Newton-Euler) and shares nothing with the matrices but
directions and places: the two routes check each other.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.forces import specific_force_at
from platform_ctrl.mechanics.kinematics import Kinematics, kinematics, topology
from platform_ctrl.mechanics.matrices import directions, mass_matrix, solved_inertia, world_inertias
from platform_ctrl.plant.gimbals import RotorControl
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform


def inverse_dynamics(
    platform: Platform,
    q: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    specific_force: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    attitude: ArrayLike | None = None,
) -> FloatArray:
    """Return the generalised forces [M, Q] that cause a motion: A* u̇ + (G_A + G_R + G_root) u + Pᵀf, eq. (11).

    M is about the root's origin; of a floating root it is a pure couple. The weight of bodies with a mass is on this
    side, that of an unbalance is one of `element_forces`.

    Parameters
    ----------
    platform
        The platform.
    q : (n,)
        Gimbal angles, rad.
    velocity, acceleration : (3 + n,)
        u = [Omega, q̇], rad/s, and its derivative component by component, in root axes, rad/s².
    specific_force, gravity, attitude
        As in `specific_force_at`: f of the root's origin.

    Returns
    -------
    (3 + n,)
        [M, Q], N m.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (11).

    R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5.
    """
    at, u, u_dot = _motion(platform, q, velocity, "acceleration", acceleration)
    return _forces(at, world_inertias(at), u, u_dot, specific_force_at(platform, specific_force, gravity, attitude))


def forward_dynamics(
    platform: Platform,
    q: ArrayLike,
    velocity: ArrayLike,
    force: ArrayLike,
    specific_force: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    attitude: ArrayLike | None = None,
) -> FloatArray:
    """Return the acceleration [Omega', q̈] under generalised forces.

    Parameters
    ----------
    platform
        The platform.
    q : (n,)
        Gimbal angles, rad.
    velocity, force : (3 + n,)
        u = [Omega, q̇], rad/s; [M, Q], N m.
    specific_force, gravity, attitude
        As in `specific_force_at`: f of the root's origin.

    Returns
    -------
    (3 + n,)
        [Omega', q̈], rad/s².

    Raises
    ------
    ArgumentError
        Wrong shape or not finite.
    MechanicsError
        A* is singular at these angles (gimbal lock, or a gimbal that moves no inertia).

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (11).

    See docs/theory/mechanics.md.

    Examples
    --------
    A torque about the axis of gimbal 10 turns that gimbal; its rotor's action appears once it moves.

    >>> import platform_ctrl as pc
    >>> platform = pc.read_platform("three_gyro_platform")
    >>> acceleration = pc.forward_dynamics(platform, [0] * 5, [0] * 8, [0, 0, 0, 0, 0, 0, 0, 1e-3])
    >>> round(float(acceleration[7]), 3)
    5.014
    """
    at, u, torque = _motion(platform, q, velocity, "force", force)
    inertias = world_inertias(at)
    f = specific_force_at(platform, specific_force, gravity, attitude)
    bias = _forces(at, inertias, u, np.zeros(len(u)), f)
    A_star = mass_matrix(at, inertias)
    return solved_inertia(A_star, torque - bias, (*OMEGA_NAMES, *platform.angle_names))


def _motion(
    platform: Platform, q: ArrayLike, velocity: ArrayLike, name: str, given: ArrayLike
) -> tuple[Kinematics, FloatArray, FloatArray]:
    """Return the directions at q, the velocity, and another vector (3 + n,), called `name`."""
    tree = topology(platform)
    n = len(tree.parents)
    at = kinematics(platform, real_array("q", q, (n,)))
    return at, real_array("velocity", velocity, (3 + n,)), real_array(name, given, (3 + n,))


def _forces(at: Kinematics, inertias: FloatArray, u: FloatArray, u_dot: FloatArray, f: FloatArray) -> FloatArray:
    """Return [M, Q] of a motion while the root's origin feels f; a floating root feels what leaves no resultant."""
    if not at.tree.floating:
        return _balance(at, inertias, u, u_dot, f)[1]
    force, _ = _balance(at, inertias, u, u_dot, np.zeros(3))
    return _balance(at, inertias, u, u_dot, -force / at.tree.mass)[1]


def _balance(
    at: Kinematics, inertias: FloatArray, u: FloatArray, u_dot: FloatArray, f: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the force on the root at its origin, (3,), and [M, Q]."""
    tree, n = at.tree, len(at.axes)
    spin, spin_change = np.zeros((1 + n, 3)), np.zeros((1 + n, 3))
    np.add.at(spin, tree.carriers, tree.L[:, None] * at.spin_axes)
    rates, accelerations, felt = (np.empty((1 + n, 3)) for _ in range(3))
    rates[0], accelerations[0], felt[0] = u[:3], u_dot[:3], f
    for k in tree.order:
        carried = 1 + tree.parents[k]
        turn = at.axes[k] * u[3 + k]
        rates[1 + k] = rates[carried] + turn
        accelerations[1 + k] = accelerations[carried] + at.axes[k] * u_dot[3 + k] + np.cross(rates[carried], turn)
        arm = at.origins[1 + k] - at.origins[carried]
        felt[1 + k] = felt[carried] + _at_arm(rates[carried], accelerations[carried], arm)
    drives = np.zeros(n)
    for k, N, J in zip(tree.geared, tree.gears, tree.gear_inertias, strict=True):
        # The rotor turns in the parent at N q̇; its gear holds N times the rotor's torque on the gimbal.
        carried = 1 + tree.parents[k]
        spin[carried] += J * (at.axes[k] @ rates[carried] + N * u[3 + k]) * at.axes[k]
        change = J * (at.axes[k] @ accelerations[carried] + N * u_dot[3 + k])
        spin_change[carried] += change * at.axes[k]
        drives[k] += N * change
    momenta = np.einsum("bij,bj->bi", inertias, rates) + spin
    moments = np.einsum("bij,bj->bi", inertias, accelerations) + spin_change + np.cross(rates, momenta)
    arms = at.centres - at.origins
    forces = tree.masses[:, None] * (felt + _at_arm(rates, accelerations, arms))
    moments += np.cross(arms, forces)
    out = np.empty(3 + n)
    for k in reversed(tree.order):
        carried = 1 + tree.parents[k]
        out[3 + k] = at.axes[k] @ moments[1 + k] + drives[k]
        forces[carried] += forces[1 + k]
        moments[carried] += moments[1 + k] + np.cross(at.origins[1 + k] - at.origins[carried], forces[1 + k])
    out[:3] = moments[0]
    return forces[0], out


def _at_arm(rate: FloatArray, acceleration: FloatArray, arm: FloatArray) -> FloatArray:
    """Acceleration of a point of a body against another one, `arm` away from it."""
    return np.asarray(np.cross(acceleration, arm) + np.cross(rate, np.cross(rate, arm)))


@value
class RotorMomenta:
    """Momenta and rates of all rotors at one state, whichever of L and p their control holds.

    Attributes
    ----------
    L : (m,)
        Angular momenta relative to the carriers, C φ̇ (8), N m s.
    p : (m,)
        Axial momenta, C ω (4), N m s.
    spin : (m,)
        Rates φ̇ relative to the carriers, rad/s.
    rate : (m,)
        Absolute rates about the rotors' axes, ω = φ̇ + B u (2), rad/s.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (2), (4), (8).
    """

    L: FloatArray
    p: FloatArray
    spin: FloatArray
    rate: FloatArray


def rotor_momenta(platform: Platform, q: ArrayLike | None = None, velocity: ArrayLike | None = None) -> RotorMomenta:
    """Return L, p and the spins of all rotors at a state, by (2), (4) and (8).

    Parameters
    ----------
    platform
        The platform. A regulated (or servo) rotor's `angular_momentum` is its L, a free rotor's its p.
    q : (n,)
        Gimbal angles, rad; default zero.
    velocity : (3 + n,)
        u = [Omega, q̇], rad/s; default zero.

    Returns
    -------
    RotorMomenta
        Of the m rotors in the file's order.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eqs. (2), (4), (8).
    """
    tree = topology(platform)
    n = len(tree.parents)
    at = kinematics(platform, real_array("q", q, (n,), 0.0))
    carried = directions(at) @ real_array("velocity", velocity, (3 + n,), 0.0)
    spin = tree.L / tree.C - np.where(tree.regulated, 0.0, carried)
    return RotorMomenta(L=tree.C * spin, p=tree.C * (spin + carried), spin=spin, rate=spin + carried)


def with_free_rotors(platform: Platform, q: ArrayLike | None = None, velocity: ArrayLike | None = None) -> Platform:
    """Return the platform with every rotor's drive taken off at a state: each keeps the p (4) that it has there.

    Parameters
    ----------
    platform, q, velocity
        As in `rotor_momenta`.

    Returns
    -------
    Platform
        The same plant with cyclic rotors alone.
    """
    return _with_rotors(platform, "free", rotor_momenta(platform, q, velocity).p)


def with_regulated_rotors(
    platform: Platform, q: ArrayLike | None = None, velocity: ArrayLike | None = None
) -> Platform:
    """Return the platform with every rotor regulated from a state on: each keeps the L (8) that it has there.

    Parameters
    ----------
    platform, q, velocity
        As in `rotor_momenta`.

    Returns
    -------
    Platform
        The same plant with regulated rotors alone.
    """
    return _with_rotors(platform, "regulated", rotor_momenta(platform, q, velocity).L)


def _with_rotors(platform: Platform, control: RotorControl, momenta: FloatArray) -> Platform:
    rotors = tuple(
        dataclasses.replace(
            r, control=control, angular_momentum=float(h), speed_gain=0.0, speed_integral=0.0, torque_limit=None
        )
        for r, h in zip(platform.rotors, momenta, strict=True)
    )
    return dataclasses.replace(platform, rotors=rotors)
