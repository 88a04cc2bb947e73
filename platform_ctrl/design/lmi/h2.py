"""H2 synthesis by linear matrix inequalities: nothing is assumed about the ranks of D12 and D21, or zeros on the axis.

With one Lyapunov matrix, the loop is linear in X, Y and the transformed controller Â, B̂, Ĉ, D̂ (Scherer, Gahinet and
Chilali 1997); for sampled plants the inequalities are those of de Oliveira, Geromel and Bernussou (2002). The least
norm is found first, then at (1 + backoff) times it the X, Y that are farthest from X Y = I. Where D12 or D21 loses rank
the least norm is not attained: the controller's gains are unbounded near it, and the back-off limits them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.lmi.conic import Solver, cp, solved
from platform_ctrl.design.lmi.linearised import Pair, balancing, from_linearised, in_states, output_feedback, separated
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.scaling import ScaledPlant, autoscale, unscale, without_direct_path
from platform_ctrl.errors import UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "h2, lmi"
CURE = 'give a larger backoff, or method="riccati" with regularise=1e-3'
# Tolerances of the solves that find good units and states, and of the others.
ROUGH, FINE = 1e-5, 1e-8
# Solved again in other units until the least norm of the scaled plant is within 1/4 .. 4; at most so often.
NORM_RANGE, MOST_ROUNDS = 4.0, 4
# Distance of the inequalities from zero in the last step, relative to the back-off, tried in turn.
STRICTNESS = (1e-3, 1e-4, 1e-5)
# Factor by which X and Y may grow for their separation.
ROOM = 10.0


class Found(NamedTuple):
    """The bound on the norm (scaled), X and Y with their separation, and the transformed controller."""

    level: float
    pair: Pair
    hat: StateArrays


def h2_lmi(
    plant: Partition, direct: bool, backoff: float, time_limit: float, P: StateSpace
) -> tuple[StateArrays, float, dict[str, float]]:
    """Return the controller in the units of `plant`, the least norm, and figures of merit (scaled)."""
    solver = Solver(where=WHERE, cure=CURE, time_limit=time_limit, P=P)
    scaled, T, gain, least = _least(plant, direct, solver)
    flat = in_states(_posed(scaled, P)[0], T)
    failure: UnscalableError | None = None
    for share in STRICTNESS:
        try:
            best = _separated(flat, least, direct, backoff, share * min(backoff, 0.02), solver)
            made = from_linearised(flat, best.pair.X, best.pair.Y, best.hat)
        except (UnscalableError, np.linalg.LinAlgError) as error:
            failure = failure or UnscalableError(f"{WHERE}: {error}; {CURE}", P)
            continue
        residual = {"separation of X and Y": best.pair.separation}
        return unscale(made._replace(D=made.D + gain), scaled), least.level * _unit(scaled), residual
    assert failure is not None
    raise failure


def _unit(scaled: ScaledPlant) -> float:
    """Return the unit of the norm: time is counted in units of 1/rate, in which white noise has another density."""
    return float(scaled.gain * np.sqrt(scaled.rate))


def _posed(scaled: ScaledPlant, P: StateSpace) -> tuple[Partition, FloatArray]:
    """Return the plant with the gain closed that cancels D11, and that gain; sampled plants keep D11."""
    p = scaled.plant
    if p.dt:
        return p, np.zeros((p.D12.shape[1], p.D21.shape[0]))
    return without_direct_path(p, P, WHERE)


def _least(plant: Partition, direct: bool, solver: Solver) -> tuple[ScaledPlant, FloatArray, FloatArray, Found]:
    """Return the plant in units and states T in which the least norm is accurate, the gain that is closed, and it."""
    scaled = autoscale(plant)
    flat, gain = _posed(scaled, solver.P)
    T = np.eye(len(flat.A))
    found = _minimised(flat, direct, solver, ROUGH)
    for _ in range(MOST_ROUNDS):
        settled = 1 / NORM_RANGE < found.level < NORM_RANGE
        # States that are balanced in the old units of z and w stay so: X and Y grow and shrink together.
        T = T @ balancing(found.pair) if settled else scaled.state[:, None] * T
        if not settled:
            scaled = autoscale(plant, scaled.gain * found.level)
            flat, gain = _posed(scaled, solver.P)
            T = T / scaled.state[:, None]
        found = _minimised(in_states(flat, T), direct, solver, FINE if settled else ROUGH)
        if settled:
            break
    return scaled, T, gain, found


def _minimised(p: Partition, direct: bool, solver: Solver, tolerance: float) -> Found:
    X, Y, hat, level = *_unknowns(p, direct), cp.Variable()
    problem = cp.Problem(cp.Minimize(level), _inequalities(p, X, Y, hat, level, 0.0))
    solver.solve(problem, (X, Y), "minimising the norm", tolerance)
    return Found(float(level.value), Pair(gamma=float(level.value), X=X.value, Y=Y.value, separation=1.0), solved(hat))


def _separated(p: Partition, least: Found, direct: bool, backoff: float, margin: float, solver: Solver) -> Found:
    X, Y, hat = _unknowns(p, direct)
    n = len(p.A)
    own = max(10.0, float(np.trace(least.pair.X) / n), float(np.trace(least.pair.Y) / n))
    level = (1.0 + backoff) * least.level
    required = _inequalities(p, X, Y, hat, level, margin)
    t = separated(X, Y, required, ROOM * own, solver, "separating X and Y", 1e-7)
    return Found(level, Pair(gamma=level, X=X.value, Y=Y.value, separation=t), solved(hat))


def _unknowns(p: Partition, direct: bool) -> tuple[Any, Any, StateArrays]:
    n, nu, ny = len(p.A), p.B2.shape[1], len(p.C2)
    D: Any = cp.Variable((nu, ny)) if p.dt and direct else np.zeros((nu, ny))
    hat = StateArrays(A=cp.Variable((n, n)), B=cp.Variable((n, ny)), C=cp.Variable((nu, n)), D=D)
    return cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), hat


def _inequalities(p: Partition, X: Any, Y: Any, hat: StateArrays, level: Any, margin: float) -> list[Any]:
    """Return constraints: the norm is below `level`, by the Lyapunov matrix of congruent form [[X, I], [I, Y]]."""
    nz, nw = p.D11.shape
    V, VA, VB, C, D = output_feedback(p, X, Y, hat)
    cover = cp.Variable((nz, nz), symmetric=True)
    if p.dt:
        none = np.zeros((V.shape[0], nw))
        decay = cp.bmat([[V, VA, VB], [VA.T, V, none], [VB.T, none.T, level * np.eye(nw)]])
        seen = cp.bmat([[cover, C, D], [C.T, V, none], [D.T, none.T, level * np.eye(nw)]])
    else:
        decay = -cp.bmat([[VA + VA.T, VB], [VB.T, -level * np.eye(nw)]])
        seen = cp.bmat([[cover, C], [C.T, V]])
    return [decay >> margin * np.eye(decay.shape[0]), seen >> 0, cp.trace(cover) <= level]
