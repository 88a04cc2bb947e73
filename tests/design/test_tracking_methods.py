"""A tracking loop by every method that designs one: commands of the rate loop from a late tracker."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from camera_job import tracking_loop
from commanded_gimbal import commanded_job
from platform_ctrl import analysis, read_job
from platform_ctrl.design import loops

DELAY = 0.005


def job_of(method: str, **rate_design: Any) -> dict[str, Any]:
    job = commanded_job([], **rate_design) | {"manoeuvre": []}
    job["plant"]["attitude_sensor"][0]["delay"] = DELAY
    limits = {"disk_margin": 0.5, "steady_error": 1e-6}
    job["loop"].append(tracking_loop(limits, "loop", "heading", name="own", method=method))
    return job


@pytest.mark.parametrize("method", ["pi", "hinf", "lqg"])
def test_a_tracking_loop_leaves_no_error(method: str) -> None:
    tracking, rate = loops(read_job(job_of(method)))
    closed = tracking.closed
    assert closed.passed
    assert closed.controller.input_labels == ["heading"]
    assert closed.controller.output_labels == ["gyro_command"]
    assert rate.closed.controller.input_labels == ["gyro", "gyro_command"]
    # Its own integrator, and that of the gimbal behind the rate loop: the gain rises by the square of the period.
    assert np.abs(closed.controller.poles() - 1.0).min() < 1e-9


def test_a_rate_loop_passes_the_commands_of_a_loop_around_it_through_its_filter() -> None:
    plain, shaped = (
        loops(read_job(job_of("pi", **more)))[0].closed.plants for more in ({}, {"command": {"filter_hz": 5.0}})
    )
    assert plain is not None
    assert shaped is not None
    w, f = np.array([3.0, 30.0]), 10.0 * np.pi
    ratio = [analysis.frequency_response(one.system()[["heading"], ["gyro_command"]], w) for one in (shaped, plain)]
    np.testing.assert_allclose(ratio[0].ravel() / ratio[1].ravel(), (f / (1j * w + f)) ** 2, rtol=2e-3)
