"""Maps of a closed loop at single frequencies: S, T, P S, K and others, with their differentials by the controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis import loop_set
from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.loop_set import Transfer
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.values import FloatArray


class Responses(NamedTuple):
    """Plant, controller, sensitivities, platform rate → what is measured, and torques and platform rate → sight.

    Each complex (..., rows, columns). `fed`: platform rate → torques that feedforward adds, where it does.
    """

    P: ComplexArray
    K: ComplexArray
    S_output: ComplexArray
    S_input: ComplexArray
    P_Omega: ComplexArray
    sight: ComplexArray
    fed: ComplexArray


# Singular vectors u, v → a (k, m), b (k, p) with d(uᴴ X v) = a dK b.
Differential = Callable[[Responses, ComplexArray, ComplexArray], tuple[ComplexArray, ComplexArray]]


class Map(NamedTuple):
    """A map of the closed loop: its response and its differential."""

    response: Callable[[Responses], ComplexArray]
    differential: Differential


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


def _at_output(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    return row_of(u, r.S_output, r.P), column_of(r.S_output, v)


def _at_input(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    return row_of(u, r.S_input), column_of(r.P, r.S_input, v)


CONTROLLER = Map(lambda r: r.K, lambda r, u, v: (u, v))


def map_of(transfer: Transfer) -> Map:
    """Return the map of a part of the closed loop; of torques over their limits see `torque_per_Omega`."""
    direct = transfer.direct
    match transfer.source, transfer.target:
        case "noise" | "command", "angle":
            return Map(lambda r: _plus(r.S_output, direct - 1.0), _at_output)
        case "torque", "torque":
            return Map(lambda r: _plus(r.S_input, direct - 1.0), _at_input)
        case "torque", "angle":
            return Map(lambda r: r.P @ r.S_input, lambda r, u, v: _at_input(r, row_of(u, r.P), v))
        case "Omega", "angle":
            return Map(lambda r: r.S_output @ r.P_Omega, lambda r, u, v: _at_output(r, u, column_of(r.P_Omega, v)))
        case "noise", "torque":
            return Map(lambda r: r.K @ r.S_output, lambda r, u, v: (row_of(u, r.S_input), column_of(r.S_output, v)))
        case "Omega", "torque":
            return Map(
                _torque_per_Omega,
                lambda r, u, v: (row_of(u, r.S_input), column_of(r.S_output, r.P_Omega, v)),
            )
    return Map(_sight_per_Omega, _at_sight)


def _torque_per_Omega(r: Responses) -> ComplexArray:
    return r.K @ r.S_output @ r.P_Omega + r.fed


def _sight_per_Omega(r: Responses) -> ComplexArray:
    m = r.P.shape[-1]
    return r.sight[..., m:] + r.sight[..., :m] @ (r.K @ r.S_output @ r.P_Omega)


def _at_sight(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    return row_of(u, r.sight[..., : r.P.shape[-1]], r.S_input), column_of(r.S_output, r.P_Omega, v)


S_OUTPUT, S_INPUT = map_of(loop_set.S_OUTPUT), map_of(loop_set.S_INPUT)


def torque_per_Omega(k: int, plants: PlantSet) -> Map:
    """Return the map from the platform's rate, in units of the set's Omega, to torque `k` over its limit."""
    weight = plants.Omega / plants.torque_limit[k]

    def differential(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        return u * r.S_input[:, k, :], column_of(r.S_output, r.P_Omega, weight * v)

    return Map(lambda r: _torque_per_Omega(r)[..., k : k + 1, :] * weight, differential)


def both_sensitivities(P: ComplexArray, K: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return S at the output, (I − P K)⁻¹, and at the input, (I − K P)⁻¹ = I + K S P."""
    S = inverse(np.eye(P.shape[-2]) - P @ K)
    return S, np.eye(P.shape[-1]) + K @ S @ P


def inverse(X: ComplexArray) -> ComplexArray:
    """Return the inverses of a stack of matrices; by hand where they are small."""
    if X.shape[-1] == 1:
        return np.asarray(1.0 / X)
    if X.shape[-1] == 2:
        a, b, c, d = X[..., 0, 0], X[..., 0, 1], X[..., 1, 0], X[..., 1, 1]
        out = np.empty_like(X)
        out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = d, -b, -c, a
        return np.asarray(out / (a * d - b * c)[..., None, None])
    return np.asarray(np.linalg.inv(X), dtype=np.complex128)


def largest(X: ComplexArray) -> FloatArray:
    """Return the largest singular values of a stack of matrices; beyond 2 x 2 a bound a few per cent above."""
    if X.shape[-1] == 1 or X.shape[-2] == 1:
        return np.asarray(np.sqrt(np.sum(np.abs(X) ** 2, axis=(-2, -1))))
    if X.shape[-2:] == (2, 2):
        square = np.sum(np.abs(X) ** 2, axis=(-2, -1))
        det = np.abs(X[..., 0, 0] * X[..., 1, 1] - X[..., 0, 1] * X[..., 1, 0])
        return np.asarray(np.sqrt(0.5 * (square + np.sqrt(np.maximum(square**2 - 4.0 * det**2, 0.0)))))
    gram = X.conj().swapaxes(-1, -2) @ X if X.shape[-1] <= X.shape[-2] else X @ X.conj().swapaxes(-1, -2)
    # Schatten norm of order 16: (Σ σ¹⁶)^(1/16).
    size = np.real(np.trace(gram, axis1=-2, axis2=-1))
    power = gram / np.maximum(size, 1e-300)[..., None, None]
    for _ in range(2):
        power = power @ power
    return np.asarray(np.sqrt(size) * np.sum(np.abs(power) ** 2, axis=(-2, -1)) ** (1.0 / 16.0))
