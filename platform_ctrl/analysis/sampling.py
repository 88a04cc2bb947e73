"""From continuous to sampled and back: exact hold with lag and delay, and the bilinear map.

The delay is exact (no Padé): the part of it that is not a whole number of periods splits each period
into two intervals of constant input, and each is integrated with the matrix exponential
(Åström and Wittenmark, Computer-Controlled Systems, sec. 2.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.system import StateSpace, System, scaled, seen_states, state_scaling
from platform_ctrl.common.arguments import not_negative, positive
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

# States for held inputs: dense matrices of more take minutes each.
MOST_HELD = 1_000
# Short enough that an exponential over it is near the identity.
_SHORT = 0.4


@overload
def sampled(system: System, period: float, delay: float = ..., lag: ArrayLike | None = ...) -> System: ...
@overload
def sampled(system: StateSpace, period: float, delay: float = ..., lag: ArrayLike | None = ...) -> StateSpace: ...
def sampled(
    system: StateSpace | System, period: float, delay: float = 0.0, lag: ArrayLike | None = None
) -> StateSpace | System:
    """Return the system as a sampled controller sees it: hold, delay, actuator lag, plant, sampler.

    ::

        u[k] -> hold -> delay -> 1/(lag s + 1) -> system -> y(k period)

    Exact at the samples. States: those of `system`, one per lag that is not zero, and the held
    inputs u[k-1], u[k-2], ... that the delay still needs. Nothing is reduced.

    Parameters
    ----------
    system
        Continuous, m inputs: a `control.StateSpace`, or `System`, which may have leading batch axes.
    period
        Sample period, s; the result's `dt`.
    delay
        From the sample to the time at which the hold's output acts, s; any number >= 0, also more than a period.
    lag : (m,) or scalar, optional
        Time constant of the first-order lag in front of each input, s; 0 for none.

    Returns
    -------
    control.StateSpace or System
        As `system`, with the names of its inputs and outputs.

    Raises
    ------
    ArgumentError
        If the system is not continuous, or `period`, `delay` or `lag` make no sense.
    """
    arrays = system if isinstance(system, System) else System.of(system, "sampled")
    if arrays.dt != 0.0:
        raise ArgumentError(f"sampled: the system must be continuous, got dt = {arrays.dt} s")
    m = arrays.B.shape[-1]
    lags = not_negative("sampled: lag", 0.0 if lag is None else lag, m)
    A, B, C, D, _ = with_lag(arrays, lags)
    period, whole, part = split_delay("sampled", period, delay, m)
    reach = whole + (1 if part > 0.0 else 0)
    phi, late = held_input(A, B, (1.0 - part) * period)
    n = A.shape[-1]
    size = n + reach * m
    # Over [x, u[k-1], ..., u[k-reach], u[k]]: where the input of so many periods ago is.
    at = [slice(size, size + m), *(slice(n + j * m, n + (j + 1) * m) for j in range(reach))]
    step, row = (np.zeros((*phi.shape[:-2], rows, size + m)) for rows in (size, C.shape[-2]))
    if part > 0.0:
        # The older input acts first in each period.
        phi_early, early = held_input(A, B, part * period)
        step[..., :n, at[reach]] = phi @ early
        phi = phi @ phi_early
    step[..., :n, :n], step[..., :n, at[whole]] = phi, late
    for j in range(reach):
        step[..., at[j + 1], at[j]] = np.eye(m)
    row[..., :n], row[..., at[reach]] = C, D
    out = System(step[..., :size], step[..., size:], row[..., :size], row[..., size:], period)
    if isinstance(system, System):
        return out
    inputs = list(system.input_labels)
    states = sampled_states(list(system.state_labels), inputs, lags, size)
    return out.to_control(inputs, list(system.output_labels), states)


def sampled_states(states: Sequence[str], inputs: Sequence[str], lags: FloatArray, order: int) -> list[str]:
    """Return the names of the states of a sampled system of that order: its own, the lags' and the held inputs'."""
    out = [*states, *(f"lag_{name}" for name, one in zip(inputs, lags, strict=True) if one > 0.0)]
    held = (order - len(out)) // max(len(inputs), 1)
    return out + [f"{name}_held{j + 1}" for j in range(held) for name in inputs]


def every_nth(system: System, n: int, once: int | None = None) -> tuple[System, list[int]]:
    """Return a sampled system, which may have batch axes, at every n-th sample, and which of its states that has.

    Its inputs are held in between. The outputs behind the first `once` are taken at all n samples, one after another.
    States that hold the same input, and states that no output depends on any more, are left out.
    """
    A, B, C, D, dt = system
    first, often = slice(once), slice(C.shape[-2] if once is None else once, None)
    rows, direct = [C[..., first, :]], [D[..., first, :]]
    power, driven = np.broadcast_to(np.eye(A.shape[-1]), A.shape), np.zeros_like(B)
    for _ in range(n):
        rows.append(C[..., often, :] @ power)
        direct.append(C[..., often, :] @ driven + D[..., often, :])
        power, driven = A @ power, A @ driven + B
    C, D = np.concatenate(rows, axis=-2), np.concatenate(direct, axis=-2)
    states = A.shape[-1]
    moved = np.concatenate([power, driven], axis=-1).reshape(-1, states, states + B.shape[-1])
    kept, known = list(range(states)), dict[bytes, int]()
    for k in range(states):
        if moved[:, k].any() and not moved[:, k, :states].any():
            same = known.setdefault(moved[:, k].tobytes(), k)
            if same != k:
                power[..., :, same] += power[..., :, k]
                C[..., :, same] += C[..., :, k]
                kept.remove(k)
    own = power[..., kept, :][..., kept].reshape(-1, len(kept), len(kept))
    kept = [kept[k] for k in seen_states(own, C[..., kept].reshape(-1, C.shape[-2], len(kept)))]
    return System(power[..., kept, :][..., kept], driven[..., kept, :], C[..., kept], D, n * dt), kept


def late_outputs(system: System, periods: Sequence[int]) -> System:
    """Return a sampled system, which may have leading batch axes, whose outputs are late by whole sample periods."""
    if not any(periods):
        return system
    p, size = len(periods), sum(periods)
    A, B, C = np.zeros((size, size)), np.zeros((size, p)), np.zeros((p, size))
    first = 0
    for row, count in enumerate(periods):
        if count:
            # A chain of states: the reading of one sample ago, of two, ...
            own = slice(first, first + count)
            A[own, own], B[first, row], C[row, own.stop - 1] = np.eye(count, k=-1), 1.0, 1.0
            first += count
    return system.series(System(A, B, C, np.diag([float(count == 0) for count in periods]), system.dt))


def late_states(outputs: Sequence[str], periods: Sequence[int]) -> list[str]:
    """Return the names of the states that `late_outputs` adds."""
    return [f"{name}_late{j + 1}" for name, count in zip(outputs, periods, strict=True) for j in range(count)]


def split_delay(where: str, period: float, delay: float, inputs: int) -> tuple[float, int, float]:
    """Return the period, s, and the delay in periods: a whole number and the part that is left."""
    period, delay = positive(f"{where}: period", period), positive(f"{where}: delay", delay, zero=True)
    if delay / period * inputs > MOST_HELD:
        words = f"delay = {delay:.4g} s needs {delay / period * inputs:.4g} states for held inputs"
        raise ArgumentError(f"{where}: {words}; at most {MOST_HELD} are possible")
    whole = math.floor(delay / period + 1e-9)
    part = delay / period - whole
    # A delay given as a decimal fraction is rarely a multiple of the period to the last bit.
    return period, whole, 0.0 if part < 1e-9 else part


def with_lag(system: System, lags: FloatArray) -> System:
    """Return a continuous system with a first-order lag in front of every input whose time constant is not zero."""
    slow = np.flatnonzero(lags > 0.0)
    if slow.size == 0:
        return system
    chosen, rates = np.eye(len(lags))[:, slow], 1.0 / lags[slow]
    lag = System(np.diag(-rates), rates[:, None] * chosen.T, chosen, np.diag(np.where(lags > 0.0, 0.0, 1.0)))
    A, B, C, D, _ = lag.series(system)
    # The system's own states first.
    order = np.roll(np.arange(A.shape[-1]), -slow.size)
    return System(A[..., order, :][..., order], B[..., order, :], C[..., order], D)


def held_input(A: FloatArray, B: FloatArray, duration: float) -> tuple[FloatArray, FloatArray]:
    """Return exp(A h) and its integral times B over `duration` h: one step with the input held."""
    n = A.shape[-1]
    # Balanced states: expm would otherwise square too often and lose digits.
    s = state_scaling(A, B, np.zeros((0, n)))
    phi, held = input_steps(A * s / s[:, None], B / s[:, None], duration, ramp=False)
    return phi * s[:, None] / s, held * s[:, None]


def input_steps(A: FloatArray, B: FloatArray, duration: float, ramp: bool) -> tuple[FloatArray, FloatArray]:
    """Return exp(A h) of balanced states, and what an input adds in one step that is held, then one that rises from 0.

    The latter, (n, m) or (n, 2 m), stand side by side.
    """
    from scipy.linalg import expm

    n, m = A.shape[-1], B.shape[-1]
    batch = () if A.ndim == B.ndim == 2 else np.broadcast_shapes(A.shape[:-2], B.shape[:-2])
    N = n + (2 * m if ramp else m)
    whole = np.zeros((*batch, N, N))
    whole[..., :n, :n] = A * duration
    # A power of two that makes the input matrix as large as A is exact to undo.
    size = np.abs(whole).max(initial=0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        gain = np.abs(B).max(initial=0.0) * duration
        ratio = gain / size if size > 0.0 and 0.0 < gain < math.inf else 1.0
        unit = 2.0 ** round(math.log2(ratio)) if 0.0 < ratio < math.inf else 1.0
        whole[..., :n, n : n + m] = B * (duration / unit)
        # Inputs that rise are states of their own.
        whole[..., n : n + m, n + m :] = np.eye(m, N - n - m)
        power = expm(whole)[..., :n, :]
        power[..., n:] *= unit
    if not np.isfinite(power).all():
        raise ArgumentError(
            f"sampled: within {duration:.3g} s the plant grows beyond floating-point numbers; take a shorter period"
        )
    return power[..., :n], power[..., n:]


def energy_rows(plant: System, period: float, delay: float) -> list[FloatArray]:
    """Return of each output of a continuous plant rows E (r, n' + m): |E [x; u]|² is its energy over a period.

    x (n',) and u (m,) are the states and inputs of the plant as `sampled` makes it, at the period's sample.
    """
    A, B, C, D, _ = plant
    n, m = B.shape
    s = state_scaling(A, B, C)
    period, whole, part = split_delay("energy_rows", period, delay, m)
    # The unit of an input is what it does to the states in a period, or to an output at once.
    unit = np.maximum(np.abs(B / s[:, None]).max(axis=0, initial=0.0) * period, np.abs(D).max(axis=0, initial=0.0))
    unit = np.where(unit > 0.0, 1.0 / np.where(unit > 0.0, unit, 1.0), 1.0)
    F = np.zeros((n + m, n + m))
    F[:n, :n], F[:n, n:] = A * s / s[:, None], B / s[:, None] * unit
    seen = np.hstack([C * s, D * unit])
    early, of_early = _energy(F, seen, part * period)
    _, of_late = _energy(F, seen, (1.0 - part) * period)
    # Over [x, u₁, u₂]: u₁ acts before the delay's fractional part is over, u₂ after it.
    first, second = np.eye(n + m, n + 2 * m), np.eye(n + m, n + 2 * m, k=m)
    second[:n] = (early @ first)[:n]
    size = n + m * (whole + (1 if part > 0.0 else 0))
    into = np.zeros((n + 2 * m, size + m))
    into[:n, :n] = np.diag(1.0 / s)
    for place, age in ((n + m, whole), *([(n, whole + 1)] if part > 0.0 else [])):
        column = n + (age - 1) * m if age else size
        into[place : place + m, column : column + m] = np.diag(1.0 / unit)
    return [factor(one).T @ into for one in first.T @ of_early @ first + second.T @ of_late @ second]


def _energy(F: FloatArray, rows: FloatArray, duration: float) -> tuple[FloatArray, FloatArray]:
    """Return exp(F h), and of each row c the integral of exp(F't) c c' exp(Ft) over `duration` h: (q, n, n)."""
    from scipy.linalg import expm

    n = len(F)
    size = float(np.linalg.norm(F, 1))
    doublings = max(0, math.ceil(math.log2(size * duration / _SHORT))) if size * duration > 0.0 else 0
    short = duration / 2.0**doublings
    weights = rows[:, :, None] * rows[:, None, :]
    units = np.abs(weights).max(axis=(1, 2), keepdims=True, initial=0.0)
    units[units == 0.0] = 1.0
    whole = np.zeros((len(rows), 2 * n, 2 * n))
    whole[:, :n, :n], whole[:, :n, n:], whole[:, n:, n:] = -F.T, weights / units * (size or 1.0), F
    power = expm(whole * short)
    phi, energy = expm(F * short), power[:, n:, n:].swapaxes(-1, -2) @ power[:, :n, n:]
    # Sums of positive terms: small energies keep their digits beside large ones.
    for _ in range(doublings):
        energy, phi = energy + phi.T @ energy @ phi, phi @ phi
    energy = energy * (units / (size or 1.0))
    return phi, 0.5 * (energy + energy.swapaxes(-1, -2))


def factor(square: FloatArray) -> FloatArray:
    """Return B with B B' = a positive semidefinite matrix, one column for each direction above rounding."""
    if square.size == 0:
        return np.zeros((len(square), 0))
    values, vectors = np.linalg.eigh(square)
    kept = values > len(square) * np.finfo(float).eps * max(float(values[-1]), 0.0)
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


def to_w_plane(system: System) -> System:
    """Return a discrete system in w = (2/T) (z - 1)/(z + 1), in balanced states.

    The map is exact: stability, the H-infinity norm and the values along the frequency axis are kept, the latter at
    w = j (2/T) tan(frequency T/2). A pole at z = -1, which would go to infinity, is an `ArgumentError`.
    """
    A, B, C = scaled(*system[:3])
    D, period, eye = system.D, system.dt, np.eye(A.shape[-1])
    inverse = _inverse(A + eye, "the system has a pole at z = -1")
    root = 2.0 / math.sqrt(period)
    return System(2.0 / period * (inverse @ (A - eye)), root * (inverse @ B), root * (C @ inverse), D - C @ inverse @ B)


def from_w_plane(system: System, period: float) -> System:
    """Return a system in w in z, in balanced states: the inverse of `to_w_plane` (Tustin's map)."""
    A, B, C = scaled(*system[:3])
    D, half, root, eye = system.D, 0.5 * period, math.sqrt(period), np.eye(A.shape[-1])
    inverse = _inverse(eye - half * A, f"the system has a pole at 2/period = {2.0 / period:g}")
    return System(
        inverse @ (eye + half * A), root * (inverse @ B), root * (C @ inverse), D + half * (C @ inverse @ B), period
    )


def _inverse(matrix: FloatArray, pole: str) -> FloatArray:
    smallest = np.linalg.svd(matrix, compute_uv=False).min(initial=np.inf)
    if smallest < 1e-14 * max(1.0, float(np.abs(matrix).max(initial=0.0))):
        raise ArgumentError(
            f"bilinear map: {pole}, which the map sends to infinity; use another period, or remove that pole"
        )
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
