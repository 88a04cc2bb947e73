"""Poles, frequencies around them, their damping and their branches over a parameter, of any system.

A pole z of a sampled system counts as the continuous pole s = ln(z)/T with |Im s| <= pi/T that has the
same samples. So a pole at z = 0 (a delay) is infinitely fast and fully damped, and one on the negative real axis of z
oscillates at the Nyquist frequency: z = -0.5 has the damping ratio 0.22, z = -0.9 only 0.03.

A rate loop whose integrals carry the torque of a spring is in balance wherever the gimbal happens to be. The closed
loop then has a pole at exactly z = 1, whose vector v is an equilibrium, A v = v, that no sensor sees, C v = 0. It is no
motion and no instability: with v as a coordinate of its own, nothing else depends on it. What is left is judged; no
pole is moved. A pole that only lies near z = 1, or that a sensor sees, stays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.response import StateSystem, linear_arrays
from platform_ctrl.analysis.system import ComplexArray, System, scaled, state_scaling
from platform_ctrl.common.arguments import real_numbers
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError


@value
class Damping:
    """Damping ratio of every pole, slowest pole first.

    Attributes
    ----------
    poles : complex (n,)
        Continuous-equivalent poles s, rad/s; ``-inf`` for z = 0.
    natural_frequency : (n,)
        |s|, rad/s.
    ratio : (n,)
        -Re(s)/|s|, dimensionless: 1 for real stable poles and for z = 0, -1 for real unstable ones, 0 at s = 0.
    """

    poles: ComplexArray
    natural_frequency: FloatArray
    ratio: FloatArray


def poles(system: StateSystem | ArrayLike) -> ComplexArray:
    """Return the poles (..., n) of a system in its own plane (s, rad/s, or z), or of a stack of state matrices A.

    The poles of a system are computed in balanced states, the eigenvalues of a matrix as it is.
    """
    if isinstance(system, np.ndarray | list):
        A = real_numbers("poles: A", system)
        if A.ndim < 2 or A.shape[-1] != A.shape[-2] or not np.isfinite(A).all():
            raise ArgumentError(f"poles: A must be square matrices of finite numbers, got shape {A.shape}")
    else:
        A, B, C, _, _ = linear_arrays(cast(StateSystem, system), "poles")
        A = scaled(A, B, C)[0]
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)


def continuous_poles(poles: ComplexArray, dt: float) -> ComplexArray:
    """Return s = ln(z)/dt, rad/s, for the poles (..., n) of a discrete system; as they are for dt = 0.

    |Im s| <= π/dt, and s is ``-inf`` for z = 0.
    """
    z = np.asarray(poles, dtype=np.complex128)
    if dt == 0.0:
        return z
    # By parts: no complex infinities with undefined angles, and no digits lost next to z = 1.
    with np.errstate(divide="ignore", over="ignore"):
        near = 0.5 * np.log1p(np.maximum((z.real - 1.0) * (z.real + 1.0) + z.imag**2, -1.0))
        growth = np.where(np.abs(z - 1.0) < 0.5, near, np.log(np.abs(z)))
    out = np.empty(z.shape, dtype=np.complex128)
    out.real = growth / dt
    out.imag = np.where(z == 0.0, 0.0, np.angle(z) / dt)
    return out


def resonances(s: ComplexArray) -> FloatArray:
    """Return frequencies, rad/s, at which poles s can make peaks: |Im s| and about |Re s| around it, and |s|."""
    s = s[np.isfinite(s) & (s.imag >= 0.0)]
    centre, width = s.imag, np.abs(s.real)
    beside = np.abs(centre[:, None] + width[:, None] * np.array([-1.0, -0.3, 0.0, 0.3, 1.0]))
    return np.unique(np.concatenate([beside.ravel(), np.abs(s), 1.7 * np.abs(s)]))


def search_grid(system: System, s: ComplexArray) -> FloatArray:
    """Return frequencies that follow the closed loop's poles, and some a decade between and beyond them."""
    own = resonances(s)
    own = own[own > 0.0]
    if own.size == 0:
        own = np.ones(1)
    low, high = 0.1 * float(own.min()), 10.0 * float(own.max())
    if system.dt > 0.0:
        high = math.pi / system.dt
        low = min(low, 1e-3 * high)
    low = max(low, 1e-9 * high)
    fill = np.geomspace(low, high, 2 + int(10.0 * math.log10(high / low)))
    return np.unique(np.concatenate([[0.0], own[(own >= low) & (own <= high)], fill]))


