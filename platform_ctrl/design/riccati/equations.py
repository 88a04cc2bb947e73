"""Stabilising solutions of algebraic Riccati equations, continuous and discrete, in units in which they are near one.

Continuous equations are solved by the ordered real Schur form of the Hamiltonian matrix (Laub, IEEE Transactions on
Automatic Control 24, 1979): it is six times as fast as SciPy's pencil, which counts in the H-infinity bisection, and
better next to the imaginary axis. SciPy solves discrete equations, and continuous ones for which the Schur form fails.
One step of Newton's method (Kleinman, ibid. 13, 1968; Hewer, ibid. 16, 1971) corrects a solution; the residual,
relative to the terms of the equation, must be small.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import UnscalableError

# Eigenvalues of a Hamiltonian matrix nearer to the imaginary axis than this share of its norm lie on it.
AXIS_DISTANCE = 1e-12
# Largest asymmetry of a Riccati solution before it is made symmetric, relative to it, and what counts as zero when
# the matrices of the equation are near one: the solution 0 comes out as rounding.
LARGEST_ASYMMETRY, SOLUTION_ROUNDING = 1e-6, 1e-9
# Largest residual of an equation, relative to the largest of its terms.
LARGEST_RESIDUAL = 1e-6


class Equation(NamedTuple):
    """A'X + XA + Q − (XB + N) R⁻¹ (B'X + N') = 0, or A'XA − X + Q − (A'XB + N) (R + B'XB)⁻¹ (B'XA + N') = 0."""

    A: FloatArray
    B: FloatArray
    Q: FloatArray
    R: FloatArray
    N: FloatArray
    discrete: bool


class Solution(NamedTuple):
    """A solution X and what is made of it."""

    X: FloatArray
    F: FloatArray  # u = F x makes A + B F stable: −W⁻¹(B'X + N'), discrete −W⁻¹(B'XA + N')
    W: FloatArray  # R, discrete R + B'XB
    residual: FloatArray
    relative: float  # norm of the residual over that of the largest term


def riccati_solution(equation: Equation, where: str) -> Solution:
    """Return the stabilising solution; an UnscalableError, which begins with `where`, if none is found.

    Of all inputs that bring x to rest, the least of ∫ x'Qx + 2 x'Nu + u'Ru is x'Xx.
    """
    from scipy.linalg import solve_continuous_are, solve_discrete_are

    A, B, Q, R, N, discrete = equation
    solve = solve_discrete_are if discrete else solve_continuous_are
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            X = None if discrete else stabilising(equation)
            return refined(equation, solve(A, B, Q, R, s=N) if X is None else X, where)
    except (np.linalg.LinAlgError, ValueError):
        boundary = "unit circle" if discrete else "imaginary axis"
        raise UnscalableError(
            f"{where} has no stabilising solution: u or y hardly reaches a mode on the {boundary}, or a zero is near "
            "it; add small weights on the controls to z and small noises on the measurements to w, or give "
            "regularise=1e-3"
        ) from None


def refined(equation: Equation, X: FloatArray, where: str) -> Solution:
    """Return a solution after one step of Newton's method; an UnscalableError where its residual stays large."""
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    found = _evaluated(equation, X)
    loop = (equation.A + equation.B @ found.F).T
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        if equation.discrete:
            step = solve_discrete_lyapunov(loop, found.residual)
        else:
            step = solve_continuous_lyapunov(loop, -found.residual)
    better = _evaluated(equation, found.X + step)
    best = better if better.relative < found.relative else found
    if not best.relative <= LARGEST_RESIDUAL:
        raise UnscalableError(
            f"{where} is solved with a residual of {best.relative:.1e} times its largest term; give weights with less "
            "spread between slow and fast poles, or between large and small gains"
        )
    return best


def _evaluated(equation: Equation, X: FloatArray) -> Solution:
    A, B, Q, R, N, discrete = equation
    X = 0.5 * (X + X.T)
    terms = [A.T @ X @ A, -X, Q] if discrete else [A.T @ X, X @ A, Q]
    cross, W = (A.T @ X @ B + N, R + B.T @ X @ B) if discrete else (X @ B + N, R)
    F = np.asarray(-np.linalg.solve(W, cross.T), dtype=np.float64)
    terms.append(cross @ F)
    residual = terms[0] + terms[1] + terms[2] + terms[3]
    # Terms that are all rounding count as larger.
    size = max(SOLUTION_ROUNDING, *(float(np.linalg.norm(term)) for term in terms))
    return Solution(X, F, W, 0.5 * (residual + residual.T), float(np.linalg.norm(residual)) / size)


def stabilising(equation: Equation) -> FloatArray | None:
    """Return the stabilising X of a continuous equation with a regular R of any sign, fast; None where there is none.

    There is none where eigenvalues of the Hamiltonian matrix lie on the imaginary axis.
    """
    from scipy.linalg import lapack

    A, B, Q, R, N, _ = equation
    n = len(A)
    into = np.linalg.solve(R, np.hstack([N.T, B.T]))
    left = A - B @ into[:, :n]
    H = np.vstack([np.hstack([left, -B @ into[:, n:]]), np.hstack([N @ into[:, :n] - Q, -left.T])])
    if not np.all(np.isfinite(H)):
        return None
    # Units of the states, x = d x', with which the costates are in 1/d: powers of two that balance H.
    _, _, _, scale, _ = lapack.dgebal(H - np.diag(np.diag(H)), scale=1, permute=0)
    d = np.exp2(np.round(0.5 * np.log2(scale[:n] / scale[n:])))
    both = np.concatenate([d, 1.0 / d])
    H = H / both[:, None] * both
    # What is fast first: the QR algorithm then keeps the digits of what is slow.
    order = np.argsort(-np.linalg.norm(H, axis=1), kind="stable")
    H = np.array(H[np.ix_(order, order)], order="F")
    _, stable, real, imaginary, U, _, failed = lapack.dgees(
        lambda real, imaginary: real < 0.0, H, lwork=max(1, 70 * n), sort_t=1, overwrite_a=1
    )
    # Eigenvalues on the axis come out on either side of it, sometimes n on each.
    if failed or stable != n or np.any(np.abs(real) <= AXIS_DISTANCE * np.abs(imaginary)):
        return None
    U = U[np.argsort(order)]
    try:
        X = np.linalg.solve(U[:n, :n].T, U[n:, :n].T).T
    except np.linalg.LinAlgError:
        return None
    # Then their subspace is not Lagrangian.
    if not np.linalg.norm(X - X.T) <= LARGEST_ASYMMETRY * np.linalg.norm(X) + SOLUTION_ROUNDING:
        return None
    return np.asarray(0.5 * (X + X.T) / d / d[:, None])
