"""The equations of motion (11), with Boltzmann-Hamel rows for the root, as a recursion over the tree; rotors' momenta.

The recursion balances moments body by body (Newton-Euler) and shares nothing with the matrices but the
directions: the two routes check each other.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.kinematics import Kinematics, configuration, topology
from platform_ctrl.mechanics.matrices import directions, mass_matrix, solved_inertia, world_inertias
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform, RotorControl


def inverse_dynamics(platform: Platform, q: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> FloatArray:
    """Return the generalised forces [M, Q] that cause a motion: A* u̇ + (G_A + G_R + G_root) u, eq. (11).

    Parameters
    ----------
    platform
        The platform.
    q : (n,)
        Gimbal angles, rad.
    velocity, acceleration : (3 + n,)
        u = [Omega, q̇], rad/s, and its derivative component by component, in root axes, rad/s².

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
    return _moments(at, world_inertias(at), u, u_dot)


def forward_dynamics(platform: Platform, q: ArrayLike, velocity: ArrayLike, force: ArrayLike) -> FloatArray:
    """Return the acceleration [Omega', q̈] under generalised forces.

    Parameters
    ----------
    platform
        The platform.
    q : (n,)
        Gimbal angles, rad.
    velocity, force : (3 + n,)
        u = [Omega, q̇], rad/s; [M, Q], N m.

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
    bias = _moments(at, inertias, u, np.zeros(len(u)))
    A_star = mass_matrix(at.jacobians, inertias)
    return solved_inertia(A_star, torque - bias, (*OMEGA_NAMES, *platform.angle_names))


def _motion(
    platform: Platform, q: ArrayLike, velocity: ArrayLike, name: str, given: ArrayLike
) -> tuple[Kinematics, FloatArray, FloatArray]:
    """Return the directions at q, the velocity, and another vector (3 + n,), called `name`."""
    tree = topology(platform)
    n = len(tree.parents)
    at = configuration(tree, real_array("q", q, (n,)))
    return at, real_array("velocity", velocity, (3 + n,)), real_array(name, given, (3 + n,))


def _moments(at: Kinematics, inertias: FloatArray, u: FloatArray, u_dot: FloatArray) -> FloatArray:
    tree, n = at.tree, len(at.axes)
    spin = np.zeros((1 + n, 3))
    np.add.at(spin, tree.carriers, tree.L[:, None] * at.spin_axes)
    rates, accelerations = np.empty((1 + n, 3)), np.empty((1 + n, 3))
    rates[0], accelerations[0] = u[:3], u_dot[:3]
    for k in tree.order:
        carried = 1 + tree.parents[k]
        turn = at.axes[k] * u[3 + k]
        rates[1 + k] = rates[carried] + turn
        accelerations[1 + k] = accelerations[carried] + at.axes[k] * u_dot[3 + k] + np.cross(rates[carried], turn)
    momenta = np.einsum("bij,bj->bi", inertias, rates) + spin
    moments = np.einsum("bij,bj->bi", inertias, accelerations) + np.cross(rates, momenta)
    out = np.empty(3 + n)
    for k in reversed(tree.order):
        out[3 + k] = at.axes[k] @ moments[1 + k]
        moments[1 + tree.parents[k]] += moments[1 + k]
    out[:3] = moments[0]
    return out


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
    at = configuration(tree, real_array("q", q, (n,), 0.0))
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
