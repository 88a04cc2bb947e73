"""What acts on the plant besides the torquers at an instant: motion of the base, torques on gimbals, rotors' speeds."""

from __future__ import annotations

import math

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import Number, choose, columns, greater, lesser, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine, exponential
from platform_ctrl.simulation.kernel.arrays import At, Layout, Shared


@inlined
def _look_up(shared: Shared, mem: FloatArray, lane: int, t: int, scale: int, result: int) -> None:
    """The time table at the times in slot `t`, into three slots: one scenario after the other, each has its piece."""
    first, last = columns(lane)
    knots, pieces = shared.knots, shared.pieces
    for column in range(first, last):
        time = min(max(load(mem, t, column), knots[0]), knots[-1])
        low, high = 0, pieces.shape[0] - 1
        while low < high:
            middle = (low + high + 1) // 2
            if knots[middle] <= time:
                low = middle
            else:
                high = middle - 1
        s = time - knots[low]
        for i in range(3):
            c = pieces[low, i]
            number = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
            store(mem, result + i, column, load(mem, scale, column) * number)


@inlined
def _half_cosine(mem: FloatArray, lane: int, layout: Layout, t: Number) -> Number:
    """How much of the half-cosine's rate is there."""
    rise, hold = load(mem, layout.rate + arrays.RISE, lane), load(mem, layout.rate + arrays.HOLD, lane)
    zero = 0.0 * t
    inside = lesser(t, 2.0 * rise + hold - t)
    slow = rise > 0.0
    part = lesser(greater(inside / choose(slow, rise, zero + 1.0), zero), zero + 1.0)
    part = choose(slow, part, choose(inside >= 0.0, zero + 1.0, zero))
    c, _ = cosine_and_sine(math.pi * part)
    return 0.5 - 0.5 * c


@inlined
def _faded(mem: FloatArray, lane: int, layout: Layout, t: Number) -> Number:
    """How much of the vibrations and sines is there."""
    fade, zero = load(mem, layout.rate + arrays.FADE, lane), 0.0 * t
    slow = fade > 0.0
    part = choose(slow, lesser(t / choose(slow, fade, zero + 1.0), zero + 1.0), zero + 1.0)
    c, _ = cosine_and_sine(math.pi * part)
    return 0.5 - 0.5 * c


@inlined
def _shares(shared: Shared, mem: FloatArray, lane: int, layout: Layout, t: Number) -> None:
    """How much of their speed the failing rotors have at t; LAST_SHARE takes what SHARE was."""
    for r in range(shared.rotors.shape[0]):
        slot = layout.rotor + r * arrays.ROTOR
        store(mem, slot + arrays.LAST_SHARE, lane, load(mem, slot + arrays.SHARE, lane))
        store(mem, slot + arrays.SHARE, lane, 0.0 * t + 1.0)
    for f in range(shared.faults.shape[0]):
        kind = shared.faults[f, 0]
        if kind > arrays.RIPPLE:
            continue
        row, slot = layout.fault + f * arrays.FAULT, layout.rotor + shared.faults[f, 1] * arrays.ROTOR + arrays.SHARE
        begin, until = load(mem, row + arrays.BEGIN, lane), load(mem, row + arrays.UNTIL, lane)
        a, b = load(mem, row + arrays.FIRST, lane), load(mem, row + arrays.SECOND, lane)
        begun = t >= begin
        since = choose(begun, t - begin, 0.0 * t)
        if kind == arrays.RIPPLE:
            _, s = cosine_and_sine(b * since)
            share = choose(begun & (t < until), 1.0 + a * s, 0.0 * t + 1.0)
        else:
            left = (1.0 - a) * exponential(-since / b)
            before, after = (a, 1.0 - left) if kind == arrays.RUN_UP else (0.0 * a + 1.0, a + left)
            share = choose(begun, after, before)
        store(mem, slot, lane, load(mem, slot, lane) * share)


