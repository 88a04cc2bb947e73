"""The coupled check: poles by python-control and on paper, rates as readings, loops without that of the platform."""

import dataclasses

import control
import numpy as np
import pytest

from given_controllers import verdict
from mechanics.test_compliance import drive as stiff_drive
from mechanics.test_motor_winding import drive
from offset_trees import MODES, offset_platform
from one_axis import job_of as joined
from one_axis import loop_of
from platform_ctrl import design, linearise, matrices, read_job, read_platform, state_space
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import CoupledLimits, Job, Sampling
from platform_ctrl.job.variation import Uncertainty
from platform_ctrl.plant.locking import with_cogging, with_locked
from platform_ctrl.verification.coupled import coupled_check


@pytest.fixture(scope="module")
def job():
    """The main job with its classical designs as they stand in the file."""
    job = read_job("examples/three_gyro_platform.toml")
    chosen = [next(d for d in spec.designs if d.method in ("classical", "platform-servo")) for spec in job.loops]
    loops = tuple(
        dataclasses.replace(spec, designs=(dataclasses.replace(one, tune=False),), use=one.name)
        for spec, one in zip(job.loops, chosen, strict=True)
    )
    return dataclasses.replace(job, loops=loops, manoeuvres=job.manoeuvres[:1])


@pytest.fixture(scope="module")
def controllers(job):
    return [outcome.closed.controller for outcome in design.loops(job)]


def test_coupled_poles_are_python_controls(job, controllers):
    found = verdict(dataclasses.replace(job, manoeuvres=()), controllers).coupled
    loop = control.feedback(found.plant, found.controller, sign=1)
    ours, theirs = np.sort(np.abs(found.poles)), np.sort(np.abs(control.poles(loop)))
    np.testing.assert_allclose(ours[-6:], theirs[-6:], atol=1e-7)
    assert found.stable


def test_a_weak_torquer_loses_the_gyro_and_the_verdict_says_so(job, controllers):
    """0.05 N m holds 0.33 rad/s at most: at 1 rad/s the gimbal runs away, and no requirement hides it."""
    weak = dataclasses.replace(
        job.platform,
        torquers=tuple(dataclasses.replace(t, limit=0.05 if t.gimbal else t.limit) for t in job.platform.torquers),
    )
    job = dataclasses.replace(job, platform=weak)
    [run] = verdict(job, controllers).runs
    assert not any(r.passed for r in run.results)
    assert run.largest["torque_share"][0] > 1.0


def test_without_a_platform_loop_the_platform_is_carried(job, controllers):
    """Caging loops alone: Omega given, no coupling to pay for; one loop alone leaves the other gyros out."""

    def closed(*loops):
        some = dataclasses.replace(job, loops=tuple(job.loops[k] for k in loops), manoeuvres=())
        return verdict(some, [controllers[k] for k in loops]).coupled

    both = closed(0, 1)
    assert both.stable
    assert both.plant.input_labels == ["Q4", "Q5", "Q7", "Q9", "Q10"]
    np.testing.assert_array_equal(both.cost, 0.0)
    lone = closed(1)
    assert lone.stable
    assert lone.plant.output_labels == ["alpha9", "beta10"]
    np.testing.assert_allclose(lone.coupled, both.coupled[3:], rtol=1e-7)


@pytest.mark.parametrize("mode", ["floating", "pivot"])
def test_a_light_root_that_reacts_on_an_encoders_loop_is_a_cost_and_said_to_be_held(mode):
    """Between payload J and root J0 a torque shows 1 + J/J0 times: the margin is that of so much more gain, held."""
    J, J0 = 1.0, 0.5
    body = {"mass": 10.0, "centre": [0.0, 0.0, 0.0]}
    plant = {
        "schema": 1,
        "name": "bus",
        "root": {"name": "bus", "mode": mode, "inertia": [J0] * 3, **body},
        "gimbal": [{"name": "g", "angle": "angle", "parent": "bus", "axis": [0, 0, 1], "inertia": [J] * 3, **body}],
        "torquer": [{"gimbal": "g"}],
        "pickoff": [{"gimbal": "g"}],
    }
    turn = {"name": "turn", "mode": "caged", "duration": 0.3, "axis": 3, "rate": 0.1, "rise": 0.1, "hold": 0.1}
    tables = {"operation": {"Omega": [0.0, 0.0, 0.0]}, "coupled": {"coupling_cost": 0.1}}
    tables["manoeuvre"] = [turn | {"limits": {"angle": 1}}]
    loop = loop_of("g", ["angle"], design={"crossover_hz": 4})
    job = read_job(joined(plant, loop, rate_hz=100, **tables))
    [outcome] = design.loops(job)
    assert all("; held: bus" in one.evidence for one in outcome.closed.results)
    K = outcome.closed.controller
    result = verdict(job, [K])
    found = result.coupled
    margins = []
    for gain in (1.0, 1.0 + J / J0):
        P = control.ss([[1.0, 0.01], [0.0, 1.0]], [[5e-5], [0.01]], [[gain / J, 0.0]], 0.0, 0.01)
        margins.append(control.disk_margins(-control.ss(K.A, K.B, K.C, K.D, K.dt) * P, np.geomspace(0.1, 314.0, 20000)))
    (held, *_), (real, *_) = margins
    assert [found.decoupled[0], found.coupled[0]] == pytest.approx([held, real], rel=1e-3)
    [cost] = [one for one in found.results if one.name == "disk margin lost by coupling"]
    assert cost.value == pytest.approx(1.0 - real / held, rel=1e-3)
    assert not cost.passed
    assert "; the rate of bus is prescribed" in result.runs[0].results[0].evidence


