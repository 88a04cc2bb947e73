"""Structures on every signal, lead and notch, in series, sampled for a job, or built from named numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray, input_value, value
from platform_ctrl.design.fixed_structure.structures import Given, Parameter, Structure, Units, joined, zeros
from platform_ctrl.errors import ArgumentError


@input_value
class Lead(Structure):
    """(s/zero + 1)/(s/pole + 1) on every signal; parameters zero1, pole1, ... with the block's name before them.

    Attributes
    ----------
    name
        Put before the names of the parameters, where there are several such blocks.
    start, bounds, fixed, tied
        As in `Structure`.
    """

    name: str = "lead"

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return corner frequencies, rad/s."""
        rate = units.rate
        return tuple(
            Parameter(
                name=f"{self.name}_{word}{j + 1}",
                start=start * rate,
                size=1.0,
                positive=True,
                lower=1e-4 * rate,
                upper=1e6 * rate,
            )
            for word, start in (("zero", 0.5), ("pole", 5.0))
            for j in range(nmeas)
        )

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the diagonal block."""
        zeros_at, poles_at = np.split(p, 2, axis=-1)
        pole, ratio = (number[..., None] * np.eye(nmeas) for number in (poles_at, poles_at / zeros_at))
        # (s/z + 1)/(s/q + 1) = q/z + q (1 − q/z)/(s + q)
        return System(-pole, pole, np.eye(nmeas) - ratio, ratio)


@input_value
class Notch(Structure):
    """(s² + 2 depth width f s + f²)/(s² + 2 width f s + f²) on every signal.

    Parameters notch_frequency1, ... (f, rad/s), notch_depth1, ..., notch_width1, ...

    Attributes
    ----------
    name
        Put before the names of the parameters in place of "notch".
    start, bounds, fixed, tied
        As in `Structure`.
    """

    name: str = "notch"

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return frequency, depth and width of every notch."""
        rate = units.rate
        ranges = (("frequency", rate, 1e-3 * rate, 1e4 * rate), ("depth", 0.7, 1e-2, 10.0), ("width", 0.3, 1e-2, 10.0))
        return tuple(
            Parameter(name=f"{self.name}_{word}{j + 1}", start=start, size=1.0, positive=True, lower=low, upper=high)
            for word, start, low, high in ranges
            for j in range(nmeas)
        )

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the diagonal block, two states a signal."""
        m = nmeas
        f, depth, width = np.split(p, 3, axis=-1)
        A, B, C, D = zeros(p, 2 * m, 2 * m), zeros(p, 2 * m, m), zeros(p, m, 2 * m), zeros(p, m, m)
        k = np.arange(m)
        first, second = 2 * k, 2 * k + 1
        # States in units of f: x1' = f x2, x2' = f (y − x1 − 2 width x2);  out = y + 2 width (depth − 1) x2.
        A[..., first, second], A[..., second, first], A[..., second, second] = f, -f, -2.0 * width * f
        B[..., second, k], C[..., k, second], D[..., k, k] = f, 2.0 * width * (depth - 1.0), 1.0
        return System(A, B, C, D)


@input_value
class Series(Structure):
    """Structures one after another; the first ones keep the number of signals, the last one makes u.

    Attributes
    ----------
    blocks
        From y to u, for example (Notch(), PID()).
    start, bounds, fixed, tied
        As in `Structure`; what is given here overrides what a block has.
    """

    blocks: Sequence[Structure]

    @property
    def given(self) -> Given:
        """Everything that was given by name here or in a block; here overrides the block."""
        start, bounds, fixed, tied = dict(self.start), dict(self.bounds), dict(self.fixed), tuple(self.tied)
        for one in self.blocks:
            inner = one.given
            start, bounds, fixed = inner.start | start, inner.bounds | bounds, inner.fixed | fixed
            tied += inner.tied
        return Given(start, bounds, fixed, tied)

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return those of all blocks."""
        if not self.blocks:
            raise ArgumentError("Series: there must be at least one block, got none")
        out: list[Parameter] = []
        for k, one in enumerate(self.blocks):
            out += one.parameters(nmeas, ncon if k == len(self.blocks) - 1 else nmeas, units)
        names = [one.name for one in out]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ArgumentError(f"Series: two parameters are called {twice[0]!r}; give the blocks different names")
        return tuple(out)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the blocks in series."""
        units = Units(gain=np.ones((ncon, nmeas)), rate=1.0)
        out = System(zeros(p, 0, 0), zeros(p, 0, nmeas), zeros(p, nmeas, 0), zeros(p, nmeas, nmeas) + np.eye(nmeas))
        for k, one in enumerate(self.blocks):
            outputs = ncon if k == len(self.blocks) - 1 else nmeas
            count = len(one.parameters(nmeas, outputs, units))
            a, b, c, d, _ = one.block(p[..., :count], nmeas, outputs)
            A = np.block([[out.A, zeros(p, out.A.shape[-1], a.shape[-1])], [b @ out.C, a]])
            B, C = np.concatenate([out.B, b @ out.D], axis=-2), np.concatenate([d @ out.C, c], axis=-1)
            out, p = System(A, B, C, d @ out.D), p[..., count:]
        return out


# Relative step of the differences that replace it where a function takes real numbers alone.
_STEP = 1e-5


@value
class Sampled(Structure):
    """A sampled structure in other directions: u = basisᵀ K basis y."""

    inner: Structure  # in the w-plane or in (z − 1)/period, in the directions that the rows of `basis` are
    period: float  # s
    basis: FloatArray  # (n, n): orthogonal
    # Whether s is (z − 1)/period, and not Tustin's rule: then the sampled matrices are affine in those of `inner`.
    # Tustin's states are those of the trapezium rule.
    forward: bool = False

    @property
    def given(self) -> Given:
        """Everything that was given for the structure inside."""
        return self.inner.given

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return those of the structure inside."""
        return self.inner.parameters(nmeas, ncon, units)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the sampled block."""
        A, B, C, D, _ = self.inner.block(p, nmeas, ncon)
        half, eye = 0.5 * self.period * (not self.forward), np.eye(A.shape[-1])
        inverse = np.linalg.inv(eye - half * A)
        into, out = inverse @ B @ self.basis, self.basis.T @ C
        direct = self.basis.T @ D @ self.basis + half * out @ into
        return System(
            inverse @ (eye + (self.period - half) * A), self.period * into, out @ inverse, direct, self.period
        )


@value
class Named(Structure):
    """A controller that a function builds from positive numbers with names, as the classical design does."""

    build: Callable[[dict[str, float]], System]  # numbers by name → A, B, C, D; real numbers alone, smooth in them
    values: Mapping[str, float]  # all numbers; those in `fixed` do not change
    largest: Mapping[str, float]  # upper bounds of some

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the numbers."""
        return tuple(
            Parameter(name=name, start=number, size=1.0, positive=True, lower=0.0, upper=self.largest.get(name, np.inf))
            for name, number in self.values.items()
        )

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
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
