"""Linear matrix inequalities of a loop with output feedback, and the controller that belongs to their solution.

The plant, with D22 = 0, and a controller of its order,

    dx/dt = A x + B1 w + B2 u,    z = C1 x + D11 w + D12 u,    y = C2 x + D21 w,
    dx_K/dt = A_K x_K + B_K y,    u = C_K x_K + D_K y,

close a loop with the matrices 𝒜, ℬ, 𝒞, 𝒟 and the Lyapunov matrix 𝒫. With the first blocks Y of 𝒫 and X of its inverse,
I − Y X = N M', Π = [X, I; M', 0] and the transformed controller

    (1)  B̂ = N B_K + Y B2 D̂,   Ĉ = C_K M' + D̂ C2 X,   D̂ = D_K,
         Â = N A_K M' + N B_K C2 X + Y B2 C_K M' + Y (A + B2 D̂ C2) X

the loop is linear in X, Y, Â, B̂, Ĉ, D̂:

    (2)  𝒱 = Π'𝒫Π     = [X, I; I, Y]
    (3)  𝒱_A = Π'𝒫𝒜Π = [A X + B2 Ĉ, A + B2 D̂ C2; Â, Y A + B̂ C2]
    (4)  𝒱_B = Π'𝒫ℬ   = [B1 + B2 D̂ D21; Y B1 + B̂ D21]
    (5)  𝒞Π = [C1 X + D12 Ĉ, C1 + D12 D̂ C2],   𝒟 = D11 + D12 D̂ D21

and so are what is required of it:

    (6)  ‖w → z‖∞ < √(αβ):        [𝒱_A + 𝒱_A', 𝒱_B, (𝒞Π)'; 𝒱_B', −α I, 𝒟'; 𝒞Π, 𝒟, −β I] < 0
    (7)  ‖w → z_j‖₂ < √(α Q_jj):  [𝒱_A + 𝒱_A', 𝒱_B; 𝒱_B', −α I] < 0,   [𝒱, (𝒞Π)'; 𝒞Π, Q] > 0,   𝒟 = 0
    (8)  poles where L + s M + s̄ M' < 0:   [L_ij 𝒱 + M_ij 𝒱_A + M_ji 𝒱_A']_ij < 0
    (9)  N, M well conditioned:    [X, t I; t I, Y] ≥ 0 with a large t > 1

The first inequality of (7) is a part of (6) where w is among the inputs of (6) at the same α.

The full-order H-infinity controller, for plants that the Riccati equations do not take (any D12, D21, zeros on the
axis), has the least γ of (6) with α = β = γ; at (1 + backoff) times it X and Y are those farthest from X Y = I (9), as
there a controller has arbitrarily fast poles.

References
----------
C. Scherer, P. Gahinet, M. Chilali, IEEE Trans. Automatic Control 42, 1997: (1) is their (35), (3) to (7) their section
IV. M. Chilali, P. Gahinet, IEEE Trans. Automatic Control 41, 1996: (8). P. Gahinet, Automatica 32, 1996: (9).
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Partition, ScaledPlant, autoscale, autoscaled_with_gain, closed_loop, unscale
from platform_ctrl.errors import DesignError, InfeasibleError, TimeLimitError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

cp: Any = import_module("cvxpy")  # its annotations are incomplete

# How far the inequalities of a common Lyapunov matrix are moved to hold, and how often over all plants.
_STRICT, _ROUNDS = 0.01, 50

# The solver's own tolerances of its linear equations.
_REFINEMENT = {"reltol": 1e-13, "abstol": 1e-12}

WHERE = "hinf, lmi"
CURE = 'give a larger backoff, other weights, or method="riccati"'
# The first solution is found again in other units until gamma is within 1/8 .. 8.
GAMMA_RANGE, MOST_ROUNDS = 8.0, 6
# Tolerances of the first solution, which finds the states, and of the others.
ROUGH, FINE = 1e-4, 1e-7
# Largest separation; X and Y may grow to this mean, and by this factor, for it.
SEPARATION, LARGEST_MEAN, ROOM = 10.0, 100.0, 10.0
# Distance of the inequalities from zero in the last step, relative to gamma and the back-off, tried in turn.
STRICTNESS = (5e-3, 5e-4, 5e-5)


class LinearLoop:
    """A loop that is linear in the unknowns X, Y, Â, B̂, Ĉ and, unless it is zero, D̂: (2) to (5)."""

    def __init__(self, p: Partition, direct: bool) -> None:
        n, nu, ny = len(p.A), p.B2.shape[1], len(p.C2)
        self.X, self.Y = (cp.Variable((n, n), symmetric=True) for _ in range(2))
        self.A, self.B, self.C = cp.Variable((n, n)), cp.Variable((n, ny)), cp.Variable((nu, n))
        self.D = cp.Variable((nu, ny)) if direct else np.zeros((nu, ny))
        self.plant, one = p, np.eye(n)
        self.V = cp.bmat([[self.X, one], [one, self.Y]])
        self.VA = cp.bmat(
            [[p.A @ self.X + p.B2 @ self.C, p.A + p.B2 @ self.D @ p.C2], [self.A, self.Y @ p.A + self.B @ p.C2]]
        )
        self.VB = cp.vstack([p.B1 + p.B2 @ self.D @ p.D21, self.Y @ p.B1 + self.B @ p.D21])
        self.out = cp.hstack([p.C1 @ self.X + p.D12 @ self.C, p.C1 + p.D12 @ self.D @ p.C2])
        self.direct = p.D11 + p.D12 @ self.D @ p.D21

    def hinf_below(self, w: Sequence[int], z: Sequence[int], alpha: Any, beta: Any, margin: float = 0.0) -> Any:
        """Inequality (6) for some of the signals w and z, at most −`margin`."""
        w, z = list(w), list(z)
        B, C, D = self.VB[:, w], self.out[z, :], self.direct[z, :][:, w]
        return _negative(
            [[self.VA + self.VA.T, B, C.T], [B.T, -alpha * np.eye(len(w)), D.T], [C, D, -beta * np.eye(len(z))]], margin
        )

    def outputs_below(self, z: Sequence[int], square: Any) -> list[Any]:
        """Second inequality of (7): every Q_jj is at most `square`."""
        Q = cp.Variable((len(z), len(z)), symmetric=True)
        C = self.out[list(z), :]
        return [cp.bmat([[self.V, C.T], [C, Q]]) >> 0, cp.diag(Q) <= square]

    def poles_in(self, L: FloatArray, M: FloatArray) -> Any:
        """Inequality (8)."""
        k = range(len(L))
        return _negative([[L[i, j] * self.V + M[i, j] * self.VA + M[j, i] * self.VA.T for j in k] for i in k])

    def separated(self, t: Any) -> Any:
        """Inequality (9)."""
        one = t * np.eye(self.X.shape[0])
        return cp.bmat([[self.X, one], [one, self.Y]]) >> 0

    def size(self) -> Any:
        """Return the mean of the eigenvalues of X and Y."""
        return (cp.trace(self.X) + cp.trace(self.Y)) / (2 * self.X.shape[0])

    def controller(self) -> System:
        """Return the controller of the values that the unknowns have: (1) solved for it."""
        p, X, Y, A, B, C, D = (
            self.plant,
            *(getattr(x, "value", x) for x in (self.X, self.Y, self.A, self.B, self.C, self.D)),
        )
        U, sigma, Vt = np.linalg.svd(np.eye(len(X)) - Y @ X)
        N, M = U * np.sqrt(sigma), Vt.T * np.sqrt(sigma)
        B_K = np.linalg.solve(N, B - Y @ p.B2 @ D)
        C_K = np.linalg.solve(M, (C - D @ p.C2 @ X).T).T
        rest = A - N @ B_K @ p.C2 @ X - Y @ p.B2 @ C_K @ M.T - Y @ (p.A + p.B2 @ D @ p.C2) @ X
        return System(np.linalg.solve(M, np.linalg.solve(N, rest).T).T, B_K, C_K, np.asarray(D))


def _negative(blocks: list[list[Any]], margin: float = 0.0) -> Any:
    matrix = cp.bmat(blocks)
    return matrix << (-margin * np.eye(matrix.shape[0]) if margin else 0)


def sector(damping: float) -> tuple[FloatArray, FloatArray]:
    """Return L and M of (8) for poles with at least this damping ratio."""
    sine = np.sqrt(1.0 - damping**2)
    return np.zeros((2, 2)), np.array([[sine, damping], [-damping, sine]])


def balancing(X: FloatArray, Y: FloatArray) -> FloatArray:
    """Return states T, x = T x', in which X and Y are equal and diagonal: there the solver is most accurate."""
    values, vectors = np.linalg.eigh(X)
    root = vectors * np.sqrt(np.maximum(values, 1e-10 * values[-1]))
    products, turn = np.linalg.eigh(root.T @ Y @ root)
    return np.asarray(root @ turn / np.maximum(products, 1e-8 * products[-1]) ** 0.25)


