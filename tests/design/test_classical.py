"""The classical route: channels found from G, blocks against python-control, corners, tuning, certification."""

import dataclasses
import math

import control
import numpy as np
import pytest
from hypothesis import given, settings

from one_axis import job_of, loop_of
from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.design import tuning
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.loop import given_design
from platform_ctrl.design.loop_signals import channels
from platform_ctrl.design.method import instability
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.methods.classical import Classical
from platform_ctrl.design.methods.platform_servo import rate_estimate
from platform_ctrl.design.plants import plants_of
from platform_ctrl.design.sections import first_order, gain, low_pass, notch
from platform_ctrl.errors import DesignError
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.job.requirements import loop_requirements
from platform_ctrl.mechanics.linearisation import linearise
from tree_cases import platforms

PERIOD = 5e-4
L, J4, J5, J9, J10 = 0.15, 8e-4, 2e-4, 5e-4, 2e-4


def starting_values(given, channel, nutation, period):
    """All options of a classical design, those not given from rules of thumb."""
    return Classical().defaults(
        DesignSpec(name="classical", method="classical", options=given), channel, nutation, period
    )


@pytest.fixture(scope="module")
def job():
    return read_job("examples/three_gyro_platform.toml")


@pytest.fixture(scope="module")
def model(job):
    return linearise(job.platform)


@pytest.fixture(scope="module")
def classical(job, channel, two_axis):
    """Options and controller of the job's classical design of 9-10."""
    options = starting_values(job.loops[1].designs[0].options, channel, two_axis.nutation, PERIOD)
    return options, Classical().of_directions(options, channel, PERIOD)


@pytest.fixture(scope="module")
def two_axis(job):
    return plants_of(job, job.loops[1])


def response(block, w):
    """The response of a sampled block at w, rad/s."""
    A, B, C, D, _ = block
    return C @ np.linalg.solve(np.exp(1j * w * PERIOD) * np.eye(len(A)) - A, B) + D


@pytest.fixture(scope="module")
def channel(model):
    """The pair of gimbals 9 and 10."""
    return channels(model, [3, 4])


LEAD, LEAD_S = first_order(1.0, 30.0, 1 / 4000.0, 1.0, PERIOD), control.tf([1.0, 30.0], [1 / 4000.0, 1.0])


@pytest.mark.parametrize(
    ("block", "continuous"),
    [
        (first_order(1.0, 12.0, 1.0, 0.0, PERIOD), control.tf([1.0, 12.0], [1.0, 0.0])),
        (LEAD, LEAD_S),
        (LEAD.series(gain(3.0)), 3.0 * LEAD_S),
    ],
)
def test_blocks_are_python_controls_tustin(block, continuous):
    w = np.geomspace(1.0, 6000.0, 50)
    expected = control.sample_system(continuous, PERIOD, method="tustin")(np.exp(1j * w * PERIOD))
    np.testing.assert_allclose([response(block, one)[0, 0] for one in w], expected, rtol=1e-9)


@pytest.mark.parametrize("f", [300.0, 1200.0, 2500.0])
def test_prewarped_blocks_are_exact_at_their_frequency(f):
    assert response(notch(f, 0.2, 0.3, PERIOD), f)[0, 0] == pytest.approx(0.2, abs=1e-9)
    assert response(low_pass(f, 0.7, PERIOD), f)[0, 0] == pytest.approx(1 / (1.4j), abs=1e-9)


