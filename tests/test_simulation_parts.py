"""Sensors, torquers, controllers, stops and noise of the sampled loop, by what is known of them without the kernel."""

from __future__ import annotations

import itertools

import control
import numba
import numpy as np
import pytest
from scipy import stats

import platform_ctrl as pc
from platform_ctrl import simulation
from platform_ctrl.description import Gimbal, PickOff, Platform, RateSensor, Torquer
from platform_ctrl.scenario import Fault, Scenario, TimeTable
from platform_ctrl.simulation import Trajectory
from platform_ctrl.simulation.kernel.noise import philox

PERIOD = 1e-3
J = 2e-3
RMS = 1e-3


def plant(
    stops: tuple[float, float] | None = None,
    restitution: float = 0.0,
    noise: float = 0.0,
    quantisation: float = 0.0,
    **torquer: float,
) -> Platform:
    """Two gimbals that do not feel each other on a held root: what `signal` reads is a straight line, `g` is turned."""
    sensor = {"noise_rms": noise, "noise_bandwidth_hz": 0.5 / PERIOD, "quantisation": quantisation}
    return Platform(
        name="signal and gimbal",
        root_name="case",
        root_inertia=0.01 * np.eye(3),
        gimbals=(
            Gimbal(name="s", parent="case", axis=np.array([1.0, 0, 0]), inertia=np.eye(3), angle="signal"),
            Gimbal(
                name="g",
                parent="case",
                axis=np.array([0, 0, 1.0]),
                inertia=J * np.eye(3),
                angle="alpha",
                stops=stops,
                restitution=restitution,
            ),
        ),
        torquers=(Torquer(name="Qg", gimbal="g", **torquer),),
        pickoffs=(PickOff(name="signal", gimbal="s", **sensor), PickOff(name="alpha", gimbal="g", **sensor)),
        rate_sensors=(
            RateSensor(name="signal_rate", gimbal="s", **sensor),
            RateSensor(name="Omega2", root_axis=2, **sensor),
        ),
    )


def gain(number: float = 1.0, of: str = "signal") -> control.StateSpace:
    return control.ss([], [], [], [[number]], PERIOD, inputs=[of], outputs=["Qg"], name="gain")


def scenario(platform: Platform, level: float = 1.0, slope: float = 0.0, **more: object) -> Scenario:
    given: dict[str, object] = {"mode": "caged", "duration": 0.1, "delay": 0.0, "q": [level, 0.0], "rate": [slope, 0.0]}
    return Scenario(platform=platform, **(given | more))  # type: ignore[arg-type]


def flown(platform: Platform, *faults: Fault, step: float = 1e-4, **more: object) -> Trajectory:
    return simulation.flight(scenario(platform, faults=faults, **more), [gain()], period=PERIOD, step=step)


def fault(kind: str, part: str | None = "Qg", at: float = 0.03, until: float = 0.07, **numbers: float) -> Fault:
    return Fault(name="f", kind=kind, part=part, at=at, until=until, **numbers)  # type: ignore[arg-type]


def within(t: np.ndarray, begin: float, end: float) -> np.ndarray:
    return (t > begin - 1e-9) & (t < end - 1e-9)


# Noise.


