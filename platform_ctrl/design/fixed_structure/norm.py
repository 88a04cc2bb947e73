"""The H-infinity norms of closed loops as functions of a controller: every peak near the highest, with its gradient.

A dynamic controller is one matrix M = [A_K, B_K; C_K, D_K], which closes a static loop around the plant with the
controller's integrators beside it. From M on, at any s, T(M + dM) = T + L dM R to first order, with L and R the loop
from u to z and from w to y (Apkarian and Noll, IEEE Trans. Automatic Control 51, 2006).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.singular_values import hamiltonian_crossings
from platform_ctrl.analysis.system import ComplexArray, scaled
from platform_ctrl.analysis.transfers import column_of, row_of
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.maps import singular
from platform_ctrl.design.fixed_structure.minimax import Evaluation
from platform_ctrl.design.fixed_structure.structures import Parametrised
from platform_ctrl.design.partition import Partition

# Peaks down to this share below the highest count, and at most so many of them.
_WINDOW, _MOST = 0.15, 40
# Points that an interval above the level is searched by, and relative distances in frequency at which the parabola
# through three points finds the top of a peak, one after the other.
_INSIDE, _AROUND = 6, (0.1, 0.02, 2e-3)
# Relative excess over the highest gain known at which it is tested for more, and how often.
_HIGHER, _SEARCHES = 1e-8, 20
# Poles within this share of the largest decay or growth rate count as growing beside it.
_NEAR = 0.1
# Distance of the poles from the axis, relative to the fastest, that counts as stable: what rounding leaves.
_ROUNDING = 1e-13


class AugmentedLoop:
    """The loop of an augmented plant and one matrix M."""

    def __init__(self, plant: Partition, M: FloatArray) -> None:
        self.M = M
        ny, nu = plant.D22.shape
        E = np.linalg.inv(np.eye(nu) - M @ plant.D22)
        if not np.abs(E).max() < 1e10:
            raise np.linalg.LinAlgError("not well posed")
        F, gain = np.eye(ny) + plant.D22 @ E @ M, E @ M
        self.B2, self.C2 = plant.B2 @ E, F @ plant.C2
        self.D12, self.D21 = plant.D12 @ E, F @ plant.D21
        self.A = plant.A + plant.B2 @ gain @ plant.C2
        self.B = plant.B1 + plant.B2 @ gain @ plant.D21
        self.C = plant.C1 + plant.D12 @ gain @ plant.C2
        self.D = plant.D11 + plant.D12 @ gain @ plant.D21
        self.poles = np.linalg.eigvals(self.A).astype(np.complex128)
        self.abscissa = float(np.max(self.poles.real, initial=-np.inf))
        self.size = float(np.abs(self.poles).max(initial=0.0))

    @property
    def stable(self) -> bool:
        """Whether all poles lie to the left of the axis, beyond rounding."""
        return self.abscissa < -_ROUNDING * self.size

    def growth(self, near: float) -> tuple[FloatArray, FloatArray]:
        """Return real parts of poles within `near` of the largest, (k,), and their gradients by M, (k, r, c)."""
        from scipy.linalg import eig

        poles, left, right = eig(self.A, left=True, right=True)
        chosen = np.flatnonzero((poles.real >= self.abscissa - near) & (poles.imag >= 0.0))
        inner = np.einsum("ik,ik->k", left[:, chosen].conj(), right[:, chosen])
        # A defective pole has no gradient; a finite one of the right direction serves.
        inner = np.where(np.abs(inner) < 1e-8, 1e-8, inner)
        a, b = left[:, chosen].conj().T @ self.B2, self.C2 @ right[:, chosen] / inner
        return poles.real[chosen], np.real(a[:, :, None] * b.T[:, None, :])

    def responses(self, frequency: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return T, L, R at frequencies (N,), rad/s or inf for the direct terms."""
        w, finite = self.B.shape[1], np.isfinite(frequency)
        s = 1j * np.where(finite, frequency, 0.0)
        shifted = s[:, None, None] * np.eye(len(self.A)) - self.A
        X = np.asarray(np.linalg.solve(shifted, np.hstack([self.B, self.B2])[None]), dtype=np.complex128)
        X[~finite] = 0.0
        Z, Y = self.C @ X, self.C2 @ X
        return Z[..., :w] + self.D, Z[..., w:] + self.D12, Y[..., :w] + self.D21

    def gains(self, frequency: FloatArray) -> FloatArray:
        """Return the largest singular value at finite frequencies (N,), rad/s."""
        shifted = 1j * frequency[:, None, None] * np.eye(len(self.A)) - self.A
        T = self.C @ np.linalg.solve(shifted, self.B[None]) + self.D
        return np.asarray(np.linalg.svd(T, compute_uv=False)[:, 0])

    def peaks(self, known: FloatArray) -> FloatArray:
        """Return the frequencies of the peaks near the highest, rad/s; inf where the direct term is one of them.

        Where singular values cross a level follows from the eigenvalues of a Hamiltonian matrix (Boyd and Balakrishnan,
        Systems & Control Letters 15, 1990), used as proposals only. Frequencies in `known` are looked at in any case.
        """
        direct = float(np.linalg.norm(self.D, 2))
        w = np.unique(np.concatenate([[0.0], np.abs(self.poles), np.abs(self.poles.imag), known]))
        gains = self.gains(w)
        A, B, C = scaled(self.A, self.B, self.C)

        def look(more: FloatArray) -> None:
            nonlocal w, gains
            w, first = np.unique(np.concatenate([w, more]), return_index=True)
            gains = np.concatenate([gains, self.gains(more)])[first]

        def crossed(level: float) -> FloatArray:
            root = np.sqrt(level)
            return hamiltonian_crossings(A, B / root, C / root, self.D / level) if level > 0.0 else np.zeros(0)

        level = (1.0 - _WINDOW) * max(float(gains.max()), direct)
        ends = crossed(level)
        if ends.size > 1:
            above = self.gains(0.5 * (ends[1:] + ends[:-1])) > level
            share = (np.arange(_INSIDE) + 0.5) / _INSIDE
            look((ends[:-1, None] + np.diff(ends)[:, None] * share)[above].ravel())
        for _ in range(_SEARCHES):
            top = max(float(gains.max()), direct)
            for distance in _AROUND:
                local = self._tops(w, gains, (1.0 - 1.3 * _WINDOW) * top)
                look(self._parabolas(w[local], distance))
            top = max(float(gains.max()), direct)
            ends = crossed(top * (1.0 + _HIGHER))
            if not ends.size:
                break
            look(np.concatenate([[0.5 * ends[0]], 0.5 * (ends[1:] + ends[:-1]), [2.0 * ends[-1]]]))
            if gains.max() <= top * (1.0 + _HIGHER):
                break
        local = self._tops(w, gains, (1.0 - _WINDOW) * top)
        return np.append(w[local], [np.inf] if direct >= (1.0 - _WINDOW) * top else [])

    @staticmethod
    def _tops(w: FloatArray, gains: FloatArray, level: float) -> NDArray[np.intp]:
        """Return the local maxima above a level, one of those next to each other, the highest first."""
        padded = np.concatenate([[-np.inf], gains, [-np.inf]])
        local = np.flatnonzero((gains >= padded[:-2]) & (gains > padded[2:]) & (gains >= level))
        local = local[np.argsort(-gains[local], kind="stable")]
        kept: list[int] = []
        for k in map(int, local):
            if not any(abs(w[k] - w[j]) <= 1e-3 * w[j] for j in kept):
                kept.append(k)
        return np.array(kept[:_MOST], dtype=np.intp)

    def _parabolas(self, at: FloatArray, distance: float) -> FloatArray:
        """Return where parabolas over the logarithm of frequency have their tops, and their other two points."""
        at = at[at > 0.0]
        points = at * np.exp(distance * np.array([[-1.0], [0.0], [1.0]]))
        left, middle, right = self.gains(points.ravel()).reshape(3, -1)
        bend = np.where(left + right < 2.0 * middle, left + right - 2.0 * middle, -np.inf)
        top = at * np.exp(distance * np.clip(0.5 * (left - right) / bend, -1.0, 1.0))
        return np.concatenate([points[0], points[2], top])


