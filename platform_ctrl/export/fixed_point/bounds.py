"""Rigorous l1 norms of impulse responses: how large a signal can become for inputs and roundings of bounded size.

The responses are summed in floating point and everything that this leaves out is bounded: what rounding does to the
sums, by residuals that run through the system once more, and the tail, by a power of A enclosed in balls.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from platform_ctrl.analysis.certificates.intervals import Balls
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import UnscalableError
from platform_ctrl.export.c99.scheme import noise_of
from platform_ctrl.export.fixed_point.exact import ExactSystem

# Working precision of the balls; size of a power of A below which the rest of a response is bounded.
BITS = 256
_SMALL = 2.0**-30
# Longest response that is summed: 2 to the power of this many samples.
_LONGEST = 22
# Powers of A up to A^64 advance blocks of as many samples.
_BLOCK = 6
_UNIT = 2.0**-53
# Inflates what was computed from non-negative numbers with fewer than 10^5 roundings.
_UP = 1.0 + 1e-10
_TINY = 1e-290


class SlowError(Exception):
    """The response does not decay within the longest time that is summed."""


@value
class Enclosed:
    """A real matrix between `middle` − `radius` and `middle` + `radius`."""

    middle: FloatArray
    radius: FloatArray

    @property
    def size(self) -> FloatArray:
        """Upper bounds of the entries' magnitudes."""
        return (np.abs(self.middle) + self.radius) * _UP


def enclosed(matrix: Balls) -> Enclosed:
    """Return a matrix of balls as doubles with radii."""
    rows, columns = matrix.nrows(), matrix.ncols()
    middle, radius = np.zeros((rows, columns)), np.zeros((rows, columns))
    for i, row in enumerate(matrix.tolist()):
        for j, ball in enumerate(row):
            middle[i, j] = float(ball.mid())
            radius[i, j] = float(ball.rad())
    return Enclosed(middle=middle, radius=radius * _UP + 2.0 * _UNIT * np.abs(middle) + _TINY)


@value
class Gains:
    """Upper bounds of Σ|h| over all samples, from each input and from each state's own disturbance."""

    states: FloatArray  # (n, m): from the inputs to the states
    signals: FloatArray  # (p, m): from the inputs to the signals
    # noise_states, noise_signals: (n, n), (p, n): from what is added to a state's next value
    noise_states: FloatArray
    noise_signals: FloatArray
    samples: int  # Number of samples that were summed; the tail after them is bounded


def gains(A: Balls, B: Balls, C: Balls, D: Balls) -> Gains:
    """Return upper bounds of the l1 norms of x⁺ = A x + B u + v, y = C x + D u from u and v to x and y."""
    n, m = A.nrows(), B.ncols()
    direct = enclosed(D).size
    if n == 0:
        p = D.nrows()
        return Gains(
            states=np.zeros((0, m)),
            signals=direct,
            noise_states=np.zeros((0, 0)),
            noise_signals=np.zeros((p, 0)),
            samples=0,
        )
    powers, sums, last = _powers(A)
    b, c = enclosed(B), enclosed(C)
    # First the inputs' columns, then those of the disturbances.
    start = Enclosed(middle=np.hstack([b.middle, np.eye(n)]), radius=np.hstack([b.radius, np.zeros((n, n))]))
    x, y = _summed(powers, sums, last, c, start)
    samples = 2 ** (len(powers) - 1)
    # Σ_{k ≥ N} |A^k B| ≤ Σ_k |A^k| |A^N| |B|; the sum of the first N powers is the tighter one from here.
    tail = x[:, m:] @ _geometric(last) @ (last @ start.size) * _UP**2
    x = (x + tail) * _UP
    y = (y + c.size @ tail * _UP) * _UP
    return Gains(
        states=x[:, :m],
        signals=(y[:, :m] + direct) * _UP,
        noise_states=x[:, m:],
        noise_signals=y[:, m:],
        samples=samples,
    )


def _powers(A: Balls) -> tuple[list[Enclosed], FloatArray, FloatArray]:
    """Return A, A², A⁴, ... up to a small one, an upper bound of Σ|A^k| over all k, and one of the last power."""
    n = A.nrows()
    powers = [enclosed(A)]
    product, sums = A, np.eye(n)
    while True:
        size = powers[-1].size
        if n * size.max() < _SMALL:
            return powers, sums @ _geometric(size) * _UP, size
        if not np.all(np.isfinite(size)):
            raise UnscalableError(
                "fixed point: responses grow beyond 1e308; scale states and signals to similar sizes", product
            )
        if len(powers) > _LONGEST:
            raise SlowError
        # Σ_{k < 2N} |A^k| ≤ (I + |A^N|) Σ_{k < N} |A^k|.
        sums = (sums + size @ sums) * _UP
        product = product * product
        powers.append(enclosed(product))