def test_philox_gives_the_published_words() -> None:
    @numba.njit
    def words(c, k):  # type: ignore[no-untyped-def]
        return philox(c[0], c[1], c[2], c[3], k[0], k[1])

    for counter, key, expected in (
        ("00000000 " * 4, "00000000 " * 2, "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        ("ffffffff " * 4, "ffffffff " * 2, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
        ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
    ):
        c, k = (np.array([int(word, 16) for word in text.split()], dtype=np.uint64) for text in (counter, key))
        assert " ".join(f"{word:08x}" for word in words(c, k)) == expected


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


def test_a_torque_whose_rate_is_limited_moves_along_a_ramp() -> None:
    out = flown(plant(rate_limit=20.0))
    risen = np.minimum(out.t, 0.05)
    np.testing.assert_allclose(out.torque[:, 0], 20.0 * risen, rtol=0, atol=1e-13)
    impulse = 10.0 * risen**2 + (out.t - risen)
    np.testing.assert_allclose(J * out.rate[:, 1], impulse, rtol=0, atol=1e-14)


def test_a_command_that_turns_about_turns_the_ramp_about() -> None:
    # The command falls through zero at 0.03 s from a limit of 0.2; the ramp to it takes 0.05 s at first.
    out = flown(plant(rate_limit=4.0, limit=0.2), level=3.0, slope=-100.0, delay=0.5 * PERIOD)
    expected, torque = [0.0], 0.0
    wanted = np.concatenate([[0.0], np.clip(out.command[:, 0], -0.2, 0.2)])
    for before, now in itertools.pairwise(wanted[:-1]):
        for level in (before, now):  # half a period each
            torque += np.clip(level - torque, -2e-3, 2e-3)
        expected.append(torque)
    np.testing.assert_allclose(out.torque[:, 0], expected, rtol=0, atol=1e-13)


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


def test_of_several_faults_of_a_torquer_the_gravest_counts() -> None:
    faults = (
        fault("torquer dead", at=0.05, until=0.06),
        fault("torquer weak", at=0.01, until=0.08, share=0.5),
        fault("torquer stuck", at=0.03, until=0.07),
    )
    ramp = {"level": 0.0, "slope": 10.0}
    for order in itertools.permutations(faults):
        torque = flown(plant(), *order, **ramp).torque[:, 0]
        np.testing.assert_allclose(
            torque[[5, 20, 35, 55, 65, 75, 90]], [0.05, 0.1, 0.145, 0.0, 0.145, 0.375, 0.9], rtol=0, atol=1e-13
        )


# Sensors.


READINGS = ["signal", "signal_rate", "Omega2"]
TURNING = TimeTable(t=np.array([0.0, 0.1]), values=np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]]))


def truth(out: Trajectory) -> np.ndarray:
    return np.column_stack([out.q, out.rate[:, 0], out.Omega[:, 1]])


def test_rate_sensors_read_the_rates_of_gimbal_and_root() -> None:
    platform = plant()
    out = flown(platform, level=0.1, slope=-0.7, Omega_table=TURNING)
    assert out.pickoff_names == ("signal", "alpha", "signal_rate", "Omega2")
    np.testing.assert_array_equal(out.reading, truth(out))
    np.testing.assert_allclose(out.reading[:, 3], 3.0 * out.t, rtol=0, atol=1e-15)
    free = scenario(platform, mode="stabilised", Omega=[0.1, 0.2, -0.3], slope=0.4)
    out = simulation.flight(free, [gain(1e-3, of="signal_rate")], period=PERIOD)
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
        out = flown(platform, fault(kind, part=part, rate=0.8), slope=2.0, Omega_table=TURNING)
        np.testing.assert_allclose(out.reading[on, j], reading, rtol=0, atol=1e-14)
        np.testing.assert_array_equal(out.reading[~on, j], sound.reading[~on, j])
        others = np.arange(4) != j
        if part != "signal":  # which the torque follows, and alpha the torque
            np.testing.assert_array_equal(out.reading[:, others], sound.reading[:, others])
        np.testing.assert_array_equal(out.command[:, 0], out.reading[:, 0])


def test_a_drift_is_quantised_with_the_angle() -> None:
    out = flown(plant(quantisation=0.01), fault("pick-off drift", part="signal", at=0.0, until=1.0, rate=0.5))
    np.testing.assert_allclose(out.reading[:, 0], 0.01 * np.floor((1.0 + 0.5 * out.t) / 0.01 + 0.5), atol=1e-12)


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
    one = scenario(plant(limit=1e-6), faults=(missing,), duration=10.0, level=1.0)
    out = simulation.flight(one, [count], period=PERIOD, step=PERIOD)
    command = out.command[:, 0]
    np.testing.assert_array_equal(command[:1001], np.arange(1001.0))
    # A sample that is met shows the state that the last one met left behind.
    assert set(np.diff(command)) == {0.0, 1.0}
    losses(np.diff(command)[1000:8998] == 0.0, 0.2)
    np.testing.assert_array_equal(np.diff(command[9000:]), 1.0)


# Stops.


def bouncing(restitution: float, **more: object) -> Trajectory:
    platform = plant(stops=(-0.05, 0.05), restitution=restitution)
    one = scenario(platform, **({"rate": [0.0, 3.0], "level": 0.0} | more))
    return simulation.flight(one, [gain()], period=PERIOD)


