"""Budgets of sampled loops, against covariances over a period, exact steady states and identities of physics."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import control
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov

from platform_ctrl.analysis.budget_integrals import motion_transfer, window_shares
from platform_ctrl.analysis.hybrid_plant import (
    Density,
    HybridPlant,
    RandomDisturbance,
    SampleNoise,
    SineDisturbance,
)
from platform_ctrl.analysis.interconnection import interconnected_at_rates, interconnected_by_sample
from platform_ctrl.analysis.jitter_budget import JitterBudget
from platform_ctrl.analysis.sampling import held_input
from platform_ctrl.analysis.system import System
from platform_ctrl.errors import ArgumentError

PERIOD = 0.7
K = System(np.array([[0.5]]), np.array([[1.0]]), np.array([[-0.3]]), np.array([[-0.5]]), PERIOD)
# White noise of two-sided density one behind five poles.
SHAPE = control.tf([1.0], [1.0, 1.0, 1.0]) * control.tf([1.0], [0.25, 1.0]) * control.tf([1.0], [0.2, 1.0])
KNOTS = np.array([0.0, 0.5, 1.0, 2.0, 5.0, 20.0, 300.0])


def shaped(gain: float = 1.0) -> Density:
    return Density(knots=KNOTS, density=lambda w: 2.0 * gain * np.abs(SHAPE(1j * w)) ** 2)


def oscillator(direct: float = 0.0, **changes: object) -> HybridPlant:
    """Inputs: control, disturbance, another one; outputs: measured position, then position and rate."""
    A = np.array([[0.0, 1.0, 0.0], [-4.0, -0.3, 1.0], [0.0, 0.0, -3.0]])
    B = np.array([[0.0, 0.0, 0.2], [0.0, 1.0, -0.5], [1.0, 0.0, 0.0]])
    C = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    D = np.zeros((3, 3))
    # The rate is the derivative of the position whatever drives it.
    D[0, 1], D[2, 2] = direct, 0.2
    given = {"plant": System(A, B, C, D), "controls": 1, "measured": 1, "period": PERIOD, "delay": 0.25 * PERIOD}
    return HybridPlant(**(given | changes))  # type: ignore[arg-type]


def noise(name: str = "torque", at: int = 0, gain: float = 1.0) -> RandomDisturbance:
    return RandomDisturbance(name=name, inputs=(at,), spectra=(shaped(gain),))


def test_the_integral_of_a_rate_is_the_angle() -> None:
    found = JitterBudget(oscillator(integrated=(False, True)), [noise(), noise("base", 1)]).of(K, 1e-9)
    assert found.rms[:, 1] == pytest.approx(found.rms[:, 0], rel=1e-9)
    assert found.total == pytest.approx(np.sqrt(np.sum(found.rms**2, axis=0)), rel=1e-12)
    assert found.remaining < 1e-9


def test_correlated_sources_are_their_sum_and_difference() -> None:
    def rms(rho: complex) -> np.ndarray:
        coherence = np.array([[1.0, rho], [np.conj(rho), 1.0]])
        both = RandomDisturbance(name="base", inputs=(0, 1), spectra=(shaped(),) * 2, coherence=coherence)
        return JitterBudget(oscillator(), [both]).of(K, 1e-9).total

    apart = JitterBudget(oscillator(), [noise("a", 0), noise("b", 1)]).of(K, 1e-9).total
    assert rms(0.0) == pytest.approx(apart, rel=1e-9)
    assert 0.8 * rms(1.0) ** 2 + 0.2 * rms(-1.0) ** 2 == pytest.approx(rms(0.6) ** 2, rel=1e-9)
    # One input that does the work of both.
    A, B, C, D, _ = oscillator().plant
    joined = System(A, np.column_stack([B[:, 0], B[:, 1] + B[:, 2]]), C, np.column_stack([D[:, 0], D[:, 1] + D[:, 2]]))
    one = JitterBudget(oscillator(plant=joined), [noise()]).of(K, 1e-9).total
    assert rms(1.0) == pytest.approx(one, rel=1e-9)
    assert np.all(np.abs(rms(0.5j) / rms(-0.5j) - 1.0) > 1e-3)


def test_sines_of_one_frequency_add_as_their_phases_say() -> None:
    def sine(name: str, phase: float | None) -> SineDisturbance:
        given = None if phase is None else np.array([phase])
        return SineDisturbance(name=name, inputs=(0,), frequency=3.0, amplitude=np.array([0.2]), phase=given)

    plant = oscillator()
    alone = JitterBudget(plant, [sine("a", 0.0)]).of(K).total
    assert JitterBudget(plant, [sine("a", 0.0), sine("b", math.pi)]).of(K).total == pytest.approx(0.0, abs=1e-8)
    assert JitterBudget(plant, [sine("a", 0.1), sine("b", 0.1)]).of(K).total == pytest.approx(2.0 * alone, rel=1e-12)
    apart = JitterBudget(plant, [sine("a", None), sine("b", None)]).of(K)
    assert apart.total == pytest.approx(math.sqrt(2.0) * alone, rel=1e-12)
    assert apart.rms**2 / apart.total**2 == pytest.approx(np.full((2, 2), 0.5), rel=1e-12)


def stabilised(**changes: object) -> tuple[HybridPlant, System]:
    """A gyro holds an inertial rate; the angle against the base is an integral that nothing depends on."""
    # States: the relative angle, the inertial rate. Inputs: torque, torque disturbance, base rate.
    A, B = np.array([[0.0, 1.0], [0.0, -0.1]]), np.array([[0.0, 0.0, -1.0], [1.0, 1.0, 0.1]])
    C = np.array([[0.0, 1.0], [0.0, 1.0]])
    given = {"plant": System(A, B, C, np.zeros((2, 3))), "controls": 1, "measured": 1, "period": 0.01}
    plant = HybridPlant(**(given | {"integrated": (True,)} | changes))  # type: ignore[arg-type]
    return plant, System(np.eye(1), np.eye(1), np.array([[-1.0]]), np.array([[-20.0]]), 0.01)


def test_an_angle_held_by_a_noisy_gyro_walks() -> None:
    plant, controller = stabilised()
    gyro = SampleNoise(name="gyro", measured=0, rms=1e-3)
    lowest = 1e-3
    found = JitterBudget(plant, [gyro], (0.02,), lowest).of(controller)
    # Density 2 T σ²/ω² of an angle random walk.
    assert found.total[0] ** 2 == pytest.approx(0.01 * 1e-6 / (math.pi * lowest), rel=1e-3)
    assert found.windows[0].jitter[0] < 1e-2 * found.total[0]
    with pytest.raises(ArgumentError, match="without bound"):
        JitterBudget(plant, [gyro]).of(controller)


def test_an_unseen_integral_is_no_instability_and_a_seen_one_is() -> None:
    plant, controller = stabilised()
    assert np.abs(JitterBudget(plant, []).open_loop.closed_poles(controller)).max() >= 1.0 - 1e-9
    A, B, C, D, _ = plant.plant
    seen = np.array([C[0], [1.0, 0.0]])
    for unstable in (
        dataclasses.replace(plant, plant=System(A, B, seen, D)),
        dataclasses.replace(plant, delay=0.1),
    ):
        with pytest.raises(ArgumentError, match="must be stable"):
            JitterBudget(unstable, []).of(controller)


@pytest.fixture(scope="module")
def budget() -> Any:
    sources = [noise(), noise("base", 1), SampleNoise(name="gyro", measured=0, rms=0.1)]
    sine = SineDisturbance(name="motor", inputs=(0,), frequency=6.0, amplitude=np.array([0.3]))
    return JitterBudget(oscillator(), [*sources, sine], (0.4, 3.0)).of(K, 1e-8)


def test_the_cumulative_variance_rises_to_the_total(budget: Any) -> None:
    assert np.all(np.diff(budget.cumulative) >= 0.0)
    # The position's images beyond those that are kept are the only difference.
    assert budget.cumulative[..., -1] == pytest.approx(budget.rms**2, rel=1e-5)
    assert budget.total_cumulative[:, -1] - budget.total_cumulative[:, 0] == pytest.approx(budget.total**2, rel=1e-5)
    below = np.searchsorted(budget.edges, 6.0) - 1
    motor = budget.cumulative[3, 0]
    # The first image, at 2 π/T - 6, lies below the sine itself.
    assert 0.0 < motor[below] < 1e-2 * motor[below + 1]


def test_displacement_smear_and_jitter_add_up_to_the_variance(budget: Any) -> None:
    for window in budget.windows:
        parts = window.displacement**2 + window.smear**2 + window.jitter**2
        assert parts == pytest.approx(budget.total**2, rel=1e-9)
    assert np.all(budget.windows[0].jitter < budget.windows[1].jitter)


def taking_turns(*controllers: control.StateSpace) -> tuple[list[System], Any]:
    """Controllers from position and rate to the control at every sample of their cycle, and as one."""
    signals = ["position", "rate"], ["u"], PERIOD
    return interconnected_by_sample(controllers, *signals), interconnected_at_rates(controllers, *signals)


# A loop on the position, with an integrator, at every third sample around one on the rate at every sample.
OUTER = control.ss(1.0, 1.0, -0.04, -0.1, 3 * PERIOD, inputs=["position"], outputs=["rate_command"])
INNER = control.ss(
    0.3, [[0.2, -0.2]], 0.5, [[-0.4, 0.4]], PERIOD, inputs=["rate", "rate_command"], outputs=["u"]
)  # fmt: skip


def cascaded(**changes: object) -> HybridPlant:
    """The oscillator with both position, one sample late, and rate measured."""
    A, B, C, D, _ = oscillator().plant
    rows = [0, 2, 1, 2]
    given = {"plant": System(A, B, C[rows], D[rows]), "measured": 2, "reading_delay": (1, 0), "cycle": 3}
    return oscillator(**(given | changes))


class Stepped:
    """The cascade with a source behind the disturbance, ẋ = F x + G n, w = H x, stepped sample by sample by hand."""

    def __init__(self, F: np.ndarray, G: np.ndarray, H: np.ndarray) -> None:
        by_sample, _ = taking_turns(OUTER, INNER)
        A, B, C, D, _ = cascaded().plant
        f, k = len(F), len(by_sample[0].A)
        self.x, self.held, self.late, self.size = 3 + f, 3 + f, 4 + f, 5 + f + k
        self.A = np.block([[A, B[:, 1:2] @ H], [np.zeros((f, 3)), F]])
        self.B, self.noise = np.vstack([B[:, :1], np.zeros((f, 1))]), np.vstack([np.zeros((3, G.shape[1])), G])
        self.C = np.hstack([C, D[:, 1:2] @ H])
        self.controllers = by_sample
        # Of every sample: the state at its beginning to the control, and to the next beginning.
        self.u, self.steps, self.added = [], [], []
        for K in by_sample:
            seen = np.zeros((2, self.size))
            seen[0, self.late], seen[1, : self.x] = 1.0, self.C[1]
            u = K.D @ seen
            u[:, self.late + 1 :] += K.C
            step = np.zeros((self.size, self.size))
            step[: self.x] = self.between(1.0, u)[0]
            step[self.held], step[self.late, : self.x] = u[0], self.C[0]
            step[self.late + 1 :] = K.B @ seen
            step[self.late + 1 :, self.late + 1 :] += K.A
            # What the noise of both readings adds.
            added = np.zeros((self.size, 2))
            added[: self.x] = held_input(self.A, self.B, 0.75 * PERIOD)[1] @ K.D
            added[self.held], added[self.late + 1 :] = K.D[0], K.B
            self.added.append(added)
            self.u.append(u)
            self.steps.append(step)

    def between(self, part: float, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The plant's state, and what noise has added, after a part of a period; the control acts after a quarter."""
        before = np.eye(1, self.size, self.held)
        phi, gain = held_input(self.A, self.B, min(part, 0.25) * PERIOD)
        x = phi @ np.eye(self.x, self.size) + gain @ before
        if part > 0.25:
            phi, gain = held_input(self.A, self.B, (part - 0.25) * PERIOD)
            x = phi @ x + gain @ u
        n = self.x
        pair = np.block([[-self.A, self.noise @ self.noise.T], [np.zeros((n, n)), self.A.T]])
        power = expm(pair * part * PERIOD)
        return x, power[n:, n:].T @ power[:n, n:]

    def covariances(self, driven: list[np.ndarray]) -> list[np.ndarray]:
        """The periodic covariance at the beginning of each sample, of what each adds until its end."""
        turn, whole = np.eye(self.size), np.zeros((self.size, self.size))
        for step, own in zip(self.steps, driven, strict=True):
            turn, whole = step @ turn, step @ whole @ step.T + own
        out = [solve_discrete_lyapunov(turn, whole)]
        for step, own in zip(self.steps[:-1], driven[:-1], strict=True):
            out.append(step @ out[-1] @ step.T + own)
        return out

    def instants(self) -> list[tuple[int, float, np.ndarray, np.ndarray, np.ndarray]]:
        """Of instants over the cycle: the sample and a weight; z from the state there, its variance by the source's
        noise since, and z from the noise of both readings.
        """
        point, weight = np.polynomial.legendre.leggauss(20)
        out = []
        for k, u in enumerate(self.u):
            for low, high in ((0.0, 0.25), (0.25, 1.0)):
                for t, w in zip(low + 0.5 * (high - low) * (1.0 + point), 0.5 * (high - low) * weight, strict=True):
                    x, noise = self.between(float(t), u)
                    struck = held_input(self.A, self.B, max(float(t) - 0.25, 0.0) * PERIOD)[1] @ self.controllers[k].D
                    z = self.C[2:]
                    out.append((k, w / 3.0, z @ x, np.diag(z @ noise @ z.T), z @ struck))
        return out


