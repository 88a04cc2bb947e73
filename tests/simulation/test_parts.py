"""Noise, torquers, sensors and sampling of the sampled loop, by what is known of them without the kernel."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import control
import numpy as np
import pytest
from scipy import stats

import platform_ctrl as pc
from plant_parts import PickOff
from platform_ctrl import simulation
from platform_ctrl.simulation import Scenario, TimeTable
from signal_and_gimbal import PERIOD, RMS, J, fault, flown, gain, plant, scenario, within

# Noise.


def readings(seed: int = 1, run: int = 0) -> np.ndarray:
    out = flown(plant(noise=RMS), level=0.0, duration=20.0, seed=seed, run=run, step=PERIOD)
    truth = np.column_stack([out.q, out.rate[:, 0], out.Omega[:, 1]])
    return (out.reading - truth) / RMS


def test_noise_is_standard_normal_and_independent_between_sensors_runs_seeds_and_samples() -> None:
    series = [*readings().T, *readings(run=1).T, *readings(seed=2).T, *readings(seed=2**40, run=2**33).T]
    for one in series:
        assert stats.kstest(one, "norm").pvalue > 1e-3
        assert abs(stats.skew(one)) < 0.09
        assert abs(stats.kurtosis(one)) < 0.18
    several = 5.0 / np.sqrt(len(series[0]))
    for a, b in itertools.combinations(series, 2):
        assert abs(np.mean(a * b)) < several
        assert abs(np.mean((a**2 - 1.0) * (b**2 - 1.0))) < 2.0 * several
    for one, lag in itertools.product(series, (1, 2, 3, 10)):
        assert abs(np.mean(one[lag:] * one[:-lag])) < several


# Torquers.


def test_a_limited_torque_stays_at_its_limit_and_is_counted() -> None:
    out = flown(plant(limit=0.4), level=-0.5, slope=10.0)
    np.testing.assert_allclose(out.torque[:, 0], np.clip(10.0 * out.t - 0.5, -0.4, 0.4), rtol=0, atol=1e-13)
    assert out.saturated[0] == np.sum(np.abs(out.command) >= 0.4)


@pytest.mark.parametrize("step", [1e-3, 1e-4])
def test_a_lag_follows_a_limited_ramp_exactly(step: float) -> None:
    lag, rate, end = 8e-3, 20.0, 0.05
    out = flown(plant(rate_limit=rate, lag=lag), step=step)
    ramp = rate * (out.t - lag * -np.expm1(-out.t / lag))
    at_end = rate * (end - lag * -np.expm1(-end / lag))
    expected = np.where(out.t < end, ramp, 1.0 + (at_end - 1.0) * np.exp(-(out.t - end) / lag))
    np.testing.assert_allclose(out.torque[:, 0], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("more", [{}, {"lag": 5e-3}, {"rate_limit": 15.0}])
def test_a_dead_torquer_gives_nothing_while_it_is_dead(more: dict[str, float]) -> None:
    sound, out = flown(plant(**more)), flown(plant(**more), fault("torquer dead"))
    dead = within(out.t, 0.03, 0.07)
    np.testing.assert_array_equal(out.torque[dead], 0.0)
    np.testing.assert_array_equal(out.torque[out.t < 0.0295], sound.torque[out.t < 0.0295])
    # Sound again, it begins as it did at first.
    again = out.torque[out.t > 0.0695, 0]
    np.testing.assert_allclose(again, sound.torque[: len(again), 0], rtol=0, atol=1e-13)
    assert np.ptp(out.rate[dead, 1]) < 1e-14


@pytest.mark.parametrize("at", [0.03, 0.0303])
def test_a_stuck_torquer_keeps_the_torque_that_it_had(at: float) -> None:
    ramp, lag, moving = {"level": 0.0, "slope": 10.0}, 5e-3, at - PERIOD  # the first command is zero
    following = flown(plant(lag=lag), **ramp).torque[30, 0]
    had = {
        (): 0.29 if at == 0.03 else 0.3,  # the command that comes at the same time is too late
        ("lag",): 0.3 + (following - 0.3) * np.exp((0.03 - at) / lag),
        ("rate_limit",): 7.0 * moving,
        ("lag", "rate_limit"): 7.0 * (moving + lag * np.expm1(-moving / lag)),
    }
    for names, expected in had.items():
        limits = {name: {"lag": lag, "rate_limit": 7.0}[name] for name in names}
        out = flown(plant(**limits), fault("torquer stuck", at=at), **ramp)
        stuck = out.torque[within(out.t, at, 0.07), 0]
        assert np.ptp(stuck) == 0.0
        assert stuck[0] == pytest.approx(expected, rel=0, abs=1e-12)
        turned = np.diff(out.rate[within(out.t, at, 0.0705), 1])
        np.testing.assert_allclose(J * turned, stuck[0] * PERIOD, rtol=1e-10)


def test_a_weak_torquer_gives_its_share_of_the_limited_command() -> None:
    ramp = {"level": 0.0, "slope": 10.0}
    out = flown(plant(limit=0.4), fault("torquer weak", share=0.25), **ramp)
    share = np.where(within(out.t, 0.03, 0.07), 0.25, 1.0)
    np.testing.assert_allclose(out.torque[:, 0], share * np.minimum(10.0 * out.t, 0.4), rtol=0, atol=1e-13)
    np.testing.assert_allclose(out.command[:, 0], 10.0 * out.t, rtol=0, atol=1e-13)


# Sensors.


READINGS = ["signal", "signal_rate", "Omega2"]
TURNING = TimeTable(t=np.array([0.0, 0.1]), values=np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]]))


def truth(out: Any) -> np.ndarray:
    return np.column_stack([out.q, out.rate[:, 0], out.Omega[:, 1]])


def test_rate_sensors_read_the_rates_of_gimbal_and_root() -> None:
    platform = plant()
    out = flown(platform, level=0.1, slope=-0.7, Omega_table=TURNING)
    assert out.pickoff_names == ("signal", "alpha", "signal_rate", "Omega2")
    np.testing.assert_array_equal(out.reading, truth(out))
    np.testing.assert_allclose(out.reading[:, 3], 3.0 * out.t, rtol=0, atol=1e-15)
    free = scenario(platform, mode="stabilised", Omega=[0.1, 0.2, -0.3], slope=0.4)
    out = simulation.simulate(free, [gain(1e-3, of="signal_rate")], period=PERIOD)
    np.testing.assert_array_equal(out.reading, truth(out))
    np.testing.assert_array_equal(out.command[:, 0], 1e-3 * out.rate[:, 0])
    assert np.ptp(out.Omega[:, 1]) > 1e-3


def test_a_quantised_reading_is_the_nearest_step() -> None:
    out = flown(plant(quantisation=0.013), slope=-9.0, Omega_table=TURNING)
    steps = out.reading / 0.013
    np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-9)
    assert np.abs(out.reading - truth(out)).max() <= 0.0065 + 1e-12
    assert len(np.unique(out.reading[:, 0])) > 50


@pytest.mark.parametrize("part", READINGS)
def test_faults_of_a_sensor_change_what_it_reads_as_they_say(part: str) -> None:
    platform = plant(noise=RMS)
    sound = flown(platform, slope=2.0, Omega_table=TURNING)
    j = sound.pickoff_names.index(part)
    on = within(sound.t, 0.03, 0.07)
    expected = {
        "pick-off dead": np.zeros(40),
        "pick-off stuck": np.full(40, sound.reading[29, j]),
        "pick-off drift": sound.reading[on, j] + 0.8 * (sound.t[on] - 0.03),
        "pick-off dropout": np.full(40, sound.reading[29, j]),  # all are lost
    }
    for kind, reading in expected.items():
        numbers = {"rate": 0.8} if kind == "pick-off drift" else {}
        out = flown(platform, fault(kind, part=part, **numbers), slope=2.0, Omega_table=TURNING)
        np.testing.assert_allclose(out.reading[on, j], reading, rtol=0, atol=1e-14)
        np.testing.assert_array_equal(out.reading[~on, j], sound.reading[~on, j])
        others = np.arange(4) != j
        if part != "signal":  # which the torque follows, and alpha the torque
            np.testing.assert_array_equal(out.reading[:, others], sound.reading[:, others])
        np.testing.assert_array_equal(out.command[:, 0], out.reading[:, 0])


def losses(lost: np.ndarray, probability: float) -> None:
    """Judge a series of losses: as many as there should be, and none the more likely for the one before."""
    spread = 4.0 * np.sqrt(probability * (1.0 - probability) / len(lost))
    assert abs(np.mean(lost) - probability) < spread
    assert abs(np.mean(lost[1:] & lost[:-1]) - probability**2) < 2.0 * spread


@pytest.mark.parametrize("probability", [0.03, 0.4])
def test_samples_are_lost_with_their_probability_one_by_one_and_the_last_stays(probability: float) -> None:
    lossy = [
        fault("pick-off dropout", part=part, at=0.0, until=np.inf, probability=probability)
        for part in ("signal", "signal_rate")
    ]
    platform, more = plant(noise=RMS), {"duration": 8.0, "step": PERIOD, "slope": 1e-3, "level": 0.0}
    sound = flown(platform, **more).reading
    series = []
    for run in (0, 1):
        noise = sound if run == 0 else flown(platform, run=run, **more).reading
        out = flown(platform, *lossy, run=run, **more).reading
        for j in (0, 2):
            lost = out[1:, j] != noise[1:, j]
            np.testing.assert_array_equal(out[1:, j], np.where(lost, out[:-1, j], noise[1:, j]))
            losses(lost, probability)
            series.append(lost)
    for a, b in itertools.combinations(series, 2):
        assert abs(np.mean(a & b) - probability**2) < 5.0 * probability / np.sqrt(len(a))


def test_in_a_missed_sample_command_and_controller_stay() -> None:
    count = control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], PERIOD, inputs=["signal"], outputs=["Qg"], name="count")
    missing = fault("controller overrun", part=None, at=1.0, until=9.0, probability=0.2)
    dead = fault("torquer dead", at=0.0, until=11.0)
    one = scenario(plant(limit=1e6), faults=(missing, dead), duration=10.0, level=1.0)
    out = simulation.simulate(one, [count], period=PERIOD, step=PERIOD)
    command = out.command[:, 0]
    np.testing.assert_array_equal(command[:1001], np.arange(1001.0))
    # A sample that is met shows the state that the last one met left behind.
    assert set(np.diff(command)) == {0.0, 1.0}
    losses(np.diff(command)[1000:8998] == 0.0, 0.2)
    np.testing.assert_array_equal(np.diff(command[9000:]), 1.0)


# Sampling.


@pytest.mark.parametrize("mode", ["stabilised", "caged"])
@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0, 2.4])
def test_a_run_of_small_signals_is_that_of_the_linear_sampled_loop(delay: float, mode: str) -> None:
    platform, period, samples = pc.read_platform("three_gyro_platform"), 5e-4, 120
    lags = np.linspace(0.0, 2e-3, len(platform.torquers))
    platform = dataclasses.replace(
        platform,
        pickoffs=tuple(PickOff(name=p.name, gimbal=p.gimbal) for p in platform.pickoffs),
        torquers=tuple(dataclasses.replace(t, lag=lag) for t, lag in zip(platform.torquers, lags, strict=True)),
    )
    rng, free = np.random.default_rng(3), mode == "stabilised"
    acting = [t for t in platform.torquers if free or t.gimbal is not None]
    angles, torquers = [p.name for p in platform.pickoffs], [t.name for t in acting]

    def of(inputs: list[str], outputs: list[str], size: float) -> control.StateSpace:
        A, B = 0.3 * rng.normal(size=(3, 3)), rng.normal(size=(3, len(inputs)))
        C, D = size * rng.normal(size=(len(outputs), 3)), size * rng.normal(size=(len(outputs), len(inputs)))
        return control.ss(A, B, C, D, period, inputs=inputs, outputs=outputs)

    inner = of(angles, ["wanted"], 1.0)
    controllers = [inner, of([*angles, "wanted"], torquers, 0.05)]
    push = 1e-7 * np.array([1.0, -2.0, 0.5])
    q = np.zeros(5) if free else 1e-8 * rng.normal(size=5)
    pushed = {"torque": push} if free else {"q": q}
    small = Scenario(platform=platform, mode=mode, duration=samples * period, delay=delay * period, **pushed)
    out = simulation.simulate(small, controllers, period=period, step=2e-5)

    G = pc.state_space(pc.linearise(platform), root="free" if free else "prescribed")
    plants = (
        pc.analysis.sampled(G[:, [t.signal for t in acting]], period, delay * period, lags[: len(acting)]),
        pc.analysis.sampled(G[:, ["M1", "M2", "M3"] if free else ["Omega1", "Omega2", "Omega3"]], period),
    )
    x, d = np.linalg.pinv(plants[0].C) @ np.resize(q, len(plants[0].C)), np.zeros(plants[1].nstates)
    states = [np.zeros(3), np.zeros(3)]
    measured = [plants[0].output_labels.index(name) for name in angles]
    outputs, commands = [], []
    for _ in range(samples + 1):
        y = plants[0].C @ x + plants[1].C @ d
        seen = y[measured]
        command = seen
        for k, K in enumerate(controllers):
            command = K.C @ states[k] + K.D @ seen
            states[k] = K.A @ states[k] + K.B @ seen
            seen = np.concatenate([y[measured], command])
        outputs.append(y)
        commands.append(command)
        x = plants[0].A @ x + plants[0].B @ command
        d = plants[1].A @ d + plants[1].B @ push * free
    expected = np.array(outputs)
    found = np.concatenate([out.q, out.Omega], axis=1) if free else out.q
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-6)
    given = out.command[:, [out.torquer_names.index(name) for name in torquers]]
    np.testing.assert_allclose(given, commands, rtol=0, atol=1e-6 * np.abs(commands).max())