class WorstNorm:
    """The H-infinity norms of all plants with one controller, for `minimise`: a function of its free numbers."""

    def __init__(self, plants: Sequence[Partition], controller: Parametrised) -> None:
        self.plants, self.controller = tuple(plants), controller
        # Where the peaks were at the last point.
        self._known = [np.zeros(0) for _ in self.plants]

    def __call__(self, x: FloatArray) -> Evaluation:
        """Return every peak near the highest; of loops that are not stable their growth, 1/s."""
        M = self.controller.matrix(x)
        try:
            loops = [AugmentedLoop(plant, M) for plant in self.plants]
            stable = all(loop.stable for loop in loops)
            parts = [self._of_loop(k, loop, stable) for k, loop in enumerate(loops)]
        except np.linalg.LinAlgError:
            # Not well posed: worse than any other.
            parts, stable = [(np.array([np.inf]), np.zeros((1, *M.shape)))], False
        values = np.concatenate([one[0] for one in parts])
        gradients = np.einsum("kij,ijx->kx", np.concatenate([one[1] for one in parts]), self.controller.jacobian(x))
        owner = np.concatenate([np.full((len(one[0]), 1), k if stable else -1 - k) for k, one in enumerate(parts)])
        near = values >= ((1.0 - _WINDOW) * values.max() if stable else -np.inf)
        return Evaluation(
            values=values[near],
            gradients=gradients[near],
            hard=np.zeros(int(near.sum()), dtype=np.bool_),
            owner=owner[near],
            stable=stable,
        )

    def _of_loop(self, k: int, loop: AugmentedLoop, stable: bool) -> tuple[FloatArray, FloatArray]:
        """Return the values of one loop and their gradients by M."""
        if not stable:
            return loop.growth(_NEAR * abs(loop.abscissa))
        frequency = loop.peaks(self._known[k])
        self._known[k] = frequency[np.isfinite(frequency)]
        T, L, R = loop.responses(frequency)
        found = singular(T)
        a, b = row_of(found.u, L[found.at]), column_of(R[found.at], found.v)
        return found.size, np.real(a[:, :, None] * b[:, None, :])


def augmented(plant: Partition, order: int) -> Partition:
    """Return the plant with the controller's `order` integrators beside it: u = [xK', u], y = [xK, y]."""
    if order == 0:
        return plant
    n, own = len(plant.A), np.eye(order)
    return Partition(
        A=np.pad(plant.A, (0, order)),
        B1=np.pad(plant.B1, ((0, order), (0, 0))),
        B2=np.block([[np.zeros((n, order)), plant.B2], [own, np.zeros((order, plant.B2.shape[1]))]]),
        C1=np.pad(plant.C1, ((0, 0), (0, order))),
        C2=np.block([[np.zeros((order, n)), own], [plant.C2, np.zeros((len(plant.C2), order))]]),
        D11=plant.D11,
        D12=np.pad(plant.D12, ((0, 0), (order, 0))),
        D21=np.pad(plant.D21, ((order, 0), (0, 0))),
        D22=np.pad(plant.D22, ((order, 0), (order, 0))),
    )
