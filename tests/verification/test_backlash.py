"""Play of a gear: the limit cycle that the check predicts against runs of the non-linear plant."""

import control
import numpy as np
import pytest

import platform_ctrl as pc
from given_controllers import verdict
from one_axis import job_of, loop_of, one_axis
from platform_ctrl import simulation

J1, J2, K, C, PLAY = 0.02, 0.05, 300.0, 0.04, 2e-3
PERIOD, DELAY, SECONDS = 5e-4, 2e-4, 30.0


def law(inertia, w, rate=False):
    """Return a lead with integral for a rigid inertia, with its zero near w, or a PI of its rate, sampled."""
    s = control.tf("s")
    one = -0.4 * inertia * w**2 * (1 + 2.5 * s / w + 0.15 * w / s) / (1 + s / (8 * w)) ** 2
    if rate:
        one = -inertia * w * (1 + 0.2 * w / s) / (1 + s / (8 * w)) ** 2
    return control.ss(control.sample_system(one, PERIOD, "tustin"))


def checked(sensor, crossover, weight=0.0, play=PLAY, stiffness=K, **coupled):
    """A motor and a load on a shaft with play, a loop on an encoder or a gyro on the load; the coupled check."""
    rate = sensor == "gyro"
    plant = one_axis(
        [J2] * 3,
        {"mode": "held", "specific_force": [0, 9.81, 0]},
        torquer=[{"gimbal": "g"}],
        pickoff=[{"gimbal": "g"}],
        angle_sensor=[{"name": "motor", "gimbal": "g_motor"}],
        rate_sensor=[{"name": "gyro", "body": "g", "axis": [0, 0, 1]}],
        friction=[{"gimbal": "g", "viscous": 0.02}],
        unbalance=[{"body": "g", "moment": [weight / 9.81, 0, 0]}],
        compliance=[{"gimbal": "g", "stiffness": stiffness, "damping": C, "inertia": J1, "play": play}],
    )
    kind, method = ("rate", "pi") if rate else ("pointing", "classical")
    loop = loop_of(["g_motor"], [sensor], method, kind=kind)
    read = pc.read_job(job_of(plant, loop, rate_hz=1 / PERIOD, delay=DELAY, coupled=coupled))
    one = law(J1 + J2, crossover, rate)
    controller = control.StateSpace(one.A, one.B, one.C, one.D, PERIOD, inputs=[sensor], outputs=["Qg"])
    check = verdict(read, [controller]).coupled
    [found] = [one for one in check.results if "limit cycle" in one.name] or [None]
    return read, controller, check, found


