"""The equations of motion (11), with Boltzmann-Hamel rows for the root, as a recursion over the tree.

The recursion balances moments body by body (Newton-Euler) and shares nothing with the matrices but the
directions: the two routes check each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.arguments import real_array
from platform_ctrl.description import Platform
from platform_ctrl.errors import MechanicsError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import Kinematics, kinematics, topology
from platform_ctrl.mechanics.matrices import mass_matrix, world_inertias

# A mass matrix whose unit-diagonal form is worse conditioned than this leaves no correct digits in u̇.
_SINGULAR = 1e-13


def inverse_dynamics(platform: Platform, q: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> FloatArray:
    """Return the generalised forces [M, Q] that cause a motion, (3 + n,), N m.

    Parameters
    ----------
    platform
        The platform.
    q : (n,)
        Gimbal angles, rad.
    velocity, acceleration : (3 + n,)
        u = [Omega, q̇] and its derivative component by component, in root axes.

    Raises
    ------
    ArgumentError
        Wrong shape or not finite.

    Notes
    -----
    Equal to A* u̇ + (G_A + G_R + G_root) u of `matrices`, eq. (11).
    """
    n = len(platform.gimbals)
    angles = real_array("q", q, (n,))
    u = real_array("velocity", velocity, (3 + n,))
    u_dot = real_array("acceleration", acceleration, (3 + n,))
    at = kinematics(platform, angles)
    return _moments(platform, at, world_inertias(platform, at), u, u_dot)


def forward_dynamics(platform: Platform, q: ArrayLike, velocity: ArrayLike, force: ArrayLike) -> FloatArray:
    """Return the acceleration [Omega', q̈] under generalised forces, (3 + n,), rad/s².

    Parameters
    ----------
    platform
        The platform.
    q : (n,)
        Gimbal angles, rad.
    velocity, force : (3 + n,)
        u = [Omega, q̇], rad/s; [M, Q], N m.

    Raises
    ------
    ArgumentError
        Wrong shape or not finite.
    MechanicsError
        A* is singular at these angles (gimbal lock, or a gimbal that moves no inertia).
    """
    n = len(platform.gimbals)
    angles = real_array("q", q, (n,))
    u = real_array("velocity", velocity, (3 + n,))
    torque = real_array("force", force, (3 + n,))
    at = kinematics(platform, angles)
    inertias = world_inertias(platform, at)
    bias = _moments(platform, at, inertias, u, np.zeros(3 + n))
    A_star = mass_matrix(at.jacobians, inertias)
    diagonal = np.diag(A_star)
    names = ("Omega1", "Omega2", "Omega3", *platform.angle_names)
    if np.any(diagonal <= 0.0):
        raise MechanicsError(
            f"A* is singular: {names[int(np.argmin(diagonal))]} moves no inertia; expected some in its body"
        )
    scale = 1.0 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(scale[:, None] * A_star * scale)
    if values[0] < _SINGULAR * values[-1]:
        joint = [name for name, part in zip(names, np.abs(vectors[:, 0]), strict=True) if part > 0.3]
        raise MechanicsError(f"A* is singular at these angles: {', '.join(joint)} can move without moving any inertia")
    out: FloatArray = scale * (vectors @ ((vectors.T @ (scale * (torque - bias))) / values))
    return out


def _moments(platform: Platform, at: Kinematics, inertias: FloatArray, u: FloatArray, u_dot: FloatArray) -> FloatArray:
    tree = topology(platform)
    n = len(tree.parents)
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
