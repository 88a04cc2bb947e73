"""Stabilising solutions of Riccati equations, by the stable subspace of their Hamiltonian or symplectic pencil.

Continuous equations by the ordered real Schur form (Laub, IEEE Transactions on Automatic Control 24, 1979), discrete
ones by SciPy's ordered QZ. None means that there is no stabilising solution: an eigenvalue lies on the stability
boundary, or so near to it that rounding cannot tell.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from platform_ctrl.frozen import FloatArray

# Eigenvalues of a Hamiltonian matrix nearer to the imaginary axis than this share of its norm lie on it.
AXIS = 1e-10
# Largest asymmetry of a Riccati solution before it is made symmetric, relative to it, and what counts as zero when
# the matrices of the equation are near one: the solution 0 comes out as rounding.
SYMMETRY, ZERO = 1e-6, 1e-9
# Steps of Newton's method at most.
NEWTON_STEPS = 8


class Subspace(NamedTuple):
    """What the ordered Schur form of a Hamiltonian matrix says.

    Attributes
    ----------
    X
        The stabilising solution, symmetric; None where there is none.
    eigenvalues : complex (2n,)
        Of the Hamiltonian matrix.
    distance
        Of the eigenvalues from the imaginary axis, relative to the norm of the matrix.
    """

    X: FloatArray | None
    eigenvalues: np.ndarray[tuple[int, ...], np.dtype[np.complex128]]
    distance: float


def _in_left_half(real: float, imaginary: float) -> bool:
    return real < 0.0


def stabilising(H: FloatArray) -> Subspace:
    """Return the stabilising solution of the equation with the Hamiltonian matrix H = [A, −S; −Q, −A'].

    X makes A − S X stable and solves A'X + XA − XSX + Q = 0.
    """
    from scipy.linalg import lapack

    n = len(H) // 2
    size = float(np.linalg.norm(H))
    if not np.isfinite(size):
        return Subspace(None, np.zeros(0, dtype=np.complex128), 0.0)
    _, stable, real, imaginary, U, _, failed = lapack.dgees(
        _in_left_half, np.array(H, order="F"), lwork=max(1, 70 * n), sort_t=1, overwrite_a=1
    )
    eigenvalues = real + 1j * imaginary
    distance = float(np.abs(real).min(initial=np.inf)) / size if size else 0.0
    # Eigenvalues on the axis come out on either side of it, sometimes n on each.
    if failed or stable != n or distance < AXIS:
        return Subspace(None, eigenvalues, distance)
    try:
        X = np.linalg.solve(U[:n, :n].T, U[n:, :n].T).T
    except np.linalg.LinAlgError:
        return Subspace(None, eigenvalues, distance)
    # Then their subspace is not Lagrangian.
    if not np.linalg.norm(X - X.T) <= SYMMETRY * np.linalg.norm(X) + ZERO:
        return Subspace(None, eigenvalues, distance)
    return Subspace(0.5 * (X + X.T), eigenvalues, distance)


def continuous_solution(
    A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, N: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return X and the gain F = −R⁻¹(B'X + N') that makes A + B F stable, or None.

    X solves A'X + XA + Q − (XB + N) R⁻¹ (B'X + N') = 0: the least of ∫ x'Qx + 2 x'Nu + u'Ru is x'Xx. R is positive
    definite.
    """
    from scipy.linalg import solve_continuous_lyapunov

    into = np.linalg.solve(R, np.hstack([B.T, N.T]))
    n = len(A)
    left = A - B @ into[:, n:]
    H = np.block([[left, -B @ into[:, :n]], [N @ into[:, n:] - Q, -left.T]])
    X = stabilising(H).X
    if X is None:
        return None
    # Newton's method (Kleinman) takes back what the change to U11⁻¹ has cost: mostly one step. It converges from
    # wherever the loop is stable.
    F = -into[:, :n] @ X - into[:, n:]
    residual = A.T @ X + X @ A + Q - F.T @ R @ F
    for _ in range(NEWTON_STEPS):
        closed = A + B @ F
        if not np.all(np.isfinite(closed)) or np.linalg.eigvals(closed).real.max(initial=-1.0) >= 0.0:
            break
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            step = solve_continuous_lyapunov(closed.T, -0.5 * (residual + residual.T))
        if not np.all(np.isfinite(step)):
            break
        new = X + 0.5 * (step + step.T)
        F_new = -into[:, :n] @ new - into[:, n:]
        left = A.T @ new + new @ A + Q - F_new.T @ R @ F_new
        enough = np.linalg.norm(left) > 0.1 * np.linalg.norm(residual)
        if np.linalg.norm(left) <= np.linalg.norm(residual):
            X, F, residual = new, F_new, left
        if enough:
            break
    return X, F


def discrete_solution(
    A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, N: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return X, the gain F = −W⁻¹(B'XA + N') that makes A + B F stable, and W = R + B'XB; or None.

    X solves A'XA − X + Q − (A'XB + N) W⁻¹ (B'XA + N') = 0: the least of Σ x'Qx + 2 x'Nu + u'Ru is x'Xx. R may be
    singular, W must not be.
    """
    from scipy.linalg import solve_discrete_are

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            X = solve_discrete_are(A, B, Q, R, s=N)
            X = 0.5 * (X + X.T)
            W = R + B.T @ X @ B
            F = -np.linalg.solve(W, B.T @ X @ A + N.T)
        except (np.linalg.LinAlgError, ValueError):
            return None
    if not np.all(np.isfinite(F)) or np.abs(np.linalg.eigvals(A + B @ F)).max(initial=0.0) >= 1.0 - AXIS:
        return None
    return X, F, 0.5 * (W + W.T)


def relative_residual(
    A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, N: FloatArray, X: FloatArray, discrete: bool
) -> float:
    """Return the residual of the equation at X relative to the largest of its terms."""
    terms: tuple[FloatArray, ...]
    if discrete:
        terms = (A.T @ X @ A, -X, Q)
        cross, weight = A.T @ X @ B + N, R + B.T @ X @ B
    else:
        terms = (A.T @ X, X @ A, Q)
        cross, weight = X @ B + N, R
    terms = (*terms, -cross @ np.linalg.solve(weight, cross.T))
    size = max(float(np.linalg.norm(term)) for term in terms)
    return float(np.linalg.norm(sum(terms))) / size if size else 0.0
