"""The classical route: channels found from G, blocks against python-control, corners, tuning, certification."""

import dataclasses

import control
import numpy as np
import pytest
from hypothesis import given, settings

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.design.cases import cases, changed
from platform_ctrl.design.classical.caging import classical_controller, starting_values
from platform_ctrl.design.classical.stabilisation import platform_servo, rate_estimate
from platform_ctrl.design.loop import Designed, LoopProblem, closed_loop_poles, measured, sampled_plant
from platform_ctrl.design.partition import channels, first_order, gain, low_pass, notch, side_by_side
from platform_ctrl.design.plants import loop_plants
from platform_ctrl.design.tuning import tune, worst_ratio
from platform_ctrl.errors import DesignError
from platform_ctrl.job.reading import read_job
from platform_ctrl.job.requirements import loop_requirements
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.matrices import matrices
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.reading import read_platform
from tree_cases import platforms

PERIOD = 5e-4
L, J4, J5, J9, J10 = 0.15, 8e-4, 2e-4, 5e-4, 2e-4


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
    return options, classical_controller(options, channel, PERIOD)


@pytest.fixture(scope="module")
def two_axis(job):
    return loop_plants(job, ("9", "10"))


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


@settings(max_examples=40, deadline=None)
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


def test_a_change_of_inertia_moves_one_J_alone(job):
    J = np.diag(matrices(job.platform).A_star)[3:]
    moved = changed(job.platform, {"9": 0.1, "10": -0.1}, {"6": 0.2})
    now = np.diag(matrices(moved).A_star)[3:]
    np.testing.assert_allclose(now / J, [1, 1, 1, 1.1, 0.9], rtol=1e-12)
    np.testing.assert_allclose(matrices(moved).L / matrices(job.platform).L, [1.2, 1, 1])


def test_every_corner_of_the_uncertainty_and_of_the_rate_is_in_the_set(job):
    found = cases(job, ("9", "10"))
    assert found[0].label == "nominal"
    assert len(found) == 1 + 2**3 + 2**3
    assert len(cases(job, ("4", "5", "7"))) == 1 + 2**5 + 2**3
    assert len({case.label for case in found}) == len(found)


def test_corner_plants_have_their_own_nutation(job):
    """L up, J down: the open-loop nutation of that corner is 1.1/0.9 of the nominal one."""
    plants = loop_plants(job, ("9", "10"))
    corner = plants.labels.index("J9-10% J10-10% L11+10%")
    fast = [np.abs(np.log(np.linalg.eigvals(plants.A[k])[:, None] + 1e-300) / PERIOD) for k in (0, corner)]
    nutation = [
        f[np.abs(f - plants.nutation * guess).argmin()] for f, guess in zip(fast, (1.0, 1.1 / 0.9), strict=True)
    ]
    assert nutation[0] == pytest.approx(L / np.sqrt(J9 * J10), rel=1e-6)
    assert nutation[1] / nutation[0] == pytest.approx(1.1 / 0.9, rel=1e-6)


def test_cross_gain_alone_drives_nutation_unstable_and_the_direct_lead_damps_it(channel, two_axis):
    """Growth rate about the crossover; the trap of the cross-axis loop."""
    options = starting_values({"crossover_hz": 10.0}, channel, two_axis.nutation, PERIOD)
    weak = options | {"damping_hz": 1e-6, "damping2_hz": 1e-6}
    cross = classical_controller(weak, channel, PERIOD)
    decay = measure(two_axis, cross).decay[0]
    assert -decay == pytest.approx(2 * np.pi * 10.0, rel=0.4)
    damped = measure(two_axis, classical_controller(options, channel, PERIOD))
    assert damped.decay[0] > 0.0
    assert damped.damping[0] > 0.1


def test_no_integrator_is_doubled(model):
    """One pole at z = 1 for every gimbal, no more: 4-5-7 has three, 9-10 two."""
    for rows in ([0, 1, 2], [3, 4]):
        channel = channels(model, rows)
        options = starting_values({"notch_depth": 0.5}, channel, 500.0, PERIOD)
        A = classical_controller(options, channel, PERIOD).A
        assert np.sum(np.abs(np.linalg.eigvals(A) - 1.0) < 1e-6) == len(rows)


