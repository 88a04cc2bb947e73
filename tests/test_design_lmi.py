"""Matrix inequalities: the solver in its process, and designs against Riccati routes, closed forms and simulation."""

from __future__ import annotations

import _thread
import threading
import time

import cvxpy as cp
import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from platform_ctrl.design.lmi import conic
from platform_ctrl.errors import InfeasibleError, TimeLimitError, UnscalableError


def lyapunov_problem(n=4, sign=1.0):
    A = np.random.default_rng(n).normal(size=(n, n)) - 4 * np.eye(n)
    X = cp.Variable((n, n), symmetric=True)
    inequality = sign * (A @ X + X @ A.T) << -np.eye(n)
    return cp.Problem(cp.Minimize(cp.trace(X)), [inequality, X >> 0]), X, A


def solve(problem, X, **options):
    return conic.solve(problem, (X,), what="test", P=problem, **({"time_limit": 30.0} | options))


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
    old = conic._shared.worker.process
    start = time.monotonic()
    with pytest.raises(TimeLimitError, match=r"did not finish in 0\.3 s") as refused:
        solve(problem, X, time_limit=0.3, wait=60.0)
    assert time.monotonic() - start < 10
    assert refused.value.problem is problem
    assert old.poll() is not None
    assert solve(problem, X).status == "Solved"
    assert conic._shared.worker.process.pid != old.pid


def test_a_worker_that_died_is_replaced_once():
    problem, X, _ = lyapunov_problem()
    solve(problem, X)
    conic._shared.worker.process.kill()
    assert solve(problem, X).status == "Solved"


def test_a_worker_that_cannot_run_is_an_error_and_not_a_hang(monkeypatch):
    problem, X, _ = lyapunov_problem()
    conic._shared.end()
    monkeypatch.setattr(conic.inspect, "getsource", lambda module: "raise SystemExit(3)")
    with pytest.raises(UnscalableError, match="process died 2 times"):
        solve(problem, X)


def test_an_interrupt_ends_the_solver_at_once():
    problem, X, _ = lyapunov_problem()
    solve(problem, X)
    old = conic._shared.worker.process
    timer = threading.Timer(0.3, _thread.interrupt_main)
    start = time.monotonic()
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        solve(problem, X, wait=60.0)
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


def test_contradicting_and_unbounded_problems_speak():
    problem, X, _ = lyapunov_problem(sign=-1.0)
    with pytest.raises(InfeasibleError, match="test: the solver says infeasible") as refused:
        solve(problem, X)
    assert refused.value.problem is problem
    X = cp.Variable((2, 2), symmetric=True)
    with pytest.raises(UnscalableError, match="DualInfeasible"):
        solve(cp.Problem(cp.Maximize(cp.trace(X)), [X >> 0]), X)
