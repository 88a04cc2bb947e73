"""Where searches begin: the structure's own values, fits to the full-order controller, and a scatter."""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.response import frequency_response_arrays
from platform_ctrl.design.partition import Partition, Realisation
from platform_ctrl.design.structured.norm import ClosedLoop, augmented
from platform_ctrl.design.structured.parametrised import Parametrised
from platform_ctrl.frozen import FloatArray

# Frequencies of a fit, and how far beyond the poles they reach.
_POINTS, _BEYOND = 60, 10.0
# Decades over which the size of random starts is spread, either side of the units.
_DECADES = 1.5
# Width of the scatter about a good start, in search coordinates.
_SCATTER = 0.7


def truncated(K: Realisation, order: int) -> Realisation | None:
    """Return the balanced truncation of a stable controller to `order` states; None where there is none."""
    from scipy.linalg import solve_continuous_lyapunov

    if order >= len(K.A):
        return K if order == len(K.A) else None
    if np.max(np.linalg.eigvals(K.A).real, initial=-np.inf) >= 0.0:
        return None
    try:
        reach = solve_continuous_lyapunov(K.A, -K.B @ K.B.T)
        sight = solve_continuous_lyapunov(K.A.T, -K.C.T @ K.C)
        left, right = _root(reach), _root(sight)
        U, S, Vh = np.linalg.svd(right.T @ left)
    except np.linalg.LinAlgError:
        return None
    if S[order - 1] <= 1e-12 * S[0]:
        return None
    scale = 1.0 / np.sqrt(S[:order])
    into, out = (right @ U[:, :order] * scale).T, left @ Vh[:order].T * scale
    return Realisation(A=into @ K.A @ out, B=into @ K.B, C=K.C @ out, D=K.D)


def _root(gramian: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def fitted(plant: Partition, full: Realisation, structured: Parametrised, start: FloatArray) -> FloatArray | None:
    """Return the numbers whose closed loop differs least from that of the full-order controller, to first order.

    With L and R the loop around `full` from u to z and from w to y, T(K) ≈ T(full) + L (K − full) R: least squares of
    that difference over frequency.
    """
    from scipy.optimize import least_squares

    order = len(full.A)
    try:
        loop = ClosedLoop(augmented(plant, order), np.block([[full.A, full.B], [full.C, full.D]]))
        speeds = np.abs(np.concatenate([loop.poles, np.linalg.eigvals(plant.A)]))
        speeds = speeds[speeds > 1e-6 * speeds.max()]
        frequency = np.geomspace(speeds.min() / _BEYOND, _BEYOND * np.median(speeds), _POINTS)
        seen = [loop.responses(float(w)) for w in frequency]
    except np.linalg.LinAlgError:
        return None
    left = np.array([L[:, order:] for _, L, _, _ in seen])
    right = np.array([R[order:] for _, _, R, _ in seen])
    wanted = frequency_response_arrays(full.A, full.B, full.C, full.D, 0.0, frequency)
    k = structured.structure.order(structured.nmeas, structured.ncon)

    def difference(x: FloatArray) -> FloatArray:
        M = structured.matrix(x)
        try:
            K = frequency_response_arrays(M[:k, :k], M[:k, k:], M[k:, :k], M[k:, k:], 0.0, frequency)
        except (np.linalg.LinAlgError, ArithmeticError):
            return np.full(2 * left.shape[0] * left.shape[1] * right.shape[2], 1e6)
        error = (left @ (K - wanted) @ right).ravel()
        error = np.where(np.isfinite(error), error, 1e6)
        return np.concatenate([error.real, error.imag])

    low, high = np.maximum(structured.lower, start - 20.0), np.minimum(structured.upper, start + 20.0)
    low = np.where(structured.lower == -np.inf, -np.inf, low)
    high = np.where(structured.upper == np.inf, np.inf, high)
    inside = np.clip(start, np.where(np.isfinite(low), low + 1e-9, low), np.where(np.isfinite(high), high - 1e-9, high))
    try:
        found = least_squares(difference, inside, bounds=(low, high), x_scale="jac", max_nfev=60)
    except (ValueError, np.linalg.LinAlgError):
        return None
    return np.clip(np.asarray(found.x, dtype=np.float64), structured.lower, structured.upper)


def scattered(count: int, size: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return points of random direction and of lengths spread over decades about one."""
    return [rng.standard_normal(size) * 10.0 ** rng.uniform(-_DECADES, _DECADES) for _ in range(count)]


def around(centre: FloatArray, count: int, rng: np.random.Generator, structured: Parametrised) -> list[FloatArray]:
    """Return points about a centre, within the bounds."""
    width = _SCATTER * np.maximum(1.0, 0.3 * np.abs(centre))
    drawn = [centre + width * rng.standard_normal(centre.size) for _ in range(count)]
    return [np.clip(x, structured.lower, structured.upper) for x in drawn]