def test_loops_that_take_turns_have_the_variance_of_the_covariance_over_their_cycle() -> None:
    shape = control.ss(SHAPE)
    stepped = Stepped(shape.A, shape.B, shape.C)
    driven = np.zeros((stepped.size, stepped.size))
    driven[: stepped.x, : stepped.x] = stepped.between(1.0, stepped.u[0])[1]
    X = stepped.covariances([driven] * 3)
    expected = sum(w * (np.einsum("ij,jk,ik->i", z, X[k], z) + more) for k, w, z, more, _ in stepped.instants())
    _, K_cycle = taking_turns(OUTER, INNER)
    found = JitterBudget(cascaded(), [noise()], (0.4, 3.0)).of(K_cycle, 1e-9)
    assert found.rms[0] ** 2 == pytest.approx(expected, rel=1e-8)
    assert found.cumulative[0, :, -1] == pytest.approx(expected, rel=1e-4)
    # The integral of the rate is the position.
    integral = JitterBudget(cascaded(integrated=(False, True)), [noise()]).of(K_cycle, 1e-8)
    assert integral.rms[0, 1] == pytest.approx(found.rms[0, 0], rel=1e-7)


@pytest.mark.parametrize("omega", [0.9, 4.1, 2.0 * math.pi / (3 * PERIOD), 31.0])
def test_a_sine_in_loops_that_take_turns_has_the_mean_square_of_the_exact_steady_state(omega: float) -> None:
    stepped = Stepped(np.array([[0.0, omega], [-omega, 0.0]]), np.zeros((2, 1)), np.array([[1.0, 0.0]]))
    rest = [k for k in range(stepped.size) if k not in (3, 4)]
    turn = np.linalg.multi_dot(stepped.steps[::-1])
    v = np.zeros(stepped.size, dtype=complex)
    v[3:5] = [1.0, 1j]
    back = np.exp(3j * omega * PERIOD) * np.eye(len(rest)) - turn[np.ix_(rest, rest)]
    v[rest] = np.linalg.solve(back, turn[np.ix_(rest, [3, 4])] @ v[3:5])
    at = [v, stepped.steps[0] @ v, stepped.steps[1] @ stepped.steps[0] @ v]
    expected = sum(w * 0.5 * np.abs(z @ at[k]) ** 2 for k, w, z, *_ in stepped.instants())
    sine = SineDisturbance(name="motor", inputs=(0,), frequency=omega, amplitude=np.array([1.0]))
    found = JitterBudget(cascaded(), [sine]).of(taking_turns(OUTER, INNER)[1])
    assert found.rms[0] ** 2 == pytest.approx(expected, rel=1e-9)


