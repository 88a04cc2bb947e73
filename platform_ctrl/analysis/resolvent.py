"""C (z I - A)^-1 B + D of systems with states, accurate for every system matrix.

A compiled recurrence (`hessenberg_recurrence`) does most of the work and bounds its own error. Points where the bound
is too large are solved again by iterative refinement.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import MANY_STATES, ComplexArray, StateArrays, scaled
from platform_ctrl.common.values import FloatArray

if TYPE_CHECKING:
    from platform_ctrl.analysis.hessenberg_form import Chains
    from platform_ctrl.analysis.hessenberg_refinement import HessenbergRefinement
    from platform_ctrl.analysis.refinement import Band, Refinement


# Error bound of the recurrence above which a point is refined: the result is then right to 1e-9.
TOLERATED = 2.5e-10
# The same for curves and grids: far below the error between their points.
ON_A_GRID = 1e-6
# With MANY_STATES or more: how far the bound may exceed the tolerance, per state. The bound adds the rounding
# errors of n² entries as if all had one sign. Of lightly damped, random and far from normal systems of 48 to 1,006
# states the error was below 25/n of it, mostly 3/n.
AVERAGED = 1.0 / 12.0


def state_response(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    dt: float,
    w: FloatArray,
    tolerated: float = TOLERATED,
) -> ComplexArray:
    """Return C (z - A)^-1 B + D along the frequency axis, (..., p, m, N)."""
    z, low = _on_axis(w, dt)
    if dt == 0.0:
        return responses_at(A, None, B, C, D, z, tolerated=tolerated)
    return responses_at(*_less_one(A), B, C, D, z, low, tolerated)


def _less_one(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return A - I and the low-order part of its diagonal (..., n), in double-double precision.

    z - 1 and A - I instead of z and A: nothing cancels far below the sample rate. Both are rounded, which is felt next
    to poles: their low-order parts are kept.
    """
    shifted = np.array(A, order="C")
    diagonal = shifted.reshape(*A.shape[:-2], -1)[..., :: A.shape[-1] + 1]
    given = diagonal.copy()
    diagonal -= 1.0
    back = diagonal + 1.0
    return shifted, (given - back) - (1.0 - (back - diagonal))


def _on_axis(w: FloatArray, dt: float) -> tuple[ComplexArray, Callable[[NDArray[np.int64]], ComplexArray] | None]:
    """Return j w, or exp(j w dt) - 1 with a function that gives its low-order part."""
    z = np.zeros(len(w), dtype=np.complex128)
    if dt == 0.0:
        z.imag = w
        return z, None
    tangent = np.tan(w * (0.5 * dt))
    z.imag = 2.0 * tangent / (1.0 + tangent * tangent)
    z.real = -tangent * z.imag
    return z, _LowOrderPart(z, w, float(dt))


class _LowOrderPart:
    """The low-order part of exp(j w dt) - 1 beside its doubles z (N,), computed on demand and kept for a stack."""

    def __init__(self, z: ComplexArray, w: FloatArray, dt: float) -> None:
        self._z, self._w, self._dt = z, w, dt
        self._found: dict[int, complex] = {}

    def __call__(self, chosen: NDArray[np.int64]) -> ComplexArray:
        """Return it at the `chosen` points."""
        places = chosen.tolist()
        new = [k for k in places if k not in self._found]
        if new:
            self._find(new)
        return np.array([self._found[k] for k in places], dtype=np.complex128)

    def _find(self, places: list[int]) -> None:
        import flint

        with flint.ctx.workprec(192):
            for k in places:
                sine, cosine = (flint.arb(float(self._w[k])) * self._dt / 2).sin_cos()
                real, imaginary = -2 * sine * sine - float(self._z[k].real), 2 * sine * cosine - float(self._z[k].imag)
                self._found[k] = complex(float(real), float(imaginary))


def responses_at(
    A: FloatArray,
    A_low: FloatArray | None,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    z: ComplexArray,
    z_low: Callable[[NDArray[np.int64]], ComplexArray] | None = None,
    tolerated: float = TOLERATED,
) -> ComplexArray:
    """Return the response at z as (..., p, m, N)."""
    n, m, p, N = A.shape[-1], B.shape[-1], C.shape[-2], z.shape[0]
    alone = A.ndim == B.ndim == C.ndim == D.ndim == 2
    batch = () if alone else np.broadcast_shapes(*(item.shape[:-2] for item in (A, B, C, D)))
    if not (n and m and p and N):
        return np.array(np.broadcast_to(D[..., None], (*batch, p, m, N)), dtype=np.complex128)
    A, B, C = scaled(A, B, C)
    if alone:
        return Resolvent(A, B, C, D, A_low, tolerated).at(z, z_low)
    H = np.empty((*batch, p, m, N), dtype=np.complex128)
    for k in np.ndindex(batch):
        a, b, c, d = (np.broadcast_to(item, (*batch, *item.shape[-2:]))[k] for item in (A, B, C, D))
        low = None if A_low is None else np.broadcast_to(A_low, (*batch, n))[k]
        H[k] = Resolvent(a, b, c, d, low, tolerated).at(z, z_low)
    return H


