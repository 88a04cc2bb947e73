"""The largest structured singular value of a system over all frequencies: climbed, then proved to be the largest."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.norms import resonances
from platform_ctrl.analysis.singular_values import FrequencyAxis, largest_singular_values
from platform_ctrl.common.values import FloatArray


class MuBounds(NamedTuple):
    """Bounds of mu for each of N matrices of m channels."""

    # upper, lower: (N,): equal to the tolerance up to three channels
    upper: FloatArray
    lower: FloatArray
    D: FloatArray  # (N, m): scalings: `upper` bounds the largest singular value of D M D^-1. Geometric mean 1.
    # complex (N, m): phases: `lower` is the spectral radius of Q M, to rounding of the power iteration that found it.
    # All but one of them are 0 where one channel alone reaches more than the phases that were found.
    Q: ComplexArray


def mu_bounds(M: ComplexArray, tolerance: float = 1e-6) -> MuBounds:
    """Return both bounds of mu for finite matrices (N, m, m), faster where each resembles the one before.

    `tolerance` is relative; every returned upper bound is one whatever the tolerance.
    """
    # Compiled, or taken from numba's cache, with the first call.
    from platform_ctrl.analysis import mu_kernel

    N, m, _ = M.shape
    upper, lower, D, Q = np.empty(N), np.empty(N), np.empty((N, m)), np.empty((N, m), dtype=np.complex128)
    mu_kernel.mu_bounds(np.ascontiguousarray(M, dtype=np.complex128), tolerance, upper, lower, D, Q)
    return MuBounds(upper=upper, lower=lower, D=D, Q=Q)


def perturbation(M: ComplexArray, Q: ComplexArray) -> ComplexArray:
    """Return delta (m,) with |delta_i| = 1/rho(Q M) or 0 for which I - M diag(delta) is singular; M (m, m), Q (m,).

    Real where M is and signs reach as much as the phases; infinite where Q M has no eigenvalue but 0.
    """
    largest = _largest_eigenvalue(Q, M)
    if largest == 0.0:
        return np.full(len(Q), np.inf + 0j)
    if np.abs(M.imag).max() <= 1e-13 * np.abs(M.real).max():
        # Eigenvalues of a matrix of real numbers: those on the real axis are real without rounding.
        signs = np.sign(np.round((Q / largest * abs(largest)).real))
        real = _largest_eigenvalue(signs, M.real)
        if abs(real) >= (1.0 - 1e-9) * abs(largest) and real.imag == 0.0:
            return np.asarray(signs / real.real, dtype=np.complex128)
    return Q / largest


def _largest_eigenvalue(Q: ComplexArray | FloatArray, M: ComplexArray | FloatArray) -> complex:
    eigenvalues = np.linalg.eigvals(Q[:, None] * M)
    return complex(eigenvalues[np.argmax(np.abs(eigenvalues))])


def search_grid(system: StateArrays, s: ComplexArray, known: int = 0) -> FloatArray:
    """Return frequencies that follow the closed loop's poles, and some a decade between and beyond them.

    Fewer where `known` others, a hundred or more, are evaluated anyway: a peak between them is found by its proof.
    """
    few = known >= 100
    finite = s[np.isfinite(s)]
    own = np.concatenate([np.abs(finite.imag), np.abs(finite)]) if few else resonances(s)
    own = own[own > 0.0]
    if own.size == 0:
        own = np.ones(1)
    low, high = 0.1 * float(own.min()), 10.0 * float(own.max())
    if system.dt > 0.0:
        high = math.pi / system.dt
        low = min(low, 1e-3 * high)
    low = max(low, 1e-9 * high)
    decades = math.log10(high / low)
    # Like `np.geomspace`, which takes a twentieth of the time of a margin.
    fill = low * 10.0 ** np.linspace(0.0, decades, 2 + int((5.0 if few else 15.0) * decades))
    fill[-1] = high
    return np.unique(np.concatenate([[0.0], own[(own >= low) & (own <= high)], fill]))


# Relative amount by which mu may exceed its peak between the frequencies that were evaluated, once that is proved.
SLACK = 1e-4
# Where a climb looks between two frequencies.
FAN = np.linspace(0.0, 1.0, 13)


class MuPeak:
    """The largest mu of a square system over frequency: climbed, then proved.

    `mu` is its upper bound at `frequency`, the highest that was evaluated, with the scalings D (m,), and `lower` its
    lower bound there, which the phases Q (m,) reach; M (m, m) is the response there.
    """

    def __init__(self, system: StateArrays) -> None:
        m = len(system.D)
        self.axis = FrequencyAxis(system)
        self.mu = self.frequency = self.lower = 0.0
        self.D = np.ones(m)
        self.Q = np.ones(m, dtype=np.complex128)
        self.M = np.zeros((m, m), dtype=np.complex128)

    def bounds(self, frequency: FloatArray, response: ComplexArray | None = None, tolerance: float = 1e-8) -> MuBounds:
        """Return mu's bounds at each frequency, and keep the largest; its response may be known."""
        response = self.response(frequency) if response is None else response
        found = mu_bounds(response, tolerance)
        i = int(np.argmax(found.upper))
        if found.upper[i] > self.mu:
            self.mu, self.frequency, self.lower = float(found.upper[i]), float(frequency[i]), float(found.lower[i])
            self.D, self.Q, self.M = found.D[i], found.Q[i], response[i]
        return found

    def response(self, frequency: FloatArray) -> ComplexArray:
        """Return the response, (N, m, m); at infinite frequency the direct term."""
        return self.axis.response(frequency)

    def climb(self, grid: FloatArray, mu: FloatArray) -> None:
        """Refine the three highest local maxima of `mu` on `grid` side by side, the highest of them to the end."""
        padded = np.concatenate([[-np.inf], mu, [-np.inf]])
        tops = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
        tops = tops[mu[tops] >= 0.7 * mu.max()]
        tops = tops[np.argsort(-mu[tops])][:3]
        left, right = grid[np.maximum(tops - 1, 0)], grid[np.minimum(tops + 1, len(grid) - 1)]
        for step in range(6):
            fan = left[:, None] + (right - left)[:, None] * FAN
            if step == 0:
                # The responses that separated the local maxima may have been less accurate.
                fan[:, len(FAN) // 2] = grid[tops]
                fan.sort(axis=1)
            found = self.bounds(fan.ravel()).upper.reshape(fan.shape)
            high = found.max(axis=1) >= 0.999 * self.mu
            fan, at = fan[high], found[high].argmax(axis=1)
            row = np.arange(len(fan))
            below, above = np.maximum(at - 1, 0), np.minimum(at + 1, fan.shape[1] - 1)
            left, right = fan[row, below], fan[row, above]
            lowest = np.minimum(found[high][row, below], found[high][row, above])
            if np.all(lowest >= self.mu * (1.0 - 1e-8)):
                break

    def prove(self, slack: float = SLACK, most: int = 80) -> bool:
        """Show that mu exceeds its peak nowhere by more than `slack`; climb where it does.

        The end of the axis has to have been evaluated.

        With D fixed, the Hamiltonian of D (S + ...) D^-1 shows where its gain exceeds the peak; another D is needed
        only there (Ferreres, Magni and Biannic, Int. J. Robust Nonlinear Control 13, 2003).
        """
        if len(self.axis.system.A) == 0:
            return True
        doubtful = [(0.0, self.axis.edge)]
        D = self.D
        for _ in range(most):
            doubtful = self._exceeding(doubtful, D, self.mu * (1.0 + slack))
            if not doubtful:
                return True
            low, high = max(doubtful, key=lambda part: math.inf if part[0] == 0.0 else part[1] / part[0])
            middle = _middle(low, high)
            before = self.mu
            found = self.bounds(np.array([middle]))
            D = found.D[0]
            if found.upper[0] > before:
                grid = np.array([max(low, 0.5 * middle), middle, min(high, 2.0 * middle)])
                self.climb(grid, self.bounds(grid).upper)
        return False

    def _exceeding(
        self, intervals: list[tuple[float, float]], D: FloatArray, level: float
    ) -> list[tuple[float, float]]:
        """Return the parts of `intervals` where the gain of D (S + ...) D^-1 exceeds `level`."""
        crossings = self.axis.crossings(level, D)
        parts: list[tuple[float, float]] = []
        for low, high in intervals:
            inner = crossings[(crossings > low) & (crossings < high)]
            edges = [low, *inner.tolist(), high]
            parts += list(pairwise(edges))
        response = self.axis.response(np.array([_middle(*part) for part in parts]))
        exceeds = largest_singular_values(D[:, None] * response / D) > level
        kept: list[tuple[float, float]] = []
        for part, bad in zip(parts, exceeds, strict=True):
            if not bad:
                continue
            if kept and kept[-1][1] == part[0]:
                kept[-1] = (kept[-1][0], part[1])
            else:
                kept.append(part)
        return kept


def _middle(low: float, high: float) -> float:
    if math.isinf(high):
        return 3.0 * low if low > 0.0 else 1.0
    return math.sqrt(low * high) if low > 0.0 else 0.3 * high
