"""The method "lmi" of jobs: limits on a plant written by hand from (27), bounds, and what it says of failures."""

import copy
import tomllib
from pathlib import Path

import control
import numpy as np
import pytest
import sympy
from scipy.linalg import block_diag, expm, solve_discrete_lyapunov

import three_gyro_paper as paper
from platform_ctrl import design
from platform_ctrl.analysis.system import System
from platform_ctrl.design.inequalities import LinearLoop, cp, half_plane, sector, sharing, solve
from platform_ctrl.design.loop import LoopOutcome
from platform_ctrl.design.partition import closed_loop, partition
from platform_ctrl.design.scaling import autoscale, unscale
from platform_ctrl.errors import ArgumentError, DesignError, InfeasibleError, TimeLimitError
from platform_ctrl.plant.reading import read_platform

EXAMPLES = Path(__file__).parents[2] / "examples"
JOB = tomllib.loads((EXAMPLES / "three_gyro_platform.toml").read_text())
# Of the shipped plant: lag of the torquers and delay, s, and rms of the pick-offs' noise, rad.
LAG, DELAY, PERIOD, NOISE = 2e-4, 5e-4, 5e-4, 5e-6
LOOPS = {"caging 4-5-7": ("4", "5", "7"), "caging 9-10": ("9", "10")}


def job_of(loop: str, **changes: dict[str, float]) -> dict[str, object]:
    """The shipped job with the LMI design of one loop alone; `limits` and `options` are changed."""
    job = {key: copy.deepcopy(JOB[key]) for key in ("schema", "name", "plant", "operation", "uncertainty", "sampling")}
    spec = copy.deepcopy(next(one for one in JOB["loop"] if one["name"] == loop))
    spec["design"] = [one | changes.get("options", {}) for one in spec["design"] if one["name"] == "LMI"]
    spec["limits"] |= changes.get("limits", {})
    return job | {"loop": [spec | {"use": "LMI"}]}


@pytest.fixture(scope="module", params=LOOPS)
def made(request: pytest.FixtureRequest) -> LoopOutcome:
    return design.loops(job_of(request.param))[0]