def test_noise_of_samples_in_loops_that_take_turns_is_the_mean_over_their_cycle() -> None:
    stepped = Stepped(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)))
    found = JitterBudget(cascaded(), [SampleNoise(name=f"{k}", measured=k, rms=0.3) for k in range(2)])
    rms = found.of(taking_turns(OUTER, INNER)[1], 1e-9).rms
    for k in range(2):
        added = [one[:, k : k + 1] for one in stepped.added]
        X = stepped.covariances([one @ one.T for one in added])
        expected = sum(
            w * (np.einsum("ij,jk,ik->i", z, X[at], z) + direct[:, k] ** 2)
            for at, w, z, _, direct in stepped.instants()
        )
        assert rms[k] == pytest.approx(0.3 * np.sqrt(expected), rel=1e-8)


def test_a_slow_controller_alone_is_one_of_a_longer_period() -> None:
    """A cycle of three samples of which one is used, and one period of the three together: the same to the last."""
    sources = [noise(), noise("base", 1), SampleNoise(name="gyro", measured=0, rms=0.1)]
    sine = SineDisturbance(name="motor", inputs=(0,), frequency=6.0, amplitude=np.array([0.3]))
    whole = JitterBudget(oscillator(), [*sources, sine], (0.4, 3.0)).of(K, 1e-9)
    slow = control.ss(*K, inputs=["y"], outputs=["u"])
    turns = interconnected_at_rates([slow], ["y"], ["u"], PERIOD / 3)
    again = JitterBudget(oscillator(period=PERIOD / 3, cycle=3), [*sources, sine], (0.4, 3.0)).of(turns, 1e-9)
    assert again.rms == pytest.approx(whole.rms, rel=1e-8)
    assert again.total == pytest.approx(whole.total, rel=1e-8)
    for one, other in zip(again.windows, whole.windows, strict=True):
        assert one.smear == pytest.approx(other.smear, rel=1e-6)
        assert one.jitter == pytest.approx(other.jitter, rel=1e-6)
    at = np.array([0.3, 1.0, 3.0, 8.0, 20.0])
    for k in range(2):
        curves = [np.interp(at, one.edges, one.total_cumulative[k]) for one in (again, whole)]
        assert curves[0] == pytest.approx(curves[1], rel=1e-3)


