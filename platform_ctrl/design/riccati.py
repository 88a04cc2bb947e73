"""H-infinity and H2 synthesis by two algebraic Riccati equations each, and the stabilising solutions of these.

Equations, continuous and discrete, are in units in which their matrices are near one. Continuous ones are solved by the
ordered real Schur form of the Hamiltonian matrix (Laub, IEEE Transactions on Automatic Control 24, 1979): it is six
times as fast as SciPy's pencil, which counts in the H-infinity bisection, and better next to the imaginary axis. SciPy
solves discrete equations, and continuous ones for which the Schur form fails. One step of Newton's method (Kleinman,
ibid. 13, 1968; Hewer, ibid. 16, 1971) corrects a solution; the residual, relative to the terms of the equation, must be
small.

H-infinity (Glover and Doyle 1988) on a scaled plant: the central controller for a general D11, in the normal form
D12 = [0; I], D21 = [0, I], which the scaling and a rotation of z and w give exactly; formulae as in Zhou, Doyle and
Glover, Robust and Optimal Control (1996), theorem 17.1.

H2: state feedback on the optimal estimate (ibid., section 14.5), with a direct path D11 that a static gain can cancel;
of sampled plants with the estimate of the present state and disturbance, so that u[k] uses y[k].
"""

from __future__ import annotations

import dataclasses
import functools
import math
import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Partition, autoscaled_with_gain, require_assumptions, split, unscale, whole
from platform_ctrl.design.sections import gain as static
from platform_ctrl.errors import IllPosedError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

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
    solve, boundary = (solve_discrete_are, "unit circle") if discrete else (solve_continuous_are, "imaginary axis")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return refined(equation, solve(A, B, Q, R, s=N), where)
    except (np.linalg.LinAlgError, ValueError):
        raise UnscalableError(
            f"{where} has no stabilising solution: u or y hardly reaches a mode on the {boundary}, or a zero is near "
            "it; add small weights on the controls to z and small noises on the measurements to w"
        ) from None


