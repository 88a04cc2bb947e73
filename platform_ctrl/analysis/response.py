"""Systems of every kind: their frequency responses, and minimal realisations of transfer functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.resolvent import state_response
from platform_ctrl.analysis.system import ComplexArray, System, frequencies, scaled
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

# What has named signals, what has states, and what has at least values.
NamedSystem: TypeAlias = "control.StateSpace | control.TransferFunction"
StateSystem: TypeAlias = "control.StateSpace | control.TransferFunction | System"
LinearSystem: TypeAlias = "control.StateSpace | control.TransferFunction | control.FrequencyResponseData | System"

# Part of |A| (of B or C) below which a direction of the state space counts as not reached (not seen).
_UNREACHED = 1e-11
# Largest error of a realisation next to the poles' own frequencies, relative to the largest entry.
_REALISED = 1e-7


def linear_arrays(system: StateSystem, where: str) -> System:
    """Return the arrays of a `control.StateSpace`, or a minimal realisation of a `control.TransferFunction`.

    `where` is what messages call it. T. Kailath, Linear Systems, 1980, sec. 6.4.
    """
    if isinstance(system, System):
        return system
    if hasattr(system, "frdata"):
        raise ArgumentError(
            f"{where}: frequency response data say nothing between their frequencies; give a control.StateSpace or "
            "TransferFunction (of data take the values that you need from `data.frdata`)"
        )
    if not is_rational(system):
        return System.of(system, where)
    if not is_proper(system, where):
        raise ArgumentError(
            f"{where}: the transfer function is improper, an entry has more zeros than poles; add fast poles"
        )
    return _realisation(system, where)


def is_rational(system: Any) -> bool:
    """Return whether it is a `control.TransferFunction`."""
    return hasattr(system, "num_list") and hasattr(system, "den_list")


def is_proper(system: control.TransferFunction, where: str) -> bool:
    """Return whether no entry has more zeros than poles."""
    return all(len(num) <= len(den) for _, _, num, den in _entries(system, where))


def rational_response(system: control.TransferFunction, frequency: FloatArray) -> ComplexArray:
    """Return the values of a transfer function at `frequency` (N,), rad/s, as (p, m, N); inf at a pole."""
    where = "frequency_response"
    dt = _period(system, where)
    point = np.exp(1j * frequency * dt) if dt else 1j * frequency
    out = np.zeros((system.noutputs, system.ninputs, len(frequency)), dtype=np.complex128)
    for i, j, num, den in _entries(system, where):
        with np.errstate(all="ignore"):
            below = np.polyval(den, point)
            out[i, j] = np.where(below == 0.0, np.inf, np.polyval(num, point) / below) if len(num) else 0.0
    return out


def _period(system: Any, where: str) -> float:
    if system.dt is True:
        raise ArgumentError(f"{where}: the system is discrete without a sample period (dt=True); give dt in s")
    return 0.0 if system.dt is None else float(system.dt)


def _entries(system: Any, where: str = "transfer function") -> list[tuple[int, int, FloatArray, FloatArray]]:
    """Return outputs, inputs, numerators (empty: zero) and denominators without leading zeros."""
    out = []
    for i, j in np.ndindex(system.noutputs, system.ninputs):
        num, den = (
            np.trim_zeros(np.asarray(rows[i][j], dtype=np.float64), "f") for rows in (system.num_list, system.den_list)
        )
        if not (den.size and np.all(np.isfinite(num)) and np.all(np.isfinite(den))):
            raise ArgumentError(f"{where}: a coefficient is not finite, or a denominator is 0; check the system")
        out.append((i, j, num, den))
    return out


def _realisation(system: Any, where: str) -> System:
    """Return companion forms of the entries, and of several entries what is reached and seen."""
    p, m, dt = system.noutputs, system.ninputs, _period(system, where)
    entries = _entries(system, where)
    size = sum(len(den) - 1 for _, _, num, den in entries if len(num))
    A, B, C, D = np.zeros((size, size)), np.zeros((size, m)), np.zeros((p, size)), np.zeros((p, m))
    at = 0
    for i, j, num, den in entries:
        if not len(num):
            continue
        n = len(den) - 1
        num = np.concatenate([np.zeros(n + 1 - len(num)), num]) / den[0]
        den = den / den[0]
        own = slice(at, at + n)
        A[own, own] = np.eye(n, k=-1)
        A[at : at + 1, own] -= den[1:]
        B[at : at + 1, j] = 1.0
        C[i, own], D[i, j] = num[1:] - num[0] * den[1:], num[0]
        at += n
    if p * m == 1 or not size:
        return System(A, B, C, D, dt)
    # A pole that entries share would be there twice, and a loop closed around it could not move the second one.
    A, B, C = _minimal(A, B, C)
    _require_same(system, System(A, B, C, D, dt), where)
    return System(A, B, C, D, dt)


def _minimal(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what the inputs reach and the outputs see, in balanced states."""
    # Each signal in a unit of its own: none is small because of its unit.
    into, seen = np.linalg.norm(B, axis=0), np.linalg.norm(C, axis=1)
    into[into == 0.0] = seen[seen == 0.0] = 1.0
    A, B, C = scaled(A, B / into, C / seen[:, None])
    Q = _reached(A, B)
    A, B, C = scaled(Q.T @ A @ Q, Q.T @ B, C @ Q)
    Q = _reached(A.T, C.T)
    return Q.T @ A @ Q, (Q.T @ B) * into, seen[:, None] * (C @ Q)


