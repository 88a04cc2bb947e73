"""The largest closed-loop norm over several plants as a function of a controller's free numbers."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from platform_ctrl.design.partition import Partition
from platform_ctrl.design.structured.norm import ClosedLoop
from platform_ctrl.frozen import FloatArray

# Share of its distance to the stability boundary that a pole may lose in one step, to first order.
_APPROACH = 0.95


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
    def __init__(self, x: FloatArray, loops: list[ClosedLoop] | None) -> None:
        self.x, self.loops = x, loops
        self.seen: list[tuple[int, float, int]] | None = None  # plant, frequency and number of each piece


class WorstNorm:
    """The H-infinity norms of all plants as pieces for `minimax.minimise`.

    Attributes
    ----------
    window
        How far below the highest peak a peak still counts, relative.
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
        # The last few points: a search comes back to where a trial was refused.
        self._points: list[_Point] = []

    def loops(self, x: FloatArray) -> list[ClosedLoop] | None:
        """Return the closed loops at x; None where one is not well posed."""
        return self._at(x).loops

    def _at(self, x: FloatArray) -> _Point:
        for point in self._points:
            if np.array_equal(point.x, x):
                self._points.remove(point)
                self._points.insert(0, point)
                return point
        M = self.controller.matrix(x)
        loops = None
        if np.all(np.isfinite(M)):
            with contextlib.suppress(np.linalg.LinAlgError):
                loops = [ClosedLoop(plant, M) for plant in self.plants]
        point = _Point(x.copy(), loops)
        self._points = [point, *self._points[:3]]
        return point

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
        seen: list[tuple[int, float, int]] = []
        try:
            for k, loop in enumerate(point.loops):
                found = loop.peaks(self.window, self._memory[k])
                self._memory[k] = np.unique(found.frequency[np.isfinite(found.frequency)])
                values.append(found.values)
                slopes.append(found.gradients)
                seen += [(k, float(w), int(i)) for w, i in zip(found.frequency, found.index, strict=True)]
        except np.linalg.LinAlgError:
            return np.array([np.inf]), np.zeros((1, len(x)))
        value = np.concatenate(values)
        near = value >= (1.0 - self.window) * value.max()
        point.seen = [one for one, close in zip(seen, near, strict=True) if close]
        return value[near], np.einsum("kij,ijx->kx", np.concatenate(slopes)[near], self.controller.jacobian(x))

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
        for weight, (k, frequency, index) in zip(weights, point.seen, strict=True):
            if weight > 1e-6:
                gradient, bent = point.loops[k].curvature(frequency, index, J)
                G += weight * gradient
                H += weight * bent
        return H + self.controller.bend(x, G)