# Grids of sampled systems end at this share of the Nyquist frequency.
_LAST = 0.999
# Points below, around and above the nutation frequency: for a search, and for one that misses no resonance.
_COUNTS, _FINE_COUNTS = (15, 60, 15), (15, 130, 25)

# Offsets from a resonance in units of its half-width: its shape is drawn whatever its sharpness.
_OFFSETS = np.array([0.0, 0.35, 0.7, 1.0, 1.5, 2.5, 4.0, 7.0, 12.0])
# A pole sharper than this is drawn as if it had this damping ratio: no spike of one point, no division by zero.
_MINIMUM_DAMPING = 2e-3
# Relative spacing below which two frequencies are one.
_RESOLUTION = 2e-4


def tuning_grid(nutation: float, period: float, fine: bool = False) -> FloatArray:
    """Return frequencies, rad/s, dense where margins are lost: between a sixth and about twice the nutation."""
    last = _LAST * np.pi / period
    # Where nutation is faster than what is sampled, the grid covers what is left below the Nyquist frequency.
    slowest = min(nutation / 150.0, np.pi / period / 100.0)
    edges = np.minimum([slowest, nutation / 6.0, 2.2 * nutation, last], last)
    parts = [
        np.geomspace(low, high, k, endpoint=False)
        for low, high, k in zip(edges, edges[1:], _FINE_COUNTS if fine else _COUNTS, strict=False)
        if high > low
    ]
    return np.append(np.concatenate(parts), last)


def following_grid(poles: ComplexArray, low: float, high: float, points: int = 220) -> FloatArray:
    """Return frequencies from `low` to `high`, logarithmic, denser around every resonance of `poles` (s-plane)."""
    s = np.asarray(poles).ravel()
    s = s[np.isfinite(s)]
    centre, distance = np.abs(s.imag), np.abs(s.real)
    sharp = (centre > low) & (centre < high) & (distance < 0.5 * centre)
    centre, distance = centre[sharp], distance[sharp]
    width = np.maximum(distance, _MINIMUM_DAMPING * centre)
    near = centre[:, None] + width[:, None] * np.concatenate([-_OFFSETS, _OFFSETS[1:]])
    grid = np.unique(np.concatenate([np.geomspace(low, high, points), near.ravel()]))
    grid = grid[(grid >= low) & (grid <= high)]
    # Next to an undamped pole the response is infinite, and sensitivities have no digits left.
    for at in centre[distance < _MINIMUM_DAMPING * centre]:
        grid = grid[np.abs(grid - at) > 0.3 * _MINIMUM_DAMPING * at]
    kept = np.concatenate([[True], np.diff(np.log(grid)) > _RESOLUTION])
    return np.asarray(grid[kept])


def damping_ratio(poles: ComplexArray) -> FloatArray:
    """Return -Re(s)/|s| of continuous(-equivalent) poles (..., n); 1 for infinitely fast ones, 0 for s = 0."""
    s = np.asarray(poles, dtype=np.complex128)
    size = np.abs(s)
    plain = np.isfinite(size) & (size > 0.0)
    out = np.where(np.isinf(size), 1.0, 0.0)
    out[plain] = -s.real[plain] / size[plain]
    return out


def damping(system: StateSystem) -> Damping:
    """Return natural frequency and damping ratio of every pole of `system`, slowest first.

    Parameters
    ----------
    system
        Continuous or discrete.

    Returns
    -------
    Damping
        One entry for each pole.

    Examples
    --------
    >>> import control
    >>> from platform_ctrl import analysis
    >>> analysis.damping(control.ss([[0, 1], [-1, -0.2]], [[0], [1]], [[1, 0]], 0)).ratio.round(3)
    array([0.1, 0.1])
    """
    dt = linear_arrays(system, "damping").dt
    s = continuous_poles(poles(system), dt)
    s = s[np.argsort(np.abs(s), kind="stable")]
    return Damping(poles=s, natural_frequency=np.abs(s), ratio=damping_ratio(s))


