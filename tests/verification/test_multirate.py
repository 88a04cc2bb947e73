"""Loops at rates of their own: the linear numbers, the kernel, the stepped run and the C code do the same.

The oracles step the sampled plant and the controllers one sample at a time, in the words of the job file: at every n-th
sample a loop is computed, in between its output is held.
"""

from __future__ import annotations

import ctypes
import math
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from camera_job import tracking_loop
from commanded_gimbal import RATE_HZ, commanded_job
from generated_c import Machine, compiled
from given_controllers import verdict
from platform_ctrl import read_job
from platform_ctrl.design import loops
from platform_ctrl.export import write_c
from platform_ctrl.simulation import simulate
from platform_ctrl.verification import check_job

T, SLOW = 1.0 / RATE_HZ, 20
STEP = [{"reading": "heading", "step": 1e-3, "at": 0.1}]


def tracking_job(slow: int | None = SLOW, inner: int = 1, **sensor: Any) -> dict[str, Any]:
    """A tracking loop at every `slow`-th sample around a rate loop, on one axis; None: without the key."""
    job = commanded_job(STEP)
    job["plant"]["attitude_sensor"][0] |= {"delay": 0.004} | sensor
    tracking = tracking_loop({"disk_margin": 0.5}, "loop", "heading", name="own", crossover_hz=1.0)
    job["loop"].append(tracking | ({} if slow is None else {"rate_hz": RATE_HZ / slow}))
    job["loop"][0] |= {"rate_hz": RATE_HZ / inner} if inner > 1 else {}
    return job


@pytest.fixture(scope="module")
def job() -> Any:
    return read_job(tracking_job())


@pytest.fixture(scope="module")
def made(job: Any) -> tuple[Any, ...]:
    return loops(job)


@pytest.fixture(scope="module")
def controllers(made: tuple[Any, ...]) -> list[control.StateSpace]:
    return [one.closed.controller for one in made]


@pytest.fixture(scope="module")
def result(job: Any, controllers: list[control.StateSpace]) -> Any:
    return verdict(job, controllers, prove=True)


@pytest.fixture(scope="module")
def check(result: Any) -> Any:
    return result.coupled


class Computer:
    """Controllers as a computer runs them, in the words of the job file."""

    def __init__(self, controllers: list[control.StateSpace]) -> None:
        self.controllers = controllers
        self.x = [np.zeros(K.nstates) for K in controllers]
        self.u = [np.zeros(K.noutputs) for K in controllers]
        self.sample = 0

    def step(self, readings: dict[str, float]) -> dict[str, float]:
        signals = dict(readings)
        for k, K in enumerate(self.controllers):
            if self.sample % round(K.dt / T) == 0:
                y = np.array([signals.get(name, 0.0) for name in K.input_labels])
                self.u[k], self.x[k] = K.C @ self.x[k] + K.D @ y, K.A @ self.x[k] + K.B @ y
            signals |= dict(zip(K.output_labels, self.u[k], strict=True))
        self.sample += 1
        return signals

    @property
    def memory(self) -> np.ndarray:
        return np.concatenate([*self.x, *self.u])

    @memory.setter
    def memory(self, values: np.ndarray) -> None:
        parts = np.split(values, np.cumsum([len(one) for one in (*self.x, *self.u)])[:-1])
        self.x, self.u = list(parts[: len(self.x)]), list(parts[len(self.x) :])


