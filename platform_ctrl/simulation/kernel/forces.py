"""Forces on the bodies: force elements, motors of servo rotors, and the surroundings with all that moves them."""

from __future__ import annotations

import math

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import (
    LANES,
    Mask,
    Number,
    choose,
    greater,
    lesser,
    load,
    load_one,
    root,
    store,
    store_one,
)
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine, exponential, hyperbolic_tangent, within
from platform_ctrl.simulation.kernel.arrays import At, Layout, Links, Shared
from platform_ctrl.simulation.kernel.slots import add, add_vector, copy, put, put_where, vector
from platform_ctrl.simulation.kernel.vectors import Vector, cross, dot, minus, plus, scaled


@inlined
def _level(mem: FloatArray, joint: int, rate: Number) -> Number:
    """Level of dry friction at a rate: the Stribeck curve of its side."""
    back = rate < 0.0
    level = choose(back, load(mem, joint + arrays.COULOMB), load(mem, joint + arrays.COULOMB + 1))
    highest = choose(back, load(mem, joint + arrays.BREAKAWAY), load(mem, joint + arrays.BREAKAWAY + 1))
    sliding = rate * load(mem, joint + arrays.PER_STRIBECK_RATE)
    return level + (highest - level) * exponential(-sliding * sliding)


# Share of its largest deflection up to which an elasto-plastic bristle is elastic.
_ELASTIC = 0.85
# Below this argument (1 - exp(-x))/x is found by its series.
_SMALL = 1e-3


@inlined
def _plasticity(elastic: Mask, z: Number, most: Number, rate: Number) -> Number:
    """Share α of a bristle's rate that slides: 1, or of an elasto-plastic one what its deflection says."""
    z = choose(rate < 0.0, -z, z)
    u = lesser(greater((z / most - _ELASTIC) / (1.0 - _ELASTIC), 0.0 * z), 0.0 * z + 1.0)
    c, _ = cosine_and_sine(math.pi * u)
    return choose(elastic, 0.5 - 0.5 * c, 0.0 * z + 1.0)


@inlined
def _moved(alpha: Number, most: Number, ahead: Number, rate: Number, z: Number) -> Number:
    """Deflection of bristles after a time in which they turn at a rate, from ż = rate - alpha |rate|/most z."""
    x = alpha * greater(rate, -rate) / most * ahead
    decay = exponential(-x)
    large = x > _SMALL
    share = choose(large, (1.0 - decay) / choose(large, x, 0.0 * x + 1.0), 1.0 - x * (0.5 - x / 6.0))
    return z * decay + rate * ahead * share


@internal
def deflection(mem: FloatArray, at: At, y: int, k: int, rate: Number) -> Number:
    """Deflection of a joint's bristles at a moment of a step, which has had the mean rate until then.

    With that rate ż = v - λ z is solved exactly: λ = α σ0 |v|/level may be much faster than the step. `rate` is that at
    the begin, where there is no mean one.
    """
    joint, begun = at.joint + k * arrays.JOINT, at.during + 1 + k * arrays.DURING + arrays.BEGUN
    ahead, z = load(mem, at.during), load(mem, y + at.keeps + k * arrays.FRICTION + arrays.DEFLECTION)
    q, moving = load(mem, y + k), ahead > 0.0
    before = choose(moving, load(mem, begun), q)
    store(mem, begun, before)
    mean = choose(moving, (q - before) / choose(moving, ahead, 0.0 * q + 1.0), rate)
    elastic = load(mem, joint + arrays.LAW) > 0.5 * (arrays.BRISTLES + arrays.ELASTOPLASTIC)
    most = _level(mem, joint, mean) / load(mem, joint + arrays.BRISTLE)
    # How much slides by the deflection at the begin, then by that half-way.
    moved = _moved(_plasticity(elastic, z, most, mean), most, ahead, mean, z)
    return _moved(_plasticity(elastic, 0.5 * (z + moved), most, mean), most, ahead, mean, z)