def oscillation(read, controller, start, step=1e-4, angle=0):
    """Return amplitude and frequency (Hz) of the fundamental of the load at the end of a run."""
    n = len(read.platform.angle_names)
    q, begin = [start, *[0.0] * (n - 1)], "equilibrium" if start == 0.0 else "rest"
    at = simulation.Scenario(platform=read.platform, mode="caged", duration=SECONDS, delay=DELAY, q=q, start=begin)
    run = simulation.simulate(at, [controller], period=PERIOD, step=step, noise=False)
    y = run.q[len(run.t) // 2 :, angle] - run.q[len(run.t) // 2 :, angle].mean()
    up = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    if np.abs(y).max() < 0.01 * PLAY or len(up) < 2:
        return np.abs(y).max(), 0.0
    cycles, y = len(up) - 1, y[up[0] : up[-1]]
    turns = np.exp(-2j * np.pi * cycles * np.arange(len(y)) / len(y))
    return 2 * abs(np.mean(y * turns)), cycles / (len(y) * PERIOD)


@pytest.mark.parametrize(("sensor", "crossover"), [("q", 8.0), ("q", 20.0), ("motor", 8.0), ("gyro", 20.0)])
def test_a_limit_cycle_has_the_amplitude_and_the_frequency_of_the_run(sensor, crossover):
    read, controller, check, found = checked(sensor, crossover)
    assert check.stable
    assert not found.passed
    amplitude, hertz = oscillation(read, controller, start=4e-3)
    assert found.value == pytest.approx(amplitude, rel=0.1)
    assert float(found.evidence.split("limit cycle of ")[1].split(" Hz")[0]) == pytest.approx(hertz, rel=0.1)
    assert "play 2 mrad of the drive of gimbal g" in found.evidence
    assert "preload the gear" in found.evidence


def test_a_gear_whose_stiffness_is_far_above_the_loops_has_a_limit_cycle_too():
    # With its motor locked the load swings at 320 Hz, at the loop's 9 Hz with less than a thousandth of the stiffness.
    read, controller, check, found = checked("q", 8.0, stiffness=2e5)
    assert check.stable
    assert not found.passed
    amplitude, hertz = oscillation(read, controller, start=4e-3, step=5e-5)
    assert amplitude < found.value < 1.25 * amplitude  # its peaks are higher than its fundamental
    assert float(found.evidence.split("limit cycle of ")[1].split(" Hz")[0]) == pytest.approx(hertz, rel=0.2)


@pytest.mark.parametrize(("sensor", "crossover", "weight"), [("motor", 30.0, 0.0), ("q", 20.0, 3.0)])
def test_a_drive_whose_loop_or_weight_keeps_its_teeth_together_comes_to_rest(sensor, crossover, weight):
    read, controller, _, found = checked(sensor, crossover, weight)
    assert found.passed
    assert found.value == 0.0
    amplitude, _ = oscillation(read, controller, start=4e-3 if not weight else 0.0)
    assert amplitude < 0.01 * PLAY


def test_a_limit_cycle_counts_where_it_moves_a_gimbal_most():
    # The inner gimbal turns about the outer one's axis: the outer drive moves it more than its own does.
    common = {"axis": [0, 0, 1], "inertia": [0.1] * 3}
    inner = common | {"name": "b", "parent": "a", "inertia": [0.04] * 3, "angle": "qb"}
    sides = [("a", 600.0, 0.03, 2e-3), ("b", 300.0, 0.02, 1e-3)]
    plant = {
        "schema": 1,
        "name": "two drives",
        "root": {"name": "base", "inertia": [1, 1, 1], "mode": "held"},
        "gimbal": [common | {"name": "a", "parent": "base", "angle": "qa"}, inner],
        "torquer": [{"gimbal": name} for name in "ab"],
        "pickoff": [{"gimbal": name} for name in "ab"],
        "friction": [{"gimbal": name, "viscous": 0.02} for name in "ab"],
        "compliance": [
            {"gimbal": name, "stiffness": k, "damping": 0.05, "inertia": J, "play": play} for name, k, J, play in sides
        ],
    }
    loop = loop_of(["a_motor", "b_motor"], ["qa", "qb"])
    read = pc.read_job(job_of(plant, loop, rate_hz=1 / PERIOD, delay=DELAY, coupled={}))
    one = control.append(law(0.19, 8.0), law(0.06, 10.4))
    matrices = (one.A, one.B, one.C, one.D, PERIOD)
    controller = control.StateSpace(*matrices, inputs=["qa", "qb"], outputs=["Qa", "Qb"])
    found = [one for one in verdict(read, [controller]).coupled.results if "limit cycle" in one.name]
    amplitude, _ = oscillation(read, controller, start=4e-3, angle=1)
    assert len(found) == 2
    for result in found:
        assert amplitude < result.value < 1.3 * amplitude
    assert "gimbal b moves most, with what other drives add" in found[0].evidence


def test_a_limit_says_how_large_a_limit_cycle_may_be():
    assert checked("q", 8.0, limit_cycle=5e-4)[3].passed
    assert not checked("q", 8.0, limit_cycle_arcsec=60.0)[3].passed
    assert checked("q", 8.0, play=0.0, limit_cycle=5e-4)[3] is None
    assert checked("q", 30.0)[3] is None  # unstable without play
