"""Q of springs, friction, cages, unbalance and erection: the torques themselves and their slopes for eq. (19)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.kinematics import Kinematics, configuration, cross_matrix, topology
from platform_ctrl.plant.force_elements import Cage, Friction
from platform_ctrl.plant.platform import Platform

__all__ = ["element_forces"]


@value
class ForceSlopes:
    """Derivatives of [M, Q] at angles q, gimbals at rest.

    Attributes
    ----------
    angle : (3 + n, n)
        ∂[M, Q]/∂q, N m/rad.
    rate : (n, n)
        ∂Q/∂q̇, N m s; of dry friction only what `rate_amplitude` makes of it.
    force : (3 + n, 3)
        ∂[M, Q]/∂f, N m per m/s².
    """

    angle: FloatArray
    rate: FloatArray
    force: FloatArray


def element_forces(
    platform: Platform,
    q: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    specific_force: ArrayLike | None = None,
) -> FloatArray:
    """Return [M, Q] of all force elements together: they add to the torquers' in eq. (11).

    Parameters
    ----------
    platform
        The platform.
    q : (n,)
        Gimbal angles, rad; default zero.
    velocity : (3 + n,)
        [Omega, q̇], rad/s; default zero.
    specific_force : (3,)
        In root axes, m/s²; default the platform's own.

    Returns
    -------
    (3 + n,)
        [M, Q], N m.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (11).

    See docs/theory.md.
    """
    tree = topology(platform)
    n = len(tree.parents)
    angles = real_array("q", q, (n,), 0.0)
    rates = real_array("velocity", velocity, (3 + n,), 0.0)[3:]
    f = platform.specific_force if specific_force is None else real_array("specific_force", specific_force, (3,))
    return forces_at(platform, configuration(tree, angles), angles, rates, f)


def forces_at(platform: Platform, at: Kinematics, angles: FloatArray, rates: FloatArray, f: FloatArray) -> FloatArray:
    """Return [M, Q] of all force elements at the gimbals' angles and rates under the specific force f, (3 + n,)."""
    out = _unbalance_torque(platform, at) @ f
    for spring in platform.springs:
        k = platform.gimbal(spring.gimbal)
        out[3 + k] -= spring.stiffness * (angles[k] - spring.rest)
    for friction in platform.frictions:
        k = platform.gimbal(friction.gimbal)
        out[3 + k] -= friction.viscous * rates[k] + friction.dry(float(rates[k]))
    for cage in platform.cages:
        k = platform.gimbal(cage.gimbal)
        out[3 + k] += _contact(cage, float(angles[k]), float(rates[k]))
    for erecting in _erections(platform, at, f):
        out[3 + erecting.gimbal] += min(max(erecting.gain * erecting.tilt, -erecting.limit), erecting.limit)
    return out


def force_slopes(
    platform: Platform,
    at: Kinematics,
    q: FloatArray,
    specific_force: FloatArray,
    rate_amplitude: FloatArray | None = None,
) -> ForceSlopes:
    """Return the slopes of `element_forces` with the gimbals at rest.

    Dry friction has none at rest. With `rate_amplitude` (n,), rad/s, its describing function replaces it: the viscous
    friction that takes as much out of an oscillation of that rate, 4 F/(π amplitude), more with a Stribeck curve.
    """
    tree, n = at.tree, len(q)
    rate = np.zeros((n, n))
    angle, force = _unbalance_slope(platform, at, specific_force), _unbalance_torque(platform, at)
    for spring in platform.springs:
        k = platform.gimbal(spring.gimbal)
        angle[3 + k, k] -= spring.stiffness
    for friction in platform.frictions:
        k = platform.gimbal(friction.gimbal)
        rate[k, k] -= friction.viscous
        if rate_amplitude is not None:
            rate[k, k] -= _equivalent(friction, float(rate_amplitude[k]))
    for cage in platform.cages:
        k = platform.gimbal(cage.gimbal)
        if cage.clearance == 0.0 or abs(q[k] - cage.angle) > cage.clearance:
            angle[3 + k, k] -= cage.stiffness
            rate[k, k] -= cage.damping
    size = float(np.linalg.norm(specific_force))
    for erecting in _erections(platform, at, specific_force):
        if abs(erecting.gain * erecting.tilt) < erecting.limit:
            turning = np.cross(at.axes, erecting.axis) * tree.on_path[erecting.body][:, None]
            row = 3 + erecting.gimbal
            angle[row] += erecting.gain * (turning @ specific_force) / size
            force[row] += erecting.gain * (erecting.axis - specific_force / size * erecting.tilt) / size
    return ForceSlopes(angle=angle, rate=rate, force=force)