def _geometric(size: FloatArray) -> FloatArray:
    """Return an upper bound of Σ|P|^j for a small |P|: |P| ≤ p J with J all ones, J² = n J."""
    n, largest = len(size), float(size.max())
    return np.asarray(np.eye(n) + largest / (1.0 - n * largest) * _UP, dtype=np.float64)


def _summed(
    powers: list[Enclosed], sums: FloatArray, last: FloatArray, c: Enclosed, start: Enclosed
) -> tuple[FloatArray, FloatArray]:
    """Return upper bounds of Σ|x_k| and Σ|C x_k| over the first 2^(len(powers) − 1) samples, x_0 the start.

    The last columns of the start are the identity.
    """
    n, columns = start.middle.shape
    gamma = 2.0 * (n + 4) * _UNIT
    residual = start.radius.copy()
    x = np.zeros((n, columns))
    y = np.zeros((len(c.middle), columns))

    def step(power: Enclosed, block: FloatArray) -> FloatArray:
        nonlocal residual
        size = np.abs(block).sum(axis=1)
        residual = residual + (gamma * power.size + power.radius) @ size * _UP + _TINY * block.shape[1]
        advanced = power.middle @ block.reshape(n, -1)
        return np.asarray(advanced.reshape(block.shape), dtype=np.float64)

    def count(block: FloatArray) -> None:
        nonlocal x, y
        x += np.abs(block).sum(axis=1)
        shown = (c.middle @ block.reshape(n, -1)).reshape(len(y), block.shape[1], columns)
        y += np.abs(shown).sum(axis=1)

    # (n, samples, columns); as many samples again with every power.
    block = start.middle.reshape(n, 1, columns)
    doublings = min(_BLOCK, len(powers) - 1)
    for power in powers[:doublings]:
        block = np.concatenate([block, step(power, block)], axis=1)
    count(block)
    for _ in range(2 ** (len(powers) - 1 - doublings) - 1):
        block = step(powers[doublings], block)
        count(block)
    inflated = 1.0 + 1e-8  # of sums over at most 2^22 samples
    # A bound of all powers from these sums is tighter than `sums`, and so is that of the residuals.
    closer = (x * inflated + sums @ residual)[:, columns - n :] @ _geometric(last) * _UP**2
    rest = closer @ residual * _UP**2
    y = (y * inflated + (gamma * c.size + c.radius) @ x * inflated + c.size @ rest) * _UP
    return (x * inflated + rest) * _UP, y


@value
class Responses:
    """Bounds of signals and states by the free sources and by disturbances of every row."""

    system: ExactSystem
    norms: Gains  # From the free sources and the states' disturbances
    # to_states, to_signals: (n, p), (p, p): Magnitudes with which the signals' disturbances enter the states and the
    # signals directly
    to_states: FloatArray
    to_signals: FloatArray

    def bounds(self, sizes: Mapping[str, float], noise: Mapping[str, float]) -> dict[str, float]:
        """Return upper bounds by signal and state.

        `sizes` are the largest magnitudes of the free sources, `noise` of what is added to signals and states;
        default 0.
        """
        free = np.array([sizes.get(name, 0.0) for name in self.system.free])
        added = np.array([noise.get(name, 0.0) for name in self.system.states])
        direct = np.array([noise.get(name, 0.0) for name in self.system.signals])
        inner = (added + self.to_states @ direct) * _UP
        states = (self.norms.states @ free + self.norms.noise_states @ inner) * _UP
        signals = (self.norms.signals @ free + self.norms.noise_signals @ inner + self.to_signals @ direct) * _UP
        return dict(zip((*self.system.states, *self.system.signals), map(float, (*states, *signals)), strict=True))


def responses(system: ExactSystem) -> Responses:
    """Return the norms of a system."""
    A, B, C, D = system.balls(system.free)
    _, to_states, _, to_signals = system.balls([noise_of(name) for name in system.signals])
    return Responses(
        system=system,
        norms=gains(A, B, C, D),
        to_states=enclosed(to_states).size,
        to_signals=enclosed(to_signals).size,
    )
