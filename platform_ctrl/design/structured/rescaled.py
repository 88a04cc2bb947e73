"""Search coordinates in which no direction is steep: the trust region is a box, and it should fit."""

from __future__ import annotations

import numpy as np

from platform_ctrl.design.structured.objective import Parametrisation
from platform_ctrl.frozen import FloatArray


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
