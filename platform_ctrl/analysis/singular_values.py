"""One system along its frequency axis: response, gain, and the frequencies where the gain may cross a level.

Balancing, modes and the map to the w-plane, which depend neither on frequency nor level, are computed once: norms
and margins need them many times. Behind long delays the gain is followed on a grid instead: their Hamiltonian has
thousands of eigenvalues, which lie close together.
"""

from __future__ import annotations

import contextlib
import copy
import math
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.poles import continuous_poles, resonances
from platform_ctrl.analysis.response import AxisResponse
from platform_ctrl.analysis.sampling import to_w_plane
from platform_ctrl.analysis.system import ComplexArray, Index, System, block, scaled
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

# Points of a grid in the time in which what is oldest turns once; halvings of a step between two of them.
_IN_A_TURN, _HALVINGS = 8, 40

# Sums of squares between this and its inverse keep their digits.
_TINY = 1e-200

# Relative real part of a Hamiltonian eigenvalue from which on it is off the axis, and its error in sizes of the matrix.
_OFF, _UNSURE = 0.1, 1e-6

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class FrequencyAxis:
    """One system, of any stability and number of states, on the imaginary axis or the unit circle.

    `system` is it in balanced states; `edge` is the highest frequency, rad/s: infinite, or the Nyquist frequency.
    `known` are its poles (n,), perhaps among others, in the plane of s or z, where they are known already.
    """

    def __init__(self, system: System, known: ComplexArray | None = None) -> None:
        A, B, C, D, dt = system
        self.edge = math.inf if dt == 0.0 else math.pi / dt
        self._known = known
        self.system = System(*scaled(A, B, C), D, dt)
        self._w_plane: System | None = None
        self._along = AxisResponse(self.system, balanced=True)

    def part(self, outputs: Index, inputs: Index, direct: float = 0.0) -> FrequencyAxis:
        """Return the axis of a part (`System.part`); what depends on the states alone is computed once for all."""
        out = copy.copy(self)
        out.__dict__.pop("_grid", None)
        out.system = self.system.part(outputs, inputs, direct)
        out._along = self._along.part(out.system)
        if self.system.dt > 0.0 and not out._along.oldest:
            with contextlib.suppress(ArgumentError):
                out._w_plane = self._in_w_plane().part(outputs, inputs, direct)
        return out

    def _in_w_plane(self) -> System:
        """Return a sampled system in the w-plane; an ArgumentError where a pole would go to infinity."""
        if self._w_plane is None:
            self._w_plane = to_w_plane(self.system)
        return self._w_plane

    def poles(self) -> ComplexArray:
        """Return the poles, (n,), in the plane of s or z."""
        return self._along.poles if self._known is None else self._known

    def response(self, frequency: FloatArray) -> ComplexArray:
        """Return the response at `frequency` (N,), rad/s, as (N, p, m); at infinite frequency D.

        Real at both ends of the axis: exp(j w dt) at the Nyquist frequency is -1, whatever the rounding of w dt.
        """
        ends = (frequency == 0.0) | (frequency == self.edge)
        if not ends.any():
            return self._along.at(frequency)
        infinite = np.isinf(frequency)
        out = self._along.at(np.where(infinite, 0.0, frequency))
        out[infinite] = self.system.D
        out.imag[ends] = 0.0
        return out

    def gains(self, frequency: FloatArray) -> FloatArray:
        """Return the largest singular value at each frequency, (N,); inf where the response is not finite."""
        return largest_singular_values(self.response(frequency))

    def largest(self, frequency: FloatArray) -> tuple[float, float]:
        """Return the largest gain among `frequency` up to the edge, and where it is; (0, 0) without any.

        The first of gains that are alike but for rounding.
        """
        frequency = frequency[frequency <= self.edge * (1.0 + 1e-12)]
        if frequency.size == 0:
            return 0.0, 0.0
        sizes = self.gains(frequency)
        i = int(np.argmax(sizes >= sizes.max() * (1.0 - 4.0 * _EPSILON)))
        return float(sizes[i]), float(frequency[i])

    def crossings(self, level: float, scaling: FloatArray | None = None) -> FloatArray:
        """Return sorted frequencies, rad/s, that contain all at which a singular value crosses `level` > 0.

        With `scaling` d (m,): of diag(d) H diag(d)^-1 instead of the square system H itself.
        """
        dt = self.system.dt
        if len(self.system.A) == 0 or not level > 0.0:
            return np.zeros(0)
        if self._along.oldest:
            return self._followed(level, scaling)
        system: Matrices = self.system[:4]
        if dt > 0.0:
            try:
                system = self._in_w_plane()[:4]
            except ArgumentError:
                # A pole next to z = -1, which the map would send to infinity.
                return pencil_crossings(*_over(level, system, scaling), dt)
        w = hamiltonian_crossings(*_over(level, system, scaling))
        return w if dt == 0.0 else np.asarray(2.0 / dt * np.arctan(0.5 * dt * w), dtype=np.float64)

    @cached_property
    def _grid(self) -> tuple[FloatArray, ComplexArray]:
        """Frequencies that follow the poles and the turns of the oldest values, rad/s, and the response there."""
        own = resonances(continuous_poles(self.poles(), self.system.dt))
        turns = np.linspace(0.0, self.edge, _IN_A_TURN * self._along.oldest)
        w = np.unique(np.concatenate([own[own < self.edge], turns]))
        return w, self.response(w)

    def _followed(self, level: float, scaling: FloatArray | None) -> FloatArray:
        """Return where the gain crosses a level between points of the grid, and its tops among these."""

        def gains(response: ComplexArray) -> FloatArray:
            if scaling is not None:
                response = scaling[:, None] * response / scaling
            return largest_singular_values(response)

        w, response = self._grid
        sizes = gains(response)
        sides = np.pad(sizes, 1)
        tops = w[(sizes >= sides[:-2]) & (sizes >= sides[2:])]
        above = sizes > level
        at = np.flatnonzero(above[1:] != above[:-1])
        low, high, rising = w[at], w[at + 1], above[at + 1]
        for _ in range(_HALVINGS if at.size else 0):
            middle = 0.5 * (low + high)
            beyond = (gains(self.response(middle)) > level) == rising
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        return np.unique(np.concatenate([high, tops]))


