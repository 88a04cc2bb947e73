"""Drives of torquers are read, written and judged; the weights of their sensors follow from kinematics."""

from __future__ import annotations

import pytest

from driven_gimbal import FRICTION, driven_job
from platform_ctrl import read_job
from platform_ctrl.errors import InputError


@pytest.mark.parametrize(
    ("sensors", "weights", "feedback"),
    [
        (["base_yaw"], {"base_yaw": -1.0}, False),
        (["base_pitch", "base_oblique"], {"base_pitch": 0.75, "base_oblique": -1.25}, False),
        (["base_yaw", "base_pitch"], {"base_yaw": -1.0}, False),
        (["tacho"], {"tacho": 1.0}, True),
    ],
)
def test_weights_follow_from_the_sensing_axes(sensors: list[str], weights: dict[str, float], feedback: bool) -> None:
    (law,) = read_job(driven_job(FRICTION | {"sensors": sensors})).drive_laws
    assert law.weights.keys() == weights.keys()
    assert law.weights == pytest.approx(weights, rel=1e-12)
    assert law.feedback is feedback


def test_the_computer_does_not_know_a_misalignment() -> None:
    job = driven_job(FRICTION)
    job["plant"]["rate_sensor"][2]["misalignment"] = [0.01, 0.02, 0.0]
    assert read_job(job).drive_laws[0].weights == pytest.approx({"base_yaw": -1.0}, rel=1e-12)


def test_a_base_that_a_loop_moves_gives_no_feedforward() -> None:
    job = driven_job(FRICTION)
    job["plant"]["torquer"] += [{"root_axis": axis} for axis in (1, 2, 3)]
    job["loop"].append(
        {
            "name": "platform",
            "kind": "stabilisation",
            "use": "own",
            "design": [{"name": "own", "method": "platform-servo"}],
        }
    )
    with pytest.raises(InputError, match="base_yaw turn with 'base', which a loop of the job moves"):
        read_job(job)


def test_a_drive_may_state_that_it_feeds_nothing_forward() -> None:
    (drive,) = read_job(driven_job(FRICTION | {"friction": 0.0})).drives
    assert (drive.friction, drive.sensors) == (0.0, ("base_yaw",))
