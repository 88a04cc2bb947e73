"""Drives: shafts and gears that give way, currents of motors with their loops, cogging and ripple."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined
from platform_ctrl.common.simd import Number, choose, greater, lesser, load
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import add, cosine_and_sine, put, vector
from platform_ctrl.simulation.kernel.arrays import At, Links
from platform_ctrl.simulation.kernel.forces import contact, missing_torque


@inlined
def _within(mem: FloatArray, slot: int, number: Number) -> Number:
    limit = load(mem, slot)
    return lesser(greater(number, -limit), limit)


@inlined
def drive_torques(links: Links, mem: FloatArray, at: At, y: int, around: int, dy: int) -> None:
    """Add the torques of drives to the joints' in `dy`, behind the joints' rates there; derivatives of currents."""
    n, zero = at.n, 0.0 * load(mem, y)
    torque, first = dy + n + 3, links.drive.shape[0] - at.windings - at.teeth - at.ripples
    for d in range(first):
        k, motor = links.drive[d, 0], links.drive[d, 1]
        apart = load(mem, y + motor) - load(mem, y + k)
        turning = load(mem, dy + motor) - load(mem, dy + k)
        twist = contact(mem, at.drive + 3 * d, apart, turning)
        add(mem, torque + k, twist)
        add(mem, torque + motor, -twist)
    for m in range(at.windings):
        k, slot, state = links.drive[first + m, 0], at.winding + m * arrays.WINDING, at.currents + 3 * m
        add(mem, torque + k, missing_torque(mem, at, y, around, m))
        current, integral, delayed = vector(mem, y + state)
        error = load(mem, around + at.wanted + m) / load(mem, slot) - current
        asked = load(mem, slot + arrays.LOOP_GAIN) * error + integral
        given = _within(mem, slot + arrays.SUPPLY, asked)
        v = _within(mem, slot + arrays.SUPPLY, 2.0 * delayed - given)
        v = v - load(mem, slot + arrays.RESISTANCE) * current
        v = v - load(mem, slot + arrays.EMF) * load(mem, dy + k)
        further = (asked - given) * error > 0.0
        rise = choose(further, zero, load(mem, slot + arrays.LOOP_INTEGRAL) * error)
        pace = load(mem, slot + arrays.PACE)
        put(mem, dy + state, v / load(mem, slot + arrays.INDUCTANCE), rise, pace * (given - delayed))
    for t in range(at.teeth + at.ripples):
        row, slot = first + at.windings + t, at.winding + at.windings * arrays.WINDING + 3 * t
        k, m = links.drive[row, 0], links.drive[row, 1]
        _, s = cosine_and_sine(load(mem, slot) * load(mem, y + k) + load(mem, slot + 2))
        size = load(mem, slot + 1)
        if t >= at.teeth:  # a share of what the current does
            size = size * load(mem, at.winding + m * arrays.WINDING) * load(mem, y + at.currents + 3 * m)
        add(mem, torque + k, size * s)
