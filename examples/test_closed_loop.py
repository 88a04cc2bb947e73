"""A regression test to keep beside a project: the caged gyro 9-10 must not get worse.

    pytest examples/test_closed_loop.py

The loop is designed from fixed numbers, or read from the result.json named in CONTROLLERS; every value is computed
anew from the closed loop, and compared with the limits of the job and with a result that was once accepted:
gyro_9_10.json, beside this file. Whoever changes the plant, the controller or this package and makes the loop worse by
more than the tolerance gets a failed test that says which value, and by how much. When the change is wanted, replace
gyro_9_10.json by the result.json of the loop as it is now.

The fixture is that of the package's pytest plugin. Where the package is on the path and not installed, pytest has to
be told of it: `pytest -p platform_ctrl.cli.testing.plugin`.
"""

from __future__ import annotations

from collections.abc import Callable

from platform_ctrl.cli.testing import assert_requirements
from platform_ctrl.verification.verdict import JobResult

CONTROLLERS = None  # or "../out/result.json", as `platform-ctrl design` writes it
CONTROLLER = {
    "name": "PI across, lead along",
    "method": "classical",
    "crossover_hz": 70,
    "integral_hz": 2,
    "damping_hz": 78,
    "damping2_hz": 92,
    "lead_hz": 7,
    "rolloff_hz": 900,
    "notch_hz": 200,
    "notch_depth": 0.7,
    "notch_width": 0.15,
}
JOB = {
    "schema": 2,
    "name": "gyro 9-10",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [0.0, 0.0, 0.0]},
    "tolerance": 0.02,
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "caging 9-10",
            "kind": "caging",
            "gimbals": ["9", "10"],
            "use": CONTROLLER["name"],
            "limits": {"bandwidth_hz": 40, "disk_margin": 0.5, "damping": 0.1, "torque_noise": 0.005},
            "design": [CONTROLLER],
        }
    ],
}

ClosedLoop = Callable[..., JobResult]


def test_the_loop_does_what_is_asked(closed_loop: ClosedLoop) -> None:
    """Fail where a limit of the job is not met."""
    assert_requirements(closed_loop(JOB, CONTROLLERS))


def test_the_loop_is_not_worse_than_what_was_accepted(closed_loop: ClosedLoop) -> None:
    """Fail where a value is worse than the accepted one by more than the tolerance of the job."""
    closed_loop(JOB, CONTROLLERS, baseline="gyro_9_10.json")
