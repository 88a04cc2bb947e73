"""Where searches begin: the structure's own values, fits to the full-order controller, and a scatter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.norms import stationary_covariance
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.norm import ClosedLoop, augmented
from platform_ctrl.design.fixed_structure.parametrised import Parametrised
from platform_ctrl.design.partition import Partition

# Hankel singular values below this share of the largest say nothing.
_NEGLIGIBLE = 1e-7


def balanced_truncation(system: StateArrays, order: int, negligible: float = _NEGLIGIBLE) -> StateArrays:
    """Return the balanced truncation of a stable system, by square roots (Tombs and Postlethwaite 1987).

    Parameters
    ----------
    system
        Stable.
    order
        Most states that are kept: fewer where the others are negligible.
    negligible
        Share of the largest Hankel singular value below which a state is left out.
    """
    A, B, C, D, dt = system
    if not len(A):
        return system
    reach, show = (_root(_gramian(a, b, dt > 0.0)) for a, b in ((A, B), (A.T, C.T)))
    U, s, V = np.linalg.svd(show.T @ reach)
    order = min(order, int(np.sum(s > negligible * s[0])))
    scale = 1.0 / np.sqrt(s[:order])
    right, left = reach @ V[:order].T * scale, (show @ U[:, :order] * scale).T
    first, into, out = (np.asarray(item, dtype=np.float64) for item in (left @ A @ right, left @ B, C @ right))
    return StateArrays(first, into, out, D, dt)


def _gramian(A: FloatArray, B: FloatArray, sampled: bool) -> FloatArray:
    """Return X = A X A' + B B', or A X + X A' + B B' = 0."""
    if sampled:
        return stationary_covariance(A, B)
    from scipy.linalg import solve_continuous_lyapunov

    return np.asarray(solve_continuous_lyapunov(A, -B @ B.T), dtype=np.float64)


def _root(gramian: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    out: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return out


# Frequencies of a fit, and how far beyond the poles they reach.
_POINTS, _BEYOND = 60, 10.0
# Decades over which the size of random starts is spread, either side of the units.
_DECADES = 1.5
# Hankel singular values below this share of the largest are rounding.
_ROUNDING = 1e-12
# Width of the scatter about a good start, in search coordinates.
_SCATTER = 0.7


def truncated(K: StateArrays, order: int) -> StateArrays | None:
    """Return the balanced truncation of a stable continuous controller to `order` states; None where there is none."""
    if order >= len(K.A):
        return K if order == len(K.A) else None
    if np.max(np.linalg.eigvals(K.A).real, initial=-np.inf) >= 0.0:
        return None
    try:
        less = balanced_truncation(K, order, _ROUNDING)
    except np.linalg.LinAlgError:
        return None
    return less if len(less.A) == order else None


class Fit:
    """Fits of a structure to a full-order controller, to first order in the closed loop.

    With L and R the loop around `full` from u to z and from w to y, T(K) ≈ T(full) + L (K − full) R: least squares of
    that difference over frequency.
    """

    def __init__(self, plant: Partition, full: StateArrays, structured: Parametrised) -> None:
        self.structured = structured
        order = len(full.A)
        loop = ClosedLoop(augmented(plant, order), np.block([[full.A, full.B], [full.C, full.D]]))
        speeds = np.abs(np.concatenate([loop.poles, np.linalg.eigvals(plant.A)]))
        speeds = speeds[speeds > 1e-6 * speeds.max()]
        self.frequency = np.geomspace(speeds.min() / _BEYOND, _BEYOND * np.median(speeds), _POINTS)
        seen = [loop.responses(float(w)) for w in self.frequency]
        self.left = np.array([L[:, order:] for _, L, _, _ in seen])
        self.right = np.array([R[order:] for _, _, R, _ in seen])
        self.wanted = frequency_response(StateArrays(full.A, full.B, full.C, full.D, 0.0), self.frequency, -3)
        self._order = structured.structure.order(structured.nmeas, structured.ncon)

    def difference(self, x: FloatArray) -> FloatArray:
        """Return real and imaginary parts of the closed loops' difference."""
        M, k = self.structured.matrix(x), self._order
        try:
            K = frequency_response(StateArrays(M[:k, :k], M[:k, k:], M[k:, :k], M[k:, k:], 0.0), self.frequency, -3)
            error = (self.left @ (K - self.wanted) @ self.right).ravel()
        except (np.linalg.LinAlgError, ArithmeticError):
            error = np.full(self.left.shape[0] * self.left.shape[1] * self.right.shape[2], np.inf, dtype=complex)
        out = np.concatenate([error.real, error.imag])
        return np.where(np.isfinite(out), out, 1e6)

    def gains(self, x: FloatArray) -> FloatArray:
        """Return x with the numbers that enter affinely fitted, the positive ones kept."""
        affine = ~self.structured.positive
        base = x.copy()
        base[affine] = 0.0
        at = self.difference(base)
        columns = []
        for k in np.flatnonzero(affine):
            one = base.copy()
            one[k] = 1.0
            columns.append(self.difference(one) - at)
        if not columns:
            return x
        out = base
        out[affine] = np.linalg.lstsq(np.array(columns).T, -at, rcond=1e-12)[0]
        return np.clip(out, self.structured.lower, self.structured.upper)

    def everything(self, start: FloatArray) -> FloatArray:
        """Return all numbers fitted, from `start` on."""
        from scipy.optimize import least_squares

        low, high = self.structured.lower, self.structured.upper
        room = 1e-9 * np.maximum(1.0, np.abs(start))
        found = least_squares(
            self.difference, np.clip(start, low + room, high - room), bounds=(low, high), x_scale="jac", max_nfev=60
        )
        return np.clip(np.asarray(found.x, dtype=np.float64), low, high)


def fits(
    plants: Sequence[Partition], known: Sequence[StateArrays], structured: Parametrised
) -> list[tuple[Fit, FloatArray]]:
    """Return a fit to each known full-order controller, and what it found; those that have none are left out."""
    out = []
    for plant, K in zip(plants, known, strict=True):
        try:
            fit = Fit(plant, K, structured)
            out.append((fit, fit.everything(fit.gains(structured.start))))
        except (np.linalg.LinAlgError, ValueError):
            continue
    return out


def scattered(count: int, size: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return points of random direction and of lengths spread over decades about one."""
    return [rng.standard_normal(size) * 10.0 ** rng.uniform(-_DECADES, _DECADES) for _ in range(count)]


def around(centre: FloatArray, fit: Fit | None, rng: np.random.Generator, structured: Parametrised) -> FloatArray:
    """Return a point about a centre: positive numbers scattered, the others fitted again or scattered too."""
    drawn = rng.standard_normal(centre.size)
    x = np.clip(centre + _SCATTER * drawn * structured.positive, structured.lower, structured.upper)
    if fit is not None and structured.positive.any():
        return fit.gains(x)
    width = _SCATTER * np.maximum(0.1, np.abs(centre))
    return np.clip(np.where(structured.positive, x, centre + width * drawn), structured.lower, structured.upper)
