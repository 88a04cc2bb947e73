"""One system along its frequency axis: response, gain, and the frequencies where the gain may cross a level.

What does not depend on the frequency or the level (balancing, the recurrence, the map to the w-plane) is worked
out once: norms and margins ask many times.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, scaled
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.analysis.resolvent import AxisResponse
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import to_w_plane
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

# Inputs or outputs up to which singular values are compiled ones.
PORTS = 8

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class FrequencyAxis:
    """One system, of any stability and number of states, on the imaginary axis or the unit circle.

    `system` is it in balanced states; `edge` is the highest frequency, rad/s: infinite, or the Nyquist frequency.
    """

    def __init__(self, system: StateArrays) -> None:
        A, B, C, D, dt = system
        self.edge = math.inf if dt == 0.0 else math.pi / dt
        self.system = StateArrays(*scaled(A, B, C), D, dt)
        self._w_plane: Matrices | None = None
        self._along = AxisResponse(self.system, balanced=True) if A.size and B.size and C.size else None

    def response(self, frequency: FloatArray, tolerated: float | None = None, least: float = 0.0) -> ComplexArray:
        """Return the response at `frequency` (N,), rad/s, as (N, p, m); at infinite frequency D.

        `tolerated` and `least` are as of `AxisResponse.at`. Real at both ends of the axis: exp(j w dt) at the Nyquist
        frequency is -1, whatever the rounding of w dt.
        """
        infinite = np.isinf(frequency)
        some = bool(np.any(infinite))
        finite = np.where(infinite, 0.0, frequency) if some else frequency
        if self._along is None:
            out = frequency_response(self.system, finite, -3)
        else:
            out = self._along.at(finite, tolerated, least)
        out = np.ascontiguousarray(out)
        if some:
            out[infinite] = self.system.D
        out.imag[(frequency == 0.0) | (frequency == self.edge)] = 0.0
        return out

    def gains(self, frequency: FloatArray, tolerated: float | None = None, least: float = 0.0) -> FloatArray:
        """Return the largest singular value at each frequency, (N,); inf where the response is not finite."""
        return largest_singular_values(self.response(frequency, tolerated, least))

    def largest(self, frequency: FloatArray) -> tuple[float, float]:
        """Return the largest gain among `frequency` up to the edge, and where it is; (0, 0) without any."""
        frequency = frequency[frequency <= self.edge * (1.0 + 1e-12)]
        if frequency.size == 0:
            return 0.0, 0.0
        sizes = self.gains(frequency)
        i = int(np.argmax(sizes))
        return float(sizes[i]), float(frequency[i])

    def crossings(self, level: float, scaling: FloatArray | None = None) -> FloatArray:
        """Return sorted frequencies, rad/s, that contain all at which a singular value crosses `level` > 0.

        With `scaling` d (m,): of diag(d) H diag(d)^-1 instead of the square system H itself.
        """
        dt = self.system.dt
        if len(self.system.A) == 0 or not level > 0.0:
            return np.zeros(0)
        system: Matrices = self.system[:4]
        if dt > 0.0:
            try:
                if self._w_plane is None:
                    self._w_plane = to_w_plane(self.system)[:4]
                system = self._w_plane
            except ArgumentError:
                # A pole next to z = -1, which the map would send to infinity.
                return pencil_crossings(*_over(level, *_rescaled(*system, scaling)), dt)
        w = hamiltonian_crossings(*_over(level, *_rescaled(*system, scaling)))
        return w if dt == 0.0 else np.asarray(2.0 / dt * np.arctan(0.5 * dt * w), dtype=np.float64)


def largest_singular_values(matrices: ComplexArray) -> FloatArray:
    """Return the largest singular value of each matrix, (...) of (..., p, m); inf where one is not finite."""
    *batch, p, m = matrices.shape
    H = np.ascontiguousarray(matrices, dtype=np.complex128).reshape(math.prod(batch), p, m)
    out = np.full(len(H), np.inf)
    if min(p, m) <= PORTS:
        from platform_ctrl.analysis import kernels

        kernels.largest_singular_values(H, out)
    else:
        fine = np.all(np.isfinite(H), axis=(-2, -1))
        if np.any(fine):
            out[fine] = np.linalg.norm(H[fine], 2, axis=(-2, -1))
    return out.reshape(batch)


def hamiltonian_crossings(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> FloatArray:
    """Return |Im| of all eigenvalues of the Hamiltonian for the level 1, sorted: every crossing is among them.

    Where 1 is next to a singular value of D, of the matrix pencil that needs no inverse.
    """
    n, m = B.shape
    hamiltonian = np.empty((2 * n, 2 * n))
    R = np.eye(m) - D.T @ D
    if np.abs(np.linalg.eigvalsh(R)).min() < 1e-8:
        return pencil_crossings(A, B, C, D, 0.0)
    driven = B @ np.linalg.inv(R)
    seen = D.T @ C
    F = A + driven @ seen
    hamiltonian[:n, :n], hamiltonian[:n, n:] = F, driven @ B.T
    hamiltonian[n:, :n], hamiltonian[n:, n:] = -(C.T @ C) - seen.T @ np.linalg.solve(R, seen), -F.T
    if not np.all(np.isfinite(hamiltonian)):
        return np.zeros(0)
    out: FloatArray = np.unique(np.abs(np.linalg.eigvals(hamiltonian).imag))
    return out


def pencil_crossings(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> FloatArray:
    """Return sorted frequencies that contain all at which a singular value is 1: a pencil's generalised eigenvalues.

    Its unknowns are states, costates, inputs and outputs; nothing is inverted.
    """
    from scipy.linalg import eigvals

    n, m, p = len(A), B.shape[1], len(C)
    size = 2 * n + m + p
    x, q, u, y = np.split(np.arange(size), [n, 2 * n, 2 * n + m])
    M, N = np.zeros((size, size)), np.zeros((size, size))
    M[np.ix_(x, x)], M[np.ix_(x, u)] = A, B
    M[np.ix_(u, q)], M[np.ix_(u, y)] = B.T, D.T
    M[np.ix_(y, x)], M[np.ix_(y, u)] = C, D
    M[u, u] = M[y, y] = -1.0
    N[x, x] = 1.0
    if dt == 0.0:
        M[np.ix_(q, q)], M[np.ix_(q, y)] = -A.T, -C.T
        N[q, q] = 1.0
    else:
        M[q, q] = 1.0
        N[np.ix_(q, q)], N[np.ix_(q, y)] = A.T, C.T
    if not (np.all(np.isfinite(M)) and np.all(np.isfinite(N))):
        return np.zeros(0)
    with np.errstate(all="ignore"):
        found = eigvals(M, N, check_finite=False)
    found = found[np.isfinite(found)]
    w = np.abs(found.imag) if dt == 0.0 else np.abs(np.angle(found)) / dt
    return np.asarray(np.unique(w[np.isfinite(w)]), dtype=np.float64)


def _over(level: float, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> Matrices:
    """Return the system over `level`, shared by input and output: both halves of its Hamiltonian are equally large."""
    root = math.sqrt(level)
    with np.errstate(over="ignore"):
        return A, B / root, C / root, D / level


def _rescaled(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, scaling: FloatArray | None) -> Matrices:
    if scaling is None:
        return A, B, C, D
    return A, B / scaling, scaling[:, None] * C, scaling[:, None] * D / scaling


EPSILON = 2.0**-52
# Distance from the boundary, in roundings of |A|, up to which a computed pole is not trusted.
DOUBTFUL = 1e4
# Roundings of each entry that A is granted: a few, since it is the result of some computation.
GRANTED = 8.0
BITS = 192


def boundary_poles(A: FloatArray, dt: float) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Return the continuous(-equivalent) poles of one balanced system, and which of them lie on the boundary, (n,)."""
    poles = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
    distance = 1.0 - np.abs(poles) if dt else -poles.real
    if not np.any(np.abs(distance) <= DOUBTFUL * EPSILON * np.linalg.norm(A)):
        return continuous_poles(poles, dt) if dt else poles, np.zeros(len(poles), dtype=np.bool_)
    return _precise_poles(A, dt)


