"""Dry friction at the end of a step: joints that come to rest stick, joints that are pulled too hard break away."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import Number, anywhere, choose, greater, lesser, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arrays import At, Links
from platform_ctrl.simulation.kernel.dynamics import derivative, push, response
from platform_ctrl.simulation.kernel.forces import deflection, dry_torque

# Rounds over the joints until none changes any more: joints that do not move each other need one.
_ROUNDS = 50
# A rate that is smaller counts as zero, rad/s.
_ZERO = 1e-13


@inlined
def _survey(links: Links, mem: FloatArray, at: At, free: bool) -> None:
    """Put the joints' rates at the end of a step into TURNS and the dry torques there into HAD."""
    n, rates = at.n, at.state + at.n + 3
    if not free:
        rates = at.stages
        derivative(links, mem, at, free, at.no, at.no, at.state, at.surroundings + 2 * at.block, rates)
    for k in range(n):
        during = at.during + 1 + k * arrays.DURING
        rate = load(mem, rates + k)
        store(mem, during + arrays.HAD, dry_torque(mem, at, at.state, k, rate))
        store(mem, during + arrays.TURNS, rate)


@internal
def settle_friction(links: Links, mem: FloatArray, at: At, free: bool, step: Number) -> None:
    """Bring the frictions' states to the end of a step of the motion.

    A joint that has stuck or whose rate has changed its sign gets the torque that would have stopped it, within
    breakaway: it sticks if that is enough, else it slides as it is pulled. The torque acts as an impulse on the whole
    plant, so that momenta balance.
    """
    n, dy = at.n, at.stages
    zero = 0.0 * load(mem, at.state)
    store(mem, at.during, step + zero)
    for k in range(n):
        if at.dry >= 1 << arrays.BRISTLES:
            z = at.state + at.keeps + k * arrays.FRICTION + arrays.DEFLECTION
            bristles = load(mem, at.joint + k * arrays.JOINT + arrays.LAW) > 1.5
            new = deflection(mem, at, at.state, k, zero)
            store(mem, z, choose(bristles, new, load(mem, z)))
    store(mem, at.during, zero)
    if at.dry & 1 << arrays.STICKING == 0:
        return
    _survey(links, mem, at, free)
    for _ in range(_ROUNDS):
        settled = True
        for k in range(n):
            joint = at.joint + k * arrays.JOINT
            kept, during = at.state + at.keeps + k * arrays.FRICTION, at.during + 1 + k * arrays.DURING
            law, side = load(mem, joint + arrays.LAW), load(mem, kept + arrays.SLIDING)
            rate, had = load(mem, during + arrays.TURNS), load(mem, during + arrays.HAD)
            stopped = (law > 0.5) & (law < 1.5) & ((side * side < 0.5) | (side * rate < 0.0))
            turning = stopped & ((rate > _ZERO) | (rate < -_ZERO))
            if not anywhere(turning):
                continue
            settled = False
            response(links, mem, at, free, k, dy)
            wanted = had + rate / load(mem, dy + k) / step
            most, least = load(mem, joint + arrays.BREAKAWAY + 1), -load(mem, joint + arrays.BREAKAWAY)
            given = lesser(greater(wanted, least), most)
            direction = choose(wanted > most, zero + 1.0, choose(wanted < least, zero - 1.0, zero))
            impulse = choose(turning, (had - given) * step, zero)
            push(mem, at, free, k, dy, impulse)
            for i in range(n):
                turns = at.during + 1 + i * arrays.DURING + arrays.TURNS
                store(mem, turns, load(mem, turns) + impulse * load(mem, dy + i))
            store(mem, during + arrays.HAD, choose(turning, given, had))
            store(mem, kept + arrays.SLIDING, choose(turning, direction, side))
            held = load(mem, kept + arrays.HELD_BY)
            store(mem, kept + arrays.HELD_BY, choose(turning, -given, held))
        if settled:
            return
