"""Frequency responses of systems of every kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, frequencies, state_arrays, system_arrays
from platform_ctrl.analysis.resolvent import TOLERATED, state_response
from platform_ctrl.analysis.transfer_function import LinearSystem, is_rational, rational_response
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control


def frequency_response(
    system: LinearSystem | Sequence[LinearSystem],
    frequency: ArrayLike,
    axis: int = -1,
    tolerance: float = TOLERATED,
) -> ComplexArray:
    """Return the response of `system` on the imaginary axis or on the unit circle.

    Each entry is right to 1e-9 of itself, or to 1e-12 of the largest entry at that frequency where it is smaller than
    a thousandth of that one; mostly to rounding. That holds for the system matrices digit by digit as they are,
    whatever the eigenvectors of A, and next to lightly damped poles, until the last digit of A decides: where |A| times
    |(z I - A)^-1| goes beyond 1e15 in balanced states; beyond 1e13 with 48 states or more, unless these fall apart into
    small groups or an order of them gives A a narrow band (modes, chains of bodies, finite elements, lumped masses).

    Parameters
    ----------
    system
        Continuous or discrete `control.StateSpace`, p outputs, m inputs, a `control.TransferFunction` (its polynomials
        are evaluated), data (`control.FrequencyResponseData`, at frequencies of its own) or `StateArrays`, which may
        have leading batch axes; or a sequence of K systems with as many outputs and inputs each (and states and sample
        periods of their own).
    frequency : (N,)
        rad/s, >= 0.
    axis
        Axis of the frequencies in the result: the last one, or with -3 before the matrices, for products of responses.
    tolerance
        Bound on the error of an entry, relative to itself, above which it is computed again with more digits.

    Returns
    -------
    complex (p, m, N), or (K, p, m, N) for a sequence, or (..., p, m, N)
        In the units of the outputs per unit of the inputs; inf where a frequency coincides with a pole (with
        48 states or more, all coupled, at frequency 0 only: elsewhere it is large).

    Raises
    ------
    ArgumentError
        If `system` or `frequency` is not what is expected, or data have no value at one of the frequencies.

    References
    ----------
    J. H. Wilkinson, The Algebraic Eigenvalue Problem, 1965, ch. 7, sec. 11.

    J. Demmel et al., ACM Transactions on Mathematical Software 32, 2006.
    """
    w = frequencies(frequency, "frequency_response")
    if not isinstance(axis, int) or axis not in (-1, -3):
        raise ArgumentError(f"frequency_response: axis must be -1 or -3, got {short(axis)}")
    tolerance = positive("frequency_response: tolerance", tolerance)
    if isinstance(system, StateArrays) or not isinstance(system, Sequence):
        return np.moveaxis(_response_of(system, w, tolerance), -1, axis)
    every = [_response_of(one, w, tolerance) for one in system]
    if len({one.shape for one in every}) != 1:
        raise ArgumentError(
            f"frequency_response: there must be at least one system, and outputs x inputs must be the same for all, "
            f"got {sorted({one.shape[:2] for one in every})}"
        )
    return np.moveaxis(np.stack(every), -1, axis)


def _response_of(system: LinearSystem, w: FloatArray, tolerance: float) -> ComplexArray:
    if isinstance(system, StateArrays):
        return state_response(*system_arrays("frequency_response", *system), w, tolerance)
    if hasattr(system, "frdata"):
        return _measured(system, w)
    if is_rational(system):
        return rational_response(system, w)
    return state_response(*state_arrays(system, "frequency_response"), w, tolerance)


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
