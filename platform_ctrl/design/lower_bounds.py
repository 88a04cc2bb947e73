"""Lower bounds on the norm of every closed loop around a plant: H-infinity and H2, no assumption on D12 and D21.

Adjoint signals ζ, with p' = A'p + C1'ζ and B2'p + D12'ζ = 0, are invisible to the controls: no controller changes the
gain from ζ to ω = B1'p + D11'ζ. The dual plant gives the same for measurements. Such signals lie in a subspace, p = S ξ
(the reachable and the antistable part of the largest output-nulling one), where they are those of a regular system

    ξ' = A ξ + B η,   ζ = C ξ + D η,   ω = H ξ + E η

whether D12 has full rank or not (Stoorvogel 1992). Any feedback η = K ξ that makes −A − B K stable gives a feasible
point of the dual of the synthesis inequalities, and with it a bound that holds by an identity, not by the convergence
of a solver; the optimal K, from a Riccati equation, makes it tight, and an error in K counts quadratically.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Partition, delayed, with_white_noise
from platform_ctrl.design.riccati.equations import Equation, by_pencil, hamiltonian, stabilising
from platform_ctrl.design.scaling import NO_DIRECT_PATH, ScaledPlant, autoscaled_with_gain, clustered
from platform_ctrl.errors import ArgumentError, UnscalableError

# Share of the bound that is subtracted for rounding of its evaluation.
ROUNDING = 5e-11
# Singular values below this share of the largest count as zero in the search of the subspace; and its least angle.
RANK_TOLERANCE, LEAST_ANGLE = 1e-13, 1e-8
# Couplings below this share of the plant count as zero.
LEAST_COUPLING = 1e-12
# Largest error of the subspace, and largest distance from the axis at which an eigenvalue that no input moves is not
# antistable, relative to the scaled plant.
LARGEST_LEAK, AXIS_DISTANCE = 1e-11, 1e-8
# Ratios of sizes below this are rounding, not units.
LEAST_SIZE_RATIO = 1e-8
# Eigenvalues farther from the axis than this share of the Hamiltonian matrix: the solution exists and is ill-scaled.
SOLUTION_DISTANCE = 1e-9
# Added to the right-hand side of a Lyapunov equation in states of unit cost, until the inequality holds with rounding.
SLACKS = 10.0 ** np.arange(-14.0, -6.0)
# The search for the least level ends at this relative width of gamma^-2, or after so many steps.
SEARCH_WIDTH, SEARCH_STEPS = 1e-10, 80
# Relative distance to the level of a synthesis below which a bound needs no search.
NEAR_LEVEL = 1e-8
# Levels of a scaled plant below this count as zero.
LEAST_LEVEL = 1e-9


class Side(NamedTuple):
    """The adjoint signals that no control (or, transposed, no measurement) sees, as above."""

    S: FloatArray
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    H: FloatArray
    E: FloatArray
    fixed: float  # Gain at single frequencies: those of eigenvalues on the axis that η does not move, and infinity.


class Level(NamedTuple):
    """The solution of a side at t = gamma⁻²: the least ∫ |ζ|² − t |ω|² that leads to ξ is ξ'X ξ, by the feedback K."""

    X: FloatArray
    K: FloatArray


def hinf_lower_bound(plant: Partition, near: float = math.nan, scaled: ScaledPlant | None = None) -> float:
    """Return what no stabilising controller of any order can undercut in the H-infinity norm; 0 where nothing is shown.

    The plant is continuous, or in the w-plane; `near` is a level that a synthesis has reached, which spares a search;
    `scaled` is the plant in scaled units, where it is available. P. Gahinet, P. Apkarian, Int. J. Robust and Nonlinear
    Control 4, 1994; A. A. Stoorvogel, The H-infinity Control Problem: a State Space Approach, 1992.
    """
    return _evaluated(lambda: _hinf(plant, near, scaled or autoscaled_with_gain(plant)))


def h2_lower_bound(plant: Partition, direct: bool = True) -> float:
    """Return what no stabilising controller of any order can undercut in the H2 norm; 0 where nothing is shown.

    With P = S X⁻¹ S' and X the cost ∫ |ζ|² of *any* feedback K, every closed loop has
    ‖z‖² = tr(B1'P B1) + ‖z − Z X⁻¹S'x‖², Z = C + D K; the transposed plant bounds the second term by tr(L Q L') with
    L = C1 − Z X⁻¹S'. `direct`: whether u[k] of sampled plants may use y[k]. A. A. Stoorvogel, A. Saberi, B. M. Chen,
    Int. J. Robust and Nonlinear Control 3, 1993.
    """
    return _evaluated(lambda: _h2(with_white_noise(plant if direct else delayed(plant)) if plant.dt else plant))


