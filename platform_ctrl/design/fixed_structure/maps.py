"""Maps of a closed loop at single frequencies with their differentials by the controller, and smooth pieces of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.loop import Transfer
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray, value


class Responses(NamedTuple):
    """Plant, controller, sensitivities, and what disturbances do to what is measured, to it and the sight between.

    Each complex (..., rows, columns); the last three as in `between_samples.Disturbed`. `fed`: platform rate → torques
    that feedforward adds, where it does.
    """

    P: ComplexArray
    K: ComplexArray
    S_output: ComplexArray
    S_input: ComplexArray
    fed: ComplexArray
    read: ComplexArray
    angle: ComplexArray
    sight: ComplexArray

    def columns(self, source: str) -> slice:
        """Return the columns of a continuous disturbance."""
        m = self.P.shape[-1]
        return slice(-3, None) if source == "Omega" else slice(m, 2 * m)


# A second singular value above this share of the first counts as near it.
_CLOSE = 0.9
# Directions in the plane of two singular vectors: an icosahedron on the sphere of their mixtures, less the first.
_DIRECTIONS = [np.array([0.0, 1.0], dtype=np.complex128)] + [
    np.array([np.sqrt(0.5 + 0.5 * height), np.sqrt(0.5 - 0.5 * height) * np.exp(1j * np.pi * (2 * k + shift) / 5.0)])
    for height, shift in ((np.sqrt(0.2), 0), (-np.sqrt(0.2), 1))
    for k in range(5)
]

# Singular vectors u, v → a (k, m), b (k, p) with d(uᴴ X v) = a dK b.
Differential = Callable[[Responses, ComplexArray, ComplexArray], tuple[ComplexArray, ComplexArray]]


class Map(NamedTuple):
    """A map of the closed loop: its response, its differential, and whether it is from a continuous disturbance."""

    response: Callable[[Responses], ComplexArray]
    differential: Differential
    disturbed: bool = False


def row_of(left: ComplexArray, *factors: ComplexArray) -> ComplexArray:
    """Return the rows (k, n) times the matrices (k, n, ...), in this order."""
    out = left[:, None, :]
    for factor in factors:
        out = out @ factor
    return out[:, 0, :]


def column_of(*factors: ComplexArray) -> ComplexArray:
    """Return the matrices (k, ..., n) times the columns (k, n), which come last."""
    out = factors[-1][:, :, None]
    for factor in factors[-2::-1]:
        out = factor @ out
    return out[:, :, 0]


def _plus(S: ComplexArray, factor: float) -> ComplexArray:
    return S if factor == 0.0 else S + factor * np.eye(S.shape[-1])


def _at_output(direct: float, part: slice, commanded: FloatArray | None = None) -> Map:
    """Return S at some outputs, or from their commands, less the identity, and `direct` times that."""

    def right(r: Responses) -> ComplexArray:
        return r.S_output[..., part] if commanded is None else np.asarray(r.S_output @ commanded)

    return Map(
        lambda r: _plus(right(r)[..., part, :], direct - 1.0),
        lambda r, u, v: (row_of(u, r.S_output[..., part, :], r.P), column_of(right(r), v)),
    )


def _at_input(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    return row_of(u, r.S_input), column_of(r.P, r.S_input, v)


CONTROLLER = Map(lambda r: r.K, lambda r, u, v: (u, v))


def map_of(transfer: Transfer, plants: PlantSet) -> Map:
    """Return the map of a part of the closed loop; of torques over their limits see `torque_per_Omega`."""
    direct, kept = transfer.direct, slice(plants.kept)
    match transfer.source, transfer.target:
        case "noise", "angle":
            return _at_output(direct, kept)
        case "command", "angle":
            return _at_output(direct, kept, plants.commanded)
        case "torque", "torque":
            return Map(lambda r: _plus(r.S_input, direct - 1.0), _at_input)
        case "noise", "torque":
            return Map(lambda r: r.K @ r.S_output, lambda r, u, v: (row_of(u, r.S_input), column_of(r.S_output, v)))
        case "Omega", "torque":
            return Map(
                _torque_per_Omega,
                lambda r, u, v: (row_of(u, r.S_input), column_of(r.S_output, r.read[..., -3:], v)),
                True,
            )
    return _between(transfer.source, transfer.target, kept)


def helping_maps(direct: float, plants: PlantSet) -> list[Map]:
    """Return S at each of the readings that help the loop, with all others closed."""
    return [_at_output(direct, slice(i, i + 1)) for i in range(plants.kept, len(plants.angles))]


def _torque_per_Omega(r: Responses) -> ComplexArray:
    return r.K @ r.S_output @ r.read[..., -3:] + r.fed


def _between(source: str, target: str, kept: slice) -> Map:
    """Return the map from a continuous disturbance to what is measured or to the line of sight, between samples.

    Of commands in place of torques at the samples.
    """

    def sampled(r: Responses) -> bool:
        return source == "torque" and r.read.shape[-1] != 2 * r.P.shape[-1] + 3

    def response(r: Responses) -> ComplexArray:
        if sampled(r):
            return r.P[..., kept, :] @ r.S_input
        at, seen, m = r.columns(source), getattr(r, target), r.P.shape[-1]
        return np.asarray(seen[..., at] + seen[..., :m] @ (r.K @ r.S_output @ r.read[..., at]))

    def differential(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        if sampled(r):
            return _at_input(r, row_of(u, r.P[..., kept, :]), v)
        at, seen, m = r.columns(source), getattr(r, target), r.P.shape[-1]
        return row_of(u, seen[..., :m], r.S_input), column_of(r.S_output, r.read[..., at], v)

    return Map(response, differential, True)


def torque_per_Omega(k: int, plants: PlantSet) -> Map:
    """Return the map from the platform's rate, in units of the set's Omega, to torque `k` over its limit."""
    weight = plants.Omega / plants.torque_limit[k]

    def differential(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        return u * r.S_input[:, k, :], column_of(r.S_output, r.read[..., -3:], weight * v)

    return Map(lambda r: _torque_per_Omega(r)[..., k : k + 1, :] * weight, differential, True)


class Singular(NamedTuple):
    """Singular values, or mixtures of two: sizes (k,), at which points (k,), left vectors conjugated, right vectors."""

    size: FloatArray
    at: NDArray[np.intp]
    u: ComplexArray
    v: ComplexArray


def singular(X: ComplexArray) -> Singular:
    """Return the largest singular value of every matrix of a stack as smooth pieces.

    Where the second one comes near, no single one is smooth: their vectors turn within a plane. With X = U Σ Vᴴ all of
    Re((U c)ᴴ X V c), |c| = 1, are smooth, lie below the largest singular value and reach it; twelve directions c stand
    for them.
    """
    U, s, V = np.linalg.svd(X)
    close = np.flatnonzero(s[:, 1] > _CLOSE * s[:, 0]) if s.shape[1] > 1 else np.zeros(0, dtype=np.intp)
    u, v, size = [U[:, :, 0]], [V[:, 0, :].conj()], [s[:, 0]]
    at = [np.arange(len(s))]
    for c in _DIRECTIONS if len(close) else ():
        u.append(U[close, :, :2] @ c)
        v.append(V[close, :2, :].conj().swapaxes(-1, -2) @ c)
        size.append(s[close, :2] @ np.abs(c) ** 2)
        at.append(close)
    return Singular(size=np.concatenate(size), at=np.concatenate(at), u=np.concatenate(u).conj(), v=np.concatenate(v))


Numbers = NDArray[np.intp]

# Share of a limit below which a measure that should be at least that counts along the tangent.
_LEAST = 0.01


@value
class Pieces:
    """Smooth pieces."""

    ratio: FloatArray  # (k,): values; as ratios of a requirement at most 1 when it is met
    gradient: FloatArray  # (k, n_K + m, n_K + p): with respect to [[A_K, B_K], [C_K, D_K]]
    plant: Numbers  # (k,): number of the plant in the set

    def times(self, factor: float) -> Pieces:
        """Return the pieces in another unit."""
        return Pieces(ratio=factor * self.ratio, gradient=factor * self.gradient, plant=self.plant)

    def raised(self, by: float) -> Pieces:
        """Return the pieces with a larger ratio."""
        return Pieces(ratio=self.ratio + by, gradient=self.gradient, plant=self.plant)


def joined(parts: Sequence[Pieces]) -> Pieces:
    """Return all pieces of several lists."""
    return Pieces(
        ratio=np.concatenate([part.ratio for part in parts]),
        gradient=np.concatenate([part.gradient for part in parts]),
        plant=np.concatenate([part.plant for part in parts]),
    )


def at_least(measured: FloatArray, limit: float) -> tuple[FloatArray, FloatArray]:
    """Return limit/measured and its slope; near zero along the tangent, so that negative values count as worse."""
    low = _LEAST * limit
    inside = np.maximum(measured, low)
    slope = -limit / inside**2
    return limit / inside + np.minimum(measured - low, 0.0) * slope, slope


def reaching(ratio: FloatArray, counts: NDArray[np.bool_], floor: float) -> tuple[Numbers, Numbers]:
    """Return the places that count and reach `floor`, and the worst that counts."""
    masked = np.where(counts, ratio, -np.inf)
    chosen = masked >= floor
    if np.any(counts):
        chosen[np.unravel_index(int(np.argmax(masked)), masked.shape)] = True
    row, k = np.nonzero(chosen)
    return row, k


def tops(x: FloatArray, y: FloatArray, row: Numbers, k: Numbers) -> tuple[FloatArray, FloatArray]:
    """Return the tops of the parabolas through points `k` of rows of `y` and their neighbours, and the smaller spacing.

    At the ends of the grid the point itself, with a spacing of zero.
    """
    if len(x) < 3:
        return x[k], np.zeros(len(k))
    inside = (k > 0) & (k < len(x) - 1)
    j = np.clip(k, 1, len(x) - 2)
    left, right = x[j - 1] - x[j], x[j + 1] - x[j]
    fall, rise = y[row, j - 1] - y[row, j], y[row, j + 1] - y[row, j]
    # y ≈ y_j + b t + c t² through both neighbours.
    c = (fall / left - rise / right) / (left - right)
    b = fall / left - c * left
    t = np.clip(-b / np.where(c < 0.0, 2.0 * c, -np.inf), left, right)
    return np.where(inside, x[j] + t, x[k]), np.where(inside, np.minimum(right, -left), 0.0)
