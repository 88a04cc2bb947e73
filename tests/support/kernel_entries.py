"""Single functions of the compiled kernel, called from Python on up to eight states side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl import Platform
from platform_ctrl.common.compiling import _stamp, compiled
from platform_ctrl.common.simd import memory
from platform_ctrl.simulation.kernel import dynamics
from platform_ctrl.simulation.kernel.arrays import LOCKED, MOMENT, WORK
from platform_ctrl.simulation.packing import Packed, pack


@compiled
def _derivative(links, mem, at, free, locking, bare, y, around, dy):
    dynamics.derivative(links, mem, at, free, locking, bare, y, around, dy)


@compiled
def _joint_momenta(links, mem, at, y, around, result):
    dynamics.joint_momenta(links, mem, at, y, around, result)


# They are compiled anew when the kernel has changed.
for _entry in (_derivative, _joint_momenta):
    _entry._cache._cache_file._version += str(_stamp(Path(dynamics.__file__)))


def space(plant: Packed) -> np.ndarray:
    """Return a memory that holds the plant and what is around it."""
    mem = memory(plant.at.end)
    mem[: len(plant.constants)] = plant.constants[:, None]
    mem[plant.at.surroundings : plant.at.surroundings + 3 * plant.at.block] = np.tile(plant.around, 3)[:, None]
    return mem


def put(mem: np.ndarray, slot: int, rows: np.ndarray) -> None:
    """Put rows, or one row for all columns, into the columns of the memory; the first one into what is left."""
    rows = np.atleast_2d(rows)
    columns = np.concatenate([rows, np.repeat(rows[:1], mem.shape[1] - len(rows), axis=0)])
    mem[slot : slot + rows.shape[1]] = columns.T


def whole_state(q: np.ndarray, v: np.ndarray, rotors: np.ndarray | tuple[()] = ()) -> np.ndarray:
    """Return the kernel's state; `rotors` are P and x of the servo rotors."""
    return np.concatenate([q, v, [1.0, 0.0, 0.0, 0.0], rotors])


def derivatives(
    platform: Platform,
    states: np.ndarray,
    force: np.ndarray,
    free: bool = True,
    held: Any = (),
) -> np.ndarray:
    """Derivatives of states (k, size), k <= 8, under [M, Q] = `force`; the gimbals `held` are locked."""
    plant = pack(platform)
    at, mem = plant.at, space(plant)
    put(mem, at.state, states)
    put(mem, at.surroundings, force)
    for k in held:
        mem[at.work + (k + 1) * WORK + LOCKED] = 1.0
    locking = len(tuple(held)) > 0
    _derivative(plant.links, mem, at, free, locking, False, at.state, at.surroundings, at.stages)
    return mem[at.stages : at.stages + at.size].T[: len(np.atleast_2d(states))].copy()


def momenta(platform: Platform, states: np.ndarray) -> np.ndarray:
    """Angular momentum about the fixed point in root axes and joint momenta (k, 3 + n) of states whose v is rates."""
    plant = pack(platform)
    at, mem = plant.at, space(plant)
    put(mem, at.state, states)
    _joint_momenta(plant.links, mem, at, at.state, at.surroundings, at.stages)
    root = at.work + MOMENT
    out = np.concatenate([mem[root : root + 3], mem[at.stages : at.stages + at.n]])
    return out.T[: len(np.atleast_2d(states))].copy()


def state_derivative(platform: Platform, q: Any, v: Any, force: Any, free: bool = True, held: Any = ()) -> Any:
    """Return q' and v' of one state."""
    n = len(platform.gimbals)
    dy = derivatives(platform, whole_state(q, v), force, free=free, held=held)[0]
    return dy[:n], dy[n : 2 * n + 3]
