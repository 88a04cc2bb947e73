"""H2 synthesis by linear matrix inequalities: nothing is assumed about the ranks of D12 and D21, or zeros on the axis.

With one Lyapunov matrix, the loop is linear in X, Y and the transformed controller Â, B̂, Ĉ, D̂ (Scherer, Gahinet and
Chilali 1997); for sampled plants the inequalities are those of de Oliveira, Geromel and Bernussou (2002). The least
norm is found first, then at (1 + backoff) times it the X, Y that stay farthest from X Y = I. Where D12 or D21 loses
rank the least norm is not attained: nearer to it the controller's gains grow without end; the back-off bounds them.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.lmi.bounded_real import Pair, balancing, from_linearised, turned
from platform_ctrl.design.lmi.conic import cvxpy, solve, solved
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.riccati.assumptions import without_direct_path
from platform_ctrl.design.scaling import ScaledPlant, autoscale, unscale
from platform_ctrl.errors import UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "h2, lmi"
CURE = 'give a larger backoff, or method="riccati" with regularise=1e-3'
# Tolerances of the solves that find good units and states, and of the others.
ROUGH, FINE = 1e-5, 1e-8
# Solved again in other units until the least norm of the scaled plant is within 1/4 .. 4; at most so often.
NORM_RANGE, MOST_ROUNDS = 4.0, 4
# How far the inequalities are kept from zero in the last step, relative to the back-off: until everything holds.
STRICTNESS = (1e-3, 1e-4, 1e-5)
# Largest separation t in [[X, tI], [tI, Y]] ≥ 0 that is requested, and how much more X and Y may grow for it.
LARGEST_SEPARATION, ROOM = 10.0, 10.0


class Found(NamedTuple):
    """The bound on the norm (scaled), X and Y with their separation, and the transformed controller."""

    level: float
    pair: Pair
    hat: StateArrays


def h2_lmi(
    plant: Partition, direct: bool, backoff: float, time_limit: float, P: StateSpace
) -> tuple[StateArrays, float, dict[str, float]]:
    """Controller in the units of `plant`, the least norm, and figures of merit (scaled)."""
    scaled, T, gain, least = _least(plant, direct, time_limit, P)
    flat = _in_states(_posed(scaled, P)[0], T)
    failure: UnscalableError | None = None
    for share in STRICTNESS:
        try:
            best = _separated(flat, least, direct, backoff, share * min(backoff, 0.02), time_limit, P)
            made = from_linearised(flat, best.pair.X, best.pair.Y, best.hat)
        except (UnscalableError, np.linalg.LinAlgError) as error:
            failure = failure or UnscalableError(f"{WHERE}: {error}; {CURE}", P)
            continue
        made = StateArrays(A=made.A, B=made.B, C=made.C, D=made.D + gain)
        residual = {"separation of X and Y": best.pair.separation}
        return unscale(made, scaled), least.level * _unit(scaled), residual
    assert failure is not None
    raise failure


def _unit(scaled: ScaledPlant) -> float:
    """Unit of the norm: continuous time is counted in units of 1/rate, in which white noise has another density."""
    return float(scaled.gain * np.sqrt(scaled.rate))


def _in_states(plant: Partition, T: FloatArray) -> Partition:
    return dataclasses.replace(turned(plant, T), dt=plant.dt)


def _posed(scaled: ScaledPlant, P: StateSpace) -> tuple[Partition, FloatArray]:
    """The plant with the gain closed that cancels D11, and that gain; sampled plants keep D11."""
    p = scaled.plant
    if p.dt:
        return p, np.zeros((p.D12.shape[1], p.D21.shape[0]))
    return without_direct_path(p, P, WHERE)


def _least(
    plant: Partition, direct: bool, time_limit: float, P: StateSpace
) -> tuple[ScaledPlant, FloatArray, FloatArray, Found]:
    """The plant in units and states T in which the least norm is found accurately, the gain that is closed, and it."""
    scaled = autoscale(plant)
    flat, gain = _posed(scaled, P)
    T = np.eye(len(flat.A))
    found = _minimised(flat, direct, time_limit, P, ROUGH)
    for _ in range(MOST_ROUNDS):
        settled = 1 / NORM_RANGE < found.level < NORM_RANGE
        # States that are balanced in the old units of z and w stay so: X and Y grow and shrink together.
        T = T @ balancing(found.pair) if settled else scaled.state[:, None] * T
        if not settled:
            scaled = autoscale(plant, scaled.gain * found.level)
            flat, gain = _posed(scaled, P)
            T = T / scaled.state[:, None]
        found = _minimised(_in_states(flat, T), direct, time_limit, P, FINE if settled else ROUGH)
        if settled:
            break
    return scaled, T, gain, found


def _minimised(p: Partition, direct: bool, time_limit: float, P: StateSpace, tolerance: float) -> Found:
    cp = cvxpy()
    X, Y, hat, level = *_unknowns(p, direct), cp.Variable()
    problem = cp.Problem(cp.Minimize(level), _inequalities(p, X, Y, hat, level, 0.0))
    return _solved(problem, X, Y, hat, level, 1.0, "minimising the norm", time_limit, P, tolerance)


def _separated(
    p: Partition, least: Found, direct: bool, backoff: float, margin: float, time_limit: float, P: StateSpace
) -> Found:
    cp = cvxpy()
    X, Y, hat, t = *_unknowns(p, direct), cp.Variable()
    n = len(p.A)
    own = max(10.0, float(np.trace(least.pair.X) / n), float(np.trace(least.pair.Y) / n))
    level = (1.0 + backoff) * least.level
    constraints = _inequalities(p, X, Y, hat, level, margin)
    constraints += [
        cp.bmat([[X, t * np.eye(n)], [t * np.eye(n), Y]]) >> 0,
        t <= LARGEST_SEPARATION,
        cp.trace(X) <= ROOM * own * n,
        cp.trace(Y) <= ROOM * own * n,
    ]
    problem = cp.Problem(cp.Maximize(t), constraints)
    return _solved(problem, X, Y, hat, level, t, "separating X and Y", time_limit, P, 1e-7)


def _unknowns(p: Partition, direct: bool) -> tuple[Any, Any, StateArrays]:
    cp = cvxpy()
    n, nu, ny = len(p.A), p.B2.shape[1], len(p.C2)
    D: Any = cp.Variable((nu, ny)) if p.dt and direct else np.zeros((nu, ny))
    hat = StateArrays(A=cp.Variable((n, n)), B=cp.Variable((n, ny)), C=cp.Variable((nu, n)), D=D)
    return cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), hat


def _inequalities(p: Partition, X: Any, Y: Any, hat: StateArrays, level: Any, margin: float) -> list[Any]:
    """Constraints: the norm is below `level`, by the Lyapunov matrix whose congruent form is [[X, I], [I, Y]]."""
    cp = cvxpy()
    (nz, nw), one = p.D11.shape, np.eye(len(p.A))
    V = cp.bmat([[X, one], [one, Y]])
    VA = cp.bmat([[p.A @ X + p.B2 @ hat.C, p.A + p.B2 @ hat.D @ p.C2], [hat.A, Y @ p.A + hat.B @ p.C2]])
    VB = cp.vstack([p.B1 + p.B2 @ hat.D @ p.D21, Y @ p.B1 + hat.B @ p.D21])
    C = cp.hstack([p.C1 @ X + p.D12 @ hat.C, p.C1 + p.D12 @ hat.D @ p.C2])
    D = p.D11 + p.D12 @ hat.D @ p.D21
    cover = cp.Variable((nz, nz), symmetric=True)
    if p.dt:
        none = np.zeros((V.shape[0], nw))
        decay = cp.bmat([[V, VA, VB], [VA.T, V, none], [VB.T, none.T, level * np.eye(nw)]])
        seen = cp.bmat([[cover, C, D], [C.T, V, none], [D.T, none.T, level * np.eye(nw)]])
    else:
        decay = -cp.bmat([[VA + VA.T, VB], [VB.T, -level * np.eye(nw)]])
        seen = cp.bmat([[cover, C], [C.T, V]])
    return [decay >> margin * np.eye(decay.shape[0]), seen >> 0, cp.trace(cover) <= level]


def _solved(
    problem: Any,
    X: Any,
    Y: Any,
    hat: StateArrays,
    level: Any,
    t: Any,
    step: str,
    time_limit: float,
    P: StateSpace,
    tolerance: float,
) -> Found:
    solve(
        problem, (X, Y), what=f"{WHERE}: {step}", time_limit=time_limit, P=P, tolerance=tolerance, cure=CURE,
    )  # fmt: skip
    bound, separation = (float(getattr(x, "value", x)) for x in (level, t))
    return Found(bound, Pair(gamma=bound, X=X.value, Y=Y.value, separation=separation), solved(hat))
