"""Responses over frequency and time, accurate for every system matrix.

The resolvent is solved in Schur form: unitary, so it does not care whether A has eigenvectors, and one
triangular substitution serves all frequencies at once. One step of iterative refinement in the original
(balanced) states removes what the rotation into Schur form lost next to lightly damped poles of widely
spread systems (Skeel, Math. Comp. 35, 1980).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, frequencies, scaled, state_arrays
from platform_ctrl.analysis.sampled import held_input
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray

if TYPE_CHECKING:
    import control


# Condition, |A| times the resolvent, above which a response is refined: below it 1e-12 is kept without.
REFINED_ABOVE = 1e3


def frequency_response(system: control.StateSpace, frequency: ArrayLike) -> ComplexArray:
    """Return the response of `system` on the imaginary axis or on the unit circle.

    Parameters
    ----------
    system
        Continuous or discrete `control.StateSpace`, p outputs, m inputs.
    frequency : (N,)
        rad/s, >= 0.

    Returns
    -------
    complex (p, m, N)
        Not finite where a frequency coincides with a pole.

    Raises
    ------
    ArgumentError
        If `system` or `frequency` is not what is expected.
    """
    A, B, C, D, dt = state_arrays(system, "frequency_response")
    out = frequency_response_arrays(A, B, C, D, dt, frequencies(frequency, "frequency_response"))
    return np.ascontiguousarray(np.moveaxis(out, 0, -1))


def frequency_response_arrays(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float, frequency: FloatArray
) -> ComplexArray:
    """Return C (z - A)^-1 B + D, complex (..., N, p, m), at `frequency` rad/s for dt = 0 or dt > 0."""
    if dt == 0.0:
        return response_arrays(A, B, C, D, np.asarray(1j * frequency, dtype=np.complex128))
    # z - 1 and A - I instead of z and A: nothing cancels far below the sample rate.
    return response_arrays(
        A - np.eye(A.shape[-1]), B, C, D, np.asarray(np.expm1(1j * frequency * dt), dtype=np.complex128)
    )


def response_arrays(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, z: ComplexArray) -> ComplexArray:
    """Return C (z I - A)^-1 B + D at the points `z` of the complex plane.

    Parameters
    ----------
    A, B, C, D
        ``(..., n, n)``, ``(..., n, m)``, ``(..., p, n)``, ``(..., p, m)``; batch axes broadcast.
    z : complex (N,)
        The same points for the whole stack.

    Returns
    -------
    complex (..., N, p, m)
        Not finite where z is an eigenvalue of A.
    """
    batch = np.broadcast_shapes(*(item.shape[:-2] for item in (A, B, C, D)))
    n, m, p, N = A.shape[-1], B.shape[-1], C.shape[-2], z.shape[0]
    H = np.empty((*batch, p, m, N), dtype=np.complex128)
    H[...] = D[..., None]
    if n and m and p and N:
        A, B, C = scaled(A, B, C)
        stacks = (np.broadcast_to(item, (*batch, *item.shape[-2:])) for item in (A, B, C))
        flat_A, flat_B, flat_C = (item.reshape(-1, *item.shape[-2:]) for item in stacks)
        for one, A_one, B_one, C_one in zip(H.reshape(-1, p, m * N), flat_A, flat_B, flat_C, strict=True):
            Resolvent(A_one, B_one, C_one).add(one, z)
    return np.moveaxis(H, -1, -3)


class Resolvent:
    """C (z I - A)^-1 B of one system, its Schur form worked out once for any number of points.

    Parameters
    ----------
    A, B, C
        Arrays of one system with at least one state and one input, balanced.
    """

    def __init__(self, A: FloatArray, B: FloatArray, C: FloatArray) -> None:
        from scipy.linalg import schur

        self._A, self._B, self._C = A, B, C
        self._T, self._U = schur(A, output="complex", check_finite=False)
        self._driven, self._seen = np.conj(self._U.T) @ B, C @ self._U
        self._size = float(np.linalg.norm(A))

    def add(self, H: ComplexArray, z: ComplexArray) -> None:
        """Add C (z I - A)^-1 B to H (p, m N)."""
        (n, m), N, T = self._B.shape, z.shape[0], self._T
        # Pieces that stay in the cache, and below the size at which the matrix library starts threads: on a busy
        # machine waiting for those takes longer than the product.
        piece = max(32, int(2.5e5 / (n * n * m)))
        whole = H.reshape(-1, m, N)
        with np.errstate(all="ignore"):
            for start in range(0, N, piece):
                points = z[start : start + piece]
                x = np.empty((n, m, len(points)), dtype=np.complex128)
                x[...] = self._driven[:, :, None]
                _substitute(T, x, points)
                # The rotation has moved A by about 1e-16 |A|: it is felt where the resolvent is large.
                nearest = np.abs(points - np.diag(T)[:, None]).min(axis=0)
                growth = np.abs(x).max(axis=0) / np.abs(self._B).max(axis=0, initial=1e-300)[:, None]
                felt = np.flatnonzero(~(self._size * np.maximum(growth.max(axis=0), 1.0 / nearest) < REFINED_ABOVE))
                found = (self._seen @ _merged(x)).reshape(-1, m, len(points))
                if felt.size:
                    found[:, :, felt] = _refined(x[:, :, felt], self._A, self._B, self._C, T, self._U, points[felt])
                whole[:, :, start : start + piece] += found


def _refined(
    x: ComplexArray, A: FloatArray, B: FloatArray, C: FloatArray, T: ComplexArray, U: ComplexArray, z: ComplexArray
) -> ComplexArray:
    """Return C (z I - A)^-1 B after one step of iterative refinement of its solution x in Schur coordinates."""
    plain = U @ _merged(x)
    residual = (A @ plain.view(np.float64)).view(np.complex128).reshape(x.shape)
    residual -= z * plain.reshape(x.shape)
    residual += B[:, :, None]
    correction = _substitute(T, (np.conj(U.T) @ _merged(residual)).reshape(x.shape), z)
    # The two parts are not added in Schur coordinates: there small states would lose digits beside large ones.
    return (C @ plain + (C @ U) @ _merged(correction)).reshape(-1, *x.shape[1:])


def _merged(x: ComplexArray) -> ComplexArray:
    """Join the last two axes: (n, m, N) -> (n, m N)."""
    return x.reshape(x.shape[0], -1)


def _substitute(T: ComplexArray, right: ComplexArray, z: ComplexArray) -> ComplexArray:
    """Solve (z I - T) x = right in place for upper triangular T (n, n), right (n, m, N), all z at once."""
    n, block = len(T), 8
    flat = _merged(right)
    for high in range(n, 0, -block):
        low = max(0, high - block)
        if high < n:
            flat[low:high] += T[low:high, high:] @ flat[high:]
        for k in range(high - 1, low - 1, -1):
            for j in range(k + 1, high):
                flat[k] += T[k, j] * flat[j]
            right[k] /= z - T[k, k]
    return right


def time_response(
    system: control.StateSpace,
    timepts: ArrayLike,
    inputs: ArrayLike,
    hold: Literal["zoh", "foh"] = "zoh",
    initial_state: ArrayLike | None = None,
) -> FloatArray:
    """Return the outputs at `timepts`, exact for inputs that are held or linear between the samples.

    Parameters
    ----------
    system
        Continuous, or discrete with the sample period that `timepts` have.
    timepts : (N,)
        Times with equal steps, s.
    inputs : (m, N), or (N,) for one input
        Inputs at those times.
    hold
        ``"zoh"``: held from each sample to the next; ``"foh"``: linear between samples. Without meaning for a
        discrete system.
    initial_state : (n,), optional
        State at the first time; default zero.

    Returns
    -------
    (p, N)

    Raises
    ------
    ArgumentError
        If shapes do not fit, the steps are not equal, or differ from a discrete system's sample period.
    """
    A, B, C, D, dt = state_arrays(system, "time_response")
    times = np.asarray(timepts, dtype=np.float64)
    if times.ndim != 1 or times.size < 2 or not np.all(np.isfinite(times)):
        raise ArgumentError(f"time_response: timepts has shape {times.shape}, expected at least two finite times")
    step = float(times[-1] - times[0]) / (times.size - 1)
    if step <= 0.0 or np.abs(np.diff(times) - step).max() > 1e-6 * step:
        raise ArgumentError("time_response: the steps of timepts differ, expected equal steps > 0; use numpy.linspace")
    if dt > 0.0 and abs(step - dt) > 1e-6 * dt:
        raise ArgumentError(f"time_response: timepts has steps of {step:g} s, expected the system's dt = {dt:g} s")
    u = np.asarray(inputs, dtype=np.float64)
    u = u[None, :] if u.ndim == 1 else u
    if u.shape != (B.shape[1], times.size) or not np.all(np.isfinite(u)):
        raise ArgumentError(
            f"time_response: inputs has shape {np.shape(inputs)}, expected finite ({B.shape[1]}, {times.size})"
        )
    x0 = np.zeros(A.shape[0]) if initial_state is None else np.asarray(initial_state, dtype=np.float64)
    if x0.shape != (A.shape[0],) or not np.all(np.isfinite(x0)):
        raise ArgumentError(f"time_response: initial_state has shape {x0.shape}, expected finite ({A.shape[0]},)")
    if hold not in ("zoh", "foh"):
        raise ArgumentError(f"time_response: hold = {hold!r}, expected 'zoh' or 'foh'")

    if dt > 0.0:
        driven = B @ u
        transition = A
    elif hold == "zoh":
        transition, held = held_input(A, B, step)
        driven = held @ u
    else:
        transition, held, ramp = linear_input(A, B, step)
        driven = held @ u
        driven[:, :-1] += ramp @ np.diff(u, axis=1)
    out: FloatArray = C @ recurrence(transition, driven, x0) + D @ u
    return out


def linear_input(A: FloatArray, B: FloatArray, step: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return exp(A h), and what an input held, and one that rises by 1 during `step` h, add to the state."""
    n, m = A.shape[-1], B.shape[-1]
    # x' = A x + B v, v' = w with w held: the ramp's state v is appended to x.
    A_ramp = np.zeros((n + m, n + m))
    A_ramp[:n, :n] = A
    A_ramp[:n, n:] = B
    B_ramp = np.zeros((n + m, m))
    B_ramp[n:] = np.eye(m) / step
    phi, ramp = held_input(A_ramp, B_ramp, step)
    return phi[:n, :n], phi[:n, n:], ramp[:n]


def recurrence(transition: FloatArray, driven: FloatArray, x0: FloatArray) -> FloatArray:
    """Return x[0], x[1], ... of x[k+1] = transition x[k] + driven[:, k] as (n, N), x[0] = `x0`.

    The N steps are cut into about sqrt(N) blocks that advance side by side; the blocks' first states follow from a
    short recurrence of their own. That is 3 sqrt(N) matrix products in place of N.
    """
    n, N = driven.shape
    length = max(1, math.isqrt(N))
    blocks = -(-N // length)
    forced = np.zeros((length + 1, n, blocks))
    padded = np.zeros((n, blocks * length))
    padded[:, :N] = driven
    padded = padded.reshape(n, blocks, length)
    power = np.empty((length + 1, n, n))
    power[0] = np.eye(n)
    for k in range(length):
        forced[k + 1] = transition @ forced[k] + padded[:, :, k]
        power[k + 1] = transition @ power[k]
    starts = np.empty((n, blocks))
    start = x0
    for j in range(blocks):
        starts[:, j] = start
        start = power[length] @ start + forced[length, :, j]
    x = forced[:length] + power[:length] @ starts
    return np.moveaxis(x, 0, -1).reshape(n, blocks * length)[:, :N]
