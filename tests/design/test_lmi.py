"""Matrix inequalities: the solver in its process, and designs against Riccati routes, closed forms and simulation."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time

import control
import cvxpy as cp
import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from platform_ctrl import design, parameter_varying, read_platform
from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.analysis.norms import h2_norm, hinf_norm
from platform_ctrl.common import clarabel_task
from platform_ctrl.design.lmi import conic
from platform_ctrl.design.partition import closed_loop, partition
from platform_ctrl.errors import ArgumentError, IllPosedError, InfeasibleError, TimeLimitError, UnscalableError
from platform_ctrl.job.requirements import requirement


def lyapunov_problem(n=4, sign=1.0):
    A = np.random.default_rng(n).normal(size=(n, n)) - 4 * np.eye(n)
    X = cp.Variable((n, n), symmetric=True)
    inequality = sign * (A @ X + X @ A.T) << -np.eye(n)
    return cp.Problem(cp.Minimize(cp.trace(X)), [inequality, X >> 0]), X, A


def solve(problem, X, time_limit=30.0):
    conic.Solver(where="test", cure="", time_limit=time_limit, P=problem).solve(problem, (X,), "inequality")


def stopped_worker():
    """The process of the solver, which hangs."""
    process = conic._shared.worker.process
    os.kill(process.pid, signal.SIGSTOP)
    return process


def test_another_process_solves_what_the_lyapunov_equation_solves():
    problem, X, A = lyapunov_problem()
    solve(problem, X)
    np.testing.assert_allclose(X.value, solve_continuous_lyapunov(A, -np.eye(len(A))), atol=1e-6)


def test_a_second_order_cone_and_equations_reach_the_worker_too():
    x = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(cp.norm(x) + cp.sum_squares(x)), [cp.sum(x) == 3, x >= 0.5])
    solve(problem, x)
    np.testing.assert_allclose(x.value, np.ones(3), atol=1e-5)


def test_a_hanging_solver_is_ended_in_time_and_the_next_problem_gets_a_new_one():
    problem, X, _ = lyapunov_problem()
    solve(problem, X)
    old = stopped_worker()
    start = time.monotonic()
    with pytest.raises(TimeLimitError, match=r"did not finish in 0\.3 s") as refused:
        solve(problem, X, time_limit=0.3)
    assert time.monotonic() - start < 10
    assert refused.value.problem is problem
    assert old.poll() is not None
    solve(problem, X)
    assert conic._shared.worker.process.pid != old.pid


def test_a_worker_that_died_is_replaced_once():
    problem, X, _ = lyapunov_problem()
    solve(problem, X)
    conic._shared.worker.process.kill()
    solve(problem, X)
    assert problem.status == "optimal"


def test_a_worker_that_cannot_run_is_an_error_and_not_a_hang(monkeypatch):
    problem, X, _ = lyapunov_problem()
    conic._shared.end()
    monkeypatch.setattr(clarabel_task, "clarabel_solution", sys.exit)
    with pytest.raises(UnscalableError, match="process died 2 times"):
        solve(problem, X)


def test_an_interrupt_ends_the_solver_at_once():
    problem, X, _ = lyapunov_problem()
    solve(problem, X)
    old = stopped_worker()
    timer = threading.Timer(0.3, _thread.interrupt_main)
    start = time.monotonic()
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        solve(problem, X)
    timer.join()
    assert time.monotonic() - start < 10
    assert old.poll() is not None


def test_threads_share_the_worker():
    answers = {}

    def work(n):
        problem, X, A = lyapunov_problem(n)
        solve(problem, X)
        answers[n] = np.abs(X.value - solve_continuous_lyapunov(A, -np.eye(n))).max()

    threads = [threading.Thread(target=work, args=(n,)) for n in (2, 3, 4, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 4
    assert max(answers.values()) < 1e-6


def test_infeasible_and_unbounded_problems_raise_errors():
    problem, X, _ = lyapunov_problem(sign=-1.0)
    with pytest.raises(InfeasibleError, match="test: inequality: the inequalities are infeasible") as refused:
        solve(problem, X)
    assert refused.value.problem is problem
    X = cp.Variable((2, 2), symmetric=True)
    with pytest.raises(UnscalableError, match="DualInfeasible"):
        solve(cp.Problem(cp.Maximize(cp.trace(X)), [X >> 0]), X)


# ---------------------------------------------------------------------------------------------------------------------
# Several requirements at once


def random_plant(seed=3, n=4):
    """Full D12 and D21, D11 = 0: both H2 and H-infinity problems are regular."""
    rng = np.random.default_rng(seed)
    A, B2, C2 = rng.normal(size=(n, n)), rng.normal(size=(n, 2)), rng.normal(size=(2, n))
    B1 = np.hstack([rng.normal(size=(n, 2)), np.zeros((n, 2))])
    C1 = np.vstack([rng.normal(size=(2, n)), np.zeros((2, n))])
    D = np.zeros((6, 6))
    D[2:4, 4:] = D[4:, 2:4] = np.eye(2)
    return control.ss(
        A,
        np.hstack([B1, B2]),
        np.vstack([C1, C2]),
        D,
        inputs=["d1", "d2", "n1", "n2", "Q9", "Q10"],
        outputs=["e1", "e2", "c1", "c2", "alpha9", "beta10"],
    )


def hinf_bound(limit=1.0, hard=False, **channel):
    return requirement("H-infinity norm", limit, hard=hard, channel=Channel(**channel) if channel else None)


def h2_bound(limit=1.0, hard=False, **channel):
    return requirement("H2 norm", limit, hard=hard, channel=Channel(**channel) if channel else None)


def by_name(result):
    return {outcome.name: outcome for outcome in result.outcomes}


@pytest.mark.parametrize("seed", [3, 4])
def test_one_norm_alone_reaches_what_its_riccati_equations_reach(seed):
    P = random_plant(seed)
    gamma = design.hinf(P, 2, 2, method="riccati").gamma_optimal
    result = design.multiobjective(P, 2, 2, [hinf_bound(0.1)])
    assert 0.1 * result.ratio_optimal == pytest.approx(gamma, rel=5e-3)
    assert result.outcomes[0].value == pytest.approx(hinf_norm(result.closed_loop)[0])
    assert result.outcomes[0].value <= 1.051 * gamma
    least = design.h2(P, 2, 2, method="riccati").gamma_optimal
    result = design.multiobjective(P, 2, 2, [h2_bound(10.0)])
    assert 10 * result.ratio_optimal == pytest.approx(least, rel=5e-3)
    assert result.outcomes[0].value == pytest.approx(h2_norm(result.closed_loop))
    assert least * (1 - 1e-6) <= result.outcomes[0].value <= 1.051 * least


def test_mixed_designs_lie_between_the_two_pure_ones():
    P = random_plant()
    best = design.hinf(P, 2, 2, method="riccati").gamma_optimal
    least = design.h2(P, 2, 2, method="riccati").gamma_optimal
    found = [design.multiobjective(P, 2, 2, [h2_bound(), hinf_bound(f * best, hard=True)]) for f in (1.1, 3.0)]
    bounds = [result.ratio_optimal for result in found]
    values = [by_name(result)["H2 norm"].value for result in found]
    assert bounds == sorted(bounds, reverse=True)
    assert values == sorted(values, reverse=True)
    assert all(least <= value <= 1.06 * bound for value, bound in zip(values, bounds, strict=True))
    # The H2 optimum itself is admissible for three times the least gamma.
    assert values[-1] < 1.06 * least
    for f, result in zip((1.1, 3.0), found, strict=True):
        assert by_name(result)["H-infinity norm"].value <= f * best


def test_limits_below_the_least_gamma_are_infeasible_and_the_message_says_how_far():
    P = random_plant()
    best = design.hinf(P, 2, 2, method="riccati").gamma_optimal
    with pytest.raises(InfeasibleError, match=r"is 1\.11\d?, (more than|not below)") as refused:
        design.multiobjective(P, 2, 2, [h2_bound(), hinf_bound(0.9 * best, hard=True)])
    assert refused.value.problem is P
    with pytest.raises(InfeasibleError, match=r"is 1\.11\d?, not below 1"):
        design.multiobjective(P, 2, 2, [hinf_bound(0.9 * best, hard=True)])
    kept = design.multiobjective(P, 2, 2, [hinf_bound(1.01 * best, hard=True)])
    assert kept.outcomes[0].passed


def test_channels_are_found_by_name_and_weighted():
    P = random_plant()
    weight = control.ss(-2.0, 1.0, 3.0, 0.5)
    result = design.multiobjective(
        P,
        2,
        2,
        [hinf_bound(inputs=("n1",), outputs=("c1", "e2"), input_weight=weight), h2_bound(20.0, True, inputs=("d1",))],
    )
    loop = result.closed_loop
    expected = hinf_norm(loop[["c1", "e2"], ["n1"]] * weight)[0]
    assert by_name(result)["H-infinity norm"].value == pytest.approx(expected, rel=1e-6)
    assert by_name(result)["H2 norm"].value == pytest.approx(h2_norm(loop[:, ["d1"]]), rel=1e-6)
    assert by_name(result)["H2 norm"].passed
    with pytest.raises(ArgumentError, match="did you mean 'n1'"):
        design.multiobjective(P, 2, 2, [hinf_bound(inputs=("n1x",))])


REGION = (requirement("stability", 0.5), requirement("damping", 0.4), requirement("fastest pole", 20.0))


@pytest.mark.parametrize("period", [0.0, 0.05])
def test_poles_lie_in_the_required_region(period):
    P = random_plant()
    if period:
        P = control.sample_system(P, period, method="bilinear")
    free = design.multiobjective(P, 2, 2, [hinf_bound()])
    result = design.multiobjective(P, 2, 2, [hinf_bound(), *REGION])
    assert not all(one.check_closed_loop(free.closed_loop).passed for one in REGION)
    assert all(one.check_closed_loop(result.closed_loop).passed for one in REGION)
    s = result.poles if not period else np.log(result.poles.astype(complex)) / period
    assert s.real.max() <= -0.5
    assert (-s.real / np.abs(s)).min() >= 0.4
    assert result.ratio_optimal > free.ratio_optimal


def test_every_claim_is_proved():
    P = random_plant()
    fastest = requirement("fastest controller pole", 100.0)
    result = design.multiobjective(P, 2, 2, [h2_bound(inputs=("d1", "d2")), hinf_bound(80.0, True), *REGION, fastest])
    certificates = result.certificates
    assert len(certificates) == 1 + len(result.outcomes)
    assert all(certificate.verify().proved for certificate in certificates)
    for certificate, outcome in zip(certificates[1:3], result.outcomes[:2], strict=True):
        assert certificate.bound == pytest.approx(outcome.value, rel=1e-3)


def test_a_region_alone_is_enough():
    result = design.multiobjective(random_plant(), 2, 2, REGION)
    assert np.isnan(result.ratio_optimal)
    assert all(outcome.passed for outcome in result.outcomes)


def test_norms_of_a_sampled_plant_are_those_of_the_sampled_loop():
    P = control.sample_system(random_plant(), 0.05, method="bilinear")
    best = design.hinf(P, 2, 2, method="riccati").gamma_optimal
    result = design.multiobjective(P, 2, 2, [hinf_bound()])
    assert result.controller.dt == 0.05
    assert result.ratio_optimal == pytest.approx(best, rel=5e-3)


def test_controller_poles_are_bounded_at_the_same_norm():
    P = random_plant(n=2)
    free = design.multiobjective(P, 2, 2, [hinf_bound()])
    fastest = np.abs(free.controller.poles()).max()
    bound = requirement("fastest controller pole", 0.7 * fastest)
    slow = design.multiobjective(P, 2, 2, [hinf_bound(), bound])
    assert np.abs(slow.controller.poles()).max() <= bound.limit
    assert slow.outcomes[0].ratio <= 1.06 * free.ratio_optimal
    with pytest.raises(InfeasibleError, match="the controller's fastest pole has"):
        design.multiobjective(P, 2, 2, [hinf_bound(), requirement("fastest controller pole", 1e-3 * fastest)])


def test_a_weight_s_pole_outside_the_region_is_named():
    slow = control.ss(-0.1, 1.0, 1.0, 0.0)
    with pytest.raises(IllPosedError, match=r"mode at -0\.1\+0j rad/s violates .* no (measurement|control)"):
        design.multiobjective(random_plant(), 2, 2, [hinf_bound(outputs=("e1",), output_weight=slow), REGION[0]])


def test_an_h2_norm_that_no_controller_makes_finite_is_named():
    P = random_plant()
    D = P.D.copy()
    D[0, 0] = 1.0
    with pytest.raises(IllPosedError, match="the H2 norm is infinite"):
        design.multiobjective(control.ss(P.A, P.B, P.C, D), 2, 2, [h2_bound()])


@pytest.mark.parametrize(
    ("requirements", "match"),
    [
        ([], "must contain at least one"),
        ([requirement("disk margin", 0.5)], "must be of kind 'H-infinity norm'.* got 'disk margin'"),
        ([requirement("damping", 0.5, hard=False)], "must be hard"),
        ([requirement("damping", 1.5)], "positive number below 1"),
    ],
)
def test_requirements_without_an_inequality_are_refused(requirements, match):
    with pytest.raises(ArgumentError, match=match):
        design.multiobjective(random_plant(), 2, 2, requirements)


# ---------------------------------------------------------------------------------------------------------------------
# Polytopes


def spring(stiffness, lag=0.1):
    """A mass on a spring behind an actuator's lag: w = [force, noise], z = [position, effort]."""
    A = [[0, 1, 0], [-stiffness, -0.2, 1], [0, 0, -1 / lag]]
    B = [[0, 0, 0], [1, 0, 0], [0, 0, 1 / lag]]
    C = [[1, 0, 0], [0, 0, 0], [1, 0, 0]]
    return control.ss(A, B, C, [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]], inputs=["d", "n", "u"], outputs=["e", "c", "y"])