def _reached(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the states that the inputs reach: the staircase form's columns."""
    size = float(np.linalg.norm(A, 2)) or 1.0
    Q, new = np.zeros((len(A), 0)), B
    threshold = _UNREACHED * float(np.linalg.norm(B, 2))
    while new.shape[1] and Q.shape[1] < len(A):
        for _ in range(2):
            new = new - Q @ (Q.T @ new)
        U, values, _ = np.linalg.svd(new, full_matrices=False)
        fresh = U[:, values > threshold]
        Q, new, threshold = np.hstack([Q, fresh]), A @ fresh, _UNREACHED * size
    return Q


def _require_same(system: Any, arrays: System, where: str) -> None:
    """Raise an ArgumentError where the realisation's response is not that of the transfer function."""
    rates = np.abs(np.concatenate([np.roots(den) for *_, den in _entries(system)]))
    w = (
        np.linspace(0.05, 0.95, 19) * np.pi / arrays.dt
        if arrays.dt
        else np.geomspace(0.1, 10.0, 5)[:, None] * np.unique(np.where(rates > 0.0, rates, 1.0))
    ).ravel()
    true, ours = rational_response(system, w), state_response(arrays, w)
    size = np.abs(true).max(axis=-1, where=np.isfinite(true), initial=0.0)
    with np.errstate(invalid="ignore"):
        wrong = np.abs(ours - true) > _REALISED * (np.abs(true) + 1e-3 * size[..., None])
    if np.any(wrong & np.isfinite(true) & np.isfinite(ours)):
        raise ArgumentError(
            f"{where}: the transfer function has no realisation of its states to {_REALISED:g} in floating point; "
            "make a control.StateSpace from the parts of the system"
        )


def frequency_response(
    system: LinearSystem,
    frequency: ArrayLike,
    axis: int = -1,
) -> ComplexArray:
    """Return the response of `system` on the imaginary axis or on the unit circle.

    States are balanced. The response is summed over the modes where the condition number of the eigenvectors is below
    1e4, else computed from the Schur form of A; z I - A itself is factored next to lightly damped poles and far below
    fast ones. What rounding changes is as if A were changed in its last digits. The error is relative to the products
    that C sums: where they cancel, as in a steep roll-off between states that mix, the small rest has fewer digits.

    Parameters
    ----------
    system
        Continuous or discrete `control.StateSpace`, p outputs, m inputs, a `control.TransferFunction` (its polynomials
        are evaluated), data (`control.FrequencyResponseData`, at frequencies of its own) or `System`, which may
        have leading batch axes.
    frequency : (N,)
        rad/s, >= 0.
    axis
        Axis of the frequencies in the result: the last one, or with -3 before the matrices, for products of responses.

    Returns
    -------
    complex (p, m, N), or (..., p, m, N)
        In the units of the outputs per unit of the inputs; inf where a frequency coincides with a computed pole.

    Raises
    ------
    ArgumentError
        If `system` or `frequency` is not what is expected, or data have no value at one of the frequencies.

    References
    ----------
    A. J. Laub, IEEE Trans. Automatic Control 26, 1981.
    """
    w = frequencies(frequency, "frequency_response")
    if not isinstance(axis, int) or axis not in (-1, -3):
        raise ArgumentError(f"frequency_response: axis must be -1 or -3, got {short(axis)}")
    return np.moveaxis(_response_of(system, w), -1, axis)


def _response_of(system: LinearSystem, w: FloatArray) -> ComplexArray:
    if isinstance(system, System):
        return state_response(system, w)
    if hasattr(system, "frdata"):
        return _measured(system, w)
    if is_rational(system):
        return rational_response(system, w)
    return state_response(System.of(system, "frequency_response"), w)


def _measured(data: control.FrequencyResponseData, w: FloatArray) -> ComplexArray:
    """Return the values of data at frequencies of their own."""
    own = np.asarray(data.omega, dtype=np.float64)
    if not own.size:
        raise ArgumentError("frequency_response: the data must have at least one frequency")
    nearest = np.abs(w[:, None] - own).argmin(axis=1)
    far = np.abs(own[nearest] - w) > 1e-9 * np.abs(w)
    if np.any(far):
        k = int(np.argmax(far))
        raise ArgumentError(
            f"frequency_response: the data have no value at {w[k]:g} rad/s, the nearest is at {own[nearest[k]]:g}; "
            "take frequencies of the data, which are not interpolated"
        )
    return np.asarray(data.frdata, dtype=np.complex128)[..., nearest]
