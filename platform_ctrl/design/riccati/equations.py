"""Stabilising solutions of algebraic Riccati equations, continuous and discrete.

A first solution comes from the ordered real Schur form of the Hamiltonian matrix (Laub, IEEE Transactions on Automatic
Control 24, 1979) or from SciPy's ordered QZ form of the extended pencil, whichever has a stable loop. Newton's method
(Kleinman, ibid. 13, 1968; Hewer, ibid. 16, 1971) then corrects it, with residuals in 128 bits: in double precision a
nearly singular weight would limit them.

None means that there is no stabilising solution: an eigenvalue lies on the stability boundary. Where double precision
does not decide this, the eigenvalues are computed with more digits.
"""

from __future__ import annotations

import importlib.util
import math
import warnings
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.riccati.balls import Balls, balls, blocks, identity

# Eigenvalues of a Hamiltonian matrix nearer to the imaginary axis than this share of its norm lie on it.
AXIS_DISTANCE = 1e-12
# Largest asymmetry of a Riccati solution before it is made symmetric, relative to it, and what counts as zero when
# the matrices of the equation are near one: the solution 0 comes out as rounding.
LARGEST_ASYMMETRY, SOLUTION_ROUNDING = 1e-6, 1e-9
# Largest number of Newton steps, and the ratio of residuals that a step must stay below.
NEWTON_STEPS, NEWTON_PROGRESS = 30, 0.7
# A Newton step below this, in units in which the diagonal of X is near one, is below the rounding of X.
LEAST_STEP = 1e-18
# Smallest entry on the diagonal of X that units of the states bring to one, relative to the largest.
SMALLEST_COST = 1e-24
# Residual over the largest term below which Newton's method converges at once, and most steps to get there.
NEWTON_RESIDUAL, APPROACH_STEPS = 1e-2, 100
# Whether there is python-flint, of the extra `proofs`; without it nearly singular weights are refused more often.
MANY_BITS = importlib.util.find_spec("flint") is not None
# Bits of a residual, and the number of states up to which it is computed with them.
RESIDUAL_BITS, RESIDUAL_STATES = 128, 128
# A pole is off the stability boundary if it decays by this many times its rounding, or by this share of the norm of the
# loop's matrix (sampled loops: of 1); and the share where the number of states excludes a better test.
DECAY_OVER_ROUNDING, SAFE_DECAY, SAFE_DECAY_WITHOUT_TEST = 1e3, 0.2, 1e-3
# Otherwise the eigenvalues are computed with so many bits, up to so many states. One is on the boundary if its decay
# over its size, or its size over the largest, is less: multiple ones separate by a root of the rounding unit.
EIGENVALUE_BITS, EIGENVALUE_STATES, BOUNDARY_DECAY, ZERO_EIGENVALUE = 400, 40, 1e-14, 1e-20


class Equation(NamedTuple):
    """A'X + XA + Q − (XB + N) R⁻¹ (B'X + N') = 0, or A'XA − X + Q − (A'XB + N) (R + B'XB)⁻¹ (B'XA + N') = 0."""

    A: FloatArray
    B: FloatArray
    Q: FloatArray
    R: FloatArray
    N: FloatArray
    discrete: bool


# F, W, the residual, and the size of its largest term.
Evaluation = tuple[FloatArray, FloatArray, FloatArray, float]


class Subspace(NamedTuple):
    """The stabilising solution of a Hamiltonian matrix, or None, and the matrix's eigenvalues, (2n,)."""

    X: FloatArray | None
    eigenvalues: ComplexArray
    distance: float  # of the eigenvalues from the imaginary axis, relative to the norm of the matrix


