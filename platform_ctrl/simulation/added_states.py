"""States behind those of the bodies: of servo rotors, of modes, and of frictions whose joints stick or slide.

Of m servo rotors these are the axial momenta P = C (φ̇ + B u), eq. (4), and the integrals x = ∫(φ̇ − spin) dt.
P' = τ = clamp(−speed_gain (φ̇ − spin) − speed_integral x, ± torque_limit) and x' = φ̇ − spin, but x' = 0 while the torque
is at its limit and the error would drive it further in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray
from platform_ctrl.plant.gimbals import Rotor
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.packing import Packed


def servo_rotors(platform: Platform) -> tuple[Rotor, ...]:
    """Return the rotors whose speed a real loop controls, in the file's order."""
    return tuple(r for r in platform.rotors if r.control == "servo")


def initial_spins(platform: Platform, given: ArrayLike | None, shape: tuple[int, ...]) -> FloatArray:
    """Return the servo rotors' spins at the start, `shape`; the nominal ones if `given` is None."""
    if given is None:
        return np.array(np.broadcast_to([r.spin for r in servo_rotors(platform)], shape), dtype=np.float64)
    return real_array("spin", given, shape)


def with_added_states(plant: Packed, states: FloatArray, spins: FloatArray) -> FloatArray:
    """Return `states` (N, 2 n + 7), whose v holds the rates, with the added states behind.

    Servo rotors are at `spins` (N, m), of which the kernel makes their momenta, modes at rest in a platform that turns,
    and joints slide as they turn.
    """
    at, first = plant.at, states.shape[1]
    out = np.concatenate([states, np.zeros((len(states), at.size - first))], axis=1)
    if at.modes:
        modes = plant.constants[at.mode : at.gravity].reshape(at.modes, -1)
        momenta = states[:, at.n : 2 * at.n + 3] @ modes[:, arrays.INERTIAL : at.shape].T
        out[:, at.swings + 1 : at.swings + 2 * at.modes : 2] = momenta
    if at.keeps:
        rows = plant.constants[at.joint : at.servo].reshape(-1, arrays.JOINT)
        side = np.sign(states[:, at.n + 3 : 2 * at.n + 3])
        most = rows[:, arrays.COULOMB : arrays.BREAKAWAY].mean(axis=1) / np.maximum(rows[:, arrays.BRISTLE], 1e-300)
        begin = np.select([rows[:, arrays.LAW] == arrays.STICKING, rows[:, arrays.LAW] > arrays.STICKING], [1.0, most])
        out[:, at.keeps :: arrays.FRICTION] = begin * side
    out[:, first : first + plant.at.servos] = spins
    return out
