"""Loops on bearings whose bristles stick: springs there, which a loop that slides stably may shake."""

import control
import numpy as np
import pytest

import platform_ctrl as pc
from given_controllers import verdict
from one_axis import job_of, loop_of, one_axis
from platform_ctrl import simulation

J, STIFFNESS, DAMPING, VISCOUS = 0.05, 2000.0, 0.2, 0.02
PERIOD, DELAY = 1e-3, 5e-3


def checked(**friction):
    """A gimbal with a lead of 60 rad/s that is 5 ms late; its coupled check."""
    own = {"friction": [{"gimbal": "g", "viscous": VISCOUS, "coulomb": 0.5} | friction]}
    plant = one_axis([J] * 3, {"mode": "held"}, torquer=[{"gimbal": "g"}], pickoff=[{"gimbal": "g"}], **own)
    read = pc.read_job(job_of(plant, loop_of("g", "q"), rate_hz=1 / PERIOD, delay=DELAY))
    s, w = control.tf("s"), 60.0
    law = control.ss(control.sample_system(-J * w**2 * (1 + 1.4 * s / w) / (1 + s / (8 * w)), PERIOD, "tustin"))
    controller = control.StateSpace(law.A, law.B, law.C, law.D, PERIOD, inputs=["q"], outputs=["Qg"])
    return read, controller, verdict(read, [controller]).coupled


def test_a_loop_that_slides_stably_is_unstable_where_bristles_stick_as_the_run_is():
    assert checked()[2].stable_at_all_angles  # a joint that stops does not move at all
    read, controller, check = checked(bristle_stiffness=STIFFNESS, bristle_damping=DAMPING)
    found = check.results[0]
    assert check.stable
    assert not found.passed
    assert "bristles of bearings stick" in found.evidence
    # The sampled loop around the spring.
    plant = control.ss(control.tf([1], [J, DAMPING + VISCOUS, STIFFNESS]))
    late = control.sample_system(plant, PERIOD, "zoh")
    for _ in range(round(DELAY / PERIOD)):
        late = late * control.ss([[0]], [[1]], [[1]], [[0]], PERIOD)
    poles = control.feedback(late, controller, sign=1).poles()
    growth = np.log(np.abs(poles).max()) / PERIOD
    assert -found.value == pytest.approx(growth, rel=1e-6)
    at = simulation.Scenario(platform=read.platform, mode="caged", duration=1.0, delay=DELAY, q=[1e-9])
    run = simulation.simulate(at, [controller], period=PERIOD, step=1e-4, noise=False)
    early, later = (np.abs(run.q[a : a + 200, 0]).max() for a in (200, 500))
    assert later < 0.01 * 0.5 / STIFFNESS  # of where bristles slide
    assert np.log(later / early) / 0.3 == pytest.approx(growth, rel=0.05)