@internal
def _bristle_torque(mem: FloatArray, at: At, y: int, k: int, rate: Number) -> Number:
    """Torque of a joint's bristles at a moment of a step."""
    joint = at.joint + k * arrays.JOINT
    stiffness, damping = load(mem, joint + arrays.BRISTLE), load(mem, joint + arrays.BRISTLE + 1)
    elastic = load(mem, joint + arrays.LAW) > 0.5 * (arrays.BRISTLES + arrays.ELASTOPLASTIC)
    z, most = deflection(mem, at, y, k, rate), _level(mem, joint, rate) / stiffness
    slips = _plasticity(elastic, z, most, rate) * greater(rate, -rate) / most * z
    return stiffness * z + damping * (rate - slips)


@inlined
def dry_torque(mem: FloatArray, at: At, y: int, k: int, rate: Number) -> Number:
    """Dry friction at joint k of a state, without its minus sign: see `platform_ctrl.plant.force_elements.Friction`."""
    joint = at.joint + k * arrays.JOINT
    law = load(mem, joint + arrays.LAW)
    torque = 0.0 * rate
    if at.dry & 1 << arrays.SMOOTH != 0:
        torque = _level(mem, joint, rate) * hyperbolic_tangent(rate * load(mem, joint + arrays.PER_COULOMB_RATE))
    if at.dry & 1 << arrays.STICKING != 0:
        kept = y + at.keeps + k * arrays.FRICTION
        side = load(mem, kept + arrays.SLIDING)
        sliding = side * _level(mem, joint, side * greater(rate, -rate))
        sliding = choose(side * side > 0.5, sliding, -load(mem, kept + arrays.HELD_BY))
        torque = choose((law > 0.5) & (law < 1.5), sliding, torque)
    if at.dry >= 1 << arrays.BRISTLES:
        torque = choose(law > 1.5, _bristle_torque(mem, at, y, k, rate), torque)
    return torque


@inlined
def stand_still(mem: FloatArray, at: At, y: int, dy: int) -> None:
    """Let the joints that stick keep their angles, and the frictions' states as they are until the step's end."""
    for k in range(at.n):
        kept = y + at.keeps + k * arrays.FRICTION
        side = load(mem, kept + arrays.SLIDING)
        law = load(mem, at.joint + k * arrays.JOINT + arrays.LAW)
        sticks = (law > 0.5) & (law < 1.5) & (side * side < 0.5)
        put_where(mem, dy + k, sticks, 0.0 * side)
        for i in range(arrays.FRICTION):
            store(mem, dy + at.keeps + k * arrays.FRICTION + i, 0.0 * side)


@internal
def free_rates(mem: FloatArray, at: At, locking: bool, y: int, dy: int) -> None:
    """Put the joints' rates of a state with a free root into `dy`, and zeros into the slots of their torques there."""
    for k in range(at.n):
        rate = load(mem, y + at.n + 3 + k)
        if locking:
            rate = rate * (1.0 - load(mem, at.work + (k + 1) * arrays.WORK + arrays.LOCKED))
        store(mem, dy + k, rate)
        store(mem, dy + at.n + 3 + k, 0.0 * rate)


@internal
def joint_torques(mem: FloatArray, at: At, bare: bool, y: int, around: int, dy: int) -> None:
    """Add to the joints' torques in `dy`, behind their rates, those from outside and, if not `bare`, of bearings."""
    for k in range(at.n):
        Q = load(mem, around + 3 + k)
        if at.joints != 0 and not bare:
            Q = Q + _bearing_torque(mem, at, y, k, load(mem, dy + k))
        add(mem, dy + at.n + 3 + k, Q)


@internal
def _bearing_torque(mem: FloatArray, at: At, y: int, k: int, rate: Number) -> Number:
    """Torque of springs, friction and a cage at joint k of a state."""
    joint, q = at.joint + k * arrays.JOINT, load(mem, y + k)
    Q = load(mem, joint + arrays.PRELOAD) - load(mem, joint + arrays.STIFFNESS) * q
    Q = Q - load(mem, joint + arrays.VISCOUS) * rate
    if at.dry != 0:
        Q = Q - dry_torque(mem, at, y, k, rate)
    if at.cages != 0:
        # No cage is one with infinite clearance.
        Q = Q - contact(mem, joint + arrays.CAGE, q - load(mem, joint + arrays.CAGE + 3), rate)
    return Q


