"""One start of the search: where it begins, and how it goes on to a local minimum."""

from __future__ import annotations

import time

import numpy as np

from platform_ctrl.design.partition import Partition, Realisation
from platform_ctrl.design.scaling import autoscale
from platform_ctrl.design.structured.chart import Chart
from platform_ctrl.design.structured.minimax import Minimum, minimise
from platform_ctrl.design.structured.norm import ClosedLoop, augmented
from platform_ctrl.design.structured.objective import WorstNorm
from platform_ctrl.design.structured.structures import Structure, Units
from platform_ctrl.design.structured.tuned import Tuned
from platform_ctrl.frozen import FloatArray, value

# Least sines of the angle to infinite gain, one stage after another.
_STAGES = (1e-2, 1e-4, 1e-6)
_ROUNDS = 4


@value
class Problem:
    """What every start is told.

    Attributes
    ----------
    plants
        Continuous, or in the w-plane.
    structure
        What is tuned.
    full
        Full-order controller of the first plant, or None.
    seed
        Of the random starts.
    """

    plants: tuple[Partition, ...]
    structure: Structure
    full: Realisation | None
    seed: int


@value
class Start:
    """What one start came to.

    Attributes
    ----------
    number, kind
        Which, and where it began: "given", "full order" or "random".
    gamma
        Largest norm over the plants; inf where no stable loop was found.
    abscissa
        Largest real part of all closed-loop poles, rad/s.
    matrix
        [A_K, B_K; C_K, D_K].
    parameters
        By name.
    evaluations, seconds
        What it took.
    finished
        Whether it ended by itself.
    history
        Largest norm after every accepted step.
    """

    number: int
    kind: str
    gamma: float
    abscissa: float
    matrix: FloatArray
    parameters: dict[str, float]
    evaluations: int
    seconds: float
    finished: bool
    history: FloatArray


def units_of(plant: Partition) -> tuple[Units, FloatArray, FloatArray]:
    """Return typical gains and frequency of a plant, and the units of controls (nu, nu) and measurements (ny, ny)."""
    scaled = autoscale(plant)
    gain = np.sqrt(np.sum(scaled.control**2, axis=1))[:, None] * np.sqrt(np.sum(scaled.measurement**2, axis=0))
    return Units(gain=gain, rate=scaled.rate), scaled.control, scaled.measurement


def started(problem: Problem, number: int, time_limit: float) -> Start:
    """Run one start; deterministic in `problem` and `number` unless time runs out."""
    began = time.monotonic()
    structure, plant = problem.structure, problem.plants[0]
    ny, nu = plant.D22.shape
    units, left, right = units_of(plant)
    tuned = Tuned(structure, ny, nu, units)
    order = structure.order(ny, nu)
    plants = [augmented(one, order) for one in problem.plants]
    x, kind = _beginning(problem, tuned, number)
    if not structure.free:
        objective = WorstNorm(plants, tuned)
        found = _minimised(objective, x, tuned.lower, tuned.upper, time_limit)
        M, parameters, history = tuned.matrix(found.x), tuned.named(found.x), list(found.history)
        spent = found.evaluations
    else:
        M = tuned.matrix(x)
        U = np.block([[units.rate * np.eye(order), np.zeros((order, nu))], [np.zeros((nu, order)), left]])
        Y = np.block([[np.eye(order), np.zeros((order, ny))], [np.zeros((ny, order)), right]])
        history, spent = [], 0
        last = np.inf
        stage = 0
        rounds = 0
        while True:
            chart = Chart(M, U, Y, _STAGES[stage])
            objective = WorstNorm(plants, chart)
            left_over = time_limit - (time.monotonic() - began)
            found = _minimised(objective, np.zeros(M.size), None, None, left_over)
            spent += found.evaluations
            M = chart.matrix(found.x)
            history += found.history
            rounds += 1
            if not (found.stable and found.finished):
                break
            settled = found.value > last * (1.0 - 1e-6) or rounds >= _ROUNDS
            last = min(last, found.value)
            if settled:
                if stage == len(_STAGES) - 1 or not chart.near_limit(found.x):
                    break
                stage, rounds, last = stage + 1, 0, np.inf
        names = [one.name for one in tuned.parameters]
        k = order
        flat = np.concatenate([M[:k, :k].ravel(), M[:k, k:].ravel(), M[k:, :k].ravel(), M[k:, k:].ravel()])
        parameters = dict(zip(names, (float(p) for p in flat), strict=True))
    return Start(
        number=number,
        kind=kind,
        gamma=found.value,
        abscissa=found.stability,
        matrix=M,
        parameters=parameters,
        evaluations=spent,
        seconds=time.monotonic() - began,
        finished=found.finished,
        history=np.array(history),
    )


