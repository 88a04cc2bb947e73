"""The structured singular value for diagonal complex perturbations: of matrices, and its peak over all frequencies.

The upper bound is the least largest singular value of D M D^-1: Osborne's balancing comes near it, and BFGS reaches it
where that matters. The lower bound is the largest spectral radius of Q M for phases Q (Packard and Doyle, Automatica
29, 1993), by BFGS as well.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.singular_values import FrequencyAxis, largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray

# Sweeps of balancing, and the share of a row that counts as that of an empty column.
_SWEEPS, _EMPTY = 8, 1e-8


class MuBounds(NamedTuple):
    """Bounds of mu for each of N matrices of m channels."""

    upper: FloatArray  # (N,)
    lower: FloatArray  # (N,)
    D: FloatArray  # (N, m): scalings: `upper` is the largest singular value of D M D^-1
    # complex (N, m): phases: `lower` is the spectral radius of Q M. All but one of them are 0 where one channel alone
    # reaches more.
    Q: ComplexArray


def mu_bounds(M: ComplexArray) -> MuBounds:
    """Return bounds of mu for finite matrices (N, m, m) by balancing alone, within a few per cent of each other."""
    D = _balanced(M)
    scaled = _scaled(M, D)
    left, sizes, right = np.linalg.svd(scaled)
    # Phases that turn each entry of the left singular vector into that of the right one.
    turn = right[:, 0, :].conj() * left[:, :, 0].conj()
    Q = np.where(np.abs(turn) > 0.0, turn / np.where(np.abs(turn) > 0.0, np.abs(turn), 1.0), 1.0)
    lower = np.abs(np.linalg.eigvals(Q[:, :, None] * M)).max(axis=-1)
    alone = np.abs(np.einsum("kii->ki", M))
    better = alone.max(axis=-1) >= lower
    Q[better] = np.eye(M.shape[-1])[alone[better].argmax(axis=-1)]
    return MuBounds(upper=sizes[:, 0], lower=np.minimum(np.maximum(lower, alone.max(axis=-1)), sizes[:, 0]), D=D, Q=Q)


def _scaled(M: ComplexArray, D: FloatArray) -> ComplexArray:
    return np.asarray(D[..., :, None] * M / D[..., None, :], dtype=np.complex128)


def _balanced(M: ComplexArray) -> FloatArray:
    """Return scalings D (N, m) with which rows and columns of D M D^-1 are equally large (Osborne)."""
    m = M.shape[-1]
    squares = np.abs(M) ** 2 * (1.0 - np.eye(m))
    D = np.ones(M.shape[:-1])
    for _ in range(_SWEEPS if m > 1 else 0):
        for i in range(m):
            ratio = (D[:, i, None] / D) ** 2
            row, column = (squares[:, i] * ratio).sum(axis=-1), (squares[:, :, i] / ratio).sum(axis=-1)
            least = _EMPTY * (row + column) + 1e-300
            D[:, i] *= ((column + least) / (row + least)) ** 0.25
    return np.asarray(D / np.exp(np.log(D).mean(axis=-1, keepdims=True)))


def best_scalings(M: ComplexArray, D: FloatArray) -> tuple[float, FloatArray]:
    """Return the least largest singular value of D M D^-1 that is found from D (m,), and the scalings."""
    from scipy.optimize import minimize

    if len(D) == 1 or not np.any(M):
        return float(np.linalg.norm(M, 2)), D

    def size(x: FloatArray) -> tuple[float, FloatArray]:
        left, sizes, right = np.linalg.svd(_scaled(M, np.exp(x)))
        return math.log(max(sizes[0], 1e-300)), np.abs(left[:, 0]) ** 2 - np.abs(right[0]) ** 2

    first = np.log(D)
    found = minimize(size, first, jac=True, method="BFGS", options={"gtol": 1e-6, "maxiter": 30})
    x = found.x if np.isfinite(found.fun) and found.fun <= size(first)[0] else first
    return math.exp(size(x)[0]), np.exp(x - x.mean())


def best_phases(M: ComplexArray, D: FloatArray, Q: ComplexArray) -> tuple[float, ComplexArray]:
    """Return the largest spectral radius of Q M that is found from the best D (m,) and from Q (m,), and the phases."""
    from scipy.optimize import minimize

    def radius(x: FloatArray) -> tuple[float, FloatArray]:
        values, vectors = np.linalg.eig(np.exp(1j * x)[:, None] * M)
        k = int(np.argmax(np.abs(values)))
        try:
            shares = np.linalg.inv(vectors)[k] * vectors[:, k]
        except np.linalg.LinAlgError:
            shares = np.zeros(len(x))
        return -math.log(max(abs(values[k]), 1e-300)), shares.imag

    left, sizes, right = np.linalg.svd(_scaled(M, D))
    starts = [np.angle(right[0].conj() * left[:, 0].conj()), np.angle(Q), np.zeros(len(D))]
    best, phases = 0.0, starts[0]
    for x in starts:
        found = minimize(radius, x, jac=True, method="BFGS", options={"gtol": 1e-7, "maxiter": 60})
        if math.exp(-found.fun) > best:
            best, phases = math.exp(-found.fun), found.x
        if best >= (1.0 - 1e-6) * sizes[0]:
            break
    alone = np.abs(np.diag(M))
    if alone.max() >= best:
        return float(alone.max()), np.eye(len(D), dtype=np.complex128)[int(alone.argmax())]
    return best, np.exp(1j * phases)


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


# Relative amount by which mu may exceed its peak between the frequencies that were evaluated, once that is proved.
SLACK = 1e-4
# A peak is known when it is no higher than its neighbours by more than this; points between neighbours at a time.
_LEVEL, _FINER = 1e-7, 9
# Scalings of the peak are tried on what is so high, relative to it.
_NEAR = 0.9
_MOST = 400
# Scalings that a proof takes at most.
_SCALINGS = 80


class MuPeak:
    """The largest mu of a square system over frequency: climbed, then proved.

    `mu` is its upper bound at `frequency`, the highest that was evaluated, with the scalings D (m,); M (m, m) is the
    response there.
    """

    def __init__(self, system: System) -> None:
        m = len(system.D)
        self.axis = FrequencyAxis(system)
        self.mu = self.frequency = 0.0
        self.D, self.M = np.ones(m), np.zeros((m, m), dtype=np.complex128)

    def reached(self) -> ComplexArray:
        """Return the perturbation (m,) that makes I - M diag(delta) singular, as small as is found."""
        near = mu_bounds(self.M[None])
        return perturbation(self.M, best_phases(self.M, self.D, near.Q[0])[1])

    def search(self, grid: FloatArray, response: ComplexArray, between: bool = True) -> tuple[FloatArray, FloatArray]:
        """Find the peak about a grid (N,) of rising frequencies; return both bounds of mu there, (N,).

        The highest of the upper bounds is lowered by better scalings, until none is higher than one with the best;
        then frequencies beside it are added, if they may lie between those of the grid.
        """
        near = mu_bounds(response)
        w, M, D, upper = grid, response, near.D, near.upper.copy()
        solved = np.zeros(len(w), dtype=np.bool_)
        of_grid = np.arange(len(grid))
        for _ in range(_MOST):
            k = int(np.argmax(upper))
            if not solved[k]:
                size, D[k] = best_scalings(M[k], D[k])
                solved[k] = True
                high = np.flatnonzero((upper >= _NEAR * size) & ~solved)
                sizes = largest_singular_values(_scaled(M[high], D[k]))
                lower = sizes < upper[high]
                upper[high[lower]], D[high[lower]] = sizes[lower], D[k]
                upper[k] = min(size, upper[k])
                continue
            beside = np.array([j for j in (k - 1, k + 1) if 0 <= j < len(w)])
            if not between or not beside.size or np.all(upper[beside] >= upper[k] * (1.0 - _LEVEL)):
                break
            new = np.setdiff1d(np.linspace(w[beside], w[k], _FINER + 2)[1:-1].ravel(), w[[k, *beside]])
            new = new[np.isfinite(new)]
            if not new.size:
                break
            more = self.axis.response(new)
            at = np.searchsorted(w, new)
            of_grid += np.searchsorted(new, w[of_grid])
            upper = np.insert(upper, at, largest_singular_values(_scaled(more, D[k])))
            D, M = np.insert(D, at, D[k], axis=0), np.insert(M, at, more, axis=0)
            w, solved = np.insert(w, at, new), np.insert(solved, at, False)
        k = int(np.argmax(upper))
        if upper[k] > self.mu:
            self.mu, self.frequency, self.D, self.M = float(upper[k]), float(w[k]), D[k], M[k]
        return upper[of_grid], np.minimum(near.lower, upper[of_grid])

    def prove(self) -> bool:
        """Show that mu exceeds its peak nowhere by more than `SLACK`; climb where it does.

        The end of the axis has to have been evaluated.

        With D fixed, the Hamiltonian of D (S + ...) D^-1 shows where its gain exceeds the peak; another D is needed
        only there (Ferreres, Magni and Biannic, Int. J. Robust Nonlinear Control 13, 2003).
        """
        if len(self.axis.system.A) == 0:
            return True
        doubtful = [(0.0, self.axis.edge)]
        D = self.D
        for _ in range(_SCALINGS):
            doubtful = self._exceeding(doubtful, D, self.mu * (1.0 + SLACK))
            if not doubtful:
                return True
            low, high = max(doubtful, key=lambda part: math.inf if part[0] == 0.0 else part[1] / part[0])
            middle = _middle(low, high)
            M = self.axis.response(np.array([middle]))
            size, D = best_scalings(M[0], D)
            if size > self.mu:
                grid = np.unique([max(low, 0.5 * middle), middle, min(high, 2.0 * middle)])
                self.search(grid, self.axis.response(grid))
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