def _evaluated(bound: Callable[[], float]) -> float:
    """Return the bound less rounding; 0 where it cannot be evaluated."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            found = (1.0 - ROUNDING) * bound()
        except (ArgumentError, ArithmeticError, UnscalableError, ValueError, np.linalg.LinAlgError):
            return 0.0
    return found if math.isfinite(found) else 0.0


def _hinf(plant: Partition, near: float, scaled: ScaledPlant) -> float:
    sides = _both_sides(_exact(scaled, plant))
    return 0.0 if sides is None else _least_level(sides, near / scaled.gain) * scaled.gain


def _h2(plant: Partition) -> float:
    """The bound of a continuous plant."""
    scaled = autoscaled_with_gain(plant)
    p = _exact(scaled, plant)
    closed = p.with_gain(-scaled.plant.D12.T @ p.D11 @ scaled.plant.D21.T)
    if np.linalg.norm(closed.D11) > NO_DIRECT_PATH * np.linalg.norm(p.D11):
        return 0.0  # There is no finite norm.
    p = dataclasses.replace(closed, D11=np.zeros_like(p.D11))
    sides = _both_sides(p)
    controls, measurements = (None, None) if sides is None else (_cost(sides[0]), _cost(sides[1]))
    if controls is None or measurements is None:
        return 0.0
    (V, seen), W = controls, measurements[0]
    square = np.linalg.norm(p.B1.T @ V) ** 2 + np.linalg.norm((p.C1 - seen @ V.T) @ W) ** 2
    return scaled.gain * math.sqrt(float(square) * scaled.rate)


def _cost(side: Side) -> tuple[FloatArray, FloatArray] | None:
    """V with V V' = P, and Z X^-½; None where the inequality does not hold in spite of rounding."""
    from scipy.linalg import solve_continuous_lyapunov

    level = _at(side, 0.0)[0]
    if level is None:
        return None
    A, Z = side.A + side.B @ level.K, side.C + side.D @ level.K
    if not len(A):
        return side.S, Z
    for slack in SLACKS:
        X = solve_continuous_lyapunov(A.T, Z.T @ Z + slack * np.eye(len(A)))
        drift = A.T @ X
        if not np.all(np.isfinite(X)):
            return None
        values, vectors = np.linalg.eigh(0.5 * (X + X.T))
        if values[0] > 0.0 and np.linalg.eigvalsh(drift + drift.T - Z.T @ Z)[0] >= 0.5 * slack:
            root = vectors / np.sqrt(values)
            return side.S @ root, Z @ root
    return None


def _exact(scaled: ScaledPlant, given: Partition) -> Partition:
    """The scaled plant with D12 and D21 as they are: where they nearly lose rank, scaling sets the rest to zero."""
    p, root = scaled.plant, math.sqrt(scaled.gain)
    return dataclasses.replace(p, D12=given.D12 / root @ scaled.control, D21=scaled.measurement @ given.D21 / root)


def _both_sides(p: Partition) -> tuple[Side, Side] | None:
    out = []
    for side in (_side(p), _side(p.dual)):
        # Twice: the first costs are those of badly scaled states.
        found = side and _in_states_of_unit_cost(_in_common_units(side))
        found = found and _in_states_of_unit_cost(found)
        if found is None:
            return None
        out.append(found)
    return out[0], out[1]


def _in_common_units(side: Side) -> Side:
    """Return the side with B and C of one size."""
    B, C = float(np.linalg.norm(side.B)), float(np.linalg.norm(side.C))
    unit = math.sqrt(B / C) if B > LEAST_SIZE_RATIO * C and C > LEAST_SIZE_RATIO * B else 1.0
    one = np.eye(len(side.A))
    return _in_states(side, unit * one, one / unit)


def _in_states(side: Side, T: FloatArray, back: FloatArray) -> Side:
    """Return the side in states ξ', ξ = T ξ'; `back` is the inverse."""
    return side._replace(S=side.S @ T, A=back @ (side.A @ T), B=back @ side.B, C=side.C @ T, H=side.H @ T)