def largest_singular_values(matrices: ComplexArray) -> FloatArray:
    """Return the largest singular value of each matrix, (...) of (..., p, m); inf where one is not finite."""
    p, m = matrices.shape[-2:]
    if not (p and m):
        return np.zeros(matrices.shape[:-2])
    # Squared: the largest eigenvalue of the smaller product H' H keeps its digits.
    H = matrices if p >= m else np.swapaxes(matrices, -1, -2)
    with np.errstate(all="ignore"):
        if min(p, m) == 1:
            square = trace = np.sum(H.real**2 + H.imag**2, axis=(-2, -1))
        else:
            gram = np.swapaxes(H, -1, -2).conj() @ H
            trace = np.einsum("...ii->...", gram).real
        if not (trace.min(initial=1.0) > _TINY and trace.max(initial=1.0) < 1.0 / _TINY):
            size = np.maximum(np.abs(matrices.real), np.abs(matrices.imag)).max(axis=(-2, -1))
            fine = np.isfinite(size) & (size > 0.0)
            H = np.where(fine[..., None, None], matrices / np.where(fine, size, 1.0)[..., None, None], 1.0)
            out = largest_singular_values(H) * size
            return np.where(size == 0.0, 0.0, np.where(fine, out, np.inf))
    if min(p, m) == 2:
        a, b, c = gram[..., 0, 0].real, gram[..., 1, 1].real, gram[..., 0, 1]
        square = 0.5 * trace + np.sqrt(0.25 * (a - b) ** 2 + c.real**2 + c.imag**2)
    elif min(p, m) > 2:
        square = np.linalg.eigvalsh(gram)[..., -1]
    return np.asarray(np.sqrt(square))


