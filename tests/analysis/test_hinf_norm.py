"""The H-infinity norm where it is hard, against gains around every pole and where `control.linfnorm` goes wrong."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from scipy.linalg import block_diag

from platform_ctrl import PlatformCtrlError, analysis

TOLERANCE = 1e-8


def modal(
    seed: int,
    modes: int,
    rates: tuple[float, float],
    damping: tuple[float, float],
    rotation: float = 0.0,
    spread: float = 0.0,
    ports: float = 0.0,
    direct: float = 0.0,
) -> control.StateSpace:
    """Return modes; rates, damping, and the scales of states and ports are drawn as powers of ten."""
    rng = np.random.default_rng(seed)
    blocks, inputs, outputs = [], [], []
    for _ in range(modes):
        w = 10.0 ** rng.uniform(*rates)
        if rng.random() < 0.3:
            blocks.append(np.array([[-w]]))
            inputs.append(rng.normal(size=(1, 2)) * w)
            outputs.append(rng.normal(size=(2, 1)) * 10.0 ** rng.uniform(-3.0, 3.0))
            continue
        zeta = 10.0 ** rng.uniform(*damping)
        blocks.append(np.array([[0.0, w], [-w, -2.0 * zeta * w]]))
        inputs.append(np.vstack([np.zeros((1, 2)), rng.normal(size=(1, 2)) * w]))
        outputs.append(rng.normal(size=(2, 2)) * 10.0 ** rng.uniform(-3.0, 3.0) * zeta)
    A, B, C = block_diag(*blocks), np.vstack(inputs), np.hstack(outputs)
    n = len(A)
    if rotation:
        w = np.abs(A).max(axis=1)
        # States mix where their rates are alike: otherwise slow ones would be lost in fast ones.
        share = np.sqrt(np.minimum(w[:, None] / w, w / w[:, None])) * (rng.random((n, n)) < 0.3)
        T = np.eye(n) + rotation * rng.normal(size=(n, n)) * share
        A, B, C = T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T)
    s = 10.0 ** rng.uniform(-spread, spread, n)
    A, B, C = A * s[:, None] / s, B * s[:, None], C / s
    B, C = B * 10.0 ** rng.uniform(-ports, ports, 2), C * 10.0 ** rng.uniform(-ports, ports, 2)[:, None]
    return control.ss(A, B, C, direct * rng.normal(size=(2, 2)), 0)


def sampled_modes(seed: int, closest: float) -> control.StateSpace:
    """Return poles inside the unit circle by 10^closest and more, at 1, at -1 and in between."""
    rng = np.random.default_rng(seed)
    blocks = []
    for _ in range(4):
        radius, kind = 1.0 - 10.0 ** rng.uniform(closest, -1.0), rng.integers(3)
        angle = (0.0, math.pi, rng.uniform(0.0, math.pi))[kind]
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        blocks.append(radius * (turn if kind == 2 else turn[:1, :1]))
    A = block_diag(*blocks)
    n = len(A)
    T = np.eye(n) + 0.1 * np.triu(rng.normal(size=(n, n)), 1)
    A = T @ A @ np.linalg.inv(T)
    period = 10.0 ** rng.uniform(-4.0, 1.0)
    return control.ss(A, rng.normal(size=(n, 2)), rng.normal(size=(2, n)), rng.normal(size=(2, 2)), period)


HARD = {
    "poles from 1e-3 to 1e9 rad/s": lambda seed: modal(seed, 4, (-3, 9), (-2, 0)),
    "the same in mixed states": lambda seed: modal(seed, 4, (-3, 9), (-2, 0), rotation=0.5),
    "lightly damped among them": lambda seed: modal(seed, 4, (-3, 9), (-9, -1)),
    "lightly damped, mixed states": lambda seed: modal(seed, 4, (-3, 9), (-6, -1), rotation=0.3),
    "states out of scale": lambda seed: modal(seed, 4, (-3, 9), (-4, 0), spread=8.0),
    "ports out of scale": lambda seed: modal(seed, 4, (0, 3), (-4, 0), spread=6.0, ports=8.0),
    "a large direct term": lambda seed: modal(seed, 4, (0, 3), (-2, 0), direct=1e5),
    "needles of damping 1e-9": lambda seed: modal(seed, 3, (0, 3), (-9, -8.9)),
    "sampled, poles next to the circle": lambda seed: sampled_modes(seed, -9.0),
}


def assert_norm(system: control.StateSpace, norm: float, frequency: float) -> None:
    """No gain is above it at any distance from any pole, and the response reaches it where it says."""
    s = np.log(system.poles().astype(complex)) / system.dt if system.dt else system.poles()
    steps = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 200)])
    near = np.abs(s.imag)[:, None] + np.outer(np.abs(s.real), np.concatenate([-steps, steps]))
    w = np.unique(near[(near >= 0.0) & (near <= (math.pi / system.dt if system.dt else math.inf))])
    gains = np.linalg.norm(np.moveaxis(analysis.frequency_response(system, w), -1, 0), 2, axis=(1, 2))
    assert gains.max() <= norm * (1.0 + TOLERANCE)
    at = system.D if math.isinf(frequency) else analysis.frequency_response(system, frequency)[:, :, 0]
    assert np.linalg.norm(at, 2) == pytest.approx(norm, rel=1e-10)


@pytest.mark.parametrize("kind", HARD)
@pytest.mark.parametrize("seed", range(2))
def test_hard_systems_have_the_norm_that_no_gain_around_their_poles_exceeds(kind: str, seed: int) -> None:
    system = HARD[kind](seed)
    assert_norm(system, *analysis.hinf_norm(system))


@pytest.mark.parametrize(("zeta", "w"), [(1e-8, 1.0), (1e-7, 1e-2), (1e-5, 1e-3)])
def test_a_damped_mode_beside_a_fast_lag_has_a_finite_norm_which_linfnorm_calls_infinite(zeta: float, w: float) -> None:
    # AB13DD takes a pole for one on the axis once its real part is below rounding of the norm of A, here 1e9 rad/s.
    A = block_diag([[0.0, w], [-w, -2.0 * zeta * w]], [[-1e9]])
    system = control.ss(A, [[0.0], [2.0 * zeta * w], [1e9]], [[1.0, 0.0, 1e-3]], 0)
    norm, frequency = analysis.hinf_norm(system)
    assert_norm(system, norm, frequency)
    # The mode's peak, 1, and the lag's 1e-3 beside it, which stands at right angles.
    assert norm == pytest.approx(math.hypot(1.0, 1e-3) + 5e-7, abs=2e-6)
    pytest.importorskip("slycot")
    assert control.linfnorm(system)[0] == math.inf


def test_two_equal_peaks_and_peaks_at_the_ends_are_found() -> None:
    def mode(w: float, zeta: float) -> np.ndarray:
        return np.array([[0.0, w], [-w, -2.0 * zeta * w]])

    A = block_diag(mode(1.0, 0.01), mode(100.0, 0.01))
    twins = control.ss(A, np.kron(np.eye(2), [[0.0], [1.0]]) * [1.0, 100.0], np.kron(np.eye(2), [1.0, 0.0]), 0)
    norm, frequency = analysis.hinf_norm(twins)
    assert norm == pytest.approx(1.0 / (0.02 * math.sqrt(1.0 - 1e-4)), rel=1e-12)
    assert min(abs(frequency - 1.0), abs(frequency / 100.0 - 1.0)) < 1e-3
    assert analysis.hinf_norm(control.ss([[-2.0]], [[1.0]], [[6.0]], 0)) == pytest.approx((3.0, 0.0))
    assert analysis.hinf_norm(control.ss([[-2.0]], [[1.0]], [[-6.0]], 4.0)) == (4.0, math.inf)
    for pole, expected in ((0.5, 0.0), (-0.5, math.pi / 0.1)):
        assert analysis.hinf_norm(control.ss([[pole]], [[1.0]], [[1.0]], 0, 0.1)) == pytest.approx((2.0, expected))


@pytest.mark.parametrize("height", [1e-6, 1e-9, 1e-12])
def test_a_small_hill_on_a_large_direct_term_is_seen(height: float) -> None:
    A = np.array([[0.0, 1.0], [-1.0, -0.2]])
    system = control.ss(A, [[0.0], [1.0]], [[0.0, 0.2 * height]], 1.0)
    norm, frequency = analysis.hinf_norm(system)
    assert norm - 1.0 == pytest.approx(height, rel=1e-3)
    assert frequency == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("A", "dt", "frequency"),
    [
        (np.zeros((1, 1)), 0.0, 0.0),
        (np.array([[0.0, 3.0], [-3.0, 0.0]]), 0.0, 3.0),
        (np.eye(1), 0.1, 0.0),
        (-np.eye(1), 0.1, math.pi / 0.1),
        (np.array([[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]]), 0.1, 3.0),
    ],
)
@pytest.mark.parametrize("seed", range(1))
def test_a_pole_on_the_boundary_gives_an_infinite_norm_at_its_frequency(
    A: np.ndarray, dt: float, frequency: float, seed: int
) -> None:
    rest = np.diag([0.5, -0.3]) if dt else np.diag([-1.0, -20.0])
    whole = block_diag(A, rest)
    n = len(whole)
    # Rotated: the pole is on the boundary to rounding only.
    T = np.random.default_rng(seed).normal(size=(n, n)) + 2.0 * np.eye(n)
    system = control.ss(T @ whole @ np.linalg.inv(T), np.ones((n, 1)), np.ones((1, n)), 0, dt)
    norm, at = analysis.hinf_norm(system)
    assert norm == math.inf
    assert at == pytest.approx(frequency, abs=1e-6)


def test_a_slow_unstable_pole_beside_a_fast_stable_one_is_told() -> None:
    system = control.ss(np.diag([1e-6, -1e9]), np.ones((2, 1)), np.ones((1, 2)), 0)
    with pytest.raises(PlatformCtrlError, match=r"pole at s = 1e-06"):
        analysis.hinf_norm(system)
    assert analysis.hinf_norm(system, allow_unstable=True) == pytest.approx((1e6, 0.0), rel=1e-9)


def test_a_gain_that_is_the_same_everywhere_is_found_by_eigenvalues() -> None:
    # Nowhere is it below the level: nothing but eigenvalues tells that it is not above.
    product = control.ss([], [], [], [[2.0]])
    for w, zeta in ((1.0, 0.1), (30.0, 0.5), (31.0, 0.02)):
        A = [[0.0, w], [-w, -2.0 * zeta * w]]
        product = product * control.ss(A, [[0.0], [1.0]], [[0.0, -4.0 * zeta * w]], 1.0)
    assert analysis.hinf_norm(product)[0] == pytest.approx(2.0, abs=1e-11)