def _equivalent(friction: Friction, amplitude: float) -> float:
    """Describing function of dry friction without its smoothing, for an oscillation of this rate amplitude, N m s."""
    out = 4.0 / math.pi * (0.5 * sum(friction.coulomb)) / amplitude
    drop = 0.5 * (sum(friction.breakaway) - sum(friction.coulomb))
    if drop > 0.0:
        from scipy.special import dawsn

        # With x = sin of the phase, the integral of cos exp(-(a cos)²) is that of exp(-a² (1 - x²)): Dawson's integral.
        a = amplitude / friction.stribeck_rate
        share = float(dawsn(a)) / a if a > 1e-8 else 1.0
        out += 4.0 / math.pi * drop / amplitude * share
    return out


def _contact(cage: Cage, angle: float, rate: float) -> float:
    deflection = angle - cage.angle
    if cage.clearance == 0.0:
        return -cage.stiffness * deflection - cage.damping * rate
    beyond = abs(deflection) - cage.clearance
    if beyond <= 0.0:
        return 0.0
    side = math.copysign(1.0, deflection)
    return -side * max(0.0, cage.stiffness * beyond + cage.damping * rate * side)


@value
class _Erecting:
    """An erection at work: gimbal, body and axis (root axes) of its sensor, sine of the tilt, gain and limit."""

    gimbal: int
    body: int
    axis: FloatArray
    tilt: float
    gain: float
    limit: float


def _erections(platform: Platform, at: Kinematics, f: FloatArray) -> list[_Erecting]:
    """Without specific force there is nothing to erect to."""
    size = float(np.linalg.norm(f))
    if size == 0.0:
        return []
    out = []
    for device in platform.erections:
        body = platform.body(device.senses)
        axis = at.rotations[body] @ device.axis
        limit = math.inf if device.limit is None else device.limit
        tilt = float(axis @ f) / size
        gimbal = platform.gimbal(device.gimbal)
        out.append(_Erecting(gimbal=gimbal, body=body, axis=axis, tilt=tilt, gain=device.gain, limit=limit))
    return out


def _moments(platform: Platform, at: Kinematics) -> FloatArray:
    """Mass moments in root axes, (1 + n, 3), kg m."""
    out = np.zeros((1 + len(platform.gimbals), 3))
    for unbalance in platform.unbalances:
        body = platform.body(unbalance.body)
        out[body] += at.rotations[body] @ unbalance.moment
    return out


def _unbalance_torque(platform: Platform, at: Kinematics) -> FloatArray:
    """∂[M, Q]/∂f, (3 + n, 3): of the moments −(m r) × f."""
    out: FloatArray = -np.einsum("bji,bjk->ik", at.jacobians, cross_matrix(_moments(platform, at)))
    return out


def _unbalance_slope(platform: Platform, at: Kinematics, f: FloatArray) -> FloatArray:
    """∂[M, Q]/∂q of the moments −(m r) × f, (3 + n, n)."""
    tree, moments = at.tree, _moments(platform, at)
    # With gimbal j turns the mass moment of all that it carries, and the axes of the gimbals that it carries.
    turned = tree.on_path.T[:, :, None] * np.cross(at.axes[:, None, :], moments[None, :, :])
    out: FloatArray = np.einsum("bxi,jbx->ij", at.jacobians, np.cross(f, turned))
    turning = tree.above[:, :, None] * np.cross(at.axes[:, None, :], at.axes[None, :, :])
    out[3:] += np.einsum("jix,bx,bi->ij", turning, np.cross(f, moments), tree.on_path)
    return out
