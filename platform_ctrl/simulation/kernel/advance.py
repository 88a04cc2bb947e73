"""Many runs of the plant with nothing but constant forces from outside, LANES at a time."""

from __future__ import annotations

from platform_ctrl.common.compiling import compiled, internal
from platform_ctrl.common.simd import LANES, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel.arrays import RATE, SERVO, WORK, At, Links
from platform_ctrl.simulation.kernel.dynamics import joint_momenta, runge_kutta
from platform_ctrl.simulation.kernel.joints import settle_friction


@internal
def _furnish(mem: FloatArray, at: At, constants: FloatArray, around: FloatArray) -> None:
    """Write what is the same for all runs into the memory."""
    size = around.shape[0]
    for column in range(LANES):
        for i in range(constants.shape[0]):
            mem[i, column] = constants[i]
        for block in range(3):
            for i in range(size):
                mem[at.surroundings + block * size + i, column] = around[i]


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
        Where the runs begin.
    force : (N, 3 + n)
        Their [M, Q].
    every, history : (N, S, size)
        With `every` = 0 the end is recorded (S = 1), else also the start and every so many steps.
    """
    size, block = at.size, around.shape[0]
    _furnish(mem, at, constants, around)
    for first in range(0, states.shape[0], LANES):
        count = min(LANES, states.shape[0] - first)
        _fill(mem, at.state, states, first, size)
        for i in range(3):
            _fill(mem, at.surroundings + i * block, force, first, at.n + 3)
        mark = 0
        for k in range(steps + 1):
            if k == steps or (every > 0 and k % every == 0):
                for column in range(count):
                    for i in range(size):
                        history[first + column, mark, i] = mem[at.state + i, column]
                mark += 1
            if k < steps:
                runge_kutta(links, mem, at, at.yes, at.no, at.state, step)
                if at.keeps != 0:
                    settle_friction(links, mem, at, at.yes, step)


@compiled
def carrier_rates(
    links: Links,
    at: At,
    constants: FloatArray,
    around: FloatArray,
    mem: FloatArray,
    states: FloatArray,
    rates: FloatArray,
) -> None:
    """Rates (N, m) of the servo rotors' carriers about their spin axes in `states` (N, size) whose v holds the rates.

    `mem` as in `advance`.
    """
    _furnish(mem, at, constants, around)
    for first in range(0, states.shape[0], LANES):
        _fill(mem, at.state, states, first, at.size)
        joint_momenta(links, mem, at, at.state, at.surroundings, at.stages)
        for r in range(at.servos):
            axis, rate = at.servo + r * SERVO, at.work + links.servo_carrier[r] * WORK + RATE
            about = load(mem, axis) * load(mem, rate)
            for i in range(1, 3):
                about = about + load(mem, axis + i) * load(mem, rate + i)
            store(mem, at.stages + r, about)
        for column in range(min(LANES, states.shape[0] - first)):
            for r in range(at.servos):
                rates[first + column, r] = mem[at.stages + r, column]
