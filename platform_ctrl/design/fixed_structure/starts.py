"""Searches from several starts: the structure's own values, fits to full-order controllers, and a scatter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.norms import stationary_covariance
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.minimax import Effort, Minimum, minimise
from platform_ctrl.design.fixed_structure.norm import AugmentedLoop, WorstNorm
from platform_ctrl.design.fixed_structure.structures import Parametrised
from platform_ctrl.design.partition import Partition, augmented

# Hankel singular values below this share of the largest are negligible.
_NEGLIGIBLE = 1e-7


def balanced_truncation(system: System, order: int) -> System:
    """Return the balanced truncation of a stable sampled system, by square roots (Tombs and Postlethwaite 1987).

    Fewer than `order` states are kept where Hankel singular values are negligible.
    """
    A, B, C, D, dt = system
    if not len(A):
        return system
    reach, show = (_root(stationary_covariance(a, b)) for a, b in ((A, B), (A.T, C.T)))
    U, s, V = np.linalg.svd(show.T @ reach)
    order = min(order, int(np.sum(s > _NEGLIGIBLE * s[0])))
    scale = 1.0 / np.sqrt(s[:order])
    right, left = reach @ V[:order].T * scale, (show @ U[:, :order] * scale).T
    first, into, out = (np.asarray(item, dtype=np.float64) for item in (left @ A @ right, left @ B, C @ right))
    return System(first, into, out, D, dt)


def _root(gramian: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    out: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return out


# Frequencies of a fit, and how far beyond the poles they reach.
_POINTS, _BEYOND = 60, 10.0
# Decades over which the length of random starts of gains is spread, either side of the units, and width of the scatter
# of positive numbers.
_DECADES, _SCATTER = 1.5, 0.7


def starting_points(
    structured: Parametrised, plants: Sequence[Partition], known: Sequence[System], count: int, seed: int
) -> list[FloatArray]:
    """Return `count` starts: the structure's own, fits to controllers `known` of single `plants`, and random ones."""
    rng = np.random.default_rng(seed)
    points, fits = [structured.start], []
    for plant, K in zip(plants, known, strict=True):
        try:
            fit = Fit(plant, K, structured)
            points.append(fit.everything(fit.gains(structured.start)))
            fits.append(fit)
        except (np.linalg.LinAlgError, ValueError):
            continue
    centres, positive = points[1:] or points, structured.positive
    for k in range(count - len(points)):
        drawn = rng.standard_normal(len(structured.start))
        if np.any(positive):
            x = centres[k % len(centres)] + _SCATTER * drawn * positive
            x = np.clip(x, structured.lower, structured.upper)
            points.append(fits[k % len(fits)].gains(x) if fits else x)
        else:
            x = structured.start + drawn * 10.0 ** rng.uniform(-_DECADES, _DECADES)
            points.append(np.clip(x, structured.lower, structured.upper))
    return points[:count]


class Fit:
    """Fits of a structure to a full-order controller, to first order in the closed loop.

    With L and R the loop around `full` from u to z and from w to y, T(K) ≈ T(full) + L (K − full) R: least squares of
    that difference over frequency.
    """

    def __init__(self, plant: Partition, full: System, structured: Parametrised) -> None:
        self.structured = structured
        order = len(full.A)
        loop = AugmentedLoop(augmented(plant, order), np.block([[full.A, full.B], [full.C, full.D]]))
        speeds = np.abs(np.concatenate([loop.poles, np.linalg.eigvals(plant.A)]))
        speeds = speeds[speeds > 1e-6 * speeds.max()]
        self.frequency = np.geomspace(speeds.min() / _BEYOND, _BEYOND * np.median(speeds), _POINTS)
        _, left, right = loop.responses(self.frequency)
        self.left, self.right = left[:, :, order:], right[:, order:]
        self.wanted = frequency_response(System(full.A, full.B, full.C, full.D, 0.0), self.frequency, -3)
        self._order = structured.structure.order(structured.nmeas, structured.ncon)

    def difference(self, x: FloatArray) -> FloatArray:
        """Return real and imaginary parts of the closed loops' difference."""
        M, k = self.structured.matrix(x), self._order
        try:
            K = frequency_response(System(M[:k, :k], M[:k, k:], M[k:, :k], M[k:, k:], 0.0), self.frequency, -3)
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


# Largest gains, in their units, and the share of the starts that go on with each: where the infimum lies at infinite
# gain, a search without limit runs there on a way of its own; along a limit it finds the best way first.
_STAGES = ((1e1, 1.0), (1e2, 1.0), (1e3, 0.5), (1e4, 0.25), (1e5, 0.25))
# Share of the largest number by which the first step of a stage may move it.
_FIRST = 0.1
# Most steps of a search, rounds of a start in the last stage, and the decrease that is worth another one, relative.
_STEPS, _ROUNDS, _WORTH = 300, 6, 1e-5


def rank(found: Minimum) -> tuple[bool, float]:
    """The smaller the better: stability first."""
    return not found.at.stable, found.at.largest(hard=False)


def searched(
    plants: Sequence[Partition],
    family: Parametrised,
    points: Sequence[FloatArray],
    evaluations: int,
    progress: Callable[[str], None],
) -> list[Minimum]:
    """Return where the searches from `points` end, in their order.

    Gains may grow in stages; the best starts go on with larger ones, and once more each time that it was worth it: a
    search may end at a kink that a new region and curvature lead away from.
    """
    functions = [WorstNorm(plants, family) for _ in points]
    ends: dict[int, Minimum] = {}
    left, order = evaluations, list(range(len(points)))
    for stage, (gain, share) in enumerate(_STAGES):
        chosen = order[: max(2, round(share * len(points)))]
        for n, k in enumerate(chosen):
            most = left // ((len(chosen) - n) * (len(_STAGES) - stage))
            for again in range(_ROUNDS if stage == len(_STAGES) - 1 else 1):
                before = ends.get(k)
                if before is not None and most <= 0:
                    break
                found = _within(functions[k], family, points[k] if before is None else before.x, gain, max(most, 1))
                most, left = most - found.evaluations, left - found.evaluations
                if before is None or rank(found) < rank(before):
                    ends[k] = found
                if before is not None and again and not rank(found)[1] < (1.0 - _WORTH) * rank(before)[1]:
                    break
            progress(f"structured: start {k + 1} of {len(points)}, gains to {gain:g}: {rank(ends[k])[1]:.6g}")
        order.sort(key=lambda k: rank(ends[k]))
    return [ends[k] for k in range(len(points))]


def _within(function: WorstNorm, family: Parametrised, x: FloatArray, gain: float, evaluations: int) -> Minimum:
    """Return where the search from x ends with gains up to `gain`, in their units."""
    size = float(np.abs(x[~family.positive]).max(initial=0.0))
    limits = np.where(family.positive, np.inf, max(gain, 2.0 * size))
    bounds = np.maximum(family.lower, -limits), np.minimum(family.upper, limits)
    effort = Effort(evaluations=evaluations, steps=_STEPS, radius=_FIRST * max(1.0, size), least=1e-10)
    return minimise(function, x, bounds, effort)
