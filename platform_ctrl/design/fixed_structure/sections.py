"""Structures of sections: PID, lead and notch, in series, sampled for a job, or built from named numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray, input_value, value
from platform_ctrl.design.fixed_structure.structures import (
    Given,
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
    filter_zero
        Whether a second-order F before everything has a zero, too: F = (s/z + 1) ω²/(s² + 2 ζ ω s + ω²), with
        parameters zero1, ... (z, rad/s). In a sampled controller z = 2/period, in `fixed`, is a filter that does
        not wait a sample; left free it is a lead.
    seen_through : (gains, rates), optional
        The measurement is already gain + rate/s (rate in 1/s) times the signal that the PID is meant for, channel by
        channel, each (ny,), as in a mixed-sensitivity plant whose weight on the error is before the controller: its
        pole is the PID's integrator, its zero becomes a fixed pole of the controller.
    start, bounds, fixed, tied
        As in `Structure`.
    """

    P: ArrayLike | str = "full"
    I: ArrayLike | str = "full"  # noqa: E741
    D: ArrayLike | str = "full"
    filter_order: Literal[0, 1, 2] = 2
    filtered: Literal["everything", "derivative"] = "everything"
    filter_zero: bool = False
    seen_through: tuple[ArrayLike, ArrayLike] | None = None

    def _masks(self, nmeas: int, ncon: int) -> tuple[Mask, Mask, Mask]:
        shape = (ncon, nmeas)
        masks = mask_of("PID: P", self.P, shape), mask_of("PID: I", self.I, shape), mask_of("PID: D", self.D, shape)
        if self.filter_order not in (0, 1, 2):
            raise ArgumentError(f"PID: filter_order must be 0, 1 or 2, got {self.filter_order!r}")
        if self.filter_order == 0 and (np.any(masks[2]) or self.seen_through is not None):
            raise ArgumentError('PID: a derivative needs a filter; give filter_order = 1 or 2, or D="none"')
        if self.filter_zero and (self.filter_order != 2 or self.filtered != "everything"):
            raise ArgumentError("PID: filter_zero needs filter_order = 2 and filtered = 'everything'")
        return masks

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return gains and filters."""
        P, integral, D = self._masks(nmeas, ncon)
        gain, rate = units.gain, units.rate
        integral_rate = rate if units.integral is None else units.integral
        if self.seen_through is not None:
            gain = gain * np.asarray(self.seen_through[0], dtype=np.float64)
        out = [
            *gains_of("kp", P, gain),
            *gains_of("ki", integral, gain * integral_rate),
            *gains_of("kd", D, gain / rate),
        ]
        if self.filter_order:
            out += [
                Parameter(
                    name=f"filter{j + 1}",
                    start=5.0 * rate,
                    size=1.0,
                    positive=True,
                    lower=1e-3 * rate,
                    upper=1e5 * rate,
                )
                for j in range(nmeas)
            ]
        if self.filter_order == 2:
            out += [
                Parameter(name=f"damping{j + 1}", start=0.7, size=1.0, positive=True, lower=0.02, upper=50.0)
                for j in range(nmeas)
            ]
        if self.filter_zero:
            out += [
                Parameter(
                    name=f"zero{j + 1}", start=2.0 * rate, size=1.0, positive=True, lower=1e-3 * rate, upper=1e5 * rate
                )
                for j in range(nmeas)
            ]
        return tuple(out)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the filters of all measurements, then their integrals, and the gains that read them."""
        masks, degree = self._masks(nmeas, ncon), self.filter_order
        ends = np.cumsum([mask.sum() for mask in masks])
        gains = [filled(m, p[..., end - m.sum() : end]) for m, end in zip(masks, ends, strict=True)]
        filters = p[..., ends[2] :].reshape(*p.shape[:-1], degree + self.filter_zero, nmeas)
        integrals = [self.seen_through is not None or bool(masks[1][:, j].any()) for j in range(nmeas)]
        states = degree * nmeas + sum(integrals)
        A, B = zeros(p, states, states), zeros(p, states, nmeas)
        rows, direct = zeros(p, 3 * nmeas, states), zeros(p, 3 * nmeas, nmeas)
        for j, integral in enumerate(integrals):
            own = np.arange(degree * j, degree * (j + 1))
            if integral:
                own = np.append(own, degree * nmeas + sum(integrals[:j]))
            a, b, c, d, _ = self._chain(filters[..., j], j, integral)
            A[..., own[:, None], own], B[..., own, j] = a, b[..., 0]
            rows[..., j::nmeas, own], direct[..., j::nmeas, j] = c, d[..., 0]
        gain = np.concatenate(gains, axis=-1)
        return System(A, B, gain @ rows, gain @ direct)

    def _chain(self, numbers: FloatArray, j: int, integral: bool) -> System:
        """Return the states behind measurement j and the rows [proportional, integral, derivative] that read them.

        First the filter's states, then the integral. Without a weight the filter is driven by y: P reads x, D reads x',
        and the integral is that of x. Behind a weight the integral q = y/s = y_m/(gain s + rate) comes first and drives
        the filter: I reads x, P reads x', D reads x''. What is not filtered is read before the filter.
        """
        degree, whole = self.filter_order, self.filter_order > 0 and self.filtered == "everything"
        n = degree + integral
        A, B, C, D = zeros(numbers, n, n), zeros(numbers, n, 1), zeros(numbers, 3, n), zeros(numbers, 3, 1)
        if degree == 1:
            A[..., 0, 0] = -numbers[..., 0]
        elif degree == 2:
            w, damping = numbers[..., 0], numbers[..., 1]
            A[..., 0, 1], A[..., 1, 0], A[..., 1, 1] = 1.0, -(w**2), -2.0 * damping * w
        drive = numbers[..., 0] ** degree if degree else None
        if self.seen_through is None:
            D[..., 0, 0], derivatives = 1.0, [0, 2]
            if degree:
                B[..., degree - 1, 0] = drive
            if integral:
                C[..., 1, -1] = 1.0
                (A if whole else B)[..., -1, 0] = 1.0
        else:
            gain, rate = (float(np.asarray(item, dtype=np.float64)[j]) for item in self.seen_through)
            A[..., -1, -1], B[..., -1, 0], A[..., degree - 1, -1] = -rate / gain, 1.0 / gain, drive
            C[..., 0, -1], D[..., 0, 0], C[..., 1, -1], derivatives = -rate / gain, 1.0 / gain, 1.0, [1, 0, 2]
        c, d = np.eye(1, n), np.zeros((1, 1))
        for action in derivatives if degree else ():
            if whole or action == 2:
                C[..., action, :], D[..., action, :] = c[..., 0, :], d[..., 0, :]
            c, d = c @ A, c @ B
        if self.filter_zero:
            zero = numbers[..., 2, None, None]
            C, D = C + C @ A / zero, C @ B / zero
        return System(A, B, C, D)
