"""Random numbers by counting: a sample depends on seed, run, step and channel alone, not on what was drawn before.

Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011), keyed by the seed, counts
(step, channel, run); normal numbers by Box and Muller (1958), two of them from one count.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import columns, inlined, internal, load, root, store
from platform_ctrl.simulation.kernel.functions import cosine_and_sine, logarithm

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
def uniforms(keys: Keys, mem: FloatArray, lane: int, step: int, channel: int, slot: int) -> None:
    """Two numbers between 0 and 1 into `slot` and the next."""
    first, last = columns(lane)
    c0, c1 = np.uint64(step) & _LOW, np.uint64(channel)
    for column in range(first, last):
        seed, run = keys[column, 0], keys[column, 1]
        a, b, c, d = philox(c0, c1, run & _LOW, run >> _HALF, seed & _LOW, seed >> _HALF)
        store(mem, slot, column, _between(a, b))
        store(mem, slot + 1, column, _between(c, d))


@internal
def normals(keys: Keys, mem: FloatArray, lane: int, step: int, channel: int, slot: int) -> None:
    """Two independent standard normal numbers into `slot` and the next."""
    uniforms(keys, mem, lane, step, channel, slot)
    size = root(-2.0 * logarithm(load(mem, slot, lane)))
    c, s = cosine_and_sine(_TURN * load(mem, slot + 1, lane))
    store(mem, slot, lane, size * c)
    store(mem, slot + 1, lane, size * s)