def sampled_by_hand(gimbals: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(27) at Omega = 0 behind torquers with a lag, their commands one sample late: A, B, C of the samples."""
    names = list(paper.ROWS)
    rows = [names.index(name) for name in gimbals]
    values = paper.numbers(read_platform("three_gyro_platform"))
    of_symbols = {symbol: values.get(symbol.name, 0.0) for symbol in (paper.L6, paper.L8, paper.L11)}
    left = paper.gimbal_rows("paper").subs(
        {symbol: 0 for symbol in (*paper.VELOCITY[:3], paper.D1, paper.D2, paper.D3)}
    )
    inertias = {symbol: values[symbol.name] for symbol in (paper.J4, paper.J5, paper.J7, paper.J9, paper.J10)}
    rates, accelerations = paper.VELOCITY[3:], (paper.a4dd, paper.b5dd, paper.b7dd, paper.a9dd, paper.b10dd)
    M, G = (
        np.array(left.jacobian(sympy.Matrix(x)).subs(of_symbols | inertias), float)[np.ix_(rows, rows)]
        for x in (accelerations, rates)
    )
    k, zero, eye = len(rows), np.zeros((len(rows), len(rows))), np.eye(len(rows))
    A = np.block([
        [zero, eye, zero, zero],
        [zero, -np.linalg.solve(M, G), np.linalg.inv(M), zero],
        [zero, zero, -eye / LAG, eye / LAG],
        [np.zeros((k, 4 * k))],
    ])  # fmt: skip
    step = expm(A * PERIOD)
    # The held command is the one of the sample before.
    held, into = step[: 3 * k, : 3 * k], step[: 3 * k, 3 * k :]
    sampled = np.block([[held, into], [np.zeros((k, 4 * k))]])
    return sampled, np.vstack([np.zeros((3 * k, k)), eye]), np.hstack([eye, np.zeros((k, 3 * k))])


def test_the_limits_hold_on_the_plant_of_equation_27(made):
    A, B, C = sampled_by_hand(LOOPS[made.spec.name])
    K = made.closed.controller
    loop = np.block([[A + B @ K.D @ C, B @ K.C], [K.B @ C, K.A]])
    poles = np.log(np.linalg.eigvals(loop).astype(complex)) / PERIOD
    limits, options = made.spec.limits, made.closed.options
    assert -poles.real.max() > options["pole_decay"]
    moving = poles[np.abs(poles) > 53.0]
    assert np.min(-moving.real / np.abs(moving)) > limits["damping"]
    # Noise n of the pick-offs to torques: the stationary variance.
    into = np.vstack([B @ K.D, K.B])
    V = solve_discrete_lyapunov(loop, NOISE**2 * into @ into.T)
    out = np.hstack([K.D @ C, K.C])
    rms = np.sqrt(np.diag(out @ V @ out.T + NOISE**2 * K.D @ K.D.T))
    assert rms.max() < limits["torque_noise"]
    assert rms.max() < made.closed.claims["torque noise bound, N m"]
    # (S − T)/2 at the output, S = (I − P K)⁻¹, on a fine grid.
    z = np.exp(1j * np.geomspace(1.0, 0.9999 * np.pi / PERIOD, 20_000) * PERIOD)[:, None, None]
    eye = np.eye(len(C))
    plant = C @ np.linalg.solve(z * np.eye(len(A)) - A, B)
    control_ = K.D + K.C @ np.linalg.solve(z * np.eye(len(K.A)) - K.A, np.broadcast_to(K.B, (len(z), *K.B.shape)))
    S = np.linalg.inv(eye - plant @ control_)
    alpha = 1.0 / np.linalg.norm(S - 0.5 * eye, 2, axis=(1, 2)).max()
    assert alpha > limits["disk_margin"]
    np.testing.assert_allclose(alpha, made.closed.measures.disk_margin[0], rtol=0.2)
    assert all(result.passed for result in made.closed.results)


def test_the_claims_are_the_performance_and_the_plants_that_share_one_lyapunov_matrix(made):
    claims = made.closed.claims
    backoff, slack = made.closed.options["backoff"], 0.03
    assert claims["gamma_optimal"] <= claims["gamma"] <= (1 + backoff) * (1 + slack) * claims["gamma_optimal"] * 1.001
    assert claims["plants"] == len(made.closed.plants.labels)
    expected = {"caging 9-10": 17, "caging 4-5-7": 9}
    assert claims["plants with one Lyapunov matrix"] == expected[made.spec.name]


def test_loops_without_a_common_matrix_share_none():
    # Each is stable; their product is not.
    first, second = np.array([[0.5, 2.0], [0.0, 0.5]]), np.array([[0.5, 0.0], [2.0, 0.5]])
    assert np.abs(np.linalg.eigvals(first @ second)).max() > 1.0
    assert sharing(np.array([first, second, 0.9 * first]), 10.0) == 2


def weighted() -> control.StateSpace:
    """A gyroscopic pair behind a lag, with torque disturbance and noise, weighted rate and control."""
    A = block_diag(np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, -5.0], [0, 0, 5.0, 0]]), -20 * np.eye(2))
    A[2:4, 4:] = np.eye(2)
    B1, B2 = np.zeros((6, 4)), np.zeros((6, 2))
    B1[2:4, :2], B2[4:] = np.eye(2), 20 * np.eye(2)
    C1, C2 = np.zeros((4, 6)), np.hstack([np.eye(2), np.zeros((2, 4))])
    C1[:2, :2] = np.eye(2)
    D = np.zeros((6, 6))
    D[2:4, 4:], D[4:, 2:4] = 0.1 * np.eye(2), 0.1 * np.eye(2)
    return control.ss(A, np.hstack([B1, B2]), np.vstack([C1, C2]), D)


def test_the_bounded_real_inequality_has_the_norm_of_the_riccati_equations_and_of_slycot():
    P = weighted()
    scaled = autoscale(partition(P, 2, 2))
    loop, square = LinearLoop(scaled.plant, direct=True), cp.Variable()
    least = cp.Problem(cp.Minimize(square), [loop.V >> 0, loop.hinf_below(range(4), range(4), 1.0, square)])
    solve(least, "test", "", 30.0, 1e-7)
    gamma = float(np.sqrt(square.value)) * scaled.gain
    assert gamma == pytest.approx(design.hinf(P, 2, 2, method="riccati").gamma_optimal, rel=1e-3)
    assert gamma == pytest.approx(control.hinfsyn(P, 2, 2)[2], rel=0.01)


def test_norms_and_poles_of_the_loop_are_within_their_inequalities():
    P, limit = weighted(), 2.0
    plant = partition(P, 2, 2)
    scaled = autoscale(plant)
    loop, noise = LinearLoop(scaled.plant, direct=False), cp.Variable()
    gamma = limit * design.hinf(P, 2, 2, method="riccati").gamma_optimal
    inequalities = [
        loop.hinf_below(range(4), range(4), 1.0, (gamma / scaled.gain) ** 2),
        *loop.outputs_below([2, 3], noise),
        loop.poles_in(*half_plane(0.5 / scaled.rate)),
        loop.poles_in(*sector(0.4)),
        loop.separated(1.05),
    ]
    solve(cp.Problem(cp.Minimize(noise), inequalities), "test", "", 30.0, 1e-6)
    around = closed_loop(plant, unscale(loop.controller(), scaled))
    poles = np.linalg.eigvals(around.A)
    assert poles.real.max() < -0.5
    assert np.min(-poles.real / np.abs(poles)) > 0.4
    system = around.to_control(list("abcd"), list("efgh"))
    assert control.linfnorm(system)[0] < gamma
    largest = max(control.system_norm(system[k, 2:4], 2) for k in (2, 3))
    assert largest < float(np.sqrt(noise.value * scaled.rate)) * scaled.gain


def test_a_limit_out_of_reach_is_said_with_the_tightest_inequality():
    with pytest.raises(
        InfeasibleError, match=r"9-10, LMI: none found: .* times their bounds at best; the tightest is"
    ) as caught:
        design.loops(job_of("caging 9-10", limits={"disk_margin": 1.9}))
    assert "\n" not in str(caught.value)


def test_a_solver_out_of_time_is_said():
    with pytest.raises(
        TimeLimitError, match=r"9-10, LMI: .*: the solver did not finish in 0.001 s; give a larger time_limit"
    ):
        design.loops(job_of("caging 9-10", options={"time_limit": 1e-3}))


def test_poles_that_no_controller_reaches_are_an_error():
    with pytest.raises(DesignError, match="9-10, LMI"):
        design.loops(job_of("caging 9-10", options={"pole_decay": 1e5}))


def test_the_tuner_brings_weights_that_miss_a_limit_within_it():
    slow = job_of("caging 9-10", options={"bandwidth_hz": 68.0, "tune": True})
    assert all(result.passed for result in design.loops(slow)[0].closed.results)


@pytest.mark.parametrize("name", LOOPS)
def test_python_control_designs_on_the_generalised_plant_and_the_loop_judges(name):
    loop = design.loops(job_of(name))[0]
    k = len(LOOPS[name])
    P = design.generalised_plant(loop, torque=0.06)
    assert P.input_labels == [f"{kind}{j + 1}" for kind in ("n", "d", "u") for j in range(k)]
    assert P.output_labels[-k:] == [f"measured{j + 1}" for j in range(k)]
    bound = design.hinf(P, k, k, method="riccati")
    # With 15 states, 6 w and 9 z slycot says "too small value of gamma" whatever it is.
    B, D = (np.insert(matrix, 2 * k, 0.0, axis=1) for matrix in (P.B, P.D))
    assert control.hinfsyn(control.ss(P.A, B, P.C, D), k, k)[2] == pytest.approx(bound.gamma_optimal, rel=0.01)
    closed = design.with_controller(loop, bound.controller, name="mine", torque=0.06)
    assert closed.use == "mine"
    assert closed.closed.measures.decay[0] > 0.0
    assert {one.name for one in closed.designs} == {"LMI", "mine"}
    # The generalised plant closed by K has the poles of the sampled loop, by the bilinear map.
    w = np.linalg.eigvals(closed_loop(partition(P, k, k), System.of(bound.controller, "K")).A)
    A, B, C = (closed.closed.plant.A, closed.closed.plant.B[:, :k], closed.closed.plant.C[:k])
    K = closed.closed.controller
    z = np.linalg.eigvals(np.block([[A + B @ K.D @ C, B @ K.C], [K.B @ C, K.A]]))
    mapped = (1 + w * PERIOD / 2) / (1 - w * PERIOD / 2)
    for pole in z[np.abs(z) > 0.3]:
        assert np.abs(mapped - pole).min() < 1e-5
    # The same controller, sampled, by its signals.
    again = design.with_controller(loop, K, name="again")
    np.testing.assert_allclose(again.closed.measures.disk_margin, closed.closed.measures.disk_margin, rtol=1e-9)


def test_a_controller_or_a_weight_that_does_not_fit_is_refused():
    loop = design.loops(job_of("caging 9-10"))[0]
    with pytest.raises(ArgumentError, match="must have 2 inputs and outputs, as the generalised plant has 2"):
        design.with_controller(loop, control.ss([], [], [], np.eye(3)))
    with pytest.raises(ArgumentError, match=r"generalised_plant: option 'bandwidth' has no meaning .* did you mean"):
        design.generalised_plant(loop, bandwidth=30.0)