@inlined
def contact(mem: FloatArray, slot: int, out: Number, rate: Number) -> Number:
    """Torque that deflects by `out` a spring with stiffness, damping and clearance at a slot: beyond it only pushes."""
    stiffness, clearance = load(mem, slot), load(mem, slot + 2)
    held = stiffness * out + load(mem, slot + 1) * rate
    above = greater(held - stiffness * clearance, 0.0 * rate)
    below = lesser(held + stiffness * clearance, 0.0 * rate)
    push = choose(out > clearance, above, choose(out < -clearance, below, 0.0 * rate))
    return choose(clearance > 0.0, push, held)


@inlined
def felt_by_root(mem: FloatArray, at: At, y: int, around: int) -> Vector:
    """Specific force of the root's origin: that of the surroundings, less gravity turned to root axes (Rodrigues)."""
    f = vector(mem, around + at.n + 6)
    if at.field != 0:
        g, e = vector(mem, at.gravity), y + 2 * at.n + 3
        w, v = 2.0 * load(mem, e), vector(mem, e + 1)
        t = cross(v, g)
        f = minus(plus(minus(f, g), scaled(w, t)), scaled(2.0, cross(v, t)))
    return f


@inlined
def missing_torque(mem: FloatArray, at: At, y: int, around: int, m: int) -> Number:
    """By how much the torque of a motor's current is more than the torque that is wanted of it."""
    current = load(mem, y + at.currents + 3 * m)
    return load(mem, at.winding + m * arrays.WINDING) * current - load(mem, around + at.wanted + m)


@inlined
def servo_momenta(links: Links, mem: FloatArray, at: At, y: int) -> None:
    """Add P s of the servo rotors to MOMENT of their carriers."""
    for r in range(at.servos):
        slot = at.work + links.servo_carrier[r] * arrays.WORK + arrays.MOMENT
        momentum = scaled(load(mem, y + 2 * at.n + 7 + r), vector(mem, at.servo + r * arrays.SERVO))
        add_vector(mem, slot, momentum)


@inlined
def servo_motor(links: Links, mem: FloatArray, at: At, y: int, r: int) -> tuple[Number, Number]:
    """Spin of a servo rotor against its carrier, whose rate the workspace holds, and the torque that its loop wants."""
    row, work = at.servo + r * arrays.SERVO, at.work + links.servo_carrier[r] * arrays.WORK
    p, x = load(mem, y + 2 * at.n + 7 + r), load(mem, y + 2 * at.n + 7 + at.servos + r)
    spin = p / load(mem, row + arrays.C) - dot(vector(mem, row), vector(mem, work + arrays.RATE))
    wanted = -load(mem, row + arrays.GAIN) * (spin - load(mem, row + arrays.SPIN))
    return spin, wanted - load(mem, row + arrays.INTEGRAL) * x


@inlined
def servo_drives(links: Links, mem: FloatArray, at: At, react: bool, y: int, dy: int) -> None:
    """Derivatives of the servo rotors' states; with `react` their motors' torques on the carriers' moments."""
    p, x = 2 * at.n + 7, 2 * at.n + 7 + at.servos
    for r in range(at.servos):
        row, work = at.servo + r * arrays.SERVO, at.work + links.servo_carrier[r] * arrays.WORK
        spin, wanted = servo_motor(links, mem, at, y, r)
        error, limit = spin - load(mem, row + arrays.SPIN), load(mem, row + arrays.TORQUE_LIMIT)
        torque = within(wanted, limit)
        further = ((wanted >= limit) & (error < 0.0)) | ((wanted <= -limit) & (error > 0.0))
        store(mem, dy + p + r, torque)
        store(mem, dy + x + r, choose(further, 0.0 * error, error))
        if react:
            add_vector(mem, work + arrays.MOMENT, scaled(torque, vector(mem, row)))


@inlined
def unbalance_moments(mem: FloatArray, at: At) -> None:
    """Add the unbalances' moments on the carriers to MOMENT, with the sign of what has to be held."""
    for b in range(at.n + 1):
        slot = at.work + b * arrays.WORK
        unbalance = vector(mem, at.body + b * arrays.BODY + arrays.UNBALANCE)
        add_vector(mem, slot + arrays.MOMENT, cross(unbalance, vector(mem, slot + arrays.FORCE)))


