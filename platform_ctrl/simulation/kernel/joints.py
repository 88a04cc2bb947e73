"""Joints at the end of a step: impacts on stops, joints held at them, and dry friction that sticks or breaks away."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import Mask, Number, anywhere, choose, greater, lesser, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arrays import At, Layout, Links, Shared
from platform_ctrl.simulation.kernel.dynamics import at_rest, derivative, joint_momenta, push, response, runge_kutta
from platform_ctrl.simulation.kernel.forces import deflection, dry_torque
from platform_ctrl.simulation.kernel.slots import add, copy, put_where

# A run of fewer steps than these from a stop back to it ends at most as fast as it began.
_SHORT = 20.0


@inlined
def past_stop(mem: FloatArray, at: At, layout: Layout, k: int) -> Mask:
    """Whether gimbal k is beyond a stop."""
    q, stop = load(mem, at.state + k), layout.stop + k * arrays.STOP
    return (q < load(mem, stop + arrays.LOW)) | (q > load(mem, stop + arrays.HIGH))


@internal
def _come_anew(links: Links, mem: FloatArray, at: At, layout: Layout, free: bool, blown: Mask) -> None:
    """Release gimbals that an impact drives against the stops they lie on: they meet these once more."""
    n, dy = at.n, at.stages
    derivative(links, mem, at, free, at.no, at.no, at.state, at.surroundings + 2 * at.block, dy)
    for k in range(n):
        stop, rate = layout.stop + k * arrays.STOP, load(mem, dy + k)
        above = load(mem, at.state + k) >= load(mem, stop + arrays.HIGH)
        outward = blown & (choose(above, rate, -rate) > 1e-12)
        put_where(mem, stop + arrays.TOUCHING, outward, 0.0 * rate)


@internal
def strike(links: Links, shared: Shared, mem: FloatArray, at: At, layout: Layout, free: bool, sample: int) -> None:
    """Throw gimbals towards their stops: the blows that are due since the last sample."""
    for f in range(shared.faults.shape[0]):
        if shared.faults[f, 0] != arrays.CONTACT:
            continue
        k, fault = shared.faults[f, 1], layout.fault + f * arrays.FAULT
        begin, impulse = load(mem, fault + arrays.BEGIN), load(mem, fault + arrays.FIRST)
        due = (begin <= sample * shared.period) & (begin > (sample - 1) * shared.period)
        if not anywhere(due):
            continue
        impulse = choose(due, impulse, 0.0 * impulse)
        if free:
            response(links, mem, at, free, k, at.stages)
        push(mem, at, free, k, at.stages, impulse)
        if layout.stops != 0:
            _come_anew(links, mem, at, layout, free, due)


@internal
def _brake(links: Links, mem: FloatArray, at: At, layout: Layout, free: bool) -> None:
    """Stop locked gimbals by impulses at their joints: one that comes back within the step still moves away."""
    n, dy = at.n, at.stages
    for _ in range(100):
        settled = True
        for k in range(n):
            rate = load(mem, at.state + n + 3 + k)
            locked = load(mem, at.work + (k + 1) * arrays.WORK + arrays.LOCKED) > 0.5
            turning = locked & ((rate > 1e-12) | (rate < -1e-12))
            if not anywhere(turning):
                continue
            settled = False
            response(links, mem, at, free, k, dy)
            impulse = choose(turning, -rate / load(mem, dy + k), 0.0 * rate)
            push(mem, at, free, k, dy, impulse)
        if settled:
            return


@internal
def hold(links: Links, mem: FloatArray, at: At, layout: Layout, free: bool, begin: int, step: Number) -> bool:
    """Repeat a step from `begin` with those gimbals locked that lay at a stop and have gone past it.

    Leaves in LOCKED which ones; scenarios in which nothing presses keep the step as it was. Returns whether any does.
    """
    n = at.n
    zero = 0.0 * step
    pressed = zero
    for k in range(n):
        touching = load(mem, layout.stop + k * arrays.STOP + arrays.TOUCHING) > 0.5
        locked = choose(past_stop(mem, at, layout, k) & touching, zero + 1.0, zero)
        store(mem, at.work + (k + 1) * arrays.WORK + arrays.LOCKED, locked)
        pressed = greater(pressed, locked)
    if not anywhere(pressed > 0.5):
        return at.no
    for i in range(at.size):
        free_step = load(mem, at.state + i)
        store(mem, at.state + i, load(mem, begin + i))
        store(mem, begin + i, free_step)
    if free:  # else the momenta of locked joints mean nothing
        _brake(links, mem, at, layout, free)
    runge_kutta(links, mem, at, free, at.yes, step)
    if not free:
        end = at.surroundings + 2 * at.block
        derivative(links, mem, at, free, at.yes, at.no, at.state, end, at.stages)
        for k in range(n):
            body = at.work + (k + 1) * arrays.WORK
            locked = load(mem, body + arrays.LOCKED) > 0.5
            put_where(mem, at.state + n + 3 + k, locked, load(mem, body + arrays.MOMENT + 2))
    for i in range(at.size):
        put_where(mem, at.state + i, pressed < 0.5, load(mem, begin + i))
    return at.yes


@internal
def _put_back(links: Links, mem: FloatArray, at: At, layout: Layout, free: bool, hit: Mask) -> None:
    """Put gimbals past their stops back on them; the momenta of the joints and of the platform stay as they are."""
    n, end = at.n, at.surroundings + 2 * at.block
    before, after, root = layout.velocity + n, at.stages, at.work + arrays.MOMENT
    if free:
        joint_momenta(links, mem, at, end, before + 3)
        copy(mem, before, root, 3)
    for k in range(n):
        stop, q = layout.stop + k * arrays.STOP, load(mem, at.state + k)
        inside = lesser(greater(q, load(mem, stop + arrays.LOW)), load(mem, stop + arrays.HIGH))
        put_where(mem, at.state + k, hit, inside)
    if not free:  # the momenta are the state
        return
    joint_momenta(links, mem, at, end, after + 3)
    copy(mem, after, root, 3)
    at_rest(mem, at)
    for i in range(n + 3):
        store(mem, at.spare_block + i, load(mem, before + i) - load(mem, after + i))
    derivative(links, mem, at, free, at.no, at.yes, at.spare_state, at.spare_block, at.stages)
    for i in range(n, 2 * n + 3):
        put_where(mem, at.state + i, hit, load(mem, at.state + i) + load(mem, at.stages + i))


@internal
def meet_stops(
    links: Links,
    mem: FloatArray,
    at: At,
    layout: Layout,
    free: bool,
    held: bool,
    contacts: int,
    t: Number,
    step: Number,
) -> bool:
    """Put every gimbal that has gone past its stop back on it by an impact; return whether any lies on a stop.

    A gimbal that touched its stop a step before does not bounce again: bounces shorter than a step have died out. A
    gimbal that falls back within a few steps arrives no faster than it left: it is found late, and the speed gained
    meanwhile would keep it bouncing for ever. `contacts` are slots that count how often each gimbal came up against
    a stop; t is the end of the step.
    """
    n, dy = at.n, at.stages
    zero = 0.0 * load(mem, layout.alive)  # which is finite even where the state is not
    hit, lying = zero, zero
    for k in range(n):
        stop = layout.stop + k * arrays.STOP
        past = past_stop(mem, at, layout, k)
        touched = load(mem, stop + arrays.TOUCHING) > 0.5
        fresh = choose(past, choose(touched, zero, zero + 1.0), zero)
        add(mem, contacts + k, fresh * load(mem, layout.alive))
        touching = choose(past, zero + 1.0, zero)
        if held:
            touching = greater(touching, load(mem, at.work + (k + 1) * arrays.WORK + arrays.LOCKED))
        # 2: it has just come, and bounces.
        store(mem, stop + arrays.TOUCHING, touching + fresh)
        hit = choose(past, zero + 1.0, hit)
        lying = greater(lying, touching)
    if anywhere(hit > 0.5):
        _put_back(links, mem, at, layout, free, hit > 0.5)
        derivative(links, mem, at, free, at.no, at.no, at.state, at.surroundings + 2 * at.block, dy)
        copy(mem, layout.velocity, dy, n)
        # Impulses in turn until no gimbal that touches moves outwards; one pass does it for one contact.
        for _ in range(100):
            settled = True
            for k in range(n):
                stop = layout.stop + k * arrays.STOP
                rate, touching = load(mem, layout.velocity + k), load(mem, stop + arrays.TOUCHING)
                above = load(mem, at.state + k) >= load(mem, stop + arrays.HIGH)
                outward = choose(above, rate, -rate)
                struck = (hit > 0.5) & (touching > 0.5) & (outward > 1e-12)
                if not anywhere(struck):
                    continue
                settled = False
                response(links, mem, at, free, k, dy)
                away = load(mem, stop + arrays.AWAY)
                again = (away > 0.0) & (t - load(mem, stop + arrays.WHEN) < _SHORT * step)
                coming = choose(again, lesser(outward, away), outward)
                back = choose(touching > 1.5, load(mem, stop + arrays.RESTITUTION) * coming, zero)
                change = choose(above, -outward - back, outward + back)
                impulse = choose(struck, change / load(mem, dy + k), zero)
                for j in range(n):
                    add(mem, layout.velocity + j, impulse * load(mem, dy + j))
                push(mem, at, free, k, dy, impulse)
            if settled:
                break
    for k in range(n):
        stop = layout.stop + k * arrays.STOP
        rate = load(mem, layout.velocity + k)
        bounced = load(mem, stop + arrays.TOUCHING) > 1.5
        put_where(mem, stop + arrays.WHEN, bounced, t)
        put_where(mem, stop + arrays.AWAY, bounced, choose(rate < 0.0, -rate, rate))
        store(mem, stop + arrays.TOUCHING, lesser(load(mem, stop + arrays.TOUCHING), zero + 1.0))
    return anywhere(lying > 0.5)


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
            put_where(mem, z, bristles, deflection(mem, at, at.state, k, zero))
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
                add(mem, at.during + 1 + i * arrays.DURING + arrays.TURNS, impulse * load(mem, dy + i))
            put_where(mem, during + arrays.HAD, turning, given)
            put_where(mem, kept + arrays.SLIDING, turning, direction)
            put_where(mem, kept + arrays.HELD_BY, turning, -given)
        if settled:
            return