POINT, WEIGHT = np.polynomial.legendre.leggauss(60)


@pytest.mark.parametrize("a", [1e-3, 0.1, 0.7, 1.99, 2.01, 5.0, 40.0])
def test_shares_are_those_of_a_least_squares_line(a: float) -> None:
    # Both phases of the wave over a window from -1 to 1: the mean square over a uniform phase is half their sum.
    parts = np.zeros(3)
    for wave in (np.cos(a * POINT), np.sin(a * POINT)):
        mean, slope = 0.5 * WEIGHT @ wave, 1.5 * WEIGHT @ (POINT * wave)
        rest = wave - mean - slope * POINT
        parts += [mean**2, slope**2 / 3.0, 0.5 * WEIGHT @ rest**2]
    found = window_shares(np.array([a]), 2.0)
    assert found.displacement[0] == pytest.approx(parts[0], rel=1e-8)
    assert found.smear[0] == pytest.approx(parts[1], rel=1e-8)
    # The difference in time loses digits where the jitter is small; the series does not.
    assert found.jitter[0] == pytest.approx(parts[2], rel=1e-8, abs=1e-16)


def test_short_windows_keep_all_digits() -> None:
    a = np.array([1e-8, 1e-6, 1e-4])
    found = window_shares(a, 2.0)
    assert found.smear == pytest.approx(a**2 / 3.0 * (1.0 - a**2 / 5.0), rel=1e-14)
    assert found.jitter == pytest.approx(a**4 / 45.0 * (1.0 - 2.0 * a**2 / 21.0), rel=1e-13)