def stabilising(H: FloatArray, axis: float = AXIS_DISTANCE) -> Subspace:
    """Return the stabilising solution of the equation with the Hamiltonian matrix H = [A, −S; −Q, −A'].

    X makes A − S X stable and solves A'X + XA − XSX + Q = 0. Eigenvalues nearer to the imaginary axis than `axis` times
    the norm of H count as on it.
    """
    from scipy.linalg import lapack

    n = len(H) // 2
    size = float(np.linalg.norm(H))
    if not np.isfinite(size):
        return Subspace(None, np.zeros(0, dtype=np.complex128), 0.0)
    # Units of the states, x = d x', with which the costates are in 1/d: powers of two that balance H.
    _, _, _, scale, _ = lapack.dgebal(H - np.diag(np.diag(H)), scale=1, permute=0)
    d = np.exp2(np.round(0.5 * np.log2(scale[:n] / scale[n:])))
    both = np.concatenate([d, 1.0 / d])
    H = H / both[:, None] * both
    size = float(np.linalg.norm(H))
    _, stable, real, imaginary, U, _, failed = lapack.dgees(
        lambda real, imaginary: real < 0.0, np.array(H, order="F"), lwork=max(1, 70 * n), sort_t=1, overwrite_a=1
    )
    eigenvalues = real + 1j * imaginary
    distance = float(np.abs(real).min(initial=np.inf)) / size if size else 0.0
    # Eigenvalues on the axis come out on either side of it, sometimes n on each.
    if failed or stable != n or distance < axis:
        return Subspace(None, eigenvalues, distance)
    try:
        X = np.linalg.solve(U[:n, :n].T, U[n:, :n].T).T
    except np.linalg.LinAlgError:
        return Subspace(None, eigenvalues, distance)
    # Then their subspace is not Lagrangian.
    if not np.linalg.norm(X - X.T) <= LARGEST_ASYMMETRY * np.linalg.norm(X) + SOLUTION_ROUNDING:
        return Subspace(None, eigenvalues, distance)
    return Subspace(0.5 * (X + X.T) / d / d[:, None], eigenvalues, distance)


def riccati_solution(equation: Equation) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return X, the gain F = −W⁻¹(B'X + N') that makes A + B F stable, and W = R, or None.

    F as in the synthesis formulas of Zhou, Doyle and Glover, u = F x; the K of u = −K x is −F.
    Of all inputs that bring x to rest, the least of ∫ x'Qx + 2 x'Nu + u'Ru is x'Xx. R is positive definite; Q need not
    be. Discrete equations: W = R + B'XB and F = −W⁻¹(B'XA + N'). R may be singular, W must not be.
    """
    for start in _starts(equation):
        found = _refined(equation, start)
        if found is not None:
            return found if _off_boundary(equation, *found) else None
    if len(equation.A) <= EIGENVALUE_STATES and MANY_BITS:
        eigenvalues, X = _eigenvalues_in_many_bits(equation)
        if _on_boundary(eigenvalues):
            return None
        found = None if X is None else _refined(equation, X)
        if found is not None:
            return found
    raise np.linalg.LinAlgError("no stabilising solution of the Riccati equation was found")


def _starts(equation: Equation) -> Iterator[FloatArray]:
    """Yield what the two methods find, each computed when it is needed."""
    if not equation.discrete:
        try:
            X = stabilising(hamiltonian(equation), axis=0.0).X
        except np.linalg.LinAlgError:
            X = None
        if X is not None:
            yield X
    for balanced in (True, False):
        X = by_pencil(equation, balanced)
        if X is not None:
            yield X


def by_pencil(equation: Equation, balanced: bool = True) -> FloatArray | None:
    """Return the solution by SciPy's ordered QZ form of the extended pencil, or None."""
    from scipy.linalg import solve_continuous_are, solve_discrete_are

    A, B, Q, R, N, discrete = equation
    solve = solve_discrete_are if discrete else solve_continuous_are
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            X = np.asarray(solve(A, B, Q, R, s=N, balanced=balanced), dtype=np.float64)
        except (np.linalg.LinAlgError, ValueError, ArithmeticError):
            return None
    return 0.5 * (X + X.T) if np.all(np.isfinite(X)) else None


