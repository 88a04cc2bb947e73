"""The torquers between samples: limited rates, first-order lags, and what fails of their torque; random numbers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import LANES, Mask, Number, choose, greater, lesser, load, root, store, store_one
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine, logarithm, within
from platform_ctrl.simulation.kernel.arrays import At, Layout, Shared
from platform_ctrl.simulation.kernel.slots import add, copy, put, put_where


@inlined
def acts(mem: FloatArray, fault: int, t: Number) -> Mask:
    """Return whether the fault at a slot has begun at t and the part is not sound again."""
    return (load(mem, fault + arrays.BEGIN) <= t) & (load(mem, fault + arrays.UNTIL) > t)


@inlined
def within_reach(shared: Shared, mem: FloatArray, layout: Layout, i: int, torque: Number) -> Number:
    """A torquer's torque within its limit, and within what a motor's supply allows at the joint's rate."""
    slot = layout.torquer + i * arrays.TORQUER
    limit, stall = load(mem, slot + arrays.LIMIT), load(mem, slot + arrays.STALL)
    counter = load(mem, slot + arrays.BACK_EMF) * load(mem, layout.velocity + shared.targets[i])
    most, least = lesser(limit, stall - counter), greater(-limit, -stall - counter)
    return lesser(greater(torque, least), most)


@internal
def ready_torquers(shared: Shared, mem: FloatArray, layout: Layout) -> None:
    """Find how far the lags stay behind a torque that slews."""
    for i in range(shared.targets.shape[0]):
        for segment in range(2):
            slot = layout.torquer + i * arrays.TORQUER + segment
            decay = load(mem, slot + arrays.DECAY)
            zero = 0.0 * decay
            lagging = (decay > 0.0) & (decay < 1.0)
            behind = (decay - 1.0) / logarithm(choose(lagging, decay, zero + 0.5))
            store(mem, slot + arrays.BEHIND, choose(lagging, behind, choose(decay > 0.0, zero + 1.0, zero)))


@internal
def hold_equilibrium(shared: Shared, mem: FloatArray, at: At, layout: Layout) -> None:
    """Begin as if torquers had given the torque that holds the gimbals, within their limits, before t = 0."""
    nu = shared.targets.shape[0]
    for i in range(nu):
        slot = layout.torquer + i * arrays.TORQUER
        wanted = load(mem, slot + arrays.EQUILIBRIUM)
        torque = within(wanted, load(mem, slot + arrays.LIMIT))
        store(mem, layout.command + i, wanted)
        store(mem, slot + arrays.SLEWED, torque)
        store(mem, slot + arrays.TORQUE, torque)
        for k in range(layout.whole + 2):
            store(mem, layout.ring + k * nu + i, torque)
        m = i - nu + at.windings
        if m >= 0:
            winding = at.winding + m * arrays.WINDING
            current = torque / load(mem, winding)
            v = load(mem, winding + arrays.RESISTANCE) * current
            put(mem, at.state + at.currents + 3 * m, (current, v, v))


@inlined
def torquers_fail(shared: Shared) -> bool:
    """Whether any torquer of any scenario fails."""
    failing = False
    for f in range(shared.faults.shape[0]):
        failing = failing or arrays.TORQUER_WEAK <= shared.faults[f, 0] <= arrays.TORQUER_DEAD
    return failing


@inlined
def _toward(wanted: Number, here: Number, reach: Number) -> Number:
    return greater(lesser(wanted, here + reach), here - reach)


@internal
def new_torque(shared: Shared, mem: FloatArray, layout: Layout, segment: int, source: int, t: Number) -> None:
    """Set the torquers' targets from t on: the limited commands of sample `source`, with faults."""
    nu = shared.targets.shape[0]
    for i in range(nu):
        slot = layout.torquer + i * arrays.TORQUER
        fixed, level = 0.0 * t, 0.0 * t
        held = load(mem, layout.ring + source % (layout.whole + 2) * nu + i)
        torque = load(mem, slot + arrays.TORQUE)
        for f in range(shared.faults.shape[0]):
            kind = shared.faults[f, 0]
            if kind < arrays.TORQUER_WEAK or kind > arrays.TORQUER_DEAD or shared.faults[f, 1] != i:
                continue
            fault = layout.fault + f * arrays.FAULT
            on = acts(mem, fault, t)
            if kind == arrays.TORQUER_WEAK:
                held = choose(on, load(mem, fault + arrays.FIRST) * held, held)
                continue
            fixed = choose(on, 0.0 * t + 1.0, fixed)
            if kind == arrays.TORQUER_DEAD:
                level = choose(on, 0.0 * t, level)
            else:
                # SECOND: whether it is stuck already.
                fresh = on & (load(mem, fault + arrays.SECOND) < 0.5)
                put_where(mem, fault + arrays.STUCK, fresh, torque)
                put_where(mem, fault + arrays.SECOND, fresh, 0.0 * t + 1.0)
                level = choose(on, load(mem, fault + arrays.STUCK), level)
        sound = fixed < 0.5
        held = choose(sound, held, level)
        store(mem, slot + arrays.HELD, held)
        slewed = _toward(held, load(mem, slot + arrays.SLEWED), load(mem, slot + arrays.AT_ONCE))
        slewed = choose(sound, slewed, level)
        store(mem, slot + arrays.SLEWED, slewed)
        lagging = sound & (load(mem, slot + arrays.DECAY + segment) > 0.0)
        store(mem, slot + arrays.TORQUE, choose(lagging, torque, slewed))


