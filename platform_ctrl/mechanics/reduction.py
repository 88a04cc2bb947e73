"""The rows (19) of gimbals without part of their inertia: roots, and how far the responses differ."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.matrices import inverse_inertia
from platform_ctrl.mechanics.state_space import ComplexArray

# A stage of the search for roots at zero takes what is this small against the whole for zero.
_ZERO_ROOT = 1e-10


class Rows(NamedTuple):
    """The rows (19) of n gimbals in coordinates x of unit inertia, q = T x, Tᵀ M T = 1; V (n, k) are directions."""

    T: FloatArray  # (n, n)
    D: FloatArray  # (n, n): coefficient of x'
    S: FloatArray  # (n, n): coefficient of x
    M_Omega: FloatArray  # (n, 3): coefficients of ω' and ω
    G_Omega: FloatArray  # (n, 3)

    @classmethod
    def of(cls, model: LinearModel, rows: list[int]) -> Rows:
        """Return those of the gimbals in `rows`; `MechanicsError` where M is singular."""
        M, D, S = (item[np.ix_(rows, rows)] for item in (model.M, model.damping, model.stiffness))
        inverse_inertia(M, [model.angle_names[k] for k in rows])
        T = np.linalg.inv(np.linalg.cholesky(M).T)
        return cls(T, T.T @ D @ T, T.T @ S @ T, T.T @ model.M_Omega[rows], T.T @ model.G_Omega[rows])

    def reduced(self, V: NDArray[np.floating]) -> tuple[FloatArray, float]:
        """Return [x', π'] over [x, π, Q, ω], (n + k, 2 n + k + 3), and ‖∂x'/∂x‖ along U, rad/s."""
        from scipy.linalg import null_space

        n, k = V.shape
        U = null_space(V.T) if k else np.eye(n)
        force = np.hstack([-self.S, np.zeros((n, k)), self.T.T, -self.G_Omega])
        momenta = np.hstack([np.zeros((k, n)), np.eye(k), np.zeros((k, n)), -V.T @ self.M_Omega])
        along_V = V @ np.linalg.solve(V.T @ V, momenta)
        by_force = U @ np.linalg.solve(U.T @ self.D @ U, U.T)
        rates = along_V + by_force @ (force - self.D @ along_V)
        size = float(np.linalg.norm(by_force @ self.S, 2)) if n else 0.0
        return np.vstack([rates, V.T @ (force - self.D @ rates)]), size

    def roots(self, V: NDArray[np.floating]) -> tuple[ComplexArray, int, float]:
        """Return the roots, slowest first, the length of the longest chain of vectors at the root 0, and ‖∂x'/∂x‖.

        Roots at 0 are split off by rank, stage by stage: as eigenvalues they would come out as noise of unknown size.
        """
        n, k = V.shape
        found, rate = self.reduced(np.linalg.qr(V)[0])
        # Momenta in units of coordinates times frequency.
        size = max(np.linalg.norm(self.D, 2), np.sqrt(np.linalg.norm(self.S, 2))) if n else 0.0
        unit = np.concatenate([np.ones(n), np.full(k, size or 1.0)])
        A = found[:, : n + k] * unit / unit[:, None]
        tolerance = _ZERO_ROOT * (np.linalg.norm(A, 2) if A.size else 0.0)
        zeros, chain = 0, 0
        while len(A):
            _, values, vectors = np.linalg.svd(A)
            null = int(np.sum(values <= tolerance))
            if not null:
                break
            zeros, chain = zeros + null, chain + 1
            rest = vectors[: len(A) - null]
            A = rest @ A @ rest.T
        own = np.linalg.eigvals(A) if len(A) else np.zeros(0)
        own = own[np.argsort(np.abs(own), kind="stable")]
        return np.concatenate([np.zeros(zeros), own]).astype(np.complex128), chain, rate

    def error(self, V: NDArray[np.floating], omega: FloatArray) -> FloatArray:
        """Return ‖X_r − X‖₂/‖X‖₂ of the responses X of x to torques at frequencies (N,), rad/s, (N,)."""
        one, inertia = np.eye(len(self.T)), V @ np.linalg.pinv(V)
        s = 1j * omega[:, None, None]
        rest = s * self.D + self.S
        reduced = s**2 * inertia + rest
        # On a root of the reduction its response, and so the error, is infinite.
        regular = np.linalg.cond(reduced) < 1.0 / np.finfo(float).eps
        reduced[~regular] = one
        # X_r − X = X (Z − Z_r) X_r holds the difference without cancellation; Z = X⁻¹ is the dynamic stiffness. X is
        # taken over its norm: finite on a pole of the full equations, too.
        left, values, right = np.linalg.svd(s**2 * one + rest)
        share = np.divide(values[:, -1:], values, out=np.ones_like(values), where=values > values[:, -1:])
        X = np.conj(np.swapaxes(left * share[:, None, :] @ right, 1, 2))
        difference = X @ (s**2 * (one - inertia)) @ np.linalg.inv(reduced)
        return np.where(regular, np.linalg.norm(difference, 2, axis=(1, 2)), np.inf)