def _refined(equation: Equation, X: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return X, F and W after Newton's method from X; None where the loop of F is not stable."""
    found = _stable(equation, X)
    if found is None:
        return None
    X, found = _approached(equation, X, found)
    unit = _cost_units(X)
    left = _size(found[2], unit)
    for _ in range(NEWTON_STEPS):
        closed = equation.A + equation.B @ found[0]
        # States that hardly cost anything suit the given units better.
        for s in (unit, np.ones(len(X))):
            step = _step(closed, found[2], s, equation.discrete)
            if step is None or np.all(np.abs(step * unit * unit[:, None]) <= LEAST_STEP):
                continue
            better = _stable(equation, X + step)
            if better is not None and _size(better[2], unit) < NEWTON_PROGRESS * left:
                X, found = X + step, better
                left = _size(found[2], unit)
                break
        else:
            break
    return X, found[0], found[1]


def _approached(equation: Equation, X: FloatArray, found: Evaluation) -> tuple[FloatArray, Evaluation]:
    """Return a solution from which the residual falls with every Newton step: at first it may rise."""
    first = X, found
    for _ in range(APPROACH_STEPS):
        if float(np.linalg.norm(found[2])) <= NEWTON_RESIDUAL * found[3]:
            return X, found
        step = _step(equation.A + equation.B @ found[0], found[2], _cost_units(X), equation.discrete)
        better = None if step is None else _stable(equation, X + step)
        if step is None or better is None:
            return first
        X, found = X + step, better
    return first


def _cost_units(X: FloatArray) -> FloatArray:
    """Return units of the states in which the diagonal of X is near one: small entries count as much as large ones."""
    costs = np.abs(np.diag(X))
    costs = np.maximum(costs, SMALLEST_COST * (float(costs.max(initial=0.0)) or 1.0))
    return np.asarray(np.exp2(-np.round(0.5 * np.log2(costs))))


def _step(closed: FloatArray, residual: FloatArray, unit: FloatArray, discrete: bool) -> FloatArray | None:
    """Return Newton's step, by a Lyapunov (Stein) equation in units of the states."""
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    scaled, right = (closed * unit / unit[:, None]).T, residual * unit * unit[:, None]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            step = solve_discrete_lyapunov(scaled, right) if discrete else solve_continuous_lyapunov(scaled, -right)
        except (np.linalg.LinAlgError, ValueError):
            return None
    step = 0.5 * (step + step.T) / unit / unit[:, None]
    return step if np.all(np.isfinite(step)) else None


def _size(residual: FloatArray, unit: FloatArray) -> float:
    """Return the size of a residual, in the given units times in others."""
    return float(np.linalg.norm(residual)) * float(np.linalg.norm(residual * unit * unit[:, None]))


def _stable(equation: Equation, X: FloatArray) -> Evaluation | None:
    """Return F and W of X, the residual and the size of its largest term; None where the loop of F is not stable."""
    try:
        found = _evaluated(equation, X)
    except (np.linalg.LinAlgError, ZeroDivisionError):
        return None
    F, _, residual, _ = found
    if not (np.all(np.isfinite(F)) and np.all(np.isfinite(residual))):
        return None
    poles = np.linalg.eigvals(equation.A + equation.B @ F)
    inside = np.abs(poles).max(initial=0.0) < 1.0 if equation.discrete else poles.real.max(initial=-1.0) < 0.0
    return found if inside else None


def _evaluated(equation: Equation, X: FloatArray) -> Evaluation:
    return _in_many_bits(equation, X) if len(X) <= RESIDUAL_STATES and MANY_BITS else _in_doubles(equation, X)


def _in_doubles(equation: Equation, X: FloatArray) -> Evaluation:
    A, B, Q, R, N, discrete = equation
    terms = [A.T @ X @ A, -X, Q] if discrete else [A.T @ X, X @ A, Q]
    cross, W = (A.T @ X @ B + N, R + B.T @ X @ B) if discrete else (X @ B + N, R)
    F = np.asarray(-np.linalg.solve(W, cross.T), dtype=np.float64)
    terms.append(cross @ F)
    residual = terms[0] + terms[1] + terms[2] + terms[3]
    return F, W, 0.5 * (residual + residual.T), max(float(np.linalg.norm(term)) for term in terms)


def _in_many_bits(equation: Equation, X: FloatArray) -> Evaluation:
    """Return what `_in_doubles` does, computed with more digits."""
    import flint

    with flint.ctx.workprec(RESIDUAL_BITS):
        A, B, Q, R, N, P = (balls(item) for item in (*equation[:5], X))
        At, PB = A.transpose(), P * B
        terms = [At * (P * A), -1 * P, Q] if equation.discrete else [At * P, P * A, Q]
        cross, W = (At * PB + N, R + B.transpose() * PB) if equation.discrete else (PB + N, R)
        F = -1 * W.mid().solve(cross.transpose().mid(), algorithm="approx")
        terms.append(cross * F)
        size = max(float(np.linalg.norm(_doubles(term))) for term in terms)
        residual = _doubles(terms[0] + terms[1] + terms[2] + terms[3])
        return _doubles(F), _doubles(W), 0.5 * (residual + residual.T), size


def _doubles(matrix: Balls) -> FloatArray:
    return np.array([float(x) for x in matrix.entries()]).reshape(matrix.nrows(), matrix.ncols())


def _off_boundary(equation: Equation, X: FloatArray, F: FloatArray, W: FloatArray) -> bool:
    """Return whether the solution belongs to a pencil without eigenvalues on the stability boundary.

    With the loop's eigenvalue λ of decay d, and its right and left eigenvectors v and w, a residual E leaves the
    eigenvalues λ and −λ* of the Hamiltonian matrix apart as long as d² > |w'Sw| |v'Ev|, S = B R⁻¹ B'.
    """
    from scipy.linalg import eig

    closed = equation.A + equation.B @ F
    if not (np.all(np.isfinite(closed)) and np.all(np.isfinite(W))):
        return False
    poles, left, right = eig(closed, left=True, right=True)
    decay = 1.0 - np.abs(poles) if equation.discrete else -poles.real
    eps, n = float(np.finfo(np.float64).eps), len(closed)
    _, _, residual, size = _evaluated(equation, X)
    with np.errstate(all="ignore"):
        left = left / np.abs(np.einsum("ij,ij->j", left.conj(), right))
        input_gain = np.einsum(
            "ij,jk,ki->i", left.conj().T, equation.B @ np.linalg.lstsq(W, equation.B.T)[0], left
        ).real
        rounding = eps * np.linalg.norm(closed) * np.linalg.norm(left, axis=0)
        error = float(np.linalg.norm(residual)) + math.sqrt(n) * eps * size
        apart = decay > DECAY_OVER_ROUNDING * rounding
        apart &= decay * decay > DECAY_OVER_ROUNDING * np.abs(input_gain) * error
    scale = 1.0 if equation.discrete else float(np.linalg.norm(closed, 2))
    # Multiple poles in one point (the states of a delay) have too few eigenvectors.
    if np.all(apart | (decay > SAFE_DECAY * scale)):
        return True
    if n <= EIGENVALUE_STATES and MANY_BITS:
        return not _on_boundary(_eigenvalues_in_many_bits(equation)[0])
    return bool(np.all(decay > SAFE_DECAY_WITHOUT_TEST * scale))


def _on_boundary(eigenvalues: ComplexArray) -> bool:
    """Return whether one of the eigenvalues, computed with many digits, lies on the imaginary axis."""
    size = np.abs(eigenvalues)
    near = np.abs(eigenvalues.real) <= BOUNDARY_DECAY * size
    return bool(np.any(near | (size <= ZERO_EIGENVALUE * size.max(initial=0.0))))


def _eigenvalues_in_many_bits(equation: Equation) -> tuple[ComplexArray, FloatArray | None]:
    """Return the eigenvalues of the Hamiltonian (symplectic) pencil, mapped to the half plane, and X if n are stable.

    A singular pencil gives the eigenvalue 0.
    """
    import flint

    n = len(equation.A)
    with flint.ctx.workprec(EIGENVALUE_BITS):
        A, B, Q, R, N = (balls(item) for item in equation[:5])
        try:
            if equation.discrete:
                H = _in_half_plane(A, B, Q, R, N)
            else:
                into, across = R.solve(B.transpose()), R.solve(N.transpose())
                left = A - B * across
                H = blocks([[left, -1 * (B * into)], [N * across - Q, -1 * left.transpose()]])
            values, vectors = flint.acb_mat(H.mid()).eig(right=True, algorithm="approx")
            eigenvalues = np.array([complex(float(one.real), float(one.imag)) for one in values])
            stable = [k for k, one in enumerate(eigenvalues) if one.real < 0.0]
            if len(stable) != n:
                return eigenvalues, None
            top, bottom = (
                flint.acb_mat([[vectors[i, k] for i in range(first, first + n)] for k in stable]) for first in (0, n)
            )
            X = top.solve(bottom, algorithm="approx")
        except ZeroDivisionError:
            # R is singular, or the pencil is at z = −1, or there is no X.
            return np.zeros(1, dtype=np.complex128), None
        found = np.array([float(x.real) for x in X.entries()]).reshape(n, n)
    return eigenvalues, 0.5 * (found + found.T) if np.all(np.isfinite(found)) else None


def _in_half_plane(A: Balls, B: Balls, Q: Balls, R: Balls, N: Balls) -> Balls:
    """Return a matrix with the eigenvalues w = (z − 1)/(z + 1) of the extended symplectic pencil, by Cayley's map."""
    n, m = A.nrows(), B.ncols()
    one, zero, empty = identity(n), balls(np.zeros((n, n))), balls(np.zeros((n, m)))
    M = blocks([[A, zero, B], [-1 * Q, one, -1 * N], [N.transpose(), empty.transpose(), R]])
    none = balls(np.zeros((m, m)))
    L = blocks([[one, zero, empty], [zero, A.transpose(), empty], [empty.transpose(), -1 * B.transpose(), none]])
    return (M + L).solve(M - L)


def hamiltonian(equation: Equation) -> FloatArray:
    """Return the Hamiltonian matrix of a continuous equation."""
    A, B, Q, R, N, _ = equation
    into = np.linalg.solve(R, np.hstack([B.T, N.T]))
    left = A - B @ into[:, len(A) :]
    return np.block([[left, -B @ into[:, : len(A)]], [N @ into[:, len(A) :] - Q, -left.T]])


def relative_residual(equation: Equation, X: FloatArray) -> float:
    """Return the residual of the equation at X relative to the largest of its terms."""
    _, _, residual, size = _evaluated(equation, X)
    return float(np.linalg.norm(residual)) / size if size else 0.0
