"""Controllers that take rates in: loops so simple that poles, margins and noise stand on paper, and what is refused."""

import control
import numpy as np
import pytest

from platform_ctrl import linearise, read_platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import CoupledLimits, Job, Sampling
from platform_ctrl.job.uncertainty import Uncertainty
from platform_ctrl.verification.coupled import coupled_check

PERIOD = 0.001
ROOT = np.array([0.2, 0.3, 0.4])
ARM = 0.01


def plant(**more):
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
    data = plant(gimbal=[{"name": "a", "parent": "base", "axis": [1, 0, 0], "inertia": [ARM, ARM, ARM]}])
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
    job = job_of(plant(), delay)
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
    job = job_of(plant())
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
