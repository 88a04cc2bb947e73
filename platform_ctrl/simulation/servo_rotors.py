"""Servo rotors in a run: their states behind those of the bodies, and the step that their speed loops need.

The states of m servo rotors are the axial momenta P = C (φ̇ + B u), eq. (4), and the integrals x = ∫(φ̇ − spin) dt:
P' = τ = clamp(−speed_gain (φ̇ − spin) − speed_integral x, ± torque_limit) and x' = φ̇ − spin, but x' = 0 while the
torque is at its limit and the error would drive it further in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.arguments import real_array
from platform_ctrl.description import Platform, Rotor
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import kinematics, topology
from platform_ctrl.mechanics.matrices import directions, mass_matrix

Plant = tuple[NDArray[np.int64], FloatArray]

# The classical Runge-Kutta method is stable for decays up to 2.785 per step.
_PER_STEP = 2.7


def servo_rotors(platform: Platform) -> tuple[Rotor, ...]:
    """Return the rotors whose speed a real loop controls, in the file's order."""
    return tuple(r for r in platform.rotors if r.control == "servo")


def initial_spins(platform: Platform, given: ArrayLike | None, shape: tuple[int, ...]) -> FloatArray:
    """Return the servo rotors' spins at the start, `shape`; the nominal ones if `given` is None.

    Raises
    ------
    ArgumentError
        Wrong shape or not finite.
    """
    if given is None:
        return np.array(np.broadcast_to([r.spin for r in servo_rotors(platform)], shape), dtype=np.float64)
    return real_array("spin", given, shape)


def spins_of(plant: Plant, states: FloatArray) -> FloatArray:
    """Return the servo rotors' spins, (..., m), at states (..., 2 n + 7 + 2 m) whose v holds the rates."""
    count = (states.shape[-1] - 2 * plant[0].shape[1] - 7) // 2
    spins = np.empty((*states.shape[:-1], count))
    if count:
        from platform_ctrl.simulation import old_kernel as kernel

        flat = np.ascontiguousarray(states).reshape(-1, states.shape[-1])
        kernel.rotor_spins(*plant, True, flat, spins.reshape(-1, count))
    return spins


def with_rotor_states(plant: Plant, states: FloatArray, spins: FloatArray) -> FloatArray:
    """Return `states` (N, 2 n + 7), whose v holds the rates, with those of servo rotors at `spins` (N, m) behind."""
    count = spins.shape[1]
    with_rotors = np.concatenate([states, np.zeros((len(states), 2 * count))], axis=1)
    # Without momentum a rotor seems to spin backwards at the rate of its carrier.
    first, body = states.shape[1], plant[1]
    rows = slice(1 + plant[0].shape[1], 1 + plant[0].shape[1] + count)
    with_rotors[:, first : first + count] = body[rows, 4] * (spins - spins_of(plant, with_rotors))
    return with_rotors


def check_step(platform: Platform, step: float, free: bool) -> None:
    """Refuse a step at which a speed loop would diverge.

    The loop's faster pole is judged, with the inertia that the motor turns: C against what carries the rotor, all
    gimbals at zero.

    Raises
    ------
    ArgumentError
        The step is longer than 2.7 times the time constant of that pole (about C/speed_gain).
    """
    servos = servo_rotors(platform)
    if not servos:
        return
    for rotor, compliance in zip(servos, _compliances(platform, free), strict=True):
        gain, integral = rotor.speed_gain * compliance, rotor.speed_integral * compliance
        fastest = float(np.abs(np.roots([1.0, gain, integral])).max())
        if step * fastest > _PER_STEP:
            raise ArgumentError(
                f"step: {step:.3g} s is too long for the speed loop of rotor {rotor.name!r}, which decays at "
                f"{fastest:.4g} 1/s; expected at most {_PER_STEP / fastest:.3g} s"
            )


def _compliances(platform: Platform, free: bool) -> FloatArray:
    """1/C + B A⁻¹ Bᵀ of every servo rotor: spin per momentum that the motor exchanges."""
    tree = topology(platform)
    servo = np.array([r.control == "servo" for r in platform.rotors])
    at = kinematics(platform, np.zeros(len(tree.parents)))
    inertias = tree.inertias.copy()
    held = np.array([r.control == "regulated" for r in platform.rotors])
    for body, C, axis in zip(tree.carriers[held], tree.C[held], tree.spin_axes[held], strict=True):
        inertias[body] += C * np.outer(axis, axis)
    low = 0 if free else 3
    A = mass_matrix(at.jacobians, inertias)[low:, low:]
    B = directions(platform, at)[servo, low:]
    # A joint that moves nothing (a singular A) is for the run itself to find.
    return np.asarray(1.0 / tree.C[servo] + np.einsum("ri,ij,rj->r", B, np.linalg.pinv(A, hermitian=True), B))