PERIOD = 0.001
ROOT = np.array([0.2, 0.3, 0.4])
ARM = 0.01


def bare(**more):
    return {
        "schema": 1,
        "name": "base",
        "root": {"name": "base", "inertia": ROOT.tolist()},
        "torquer": [{"root_axis": axis} for axis in (1, 2, 3)],
        "rate_sensor": [{"root_axis": axis, "noise_rms": 1e-4, "noise_bandwidth_hz": 500.0} for axis in (1, 2, 3)],
        **more,
    }


def with_arm(**more):
    """A wheelless arm about axis 1, with a torquer and sensors of its own."""
    data = bare(gimbal=[{"name": "a", "parent": "base", "axis": [1, 0, 0], "inertia": [ARM, ARM, ARM]}])
    data["torquer"].append({"gimbal": "a"})
    data["pickoff"] = [{"gimbal": "a"}]
    data["rate_sensor"].append({"gimbal": "a", "noise_rms": 1e-4, "noise_bandwidth_hz": 500.0})
    return data | more


def job_of(data, delay=0.0):
    return Job(
        name="rates",
        plant="",
        platform=read_platform(data),
        Omega=np.zeros(3),
        uncertainty=Uncertainty(),
        sampling=Sampling(period=PERIOD, delay=delay),
        loops=(),
        coupled=CoupledLimits(),
        manoeuvres=(),
    )


def gains(matrix, inputs, outputs):
    return control.StateSpace([], [], [], matrix, PERIOD, inputs=inputs, outputs=outputs)


OMEGA, M = ["Omega1", "Omega2", "Omega3"], ["M1", "M2", "M3"]
SERVO = gains(-np.diag([10.0, 20.0, 30.0]), OMEGA, M)


@pytest.mark.parametrize("delay", [0.0, PERIOD])
def test_a_bare_platform_held_by_its_rate_sensors_has_the_poles_of_the_textbook(delay):
    """J ω' = −k ω, sampled: z = 1 − k T/J; a period later z² − z + k T/J = 0."""
    job = job_of(bare(), delay)
    found = coupled_check(job, linearise(job.platform), [SERVO])
    ratio = np.array([10.0, 20.0, 30.0]) * PERIOD / ROOT
    expected = 1 - ratio if delay == 0.0 else np.concatenate([np.roots([1, -1, r]) for r in ratio])
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(expected), atol=1e-12)
    assert found.free
    assert found.stable
    assert found.plant.output_labels == OMEGA
    # Without gimbals there is nothing that reacts, and nothing that coupling costs.
    np.testing.assert_allclose(found.cost, 0.0, atol=1e-9)


def test_rate_noise_shakes_the_torque_as_an_autoregression_of_first_order():
    """u = −k (ω + n), ω[i+1] = ω[i] + T/J u[i]: var u = k² σ² (1 + (kT/J)²/(1 − (1 − kT/J)²))."""
    job = job_of(bare())
    found = coupled_check(job, linearise(job.platform), [SERVO])
    k = np.array([10.0, 20.0, 30.0])
    ratio = k * PERIOD / ROOT
    # At 1 kHz the sample sees all of the 500 Hz that the noise is wide.
    expected = k * 1e-4 * np.sqrt(1 + ratio**2 / (1 - (1 - ratio) ** 2))
    np.testing.assert_allclose(found.torque_noise, expected, rtol=1e-9)


def test_a_given_rate_of_the_platform_closes_no_loop():
    """Omega is known on the carried platform: what is fed forward moves no pole and no margin."""
    job = job_of(with_arm())
    model = linearise(job.platform)
    parts = [gains([[-2.0, -0.1, feed]], ["q_a", "q_a_rate", "Omega1"], ["Qa"]) for feed in (0.0, 5.0)]
    still, fed = (coupled_check(job, model, [K]) for K in parts)
    np.testing.assert_allclose(np.sort_complex(fed.poles), np.sort_complex(still.poles), atol=1e-14)
    np.testing.assert_allclose(fed.coupled, still.coupled, rtol=1e-12)
    # Its sensor's noise reaches the torque all the same: 5 N m s times 1e-4 rad/s, and a little back through the arm.
    assert np.hypot(still.torque_noise[0], 5.0 * 1e-4) <= fed.torque_noise[0] <= 1.2 * 5.0 * 1e-4


