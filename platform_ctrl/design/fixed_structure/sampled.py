"""Structures of sampled controllers, for the loops of a job: another structure sampled, or built from named numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.structures import Given, Parameter, Structure, Units, joined

# Relative step of the differences that replace it where a function takes real numbers alone.
_STEP = 1e-5


@value
class Sampled(Structure):
    """A sampled structure in other directions: u = basisᵀ K basis y.

    Attributes
    ----------
    inner
        In the w-plane or in (z − 1)/period, in the directions that the rows of `basis` are.
    period
        s.
    basis : (n, n)
        Orthogonal.
    forward
        Whether s stands for (z − 1)/period, and not for Tustin's rule: then the sampled matrices are affine in those of
        `inner`. Tustin's states are those of the trapezium rule.
    """

    inner: Structure
    period: float
    basis: FloatArray
    forward: bool = False

    @property
    def given(self) -> Given:
        """Everything that was given for the structure inside."""
        return self.inner.given

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return those of the structure inside."""
        return self.inner.parameters(nmeas, ncon, units)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return the sampled block."""
        A, B, C, D, _ = self.inner.block(p, nmeas, ncon)
        half, eye = 0.5 * self.period * (not self.forward), np.eye(A.shape[-1])
        inverse = np.linalg.inv(eye - half * A)
        into, out = inverse @ B @ self.basis, self.basis.T @ C
        direct = self.basis.T @ D @ self.basis + half * out @ into
        return StateArrays(
            inverse @ (eye + (self.period - half) * A), self.period * into, out @ inverse, direct, self.period
        )


@value
class Named(Structure):
    """A controller that a function builds from positive numbers with names, as the classical design does.

    Attributes
    ----------
    build
        Numbers by name → A, B, C, D; real numbers alone, smooth in them.
    values
        All numbers. What is not to be moved is held by `fixed`.
    largest
        Upper bounds of some.
    """

    build: Callable[[dict[str, float]], StateArrays]
    values: Mapping[str, float]
    largest: Mapping[str, float]

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the numbers."""
        return tuple(
            Parameter(name=name, start=number, size=1.0, positive=True, lower=0.0, upper=self.largest.get(name, np.inf))
            for name, number in self.values.items()
        )

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return what the function builds."""
        return self.build(dict(zip(self.values, map(float, p), strict=True)))

    def slopes(self, p: FloatArray, nmeas: int, ncon: int) -> FloatArray:
        """Return the derivatives by central differences: the function takes real numbers alone."""
        out = []
        for k, number in enumerate(p):
            high, low = (p.copy() for _ in range(2))
            high[k], low[k] = number * np.exp(_STEP), number * np.exp(-_STEP)
            change = joined(self.block(high, nmeas, ncon)) - joined(self.block(low, nmeas, ncon))
            out.append(change / (2.0 * _STEP * number))
        return np.stack(out, axis=-1)