@inlined
def erection_torques(links: Links, mem: FloatArray, at: At, dy: int) -> None:
    """Add the erecting devices' torques to the joints' in `dy`."""
    f = vector(mem, at.work + arrays.FORCE)
    size = root(dot(f, f))
    scale = choose(size > 0.0, 1.0 / size, 0.0 * size)
    for e in range(links.erection.shape[0]):
        row, slot = at.erection + e * arrays.ERECTION, at.work + links.erection[e, 1] * arrays.WORK + arrays.FORCE
        Q = load(mem, row + arrays.ERECTION_GAIN) * dot(vector(mem, row), vector(mem, slot)) * scale
        add(mem, dy + links.erection[e, 0], within(Q, load(mem, row + arrays.ERECTION_LIMIT)))


@inlined
def _look_up(shared: Shared, mem: FloatArray, t: int, scale: int, result: int) -> None:
    """The time table at the times in slot `t`, a slot each column: one scenario after the other, each has its piece."""
    knots, pieces = shared.knots, shared.pieces
    for column in range(LANES):
        time = min(max(load_one(mem, t, column), knots[0]), knots[-1])
        low, high = 0, pieces.shape[0] - 1
        while low < high:
            middle = (low + high + 1) // 2
            if knots[middle] <= time:
                low = middle
            else:
                high = middle - 1
        s = time - knots[low]
        for i in range(pieces.shape[1]):
            c = pieces[low, i]
            number = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
            store_one(mem, result + i, column, (load_one(mem, scale, column) if i < 3 else 1.0) * number)


@inlined
def _risen(t: Number, rise: Number) -> Number:
    """How much is there at t of what rises as a half-cosine from t = 0 on, at once where `rise` is 0."""
    slow, zero = rise > 0.0, 0.0 * t
    part = lesser(greater(t / choose(slow, rise, zero + 1.0), zero), zero + 1.0)
    part = choose(slow, part, choose(t >= 0.0, zero + 1.0, zero))
    c, _ = cosine_and_sine(math.pi * part)
    return 0.5 - 0.5 * c


@inlined
def _shares(shared: Shared, mem: FloatArray, layout: Layout, t: Number) -> None:
    """How much of their speed the failing rotors have at t; LAST_SHARE takes what SHARE was."""
    for r in range(shared.rotors.shape[0]):
        slot = layout.rotor + r * arrays.ROTOR
        store(mem, slot + arrays.LAST_SHARE, load(mem, slot + arrays.SHARE))
        store(mem, slot + arrays.SHARE, 0.0 * t + 1.0)
    for f in range(shared.faults.shape[0]):
        kind = shared.faults[f, 0]
        if kind > arrays.RIPPLE:
            continue
        row, slot = layout.fault + f * arrays.FAULT, layout.rotor + shared.faults[f, 1] * arrays.ROTOR + arrays.SHARE
        begin, until = load(mem, row + arrays.BEGIN), load(mem, row + arrays.UNTIL)
        a, b = load(mem, row + arrays.FIRST), load(mem, row + arrays.SECOND)
        begun = t >= begin
        since = choose(begun, t - begin, 0.0 * t)
        if kind == arrays.RIPPLE:
            _, s = cosine_and_sine(b * since)
            share = choose(begun & (t < until), 1.0 + a * s, 0.0 * t + 1.0)
        else:
            left = (1.0 - a) * exponential(-since / b)
            before, after = (a, 1.0 - left) if kind == arrays.RUN_UP else (0.0 * a + 1.0, a + left)
            share = choose(begun, after, before)
        store(mem, slot, load(mem, slot) * share)


@internal
def follow_rotors(shared: Shared, mem: FloatArray, at: At, layout: Layout, t: Number, step: Number) -> None:
    """Fill all three blocks with the rotors' momenta during the step that ends at t.

    They change linearly during a step: the carriers then get from the motors exactly the momentum that the rotors lose,
    wherever a fault begins or ends.
    """
    n = at.n
    _shares(shared, mem, layout, t)
    first, block = at.surroundings + n + 9, at.block
    copy(mem, first + 2 * block, layout.steady + n + 9, 3 * (n + 1))
    for r in range(shared.rotors.shape[0]):
        rotor, body, servo = layout.rotor + r * arrays.ROTOR, shared.rotors[r, 0], shared.rotors[r, 1]
        share = load(mem, rotor + arrays.SHARE)
        if servo >= 0:
            mean = 0.5 * (load(mem, rotor + arrays.LAST_SHARE) + share)
            store(mem, at.servo + servo * arrays.SERVO + arrays.SPIN, mean * load(mem, rotor))
            continue
        add_vector(mem, first + 2 * block + 3 * body, scaled(share - 1.0, vector(mem, rotor)))
    for i in range(3 * (n + 1)):
        before, after = load(mem, first + i), load(mem, first + 2 * block + i)
        store(mem, first + block + i, 0.5 * (before + after))
        rate = (after - before) / step
        for row in range(3):
            store(mem, first + row * block + 3 * (n + 1) + i, rate)


