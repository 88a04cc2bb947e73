"""Runs flown sample by sample: in pieces they are the whole run, and inputs act as those of a scenario."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from campaign_runs import JOB
from platform_ctrl.errors import ArgumentError, SimulationError
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.job.reading import read_job
from platform_ctrl.simulation import Scenario, Simulator, TimeTable, simulate


@pytest.fixture(scope="module")
def gyro() -> tuple[Job, list[control.StateSpace]]:
    """A job with short runs, and controllers that act across the axes of a gyro."""
    job = read_job(JOB)
    period, pairs = job.sampling.period, [("alpha9", "Q10"), ("beta10", "Q9")]
    return job, [
        control.ss([[0.9]], [[0.1]], [[-40.0]], [[-60.0 - k]], period, inputs=[y], outputs=[u], name=f"{y} to {u}")
        for k, (y, u) in enumerate(pairs)
    ]


@pytest.mark.parametrize("name", ["turn", "step"])
def test_a_run_in_pieces_is_the_run_to_the_last_bit(gyro, name):
    job, controllers = gyro
    scenario = manoeuvre_scenario(job, next(one for one in job.manoeuvres if one.name == name))
    whole = simulate(scenario, controllers, period=job.sampling.period)
    stepper = Simulator(scenario, controllers, period=job.sampling.period)
    parts = [stepper.now, stepper.advance(1), stepper.advance(7)]
    kept = stepper.snapshot()
    once = stepper.advance(11)
    stepper.restore(kept)
    assert np.array_equal(stepper.now.q, parts[-1].q[-1:])
    again = stepper.advance(11)
    parts += [again, stepper.advance(len(whole.t) - 20)]
    assert np.array_equal(once.reading, again.reading)
    for column in ("t", "q", "rate", "p", "reading", "command", "torque", "Omega", "attitude"):
        assert np.array_equal(np.concatenate([getattr(part, column) for part in parts]), getattr(whole, column)), column
    assert np.array_equal(stepper.now.saturated, whole.saturated)


def test_Omega_held_or_sloping_is_a_time_table_flown_step_by_step(gyro):
    job, controllers = gyro
    period = job.sampling.period
    points = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.2], [0.3, 0.1, 0.0], [0.3, 0.1, 0.0]]
    table = TimeTable(t=np.array([0.0, 10 * period, 25 * period, 40 * period]), values=np.array(points))
    scenario = Scenario(platform=job.platform, mode="caged", duration=40 * period, delay=job.sampling.delay)
    expected = simulate(replace(scenario, Omega_table=table), controllers, period=period)
    # On a table of the scenario's own, input and table add up: half of each.
    half = replace(scenario, Omega_table=replace(table, scale=0.5))
    for stepped, share in ((scenario, 1.0), (half, 0.5)):
        stepper = Simulator(stepped, controllers, period=period)
        found = [stepper.now]
        for a, b, samples in ((0, 1, 10), (1, 2, 15), (2, 3, 15)):
            slope = (np.array(points[b]) - points[a]) / (samples * period)
            found.append(stepper.advance(samples, Omega=share * np.array(points[a]), Omega_rate=share * slope))
        q, Omega = (np.concatenate([getattr(one, name) for one in found]) for name in ("q", "Omega"))
        assert Omega == pytest.approx(expected.Omega, rel=1e-12, abs=1e-15)
        assert q == pytest.approx(expected.q, rel=1e-9, abs=1e-12 * np.abs(expected.q).max())


def test_a_jump_of_Omega_leaves_angles_and_joint_momenta(gyro):
    job, _ = gyro
    stepper = Simulator(
        Scenario(platform=job.platform, mode="caged", duration=1.0, delay=0.0), [], period=1e-5, step=1e-5
    )
    before = stepper.advance(3)
    after = stepper.advance(1, Omega=[0.0, 0.5, 0.0])
    assert not before.rate.any()
    assert after.Omega[0] == pytest.approx([0.0, 0.5, 0.0])
    # At rest against inertial space the joints about axis 2 turn back against the platform, all but for what the
    # rotors do to them in one step.
    coupled = [k for k, gimbal in enumerate(job.platform.gimbals) if abs(gimbal.axis[1]) == 1.0]
    assert after.rate[0, coupled] == pytest.approx([-0.5] * len(coupled), rel=0.05)
    assert np.abs(after.q).max() < 1e-5
    assert np.abs(after.p).max() < 1e-3 * np.abs(after.rate).max()


def test_torques_given_on_the_way_are_those_of_the_scenario(gyro):
    job, controllers = gyro
    period, n = job.sampling.period, len(job.platform.gimbals)
    scenario = Scenario(platform=job.platform, mode="stabilised", duration=20 * period, delay=job.sampling.delay)
    expected = simulate(replace(scenario, torque=np.array([0.1, 0.0, -0.2])), controllers, period=period)
    stepper = Simulator(scenario, controllers, period=period)
    assert np.array_equal(stepper.advance(20, torque=[0.1, 0.0, -0.2]).q, expected.q[1:])
    # A torquer that is commanded a constant torque, and a torque beside it that takes it away again.
    pushed = control.ss([], [], [], [[0.0]], period, inputs=["alpha9"], outputs=["Q9"])
    stepper = Simulator(replace(scenario, delay=0.0), [pushed], period=period)
    acting_on = np.zeros(n)
    acting_on[job.platform.gimbal_names.index("9")] = 1e-3
    moved = stepper.advance(10, gimbal_torque=acting_on).q[-1]
    assert abs(moved[job.platform.angle_names.index("alpha9")]) > 1e-6
    held = stepper.advance(10)
    free = Simulator(replace(scenario, delay=0.0), [pushed], period=period).advance(20, gimbal_torque=acting_on)
    assert np.array_equal(held.q[-1], free.q[-1])


def test_a_stepper_says_what_it_cannot_do(gyro):
    job, controllers = gyro
    period = job.sampling.period
    caged = Simulator(
        Scenario(platform=job.platform, mode="caged", duration=0.0, delay=0.0), controllers, period=period
    )
    with pytest.raises(ArgumentError, match="torque: has no effect in mode 'caged', only in mode 'stabilised'"):
        caged.advance(1, torque=[0.0, 0.0, 0.0])
    with pytest.raises(ArgumentError, match=r"samples must .*got 0"):
        caged.advance(0)
    with pytest.raises(ArgumentError, match=r"Omega must .*got \(2,\)"):
        caged.advance(1, Omega=[0.0, 0.0])
    with pytest.raises(ArgumentError, match=r"snapshot must .*got \(1,\)"):
        caged.restore([1.0])
    free = Scenario(platform=job.platform, mode="stabilised", duration=0.0, delay=0.0)
    with pytest.raises(ArgumentError, match="Omega: has no effect in mode 'stabilised', only in mode 'caged'"):
        Simulator(free, controllers, period=period, Omega=[0.0, 0.0, 0.0])
    assert caged.sample == 0
    ended = caged.advance(5, gimbal_torque=np.full(len(job.platform.gimbals), 1e300))
    assert not caged.going
    assert ended.ended == "diverged at t = 0.0005 s"
    assert len(ended.t) == 0
    with pytest.raises(SimulationError, match=r"the run has diverged at t = 0\.0005 s"):
        caged.advance(1)