def refined(equation: Equation, X: FloatArray, where: str) -> Solution:
    """Return a solution after one step of Newton's method; an UnscalableError where its residual stays large."""
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    found = _evaluated(equation, X)
    solve, sign = (solve_discrete_lyapunov, 1.0) if equation.discrete else (solve_continuous_lyapunov, -1.0)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        step = solve((equation.A + equation.B @ found.F).T, sign * found.residual)
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
    """Return the stabilising X of a continuous equation with a regular R of any sign, fast, or None.

    It does not exist where eigenvalues of the Hamiltonian matrix lie on the imaginary axis.
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
    # Fast states first: the QR algorithm then keeps the digits of the slow ones.
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


WHERE, H2 = "hinf, riccati", "h2, riccati"
# A direct path below this share of D11 counts as zero.
NO_DIRECT_PATH = 1e-10
# The least gamma is found to this relative accuracy.
ACCURACY = 1e-9
# Least and largest gamma of the scaled plant in the search, and how far apart the logarithms of its first steps are.
LEAST_GAMMA, LARGEST_GAMMA, FIRST_STEP = 1e-6, 1e8, 0.7
# gamma² over the spectral radius of X Y counts as this where it is larger.
LARGEST_RATIO = 10.0
# Negative eigenvalues of X and Y below this share of the largest are rounding.
NEGATIVE_ROUNDING = 1e-7
# Largest condition of the loop around D22.
LARGEST_LOOP_CONDITION = 1e8

# A plant, whose equation is that of X, and its dual, whose equation is that of Y.
Sides = tuple[Partition, Partition]


def hinf_riccati(plant: Partition, backoff: float, P: StateSpace) -> tuple[System, float]:
    """Return the controller in the units of a continuous `plant` and the least gamma."""
    scaled = autoscaled_with_gain(plant)
    require_assumptions(scaled, P, WHERE)
    normal = _normal_form(scaled.plant)
    sides = normal, normal.dual
    least = _least_gamma(sides, P)
    gamma = (1 + backoff) * least
    found = _trial(sides, gamma)
    if found is None or not 0.0 <= found.radius < gamma**2:
        words = f"no solution at {1 + backoff:.6g} times the least gamma {least * scaled.gain:.6g}"
        raise UnscalableError(f'{WHERE}: {words}; give a larger backoff, or method="lmi"', P)
    X, Y = (
        refined(equation, V, f"{WHERE}: the Riccati equation of {name}")
        for name, equation, V in zip("XY", _equations(sides, gamma), (found.X, found.Y), strict=True)
    )
    made = _central(normal, gamma, X.X, Y.X)
    # The loop around D22, which was left out so far, has to stay well posed.
    around = np.linalg.cond(np.eye(len(made.D)) + scaled.control @ made.D @ scaled.measurement @ scaled.D22)
    if around < LARGEST_LOOP_CONDITION:
        return unscale(made, scaled), least * scaled.gain
    words = f"the loop of u and y is not well posed with the controller at gamma = {gamma * scaled.gain:.6g}"
    raise UnscalableError(f'{WHERE}: {words}; give a larger backoff, or method="lmi"', P)


def _normal_form(plant: Partition) -> Partition:
    """Rotate z and w so that D12 = [0; I] and D21 = [0, I], which keeps the norm."""
    nu, ny = plant.D12.shape[1], plant.D21.shape[0]
    U = np.hstack([np.linalg.svd(plant.D12)[0][:, nu:], plant.D12])
    V = np.hstack([np.linalg.svd(plant.D21.T)[0][:, ny:], plant.D21.T])
    return dataclasses.replace(
        plant, B1=plant.B1 @ V, C1=U.T @ plant.C1, D11=U.T @ plant.D11 @ V, D12=U.T @ plant.D12, D21=plant.D21 @ V
    )


def _equations(sides: Sides, gamma: float) -> list[Equation]:
    """Return the equations of X and Y at a gamma, which may be infinite: then those of the H2 problem.

    w is counted in units of gamma. D12 is eliminated exactly, v = u + D12'(C1 x + D11 w) in place of u: then a fast
    pole of a weight on u, which that moves to a zero of the weight, is in no other entry.
    """
    out = []
    for one in sides:
        z, nw, nu = len(one.C1) - one.D12.shape[1], one.B1.shape[1], one.B2.shape[1]
        B1, D = (one.B1 - one.B2 @ one.D11[z:]) / gamma, one.D11[:z] / gamma
        C, R = one.C1[:z], np.eye(nw + nu)
        R[:nw, :nw] = D.T @ D - np.eye(nw)
        N = np.hstack([C.T @ D, np.zeros((len(C.T), nu))])
        out.append(Equation(one.A - one.B2 @ one.C1[z:], np.hstack([B1, one.B2]), C.T @ C, R, N, discrete=False))
    return out


class Trial(NamedTuple):
    """The stabilising X and Y at a gamma, and the spectral radius of X Y: the gamma is reached where it is less.

    Beyond the gamma at which X or Y becomes infinite it is indefinite, and `radius` a negative eigenvalue of X Y.
    """

    X: FloatArray
    Y: FloatArray
    radius: float


def _trial(sides: Sides, gamma: float) -> Trial | None:
    """Return X and Y at a gamma; None where they do not exist."""
    try:
        X, Y = (stabilising(equation) for equation in _equations(sides, gamma))
    except np.linalg.LinAlgError:
        return None
    if X is None or Y is None:
        return None
    products = np.linalg.eigvals(X @ Y).real
    if all(v[0] >= -NEGATIVE_ROUNDING * abs(v[-1]) - SOLUTION_ROUNDING for v in map(np.linalg.eigvalsh, (X, Y))):
        return Trial(X, Y, max(float(products.max()), 0.0))
    return Trial(X, Y, float(products.min())) if products.min() < 0.0 else None


def _floor(p: Partition) -> float:
    """Return the largest singular value of the rows and columns of D11 that no controller reaches, a lower bound."""
    z, w = p.D11.shape[0] - p.D12.shape[1], p.D11.shape[1] - p.D21.shape[0]
    return float(max(np.linalg.norm(p.D11[:z], 2) if z else 0.0, np.linalg.norm(p.D11[:, :w], 2) if w else 0.0))


def _least_gamma(sides: Sides, P: StateSpace) -> float:
    """Search the least gamma: Brent's method for the logarithm at which gamma² is the spectral radius of X Y.

    Where X or Y ceases to exist before, that is where the function jumps, and the method bisects.
    """
    from scipy.optimize import brentq

    start = _trial(sides, math.inf)
    if start is None or start.radius < 0.0:
        raise UnscalableError(
            f"{WHERE}: no gamma is large enough for both Riccati equations, which need unstable modes that u moves and "
            'y sees well, and no zeros near the imaginary axis; give method="lmi"',
            P,
        )

    # The radius grows as gamma falls, from that of the H2 problem: nothing is reached at the first gamma.
    first = math.log(max(_floor(sides[0]), math.sqrt(start.radius), LEAST_GAMMA))

    @functools.cache
    def slack(log_gamma: float) -> float:
        gamma = math.exp(log_gamma)
        found = _trial(sides, gamma) if log_gamma > first else None
        # Where X or Y becomes infinite the ratio falls through zero.
        ratio = -1.0 if found is None else gamma**2 / found.radius if found.radius else math.inf
        return min(max(ratio, -1.0), LARGEST_RATIO) - 1.0

    low, high = first, first + FIRST_STEP
    while slack(high) <= 0.0:
        if high > math.log(LARGEST_GAMMA):
            raise UnscalableError(
                f"{WHERE}: no gamma up to {LARGEST_GAMMA:.0e} in scaled units is reached: an unstable mode is hardly "
                'moved by u or hardly seen by y; give method="lmi"',
                P,
            )
        low, high = high, high + FIRST_STEP
    return math.exp(brentq(slack, low, high, xtol=ACCURACY, rtol=ACCURACY))


def _central(p: Partition, gamma: float, X: FloatArray, Y: FloatArray) -> System:
    """Return the controller of theorem 17.1, its free parameter zero."""
    nw, nz, nu, ny = p.B1.shape[1], p.C1.shape[0], p.B2.shape[1], p.C2.shape[0]
    w, z = nw - ny, nz - nu
    B, C = np.hstack([p.B1, p.B2]), np.vstack([p.C1, p.C2])
    Drow, Dcol = np.hstack([p.D11, p.D12]), np.vstack([p.D11, p.D21])
    R = Drow.T @ Drow
    R[np.diag_indices(nw)] -= gamma**2
    Rt = Dcol @ Dcol.T
    Rt[np.diag_indices(nz)] -= gamma**2
    F = -np.linalg.solve(R, Drow.T @ p.C1 + B.T @ X)
    L = -np.linalg.solve(Rt, Dcol @ p.B1.T + C @ Y).T
    F12, F2 = F[w:nw], F[nw:]
    L12, L2 = L[:, z:nz], L[:, nz:]
    a, b, c, d = p.D11[:z, :w], p.D11[:z, w:], p.D11[z:, :w], p.D11[z:, w:]
    square = gamma**2 * np.eye(z) - a @ a.T
    D11 = -c @ a.T @ np.linalg.solve(square, b) - d
    E12 = np.eye(nu) - c @ np.linalg.solve(gamma**2 * np.eye(w) - a.T @ a, c.T)  # D̂12 D̂12'
    E21 = np.eye(ny) - b.T @ np.linalg.solve(square, b)  # D̂21' D̂21
    D12, D21 = np.linalg.cholesky(E12), np.linalg.cholesky(E21).T
    Z = np.linalg.inv(np.eye(len(X)) - Y @ X / gamma**2)
    B2 = Z @ (p.B2 + L12) @ D12
    C2 = -D21 @ (p.C2 + F12)
    B1 = -Z @ L2 + B2 @ np.linalg.solve(D12, D11)
    C1 = F2 + D11 @ np.linalg.solve(D21, C2)
    return System(A=p.A + B @ F + B1 @ np.linalg.solve(D21, C2), B=B1, C=C1, D=D11)


def h2_riccati(plant: Partition, direct: bool, P: StateSpace) -> tuple[System, float]:
    """Return the controller in the units of `plant` and the least norm.

    Of a sampled plant present state and disturbance are estimated as x̂ + Y C2' S⁻¹ e and D21' S⁻¹ e, with S the
    covariance of the innovation e = y − C2 x̂; u is the state feedback F and the disturbance feedback F0 of these.
    """
    scaled = autoscaled_with_gain(plant)
    p, gain = scaled.plant, np.zeros_like(plant.D22.T)
    if not plant.dt:
        require_assumptions(scaled, P, H2)
        p, gain = _without_direct_path(p, P)
    try:
        for_X, for_Y = [
            riccati_solution(
                Equation(one.A, one.B2, one.C1.T @ one.C1, one.D12.T @ one.D12, one.C1.T @ one.D12, discrete=p.dt > 0),
                f"{H2}: the Riccati equation of {name}",
            )
            for name, one in zip("XY", (p, p.dual), strict=True)
        ]
    except UnscalableError:
        # Sampled plants need less, but this is what to look at.
        require_assumptions(scaled, P, H2)
        raise
    (X, F, W, *_), (Y, Lt, S, *_) = for_X, for_Y
    L = -Lt.T  # the predictor's gain
    square = float(np.trace(p.D11.T @ p.D11 + p.B1.T @ X @ p.B1) + np.trace(W @ F @ Y @ F.T))
    present = np.zeros_like(gain)
    if plant.dt and direct:
        F0 = -np.linalg.solve(W, p.B2.T @ X @ p.B1 + p.D12.T @ p.D11)
        present = np.asarray(np.linalg.solve(S, (F @ Y @ p.C2.T + F0 @ p.D21.T).T).T)
        square -= float(np.trace(W @ present @ S @ present.T))
    # u = F x̂ + present (y − C2 x̂). The gain that cancels D11 is outside the estimator, which counts it as plant.
    into = p.B2 @ present + L
    made = System(p.A + p.B2 @ F - into @ p.C2, into, F - present @ p.C2, present + gain)
    # The norm of a slower system: time is counted in units of 1/rate.
    least = scaled.gain * float(np.sqrt(max(square, 0.0) * scaled.rate))
    return unscale(made, scaled), least


def _without_direct_path(plant: Partition, P: StateSpace) -> tuple[Partition, FloatArray]:
    """Return the plant with the gain D_K closed that cancels D11, and D_K; D12 and D21 are orthonormal."""
    gain = -plant.D12.T @ plant.D11 @ plant.D21.T
    nz, nw = plant.D11.shape
    (ny, nu), one = plant.D22.shape, whole(plant)
    closed = one.feedback(static(gain), range(nw, nw + nu), range(nz, nz + ny)).part(slice(nu, None), slice(nw + nu))
    rest = closed.D[:nz, :nw]
    if np.linalg.norm(rest) > NO_DIRECT_PATH * np.linalg.norm(plant.D11):
        z, w = np.unravel_index(int(np.argmax(np.abs(rest))), rest.shape)
        raise IllPosedError(
            f"{H2}: the H2 norm is infinite: no gain from y to u cancels the direct path D11 from "
            f"{P.input_labels[int(w)]} to {P.output_labels[int(z)]}; put a low-pass on that w or z",
            P,
        )
    return dataclasses.replace(split(closed, nz, nw), D11=np.zeros_like(rest)), gain