def _in_states_of_unit_cost(side: Side) -> Side | None:
    """Return the side in states ξ that are reached with ∫ |ζ|² = |ξ|²; None where there is no least."""
    level = _at(side, 0.0)[0]
    if level is None:
        return None
    values, vectors = np.linalg.eigh(level.X)
    if not np.all(values > 0.0):
        return None
    root = np.sqrt(values)
    return _in_states(side, vectors / root, (vectors * root).T)


def _kernel(M: FloatArray) -> FloatArray:
    if not M.size:
        return np.eye(M.shape[1])
    _, sigma, Vt = np.linalg.svd(M)
    return np.asarray(Vt[int(np.sum(sigma > RANK_TOLERANCE * max(1.0, sigma[0]))) :].T)


def _split(V: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Return orthonormal bases of the range of V and of its complement."""
    n = len(V)
    if not V.shape[1]:
        return np.zeros((n, 0)), np.eye(n)
    U, sigma, _ = np.linalg.svd(V)
    rank = int(np.sum(sigma > tolerance))
    return U[:, :rank], U[:, rank:]


def _side(p: Partition) -> Side | None:
    """Return the reduced adjoint system; None where rounding makes it too inexact."""
    A, B1, B2, C1, D11, D12 = p.A, p.B1, p.B2, p.C1, p.D11, p.D12
    n = len(A)
    if not all(np.all(np.isfinite(M)) for M in (A, B1, B2, C1, D11, D12)):
        return None  # which LAPACK would print
    V, rest = np.eye(n), np.zeros((n, 0))
    # Shrinks until it is invariant and invisible to the controls.
    while True:
        k = V.shape[1]
        N = _kernel(np.block([[B2.T @ V, D12.T], [rest.T @ A.T @ V, rest.T @ C1.T]]))
        inside, _ = _split(N[:k], LEAST_ANGLE)
        if inside.shape[1] == k:
            break
        V, rest = _split(V @ inside, 0.5)
    back = np.linalg.pinv(N[:k])
    free = N[k:] @ _kernel_of_rows(N[:k])
    C = N[k:] @ back
    A_V, B_V = V.T @ (A.T @ V + C1.T @ C), V.T @ C1.T @ free
    T, frequencies = _reachable_or_antistable(A_V, B_V)
    H, E = B1.T @ V + D11.T @ C, D11.T @ free
    axis = [_gain_at(one, A_V, B_V, np.hstack([C, free]), np.hstack([H, E])) for one in frequencies]
    S = V @ T
    # A controller that is proper leaves the direct term what the direct paths around it make of it.
    unseen = _kernel(D12.T)
    fixed = max([_gain(unseen, D11.T @ unseen), *axis])
    side = Side(S=S, A=T.T @ A_V @ T, B=T.T @ B_V, C=C @ T, D=free, H=H @ T, E=E, fixed=fixed)
    flow = np.hstack([A.T @ S + C1.T @ side.C, C1.T @ side.D])
    seen = np.hstack([B2.T @ S + D12.T @ side.C, D12.T @ side.D])
    leak = np.linalg.norm(flow - S @ (S.T @ flow)) + np.linalg.norm(seen)
    size = 1.0 + np.linalg.norm(A) + np.linalg.norm(C1) * (1.0 + np.linalg.norm(side.C)) + np.linalg.norm(B2)
    return side if leak <= LARGEST_LEAK * size else None


def _kernel_of_rows(M: FloatArray) -> FloatArray:
    """Return the kernel of a matrix of full row rank."""
    return np.asarray(np.linalg.svd(M)[2][len(M) :].T) if len(M) else np.eye(M.shape[1])


def _reachable_or_antistable(A: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a basis of the states that inputs reach and of the other antistable ones, and unreached frequencies.

    Signals on (−∞, 0] do not contain what decays by itself. The frequencies are those of eigenvalues on the axis that
    no input moves.
    """
    from scipy.linalg import schur

    size = max(1.0, float(np.linalg.norm(A)))
    reached, rest = _split(B, LEAST_COUPLING * max(1.0, float(np.linalg.norm(B))))
    while rest.shape[1]:
        more, _ = _split(rest.T @ A @ reached, LEAST_COUPLING * size)
        if not more.shape[1]:
            break
        reached, rest = _split(np.hstack([reached, rest @ more]), 0.5)
    if not rest.shape[1]:
        return np.eye(len(A)), np.zeros(0)
    _, Z, count = schur(rest.T @ A @ rest, output="real", sort=lambda x, y: x > AXIS_DISTANCE * size)
    poles = np.array(clustered(np.linalg.eigvals(rest.T @ A @ rest), size))
    near = np.abs(poles.imag[np.abs(poles.real) <= AXIS_DISTANCE * size])
    near[near <= AXIS_DISTANCE * size] = 0.0
    return np.hstack([reached, rest @ Z[:, :count]]), np.unique(near)


def _at(side: Side, t: float) -> tuple[Level | None, FloatArray]:
    """Return the solution at t, or None and the frequencies of eigenvalues on the axis."""
    _, A, B, C, D, H, E, _ = side
    R = D.T @ D - t * E.T @ E
    if not len(A):
        return Level(np.zeros((0, 0)), np.zeros((D.shape[1], 0))), np.zeros(0)
    if R.size and np.linalg.eigvalsh(R)[0] <= 0.0:
        return None, np.zeros(0)
    Q, N = C.T @ C - t * H.T @ H, C.T @ D - t * H.T @ E
    into = np.linalg.solve(R, np.hstack([B.T, N.T]))
    n = len(A)
    # Backwards in time: what leads to ξ from rest is what leaves it.
    equation = Equation(-A, -B, Q, R, N, discrete=False)
    found = stabilising(hamiltonian(equation))
    X = found.X
    if X is None and found.distance > SOLUTION_DISTANCE and R.size:
        # X is large in some directions and small in others.
        X = by_pencil(equation)
    if X is None:
        near = np.abs(found.eigenvalues.real) <= 1e-5 * max(np.abs(found.eigenvalues).max(initial=0.0), 1.0)
        return None, np.unique(np.abs(found.eigenvalues.imag[near]))
    return Level(X, into[:, :n] @ X - into[:, n:]), np.zeros(0)


def _least_level(sides: tuple[Side, Side], near: float) -> float:
    """Return the largest level proved to be a lower bound, by search in t = gamma⁻² for the last feasible one."""
    bound = max(max(_gain(side.D, side.E), side.fixed) for side in sides)
    feasible, beyond = 0.0, max(bound, LEAST_LEVEL) ** -2
    t = min((1.0 - SEARCH_WIDTH) * max(near, LEAST_LEVEL) ** -2, beyond) if near > 0.0 else min(1.0, 0.5 * beyond)
    for _ in range(SEARCH_STEPS):
        levels, frequencies = zip(*(_at(side, t) for side in sides), strict=True)
        shown = list(_of_frequencies(sides, frequencies))
        reached = _is_feasible(sides, levels, t)
        if reached:
            feasible = t
            shown += _of_levels(sides, levels)
        else:
            beyond = min(beyond, t)
        bound = max([bound, *shown])
        beyond = min(beyond, max(bound, LEAST_LEVEL) ** -2)
        if beyond - feasible <= SEARCH_WIDTH * beyond or bound >= (1.0 - NEAR_LEVEL) * near:
            break
        # What a feasible level shows is nearly the least level itself: look just above it.
        t = (1.0 - 0.5 * SEARCH_WIDTH) * beyond
        if not reached or t <= feasible + 0.1 * (beyond - feasible):
            far = feasible <= 0.1 * beyond
            t = math.sqrt(max(feasible, 1e-4 * beyond) * beyond) if far else 0.5 * (feasible + beyond)
    return bound


def _is_feasible(sides: tuple[Side, Side], levels: tuple[Level | None, Level | None], t: float) -> bool:
    if levels[0] is None or levels[1] is None:
        return False
    try:
        return math.sqrt(t) * _coupling(sides, (levels[0], levels[1]))[0] < 1.0
    except np.linalg.LinAlgError:
        return False


def _coupling(sides: tuple[Side, Side], levels: tuple[Level, Level]) -> tuple[float, FloatArray, FloatArray]:
    """Return the largest x'S_X'S_Y y for x'X x = y'Y y = 1, and x and y."""
    L, M = (np.linalg.cholesky(level.X) for level in levels)
    between = np.linalg.solve(L, np.linalg.solve(M, sides[1].S.T @ sides[0].S).T)
    if not between.size:
        return 0.0, np.zeros(len(L)), np.zeros(len(M))
    U, sigma, Vt = np.linalg.svd(between)
    return float(sigma[0]), np.linalg.solve(L.T, U[:, 0]), np.linalg.solve(M.T, Vt[0])


def _gain(Z: FloatArray, W: FloatArray) -> float:
    """Return the largest |W x| / |Z x|, evaluated at its vector."""
    if not Z.shape[1]:
        return 0.0
    R = np.linalg.qr(Z)[1]
    if np.abs(np.diag(R)).min() <= RANK_TOLERANCE * np.abs(R).max():
        return 0.0
    x = np.linalg.solve(R, np.linalg.svd(np.linalg.solve(R.T, W.T).T)[2][0].conj())
    return float(np.linalg.norm(W @ x) / np.linalg.norm(Z @ x))


def _gain_at(frequency: float, A: FloatArray, B: FloatArray, Z: FloatArray, W: FloatArray) -> float:
    """Largest |W x| / |Z x| of the harmonic signals x = [ξ, η] of ξ' = A ξ + B η."""
    n = len(A)
    pencil = np.hstack([A - 1j * frequency * np.eye(n), B])
    _, sigma, Vh = np.linalg.svd(pencil)
    rank = int(np.sum(sigma > LEAST_COUPLING * max(1.0, sigma.max(initial=0.0))))
    x = Vh[rank:].conj().T
    return _gain(Z @ x, W @ x)


def _of_frequencies(sides: tuple[Side, Side], frequencies: tuple[FloatArray, ...]) -> Iterator[float]:
    """Gains of the adjoint signals at frequencies, and between them."""
    for side, found in zip(sides, frequencies, strict=True):
        if not found.size:
            continue
        w = np.concatenate([[0.0], found, 0.5 * (found[1:] + found[:-1]), np.sqrt(found[1:] * found[:-1])])
        for one in w:
            yield _gain_at(one, side.A, side.B, np.hstack([side.C, side.D]), np.hstack([side.H, side.E]))


class Signals(NamedTuple):
    """Adjoint signals on (−∞, 0]: ∫ |ζ|², ∫ |ω|², and a root of the final value, W = ∫ d/dt ξξ'."""

    size: float
    seen: float
    end: FloatArray


def _signals(side: Side, level: Level, x: FloatArray) -> Signals:
    """Return the signals that lead to x by the feedback of `level`.

    In states of unit cost no feasible X exceeds γ: what W lacks to W >= 0 by rounding counts as so much more ∫ |ζ|².
    """
    from scipy.linalg import solve_continuous_lyapunov

    n, A = len(x), side.A + side.B @ level.K
    P = solve_continuous_lyapunov(A, np.outer(x, x))
    root = _root(0.5 * (P + P.T))
    drift = A @ root @ root.T
    end = drift + drift.T
    rounding = n * np.finfo(float).eps * float(np.linalg.norm(A)) * float(np.linalg.norm(root)) ** 2
    lacks = n * (rounding + max(-float(np.linalg.eigvalsh(end)[0]), 0.0))
    return Signals(
        size=float(np.linalg.norm((side.C + side.D @ level.K) @ root) ** 2) + lacks,
        seen=float(np.linalg.norm((side.H + side.E @ level.K) @ root) ** 2),
        end=_root(end),
    )


def _root(P: FloatArray) -> FloatArray:
    """Return a root of the positive semidefinite part."""
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _of_levels(sides: tuple[Side, Side], levels: tuple[Level, Level]) -> Iterator[float]:
    """Yield bounds from the signals for which the two solutions are least compatible, and from those of each alone."""
    nothing = [Signals(0.0, 0.0, np.zeros_like(level.X)) for level in levels]
    for k, (side, level) in enumerate(zip(sides, levels, strict=True)):
        if len(level.X):
            alone = nothing.copy()
            alone[k] = _signals(side, level, np.linalg.eigh(level.X)[1][:, 0])
            yield _dual(sides, *alone)
    if all(len(level.X) for level in levels):
        _, *ends = _coupling(sides, levels)
        yield _dual(sides, *(_signals(*each) for each in zip(sides, levels, ends, strict=True)))


def _dual(sides: tuple[Side, Side], one: Signals, other: Signals) -> float:
    """Return the level below which these signals exclude every controller: λ² s − λ f − g² = 0.

    Every pair X, Y of the synthesis inequalities at γ has tr(X W) <= γ s − g²/γ, summed over both sides, with W the end
    of the signals, and tr(X W_X) + tr(Y W_Y) >= f = 2 |W_X^½ S_X' S_Y W_Y^½| in the nuclear norm, by [X, I; I, Y] >= 0.
    """
    f = 2.0 * float(np.linalg.svd(one.end.T @ sides[0].S.T @ sides[1].S @ other.end, compute_uv=False).sum())
    s, g2 = one.size + other.size, one.seen + other.seen
    return (f + math.sqrt(f * f + 4.0 * s * g2)) / (2.0 * s) if s > 0.0 else 0.0