@pytest.mark.parametrize("restitution", [1.0, 0.7, 0.25, 0.0])
def test_every_bounce_gives_back_its_share_of_the_rate(restitution: float) -> None:
    out = bouncing(restitution, duration=0.2)
    rates = out.rate[:, 1]
    bounces = np.concatenate([[0], np.cumsum(np.abs(np.diff(rates)) > 1e-9)])
    expected = 3.0 * (-restitution) ** bounces
    np.testing.assert_allclose(rates, expected, rtol=1e-12, atol=1e-15)
    assert out.stop_contacts[1] == bounces[-1] == {1.0: 6, 0.7: 3, 0.25: 2, 0.0: 1}[restitution]
    assert np.abs(out.q[:, 1]).max() <= 0.05
    # Between bounces it goes on from the stop, which it has met to a step.
    if restitution == 1.0:
        way = 3.0 * out.t
        folded = np.abs((way - 0.05) % 0.2 - 0.1) - 0.05
        np.testing.assert_allclose(out.q[:, 1], folded, rtol=0, atol=6 * 3.0e-4)


def test_a_pushed_gimbal_bounces_ever_lower_and_comes_to_rest_on_its_stop() -> None:
    # As a ball that falls: heights e², e⁴, ... of the first; at rest after (1 + e)/(1 − e) times the first fall.
    e, push = 0.5, J * 20.0
    out = bouncing(e, level=push, rate=[0.0, 0.0], duration=0.4)
    fall = np.sqrt(2.0 * 0.05 / 20.0)
    alpha = out.q[:, 1]
    at_rest = out.t > fall * (1.0 + 2.0 * e / (1.0 - e)) + 5e-3
    np.testing.assert_array_equal(alpha[at_rest], 0.05)
    np.testing.assert_array_equal(out.rate[at_rest, 1], 0.0)
    first = within(out.t, fall, fall * (1.0 + 2.0 * e))
    assert 0.05 - alpha[first].min() == pytest.approx(e**2 * 0.05, rel=0.02)
    second = within(out.t, fall * (1.0 + 2.0 * e) + 1e-3, fall * (1.0 + 2.0 * e + 2.0 * e**2))
    assert 0.05 - alpha[second].min() == pytest.approx(e**4 * 0.05, rel=0.1)
    assert 5 < out.stop_contacts[1] < 15


def free_gyro(restitution: float, control: str = "regulated") -> Platform:
    """A rotor in two gimbals with stops, on a light platform."""
    return pc.read_platform(
        {
            "schema": 1,
            "name": "gyro between stops",
            "root": {"name": "case", "inertia": [[0.010, 0.001, 0.0], [0.001, 0.012, 0.0], [0.0, 0.0, 0.011]]},
            "gimbal": [
                {
                    "name": name,
                    "parent": parent,
                    "axis": axis,
                    "inertia": [6e-4, 5e-4, 7e-4],
                    "stops_deg": [-10.0, 8.0],
                    "restitution": restitution,
                }
                for name, parent, axis in (("outer", "case", [0, 0, 1]), ("inner", "outer", [1, 0, 0]))
            ],
            "rotor": [
                {
                    "name": "R",
                    "carrier": "inner",
                    "axis": [0, 0.6, 0.8],
                    "axial_inertia": 1.2e-4,
                    "transverse_inertia": 0.7e-4,
                    "spin": 200.0,
                    "control": control,
                }
                | ({"speed_gain": 1e-3} if control == "servo" else {})
            ],
        }
    )


def momentum_and_energy(platform: Platform, out: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Angular momentum in inertial axes, and the energy that goes with rates: half of v'A*v."""
    momentum, energy = [], []
    for q, Omega, rate, (w, *axis) in zip(out.q, out.Omega, out.rate, out.attitude, strict=True):
        v = np.concatenate([Omega, rate])
        m = pc.matrices(platform, q, v)
        own = (m.A_star @ v + m.B.T @ m.L)[:3]
        momentum.append(own + 2.0 * np.cross(axis, np.cross(axis, own) + w * own))
        energy.append(0.5 * v @ m.A_star @ v)
    return np.array(momentum), np.array(energy)


@pytest.mark.parametrize("restitution", [1.0, 0.6, 0.0])
def test_bounces_keep_the_angular_momentum_of_a_free_platform(restitution: float) -> None:
    platform = free_gyro(restitution)
    one = Scenario(
        platform=platform, mode="stabilised", duration=0.1, delay=0.0, rate=np.array([12.0, -9.0]), Omega=np.ones(3)
    )
    out = simulation.flight(one, [], period=PERIOD, step=5e-5)
    assert out.stop_contacts.min() >= 1
    momentum, energy = momentum_and_energy(platform, out)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), rtol=0, atol=1e-9)
    if restitution == 1.0:
        np.testing.assert_allclose(energy, energy[0], rtol=0.02)
    else:
        assert energy[-1] < 0.9 * energy[0]
        assert np.diff(energy).max() < 1e-3 * energy[0]
