"""Campaigns that vary what drives feed forward and what loops are commanded: each run is a run of a job with it."""

from __future__ import annotations

from typing import Any

import control

from driven_gimbal import COULOMB, FRICTION, driven_job
from platform_ctrl import read_job
from platform_ctrl.campaign import plan
from platform_ctrl.campaign.single_run import simulate_runs
from platform_ctrl.campaign.store import identity
from platform_ctrl.common.values import replaced
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
    columns = simulate_runs(made, range(4))
    factors, steps = columns["drive.Qouter.friction"], columns["command.gyro.step"]
    assert len({*columns["angle"].tolist()}) == 4
    for run, (factor, step) in enumerate(zip(factors.tolist(), steps.tolist(), strict=True)):
        own = job(friction=COULOMB * factor, step=step)
        scenario = replaced(own.scenario(own.manoeuvres[0]), {"seed": made.noise_seed, "run": run})
        alone = simulate_batch([scenario], [K], period=0.001, step=made.step)
        assert alone.angle.max() == columns["angle"][run]
        drawn = made.scenario(run)
        assert (scenario.drives[0].friction, scenario.commands[0].step) == (
            drawn.drives[0].friction,
            drawn.commands[0].step,
        )


def test_runs_with_other_drives_are_another_campaign() -> None:
    """Kept runs are continued only by runs that follow from the same: what drives feed forward moves the gimbals."""
    one, other = (identity(plan(job(friction=friction), [K])) for friction in (COULOMB, 0.8 * COULOMB))
    assert {key for key in one if one[key] != other[key]} == {"job"}
