"""Sensitivities of closed loops from responses: what a tuner that keeps the plants' responses works out anew."""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, square_responses


def sensitivities(loop: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return S = (I + L)^-1 and T = I - S for given responses of the loop.

    For a tuner that keeps the plant's response and changes the controller only: L = -K P by `numpy.matmul`.

    Parameters
    ----------
    loop : complex (..., m, m)
        L = -K P (broken at the input) or -P K (at the output), dimensionless.

    Returns
    -------
    S, T : complex (..., m, m)
        Dimensionless; inf in a matrix where I + L is singular or not a number.

    Raises
    ------
    ArgumentError
        `loop` is not square matrices of numbers.

    References
    ----------
    K. J. Åström, R. M. Murray, Feedback Systems, 2008, ch. 11.
    """
    from platform_ctrl.analysis.sensitivity_kernel import invert

    loop = square_responses("sensitivities: loop", loop, nan=True)
    eye = np.eye(loop.shape[-1])
    S = np.ascontiguousarray(eye + loop, dtype=np.complex128)
    invert(S.reshape(-1, *S.shape[-2:]))
    return S, eye - S


def sensitivities_of_plants(P: ComplexArray, K: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the sensitivities at the output and at the input of many plants with one controller, y = P u, u = K y.

    One inverse serves both: (I - K P)^-1 = I + K (I - P K)^-1 P.

    Parameters
    ----------
    P : complex (..., F, p, m)
        Responses of the plants, in their units.
    K : complex (F, m, p)
        Of the controller.

    Returns
    -------
    S_output : complex (..., F, p, p)
        (I - P K)^-1, in units of the outputs; inf where that is singular.
    S_input : complex (..., F, m, m)
        (I - K P)^-1, in units of the inputs.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    As `sensitivities`.
    """
    from platform_ctrl.analysis.sensitivity_kernel import close

    *batch, F, p, m = P.shape
    # Copies: numba would compile anew for what is frozen.
    plants = np.array(P, dtype=np.complex128, order="C").reshape(-1, F, p, m)
    S_output, S_input = (np.empty((len(plants), F, size, size), dtype=np.complex128) for size in (p, m))
    close(plants, np.array(K, dtype=np.complex128, order="C"), S_output, S_input)
    return S_output.reshape(*batch, F, p, p), S_input.reshape(*batch, F, m, m)
