"""LQG loops: gains by python-control called by hand, poles of feedback and estimator, sentences."""

from __future__ import annotations

import dataclasses

import control
import numpy as np
import pytest
from scipy.linalg import block_diag

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.system import System
from platform_ctrl.design.method import LoopProblem
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.methods.lqg import LQG, lqg_gains, quadratic_problem
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import NotStabilisableError
from platform_ctrl.job.job import Job
from platform_ctrl.mechanics.linearisation import linearise

LOOPS = ("caging 4-5-7", "caging 9-10")
BOTH = pytest.mark.parametrize("name", LOOPS)


@pytest.fixture(scope="module")
def job() -> Job:
    """The main job with its LQG designs alone."""
    read = read_job("examples/three_gyro_platform.toml")
    kept = [
        dataclasses.replace(spec, use="LQG", designs=tuple(one for one in spec.designs if one.method == "lqg"))
        for spec in read.loops
        if spec.name in LOOPS
    ]
    return dataclasses.replace(read, loops=tuple(kept))


@pytest.fixture(scope="module")
def problems(job: Job) -> dict[str, LoopProblem]:
    model = linearise(job.platform)
    return {
        spec.name: LoopProblem(
            job=job, spec=spec, design=spec.designs[0], model=model, plant_set=plants_of(job, spec).only(range(1))
        )
        for spec in job.loops
    }


def with_options(problem: LoopProblem, **options: float) -> LoopProblem:
    design = dataclasses.replace(problem.design, options=problem.design.options | options, tune=False)
    return dataclasses.replace(problem, design=design)


def made(problem: LoopProblem) -> System:
    return System.of(LQG().design(problem).controller, "K")


@BOTH
def test_the_gains_are_those_of_python_control_called_by_hand(problems: dict[str, LoopProblem], name: str) -> None:
    problem = problems[name]
    options, plants = problem.design.options, problem.plants
    posed = quadratic_problem(
        LQG().defaults(problem.design, problem.channel, plants.nutation, plants.period), problem.channel, plants
    )
    A, B, C, D, T = posed.plant
    assert not D.any()
    p = len(C)
    rate = options["largest_error"] / options["largest_rate"] / T * C @ (A - np.eye(len(A)))
    sums = 2.0 * np.pi * options["integral_hz"] * T * C
    Q = block_diag(C.T @ C + rate.T @ rate, np.eye(p))
    K, _, _ = control.dlqr(A, B, Q, np.eye(p), integral_action=sums)
    pair = [(options["recovery"], options["largest_torque"]), (options["recovery2"], options["largest_torque2"])]
    third = [(options["inertial_recovery"], options["inertial_largest_torque"])] if p == 3 else []
    torque_noise = np.diag([x / unit for x, unit in pair + third])
    G = np.hstack([B @ torque_noise, posed.G[:, p:]])
    noise = np.eye(p) * (5e-6 / options["largest_error"]) ** 2
    L, P, _ = control.dlqe(A, G, C, np.eye(p + 3), noise)
    found = lqg_gains(posed)
    for mine, theirs in ((found.K, K), (found.L, L), (A @ found.M, L)):
        np.testing.assert_allclose(mine, theirs, rtol=1e-10, atol=1e-10 * np.abs(theirs).max())
    # The platform's rate turns the gyros as it does in the plants: E, up to the balanced states.
    assert np.linalg.matrix_rank(posed.G[:, p:]) == p - len(third)
    assert P.shape == A.shape


@BOTH
def test_the_poles_are_those_of_the_feedback_and_of_the_estimator(problems: dict[str, LoopProblem], name: str) -> None:
    problem = with_options(problems[name])
    plants, found = problem.plants, LQG().design(problem)
    posed = quadratic_problem(found.options, problem.channel, plants)
    gains = lqg_gains(posed)
    expected = np.concatenate(
        [
            np.linalg.eigvals(posed.A - posed.B @ gains.K),
            np.linalg.eigvals(posed.plant.A - gains.L @ posed.plant.C),
        ]
    )
    A, B, C, _, _ = plants.of_torques()
    Ak, Bk, Ck, Dk, _ = System.of(found.controller, "K")
    poles = np.linalg.eigvals(np.block([[A + B @ Dk @ C, B @ Ck], [Bk @ C, Ak]]))
    # Of poles far inside the circle a share is rounding.
    for one in expected[np.abs(expected) > 0.1]:
        assert np.abs(poles - one).min() < 1e-6


def test_an_estimator_that_expects_torques_alone_is_faster_and_noisier(
    problems: dict[str, LoopProblem],
) -> None:
    """Omega moves the gyros without exciting nutation, so the estimator need not damp it as hard."""
    problem = problems["caging 9-10"]
    expected = measure(problem.plants, made(with_options(problem)))
    without = measure(
        problem.plants,
        made(with_options(problem, platform_rate=1e-6, recovery=0.03, recovery2=0.03)),
    )
    assert without.damping[0] > 1.5 * expected.damping[0]
    assert without.torque_noise.max() > 2.0 * expected.torque_noise.max()
    assert without.disk_margin[0] < 0.8 * expected.disk_margin[0]


def test_without_anything_that_moves_nutation_the_estimator_is_none(problems: dict[str, LoopProblem]) -> None:
    problem = with_options(problems["caging 9-10"], recovery=1e-30, recovery2=1e-30)
    with pytest.raises(NotStabilisableError, match=r"^lqg: control.dlqe finds no estimator .* try a larger recovery"):
        LQG().design(problem)


def test_the_tuner_meets_the_limits_from_rules_of_thumb(problems: dict[str, LoopProblem]) -> None:
    problem = problems["caging 9-10"]
    kept = {"bandwidth_hz": 35.0, "disk_margin": 0.45, "torque_noise": 0.008}
    design = dataclasses.replace(problem.design, options={})
    problem = dataclasses.replace(problem, design=design, spec=dataclasses.replace(problem.spec, limits=kept))
    reached = measure(problem.plants, made(problem))
    assert reached.bandwidth >= 2.0 * np.pi * kept["bandwidth_hz"]
    assert reached.disk_margin[0] >= kept["disk_margin"]
    assert reached.torque_noise.max() <= kept["torque_noise"]