def test_channels_of_the_three_gyro_platform(model):
    """4-5-7: the pair (α4, (β5 + β7)/√2) with √2 L, and β5 − β7 that no gyro stiffens. 9-10: one pair."""
    found = channels(model, [0, 1, 2])
    np.testing.assert_allclose(found.momenta, [np.sqrt(2) * L])
    half = np.sqrt(0.5)
    np.testing.assert_allclose(np.abs(found.basis), [[1, 0, 0], [0, half, half], [0, half, half]], atol=1e-12)
    assert found.inertial == 1
    np.testing.assert_allclose(found.inertias, [J4, J5, J5])
    found = channels(model, [3, 4])
    np.testing.assert_allclose(found.basis, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(found.momenta, [L])
    np.testing.assert_allclose(found.inertias, [J9, J10])


@settings(max_examples=20, deadline=None)
@given(platforms(max_gimbals=5))
def test_channels_bring_every_skew_matrix_to_pairs(platform):
    model = linearise(platform)
    n = len(platform.gimbals)
    found = channels(model, list(range(n)))
    np.testing.assert_allclose(found.basis @ found.basis.T, np.eye(n), atol=1e-10)
    block = np.zeros((n, n))
    for k, h in enumerate(found.momenta):
        assert h > 0
        block[2 * k, 2 * k + 1], block[2 * k + 1, 2 * k] = h, -h
    np.testing.assert_allclose(found.basis @ model.G @ found.basis.T, block, atol=1e-8 * (1 + np.abs(model.G).max()))


def test_cross_gain_alone_drives_nutation_unstable_and_the_direct_lead_damps_it(channel, two_axis):
    """Growth rate about the crossover; the trap of the cross-axis loop."""
    options = starting_values({"crossover_hz": 10.0}, channel, two_axis.nutation, PERIOD)
    weak = options | {"damping_hz": 1e-6, "damping2_hz": 1e-6}
    cross = Classical().of_directions(weak, channel, PERIOD)
    decay = measure(two_axis, cross).decay[0]
    assert -decay == pytest.approx(2 * np.pi * 10.0, rel=0.4)
    damped = measure(two_axis, Classical().of_directions(options, channel, PERIOD))
    assert damped.decay[0] > 0.0
    assert damped.damping[0] > 0.1


def test_no_integrator_is_doubled(model):
    """One pole at z = 1 for every gimbal, no more: 4-5-7 has three, 9-10 two."""
    for rows in ([0, 1, 2], [3, 4]):
        channel = channels(model, rows)
        options = starting_values({"notch_depth": 0.5}, channel, 500.0, PERIOD)
        A = Classical().of_directions(options, channel, PERIOD).A
        assert np.sum(np.abs(np.linalg.eigvals(A) - 1.0) < 1e-6) == len(rows)


def test_an_unstable_controller_is_not_certified(job, two_axis):
    growing = gain(np.array([[0.0, 40.0], [40.0, 0.0]]))
    error = instability(given_design(job.loops[1], "growing", growing, two_axis, "classical"), False)
    assert "grows at" in str(error)


def test_rates_from_the_torques_of_the_caged_gyros(model):
    """Omega1 = Q9/L, Omega2 = −(Q5 + Q7)/(2 L), Omega3 = −Q10/L."""
    estimate, used = rate_estimate(model)
    assert [model.gimbal_names[k] for k in used] == ["5", "7", "9", "10"]
    np.testing.assert_allclose(estimate, [[0, 0, 1 / L, 0], [-0.5 / L, -0.5 / L, 0, 0], [0, 0, 0, -1 / L]], atol=1e-9)


def test_a_lag_raises_the_gain_at_low_frequencies_alone(channel):
    plain = starting_values({"integral_hz": 0.1}, channel, 474.0, PERIOD)
    lagging = starting_values({"integral_hz": 0.1, "lag_hz": 2.0, "lag_ratio": 4.0}, channel, 474.0, PERIOD)

    def cross(options, hz):
        return abs(response(Classical().of_directions(options, channel, PERIOD), 2 * np.pi * hz)[0, 1])

    assert cross(lagging, 1e-3) / cross(plain, 1e-3) == pytest.approx(4.0, rel=1e-3)
    assert cross(lagging, 500.0) / cross(plain, 500.0) == pytest.approx(1.0, rel=1e-3)


def test_the_spin_notch_attenuates_every_path_at_the_spin_frequency(channel):
    """Rotor 11: 0.15/1.2e-4 = 1250 rad/s."""
    np.testing.assert_allclose(channel.spins, [1250.0])
    plain = starting_values({}, channel, 474.0, PERIOD)
    notched = starting_values({"spin_notch_depth": 0.05}, channel, 474.0, PERIOD)
    assert notched["spin_notch_hz"] == pytest.approx(1250.0 / (2.0 * np.pi))
    there, less = (response(Classical().of_directions(one, channel, PERIOD), 1250.0) for one in (plain, notched))
    np.testing.assert_allclose(less, 0.05 * there, rtol=1e-8)


def test_rotors_of_two_spins_need_a_given_one(model):
    channel = dataclasses.replace(channels(model, [0, 1, 2]), spins=np.array([1000.0, 1250.0]))
    with pytest.raises(DesignError, match=r"one spin frequency, but 159\.2, 198\.9 Hz"):
        starting_values({"spin_notch_width": 0.2}, channel, 474.0, PERIOD)
    assert starting_values({"spin_notch_hz": 180.0}, channel, 474.0, PERIOD)["spin_notch_depth"] == 0.1


GIMBALS = ("outer", "inner")
JOB = job_of(
    "gimballed_gyro",
    loop_of(GIMBALS, kind="caging", limits={"disk_margin": 1.9}, design={"tune": True}),
    rate_hz=2000,
    delay=0.0005,
    operation={"Omega": [0.0, 0.0, 0.0]},
)


@pytest.fixture(scope="module")
def untuned():
    """A job with a margin that no loop has: its limits, plants, directions and the options of a first design."""
    job = read_job(JOB)
    [spec] = job.loops
    plants, model = plants_of(job, spec), linearise(job.platform)
    return spec.limits, plants, channels(model, rows_of(model, GIMBALS))


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_options_stay_within_reach_of_their_start(untuned, direction, monkeypatch):
    limits, plants, channel = untuned
    start = starting_values({}, channel, plants.nutation, plants.period)
    tried = []

    def build(options):
        tried.append(options["crossover_hz"] / start["crossover_hz"])
        return Classical().of_directions(options, channel, plants.period)

    monkeypatch.setattr(
        tuning, "worst_ratio", lambda *_: 9.0 / (1.0 + math.exp(0.01 * direction * math.log(tried[-1])))
    )
    required = loop_requirements(limits)
    tuner = tuning.Tuner(movable=["crossover_hz"], build=build, plants=plants, requirements=required, evaluations=100)
    tuned = tuner.run(start)
    assert max(direction * math.log10(one) for one in tried) > 5.9
    assert all(0.99e-6 <= one <= 1.01e6 for one in tried)
    assert math.isfinite(tuned["crossover_hz"])


def test_what_need_not_move_keeps_its_number_to_the_last_digit(untuned):
    limits, plants, channel = untuned
    # exp(log(7)) is 6.999999999999999, and exp(log(900)) is 900.0000000000001.
    given = {"crossover_hz": 40.0, "lead_hz": 7.0, "rolloff_hz": 900.0}
    start = starting_values(given, channel, plants.nutation, plants.period)
    required = loop_requirements(limits | {"disk_margin": 0.01})

    def build(options):
        return Classical().of_directions(options, channel, plants.period)

    tuner = tuning.Tuner(movable=list(start), build=build, plants=plants, requirements=required, evaluations=5)
    assert tuner.run(start) == start
