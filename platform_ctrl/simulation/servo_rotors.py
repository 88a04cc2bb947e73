"""Servo rotors in a run: their states behind those of the bodies, and the step that their speed loops need.

The states of m servo rotors are the axial momenta P = C (φ̇ + B u), eq. (4), and the integrals x = ∫(φ̇ − spin) dt:
P' = τ = clamp(−speed_gain (φ̇ − spin) − speed_integral x, ± torque_limit) and x' = φ̇ − spin, but x' = 0 while the
torque is at its limit and the error would drive it further in.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.kinematics import kinematics
from platform_ctrl.mechanics.matrices import directions
from platform_ctrl.plant.platform import Platform, Rotor
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.packing import Packed, skeleton
from platform_ctrl.simulation.step_limit import masses

# The classical Runge-Kutta method is stable for decays up to 2.785 per step.
_PER_STEP = 2.7


def servo_rotors(platform: Platform) -> tuple[Rotor, ...]:
    """Return the rotors whose speed a real loop controls, in the file's order."""
    return tuple(r for r in platform.rotors if r.control == "servo")


def initial_spins(platform: Platform, given: ArrayLike | None, shape: tuple[int, ...]) -> FloatArray:
    """Return the servo rotors' spins at the start, `shape`; the nominal ones if `given` is None."""
    if given is None:
        return np.array(np.broadcast_to([r.spin for r in servo_rotors(platform)], shape), dtype=np.float64)
    return real_array("spin", given, shape)


def spins_of(plant: Packed, states: FloatArray) -> FloatArray:
    """Return the servo rotors' spins, (..., m), at states (..., 2 n + 7 + 2 m) whose v holds the rates."""
    at = plant.at
    momenta = states[..., 2 * at.n + 7 : 2 * at.n + 7 + at.servos]
    return np.asarray(momenta / _axial_inertias(plant) - _carrier_rates(plant, states))


def with_rotor_states(
    plant: Packed, states: FloatArray, spins: FloatArray, inertias: FloatArray | None = None
) -> FloatArray:
    """Return `states` (N, 2 n + 7), whose v holds the rates, with those of servo rotors at `spins` (N, m) behind.

    `inertias` (N, m) are C of the servo rotors where the states are of different plants.
    """
    out = np.concatenate([states, np.zeros((len(states), 2 * plant.at.servos))], axis=1)
    first = states.shape[1]
    C = _axial_inertias(plant) if inertias is None else inertias
    out[:, first : first + plant.at.servos] = C * (spins + _carrier_rates(plant, out))
    return out


def _axial_inertias(plant: Packed) -> FloatArray:
    at = plant.at
    return plant.constants[at.servo : at.erection].reshape(-1, arrays.SERVO)[:, arrays.C]


def _carrier_rates(plant: Packed, states: FloatArray) -> FloatArray:
    """Rates of the servo rotors' carriers about their spin axes, (..., m)."""
    rates = np.empty((*states.shape[:-1], plant.at.servos))
    if rates.size:
        from platform_ctrl.common.simd import memory
        from platform_ctrl.simulation.kernel.advance import carrier_rates

        flat = np.ascontiguousarray(states).reshape(-1, plant.at.size)
        carrier_rates(*plant, memory(plant.at.end), flat, rates.reshape(-1, plant.at.servos))
    return rates


def check_step(platforms: Sequence[Platform], steps: ArrayLike, free: bool) -> None:
    """Refuse steps at which a speed loop would diverge: one for each of several plants of one skeleton.

    The loop's faster pole is checked, with the inertia that the motor turns: C against what carries the rotor, all
    gimbals at zero.
    """
    shape = skeleton(platforms[0])
    if not shape.servos:
        return
    at, servos = kinematics(platforms[0], np.zeros(len(platforms[0].gimbals))), list(shape.servos)
    low = 0 if free else 3
    A = masses(shape, platforms, at, ("regulated",))[:, low:, low:]
    B = directions(at)[servos, low:]
    C, gain, integral = np.array(
        [
            [(p.rotors[k].axial_inertia, p.rotors[k].speed_gain, p.rotors[k].speed_integral) for k in servos]
            for p in platforms
        ]
    ).transpose(2, 0, 1)
    # Spin per momentum that the motor exchanges. A joint that moves nothing (a singular A) is for the run to find.
    compliance = 1.0 / C + np.einsum("ri,nij,rj->nr", B, np.linalg.pinv(A, hermitian=True), B)
    half, product = 0.5 * gain * compliance, integral * compliance
    square = half**2 - product
    fastest = np.where(square >= 0.0, np.abs(half) + np.sqrt(np.abs(square)), np.sqrt(np.abs(product)))
    given = np.broadcast_to(np.asarray(steps)[..., None], fastest.shape)
    for place, k in np.argwhere(given * fastest > _PER_STEP)[:1]:
        pole, rotor = fastest[place, k], platforms[place].rotors[servos[k]]
        raise ArgumentError(
            f"step: {given[place, k]:.3g} s is too long for the speed loop of rotor {rotor.name!r}, which decays at "
            f"{pole:.4g} 1/s; take at most {_PER_STEP / pole:.3g} s"
        )
