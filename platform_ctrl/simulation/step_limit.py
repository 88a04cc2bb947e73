"""How long a step springs, cages and friction allow: too long a one gives numbers, and wrong ones."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.description import Platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.kinematics import upright
from platform_ctrl.mechanics.matrices import mass_matrix, world_inertias

# The classical Runge-Kutta method is stable for decays up to 2.785 per step. At a radian per step it damps an
# oscillation that is too fast to matter. A contact that is met and left again needs more: at 0.3 rad per step a hundred
# bounces cost a few per cent of the energy, at 1 rad nine tenths of it.
_DECAY, _PHASE, _CONTACT = 2.7, 1.0, 0.3


def check_elements(platform: Platform, step: float, free: bool) -> None:
    """Refuse a step that is too long for an element, judged by its gimbal's inertia with all angles zero.

    Raises
    ------
    ArgumentError
        Which element, and the longest step that would do.
    """
    if not (platform.springs or platform.cages or platform.frictions):
        return
    at = upright(platform)
    low = 0 if free else 3
    mass = mass_matrix(at.jacobians, world_inertias(platform, at))[low:, low:]
    # How easily each gimbal gives way: the diagonal of A*'s inverse; a singular A* is for the run itself to find.
    level, shape = np.linalg.eigh(mass)
    regular = level > 1e-15 * level[-1]
    eases = (shape**2) @ np.where(regular, 1.0 / np.where(regular, level, 1.0), 0.0)
    mobility = dict(zip(platform.gimbal_names, eases[3 - low :].tolist(), strict=True))
    longest: list[tuple[float, str, str]] = []

    def judge(kind: str, gimbal: str, stiffness: float, damping: float, phase: float = _PHASE) -> None:
        ease = mobility[gimbal]
        turning, decay = math.sqrt(abs(stiffness) * ease), damping * ease
        if turning > 0.0:
            longest.append((phase / turning, kind, gimbal))
        if decay > 0.0:
            longest.append((_DECAY / decay, kind, gimbal))

    for spring in platform.springs:
        judge("spring", spring.gimbal, spring.stiffness, 0.0)
    for cage in platform.cages:
        judge("cage", cage.gimbal, cage.stiffness, cage.damping, _CONTACT if cage.clearance else _PHASE)
    for friction in platform.frictions:
        judge("friction", friction.gimbal, 0.0, friction.steepest_slope)
    if longest:
        allowed, kind, gimbal = min(longest)
        if step > 1.005 * allowed:  # what the message rounds up to is allowed
            cure = ", or a larger coulomb_rate" if kind == "friction" else ""
            wrong = f"step: {step:.3g} s is too long for the {kind} of gimbal {gimbal!r}"
            raise ArgumentError(f"{wrong}; expected at most {allowed:.3g} s{cure}")
