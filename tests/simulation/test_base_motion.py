"""How a run begins and what moves its base: equilibrium, sines, and what is measured of the line of sight then."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest

from commanded_gimbal import commanded_job
from platform_ctrl import Platform, design, element_forces, linearise, read_job, read_platform, state_space
from platform_ctrl.campaign import plan, rerun
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation import Scenario, Sine, Vibration, simulate, simulate_batch
from platform_ctrl.verification import check_job
from sighted_gimbal import FRICTION, GAIN, HZ, JOB, PLANT, damped, sighted

PERIOD = 1e-3
TILTED = np.array([0.4, -0.3])


def loaded(torquers: list[dict[str, Any]] | None = None) -> Platform:
    """Return a plant on which gravity and a spring act at any angle."""
    return sighted(
        torquer=torquers or PLANT["torquer"],
        unbalance=[{"body": "pitch", "moment": [2e-3, 1e-3, 0.0]}],
        spring=[{"gimbal": "yaw", "stiffness": 0.05}],
    )


def begun(platform: Platform, **more: Any) -> Scenario:
    given = {"mode": "caged", "duration": 0.3, "delay": 0.0, "q": TILTED, "start": "equilibrium"}
    return Scenario(platform=platform, **(given | more))


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 2.3e-3])
@pytest.mark.parametrize("lag", [{}, {"lag": 0.01, "rate_limit": 1.0}], ids=["at once", "with lag"])
def test_a_run_in_equilibrium_stays_where_it_began(delay, lag) -> None:
    platform = loaded([one | lag for one in PLANT["torquer"]])
    run = simulate(begun(platform, delay=delay), [], period=PERIOD)
    np.testing.assert_allclose(run.q, np.tile(TILTED, (len(run.t), 1)), rtol=0.0, atol=1e-12)
    held = -element_forces(platform, q=TILTED)[3:]
    np.testing.assert_allclose(run.torque, np.tile(held, (len(run.t), 1)), rtol=1e-13)
    np.testing.assert_array_equal(run.command, np.tile(run.command[0], (len(run.t), 1)))
    falls = simulate(begun(platform, start="rest"), [], period=PERIOD)
    assert np.abs(falls.q[-1] - TILTED).max() > 0.05


def test_the_free_root_is_held_by_its_own_torquers() -> None:
    roots = [{"root_axis": k} for k in (1, 2, 3)]
    run = simulate(begun(loaded([*PLANT["torquer"], *roots]), mode="stabilised"), [], period=PERIOD)
    np.testing.assert_allclose(run.Omega, 0.0, atol=1e-12)
    np.testing.assert_allclose(run.q, np.tile(TILTED, (len(run.t), 1)), rtol=0.0, atol=1e-12)
    with pytest.raises(ArgumentError, match=r"start: root axis 1 is not in equilibrium, .* no torquer turns it"):
        simulate(begun(loaded(), mode="stabilised"), [], period=PERIOD)


def test_the_torque_of_equilibrium_counts_against_the_limit() -> None:
    platform = loaded()
    needed = np.abs(element_forces(platform, q=TILTED)[3:])
    weak = loaded([{"gimbal": "yaw", "limit": 0.5}, {"gimbal": "pitch", "limit": 0.5 * needed[1]}])
    result = simulate_batch([begun(one) for one in (platform,)], [], period=PERIOD)
    np.testing.assert_allclose(result.torque_share[0], needed / 0.5, rtol=1e-13)
    run = simulate(begun(weak), [], period=PERIOD)
    assert run.saturated.tolist() == [0, len(run.t)]
    assert abs(run.q[-1, 1] - TILTED[1]) > 0.05
    with pytest.raises(ArgumentError, match="start: gimbal 'pitch' is not in equilibrium"):
        simulate(begun(loaded([{"gimbal": "yaw"}])), [], period=PERIOD)


def test_sines_of_the_base_have_their_frequency_amplitude_and_phase() -> None:
    sines = (
        Sine(kind="rate", axis=2, frequency_hz=7.0, amplitude=0.3, phase=0.4),
        Sine(kind="rate", axis=2, frequency_hz=11.0, amplitude=-0.1),
        Sine(kind="rate", axis=3, frequency_hz=2.0, amplitude=0.2, phase=-1.0),
    )
    run = simulate(begun(sighted(), sines=sines, seed=3), [], period=PERIOD)
    expected = np.zeros((len(run.t), 3))
    for one in sines:
        expected[:, one.axis - 1] += one.amplitude * np.sin(2.0 * np.pi * one.frequency_hz * run.t + one.phase)
    np.testing.assert_allclose(run.Omega, expected, rtol=0.0, atol=1e-12)
    with pytest.raises(ArgumentError, match="kind 'rate' has no effect in mode 'stabilised'"):
        simulate(begun(sighted(), mode="stabilised", sines=sines), [], period=PERIOD)


def test_a_motion_that_fades_in_rises_by_a_half_cosine_to_itself() -> None:
    sine = Sine(kind="rate", axis=2, frequency_hz=7.0, amplitude=0.3, phase=0.4)
    shake = Vibration(kind="rate", axis=3, frequencies_hz=[1.0, 50.0], densities=[1e-3, 1e-4], lines=8)
    full = begun(sighted(), sines=(sine,), vibrations=(shake,), duration=0.2)
    at_once, half, slow = (simulate(replace(full, fade=fade), [], period=PERIOD) for fade in (0.0, 0.1, 0.15))
    assert np.abs(at_once.Omega[0]).min(initial=1.0, where=[False, True, True]) > 0.01
    for run, fade in ((half, 0.1), (slow, 0.15)):
        share = 0.5 - 0.5 * np.cos(np.pi * np.minimum(run.t / fade, 1.0))
        np.testing.assert_allclose(run.Omega, share[:, None] * at_once.Omega, rtol=0.0, atol=1e-12)
    both = simulate_batch([replace(full, fade=fade) for fade in (0.0, 0.1, 0.15)], [], period=PERIOD)
    np.testing.assert_array_equal(both.gimbal_rate[1:], [np.abs(run.rate).max(axis=0) for run in (half, slow)])
    with pytest.raises(ArgumentError, match="fade"):
        simulate(replace(full, fade=-0.1), [], period=PERIOD)


def test_a_sine_of_specific_force_turns_an_unbalanced_gimbal() -> None:
    amplitude, moment, J, w = 0.2, 1e-3, 2e-3, 2.0 * np.pi * 10.0
    platform = read_platform(
        {
            "schema": 1,
            "name": "pendulum",
            "root": {"name": "base", "inertia": [1.0, 1.0, 1.0]},
            "gimbal": [{"name": "g", "parent": "base", "axis": [0, 1, 0], "inertia": [J, J, J]}],
            "unbalance": [{"body": "g", "moment": [moment, 0.0, 0.0]}],
        }
    )
    shaken = Sine(kind="force", axis=3, frequency_hz=10.0, amplitude=amplitude)
    run = simulate(begun(platform, q=np.zeros(1), start="rest", sines=(shaken,)), [], period=PERIOD)
    # J q'' = -(m r x f)_2 = m r a sin(w t)
    expected = moment * amplitude / (J * w**2) * (w * run.t - np.sin(w * run.t))
    np.testing.assert_allclose(run.q[:, 0], expected, rtol=0.0, atol=1e-5 * expected[-1])


def test_the_linear_model_of_a_held_root_under_gravity_is_what_a_run_does() -> None:
    """A gimbal balanced to a fraction of a millimetre: where gravity turned with the airframe it would not move so."""
    platform, q = replace(read_platform("drone_gimbal"), frictions=(), modes=()), np.array([0.2, -0.1, -0.7])
    sines = tuple(Sine(kind="rate", axis=k, frequency_hz=0.4 * k, amplitude=2e-3) for k in (1, 2, 3))
    run = simulate(begun(platform, q=q, duration=1.0, sines=sines), [], period=PERIOD, noise=False)
    fine = np.linspace(0.0, run.t[-1], 10 * (len(run.t) - 1) + 1)
    rates = [one.amplitude * np.sin(2.0 * np.pi * one.frequency_hz * fine) for one in sines]
    system, moved = state_space(linearise(platform, q=q)), np.abs(run.q - q).max()
    off = []
    for A in (system.A, np.where(np.arange(9) < 6, system.A, 0.0)):
        linear = control.forced_response(control.ss(A, system.B[:, 3:], system.C, 0), fine, rates).outputs.T[::10]
        off.append(np.abs(run.q - q - linear).max() / moved)
    assert off[0] < 1e-3
    assert off[1] > 0.5


def test_base_motion_is_attenuated_as_friction_and_rate_loop_say() -> None:
    """J w' = -c (w - base) - k w of the payload's inertial rate w."""
    job = read_job(JOB | {"campaign": {"runs": 1}})
    run = rerun(plan(job, [damped()]), 0).run
    found = {one.name: one for one in run.results}
    s = 2j * np.pi * HZ
    J = job.platform.gimbals[1].inertia[1, 1]
    share = abs(FRICTION / (J * s + FRICTION + GAIN))
    attenuation = found["attenuation of base motion, simulated"]
    assert attenuation.value == pytest.approx(-20.0 * np.log10(share), abs=0.01)
    assert attenuation.sense == "at least"
    assert attenuation.passed
    rms = 0.2 * share / np.sqrt(2.0)
    assert found["line-of-sight rate, rms"].value == pytest.approx(rms, rel=1e-3)
    # About zero: from rest the angle goes to and fro about another one than it had.
    angle = run.trajectory.line_of_sight[run.trajectory.t >= 0.25 - 1e-9, 3]
    assert angle.std() == pytest.approx(rms / abs(s), rel=1e-3)
    assert found["line-of-sight angle, rms"].value == pytest.approx(np.sqrt(np.mean(angle**2)), rel=1e-9)
    assert found["largest gimbal rate"].value == np.abs(run.trajectory.rate).max()
    assert "los_rate1" in attenuation.evidence


def test_a_bias_of_a_gyro_is_in_the_line_of_sight_that_is_judged() -> None:
    """The loop drives reading and bias together to zero: the payload turns at a constant rate, which a mean hides."""
    bias = 2e-3
    sensors = [one | {"bias": bias} if one["name"] == "gyro2" else one for one in JOB["plant"]["rate_sensor"]]
    plant = {**JOB["plant"], "rate_sensor": sensors, "friction": []}
    again = rerun(plan(read_job(JOB | {"plant": plant, "campaign": {"runs": 1}}), [damped()]), 0)
    found = {one.name: one.value for one in again.run.results}
    assert found["line-of-sight rate, rms"] == pytest.approx(bias, rel=1e-2)
    # From rest after J/k: an angle that grows.
    assert found["line-of-sight angle, rms"] > 0.5 * bias * 0.75
    assert again.metrics["los_rate_rms"] == pytest.approx(found["line-of-sight rate, rms"], rel=1e-9)


def test_a_commanded_rate_is_judged_without_the_bias_of_its_gyro() -> None:
    data = commanded_job([{"reading": "gyro", "ramp": 0.5}], limits={"rate_following_error": 1e-3})
    data["plant"]["rate_sensor"][0]["bias"] = 0.01
    data["manoeuvre"][0]["settle"] = 0.5
    job = read_job(data)
    made = design.loops(job)
    controllers = [one.closed.controller for one in made]
    [error] = check_job(job, made).runs[0].results
    assert error.value == pytest.approx(0.01, rel=0.05)
    batch = simulate_batch([job.scenario(job.manoeuvres[0])], controllers, period=job.sampling.period, noise=True)
    assert batch.rate_following_error.max() == pytest.approx(error.value, rel=1e-9)
