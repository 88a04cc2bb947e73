"""The largest closed-loop norm over several plants as a function of a controller's free numbers."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.norm import ClosedLoop, ComplexArray
from platform_ctrl.design.partition import Partition

# Share of its distance to the stability boundary that a pole may lose in one step, to first order.
_APPROACH = 0.95
# Most frequencies that are watched though no peak is there, and how near to another one is the same.
_WATCHED, _NEAR = 12, 0.02
# Frequencies of earlier tops that the norm of a new point is looked for from.
_TOPS = 5


class Parametrisation(Protocol):
    """A controller as a function of free numbers x."""

    def matrix(self, x: FloatArray) -> FloatArray:
        """Return M = [A_K, B_K; C_K, D_K]."""

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx, (rows, columns, n)."""

    def bend(self, x: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the Hessian of sum(weight * M), (n, n)."""

    def limits(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return values (k,) and gradients (k, n) of what has to stay negative, at most one."""

    def limit_bend(self, x: FloatArray) -> FloatArray:
        """Return the Hessian of that."""


class _Point:
    def __init__(self, key: bytes, loops: list[ClosedLoop] | None) -> None:
        self.key, self.loops = key, loops
        # Plant, frequency and mixture of singular vectors of each piece.
        self._blocks: dict[tuple[int, float, int], tuple[FloatArray, ComplexArray, ComplexArray]] = {}
        self.seen: list[tuple[int, float, ComplexArray]] | None = None
        # Gradient with respect to M and Hessian of each piece that is `seen`: needed again after a refused step.
        self.bent: dict[int, tuple[FloatArray, FloatArray]] = {}

    def block(self, plant: int, frequency: float, count: int) -> tuple[FloatArray, ComplexArray, ComplexArray]:
        """Return `ClosedLoop.block`, kept."""
        assert self.loops is not None
        key = plant, frequency, count
        if key not in self._blocks:
            self._blocks[key] = self.loops[plant].block(frequency, count)
        return self._blocks[key]


class WorstNorm:
    """The H-infinity norms of all plants as pieces for `minimax.minimise`.

    Peaks down to a share `window` below the highest count.
    """

    def __init__(
        self,
        plants: Sequence[Partition],
        controller: Parametrisation,
        window: float = 0.15,
        margin: float = 0.0,
    ) -> None:
        self.plants, self.controller, self.window, self.margin = tuple(plants), controller, window, margin
        self._memory = [np.zeros(0) for _ in self.plants]
        # Where the tops of the last points were.
        self._tops = [np.zeros(0) for _ in self.plants]
        # Frequencies at which peaks have come up out of the deep.
        self._watched: list[tuple[int, float]] = []
        # The last few points: a search comes back to where a trial was refused.
        self._points: list[_Point] = []

    def loops(self, x: FloatArray) -> list[ClosedLoop] | None:
        """Return the closed loops at x; None where one is not well posed."""
        return self._at(x).loops

    def _at(self, x: FloatArray) -> _Point:
        key = x.tobytes()
        for point in self._points:
            if point.key == key:
                self._points.remove(point)
                self._points.insert(0, point)
                return point
        M = self.controller.matrix(x)
        loops = None
        if np.all(np.isfinite(M)):
            with contextlib.suppress(np.linalg.LinAlgError):
                loops = [ClosedLoop(plant, M) for plant in self.plants]
        point = _Point(key, loops)
        self._points = [point, *self._points[:3]]
        return point

    def abscissa(self, x: FloatArray) -> float:
        """Return the largest real part of the loops' poles, rad/s."""
        loops = self.loops(x)
        try:
            return np.inf if loops is None else max(loop.abscissa() for loop in loops)
        except np.linalg.LinAlgError:
            return np.inf

    def stable(self, x: FloatArray) -> bool:
        """Return whether all poles keep the margin."""
        return bool(np.max(self.stability(x)[0]) < 0.0)

    def top(self, x: FloatArray, enough: float) -> tuple[float, FloatArray]:
        """Return the largest norm and its gradient; inf where a loop is not stable by the margin.

        Above `enough` any value that a loop has somewhere serves, without gradient.
        """
        refused = np.inf, np.zeros(len(x))
        loops = self.loops(x)
        if loops is None:
            return refused
        best, frequency, worst = -np.inf, 0.0, 0
        try:
            for loop in loops:
                margin = max(self.margin, 1e-13 * float(np.abs(loop.poles).max(initial=0.0)))
                if not loop.abscissa() < -margin:
                    return refused
            for k, loop in enumerate(loops):
                level, w = loop.top(self._tops[k], enough)
                if level > best:
                    best, frequency, worst = level, w, k
                if best > enough:
                    return best, np.zeros(len(x))
                if np.isfinite(w) and not np.any(np.abs(self._tops[k] - w) <= _NEAR * w):
                    self._tops[k] = np.concatenate([[w], self._tops[k][: _TOPS - 1]])
            slope = loops[worst].slope(frequency)
        except np.linalg.LinAlgError:
            return refused
        return best, slope.ravel() @ self.controller.jacobian(x).reshape(slope.size, -1)

    def stability(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the spectral abscissas with their margin; gradients of the poles near the worst of each plant."""
        loops = self.loops(x)
        if loops is None:
            return np.array([np.inf]), np.zeros((1, len(x)))
        try:
            worst = [loop.abscissa() for loop in loops]
            top = max(worst)
            size = [float(np.abs(loop.poles).max(initial=0.0)) for loop in loops]
        except np.linalg.LinAlgError:
            return np.array([np.inf]), np.zeros((1, len(x)))
        margins = [max(self.margin, 1e-13 * one) for one in size]
        if all(w < -m for w, m in zip(worst, margins, strict=True)):
            return np.array([top]), np.zeros((1, len(x)))
        J = self.controller.jacobian(x)
        values, gradients = [], []
        for loop, one, margin in zip(loops, worst, margins, strict=True):
            if one >= top - 0.1 * max(abs(top), margin):
                found, slopes = loop.pole_pieces(0.1 * max(abs(one), margin))
                values.append(found + margin)
                gradients.append(np.einsum("kij,ijx->kx", slopes, J))
        return np.concatenate(values), np.vstack(gradients)

    def walls(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is negative inside the domain: real parts of the rightmost poles, and the chart's own limits."""
        values, gradients = self.controller.limits(x)
        loops = self.loops(x)
        if loops is None:
            return values, gradients
        J = self.controller.jacobian(x)
        for loop in loops:
            found, slopes = loop.pole_pieces(np.inf)
            margin = max(self.margin, 1e-13 * float(np.abs(loop.poles).max(initial=0.0)))
            values = np.concatenate([values, _APPROACH * (found[:6] + margin)])
            gradients = np.vstack([gradients, np.einsum("kij,ijx->kx", slopes[:6], J)])
        return values, gradients

    def wall_curvature(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the Hessian of the chart's own limits."""
        limited = len(self.controller.limits(x)[0]) > 0 and weights[0] > 0.0
        return weights[0] * self.controller.limit_bend(x) if limited else np.zeros((len(x), len(x)))

    def pieces(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the heights of all peaks near the highest and their gradients."""
        point = self._at(x)
        if point.loops is None:
            return np.array([np.inf]), np.zeros((1, len(x)))
        values, slopes = [], []
        seen: list[tuple[int, float, ComplexArray]] = []
        try:
            for k, loop in enumerate(point.loops):
                found = loop.peaks(self.window, self._memory[k])
                self._memory[k] = np.unique(found.frequency[np.isfinite(found.frequency)])
                values.append(found.values)
                slopes.append(found.gradients)
                for w, i in zip(found.frequency, found.index, strict=True):
                    count = int(np.sum(found.frequency == w))
                    seen.append((k, float(w), np.eye(count, dtype=np.complex128)[i]))
        except np.linalg.LinAlgError:
            return np.array([np.inf]), np.zeros((1, len(x)))
        value = np.concatenate(values)
        near = value >= (1.0 - self.window) * value.max()
        point.seen, point.bent = [one for one, close in zip(seen, near, strict=True) if close], {}
        slope = np.einsum("kij,ijx->kx", np.concatenate(slopes)[near], self.controller.jacobian(x))
        more, steep = self._at_watched(x, self._watched)
        return np.concatenate([value[near], more]), np.vstack([slope, steep])

    def _at_watched(self, x: FloatArray, watched: list[tuple[int, float]]) -> tuple[FloatArray, FloatArray]:
        """Return the largest singular values at watched frequencies where no piece is near."""
        point = self._at(x)
        values: list[float] = []
        slopes: list[FloatArray] = []
        if point.loops is not None and point.seen is not None and watched:
            J = self.controller.jacobian(x)
            for k, w in watched:
                if any(k == j and abs(w - v) <= _NEAR * w for j, v, _ in point.seen):
                    continue
                S, a, b = point.block(k, w, 1)
                values.append(float(S[0]))
                slopes.append(np.einsum("ij,ijx->x", np.real(np.outer(a[:, 0].conj(), b[:, 0])), J))
                point.seen.append((k, w, np.ones(1, dtype=np.complex128)))
        return np.array(values), np.array(slopes).reshape(len(values), len(x))

    def watch(self, x: FloatArray, refused: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return further pieces at x: at the frequencies of peaks that made a trial point be refused."""
        here, trial = self._at(x).seen, self._at(refused).seen
        if here is None or trial is None:
            return np.zeros(0), np.zeros((0, len(x)))
        known = [(k, w) for k, w, _ in here]
        new: list[tuple[int, float]] = []
        for k, w, _ in trial:
            if np.isfinite(w) and not any(k == j and abs(w - v) <= _NEAR * w for j, v in known + new):
                new.append((k, w))
        self._watched = [*self._watched, *new][-_WATCHED:]
        return self._at_watched(x, new)

    def sharpened(self, x: FloatArray, move: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return further pieces at x: of singular values near each other the mixture that a move makes largest."""
        point = self._at(x)
        values: list[float] = []
        slopes: list[FloatArray] = []
        if point.loops is None or point.seen is None:
            return np.zeros(0), np.zeros((0, len(x)))
        J = self.controller.jacobian(x)
        dM = J @ move
        for k, frequency, count in sorted({(k, w, len(mix)) for k, w, mix in point.seen if len(mix) > 1}):
            S, a, b = point.block(k, frequency, count)
            P = a.conj().T @ dM @ b
            mix = np.linalg.eigh(np.diag(S) + 0.5 * (P + P.conj().T))[1][:, -1]
            values.append(float(np.abs(mix) ** 2 @ S))
            slopes.append(np.einsum("ij,ijx->x", np.real(np.outer((a @ mix).conj(), b @ mix)), J))
            point.seen.append((k, frequency, mix))
        return np.array(values), np.array(slopes).reshape(len(values), len(x))

    def curvature(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the Hessian of the weighted pieces that `pieces` returned at x."""
        point = self._at(x)
        if point.seen is None:
            self.pieces(x)
        J = self.controller.jacobian(x)
        H = np.zeros((len(x), len(x)))
        if point.loops is None or point.seen is None:
            return H
        G = np.zeros(J.shape[:2])
        for i in map(int, np.flatnonzero(weights > 1e-6)):
            if i not in point.bent:
                k, frequency, mix = point.seen[i]
                point.bent[i] = point.loops[k].curvature(frequency, mix, J)
            gradient, bent = point.bent[i]
            G += weights[i] * gradient
            H += weights[i] * bent
        return H + self.controller.bend(x, G)


# A direct term above this share of the plant's own direct terms makes the norm infinite.
_ROUNDING = 1e-9


class WorstPower:
    """The H2 norms of all plants as pieces for `minimax.minimise`, one a plant."""

    def __init__(self, plants: Sequence[Partition], controller: Parametrisation) -> None:
        self.plants, self.controller = tuple(plants), controller

    def pieces(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the norms and their gradients; inf where the loop has a direct term or is not stable."""
        refused = np.array([np.inf]), np.zeros((1, len(x)))
        M, J = self.controller.matrix(x), self.controller.jacobian(x)
        values, slopes = [], []
        for plant in self.plants:
            try:
                found = _norm(ClosedLoop(plant, M))
            except np.linalg.LinAlgError:
                return refused
            if found is None:
                return refused
            values.append(found[0])
            slopes.append(np.einsum("ij,ijx->x", found[1], J))
        return np.array(values), np.array(slopes)


def _norm(loop: ClosedLoop) -> tuple[float, FloatArray] | None:
    """Return the norm and its gradient with respect to M."""
    from scipy.linalg import solve_continuous_lyapunov

    plant = loop.plant
    size = max(float(np.abs(plant.D11).max(initial=0.0)), float(np.abs(plant.D12).max(initial=0.0)), 1e-300)
    if np.abs(loop.D).max(initial=0.0) > _ROUNDING * size or not loop.abscissa() < 0.0:
        return None
    X = solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)
    Y = solve_continuous_lyapunov(loop.A.T, -loop.C.T @ loop.C)
    square = float(np.trace(loop.C @ X @ loop.C.T))
    if not (np.isfinite(square) and square > 0.0):
        return None
    norm = float(np.sqrt(square))
    # d(norm²) = 2 tr(Y X dA') + 2 tr(Y B dB') + 2 tr(C X dC'), and dA = B2 dM C2, dB = B2 dM D21, dC = D12 dM C2.
    into = loop.B2.T @ (Y @ X @ loop.C2.T + Y @ loop.B @ loop.D21.T)
    return norm, np.asarray((into + loop.D12.T @ loop.C @ X @ loop.C2.T) / norm)


class Rescaled:
    """Another parametrisation at x = centre + size * y."""

    def __init__(self, inner: Parametrisation, centre: FloatArray, size: FloatArray) -> None:
        self.inner, self.centre, self.size = inner, centre, size

    def outer(self, y: FloatArray) -> FloatArray:
        """Return x."""
        return self.centre + self.size * y

    def within(self, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds of x as bounds of y."""
        return (lower - self.centre) / self.size, (upper - self.centre) / self.size

    def matrix(self, y: FloatArray) -> FloatArray:
        """Return M."""
        return self.inner.matrix(self.outer(y))

    def jacobian(self, y: FloatArray) -> FloatArray:
        """Return dM/dy."""
        return self.inner.jacobian(self.outer(y)) * self.size

    def bend(self, y: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the Hessian of sum(weight * M)."""
        return self.inner.bend(self.outer(y), weight) * self.size[:, None] * self.size

    def limits(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the limits of the inner parametrisation."""
        values, gradients = self.inner.limits(self.outer(y))
        return values, gradients * self.size

    def limit_bend(self, y: FloatArray) -> FloatArray:
        """Return the Hessian of the limit."""
        return self.inner.limit_bend(self.outer(y)) * self.size[:, None] * self.size


def step_sizes(values: FloatArray, gradients: FloatArray) -> FloatArray:
    """Return, coordinate by coordinate, the step that changes some piece by the largest value; at most one."""
    steep = np.abs(gradients).max(axis=0) / max(float(np.abs(values).max()), 1e-300)
    return np.asarray(1.0 / np.maximum(steep, 1.0))
