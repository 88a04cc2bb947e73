"""Campaigns that vary what drives feed forward and what loops are commanded: each run is a run of a job with it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import control
import pytest

from campaign_runs import processes_here
from driven_gimbal import COULOMB, FRICTION, driven_job
from platform_ctrl import read_job
from platform_ctrl.campaign import plan, rerun, run_campaign
from platform_ctrl.errors import InputError
from platform_ctrl.simulation import simulate_batch

K = control.ss([], [], [], [[-2.0, 2.0]], 0.001, inputs=["gyro", "gyro_command"], outputs=["Qouter"], name="K")


def job(friction: float = COULOMB, step: float = 0.2) -> Any:
    vary = {"distribution": "uniform", "low": 0.7, "high": 1.3, "relative": True}
    own = {"parameter": "command.gyro.step", "distribution": "uniform", "low": 0.1, "high": 0.3}
    campaign = {"runs": 4, "vary": [{"parameter": "drive.Qouter.friction", **vary}, own]}
    data = driven_job(FRICTION | {"friction": friction}, campaign=campaign)
    data["manoeuvre"][0] |= {"duration": 0.2, "command": [{"reading": "gyro", "step": step, "at": 0.02}]}
    return read_job(data)


def test_a_campaign_with_varied_friction_fed_forward_is_separate_runs_bit_for_bit() -> None:
    made = plan(job(), [K])
    found = [rerun(made, run) for run in range(4)]
    assert len({one.metrics["angle"] for one in found}) == 4
    for run, one in enumerate(found):
        factor, step = one.inputs["drive.Qouter.friction"], one.inputs["command.gyro.step"]
        own = job(friction=COULOMB * factor, step=step)
        scenario = dataclasses.replace(own.scenario(own.manoeuvres[0]), seed=made.noise_seed, run=run)
        alone = simulate_batch([scenario], [K], period=0.001, step=made.step)
        assert alone.angle.max() == one.metrics["angle"]
        drawn = made.scenario(run)
        assert (scenario.drives[0].friction, scenario.commands[0].step) == (
            drawn.drives[0].friction,
            drawn.commands[0].step,
        )


def test_runs_with_other_drives_are_another_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kept runs are continued only by runs that follow from the same: what drives feed forward moves the gimbals."""
    monkeypatch.setattr("platform_ctrl.campaign.engine.processes_here", processes_here)
    run_campaign(plan(job(), [K]), tmp_path, workers=1)
    with pytest.raises(InputError, match="another job"):
        run_campaign(plan(job(friction=0.8 * COULOMB), [K]), tmp_path, workers=1)