def in_states(p: Partition, T: FloatArray) -> Partition:
    """Return the plant in the states x', x = T x'."""
    back = np.linalg.inv(T)
    return dataclasses.replace(p, A=back @ p.A @ T, B1=back @ p.B1, B2=back @ p.B2, C1=p.C1 @ T, C2=p.C2 @ T)


def solve(problem: Any, where: str, cure: str, time_limit: float, tolerance: float, P: Any = None) -> None:
    """Solve a convex problem with Clarabel; a typed error where it has no finite solution.

    A solution that the solver calls inaccurate is accepted: callers evaluate every result again.
    """
    settings = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)
    # The solver's linear equations need not be solved better than to what is left of a coarse tolerance.
    settings |= {f"iterative_refinement_{kind}": max(least, tolerance**2) for kind, least in _REFINEMENT.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem.solve(
                solver=cp.CLARABEL, time_limit=time_limit, max_threads=1, chordal_decomposition_enable=False, **settings
            )
        except (cp.SolverError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            raise UnscalableError(f"{where}: the solver gave up; {cure}", P) from None
    if problem.status == "user_limit":
        raise TimeLimitError(f"{where}: the solver did not finish in {time_limit:.3g} s; give a larger time_limit", P)
    if problem.status in ("infeasible", "infeasible_inaccurate"):
        raise InfeasibleError(f"{where}: the inequalities are infeasible; {cure}", P)
    if problem.status not in ("optimal", "optimal_inaccurate"):
        raise UnscalableError(f"{where}: the solver ended with {problem.status!r}; {cure}", P)


def hinf_lmi(plant: Partition, backoff: float, time_limit: float, P: StateSpace) -> tuple[System, float]:
    """Return the controller in the units of `plant` and the least gamma."""

    def minimised(p: Partition, tolerance: float) -> tuple[LinearLoop, float]:
        loop, gamma = LinearLoop(p, direct=True), cp.Variable()
        problem = cp.Problem(cp.Minimize(gamma), [loop.V >> 0, _bounded(loop, gamma)])
        solve(problem, f"{WHERE}: minimising gamma", CURE, time_limit, tolerance, P)
        return loop, float(gamma.value)

    scaled, loop = _near_one(plant, minimised)
    failure: DesignError | None = None
    T = np.eye(len(plant.A))
    for strictness in STRICTNESS:
        try:
            T = T @ balancing(loop.X.value, loop.Y.value)
            p = in_states(scaled.plant, T)
            loop, least = minimised(p, FINE)
            last, t = LinearLoop(p, direct=True), cp.Variable()
            level = (1.0 + backoff) * least
            margin = strictness * min(backoff, 0.02) * level
            # In balanced states X = Y.
            room = max(LARGEST_MEAN, ROOM * float(np.sqrt(np.trace(loop.X.value @ loop.Y.value) / len(T))))
            inequalities = [_bounded(last, level, margin), last.separated(t), t <= SEPARATION, last.size() <= room]
            step = f"{WHERE}: separating X and Y at gamma = {level * scaled.gain:.6g}"
            solve(cp.Problem(cp.Maximize(t), inequalities), step, CURE, time_limit, FINE, P)
            made = last.controller()
            if not np.linalg.eigvals(closed_loop(p, made).A).real.max() < 0.0:
                raise UnscalableError(f"{WHERE}: the controller of the solver's X and Y is not stable; {CURE}", P)
            return unscale(made, scaled), least * scaled.gain
        except TimeLimitError:
            raise
        except (DesignError, np.linalg.LinAlgError) as error:
            own = error if isinstance(error, DesignError) else UnscalableError(f"{WHERE}: {error}; {CURE}", P)
            failure = failure or own
    assert failure is not None
    raise failure


def _bounded(loop: LinearLoop, gamma: Any, margin: float = 0.0) -> Any:
    nz, nw = loop.plant.D11.shape
    return loop.hinf_below(range(nw), range(nz), gamma, gamma, margin)


def _near_one(plant: Partition, minimised: Any) -> tuple[ScaledPlant, LinearLoop]:
    """Return the plant in units in which the least gamma is near one, and a first solution."""
    gain = autoscaled_with_gain(plant).gain
    for _ in range(MOST_ROUNDS):
        scaled = autoscale(plant, gain)
        loop, gamma = minimised(scaled.plant, ROUGH)
        if 1 / GAMMA_RANGE <= gamma <= GAMMA_RANGE:
            break
        # Far from one, gamma is inaccurate: a limited step.
        gain *= float(np.clip(gamma, 1e-3, 1e6))
    return scaled, loop


def sharing(loops: FloatArray) -> int:
    """Return for how many of the closed loops (N, n, n), the first one stable, one Lyapunov matrix P was found.

    P > 0 and A' P A < P for each of them: these loops stay stable however fast the plant changes from one to another.
    P is moved by the gradient of the eigenvalues that are not negative enough, of one plant after the other
    (D. Liberzon, R. Tempo, IEEE Trans. Automatic Control 49, 2004); it ends where there is a P for all of them.
    """
    from scipy.linalg import solve_discrete_lyapunov

    one = np.eye(loops.shape[-1])
    # States in which white noise on each state of the first loop makes variances of one, then its P is one.
    scale = np.sqrt(np.diag(solve_discrete_lyapunov(loops[0], one)))
    values, vectors = np.linalg.eigh(solve_discrete_lyapunov((loops[0] / scale[:, None] * scale).T, one))
    T = scale[:, None] * vectors / np.sqrt(values)
    A, P, most = np.linalg.solve(T, loops @ T), one, 0
    for _ in range(_ROUNDS):
        held = np.linalg.eigvalsh(P - np.swapaxes(A, 1, 2) @ P @ A)[:, 0] > 0.0
        # Where the inequality of a stable loop holds, P > 0.
        most = max(most, int(np.sum(held)) if held[0] else 0)
        if most == len(A):
            break
        for own in A:
            decrease, v = np.linalg.eigh(P - own.T @ P @ own)
            if decrease[0] > 0.0:
                continue
            missing = np.maximum(_STRICT - decrease, 0.0)
            gradient = (v * missing) @ v.T
            gradient = gradient - own @ gradient @ own.T
            P = P + np.sum(missing**2) / np.sum(gradient**2) * gradient
    return most
