"""How long a step springs, cages, friction and speed loops allow: too long a one gives numbers, and wrong ones."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from operator import attrgetter

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.kinematics import kinematics
from platform_ctrl.mechanics.matrices import body_inertias, directions, mass_matrix
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation.packing import skeleton


def _masses(platforms: Sequence[Platform], locked: Collection[str]) -> FloatArray:
    """Return the mass matrices (N, 3 + n, 3 + n) of plants at zero angles; rotors of the kinds `locked` add C."""
    out = []
    for platform in platforms:
        at = kinematics(platform, np.zeros(len(platform.gimbals)))
        B, C = directions(at), [r.axial_inertia * (r.control in locked) for r in platform.rotors]
        out.append(mass_matrix(at, body_inertias(at)) + B.T @ (np.array(C)[:, None] * B))
    return np.array(out)


# The classical Runge-Kutta method is stable for decays up to 2.785 per step. At a radian per step it damps an
# oscillation that is too fast to matter. A contact that is met and left again needs more: at 0.3 rad per step a hundred
# bounces cost a few per cent of the energy, at 1 rad nine tenths of it. A mode loses by it as if its damping were 2e-5
# larger.
_DECAY, _PHASE, _CONTACT = 2.7, 1.0, 0.3


def check_steps(platforms: Sequence[Platform], steps: ArrayLike, free: bool) -> None:
    """Refuse steps that are too long for a speed loop or an element: one for each of several plants of one skeleton."""
    _check_speed_loops(platforms, steps, free)
    found = _longest(platforms, free)
    if not found:
        return
    longest = np.array([row for _, _, row in found])
    given = np.broadcast_to(steps, len(platforms))
    for place in np.flatnonzero(given > 1.005 * longest.min(axis=0))[:1]:  # what the message rounds up to is allowed
        kind, k, row = found[int(longest[:, place].argmin())]
        cure = ", or a larger coulomb_rate" if kind == "friction" else ""
        plant = platforms[place]
        part = repr(plant.modes[k].name) if kind == "mode" else f"of gimbal {plant.gimbals[k].name!r}"
        wrong = f"step: {given[place]:.3g} s is too long for the {kind} {part}"
        raise ArgumentError(f"{wrong}; take at most {row[place]:.3g} s{cure}")


def longest_step(platform: Platform, free: bool) -> float:
    """Return the longest step that the elements of a plant allow, s; infinite without any."""
    return min((float(row[0]) for _, _, row in _longest([platform], free)), default=float("inf"))


def _longest(platforms: Sequence[Platform], free: bool) -> list[tuple[str, int, FloatArray]]:
    """Return of each element its kind, its gimbal and the longest step for it, (N,), for plants of one skeleton.

    Modes have their number in place of a gimbal. Uses the gimbals' inertias with all angles zero.
    """
    shape = skeleton(platforms[0])
    found: list[tuple[str, int, FloatArray]] = []
    jointed = shape.at.joints or len(shape.links.drive)
    if not (shape.at.modes or jointed):
        return found
    low, names = 0 if free else 3, platforms[0].gimbal_names
    mass = _masses(platforms, ("regulated", "servo"))[:, low:, low:]
    inverse = np.linalg.pinv(mass, hermitian=True)
    for k in range(shape.at.modes):
        # What gives way to a mode by its inertia makes it faster.
        own = np.array([p.modes[k].inertial(names)[low:] for p in platforms])
        left = 1.0 - np.einsum("ni,nij,nj->n", own, inverse, own)
        found.append(
            ("mode", k, _CONTACT * np.sqrt(np.maximum(left, 0.0)) / np.array([p.modes[k].frequency for p in platforms]))
        )
    if not jointed:
        return found
    # How easily each gimbal gives way, (N, n); a singular A* is for the run to find.
    ease = np.einsum("nii->ni", inverse)[:, 3 - low :]
    with np.errstate(divide="ignore"):
        for j, (k, motor) in enumerate(platforms[0].sides):
            stiffness, damping = np.array([(p.compliances[j].strength, p.compliances[j].damping) for p in platforms]).T
            apart = ease[:, k] + ease[:, motor]
            found.append(("compliance", int(k), _CONTACT / np.sqrt(stiffness * apart)))
            found.append(("compliance", int(k), _DECAY / (damping * apart)))
        for j, (k, _) in enumerate(platforms[0].windings):
            poles = [np.linalg.eigvals(p.windings[j][1].matrices[0]) for p in platforms]
            found.append(("current loop", k, _DECAY / np.abs(poles).max(axis=1)))
        for j, k in enumerate(shape.springs):
            stiffness, damping = np.array([(p.held_by[j].stiffness, p.held_by[j].damping) for p in platforms]).T
            found.append(("spring", k, _PHASE / np.sqrt(np.abs(stiffness) * ease[:, k])))
            found.append(("servo", k, _DECAY / (damping * ease[:, k])))
        for j, k in enumerate(shape.cages):
            cages = [p.cages[j] for p in platforms]
            phase, stiffness, damping = np.array(
                [(_CONTACT if cage.clearance else _PHASE, cage.stiffness, cage.damping) for cage in cages]
            ).T
            found.append(("cage", k, phase / np.sqrt(stiffness * ease[:, k])))
            found.append(("cage", k, _DECAY / (damping * ease[:, k])))
        for j, k in enumerate(shape.frictions):
            slope, stiffness = np.array(
                [(p.frictions[j].steepest_slope, p.frictions[j].bristle_stiffness) for p in platforms]
            ).T
            found.append(("friction", k, _DECAY / (slope * ease[:, k])))
            found.append(("bristles", k, _PHASE / np.sqrt(stiffness * ease[:, k])))
    return found


def _check_speed_loops(platforms: Sequence[Platform], steps: ArrayLike, free: bool) -> None:
    """Refuse steps at which a speed loop would diverge.

    The loop's faster pole is checked, with the inertia that the motor turns: C against what carries the rotor, all
    gimbals at zero.
    """
    shape = skeleton(platforms[0])
    if not shape.servos:
        return
    at, servos = kinematics(platforms[0], np.zeros(len(platforms[0].gimbals))), list(shape.servos)
    low = 0 if free else 3
    A = _masses(platforms, ("regulated",))[:, low:, low:]
    B = directions(at)[servos, low:]
    loop = attrgetter("axial_inertia", "speed_gain", "speed_integral")
    loops = [[loop(p.rotors[k]) for k in servos] for p in platforms]
    C, gain, integral = np.array(loops).transpose(2, 0, 1)
    # Spin per momentum that the motor exchanges. A joint that moves nothing (a singular A) is for the run to find.
    compliance = 1.0 / C + np.einsum("ri,nij,rj->nr", B, np.linalg.pinv(A, hermitian=True), B)
    half, product = 0.5 * gain * compliance, integral * compliance
    square = half**2 - product
    fastest = np.where(square >= 0.0, np.abs(half) + np.sqrt(np.abs(square)), np.sqrt(np.abs(product)))
    given = np.broadcast_to(np.asarray(steps)[..., None], fastest.shape)
    for place, k in np.argwhere(given * fastest > _DECAY)[:1]:
        pole, rotor = fastest[place, k], platforms[place].rotors[servos[k]]
        raise ArgumentError(
            f"step: {given[place, k]:.3g} s is too long for the speed loop of rotor {rotor.name!r}, which decays at "
            f"{pole:.4g} 1/s; take at most {_DECAY / pole:.3g} s"
        )
