"""The page with loops that are commanded: by a run, behind a filter, by a tracking loop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from commanded_gimbal import RATE_HZ, commanded_job
from platform_ctrl import design, read_job, verification
from platform_ctrl.app.backend import Backend
from platform_ctrl.common.files import toml
from platform_ctrl.verification.controllers import outcomes_from, read_controllers

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
    assert closed.input_labels == outcome.closed.controller.input_labels
    np.testing.assert_allclose(closed.A, outcome.closed.controller.A, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(closed.D, outcome.closed.controller.D, rtol=1e-9)
    page.close()


@pytest.mark.parametrize("every", [1, 20], ids=["at every sample", "at every 20th sample"])
def test_a_tracking_loop_is_shaped_checked_simulated_and_saved(tmp_path: Path, every: int) -> None:
    data = job_of(TRACKING | ({"rate_hz": RATE_HZ / every} if every > 1 else {}), reading="heading")
    path, saved = tmp_path / "job.toml", tmp_path / "saved.toml"
    path.write_text(toml(data), encoding="utf-8")
    page, job = Backend(path), read_job(path)
    found = verification.check_job(job, design.loops(job))
    start = page.start()
    assert [one.name for one in page.read.loops] == ["loop", "track"]
    parts = page.job_parts.parts(start)
    for one in page.job_parts.open(parts):
        page.job_parts.measure(one)
    states = {one.chip.label: one for one in page.job_parts.states(parts)}
    assert list(states) == ["loop", "track", "coupled", "runs"]
    for outcome in found.loops:
        at = page.chosen(start, loop=outcome.spec.name)
        shown = {one.name: one.value for one in page.picture(at).requirements}
        for one in outcome.closed.results:
            assert shown[one.name] == pytest.approx(one.value, rel=1e-6, abs=1e-12)
    at = page.chosen(start, loop="track")
    whole = page._loops.coupled(start)
    np.testing.assert_allclose(whole.simultaneous.alpha, found.coupled.simultaneous.alpha, rtol=1e-6)
    run = page.simulate(start, "slew")
    np.testing.assert_allclose(run.q, found.runs[0].trajectory.q, rtol=1e-6, atol=1e-12)
    faster = page.moved(at, "crossover_hz", 1.2 * at.options["track"]["own"]["crossover_hz"])
    page.save(faster, saved)
    again = outcomes_from(read_job(saved), read_controllers(tmp_path / "saved.controllers.json", read_job(saved)))
    assert [one.spec.name for one in again] == ["track", "loop"]
    reopened = Backend(saved)
    assert reopened.start().loop == "loop"
    crossover = [one.options["track"]["own"]["crossover_hz"] for one in (reopened.start(), faster)]
    assert crossover[0] == pytest.approx(crossover[1], rel=1e-3)
    page.close()


def test_a_tracking_loop_around_indirect_stabilisation_behind_a_filter_is_measured_as_designed() -> None:
    """Commands stand behind what the rate loop reads, the base's rates behind these."""
    shaped = {"filter_hz": 10.0, "acceleration": True}
    data = job_of(TRACKING | {"limits": {"disk_margin": 0.3}}, reading="heading", command=shaped)
    data["plant"]["rate_sensor"] += [{"name": "own", "body": "yaw", "axis": [0, 0, 1], "frame": "parent"}]
    data["plant"]["rate_sensor"] += [{"root_axis": 3}]
    fed = {"sensors": ["Omega3"], "into": "reading"}
    data["loop"][0]["design"][0] |= {"sensors": ["own"], "feedforward": fed}
    job = read_job(data)
    tracking, inner = design.loops(job)
    page = Backend(job)
    for one, name in ((inner, "loop"), (tracking, "track")):
        at = page.chosen(page.start(), loop=name)
        shown = {result.name: result.value for result in page.picture(at).requirements}
        for result in one.closed.results:
            assert shown[result.name] == pytest.approx(result.value, rel=1e-6, abs=1e-12), (name, result.name)
    for made, own in zip(page._loops.controllers(page.start()), (tracking, inner), strict=True):
        assert made.input_labels == own.closed.controller.input_labels
        assert made.output_labels == own.closed.controller.output_labels
        np.testing.assert_allclose(made.D, own.closed.controller.D, rtol=1e-9, atol=1e-12)
    page.close()
