"""Structured singular value of complex matrices for diagonal complex perturbations, many matrices at once.

mu(M) = 1 / min {max_i |delta_i| : det(I - M diag(delta)) = 0}. Upper bound: the smallest largest singular value of
D M D^-1 over diagonal D > 0 (exact up to three channels: Packard and Doyle, Automatica 29, 1993). Lower bound: the
spectral radius of Q M over unitary diagonal Q, reached by a perturbation that can be named.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray


class MuBounds(NamedTuple):
    """Bounds of mu for each of N matrices of m channels.

    Attributes
    ----------
    upper, lower : (N,)
        Equal to the tolerance up to three channels.
    D : (N, m)
        Scalings: `upper` bounds the largest singular value of D M D^-1. Geometric mean 1.
    Q : complex (N, m)
        Phases: `lower` is the spectral radius of Q M, to rounding of the power iteration that found it. All but one of
        them are 0 where one channel alone reaches more than the phases that were found.
    """

    upper: FloatArray
    lower: FloatArray
    D: FloatArray
    Q: ComplexArray


def mu_bounds(M: ComplexArray, tolerance: float = 1e-6) -> MuBounds:
    """Return both bounds of mu for matrices (N, m, m), faster where each resembles the one before.

    Parameters
    ----------
    M : complex (N, m, m)
        Finite.
    tolerance
        Relative, of the upper bound; every returned value is an upper bound whatever the tolerance.
    """
    # Compiled, or taken from numba's cache, with the first call.
    from platform_ctrl.analysis import mu_kernel

    N, m, _ = M.shape
    upper, lower, D, Q = np.empty(N), np.empty(N), np.empty((N, m)), np.empty((N, m), dtype=np.complex128)
    mu_kernel.mu_bounds(np.ascontiguousarray(M, dtype=np.complex128), tolerance, upper, lower, D, Q)
    return MuBounds(upper=upper, lower=lower, D=D, Q=Q)


def perturbation(M: ComplexArray, Q: ComplexArray) -> ComplexArray:
    """Return delta (m,) with |delta_i| = 1/rho(Q M) or 0 for which I - M diag(delta) is singular; M (m, m), Q (m,).

    Real where M is and signs reach as much as the phases; infinite where Q M has no eigenvalue but 0.
    """
    largest = _largest_eigenvalue(Q, M)
    if largest == 0.0:
        return np.full(len(Q), np.inf + 0j)
    if np.abs(M.imag).max() <= 1e-13 * np.abs(M.real).max():
        # Eigenvalues of a matrix of real numbers: those on the real axis are real without rounding.
        signs = np.sign(np.round((Q / largest * abs(largest)).real))
        real = _largest_eigenvalue(signs, M.real)
        if abs(real) >= (1.0 - 1e-9) * abs(largest) and real.imag == 0.0:
            return np.asarray(signs / real.real, dtype=np.complex128)
    return Q / largest


def _largest_eigenvalue(Q: ComplexArray | FloatArray, M: ComplexArray | FloatArray) -> complex:
    eigenvalues = np.linalg.eigvals(Q[:, None] * M)
    return complex(eigenvalues[np.argmax(np.abs(eigenvalues))])