def by_stiffness(rho):
    return spring(float(rho[0]))


def test_a_box_of_one_point_gives_the_ordinary_design():
    result = design.scheduled(by_stiffness, ["stiffness"], [1.0], [1.0], 1, 1)
    one = design.hinf(spring(1.0), 1, 1, method="lmi")
    assert result.gamma_optimal == pytest.approx(one.level / (1 + one.backoff), rel=1e-6)
    assert result.gamma_optimal >= one.gamma_optimal
    assert len(result.controllers) == 1


def test_scheduling_costs_little_against_the_frozen_designs_and_is_proved():
    result = design.scheduled(by_stiffness, ["stiffness"], [0.5], [2.0], 1, 1)
    frozen = max(design.hinf(spring(k), 1, 1, method="riccati").gamma_optimal for k in (0.5, 2.0))
    assert frozen * (1 - 1e-4) <= result.gamma_optimal
    assert max(result.norms) <= result.gamma
    assert result.certificate.verify().proved
    # The matrix does not prove a norm that is not there.
    X = result.certificate.X
    worse = type(result.certificate)(claim="norm", bound=0.9 * frozen, loops=result.certificate.loops, X=X)
    assert not worse.verify().proved


def test_along_a_fast_motion_energy_is_bounded_by_gamma():
    result = design.scheduled(by_stiffness, ["stiffness"], [0.5], [2.0], 1, 1)
    X, gamma = result.lyapunov, result.gamma
    rng = np.random.default_rng(1)
    step, steps = 2e-3, 8000
    x, energy_w, energy_z, worst = np.zeros(6), 0.0, 0.0, 0.0
    loops = [
        closed_loop(partition(p, 1, 1), StateArrays(A=K.A, B=K.B, C=K.C, D=K.D))
        for p, K in ((spring(k), result.at([k])) for k in (0.5, 0.9, 1.4, 2.0))
    ]
    w = np.zeros(2)
    for k in range(steps):
        # Jumps of the stiffness, and the disturbance that the storage function finds worst.
        if k % 50 == 0:
            loop = loops[rng.integers(4)]
        z = loop.C @ x + loop.D @ w
        rate = loop.A @ x + loop.B @ w
        supply = gamma**2 * w @ w - z @ z
        worst = max(worst, 2 * x @ X @ rate - supply)
        energy_w, energy_z = energy_w + step * w @ w, energy_z + step * z @ z
        x = x + step * rate
        w = loop.B.T @ X @ x / gamma**2 + 0.05 * rng.normal(size=2)
    assert energy_w > 0.1
    assert energy_z < gamma**2 * energy_w
    assert worst <= 1e-9