def plain(array: FloatArray) -> FloatArray:
    """Return an array as numba has compiled for it: it does so anew for what is read-only or lies otherwise."""
    flags = array.flags
    return array if flags.c_contiguous and flags.writeable else np.array(array, order="C")


class AxisResponse:
    """The response of one system along its frequency axis: what does not depend on the frequency is computed once.

    `balanced` says whether the states are balanced already; `tolerated` is as in `frequency_response`.
    """

    def __init__(self, system: StateArrays, tolerated: float = TOLERATED, balanced: bool = False) -> None:
        A, B, C, D, self._dt = system
        A_low = None
        if self._dt > 0.0:
            A, A_low = _less_one(A)
        if not balanced:
            A, B, C = scaled(A, B, C)
        self._resolvent = Resolvent(A, B, C, D, A_low, tolerated)

    def at(self, frequency: FloatArray, tolerated: float | None = None, least: float = 0.0) -> ComplexArray:
        """Return the response at `frequency` (N,), rad/s, complex (N, p, m).

        `tolerated` may be another this time; an entry below `least` need be no more accurate than that one.
        """
        return self._resolvent.at(*_on_axis(frequency, self._dt), tolerated, least).transpose(2, 0, 1)


class Resolvent:
    """D + C (z I - A)^-1 B of one balanced system, all that does not depend on z computed once.

    `A_low` (n,) is the low-order part of A's diagonal in double-double precision. D is zero where it is not given.
    """

    def __init__(
        self,
        A: FloatArray,
        B: FloatArray,
        C: FloatArray,
        D: FloatArray | None = None,
        A_low: FloatArray | None = None,
        tolerated: float = TOLERATED,
    ) -> None:
        D = np.zeros((C.shape[0], B.shape[1])) if D is None else D
        self._tolerated = tolerated
        # One recurrence an input: of a system with fewer outputs, the transposed one.
        self._turned = C.shape[0] < B.shape[1]
        if self._turned:
            A, B, C, D = A.T, C.T, B.T, D.T
        self._A, self._B, self._C, self._D = (plain(item) for item in (A, B, C, D))
        self._A_low = np.zeros(len(A)) if A_low is None else plain(A_low)

    @cached_property
    def _band(self) -> Band:
        from platform_ctrl.analysis.refinement import band

        return band(self._A)

    @cached_property
    def _chains(self) -> Chains:
        from platform_ctrl.analysis.hessenberg_form import chains

        return chains(self._A, self._B, self._C)

    @cached_property
    def _hessenberg(self) -> HessenbergRefinement:
        from platform_ctrl.analysis.hessenberg_refinement import HessenbergRefinement

        return HessenbergRefinement(self._A, self._B, self._C, self._D, self._A_low, *self._chains.hessenberg())

    @cached_property
    def _refinement(self) -> Refinement:
        from platform_ctrl.analysis.refinement import Refinement

        return Refinement(self._A, self._B, self._C, self._D, self._A_low, self._band)

    def at(
        self,
        z: ComplexArray,
        z_low: Callable[[NDArray[np.int64]], ComplexArray] | None = None,
        tolerated: float | None = None,
        least: float = 0.0,
    ) -> ComplexArray:
        """Return the response at z (N,), (p, m, N).

        `z_low` gives the low-order part of z on demand, and `tolerated` may be another this time. An entry below
        `least` need be no more accurate than that one.
        """
        tolerated = self._tolerated if tolerated is None else tolerated
        (p, m), z = self._D.shape, np.array(z, dtype=np.complex128)
        n = len(self._A)
        H = np.empty((m, p, len(z)) if self._turned else (p, m, len(z)), dtype=np.complex128)
        if n >= MANY_STATES and self._band.work(m) < n * (m + 1) * (3.0 + n / (len(z) + 1)):
            # Elimination in a narrow band takes less than the recurrence and its preparation.
            poor = np.arange(len(z))
        else:
            from platform_ctrl.analysis.hessenberg_recurrence import respond

            bound = tolerated * (AVERAGED * n if n >= MANY_STATES else 1.0)
            poor = respond(self._chains, self._D, z, H, self._turned, bound, least)
        if poor.size:
            low = np.zeros(len(poor), dtype=np.complex128) if z_low is None else z_low(poor)
            found = self._refined(z[poor], low, tolerated, least)
            H[..., poor] = found if self._turned else found.swapaxes(0, 1)
        return H

    def _refined(self, z: ComplexArray, z_low: ComplexArray, tolerated: float, least: float) -> ComplexArray:
        n, m = self._B.shape
        if n < MANY_STATES or self._band.work(m) < 64 * n * m:
            return self._refinement.at(z, z_low)
        found, short = self._hessenberg.at(z, z_low, tolerated, least)
        if short.size:
            found[:, :, short] = self._refinement.at(z[short], z_low[short])
        return found

    def add(self, H: ComplexArray, z: ComplexArray) -> None:
        """Add the response at z (N,) to H (p, m N)."""
        H += self.at(z).reshape(H.shape)
