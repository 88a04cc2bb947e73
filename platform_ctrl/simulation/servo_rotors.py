"""Servo rotors in a run: their states behind those of the bodies, and the step that their speed loops need.

The states of m servo rotors are the axial momenta P = C (φ̇ + B u), eq. (4), and the integrals x = ∫(φ̇ − spin) dt:
P' = τ = clamp(−speed_gain (φ̇ − spin) − speed_integral x, ± torque_limit) and x' = φ̇ − spin, but x' = 0 while the
torque is at its limit and the error would drive it further in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.arguments import real_array
from platform_ctrl.description import Platform, Rotor
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import topology, upright
from platform_ctrl.mechanics.matrices import directions, mass_matrix
from platform_ctrl.simulation.kernel import body as layout

if TYPE_CHECKING:
    from platform_ctrl.simulation.packing import Packed

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


def spins_of(plant: Packed, states: FloatArray) -> FloatArray:
    """Return the servo rotors' spins, (..., m), at states (..., 2 n + 7 + 2 m) whose v holds the rates."""
    at = plant.at
    momenta = states[..., 2 * at.n + 7 : 2 * at.n + 7 + at.servos]
    return np.asarray(momenta / _axial_inertias(plant) - _carrier_rates(plant, states))


def with_rotor_states(plant: Packed, states: FloatArray, spins: FloatArray) -> FloatArray:
    """Return `states` (N, 2 n + 7), whose v holds the rates, with those of servo rotors at `spins` (N, m) behind."""
    out = np.concatenate([states, np.zeros((len(states), 2 * plant.at.servos))], axis=1)
    first = states.shape[1]
    momenta = _axial_inertias(plant) * (spins + _carrier_rates(plant, out))
    out[:, first : first + plant.at.servos] = momenta
    return out


def _axial_inertias(plant: Packed) -> FloatArray:
    at = plant.at
    return plant.constants[at.servo : at.erection].reshape(-1, layout.SERVO)[:, layout.C]


def _carrier_rates(plant: Packed, states: FloatArray) -> FloatArray:
    """Rates of the servo rotors' carriers about their spin axes, (..., m)."""
    rates = np.empty((*states.shape[:-1], plant.at.servos))
    if rates.size:
        from platform_ctrl.lanes import memory
        from platform_ctrl.simulation.kernel.advance import carrier_rates

        flat = np.ascontiguousarray(states).reshape(-1, plant.at.size)
        carrier_rates(*plant, memory(plant.at.end), flat, rates.reshape(-1, plant.at.servos))
    return rates


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
    at = upright(platform)
    inertias = tree.inertias.copy()
    held = np.array([r.control == "regulated" for r in platform.rotors])
    for body, C, axis in zip(tree.carriers[held], tree.C[held], tree.spin_axes[held], strict=True):
        inertias[body] += C * np.outer(axis, axis)
    low = 0 if free else 3
    A = mass_matrix(at.jacobians, inertias)[low:, low:]
    B = directions(platform, at)[servo, low:]
    # A joint that moves nothing (a singular A) is for the run itself to find.
    return np.asarray(1.0 / tree.C[servo] + np.einsum("ri,ij,rj->r", B, np.linalg.pinv(A, hermitian=True), B))