def hamiltonian_crossings(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> FloatArray:
    """Return 0 and |Im| of the Hamiltonian's eigenvalues for the level 1, sorted: every crossing is among them.

    Those far off the axis are left out; nothing is returned outside of floating point. Where 1 is next to a singular
    value of D, of the matrix pencil that needs no inverse.
    """
    n, m = B.shape
    hamiltonian = np.empty((2 * n, 2 * n))
    values, vectors = np.linalg.eigh(np.eye(m) - D.T @ D)
    if np.abs(values).min() < 1e-8:
        return pencil_crossings(A, B, C, D, 0.0)
    # The system in the eigenvectors of I - D'D as its inputs.
    driven, seen = B @ vectors, vectors.T @ (D.T @ C)
    across = driven / values
    F = A + across @ seen
    hamiltonian[:n, :n], hamiltonian[:n, n:] = F, across @ driven.T
    hamiltonian[n:, :n], hamiltonian[n:, n:] = -(C.T @ C) - (seen.T / values) @ seen, -F.T
    size = float(np.linalg.norm(hamiltonian))
    if not math.isfinite(size):
        return np.zeros(0)
    found = np.linalg.eigvals(hamiltonian)
    near = np.abs(found.real) <= _OFF * np.abs(found) + _UNSURE * size
    return np.unique(np.abs(found.imag * near))


def pencil_crossings(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> FloatArray:
    """Return sorted frequencies that contain all at which a singular value is 1: a pencil's generalised eigenvalues.

    Its unknowns are states, costates, inputs and outputs; nothing is inverted.
    """
    from scipy.linalg import eigvals

    n, m, p = len(A), B.shape[1], len(C)
    costates: list[FloatArray | Literal[0]] = [0, -A.T, 0, -C.T] if dt == 0.0 else [0, np.eye(n), 0, 0]
    M = block([[A, 0, B, 0], costates, [0, B.T, -np.eye(m), D.T], [C, 0, D, -np.eye(p)]])
    N = np.diag([1.0] * 2 * n + [0.0] * (m + p))
    if dt:
        N[n : 2 * n, n : 2 * n], N[n : 2 * n, 2 * n + m :] = A.T, C.T
    if not (np.all(np.isfinite(M)) and np.all(np.isfinite(N))):
        return np.zeros(0)
    with np.errstate(all="ignore"):
        found = eigvals(M, N, check_finite=False)
    found = found[np.isfinite(found)]
    w = np.abs(found.imag) if dt == 0.0 else np.abs(np.angle(found)) / dt
    return np.asarray(np.unique(w[np.isfinite(w)]), dtype=np.float64)


def _over(level: float, system: Matrices, scaling: FloatArray | None) -> Matrices:
    """Return the scaled system over `level`, shared by input and output: both halves of its Hamiltonian are alike."""
    (A, B, C, D), root = system, math.sqrt(level)
    if scaling is not None:
        B, C, D = B / scaling, scaling[:, None] * C, scaling[:, None] * D / scaling
    with np.errstate(over="ignore"):
        return A, B / root, C / root, D / level


_EPSILON = 2.0**-52
# Distance from the boundary, in roundings of |A|, up to which a computed pole is not trusted.
_DOUBTFUL = 1e4
# Roundings of each entry that A is granted: a few, since it is the result of some computation.
_GRANTED = 8.0


def boundary_poles(A: FloatArray, dt: float, known: ComplexArray | None) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Return the continuous(-equivalent) poles of one balanced system, and which of them lie on the boundary, (n,).

    A pole lies on it if a change of A in its last digits could bring it there. `known` are its poles, if they are.
    """
    poles = np.asarray(np.linalg.eigvals(A) if known is None else known, dtype=np.complex128)
    on = np.abs(_distance(poles, dt)) <= _DOUBTFUL * _EPSILON * np.linalg.norm(A)
    if on.any():
        from scipy.linalg import eig

        shifted = A - np.eye(len(A)) if dt else A
        values, left, right = eig(shifted, left=True, right=True)
        distance = _distance(values + 1.0, dt) if dt else -values.real
        moved = np.einsum("ik,ij,jk->k", np.abs(left), np.abs(A), np.abs(right))
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = _GRANTED * _EPSILON * moved / np.abs(np.einsum("ik,ik->k", left.conj(), right))
        near = np.abs(distance) <= _DOUBTFUL * _EPSILON * np.linalg.norm(A)
        on = near & ~(np.abs(distance) > reach)
        poles = values + 1.0 if dt else np.asarray(values, dtype=np.complex128)
    return continuous_poles(poles, dt) if dt else poles, on


def _distance(poles: ComplexArray, dt: float) -> FloatArray:
    return np.asarray(1.0 - np.abs(poles) if dt else -poles.real, dtype=np.float64)
