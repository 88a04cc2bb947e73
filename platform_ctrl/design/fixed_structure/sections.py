"""Structures of sections: PID, structures in series, sampled for a job, or built from named numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray, input_value, value
from platform_ctrl.design.fixed_structure.structures import (
    Mask,
    Parameter,
    Structure,
    Units,
    filled,
    gains_of,
    joined,
    mask_of,
    zeros,
)
from platform_ctrl.errors import ArgumentError


@input_value
class Series(Structure):
    """Structures one after another; the first ones keep the number of signals, the last one makes u.

    Attributes
    ----------
    blocks
        From y to u, for example (PID(), StateSpaceOrder(states=2)).
    start, bounds, fixed
        As in `Structure`; what is given here overrides what a block has.
    """

    blocks: Sequence[Structure]

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return those of all blocks."""
        if not self.blocks:
            raise ArgumentError("Series: there must be at least one block, got none")
        out: list[Parameter] = []
        for k, one in enumerate(self.blocks):
            last = k == len(self.blocks) - 1 or nmeas == ncon
            own = units if last else replace(units, gain=np.ones((nmeas, nmeas)))
            out += one.settled(nmeas, ncon if last else nmeas, own)
        names = [one.name for one in out]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ArgumentError(f"Series: two parameters are called {twice[0]!r}; give the blocks different names")
        return tuple(out)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the blocks in series."""
        out = System(zeros(p, 0, 0), zeros(p, 0, nmeas), zeros(p, nmeas, 0), zeros(p, nmeas, nmeas) + np.eye(nmeas))
        for k, one in enumerate(self.blocks):
            outputs = ncon if k == len(self.blocks) - 1 else nmeas
            count = len(one.parameters(nmeas, outputs, Units(gain=np.ones((outputs, nmeas)), rate=1.0)))
            a, b, c, d, _ = one.block(p[..., :count], nmeas, outputs)
            A = np.block([[out.A, zeros(p, out.A.shape[-1], a.shape[-1])], [b @ out.C, a]])
            B, C = np.concatenate([out.B, b @ out.D], axis=-2), np.concatenate([d @ out.C, c], axis=-1)
            out, p = System(A, B, C, d @ out.D), p[..., count:]
        return out


# Least damping of a section: with less it follows one plant's resonance.
_SECTION_DAMPING = 0.05
# Relative step of the differences that replace it where a function takes real numbers alone.
_STEP = 1e-5


@value
class Sampled(Structure):
    """A sampled structure in other directions: u = basisᵀ K read y."""

    inner: Structure  # in the w-plane or in (z − 1)/period, in the directions that the rows of `basis` are
    period: float  # s
    basis: FloatArray  # (n, n): orthogonal
    read: FloatArray  # (p, p): the same, and itself for further readings
    # Whether s is (z − 1)/period, and not Tustin's rule: then the sampled matrices are affine in those of `inner`.
    # Tustin's states are those of the trapezium rule.
    forward: bool = False

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return those of the structure inside."""
        return self.inner.settled(nmeas, ncon, units)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the sampled block."""
        A, B, C, D, _ = self.inner.block(p, nmeas, ncon)
        half, eye = 0.5 * self.period * (not self.forward), np.eye(A.shape[-1])
        inverse = np.linalg.inv(eye - half * A)
        into, out = inverse @ B @ self.read, self.basis.T @ C
        direct = self.basis.T @ D @ self.read + half * out @ into
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
        """Return the block that the function builds."""
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


@input_value
class PID(Structure):
    """Proportional, integral and derivative gains between all or some axes, behind a low-pass on every measurement.

    u = (K_P + K_I/s + K_D s) F(s) y with F = diag(filters), of first order ω/(s + ω) or of second order
    ω²/(s² + 2 ζ ω s + ω²). Parameters kp11, ..., ki11, ..., kd11, ... (torquer, pick-off), filter1, ... (ω, rad/s) and
    for the second order damping1, ... (ζ).

    Attributes
    ----------
    P, I, D
        Which gains there are: "full", "diagonal", "cross", "none" or booleans (nu, ny).
    filter_order
        0 (only without D), 1 or 2.
    filtered
        Whether F filters every measurement, or the derivative alone: u = (K_P + K_I/s + K_D s F(s)) y.
    start, bounds, fixed
        As in `Structure`.
    """

    P: ArrayLike | str = "full"
    I: ArrayLike | str = "full"  # noqa: E741
    D: ArrayLike | str = "full"
    filter_order: Literal[0, 1, 2] = 2
    filtered: Literal["everything", "derivative"] = "everything"

    def _masks(self, nmeas: int, ncon: int) -> tuple[Mask, Mask, Mask]:
        shape = (ncon, nmeas)
        masks = mask_of("PID: P", self.P, shape), mask_of("PID: I", self.I, shape), mask_of("PID: D", self.D, shape)
        if self.filter_order not in (0, 1, 2):
            raise ArgumentError(f"PID: filter_order must be 0, 1 or 2, got {self.filter_order!r}")
        if self.filter_order == 0 and np.any(masks[2]):
            raise ArgumentError('PID: a derivative needs a filter; give filter_order = 1 or 2, or D="none"')
        return masks

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return gains and filters."""
        P, integral, D = self._masks(nmeas, ncon)
        gain, rate = units.gain, units.rate
        integral_rate = rate if units.integral is None else units.integral
        out = [
            *gains_of("kp", P, gain),
            *gains_of("ki", integral, gain * integral_rate),
            *gains_of("kd", D, gain / rate),
        ]
        filters = [("filter", 5.0 * rate, 1e-3 * rate, 1e5 * rate), ("damping", 0.7, 0.02, 50.0)][: self.filter_order]
        out += [
            Parameter(name=f"{name}{j + 1}", start=start, size=1.0, positive=True, lower=low, upper=high)
            for name, start, low, high in filters
            for j in range(nmeas)
        ]
        return tuple(out)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the filters of all measurements, then their integrals, and the gains that read them."""
        masks, degree = self._masks(nmeas, ncon), self.filter_order
        ends = np.cumsum([mask.sum() for mask in masks])
        gains = [filled(m, p[..., end - m.sum() : end]) for m, end in zip(masks, ends, strict=True)]
        filters = p[..., ends[2] :].reshape(*p.shape[:-1], degree, nmeas)
        integrals = [bool(masks[1][:, j].any()) for j in range(nmeas)]
        states = degree * nmeas + sum(integrals)
        A, B = zeros(p, states, states), zeros(p, states, nmeas)
        rows, direct = zeros(p, 3 * nmeas, states), zeros(p, 3 * nmeas, nmeas)
        for j, integral in enumerate(integrals):
            own = np.arange(degree * j, degree * (j + 1))
            if integral:
                own = np.append(own, degree * nmeas + sum(integrals[:j]))
            a, b, c, d, _ = self._chain(filters[..., j], integral)
            A[..., own[:, None], own], B[..., own, j] = a, b[..., 0]
            rows[..., j::nmeas, own], direct[..., j::nmeas, j] = c, d[..., 0]
        gain = np.concatenate(gains, axis=-1)
        return System(A, B, gain @ rows, gain @ direct)

    def _chain(self, numbers: FloatArray, integral: bool) -> System:
        """Return the states behind a measurement y and the rows [proportional, integral, derivative] that read them.

        First the filter's states, of which the first is what is filtered, then the integral.
        """
        degree, whole = self.filter_order, self.filter_order > 0 and self.filtered == "everything"
        n = degree + integral
        A, B, C, D = zeros(numbers, n, n), zeros(numbers, n, 1), zeros(numbers, 3, n), zeros(numbers, 3, 1)
        if degree == 1:
            A[..., 0, 0] = -numbers[..., 0]
        elif degree == 2:
            w, damping = numbers[..., 0], numbers[..., 1]
            A[..., 0, 1], A[..., 1, 0], A[..., 1, 1] = 1.0, -(w**2), -2.0 * damping * w
        if degree:
            B[..., degree - 1, 0] = numbers[..., 0] ** degree
            C[..., 2, :], D[..., 2, :] = A[..., 0, :], B[..., 0, :]
        (C if whole else D)[..., 0, 0] = 1.0
        if integral:
            C[..., 1, -1] = 1.0
            (A if whole else B)[..., -1, 0] = 1.0
        return System(A, B, C, D)


@input_value
class Sections(Structure):
    """Second-order sections in parallel, beside a gain of one, on every measurement.

    v = (1 + Σ (c + e s/ω) ω²/(s² + 2 ζ ω s + ω²)) y. Parameters c1_1, e1_1, filter1_1 (ω, rad/s), damping1_1 (ζ), ...
    (measurement, section). Gains start at zero: there the slopes of the requirements say at which frequencies gain and
    phase help, which those of a notch without depth do not.

    Attributes
    ----------
    rates
        ω of the sections at the start, rad/s, on every measurement.
    start, bounds, fixed
        As in `Structure`.
    """

    rates: Sequence[float]

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return those of all sections, measurement by measurement."""
        if nmeas != ncon:
            raise ArgumentError(f"Sections: there must be as many outputs as measurements, got {ncon} and {nmeas}")
        out: list[Parameter] = []
        for j, (k, rate) in product(range(nmeas), enumerate(self.rates)):
            end = f"{j + 1}_{k + 1}"
            out += [Parameter(name=f"{gain}{end}", start=0.0, size=1.0) for gain in "ce"]
            out += [
                Parameter(name=f"{name}{end}", start=start, size=1.0, positive=True, lower=low, upper=high)
                for name, start, low, high in (
                    ("filter", rate, 0.2 * rate, 5.0 * rate),
                    ("damping", 0.5, _SECTION_DAMPING, 2.0),
                )
            ]
        return tuple(out)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the sections beside one another."""
        count = nmeas * len(self.rates)
        c, e, w, damping = np.moveaxis(p.reshape(*p.shape[:-1], count, 4), -1, 0)
        first, own = 2 * np.arange(count), np.arange(count) // max(len(self.rates), 1)
        A, B = zeros(p, 2 * count, 2 * count), zeros(p, 2 * count, nmeas)
        C, D = zeros(p, nmeas, 2 * count), zeros(p, nmeas, nmeas) + np.eye(nmeas)
        A[..., first, first + 1], A[..., first + 1, first], A[..., first + 1, first + 1] = w, -w, -2.0 * damping * w
        B[..., first + 1, own], C[..., own, first], C[..., own, first + 1] = w, c, e
        return System(A, B, C, D)
