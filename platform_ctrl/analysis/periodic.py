"""Loops whose controllers are not all computed at every sample: linear and periodic, over a cycle of N samples.

With the inputs and outputs of the samples of a cycle stacked (lifting) a periodic system is time-invariant, and its
norm is the largest ratio of the energies of the periodic one (Khargonekar, Poolla and Tannenbaum, IEEE Trans. Automatic
Control 30, 1985). A channel's disk margin is that against perturbations that may change with time. Of a loop that does
not, it is the usual one: its norm is the same with and without lifting.

The stacked matrices grow with N². Here they are not formed: for a level γ each sample is a step of state and costate,
the steps are joined two by two, and those of samples that are alike by powers of two (`CostateStep`). The step of the
cycle is that of a system with as many states as the loop has, whose norm is below one exactly where that of the loop
over the cycle is below γ. Few states count at each sample: of a reading that is late only what is going to be used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import groupby, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis import poles as pole
from platform_ctrl.analysis.margins import DiskMargin, no_margin
from platform_ctrl.analysis.norms import hinf_norm
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import factor
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System, state_scaling
from platform_ctrl.common.values import FloatArray

BoolArray = NDArray[np.bool_]

# ln of the largest norm that is looked for, and of the inverse of the least.
_BEYOND = 50.0
# Relative error of a norm; what is returned is its upper end.
_TOLERANCE = 2e-9
# Cycles are doubled so often at most; a transition below this in balanced states leaves nothing.
_DOUBLINGS, _FORGOTTEN = 60, 1e-9
# Inputs of a stacked system up to which its gain is computed frequency by frequency, for a figure.
_MOST_STACKED = 64


class PeriodExceedsLevel(Exception):
    """Within a single period z is larger than the level allows: the level lies below the norm."""


class CostateStep(NamedTuple):
    """What a stretch of time does to the state v and the costate λ of ∫ z'z − w'w: v₁ = A v₀ + G λ₁, λ₀ = Q v₀ + A' λ₁.

    G and Q are positive semidefinite: w reaches G^(1/2), and Q^(1/2) v₀ is what the worst w makes of v₀.
    """

    A: FloatArray
    G: FloatArray
    Q: FloatArray


def joined(first: CostateStep, second: CostateStep) -> CostateStep:
    """Return one step after the other; `PeriodExceedsLevel` where the two together reach more than the level."""
    # The eigenvalues of G Q are those of the symmetric B' Q B with G = B B'.
    B = factor(first.G)
    gain = _symmetric(B.T @ second.Q @ B)
    if gain.size and not np.linalg.eigvalsh(gain)[-1] < 1.0:
        raise PeriodExceedsLevel
    # (I − G Q)⁻¹ = I + B (I − B' Q B)⁻¹ B' Q: the symmetric core keeps G and Q of the whole positive.
    core = np.linalg.inv(np.eye(len(gain)) - gain)
    seen = second.Q @ B
    middle, G, Q = np.eye(len(first.A)) + B @ core @ seen.T, B @ core @ B.T, second.Q + seen @ core @ seen.T
    G, Q = second.G + second.A @ G @ second.A.T, first.Q + first.A.T @ Q @ first.A
    return CostateStep(second.A @ middle @ first.A, _symmetric(G), _symmetric(Q))


def _symmetric(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))


def lifted(systems: Sequence[System]) -> System:
    """Return N systems that take turns, sample by sample, as one of N samples: their inputs and outputs are stacked."""
    N, n, (p, m) = len(systems), systems[0].A.shape[1], systems[0].D.shape
    state, driven = np.eye(n), np.zeros((n, N * m))
    C, D = np.zeros((N * p, n)), np.zeros((N * p, N * m))
    for k, one in enumerate(systems):
        rows, columns = slice(k * p, (k + 1) * p), slice(k * m, (k + 1) * m)
        C[rows], D[rows] = one.C @ state, one.C @ driven
        D[rows, columns] += one.D
        state, driven = one.A @ state, one.A @ driven
        driven[:, columns] += one.B
    return System(state, driven, C, D, N * systems[0].dt)


def transition(systems: Sequence[System]) -> FloatArray:
    """Return the states (n, n) after the samples of a cycle, of those before."""
    out = np.eye(systems[0].A.shape[1])
    for one, count in _runs(systems):
        out = (one.A if count == 1 else np.linalg.matrix_power(one.A, count)) @ out
    return out


def periodic_norm(systems: Sequence[System], tolerance: float = _TOLERANCE) -> float:
    """Return the norm of systems that take turns and are stable together, as of `lifted`.

    It is not below the true one, nor above by more than `tolerance`, relative.
    """
    parts = _runs(systems)
    direct = max((float(np.linalg.norm(one.D, 2)) for one, _ in parts if one.D.size), default=0.0)
    high, step = math.log(2.0 * direct) if direct > 0.0 else 0.0, 0.5
    while not _is_below(parts, high):
        high, step = high + step, 2.0 * step
        if high > _BEYOND:
            return math.inf
    low, step, floor = high, 0.5, math.log(direct) if direct > 0.0 else -_BEYOND
    while low > floor and _is_below(parts, low):
        high, low, step = low, max(low - step, floor), 2.0 * step
    if direct == 0.0 and low <= floor:
        return 0.0
    while high - low > tolerance:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _is_below(parts, middle) else (middle, high)
    return math.exp(high)


def _worst_frequency(systems: Sequence[System], norm: float) -> float:
    """Return the frequency, rad/s, at most that of half a cycle, at which the norm is reached."""
    if not 0.0 < norm < math.inf:
        return 0.0
    A, G, Q = _over_a_cycle(_runs(systems), norm)
    B, C = factor(G), factor(Q).T
    whole = System(A, B, C, np.zeros((len(C), B.shape[1])), len(systems) * systems[0].dt)
    return hinf_norm(whole, allow_unstable=True)[1]


def _is_below(parts: Sequence[tuple[System, int]], log_level: float) -> bool:
    """Return whether the norm is below a level: cycle after cycle the state is forgotten, whatever the input."""
    try:
        step = _over_a_cycle(parts, math.exp(log_level))
        for _ in range(_DOUBLINGS):
            size = np.abs(step.A).max(initial=0.0)
            if not size > _FORGOTTEN:
                return not np.isnan(size)
            step = joined(step, step)
    except (PeriodExceedsLevel, np.linalg.LinAlgError):
        return False
    return False


def _runs(systems: Sequence[System]) -> list[tuple[System, int]]:
    """Return systems that are the same object one sample after the other, each once with their number."""
    return [(alike[0], len(alike)) for alike in (list(group) for _, group in groupby(systems, id))]


def _over_a_cycle(parts: Sequence[tuple[System, int]], level: float) -> CostateStep:
    """Return the step of all samples; `PeriodExceedsLevel` where the cycle by itself reaches more than the level."""
    whole: CostateStep | None = None
    for one, count in parts:
        power = _one_sample(one, level)
        while count:
            if count % 2:
                whole = power if whole is None else joined(whole, power)
            count //= 2
            power = joined(power, power) if count else power
    assert whole is not None
    return whole


def _one_sample(system: System, level: float) -> CostateStep:
    """Return the step of one sample: the worst input follows from the state before and the costate behind it."""
    A, B, C, D = system.A, system.B / math.sqrt(level), system.C / math.sqrt(level), system.D / level
    if D.size and np.linalg.norm(D, 2) >= 1.0:
        raise PeriodExceedsLevel
    inverse, seen = np.linalg.inv(np.eye(D.shape[1]) - D.T @ D), D.T @ C
    into = B @ inverse
    return CostateStep(A + into @ seen, into @ B.T, C.T @ C + seen.T @ inverse @ seen)


def balanced(systems: Sequence[System]) -> list[System]:
    """Return systems of the same states in balanced ones, those that are the same object still so."""
    own = {id(one): one for one in systems}.values()
    s = state_scaling(*(np.array([one[k] for one in own]) for k in range(3)))
    return _each(systems, lambda one: one._replace(A=one.A * s / s[:, None], B=one.B / s[:, None], C=one.C * s))


def _each(systems: Sequence[System], function: Callable[[System], System]) -> list[System]:
    """Return a function of each system, the same objects of the same ones."""
    made = {key: function(one) for key, one in {id(one): one for one in systems}.items()}
    return [made[id(one)] for one in systems]


def pruned(systems: Sequence[System]) -> list[System]:
    """Return systems without the states at each sample that no output depends on and that are over by themselves.

    Of a reading that is late these are the samples that are not going to be read. Matrices A (n', n) need not be
    square; systems that are equal are the same object.
    """
    links = {id(one): one.A != 0.0 for one in systems}
    seen = [(one.C != 0.0).any(axis=0) for one in systems]
    live = _live(systems, links, seen)
    while (rest := _lasting(systems, links, live)).any():
        # These go on from cycle to cycle: a part of the loop, whether an output shows it or not.
        seen[0] = seen[0] | rest
        live = _live(systems, links, seen)
    if all(one.all() for one in live):
        return list(systems)
    made: dict[tuple[bytes, ...], System] = {}
    out = []
    for k, (one, now) in enumerate(zip(systems, live, strict=True)):
        after = live[(k + 1) % len(live)]
        own = one._replace(A=one.A[np.ix_(after, now)], B=one.B[after], C=one.C[:, now])
        key = (str(own.A.shape).encode(), *(matrix.tobytes() for matrix in (own.A, own.B, own.C, own.D)))
        out.append(made.setdefault(key, own))
    return out


def _live(systems: Sequence[System], links: dict[int, BoolArray], seen: Sequence[BoolArray]) -> list[BoolArray]:
    """Return for each sample the states (n,) on which what is `seen` then or later depends."""
    live = [one.copy() for one in seen]
    changed = True
    while changed:
        changed = False
        for k in reversed(range(len(live))):
            wider = live[k] | links[id(systems[k])][live[(k + 1) % len(live)]].any(axis=0)
            changed = changed or not np.array_equal(wider, live[k])
            live[k] = wider
    return live


def _lasting(systems: Sequence[System], links: dict[int, BoolArray], live: Sequence[BoolArray]) -> BoolArray:
    """Return the states (n,) at the first sample that are not live and that follow from such states for ever."""
    left = ~live[0]
    while left.any():
        before = left
        for k, one in enumerate(systems):
            left = links[id(one)][:, left].any(axis=1) & ~live[(k + 1) % len(live)]
        if np.array_equal(left, before):
            break
    return left


class PeriodicLoop:
    """A sampled plant closed by a controller whose matrices take turns: u = K y, `at` and `seen` what it uses of it.

    All repeats after `period`, s; `poles` (n,) are those of the transition `A` (n, n) over it, in z. `systems` are the
    loop by sample, from disturbances of the torques, then noise of what is measured, to the torques.
    """

    def __init__(self, plant: System, by_sample: Sequence[System], at: Sequence[int], seen: Sequence[int]) -> None:
        m = len(at)
        own = plant.part(seen, at)
        loops = _each(by_sample, own.feedback)
        self.systems = pruned(balanced(_each(loops, lambda one: one.part(slice(m), slice(None)))))
        self.samples, self.channels = len(by_sample), m
        self.period = self.samples * plant.dt
        self.A = transition(loops)
        # Without the equilibria that no sensor sees at any sample.
        n = len(self.A)
        rows = np.vstack(
            [row for one in {id(one): one for one in loops}.values() for row in (one.A - np.eye(n), one.C[m:])]
        )
        self.drift = pole.unseen_equilibria(
            System(self.A, np.zeros((n, 0)), rows, np.zeros((len(rows), 0)), self.period)
        )
        self.poles: ComplexArray = pole.poles(self.drift.system.A)

    def _disk(self, outputs: Sequence[int], inputs: Sequence[int]) -> list[System]:
        """Return S − I/2 from some channels' torques to others', by sample; the same matrices are the same object."""
        direct = 0.5 * (np.array(outputs)[:, None] == np.array(inputs))
        parts = _each(self.systems, lambda one: one.part(outputs, inputs))
        by_sample = _each(parts, lambda one: one._replace(D=one.D + direct))
        return pole.without_drift_over_a_cycle(by_sample) if self.drift.equilibria.size else by_sample

    @property
    def decay(self) -> float:
        """The minimum decay rate, 1/s."""
        return -float(pole.spectral_abscissa(pole.continuous_poles(self.poles, self.period)))

    def loop_margins(self) -> FloatArray:
        """Return the disk margin of each channel, all others closed, (m,); 0 if the loop is not stable."""
        if not self.decay > 0.0:
            return np.zeros(self.channels)
        return np.array([1.0 / norm if norm > 0.0 else math.inf for norm in self._alone])

    @cached_property
    def _alone(self) -> list[float]:
        return [periodic_norm(self._disk([k], [k])) for k in range(self.channels)]

    @cached_property
    def disk_margin(self) -> DiskMargin:
        """The disk margin of all channels at once, guaranteed by one scaling of each channel.

        Frequency by frequency it is given of short cycles only: of long ones it hardly depends on frequency.
        """
        from scipy.linalg import matrix_balance

        m, every = self.channels, range(self.channels)
        disks, s = self._disk(every, every), pole.continuous_poles(self.poles, self.period)
        if not self.decay > 0.0:
            return no_margin(0.0, np.zeros(0), s, disks[0]._replace(dt=self.period))
        plain = periodic_norm(disks) if m > 1 else self._alone[0]
        norm, d, at_worst = plain, np.ones(m), disks
        if m > 1:
            # Scalings are powers of two.
            sizes = np.diag(self._alone)
            for i, j in permutations(every, 2):
                sizes[i, j] = periodic_norm(self._disk([i], [j]), 1e-3)
            _, (d, _) = matrix_balance(sizes, permute=False, separate=True)
            at_worst = _each(
                disks, lambda one: one._replace(B=one.B * d, C=one.C / d[:, None], D=one.D * d / d[:, None])
            )
            norm = periodic_norm(at_worst)
        grid, lower, upper = self._over_frequency(disks, d, s)
        return DiskMargin(
            lower=1.0 / norm,
            upper=1.0 / min(max(self._alone), norm),
            unstructured=1.0 / max(norm, plain),
            frequency=_worst_frequency(at_worst, norm),
            proved=True,
            perturbation=np.full(m, np.inf + 0j),
            frequencies=grid,
            lower_response=lower,
            upper_response=upper,
        )

    def _over_frequency(
        self, disks: Sequence[System], d: FloatArray, s: ComplexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return frequencies (F,), rad/s, and the margins there: with scalings `d`, and of one channel."""
        N, m = self.samples, self.channels
        if N * m > _MOST_STACKED:
            return np.zeros(0), np.zeros(0), np.zeros(0)
        disk = lifted(disks)
        grid = pole.search_grid(disk, s)
        response = frequency_response(disk, grid, -3)
        own = response.reshape(-1, N, m, N, m)[:, :, range(m), :, range(m)]
        alone = largest_singular_values(own).max(axis=0)
        every = np.tile(d, N)
        gains = largest_singular_values(response * every / every[:, None])
        return grid, 1.0 / gains, 1.0 / alone

    def noise_to_torque(self, rms: FloatArray) -> list[System]:
        """Return for each channel a system driven by white samples of unit rms whose outputs add up to its torque.

        The sum of their mean squares is that of the torque, over the samples of a cycle, from noise (p,) of what is
        measured.
        """
        m, n = self.channels, self.systems[0].A.shape[1]
        # What the noise of a cycle makes of the state, and of each torque before the cycle is over; and what of each
        # torque follows from the state before.
        state, own, seen = np.eye(n), np.zeros(m), np.zeros((m, n, n))
        power = np.zeros((n, n))
        for one in self.systems:
            B, D = one.B[:, m:] * rms, one.D[:, m:] * rms
            own += np.einsum("ki,ij,kj->k", one.C, power, one.C) + np.sum(D**2, axis=1)
            row = one.C @ state
            seen += row[:, :, None] * row[:, None, :]
            state, power = one.A @ state, one.A @ power @ one.A.T + B @ B.T
        B = np.pad(factor(power), ((0, 0), (0, 1)))
        out = []
        for k in range(m):
            C = np.pad(factor(seen[k]).T, ((0, 1), (0, 0)))
            D = np.zeros((len(C), B.shape[1]))
            D[-1, -1] = math.sqrt(own[k])
            out.append(System(state, B, C / math.sqrt(self.samples), D / math.sqrt(self.samples), self.period))
        return out
