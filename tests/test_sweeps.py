"""Long sweeps, `pytest -m slow`: the statements of the short tests on many more platforms, and the spread in time."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from platform_ctrl import design
from platform_ctrl.design.cases import cases
from platform_ctrl.design.methods import read_job
from platform_ctrl.mechanics.equations import forward_dynamics, inverse_dynamics
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.matrices import matrices
from platform_ctrl.simulation import rollout
from single_runs import simulated
from tree_cases import platforms

pytestmark = pytest.mark.slow

long = settings(max_examples=2000, deadline=None, suppress_health_check=list(HealthCheck))


@long
@given(platforms(max_gimbals=8, max_rotors=4), st.integers(0, 2**32 - 1))
def test_both_routes_to_the_equations_agree(platform, seed):
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    q, u, u_dot = rng.uniform(-3, 3, n), 3 * rng.normal(size=3 + n), 10 * rng.normal(size=3 + n)
    m = matrices(platform, q, u)
    ours = m.A_star @ u_dot + (m.G_A + m.G_R + m.G_root) @ u
    recursion = inverse_dynamics(platform, q, u, u_dot)
    np.testing.assert_allclose(ours, recursion, atol=1e-10 * (1 + np.abs(recursion).max()))
    again = inverse_dynamics(platform, q, u, forward_dynamics(platform, q, u, recursion))
    np.testing.assert_allclose(again, recursion, atol=1e-8 * (1 + np.abs(recursion).max()))


@settings(long, max_examples=200)
@given(platforms(max_gimbals=6), st.integers(0, 2**32 - 1))
def test_free_motion_keeps_energy_and_momentum(platform, seed):
    """Fourth order: T2 drifts by little over 2000 steps that resolve the fastest motion."""
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    q, u = rng.uniform(-1, 1, n), 0.3 * rng.normal(size=3 + n)
    model = linearise(platform, Omega=u[:3], q=q)
    fastest = np.abs(np.linalg.eigvals(np.linalg.solve(model.M, model.G))).max() + 10.0
    out = rollout(platform, q[None], u[None], step=0.02 / fastest, steps=2000)

    def energy(q, u):
        return 0.5 * u @ matrices(platform, q).A_star @ u

    before, after = energy(q, u), energy(out.q[0], out.velocity[0])
    assert after == pytest.approx(before, rel=1e-5)


def test_every_corner_of_the_spread_flies():
    """9-10 and 4-5-7 in every corner: the non-linear caged platform holds a tilted gimbal and comes to rest."""
    job = read_job("examples/three_gyro_platform.toml")
    controllers = [outcome.closed.controller for outcome in design.loops(job)]
    for outcome in job.loops[:2]:
        for case in cases(job, outcome.gimbals):
            run = simulated(
                case.platform,
                controllers[:2],
                period=job.sampling.period,
                delay=job.sampling.delay,
                duration=1.0,
                mode="caged",
                noise=False,
                q=np.full(5, 1e-4),
            )
            assert run.completed, case.label
            assert np.abs(run.q[-1]).max() < 1e-6, case.label
