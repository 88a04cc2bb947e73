"""Systems that take turns: norms and states over a cycle, against the stacked matrices of all its samples."""

from __future__ import annotations

import control
import numpy as np
import pytest

from platform_ctrl.analysis import h2_norm, hinf_norm
from platform_ctrl.analysis.interconnection import interconnected_by_sample
from platform_ctrl.analysis.periodic import PeriodicLoop, lifted, periodic_norm, pruned, transition
from platform_ctrl.analysis.sampling import late_outputs
from platform_ctrl.analysis.system import System

T = 0.01
# Angle and rate of a body that a torque turns, against a little friction.
BODY = System(
    np.array([[1.0, 0.00995], [0.0, 0.99]]), np.array([[5e-5], [0.00995]]), np.eye(2), np.zeros((2, 1)), T
)  # fmt: skip
# A loop on the rate at every sample; around it one on the angle, with an integral, at every n-th.
INNER = control.ss(0.9, [[0.4, -0.4]], -2.0, [[-8.0, 8.0]], T, inputs=["rate", "rate_command"], outputs=["torque"])


def outer(n: int) -> control.StateSpace:
    slow = 1.0 / (n * T)
    return control.ss(1.0, 0.05, -0.2 * slow, -0.2 * slow, n * T, inputs=["angle"], outputs=["rate_command"])


def cascade(n: int, late: int = 0) -> PeriodicLoop:
    by_sample = interconnected_by_sample([outer(n), INNER], ["angle", "rate"], ["torque"], T)
    return PeriodicLoop(late_outputs(BODY, [late, 0]), by_sample, [0], [0, 1])


def taking_turns(seed: int, N: int, n: int, m: int) -> list[System]:
    """Stable systems of two kinds in some order, each object several times."""
    generator = np.random.default_rng(seed)

    def one() -> System:
        A = generator.normal(size=(n, n))
        A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
        B, C, D = generator.normal(size=(n, m)), generator.normal(size=(m, n)), generator.normal(size=(m, m))
        return System(A, B, C, D, T)

    kinds = [one(), one()]
    while True:
        systems = [kinds[k] for k in generator.integers(0, 2, N)]
        if np.abs(np.linalg.eigvals(transition(systems))).max() < 0.95:
            return systems


@pytest.mark.parametrize(("N", "n", "m"), [(1, 3, 2), (2, 1, 1), (5, 4, 1), (7, 3, 3), (12, 6, 2)])
def test_the_norm_is_that_of_the_stacked_system(N: int, n: int, m: int) -> None:
    for seed in range(3):
        systems = taking_turns(seed, N, n, m)
        stacked = hinf_norm(lifted(systems))[0]
        assert periodic_norm(systems) == pytest.approx(stacked, rel=5e-9)


@pytest.mark.parametrize(("n", "late"), [(4, 0), (6, 3), (5, 12), (30, 17)])
def test_a_late_reading_costs_no_more_states_than_are_going_to_be_read(n: int, late: int) -> None:
    """Margin, noise and poles are those of the stacked system, in which every sample on its way is a state."""
    loop = cascade(n, late)
    by_sample = interconnected_by_sample([outer(n), INNER], ["angle", "rate"], ["torque"], T)
    plant = late_outputs(BODY, [late, 0])
    whole = [plant.feedback(K) for K in by_sample]
    assert loop.decay > 0.0
    np.testing.assert_allclose(np.abs(loop.poles).max(), np.abs(np.linalg.eigvals(lifted(whole).A)).max(), rtol=1e-9)
    every = max(len(one.A.T) for one in loop.systems)
    assert every <= 2 + 3 + -(-late // n)
    disk = lifted([one.part([0], [0])._replace(D=np.array([[0.5]])) for one in whole])
    assert loop.loop_margins()[0] == pytest.approx(1.0 / hinf_norm(disk)[0], rel=1e-8)
    rms = np.array([1e-3, 2e-2])
    noisy = lifted([one.part([0], [1, 2])._replace(B=one.B[:, 1:] * rms, D=one.D[:1, 1:] * rms) for one in whole])
    (made,) = loop.noise_to_torque(rms)
    assert h2_norm(made) == pytest.approx(h2_norm(noisy) / np.sqrt(n), rel=1e-9)


def test_a_part_that_lasts_is_not_left_out_because_no_output_shows_it() -> None:
    """A body that falls over beside the loop, and a reading of it that nobody takes."""
    A = np.zeros((4, 4))
    A[0, 0], A[1, 1], A[1, 2], A[2, 1], A[3, 2] = 0.5, 1.1, 0.1, 0.1, 1.0
    one = System(A, np.eye(4)[:, :1], np.eye(4)[:1], np.zeros((1, 1)), T)
    kept = pruned([one, one, one])
    assert np.abs(np.linalg.eigvals(transition(kept))).max() > 1.3
    np.testing.assert_allclose(lifted(kept).D, lifted([one] * 3).D, rtol=0.0, atol=1e-15)


def test_rates_that_do_not_divide_one_another_repeat_after_their_common_multiple() -> None:
    """Two controllers at every second and third sample, in an order of their own at each of six samples."""
    generator = np.random.default_rng(3)
    parts = []
    for k, n in enumerate((2, 3)):
        A, B, C = generator.normal(size=(2, 2)) * 0.3, generator.normal(size=(2, 1)), generator.normal(size=(1, 2))
        names = {"inputs": [f"y{k + 1}"], "outputs": [f"u{k + 1}"]}
        parts.append(control.ss(A, B, C, [[0.1]], n * T, **names))
    by_sample = interconnected_by_sample(parts, ["y1", "y2"], ["u1", "u2"], T)
    assert len(by_sample) == 6
    assert len({id(one) for one in by_sample}) == 4
    x, states, u = np.zeros(len(by_sample[0].A)), [np.zeros(2), np.zeros(2)], np.zeros(2)
    for k, y in enumerate(generator.normal(size=(30, 2))):
        for j, (one, n) in enumerate(zip(parts, (2, 3), strict=True)):
            if k % n == 0:
                u[j] = (one.C @ states[j])[0] + 0.1 * y[j]
                states[j] = one.A @ states[j] + one.B[:, 0] * y[j]
        K = by_sample[k % 6]
        np.testing.assert_allclose(K.C @ x + K.D @ y, u, rtol=0.0, atol=1e-12)
        x = K.A @ x + K.B @ y