def test_what_u_drives_must_not_depend_on_the_parameters():
    def plant(rho):
        P = spring(1.0)
        B = P.B.copy()
        B[2, 2] = rho[0]
        return control.ss(P.A, B, P.C, P.D, inputs=P.input_labels, outputs=P.output_labels)

    with pytest.raises(IllPosedError, match=r"B2 must not depend .* for control 'u'; put a lag"):
        design.scheduled(plant, ["gain"], [1.0], [2.0], 1, 1)


def test_a_plant_that_is_not_affine_is_refused():
    with pytest.raises(ArgumentError, match="A of the plant must be affine in Omega2"):
        design.scheduled(lambda rho: spring(float(rho[0] ** 2)), ["Omega2"], [0.5], [2.0], 1, 1)


def test_parameters_outside_the_box_are_refused():
    result = design.scheduled(by_stiffness, ["Omega2"], [0.5], [2.0], 1, 1)
    np.testing.assert_allclose(result.controller((0, 0.5, 0)).A, result.controllers[0].A)
    with pytest.raises(ArgumentError, match=r"Omega2 must be within \[0\.5, 2\], got 3"):
        result.at([3.0])


def test_state_feedback_for_two_plants_is_the_best_that_one_matrix_allows():
    def plant(stiffness, noise=0.0):
        P = spring(stiffness)
        B = np.hstack([P.B[:, :1], np.zeros((3, 3)), P.B[:, 2:]])
        D = np.zeros((5, 5))
        D[1, 4], D[2:, 1:4] = 0.1, noise * np.eye(3)
        return control.ss(P.A, B, np.vstack([P.C[:2], np.eye(3)]), D)

    one = design.robust([plant(1.0)], 3, 1, [hinf_bound()])
    both = design.robust([plant(0.5), plant(2.0)], 3, 1, [hinf_bound(), requirement("damping", 0.5)])
    assert one.controller.nstates == both.controller.nstates == 0
    # Measuring the state with next to no noise is as good as knowing it.
    least = design.hinf(plant(1.0, 1e-5), 3, 1, method="riccati").gamma_optimal
    assert one.ratio == pytest.approx(1.05 * least, rel=1e-3)
    assert both.ratio >= one.ratio * 0.999
    assert all(outcome.ratio <= 1.001 for outcomes in both.outcomes for outcome in outcomes if outcome.hard)
    assert both.certificate.verify().proved