def test_a_free_platform_and_its_arm_turn_as_two_bodies_on_one_axis():
    """Q between them, M on the base: J_b ω' = M − Q and J_a (ω + q̇)' = Q, both torques proportional to rates."""
    job = job_of(with_arm())
    arm = gains([[-0.1]], ["q_a_rate"], ["Qa"])
    found = coupled_check(job, linearise(job.platform), [arm, SERVO])
    mobility = np.array([[1 / ROOT[0], -1 / ROOT[0]], [-1 / ROOT[0], 1 / ROOT[0] + 1 / ARM]])  # of (ω, q̇) on (M, Q)
    about_1 = np.linalg.eigvals(np.eye(2) - PERIOD * mobility @ np.diag([10.0, 0.1]))
    # The arm takes part in the turning about the other axes.
    others = 1 - PERIOD * np.array([20.0, 30.0]) / (ROOT[1:] + ARM)
    expected = np.concatenate([[0.0], about_1, others])  # 0: its angle comes to rest anywhere, which is no motion
    assert found.free_angles == ("q_a",)
    np.testing.assert_allclose(np.sort(found.poles.real), np.sort(expected), atol=1e-9)
    np.testing.assert_allclose(found.poles.imag, 0.0, atol=1e-9)
    assert found.plant.output_labels == [*OMEGA, "q_a_rate"]


@pytest.mark.parametrize("name", ["Omega2", "q_a_rate"])
def test_a_rate_without_a_sensor_is_refused(name):
    data = with_arm(rate_sensor=[{"root_axis": 1}])
    job = job_of(data)
    K = gains([[1.0]], [name], ["M1"])
    with pytest.raises(ArgumentError, match=rf"input '{name}' is a rate that no sensor measures; add a rate se") as e:
        coupled_check(job, linearise(job.platform), [K])
    assert "\n" not in str(e.value)


def test_a_motor_with_ripple_is_checked_where_it_takes_away_and_where_it_adds():
    rows = [[7.0, 0.2, 0.3], [14.0, 0.1, 0.0]]
    at_worst = with_cogging(read_platform(drive(ripple=rows)), np.zeros(1))
    assert [words for words, _ in at_worst] == ["ripple takes torque away", "ripple adds torque"]
    assert [one.windings[0][1].swell for _, one in at_worst] == pytest.approx([0.7, 1.3])
    assert not any(one.springs for _, one in at_worst)


def test_cogging_and_the_ripple_of_a_held_torque_add_up_at_the_worst_of_their_phases():
    platform = read_platform(drive(gear=-20.0, cogging=[[6.0, 0.02, 0.0]], ripple=[[36.0, 0.05, 0.0]]))
    at_worst = with_cogging(platform, np.array([0.5]))
    found = sorted([one.springs[0].stiffness, one.windings[0][1].swell] for _, one in at_worst)
    steepest = 20.0**2 * 6.0 * 0.02 + 20.0 * 36.0 * 0.05 * 0.5
    np.testing.assert_allclose(found, [[k * steepest, swell] for k in (-1, 1) for swell in (0.95, 1.05)])
    assert at_worst[0][0] == "cogging with ripple under load pushes away, ripple takes torque away"


@pytest.mark.parametrize("seed", range(6))
def test_a_locked_gimbal_is_a_part_of_its_parent(seed):
    rng = np.random.default_rng(seed)
    platform = offset_platform(rng, MODES[seed % 3], 4)
    locked = rng.choice(platform.gimbal_names)
    rest = with_locked(platform, [locked])
    kept = [k for k, name in enumerate(platform.gimbal_names) if name != locked]
    q = np.zeros(4)
    q[kept] = rng.uniform(-3, 3, 3)
    rows = [0, 1, 2, *(3 + k for k in kept)]
    u = np.zeros(7)
    u[rows] = rng.normal(size=6)
    whole, part = matrices(platform, q, u), matrices(rest, q[kept], u[rows])
    for found, expected in (
        (part.A_star, whole.A_star[np.ix_(rows, rows)]),
        (part.P, whole.P[:, rows]),
        (part.G_A @ u[rows], (whole.G_A @ u)[rows]),
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max(initial=1e-12))
    assert read_platform(rest).to_toml() == rest.to_toml()


def test_a_motor_side_that_is_locked_holds_its_load_by_the_drive():
    platform, J2 = read_platform(stiff_drive()), 0.05
    held = with_locked(platform, ["g_motor"])
    assert held.gimbal_names == ("g", "h")
    poles = state_space(linearise(held)).poles()
    assert np.abs(poles).max() == pytest.approx(np.sqrt(300.0 / (J2 + 1e-9)), rel=1e-9)
    assert -2.0 * poles.real.min() * J2 == pytest.approx(0.04, rel=1e-6)
    assert with_locked(platform, ["g", "g_motor"]).gimbal_names == ("h",)