def _minimised(
    objective: WorstNorm, x: FloatArray, lower: FloatArray | None, upper: FloatArray | None, time_limit: float
) -> Minimum:
    return minimise(
        objective.pieces,
        x,
        lower,
        upper,
        stability=objective.stability,
        curvature=objective.curvature,
        walls=objective.walls,
        descent=0,
        evaluations=1500,
        time_limit=time_limit,
    )


def _beginning(problem: Problem, tuned: Tuned, number: int) -> tuple[FloatArray, str]:
    """Return where a start begins and what that is called."""
    if number == 0:
        return tuned.start, "given"
    if number % 3 == 1 and problem.full is not None and number <= 7:
        scatter = np.random.default_rng([problem.seed, number]).standard_normal(len(tuned.start)) * (number > 1)
        return fitted(problem, tuned, np.clip(tuned.start + scatter, tuned.lower, tuned.upper)), "full order"
    random = np.random.default_rng([problem.seed, number])
    size = 10.0 ** random.uniform(-1.0, 1.0)
    scatter = random.standard_normal(len(tuned.start)) * np.where(tuned.logarithmic, 0.7, size)
    return np.clip(tuned.start + scatter, tuned.lower, tuned.upper), "random"


def fitted(problem: Problem, tuned: Tuned, x: FloatArray) -> FloatArray:
    """Return x for which the structure does to the closed loop most nearly what the full-order controller does.

    Least squares of L (K(x) − K_full) R over frequency, the first-order change of the closed loop.
    """
    from scipy.optimize import least_squares

    full = problem.full
    assert full is not None
    plant = problem.plants[0]
    nk, (ny, nu) = len(full.A), plant.D22.shape
    loop = ClosedLoop(augmented(plant, nk), np.block([[full.A, full.B], [full.C, full.D]]))
    moduli = np.abs(loop.poles)
    middle = float(np.exp(np.mean(np.log(np.maximum(moduli, 1e-12 * moduli.max())))))
    frequency = np.geomspace(1e-3 * middle, 1e2 * middle, 40)
    weights = [loop.responses(float(w)) for w in frequency]
    L = np.array([one[1][:, nk:] for one in weights])
    R = np.array([one[2][nk:] for one in weights])
    s = 1j * frequency

    def response(M: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        k = len(M) - nu
        X = np.linalg.inv(s[:, None, None] * np.eye(k) - M[:k, :k]) if k else np.zeros((len(s), 0, 0), complex)
        left = np.concatenate([M[k:, :k] @ X, np.broadcast_to(np.eye(nu), (len(s), nu, nu))], axis=2)
        right = np.concatenate([X @ M[:k, k:], np.broadcast_to(np.eye(ny), (len(s), ny, ny))], axis=1)
        return left[:, :, :k] @ M[:k, k:] + M[k:, k:], left, right

    wanted = response(np.block([[full.A, full.B], [full.C, full.D]]))[0]

    def residual(y: FloatArray) -> FloatArray:
        error = L @ (response(tuned.matrix(y))[0] - wanted) @ R
        out = np.concatenate([error.real.ravel(), error.imag.ravel()])
        return np.asarray(np.where(np.isfinite(out), np.clip(out, -1e100, 1e100), 1e100))

    def slopes(y: FloatArray) -> FloatArray:
        _, left, right = response(tuned.matrix(y))
        moved = np.einsum("fai,ijx,fjb->fabx", L @ left, tuned.jacobian(y), right @ R, optimize=True)
        out = np.concatenate([moved.real.reshape(-1, len(y)), moved.imag.reshape(-1, len(y))])
        return np.asarray(np.where(np.isfinite(out), np.clip(out, -1e100, 1e100), 0.0))

    try:
        found = least_squares(
            residual, x, jac=slopes, bounds=(tuned.lower, tuned.upper), x_scale="jac", max_nfev=60, xtol=1e-6, ftol=1e-6
        )
    except (ValueError, np.linalg.LinAlgError):
        return x
    return np.asarray(found.x, dtype=np.float64)