@inlined
def put_torques(shared: Shared, mem: FloatArray, at: At, layout: Layout, row: int) -> None:
    """Put [M, Q] into block `row`."""
    T = at.surroundings + row * at.block
    copy(mem, T, layout.table + 3 * row, 3)
    pushed = layout.pushed + row * at.n - 3
    for i in range(3, at.n + 3):
        store(mem, T + i, load(mem, layout.steady + i) + load(mem, pushed + i))
    for i in range(shared.targets.shape[0]):
        slot = layout.torquer + i * arrays.TORQUER
        add(mem, T + shared.targets[i], load(mem, slot + arrays.PER_COMMAND) * load(mem, slot + arrays.TORQUE))
    for m in range(at.windings):
        slot = layout.torquer + (at.torquers - at.windings + m) * arrays.TORQUER
        store(mem, T + at.wanted + m, load(mem, slot + arrays.TORQUE))
    for j in range(at.modes):
        shape, total = at.mode + j * (at.shape + at.torquers) + at.shape, 0.0 * load(mem, T)
        for i in range(at.torquers):
            slot = layout.torquer + i * arrays.TORQUER
            # Modes deviate from how the structure is bent in equilibrium.
            torque = load(mem, slot + arrays.TORQUE) - load(mem, slot + arrays.EQUILIBRIUM)
            torque = load(mem, slot + arrays.PER_COMMAND) * torque
            first = shared.targets[i] >= 3
            for k in range(i):
                first = first and shared.targets[k] != shared.targets[i]
            if first:  # a torque from outside works where the first torquer of its gimbal does
                torque = torque + load(mem, pushed + shared.targets[i])
            total = total + load(mem, shape + i) * torque
        store(mem, T + at.block - at.modes + j, total)


@inlined
def work_on(shared: Shared, mem: FloatArray, layout: Layout, segment: int) -> None:
    """Advance the torquers by half a substep of the segment: a lag follows a torque that slews evenly exactly."""
    for i in range(shared.targets.shape[0]):
        slot = layout.torquer + i * arrays.TORQUER
        before = load(mem, slot + arrays.SLEWED)
        decay, behind = load(mem, slot + arrays.DECAY + segment), load(mem, slot + arrays.BEHIND + segment)
        after = _toward(load(mem, slot + arrays.HELD), before, load(mem, slot + arrays.SLEW + segment))
        store(mem, slot + arrays.SLEWED, after)
        torque = after + (load(mem, slot + arrays.TORQUE) - before) * decay - (after - before) * behind
        store(mem, slot + arrays.TORQUE, torque)


# What a count is used for: the upper half of its channel.
PICKOFF, LOSS, PHASE_OF_LINE = 0, 1 << 16, 2 << 16

_FIRST, _SECOND = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_KEY_FIRST, _KEY_SECOND = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
_FIVE, _SIX, _DIGITS = np.uint64(5), np.uint64(6), np.uint64(26)
_PER_53 = 2.0**-53
_TURN = 2.0 * math.pi

Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]
# (columns, 2): seed and run of each scenario.
Keys = NDArray[np.uint64]


@inlined
def philox(c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, k0: np.uint64, k1: np.uint64) -> Words:
    """Return four words of 32 bits for a counter of four and a key of two."""
    for _ in range(10):
        a, b = c0 * _FIRST, c2 * _SECOND
        c0, c1, c2, c3 = (b >> _HALF) ^ c1 ^ k0, b & _LOW, (a >> _HALF) ^ c3 ^ k1, a & _LOW
        k0, k1 = (k0 + _KEY_FIRST) & _LOW, (k1 + _KEY_SECOND) & _LOW
    return c0, c1, c2, c3


@inlined
def _between(high: np.uint64, low: np.uint64) -> float:
    """A number between 0 and 1, neither included, from 53 bits."""
    bits = ((high >> _FIVE) << _DIGITS) + (low >> _SIX)
    return (float(bits) + 0.5) * _PER_53


@internal
def uniforms(keys: Keys, mem: FloatArray, step: int, channel: int, slot: int) -> None:
    """Two numbers between 0 and 1 into `slot` and the next."""
    c0, c1 = np.uint64(step) & _LOW, np.uint64(channel)
    for column in range(LANES):
        seed, run = keys[column, 0], keys[column, 1]
        a, b, c, d = philox(c0, c1, run & _LOW, run >> _HALF, seed & _LOW, seed >> _HALF)
        store_one(mem, slot, column, _between(a, b))
        store_one(mem, slot + 1, column, _between(c, d))


@internal
def normals(keys: Keys, mem: FloatArray, step: int, channel: int, slot: int) -> None:
    """Two independent standard normal numbers into `slot` and the next."""
    uniforms(keys, mem, step, channel, slot)
    size = root(-2.0 * logarithm(load(mem, slot)))
    c, s = cosine_and_sine(_TURN * load(mem, slot + 1))
    store(mem, slot, size * c)
    store(mem, slot + 1, size * s)
