"""The PID controller: gains between all or some axes, behind low-passes."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray, input_value
from platform_ctrl.design.fixed_structure.structures import (
    Mask,
    Parameter,
    Structure,
    Units,
    filled,
    gains_of,
    mask_of,
    zeros,
)
from platform_ctrl.errors import ArgumentError


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
