"""Q of springs, friction, cages, unbalance and erection: the torques themselves and their slopes for eq. (19)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import instance, real_array, unit_quaternions
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.kinematics import Kinematics, cross_matrix, kinematics
from platform_ctrl.plant.force_elements import Erection, Friction
from platform_ctrl.plant.platform import Platform


@value
class ForceSlopes:
    """Derivatives of [M, Q] at angles q, gimbals at rest."""

    angle: FloatArray  # (3 + n, n): ∂[M, Q]/∂q, N m/rad
    rate: FloatArray  # (n, n): ∂Q/∂q̇, N m s; of dry friction only what `rate_amplitude` makes of it
    force: FloatArray  # (3 + n, 3): ∂[M, Q]/∂f, N m per m/s²


def specific_force_at(
    platform: Platform,
    specific_force: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    attitude: ArrayLike | None = None,
) -> FloatArray:
    """Return f of the root's origin in root axes: what turns with the root, less gravity, which is fixed in space.

    Parameters
    ----------
    platform
        The platform.
    specific_force : (3,)
        In root axes, m/s²: acceleration minus gravity's; default the platform's own, or 0 with `gravity`.
    gravity : (3,)
        In axes fixed in space, m/s²; default the platform's own, or 0 with `specific_force`.
    attitude : (4,)
        Unit quaternion w, x, y, z that turns root axes to those in space; default none, they coincide.

    Returns
    -------
    (3,)
        specific_force − Rᵀ gravity, m/s².

    Raises
    ------
    ArgumentError
        Wrong shape, not finite, or a quaternion that is not of length 1.
    """
    f, g = platform.specific_force, platform.gravity
    if specific_force is not None or gravity is not None:
        f = real_array("specific_force", specific_force, (3,), 0.0)
        g = real_array("gravity", gravity, (3,), 0.0)
    if attitude is None:
        return np.asarray(f - g)
    w, *v = unit_quaternions(attitude, (4,))
    # Rᵀ g by Rodrigues' formula.
    return np.asarray(f - (g - 2.0 * w * np.cross(v, g) + 2.0 * np.cross(v, np.cross(v, g))))


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
        In root axes, m/s²; default the platform's own, with gravity at the identity attitude.

    Returns
    -------
    (3 + n,)
        [M, Q], N m.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (11).

    See docs/theory/mechanics.md.
    """
    n = len(instance("platform", platform, Platform).gimbals)
    angles = real_array("q", q, (n,), 0.0)
    rates = real_array("velocity", velocity, (3 + n,), 0.0)[3:]
    f = specific_force_at(platform, specific_force)
    return ForceElements(platform, kinematics(platform, angles), f).forces(angles, rates)


def resting_forces(platform: Platform, q: FloatArray, f: FloatArray) -> FloatArray:
    """Return [M, Q], (3 + n,) N m, of force elements and weight at rest at angles (n,), under specific force f (3,)."""
    at = kinematics(platform, q)
    forces = ForceElements(platform, at, f).forces(q, np.zeros(len(q)))
    return forces if at.tree.floating else np.asarray(forces - at.momentum.T @ f)


def twisted(platform: Platform, q: FloatArray, f: FloatArray) -> FloatArray:
    """Return angles (n,) with the motor sides of drives where they hold their loads at rest, under f (3,)."""
    out = np.array(q)
    for load, motor in platform.sides:
        out[motor] = out[load]
    forces = resting_forces(platform, out, f)
    for (load, motor), one in zip(platform.sides, platform.compliances, strict=True):
        twist = -forces[3 + load]
        out[motor] += twist / one.strength + 0.5 * one.play * np.sign(twist)
    return out


