"""Many runs of the plant with nothing but constant forces from outside, LANES at a time."""

from __future__ import annotations

from platform_ctrl.common.compiling import compiled, internal
from platform_ctrl.common.simd import LANES, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel.arrays import At, Links
from platform_ctrl.simulation.kernel.dynamics import joint_momenta, runge_kutta, start_servos
from platform_ctrl.simulation.kernel.forces import servo_motor
from platform_ctrl.simulation.kernel.joints import settle_friction


@internal
def _fill(mem: FloatArray, slot: int, rows: FloatArray, first: int, size: int) -> None:
    """Put rows from `first` on into the columns; columns without a row of their own repeat the first one."""
    for column in range(LANES):
        row = first + column if first + column < rows.shape[0] else first
        for i in range(size):
            mem[slot + i, column] = rows[row, i]


@compiled
def advance(
    links: Links,
    at: At,
    constants: FloatArray,
    around: FloatArray,
    mem: FloatArray,
    states: FloatArray,
    force: FloatArray,
    step: float,
    steps: int,
    every: int,
    history: FloatArray,
) -> None:
    """Move runs with a free root on by `steps` steps.

    Parameters
    ----------
    links, at, constants, around
        The plant.
    mem : (at.end, LANES)
        Zeros to work in.
    states : (N, size)
        Where the runs begin; here and in `history` spins of servo rotors are in the place of their momenta.
    force : (N, 3 + n)
        Their [M, Q].
    every, history : (N, S, size)
        With `every` = 0 the end is recorded (S = 1), else also the start and every so many steps.
    """
    size, block = at.size, around.shape[0]
    for column in range(LANES):
        for i in range(constants.shape[0]):
            mem[i, column] = constants[i]
        for i in range(3 * block):
            mem[at.surroundings + i, column] = around[i % block]
    for first in range(0, states.shape[0], LANES):
        count = min(LANES, states.shape[0] - first)
        _fill(mem, at.state, states, first, size)
        for i in range(3):
            _fill(mem, at.surroundings + i * block, force, first, at.n + 3)
        start_servos(links, mem, at)
        mark = 0
        for k in range(steps + 1):
            if k == steps or (every > 0 and k % every == 0):
                if at.servos > 0:
                    joint_momenta(links, mem, at, at.surroundings, at.stages)
                for r in range(at.servos):
                    spin, _ = servo_motor(links, mem, at, at.state, r)
                    store(mem, at.stages + r, spin)
                for column in range(count):
                    for i in range(size):
                        history[first + column, mark, i] = mem[at.state + i, column]
                    for r in range(at.servos):
                        history[first + column, mark, 2 * at.n + 7 + r] = mem[at.stages + r, column]
                mark += 1
            if k < steps:
                runge_kutta(links, mem, at, at.yes, at.no, step)
                if at.keeps != 0:
                    settle_friction(links, mem, at, at.yes, step)