# Angle in a sample period, rad, below which poles next to z = 1 are split by rounding: their damping says nothing.
SPLIT = 1e-6


def minimum_damping(poles: ComplexArray, dt: float = 0.0) -> FloatArray:
    """Return the smallest damping ratio of the poles (..., n), 1 without poles.

    The poles are in the s-plane (dt = 0), rad/s, or in the z-plane of a system with sample period `dt`, s. Of poles
    next to z = 1, |s| dt < `SPLIT`, unstable ones alone count.
    """
    s = continuous_poles(poles, dt)
    counts = (np.abs(s) * dt > SPLIT) | (s.real > 0.0) if dt else np.full(s.shape, True)
    out: FloatArray = np.where(counts, damping_ratio(s), 1.0).min(axis=-1, initial=1.0)
    return out


def spectral_abscissa(poles: ComplexArray) -> FloatArray:
    """Return the largest real part of poles (..., n) along the last axis; -inf without poles."""
    out: FloatArray = poles.real.max(axis=-1, initial=-np.inf)
    return out


def fastest_pole(poles: ComplexArray, period: float) -> FloatArray:
    """Return the largest magnitude of the poles, rad/s, (...); of a sampled system in the w-plane.

    There a pole is w = (2/T) (z − 1)/(z + 1): a delay (z = 0) counts 2/T, and a pole that rings at the Nyquist
    frequency (z near −1) is as fast as can be.
    """
    size = np.abs(poles)
    if period > 0.0:
        with np.errstate(divide="ignore"):
            size = 2.0 / period * np.abs(poles - 1.0) / np.abs(poles + 1.0)
    return np.asarray(size.max(axis=-1, initial=0.0))


# The poles (k, n) at k values of the parameter.
Poles = Callable[[FloatArray], ComplexArray]


def pole_branches(z: ComplexArray) -> ComplexArray:
    """Return the poles (k, n) with each row sorted so that every column moves as little as possible."""
    from scipy.optimize import linear_sum_assignment

    out = z.copy()
    for k in range(1, len(z)):
        distance = np.abs(out[k - 1][:, None] - z[k][None, :])
        nearest = distance.argmin(axis=1)
        # Mostly each has its own nearest, and no assignment has to be solved.
        own = len(set(nearest.tolist())) == len(nearest)
        out[k] = z[k][nearest if own else linear_sum_assignment(distance)[1]]
    return out


# Singular value of [A - I; C] in balanced states, relative to the largest, below which it is rounding: a pole that
# decays or grows in an hour at 10 kHz is larger by a thousand.
_ROUNDING = 1e-12
# Share of a state in an equilibrium, and of the largest coupling of states, below which there is none.
_NO_PART, _NOTHING = 1e-13, 1e-30


class Drift(NamedTuple):
    """A system without its unseen equilibria, these (n, d), and how much of each there is in a state (d, n)."""

    system: System
    equilibria: FloatArray
    shares: FloatArray

    def motion(self, z: complex, mode: ComplexArray) -> ComplexArray:
        """Return a mode of `system` as the one of the system with its equilibria, which follow it; of any size."""
        return (z - 1.0) * mode + self.equilibria @ (self.shares @ mode)


def unseen_equilibria(system: System) -> Drift:
    """Return a sampled system without the equilibria that its outputs do not see: their poles z = 1 become 0, exactly.

    Responses of the outputs stay as they are.
    """
    V, L = _equilibria(system)
    return Drift(system._replace(A=system.A - (system.A @ V) @ L), V, L)