def over_a_cycle(
    check: Any, controllers: list[control.StateSpace], cycle: int, factors: Any = None, rms: Any = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of every sample of a cycle: what becomes of plant, computer and noise of the readings, and the torques.

    By stepping, column by column. `factors` change the torques of each sample, `rms` is the noise of each reading.
    """
    plant = check.plant
    names, torquers, n = list(plant.output_labels), list(plant.input_labels), plant.nstates
    size = n + len(Computer(controllers).memory)
    noise = np.zeros(len(names)) if rms is None else rms
    out = []
    for k in range(cycle):
        states, torques = [], []
        for column in np.eye(size + len(names)):
            computer = Computer(controllers)
            computer.sample, computer.memory = k, column[n:size]
            made = computer.step(dict(zip(names, plant.C @ column[:n] + noise * column[size:], strict=True)))
            u = (1.0 if factors is None else factors[k]) * np.array([made[name] for name in torquers])
            states.append(np.concatenate([plant.A @ column[:n] + plant.B @ u, computer.memory]))
            torques.append(u)
        out.append((np.array(states).T, np.array(torques).T))
    return out


def turn(steps: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """The transition over the cycle."""
    whole = np.eye(len(steps[0][0]))
    for step, _ in steps:
        whole = step[:, : len(step)] @ whole
    return whole


def test_the_slow_loop_is_what_the_run_does(made: tuple[Any, ...], job: Any) -> None:
    """Of its plants and controller alone, at every 20th sample, follows what the kernel reads there, step for step."""
    tracking = made[0].closed
    assert tracking.plants is not None
    assert tracking.controller.dt == pytest.approx(SLOW * T)
    run = simulate(job.scenario(job.manoeuvres[0]), [one.closed.controller for one in made], period=T)
    P, K = tracking.plants, tracking.controller
    x, x_K, expected = np.zeros(P.A.shape[-1]), np.zeros(K.nstates), []
    for k in range(len(run.t[::SLOW])):
        y = P.C[0] @ x
        expected.append(y[0])
        given = np.array([y[0], 1e-3 if k * SLOW * T >= 0.1 - 1e-9 else 0.0])
        assert tracking.controller.input_labels == ["heading", "heading_command"]
        x, x_K = P.A[0] @ x + P.B[0] @ (K.C @ x_K + K.D @ given), K.A @ x_K + K.B @ given
    heading = run.reading[::SLOW, run.pickoff_names.index("heading")]
    assert np.abs(heading).max() > 1e-3
    np.testing.assert_allclose(heading, expected, rtol=0.0, atol=1e-9)


def test_poles_are_those_of_stepping_plant_and_computer_over_a_cycle(
    check: Any, controllers: list[control.StateSpace]
) -> None:
    assert check.period == pytest.approx(SLOW * T)
    assert check.controller is None
    stepped = np.linalg.eigvals(turn(over_a_cycle(check, controllers, SLOW)))

    def largest(z: Any) -> np.ndarray:
        return np.sort(np.abs(z))[::-1][:6]

    np.testing.assert_allclose(largest(check.poles), largest(stepped), rtol=1e-7, atol=1e-7)
    assert check.stable
    assert "over 20 samples" in check.results[0].evidence


def test_stability_of_the_whole_is_proved(result: Any, check: Any) -> None:
    (proof,) = result.proofs["", ""].claims
    assert proof.proved
    assert proof.bound == pytest.approx(-0.99 * np.log(np.abs(check.poles).max()) / check.period, rel=1e-6)


def test_no_gain_within_the_margin_destabilises(check: Any, controllers: list[control.StateSpace]) -> None:
    """Gains of the torque's loop that change from sample to sample at random, inside the disk."""
    alpha = check.simultaneous.guaranteed
    assert 0.3 < alpha <= check.simultaneous.upper
    np.testing.assert_allclose(check.coupled, alpha, rtol=2e-4)
    generator = np.random.default_rng(1)
    low, high = (2.0 - alpha) / (2.0 + alpha), (2.0 + alpha) / (2.0 - alpha)
    for _ in range(20):
        factors = (2.0 + alpha * generator.uniform(-1.0, 1.0, SLOW)) / (2.0 - alpha * generator.uniform(-1.0, 1.0))
        whole = turn(over_a_cycle(check, controllers, SLOW, np.clip(factors, low, high)))
        assert np.abs(np.linalg.eigvals(whole)).max() < 1.0


def test_torque_noise_is_the_mean_of_the_periodic_covariance() -> None:
    data = tracking_job(noise_rms=1e-5, noise_bandwidth_hz=500.0)
    data["plant"]["rate_sensor"][0] |= {"noise_rms": 1e-4, "noise_bandwidth_hz": 500.0}
    job = read_job(data)
    controllers = [one.closed.controller for one in loops(job)]
    check = verdict(job, controllers).coupled
    sensors = {one.name: one for one in job.platform.sensors}
    rms = np.array([sensors[name].sampled_noise(T) for name in check.plant.output_labels])
    steps = over_a_cycle(check, controllers, SLOW, rms=rms)
    n = len(steps[0][0])
    driven = np.zeros((n, n))
    for step, _ in steps:
        driven = step[:, :n] @ driven @ step[:, :n].T + step[:, n:] @ step[:, n:].T
    X, squares = solve_discrete_lyapunov(turn(steps), driven), []
    for step, torque in steps:
        squares.append(np.diag(torque[:, :n] @ X @ torque[:, :n].T + torque[:, n:] @ torque[:, n:].T))
        X = step[:, :n] @ X @ step[:, :n].T + step[:, n:] @ step[:, n:].T
    np.testing.assert_allclose(check.torque_noise, np.sqrt(np.mean(squares, axis=0)), rtol=1e-7)


def slow_job(slow: int | None, **sensor: Any) -> dict[str, Any]:
    """The tracking loop around a tracker at 2 Hz."""
    data = tracking_job(slow, rate_hz=2.0, **sensor)
    data["loop"][1]["design"][0]["crossover_hz"] = 0.05
    return data


def test_a_loop_of_hundreds_of_readings_on_their_way_is_neither_proved_nor_followed_over_its_gain() -> None:
    """A tracker at 2 Hz that is read at every sample: what it says is 250 samples old in the mean."""
    job = read_job({name: item for name, item in slow_job(None).items() if name != "manoeuvre"})
    result = check_job(job, loops(job), prove=True)
    tracking = result.loops[0].closed
    assert tracking.plants is not None
    states = tracking.plants.A.shape[-1] + tracking.own_controller.nstates
    assert states > 250
    said = {one.subject: one.evidence for one in result.requirements if one.name == "minimum decay rate"}
    assert f"no proof in interval arithmetic: {states} states, more than 64" in said["track"]
    assert "no proof in interval arithmetic" in said["all loops closed"]
    assert "no proof" not in said["loop"]
    assert [one.subject for one in result.requirements if one.name == "certified properties"] == ["loop"]


def test_a_tracking_loop_at_two_hertz_in_a_loop_at_one_kilohertz() -> None:
    """500 samples to a cycle: margins and budget are those of the rate loop, the tracker is far too slow to count."""
    data = slow_job(500, noise_rms=1e-6, noise_bandwidth_hz=1.0)
    data |= {"budget": shaken_data(SLOW)["budget"]}
    data["plant"]["friction"] = [{"gimbal": "yaw", "viscous": 0.1}]
    data["plant"]["rate_sensor"][0] |= {"noise_rms": 1e-3, "noise_bandwidth_hz": 500.0}
    job = read_job(data)
    assert job.cycle == 500
    controllers = [one.closed.controller for one in loops(job)]
    found = verdict(job, controllers, prove=True)
    check = found.coupled
    assert check.stable
    assert check.period == pytest.approx(0.5)
    assert found.proofs["", ""].left_out == "a cycle of 500 samples"
    alone = verdict(read_job(data | {"loop": data["loop"][:1], "manoeuvre": []}), controllers[1:])
    np.testing.assert_allclose(check.coupled, alone.coupled.coupled, rtol=0.02)
    np.testing.assert_allclose(found.budget.rms[0], alone.budget.rms[0], rtol=0.02)


def test_a_tracker_that_measures_when_it_is_read_is_not_held() -> None:
    """At the loop's own rate its readings are as old as its delay; twice as fast in a loop at every sample, older."""
    job = read_job(tracking_job(rate_hz=RATE_HZ / SLOW))
    sensor = next(one for one in job.platform.sensors if one.name == "heading")
    assert sensor.periods_late(T, SLOW) == 4
    assert sensor.periods_late(T, 2 * SLOW) == 4
    assert sensor.periods_late(T) == 4 + math.ceil((SLOW - 1) / 2)
    # At half the tracker's period every other reading is ten samples older.
    assert sensor.periods_late(T, SLOW // 2) == 4 + 5
    run = simulate(job.scenario(job.manoeuvres[0]), [one.closed.controller for one in loops(job)], period=T)
    plain = read_job(tracking_job())
    other = simulate(plain.scenario(plain.manoeuvres[0]), [one.closed.controller for one in loops(plain)], period=T)
    np.testing.assert_allclose(run.command, other.command, rtol=0.0, atol=1e-12)


def test_the_generated_code_is_the_simulated_computer(
    job: Any, controllers: list[control.StateSpace], tmp_path: Path
) -> None:
    files = write_c(job, controllers, tmp_path).files
    library = compiled(files, tmp_path / "all.so")
    inputs = ["heading", "heading_command", "gyro"]
    outputs = ["gyro_command", "Qyaw"]
    code = Machine(library, "commanded", inputs, outputs, ctypes.c_double, ["track_status", "loop_status"])
    run = simulate(job.scenario(job.manoeuvres[0]), controllers, period=T)
    readings = np.column_stack([run.reading[:, run.pickoff_names.index(name)] for name in ("heading", "gyro")])
    made, statuses = code.run(np.insert(readings, 1, run.reading_command[:, 0], axis=1))
    np.testing.assert_allclose(made[:, 1], run.command[:, 0], rtol=0.0, atol=1e-12 * np.abs(run.command).max())
    assert set(statuses) == {0}
    header = (tmp_path / "commanded.h").read_text()
    assert "1000 Hz (every 0.001 s)" in header
    assert "track, at one sample in 20" in header
    assert "50 Hz (every 0.02 s)" in (tmp_path / "track.h").read_text()


def shaken_data(slow: int) -> dict[str, Any]:
    """The base turns under a bearing with viscous friction; the tracker takes a noisy picture whenever it is read."""
    data = tracking_job(slow, noise_rms=1e-4, noise_bandwidth_hz=20.0, rate_hz=RATE_HZ / slow)
    data["plant"]["rate_sensor"][0] |= {"noise_rms": 1e-3, "noise_bandwidth_hz": 500.0}
    data["plant"]["friction"] = [{"gimbal": "yaw", "viscous": 0.1}]
    data["budget"] = {
        "from_hz": 1.0,
        "to_hz": 200.0,
        "exposure": [0.02],
        "limits": {"jitter": 1.0},
        "source": [
            {"name": "base", "kind": "base-rate", "axis": 3, "frequencies_hz": [1.0, 90.0], "densities": [1e-5] * 2}
        ],
    }
    return data


def test_runs_have_the_rms_of_the_budget() -> None:
    """Hold and aliasing of the tracking loop at 50 Hz included: its pictures are most of what shakes."""
    data = shaken_data(SLOW)
    data["budget"]["runs"] = 96
    job = read_job(data)
    result = check_job(job, loops(job))
    found, budget = result.simulated_budget, result.budget
    spread = (found.high[1] - found.low[1]) / (2.0 * found.rms[1])
    assert spread < 0.07
    # Four standard errors; the interval has two.
    assert found.rms[1] == pytest.approx(found.linear[1], rel=2.0 * spread)
    assert budget.names == ("base", "noise of gyro", "noise of heading")
    assert budget.rms[2, 1] > 0.6 * budget.total[1]
    np.testing.assert_allclose(np.sqrt(np.sum(budget.rms**2, axis=0)), budget.total, rtol=1e-9)
    (limit,) = budget.results
    assert limit.value == pytest.approx(np.hypot(*budget.total[:2]))


def test_a_picture_that_is_read_just_when_it_is_taken_has_the_noise_of_its_own_rate() -> None:
    sensors = {one.name: one for one in read_job(shaken_data(SLOW)).platform.sensors}
    sensor, gyro = sensors["heading"], sensors["gyro"]
    own = sensor.sampled_noise(SLOW * T)
    assert sensor.sampled_noise(T, SLOW) == sensor.sampled_noise(T, 3 * SLOW) == pytest.approx(own)
    # Read more often it is the same picture again: independent readings of the same density have more noise.
    assert sensor.sampled_noise(T, SLOW // 4) == pytest.approx(2.0 * own)
    assert sensor.sampled_noise(T) == pytest.approx(math.sqrt(SLOW) * own)
    assert gyro.sampled_noise(T, SLOW) == gyro.sampled_noise(T)