class ForceElements:
    """The force elements of a platform with their places, at one configuration under the specific force f (3,)."""

    def __init__(self, platform: Platform, at: Kinematics, f: FloatArray) -> None:
        gimbal, body = platform.gimbal, platform.body
        self._at, self._f = at, f
        self._drives = [(*sides, one) for sides, one in zip(platform.sides, platform.compliances, strict=True)]
        self._springs = [(gimbal(spring.gimbal), spring) for spring in platform.held_by]
        self._frictions = [(gimbal(friction.gimbal), friction) for friction in platform.frictions]
        self._cages = [(gimbal(cage.gimbal), cage) for cage in platform.cages]
        # Mass moments in root axes, (1 + n, 3), kg m.
        self._moments = np.zeros((1 + len(platform.gimbals), 3))
        for unbalance in platform.unbalances:
            k = body(unbalance.body)
            self._moments[k] += at.rotations[k] @ unbalance.moment
        # ∂[M, Q]/∂f, (3 + n, 3), of the moments −(m r) × f.
        self._unbalance = -np.einsum("bji,bjk->ik", at.jacobians, cross_matrix(self._moments))
        # Row, sensing body and axis of each, and its torque without a limit: none where there is nothing to erect to.
        self._erections: list[tuple[int, int, FloatArray, float, Erection]] = []
        size = float(np.linalg.norm(f))
        for device in platform.erections if size > 0.0 else ():
            axis = at.rotations[senses := body(device.senses)] @ device.axis
            wanted = device.gain * float(axis @ f) / size
            self._erections.append((3 + gimbal(device.gimbal), senses, axis, wanted, device))

    def forces(self, angles: FloatArray, rates: FloatArray) -> FloatArray:
        """Return [M, Q] of all elements at the gimbals' angles and rates, (3 + n,)."""
        out = np.asarray(self._unbalance @ self._f)
        for k, motor, one in self._drives:
            apart, turning = float(angles[motor] - angles[k]), float(rates[motor] - rates[k])
            twist = -_contact(one.strength, one.damping, 0.5 * one.play, apart, turning)
            out[3 + k] += twist
            out[3 + motor] -= twist
        for k, spring in self._springs:
            out[3 + k] -= spring.stiffness * (angles[k] - spring.rest) + spring.damping * rates[k]
        for k, friction in self._frictions:
            out[3 + k] -= friction.viscous * rates[k] + friction.dry(float(rates[k]))
        for k, cage in self._cages:
            deflection = float(angles[k]) - cage.angle
            out[3 + k] += _contact(cage.stiffness, cage.damping, cage.clearance, deflection, float(rates[k]))
        for row, _, _, wanted, device in self._erections:
            out[row] += min(max(wanted, -device.most), device.most)
        return out

    def slopes(self, q: FloatArray, rate_amplitude: FloatArray | None = None) -> ForceSlopes:
        """Return the slopes of the forces with the gimbals at rest.

        Dry friction has none at rest. With `rate_amplitude` (n,), rad/s, its describing function replaces it: the
        viscous friction that takes as much out of an oscillation of that rate, 4 F/(π amplitude), more with a Stribeck
        curve.
        """
        at, f, n = self._at, self._f, len(q)
        rate = np.zeros((n, n))
        angle, force = self._unbalance_slope(), self._unbalance.copy()
        for k, motor, one in self._drives:
            apart = np.zeros(n)
            apart[[k, motor]] = 1.0, -1.0
            angle[3:] -= one.strength * np.outer(apart, apart)
            rate -= one.damping * np.outer(apart, apart)
        for k, spring in self._springs:
            angle[3 + k, k] -= spring.stiffness
            rate[k, k] -= spring.damping
        for k, friction in self._frictions:
            rate[k, k] -= friction.viscous
            if rate_amplitude is not None:
                rate[k, k] -= _equivalent(friction, float(rate_amplitude[k]))
        for k, cage in self._cages:
            if cage.clearance == 0.0 or abs(q[k] - cage.angle) > cage.clearance:
                angle[3 + k, k] -= cage.stiffness
                rate[k, k] -= cage.damping
        size = float(np.linalg.norm(f))
        for row, senses, axis, wanted, device in self._erections:
            if abs(wanted) < device.most:
                turning = np.cross(at.axes, axis) * at.tree.on_path[senses][:, None]
                angle[row] += device.gain * (turning @ f) / size
                force[row] += (device.gain * axis - f / size * wanted) / size
        return ForceSlopes(angle=angle, rate=rate, force=force)

    def _unbalance_slope(self) -> FloatArray:
        """∂[M, Q]/∂q of the moments −(m r) × f, (3 + n, n)."""
        at, f, moments = self._at, self._f, self._moments
        # With gimbal j turns the mass moment of all that it carries, and the axes of the gimbals that it carries.
        turned = at.tree.on_path.T[:, :, None] * np.cross(at.axes[:, None, :], moments[None, :, :])
        out: FloatArray = np.einsum("bxi,jbx->ij", at.jacobians, np.cross(f, turned))
        turning = at.tree.above[:, :, None] * np.cross(at.axes[:, None, :], at.axes[None, :, :])
        out[3:] += np.einsum("jix,bx,bi->ij", turning, np.cross(f, moments), at.tree.on_path)
        return out


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


def _contact(stiffness: float, damping: float, clearance: float, deflection: float, rate: float) -> float:
    """Torque of a spring that pushes back beyond the clearance to either side; without clearance it pulls too."""
    if clearance == 0.0:
        return -stiffness * deflection - damping * rate
    beyond = abs(deflection) - clearance
    if beyond <= 0.0:
        return 0.0
    side = math.copysign(1.0, deflection)
    return -side * max(0.0, stiffness * beyond + damping * rate * side)