@pytest.mark.parametrize("exposure", [0.1, 1.0, 6.0])
def test_windows_of_a_stationary_process_are_those_of_its_correlation(exposure: float) -> None:
    # Density 4/(1 + ω²)²: correlation (1 + |τ|) exp(-|τ|)/2. No control at all: the motion is the disturbance.
    spectrum = Density(knots=np.array([0.0, 0.3, 1.0, 3.0, 30.0, 3000.0]), density=lambda w: 4.0 / (1.0 + w * w) ** 2)
    plant = HybridPlant(
        plant=System(-np.eye(1), np.array([[1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[0, 0], [0, 1.0]])),
        controls=1,
        measured=1,
        period=0.01,
    )
    idle = System(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.zeros((1, 1)), 0.01)
    source = RandomDisturbance(name="motion", inputs=(0,), spectra=(spectrum,))
    window = JitterBudget(plant, [source], (exposure,)).of(idle, 1e-10).windows[0]
    # Both halves of the square of instants, the kink of the correlation on the diagonal between them.
    t = 0.5 * exposure * (1.0 + POINT)
    weight = 0.5 * exposure * WEIGHT
    s = 0.5 * t[:, None] * (1.0 + POINT)
    area = 2.0 * weight[:, None] * 0.5 * t[:, None] * WEIGHT
    tau = t[:, None] - s
    R = 0.5 * (1.0 + tau) * np.exp(-tau)
    displacement = np.sum(area * R) / exposure**2
    half = 0.5 * exposure
    smear = 12.0 / exposure**4 * np.sum(area * R * (t[:, None] - half) * (s - half))
    assert window.displacement[0] ** 2 == pytest.approx(displacement, rel=1e-8)
    assert window.smear[0] ** 2 == pytest.approx(smear, rel=1e-8)
    assert window.jitter[0] ** 2 == pytest.approx(0.5 - displacement - smear, rel=1e-8, abs=1e-10)


def test_contrast_is_the_mean_over_the_motion() -> None:
    nu = np.array([0.0, 1e-6, 0.3, 1.0, 4.0])
    assert motion_transfer(nu, 0.1) == pytest.approx(np.exp(-2.0 * (math.pi * 0.1 * nu) ** 2), rel=1e-14)
    # Extents of Gaussian smear, drawn by quadrature.
    x, w = np.polynomial.hermite_e.hermegauss(80)
    drawn = [w @ np.sinc(one * math.sqrt(12.0) * 0.05 * x) / math.sqrt(2.0 * math.pi) for one in nu]
    assert motion_transfer(nu, 0.0, 0.05) == pytest.approx(drawn, rel=1e-12)
