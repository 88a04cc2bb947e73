"""Coordinates of a controller without a pattern: its entries, or a chart in which an infinite gain is finite."""

from __future__ import annotations

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.norm import second_order


class Chart:
    """M = left · K(X) · right around K0, X = 0 there; `left` and `right` carry units, K is at most about 1/`least`."""

    def __init__(self, centre: FloatArray, left: FloatArray, right: FloatArray, least: float = 1e-7) -> None:
        self.left, self.right, self.least = left, right, least
        rows, columns = centre.shape
        self.shape = (rows, columns)
        scaled = np.linalg.solve(left, np.linalg.solve(right.T, centre.T).T)
        Q = np.linalg.qr(np.vstack([np.eye(columns), scaled]), mode="complete")[0]
        self.top, self.bottom = Q[:columns], Q[columns:]

    def _parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return K, W = (Q11 + Q12 X)⁻¹ and V = Q22 − K Q12: dK = V dX W."""
        columns = self.shape[1]
        X = x.reshape(self.shape)
        W = np.asarray(np.linalg.inv(self.top[:, :columns] + self.top[:, columns:] @ X), dtype=np.float64)
        K: FloatArray = (self.bottom[:, :columns] + self.bottom[:, columns:] @ X) @ W
        return K, W, self.bottom[:, columns:] - K @ self.top[:, columns:]

    def matrix(self, x: FloatArray) -> FloatArray:
        """Return M."""
        try:
            return np.asarray(self.left @ self._parts(x)[0] @ self.right)
        except np.linalg.LinAlgError:
            return np.full(self.shape, np.inf)

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx."""
        _, W, V = self._parts(x)
        return np.asarray(np.einsum("ia,bj->ijab", self.left @ V, W @ self.right).reshape(*self.shape, x.size))

    def bend(self, x: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the Hessian of sum(weight * M): d²M = −V dX W Q12 dX' W − the same with dX and dX' exchanged."""
        _, W, V = self._parts(x)
        outer = V.T @ self.left.T @ weight @ self.right.T @ W.T  # (rows, columns) of the first dX's row, last column
        inner = W @ self.top[:, self.shape[1] :]
        H = -np.einsum("ad,bc->abcd", outer, inner).reshape(x.size, x.size)
        return np.asarray(H + H.T)

    def _edge(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return U, S, V' and the scale of Q11 + Q12 X, whose least singular value is zero at infinite gain."""
        columns = self.shape[1]
        U, S, Vh = np.linalg.svd(self.top[:, :columns] + self.top[:, columns:] @ x.reshape(self.shape))
        return U, S, Vh, self.top[:, columns:]

    def near_limit(self, x: FloatArray) -> bool:
        """Return whether the largest gain allowed keeps x where it is."""
        return bool(self._edge(x)[1][-1] < 3.0 * self.least)

    def limits(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is negative while M is within its largest gain."""
        U, S, Vh, Q12 = self._edge(x)
        return np.array([self.least - S[-1]]), -np.outer(Q12.T @ U[:, -1], Vh[-1]).reshape(1, -1)

    def limit_bend(self, x: FloatArray) -> FloatArray:
        """Return the Hessian of the limit."""
        U, S, Vh, Q12 = self._edge(x)
        n = x.size
        left = U.T @ Q12  # u_k' dD v = left[k] dX v
        c = np.einsum("ka,b->kab", left, Vh[-1]).reshape(len(S), n)
        d = np.einsum("a,kb->kab", left[-1], Vh).reshape(len(S), n)
        apart = S - S[-1] > 1e-3 * S[-1]
        return -second_order(c.astype(complex), d.astype(complex), S, float(S[-1]), apart)


def _mean(sizes: FloatArray) -> float:
    return float(np.exp(np.mean(np.log(sizes)))) if sizes.size else 1.0


class Entries:
    """M by its entries, row by row, in one unit for the gains of all signals: `order` states first, then signals.

    Units of every signal, as a chart has them, would set the descent on ways that end at kinks.
    """

    def __init__(self, units: tuple[FloatArray, FloatArray], order: int) -> None:
        size = []
        for unit in units:
            norms = np.maximum(np.linalg.norm(unit, axis=0), 1e-300)
            size.append(np.concatenate([norms[:order], np.full(len(unit) - order, _mean(norms[order:]))]))
        self.size = np.outer(size[0], size[1])
        self.shape = self.size.shape
        self._slope = np.zeros((*self.shape, self.size.size))
        self._slope.reshape(self.size.size, -1)[...] = np.diag(self.size.ravel())

    def coordinates(self, M: FloatArray) -> FloatArray:
        """Return x, (rows * columns,)."""
        return np.asarray(M / self.size).ravel()

    def matrix(self, x: FloatArray) -> FloatArray:
        """Return M."""
        return np.asarray(x.reshape(self.shape) * self.size)

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx."""
        return self._slope

    def bend(self, x: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the Hessian of sum(weight * M): none."""
        return np.zeros((x.size, x.size))

    def limits(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return no limits."""
        return np.zeros(0), np.zeros((0, x.size))

    def limit_bend(self, x: FloatArray) -> FloatArray:
        """Return the curvature of no limit."""
        return np.zeros((x.size, x.size))
