"""Controllers as functions of search coordinates.

Of a structure: logarithms of positive numbers, others in units of their size. Without a pattern: all entries, or a
chart in which an infinite gain is finite.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.norm import second_order
from platform_ctrl.design.fixed_structure.structures import Given, Parameter, Structure, Units, joined
from platform_ctrl.errors import ArgumentError

# Step of the differences that give second derivatives, in search coordinates.
_STEP = 1e-4


class Parametrised:
    """The matrix M = [A_K, B_K; C_K, D_K] of a structure over its free numbers x.

    `names` are those of all parameters, the fixed ones among them. `start`, `lower` and `upper` (n,) are in search
    coordinates; those that are `positive` (n,) are logarithms, and M is affine in each of the others.
    """

    def __init__(self, structure: Structure, nmeas: int, ncon: int, units: Units) -> None:
        self.structure, self.nmeas, self.ncon = structure, nmeas, ncon
        given, kind = structure.given, type(structure).__name__
        everything = [_given(one, given, kind) for one in structure.parameters(nmeas, ncon, units)]
        self.names = tuple(one.name for one in everything)
        for what in ("start", "bounds", "fixed"):
            for name in getattr(given, what):
                known_name(f"{kind}: {what}", name, self.names)
        fixed = {self.names.index(name): float(number) for name, number in given.fixed.items()}
        spread, leaders = _ties(given.tied, everything, fixed, kind)
        self._base = np.array([fixed.get(k, 0.0) for k in range(len(everything))])
        self._spread = spread
        free = [everything[k] for k in leaders]
        self._size = np.array([one.size for one in free])
        self.positive = np.array([one.positive for one in free], dtype=bool)
        self.start = self._coordinates(np.array([one.start for one in free]))
        self.lower = self._coordinates(np.array([one.lower for one in free]))
        self.upper = self._coordinates(np.array([one.upper for one in free]))
        self._kept: tuple[bytes, FloatArray] | None = None

    def _coordinates(self, numbers: FloatArray) -> FloatArray:
        out: FloatArray = numbers / self._size
        with np.errstate(invalid="ignore", divide="ignore"):
            out[self.positive] = np.log(np.maximum(numbers[self.positive], 0.0))
        return out

    def parameters(self, x: FloatArray) -> FloatArray:
        """Return all parameters at x."""
        free = np.where(self.positive, np.exp(np.where(self.positive, x, 0.0)), self._size * x)
        return np.asarray(self._base + self._spread @ free)

    def nearest(self, M: FloatArray) -> FloatArray:
        """Return the coordinates of M, in which the structure is affine, by least squares."""
        zero = np.zeros(len(self.start))
        found = np.linalg.lstsq(self.jacobian(zero).reshape(M.size, -1), (M - self.matrix(zero)).ravel(), rcond=None)[0]
        return np.clip(found, self.lower, self.upper)

    def named(self, x: FloatArray) -> dict[str, float]:
        """Return all parameters by name."""
        return dict(zip(self.names, map(float, self.parameters(x)), strict=True))

    def block(self, x: FloatArray) -> StateArrays:
        """Return A_K, B_K, C_K, D_K."""
        return self.structure.block(self.parameters(x), self.nmeas, self.ncon)

    def matrix(self, x: FloatArray) -> FloatArray:
        """Return M."""
        return joined(self.block(x))

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx, (rows, columns, n)."""
        key = x.tobytes()
        if self._kept is None or self._kept[0] != key:
            slopes = self.structure.slopes(self.parameters(x), self.nmeas, self.ncon)
            size = np.where(self.positive, np.exp(np.where(self.positive, x, 0.0)), self._size)
            self._kept = key, (slopes @ self._spread) * size
        return self._kept[1]

    def bend(self, x: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the Hessian of sum(weight * M): differences along the positive numbers, M is affine in each other."""
        H = np.zeros((len(x), len(x)))
        along = np.flatnonzero(self.positive)
        for k in along:
            step = np.zeros(len(x))
            step[k] = _STEP
            ends = [np.einsum("ij,ijx->x", weight, self.jacobian(x + sign * step)) for sign in (1.0, -1.0)]
            H[:, k] = (ends[0] - ends[1]) / (2.0 * _STEP)
        rest = np.flatnonzero(~self.positive)
        H[np.ix_(along, rest)] = H[np.ix_(rest, along)].T
        return np.asarray(0.5 * (H + H.T))

    def limits(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return nothing: bounds are kept by the search itself."""
        return np.zeros(0), np.zeros((0, len(x)))

    def limit_bend(self, x: FloatArray) -> FloatArray:
        """Return the curvature of no limit."""
        return np.zeros((len(x), len(x)))


def _given(one: Parameter, by_name: Given, kind: str) -> Parameter:
    """Return the parameter with what the user gave for it."""
    where = f"{kind}: {one.name}"
    low, high = _pair(by_name.bounds.get(one.name, (one.lower, one.upper)), where)
    if one.positive and low < 0.0:
        raise ArgumentError(f"{where}: bounds must not be negative, got {low:g} to {high:g}")
    given = by_name.fixed.get(one.name, by_name.start.get(one.name, one.start))
    if not np.isfinite(given) or (one.positive and not given > 0.0):
        raise ArgumentError(f"{where}: must be a {'positive' if one.positive else 'finite'} number, got {given!r}")
    return Parameter(
        name=one.name,
        start=float(min(max(given, low), high)),
        size=one.size,
        positive=one.positive,
        lower=low,
        upper=high,
    )


def _pair(bounds: Any, where: str) -> tuple[float, float]:
    try:
        low, high = (float(x) for x in bounds)
    except (TypeError, ValueError):
        raise ArgumentError(f"{where}: bounds must be a pair (lower, upper), got {bounds!r}") from None
    if not low < high:
        raise ArgumentError(f"{where}: the lower bound must be below the upper one, got ({low:g}, {high:g})")
    return low, high


def _ties(
    tied: Sequence[Sequence[str]], everything: Sequence[Parameter], fixed: Mapping[int, float], where: str
) -> tuple[FloatArray, list[int]]:
    """Return the matrix from free numbers to parameters, and the first parameter of each free number."""
    names = [one.name for one in everything]
    leader: dict[int, tuple[int, float]] = {}
    for group in tied:
        if isinstance(group, str) or len(group) < 2:
            raise ArgumentError(f"{where}: tied must consist of groups of at least two names, got {group!r}")
        first: tuple[int, float] | None = None
        for word in group:
            sign = -1.0 if word.startswith("-") else 1.0
            k = known_name(f"{where}: tied", word.removeprefix("-"), names)
            if k in leader or k in fixed:
                raise ArgumentError(f"{where}: tied: {names[k]!r} is tied or fixed already; give each name once")
            if sign < 0.0 and everything[k].positive:
                raise ArgumentError(f"{where}: tied: {word!r}: a positive number has no opposite")
            first = first or (k, sign)
            if everything[first[0]].positive != everything[k].positive:
                raise ArgumentError(f"{where}: tied: {names[first[0]]!r} and {names[k]!r} are of different kinds")
            leader[k] = (first[0], sign * first[1])
    leaders = [k for k in range(len(names)) if k not in fixed and leader.get(k, (k, 1.0))[0] == k]
    if not leaders:
        raise ArgumentError(f"{where}: every parameter is fixed; leave at least one free")
    spread = np.zeros((len(names), len(leaders)))
    for k in range(len(names)):
        if k not in fixed:
            at, sign = leader.get(k, (k, 1.0))
            spread[k, leaders.index(at)] = sign
    return spread, leaders


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