def test_blocks_form_the_controller():
    one, two = first_order(1.0, 2.0, 1.0, 3.0, PERIOD), notch(400.0, 0.5, 0.3, PERIOD)
    first, second, both, pair = (
        response(block, 600.0) for block in (one, two, one.series(two), side_by_side(one, two))
    )
    np.testing.assert_allclose(both, second @ first)
    np.testing.assert_allclose(pair, np.diag([first[0, 0], second[0, 0]]))


def test_tuning_meets_the_requirements_from_rules_of_thumb(job, channel, two_axis):
    """9-10 with limits relaxed by a tenth, so that the test stays short; the start does not meet them."""
    limits = job.loops[1].limits | {"bandwidth_hz": 40.0, "disk_margin_worst_case": 0.28}
    required = loop_requirements(limits)
    start = starting_values({"integral_hz": 2.0}, channel, two_axis.nutation, PERIOD)

    def build(options):
        return classical_controller(options, channel, PERIOD)

    assert worst_ratio(build(start), two_axis, required) > 1.0
    movable = ["crossover_hz", "damping_hz", "damping2_hz", "lead_hz"]
    found = tune(start, movable, build, two_axis, required, reserve=0.0, upper={"lead_hz": 50.0})
    assert worst_ratio(build(found), two_axis, required) <= 1.0
    assert found["lead_hz"] <= 50.0
    assert found["integral_hz"] == 2.0


def test_certified_figures_come_from_the_closed_loop(job, classical, two_axis):
    """Against python-control: poles, and the disk margin by a dense frequency sweep."""
    spec = job.loops[1]
    options, controller = classical
    found = Designed(controller=controller, options=options)
    design = measured(spec, spec.designs[0], found, two_axis)
    P, K = sampled_plant(two_axis), design.controller
    loop = control.feedback(P, K, sign=1)
    radius = np.abs(control.poles(loop)).max()
    assert design.measures.decay[0] == pytest.approx(-np.log(radius) / PERIOD, rel=1e-6)
    assert np.abs(closed_loop_poles(two_axis, K)[0]).max() == pytest.approx(radius, abs=1e-8)
    w = np.geomspace(1.0, 0.9999 * np.pi / PERIOD, 4000)
    L_out = -np.moveaxis((P * K)(np.exp(1j * w * PERIOD)), -1, 0)
    S = np.linalg.inv(np.eye(2) + L_out)
    swept = 1.0 / np.linalg.norm(S - 0.5 * np.eye(2), 2, axis=(1, 2)).max()
    assert design.measures.disk_margin[0] <= swept * (1 + 1e-9)
    assert design.measures.disk_margin[0] == pytest.approx(swept, rel=1e-3)
    sigma = np.linalg.norm(S, 2, axis=(1, 2))
    assert design.measures.bandwidth <= w[np.argmax(sigma >= np.sqrt(0.5))] * (1 + 1e-9)
    assert {r.name for r in design.results} >= {"bandwidth", "disk margin, worst case", "torque noise, rms"}


def test_the_exact_margins_are_never_above_those_of_the_grid(classical, two_axis):
    _, K = classical
    rough, exact = measure(two_axis, K, exact=False), measure(two_axis, K)
    assert np.all(exact.disk_margin <= rough.disk_margin * (1 + 1e-9))
    np.testing.assert_allclose(exact.disk_margin, rough.disk_margin, rtol=0.02)


def test_torque_noise_is_what_a_long_random_run_shows(classical, two_axis):
    _, K = classical
    measures = measure(two_axis, K)
    named = K.to_control(two_axis.angles, two_axis.torques)
    loop = control.feedback(named, sampled_plant(two_axis), sign=1)
    rng = np.random.default_rng(1)
    noise = 5e-6 * rng.standard_normal((2, 40000))
    torque = control.forced_response(loop, inputs=noise, timepts=PERIOD * np.arange(40000)).outputs
    np.testing.assert_allclose(torque.std(axis=1), measures.torque_noise, rtol=0.05)


def test_an_unstable_controller_is_not_certified(job, two_axis):
    spec = job.loops[1]
    growing = Designed(controller=gain(np.array([[0.0, 40.0], [40.0, 0.0]])), options={})
    with pytest.raises(DesignError, match="grows at"):
        measured(spec, spec.designs[0], growing, two_axis)


def test_rates_from_the_torques_of_the_caged_gyros(model):
    """Omega1 = Q9/L, Omega2 = −(Q5 + Q7)/(2 L), Omega3 = −Q10/L."""
    estimate, used = rate_estimate(model)
    assert [model.gimbal_names[k] for k in used] == ["5", "7", "9", "10"]
    np.testing.assert_allclose(estimate, [[0, 0, 1 / L, 0], [-0.5 / L, -0.5 / L, 0, 0], [0, 0, 0, -1 / L]], atol=1e-9)