@internal
def begin_surroundings(shared: Shared, mem: FloatArray, at: At, layout: Layout) -> None:
    """Fill all three blocks with what does not change."""
    for row in range(3):
        copy(mem, at.surroundings + row * at.block, layout.steady, at.block)
        copy(mem, layout.table + 3 * row, layout.steady, 3)


@internal
def hand_on(shared: Shared, mem: FloatArray, at: At, layout: Layout, free: bool) -> None:
    """Make the surroundings at the end of a step those at the start of the next."""
    n, block = at.n, at.surroundings
    end = block + 2 * at.block
    if not free:
        copy(mem, block + n + 3, end + n + 3, 3)
    if shared.lines.shape[0] > 0:
        copy(mem, block + n + 6, end + n + 6, 3)
    copy(mem, layout.pushed, layout.pushed + 2 * n, n)
    if at.course != 0:
        copy(mem, block + n + 9, end + n + 9, 3 * n + 3)
    copy(mem, layout.table, layout.table + 6, 3)


@internal
def surround(
    shared: Shared,
    mem: FloatArray,
    at: At,
    layout: Layout,
    free: bool,
    row: int,
    segment: int,
    turning: bool,
    t: Number,
) -> None:
    """Fill block `row` with what acts at t; with `turning`, vibrations go on by half a substep of the segment."""
    n, block = at.n, at.surroundings + row * at.block
    zero = 0.0 * t
    Omega, force = block + n + 3, block + n + 6
    if not free:
        share = zero
        if layout.profile != 0:
            rise, hold = load(mem, layout.rate + arrays.RISE), load(mem, layout.rate + arrays.HOLD)
            share = _risen(lesser(t, 2.0 * rise + hold - t), rise)
        put(mem, Omega, scaled(share, vector(mem, layout.rate)))
    for i in range(n):
        store(mem, layout.pushed + row * n + i, zero)
    if shared.pieces.shape[0] > 0:
        store(mem, layout.random, t)
        _look_up(shared, mem, layout.random, layout.rate + arrays.SCALE, layout.random + 1)
        for i in range(3):
            value = load(mem, layout.random + 1 + i)
            if free:
                store(mem, layout.table + 3 * row + i, load(mem, layout.steady + i) + value)
            else:
                add(mem, Omega + i, value)
        for i in range(3, shared.pieces.shape[1]):
            store(mem, layout.pushed + row * n + i - 3, load(mem, layout.random + 1 + i))
    if shared.lines.shape[0] > 0:
        copy(mem, force, layout.steady + n + 6, 3)
        there = zero + 1.0
        if layout.fade != 0:
            there = _risen(t, load(mem, layout.rate + arrays.FADE))
        for j in range(shared.lines.shape[0]):
            slot = layout.line + j * arrays.LINE
            c, s = load(mem, slot + arrays.PHASE), load(mem, slot + arrays.PHASE + 1)
            if turning:
                turn = slot + arrays.TURN + 2 * segment
                c_turn, s_turn = load(mem, turn), load(mem, turn + 1)
                c, s = c * c_turn - s * s_turn, s * c_turn + c * s_turn
                store(mem, slot + arrays.PHASE, c)
                store(mem, slot + arrays.PHASE + 1, s)
            component = shared.lines[j] % (n + 6)
            if component >= 3 or not free:
                target = Omega + component  # the slots of the specific force follow those of Omega
                if component >= 6:
                    target = layout.pushed + row * n + component - 6
                add(mem, target, there * load(mem, slot + arrays.AMPLITUDE) * c)
