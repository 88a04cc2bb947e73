"""The momenta of rotors at a state, (2), (4), (8), and rotors of one kind turned into another."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.kinematics import configuration, topology
from platform_ctrl.mechanics.matrices import directions
from platform_ctrl.plant.platform import Platform, RotorControl


@value
class RotorMomenta:
    """What all rotors do at one state, whichever of L and p their control holds.

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