def _precise_poles(A: FloatArray, dt: float) -> tuple[ComplexArray, NDArray[np.bool_]]:
    from flint import acb, acb_mat, ctx

    before = ctx.prec
    ctx.prec = BITS
    try:
        values, left, right = acb_mat(A.tolist()).eig(algorithm="approx", left=True, right=True)
        # Next to the unit circle |z| - 1 = (|z|^2 - 1)/2.
        distance = np.array([float(((z.real**2 + z.imag**2 - 1) / 2 if dt else z.real).mid()) for z in values])
        n = len(values)
        X = np.array([_direction([right[i, k] for i in range(n)]) for k in range(n)])
        Y = np.array([_direction([left[k, i] for i in range(n)]) for k in range(n)])
        s = np.array([complex((acb(z).log() / dt).mid() if dt and z != 0 else z.mid()) for z in values])
    finally:
        ctx.prec = before
    if dt:
        s[~np.isfinite(s) | (np.array([abs(complex(z.mid())) for z in values]) == 0.0)] = complex(-math.inf, 0.0)
    moved = np.einsum("ki,ij,kj->k", np.abs(Y), np.abs(A), np.abs(X))
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = GRANTED * EPSILON * moved / np.abs(np.einsum("ki,ki->k", Y, X))
    on = np.abs(distance) <= np.where(np.isnan(reach), math.inf, reach)
    # A pole at rest, zero in A's own digits.
    return s, np.asarray(on | (distance == 0.0), dtype=np.bool_)


def _direction(vector: list[Any]) -> list[complex]:
    """Return an acb vector as complex numbers, the largest of them of size 1."""
    sizes = [abs(x) for x in vector]
    largest = max(sizes, key=lambda size: size.mid())
    return [complex((x / largest).mid()) for x in vector] if largest != 0 else [0j] * len(vector)