@internal
def follow_rotors(shared: Shared, mem: FloatArray, lane: int, at: At, layout: Layout, t: Number, step: Number) -> None:
    """Fill all three blocks with the rotors' momenta during the step that ends at t.

    They change evenly during a step: what the motors hand to the carriers is then exactly what the rotors lose,
    wherever a fault begins or ends.
    """
    n = at.n
    _shares(shared, mem, lane, layout, t)
    first, block = at.surroundings + n + 9, at.block
    for i in range(3 * (n + 1)):
        store(mem, first + 2 * block + i, lane, load(mem, layout.steady + n + 9 + i, lane))
    for r in range(shared.rotors.shape[0]):
        rotor, body, servo = layout.rotor + r * arrays.ROTOR, shared.rotors[r, 0], shared.rotors[r, 1]
        share = load(mem, rotor + arrays.SHARE, lane)
        if servo >= 0:
            mean = 0.5 * (load(mem, rotor + arrays.LAST_SHARE, lane) + share)
            store(mem, at.servo + servo * arrays.SERVO + arrays.SPIN, lane, mean * load(mem, rotor, lane))
            continue
        for i in range(3):
            h = first + 2 * block + 3 * body + i
            store(mem, h, lane, load(mem, h, lane) + (share - 1.0) * load(mem, rotor + i, lane))
    for i in range(3 * (n + 1)):
        before, after = load(mem, first + i, lane), load(mem, first + 2 * block + i, lane)
        store(mem, first + block + i, lane, 0.5 * (before + after))
        rate = (after - before) / step
        for row in range(3):
            store(mem, first + row * block + 3 * (n + 1) + i, lane, rate)


@internal
def begin_surroundings(shared: Shared, mem: FloatArray, lane: int, at: At, layout: Layout) -> None:
    """Fill all three blocks with what does not change."""
    for row in range(3):
        for i in range(at.block):
            store(mem, at.surroundings + row * at.block + i, lane, load(mem, layout.steady + i, lane))
        for i in range(3):
            store(mem, layout.table + 3 * row + i, lane, load(mem, layout.steady + i, lane))


@internal
def hand_on(shared: Shared, mem: FloatArray, lane: int, at: At, layout: Layout, free: bool) -> None:
    """Make the surroundings at the end of a step those at the start of the next."""
    n, block = at.n, at.surroundings
    end = block + 2 * at.block
    if not free:
        for i in range(n + 3, n + 6):
            store(mem, block + i, lane, load(mem, end + i, lane))
    if shared.lines.shape[0] > 0:
        for i in range(n + 6, n + 9):
            store(mem, block + i, lane, load(mem, end + i, lane))
        for i in range(n):
            store(mem, layout.pushed + i, lane, load(mem, layout.pushed + 2 * n + i, lane))
    if at.course != 0:
        for i in range(n + 9, 4 * n + 12):
            store(mem, block + i, lane, load(mem, end + i, lane))
    for i in range(3):
        store(mem, layout.table + i, lane, load(mem, layout.table + 6 + i, lane))


@internal
def surround(
    shared: Shared,
    mem: FloatArray,
    lane: int,
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
        if layout.profile != 0:
            share = _half_cosine(mem, lane, layout, t)
            for i in range(3):
                store(mem, Omega + i, lane, share * load(mem, layout.rate + i, lane))
        else:
            for i in range(3):
                store(mem, Omega + i, lane, zero)
    if shared.pieces.shape[0] > 0:
        store(mem, layout.random, lane, t)
        _look_up(shared, mem, lane, layout.random, layout.rate + arrays.SCALE, layout.random + 1)
        for i in range(3):
            value = load(mem, layout.random + 1 + i, lane)
            if free:
                store(mem, layout.table + 3 * row + i, lane, load(mem, layout.steady + i, lane) + value)
            else:
                store(mem, Omega + i, lane, load(mem, Omega + i, lane) + value)
    if shared.lines.shape[0] > 0:
        for i in range(3):
            store(mem, force + i, lane, load(mem, layout.steady + n + 6 + i, lane))
        for i in range(n):
            store(mem, layout.pushed + row * n + i, lane, zero)
        there = zero + 1.0
        if layout.fade != 0:
            there = _faded(mem, lane, layout, t)
        for j in range(shared.lines.shape[0]):
            slot = layout.line + j * arrays.LINE
            c, s = load(mem, slot + arrays.PHASE, lane), load(mem, slot + arrays.PHASE + 1, lane)
            if turning:
                turn = slot + arrays.TURN + 2 * segment
                c_turn, s_turn = load(mem, turn, lane), load(mem, turn + 1, lane)
                c, s = c * c_turn - s * s_turn, s * c_turn + c * s_turn
                store(mem, slot + arrays.PHASE, lane, c)
                store(mem, slot + arrays.PHASE + 1, lane, s)
            component = shared.lines[j] % (n + 6)
            if component >= 3 or not free:
                target = Omega + component  # the slots of the specific force follow those of Omega
                if component >= 6:
                    target = layout.pushed + row * n + component - 6
                store(mem, target, lane, load(mem, target, lane) + there * load(mem, slot + arrays.AMPLITUDE, lane) * c)