def test_one_output_feedback_serves_both_ends_and_what_is_between():
    result = design.robust([spring(0.5), spring(2.0)], 1, 1, [hinf_bound(), requirement("stability", 0.05)])
    K = StateArrays(**{name: getattr(result.controller, name) for name in "ABCD"})
    for stiffness in (0.5, 1.0, 1.7, 2.0):
        loop = closed_loop(partition(spring(stiffness), 1, 1), K)
        assert hinf_norm(control.ss(loop.A, loop.B, loop.C, loop.D))[0] <= result.ratio
    assert result.certificate.verify().proved
    scheduled = design.scheduled(by_stiffness, ["stiffness"], [0.5], [2.0], 1, 1)
    # Not knowing the stiffness cannot help.
    assert result.ratio >= scheduled.gamma_optimal


def test_plants_too_far_apart_for_one_matrix_are_infeasible():
    with pytest.raises(InfeasibleError, match=r"of the way from their mean|one Lyapunov matrix"):
        design.robust([spring(-4.0), spring(200.0)], 1, 1, [hinf_bound(0.1, hard=True)])


def test_a_caging_loop_follows_omega_for_little():
    platform = read_platform("three_gyro_platform")
    caging = design.scheduled_caging(platform, ("9", "10"), Omega_max=(5, 5, 5), bandwidth_hz=40, terms="paper")
    assert caging.scheduled.box.names == ("Omega2",)
    assert -1e-4 < caging.price < 0.012
    assert caging.scheduled.certificate.verify().proved
    model = parameter_varying(platform, gimbals=("9", "10"), form="momenta", terms="paper")
    for Omega in ((0, 0, 0), (5, -5, 2), (0, 5, 0)):
        K, G = caging.controller(Omega), model.state_space(Omega)[["alpha9", "beta10"], ["Q9", "Q10"]]
        A = np.block([[G.A + G.B @ K.D @ G.C, G.B @ K.C], [K.B @ G.C, K.A]])
        assert np.linalg.eigvals(A).real.max() < -10
        assert K.input_labels == ["alpha9", "beta10"]
        # Integral action: no standing angle.
        assert np.abs(K.poles()).min() < 1e-6
    with pytest.raises(ArgumentError, match=r"must be at most \[5\.0, 5\.0, 5\.0\] rad/s"):
        caging.controller((0, 6, 0))


def test_lists_are_expected_where_single_things_are_given():
    H = requirement("H-infinity norm", 1.0, hard=False)
    P = spring(1.0)
    with pytest.raises(ArgumentError, match="must be a sequence, each a LoopRequirement, got a LoopRequirement"):
        design.multiobjective(P, 1, 1, H)
    with pytest.raises(ArgumentError, match="plants must be a sequence, each a StateSpace, got a StateSpace"):
        design.robust(P, 1, 1, [H])
    for names in ("k", ["k", "k"], []):
        with pytest.raises(ArgumentError, match=r"names must be a (list of different names|sequence)"):
            design.scheduled(lambda rho: P, names, [0.5] * len(names), [1.0] * len(names), 1, 1)
