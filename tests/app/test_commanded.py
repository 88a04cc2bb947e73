"""The page with loops that are commanded: by a run, behind a filter, by a tracking loop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from commanded_gimbal import commanded_job
from platform_ctrl import design, read_job, verification
from platform_ctrl.app.backend import Backend
from platform_ctrl.job.writing import toml
from platform_ctrl.verification.controllers import outcomes_from, read_controllers

pytestmark = pytest.mark.usefixtures("untraced")
RATE_LIMITS = {"overshoot": 0.5, "settling_time": 9.0}
TRACKING = {
    "name": "track",
    "kind": "tracking",
    "around": "loop",
    "sensors": ["heading"],
    "use": "own",
    "limits": {"disk_margin": 0.5, "settling_time": 9.0},
    "design": [{"name": "own", "method": "pi"}],
}


def job_of(*loops: dict[str, Any], reading: str = "gyro", **rate_design: Any) -> dict[str, Any]:
    job = commanded_job([{"reading": reading, "step": 0.01}], **rate_design)
    job["loop"][0]["limits"] = RATE_LIMITS
    job["plant"]["attitude_sensor"][0]["delay"] = 0.005
    job["loop"] += loops
    job["manoeuvre"][0] |= {"duration": 0.01}
    return job


def test_a_design_with_a_filter_is_measured_as_a_whole_and_delivered_with_it() -> None:
    job = read_job(job_of(command={"filter_hz": 4.0, "acceleration": True}))
    (outcome,) = design.loops(job)
    page = Backend(job)
    shown = {one.name: one.value for one in page.picture(page.start()).requirements}
    for one in outcome.closed.results:
        assert shown[one.name] == pytest.approx(one.value, rel=1e-6)
    (closed,) = page._loops.controllers(page.start())
    assert closed.system.input_labels == outcome.closed.controller.input_labels
    np.testing.assert_allclose(closed.system.A, outcome.closed.controller.A, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(closed.system.D, outcome.closed.controller.D, rtol=1e-9)
    page.close()


def test_a_tracking_loop_is_listed_as_fixed_checked_simulated_and_saved(tmp_path: Path) -> None:
    data = job_of(TRACKING, reading="heading")
    path, saved = tmp_path / "job.toml", tmp_path / "saved.toml"
    path.write_text(toml(data), encoding="utf-8")
    page, job = Backend(path), read_job(path)
    found = verification.check_job(job, design.loops(job))
    start = page.start()
    assert page.choices().loops == ("loop",)
    parts = page.job_parts.parts(start)
    for one in page.job_parts.open(parts):
        page.job_parts.measure(one)
    states = {one.chip.label: one for one in page.job_parts.states(parts)}
    assert list(states) == ["loop", "track (fixed)", "coupled", "runs"]
    tracking = found.loops[0].closed
    worst = states["track (fixed)"].worst
    assert worst is not None
    assert worst.value == pytest.approx(next(one.value for one in tracking.results if one.name == worst.name))
    whole = page._loops.coupled(start)
    np.testing.assert_allclose(whole.simultaneous.alpha, found.coupled.simultaneous.alpha, rtol=1e-6)
    run = page.simulate(start, "slew")
    np.testing.assert_allclose(run.q, found.runs[0].trajectory.q, rtol=1e-6, atol=1e-12)
    page.save(start, saved)
    again = outcomes_from(read_job(saved), read_controllers(tmp_path / "saved.controllers.json", read_job(saved)))
    assert [one.spec.name for one in again] == ["track", "loop"]
    assert Backend(saved).start().loop == "loop"
    page.close()