def _equilibria(system: System) -> tuple[FloatArray, FloatArray]:
    """Return unseen equilibria V (n, d) and how much of each there is in a state, L (d, n): L V = 1."""
    A, B, C, _, dt = system
    n = len(A)
    if not n or not dt:
        return np.zeros((n, 0)), np.zeros((0, n))
    s = state_scaling(*map(_coupling, (A, B, C)))
    balanced, rows = A * s / s[:, None], C * s
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = rows[size[:, 0] > 0.0] / size[size[:, 0] > 0.0]
    _, found, vectors = np.linalg.svd(np.vstack([balanced - np.eye(n), rows]))
    count = int(np.count_nonzero(found < _ROUNDING * found[0]))
    V = vectors[n - count :].T
    # States that have no part may have any scale.
    V = np.where(np.abs(V) > _NO_PART, V, 0.0)
    return V * s[:, None], V.T / s


def _coupling(matrix: FloatArray) -> FloatArray:
    """Return a matrix without what has decayed to nothing, over a long cycle say: no scale is to make up for it."""
    size = np.abs(matrix)
    return np.asarray(np.where(size > _NOTHING * size.max(initial=0.0), matrix, 0.0))


def without_drift(system: System) -> System:
    """Return sampled systems (..., n, n) without equilibria that their outputs do not see or their inputs do not reach.

    Responses stay as they are; poles z = 1 that they do not have become 0.
    """
    A, B, C, D, dt = system
    batch = A.shape[:-2]
    out = np.array(A).reshape(-1, *A.shape[-2:])
    for k, place in enumerate(np.ndindex(*batch)):
        B_k, C_k = (item[place] if item.ndim > 2 else item for item in (B, C))
        (V, L), (W, M) = _no_part(System(out[k], B_k, C_k, np.zeros((len(C_k), B_k.shape[1])), dt))
        left = out[k] - (out[k] @ V) @ L
        out[k] = left - M.T @ (W.T @ left)
    return System(out.reshape(A.shape), B, C, D, dt)


def over_a_cycle(systems: Sequence[System]) -> System:
    """Return systems that take turns as one, from the inputs of all samples to the outputs of all, without D."""
    state, seen = np.eye(systems[0].A.shape[1]), []
    for one in systems:
        seen.append(one.C @ state)
        state = one.A @ state
    after, reached = np.eye(len(state)), []
    for one in reversed(systems):
        reached.append(after @ one.B)
        after = after @ one.A
    B, C = np.hstack(reached), np.vstack(seen)
    return System(state, B, C, np.zeros((len(C), B.shape[1])), systems[0].dt)


def without_drift_over_a_cycle(systems: Sequence[System]) -> list[System]:
    """Return systems that take turns as `without_drift` does: what has no part in responses ends with each cycle."""
    (V, L), (W, M) = _no_part(over_a_cycle(systems))
    out = list(systems)
    out[0] = out[0]._replace(A=out[0].A - (out[0].A @ V) @ L)
    out[-1] = out[-1]._replace(A=out[-1].A - M.T @ (W.T @ out[-1].A))
    return out


def _no_part(system: System) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Return the equilibria that outputs do not see, and of the transpose those that inputs do not reach."""
    A, B, C, D, dt = system
    V, L = _equilibria(system)
    return (V, L), _equilibria(System((A - (A @ V) @ L).T, C.T, B.T, D.T, dt))


def onto_equilibria(system: System) -> FloatArray | None:
    """Return the projection P (n, n) of the states of a sampled system onto its poles z = 1, zero without any.

    None where such poles have no vectors of their own: motion along them grows by itself.
    """
    A, B, C, _, _ = system
    s = state_scaling(*map(_coupling, (A, B, C)))
    left, found, right = np.linalg.svd(A * s / s[:, None] - np.eye(len(A)))
    count = int(np.count_nonzero(found < _ROUNDING * found.max(initial=0.0)))
    if not count:
        return np.zeros_like(A)
    V, W = right[len(A) - count :].T, left[:, len(A) - count :]
    coupling = W.T @ V
    if np.linalg.svd(coupling, compute_uv=False)[-1] < math.sqrt(_ROUNDING):
        return None
    return np.asarray((V @ np.linalg.solve(coupling, W.T)) * s[:, None] / s)