def test_gyros_that_do_not_measure_a_rate_are_an_error(job):
    blind = dataclasses.replace(job.platform, rotors=job.platform.rotors[:2])
    with pytest.raises(DesignError, match=r"gyros of gimbals 5 and 7 show the rate about parallel axes"):
        rate_estimate(linearise(blind))
    # Two gimbals show two rates at most: the third is named too.
    with pytest.raises(DesignError, match=r"about \(0\.00, -?1\.00, 0\.00\)"):
        rate_estimate(linearise(read_platform("momentum_wheel_satellite")))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inertial_crossover_hz": 3.0}, "inertial_crossover_hz"),
        ({"crossover_hz": 0.0}, "crossover_hz must be > 0, got 0"),
        ({"notch_hz": 1500.0}, "notch_hz must be below half the sample rate, got 1500"),
        ({"spin_notch_hz": 1000.0}, "spin_notch_hz must be below half the sample rate, got 1000"),
        ({"lag_ratio": 1.0}, "lag_ratio.* must exceed 1, got 1"),
    ],
)
def test_wrong_options_are_named(channel, options, message):
    with pytest.raises(DesignError, match=message):
        starting_values(options, channel, 474.0, PERIOD)


def test_a_filter_beyond_half_the_sample_rate_is_an_error(job, model):
    servo = dataclasses.replace(job.loops[2].designs[0], options={"filter_hz": 1000.0})
    with pytest.raises(DesignError, match="filter_hz must be below half the sample rate, got 1000"):
        platform_servo(LoopProblem(job=job, spec=job.loops[2], design=servo, model=model))


def test_a_lag_raises_the_gain_at_low_frequencies_alone(channel):
    plain = starting_values({"integral_hz": 0.1}, channel, 474.0, PERIOD)
    lagging = starting_values({"integral_hz": 0.1, "lag_hz": 2.0, "lag_ratio": 4.0}, channel, 474.0, PERIOD)

    def cross(options, hz):
        return abs(response(classical_controller(options, channel, PERIOD), 2 * np.pi * hz)[0, 1])

    assert cross(lagging, 1e-3) / cross(plain, 1e-3) == pytest.approx(4.0, rel=1e-3)
    assert cross(lagging, 500.0) / cross(plain, 500.0) == pytest.approx(1.0, rel=1e-3)


def test_the_spin_notch_attenuates_every_path_at_the_spin_frequency(channel):
    """Rotor 11: 0.15/1.2e-4 = 1250 rad/s."""
    np.testing.assert_allclose(channel.spins, [1250.0])
    plain = starting_values({}, channel, 474.0, PERIOD)
    notched = starting_values({"spin_notch_depth": 0.05}, channel, 474.0, PERIOD)
    assert notched["spin_notch_hz"] == pytest.approx(1250.0 / (2.0 * np.pi))
    there, less = (response(classical_controller(one, channel, PERIOD), 1250.0) for one in (plain, notched))
    np.testing.assert_allclose(less, 0.05 * there, rtol=1e-8)


def test_rotors_of_two_spins_need_a_given_one(model):
    channel = dataclasses.replace(channels(model, [0, 1, 2]), spins=np.array([1000.0, 1250.0]))
    with pytest.raises(DesignError, match=r"one spin frequency, but 159\.2, 198\.9 Hz"):
        starting_values({"spin_notch_width": 0.2}, channel, 474.0, PERIOD)
    assert starting_values({"spin_notch_hz": 180.0}, channel, 474.0, PERIOD)["spin_notch_depth"] == 0.1


def test_python_controls_root_locus_follows_the_momentum_states(model):
    """One torque across, the other axis free: its poles are those of the closed states but for the one not seen."""
    plant = state_space(model, gimbals=("9", "10"))["beta10", "Q9"]
    gains = np.array([0.0, 0.5, 5.0])
    locus = control.root_locus_map(plant, gains)
    for gain_value, poles in zip(gains, locus.loci, strict=True):
        closed = np.linalg.eigvals(plant.A - gain_value * plant.B @ plant.C)
        np.testing.assert_allclose(np.sort(np.abs(poles)), np.sort(np.abs(closed))[1:], rtol=1e-6, atol=1e-5)
        assert np.abs(closed).min() < 1e-6
