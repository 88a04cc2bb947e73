"""Campaigns that vary what drives feed forward and what loops are commanded: each run is a run of a job with it."""

from __future__ import annotations

import control

from platform_ctrl.campaign.identity import identity
from platform_ctrl.campaign.planning import plan
from platform_ctrl.campaign.single_run import simulate_runs
from platform_ctrl.common.values import replaced
from platform_ctrl.job.job import Job, manoeuvre_scenario
from platform_ctrl.job.reading import read_job
from platform_ctrl.simulation import simulate_batch

K = control.ss([], [], [], [[-2.0, 2.0]], 0.001, inputs=["rate", "rate_command"], outputs=["Qpitch"], name="K")


def job(friction: float = 0.05, step: float = 0.2) -> Job:
    return read_job(
        {
            "schema": 2,
            "name": "one gimbal",
            "plant": {
                "schema": 1,
                "name": "gimbal with dry friction",
                "source": "assumed",
                "root": {"name": "case", "inertia": [1.0, 1.0, 1.0]},
                "gimbal": [{"name": "pitch", "parent": "case", "axis": [0, 1, 0], "inertia": [0.1, 0.1, 0.1]}],
                "torquer": [{"gimbal": "pitch", "name": "Qpitch"}],
                "rate_sensor": [
                    {"name": "rate", "body": "pitch", "axis": [0, 1, 0]},
                    {"name": "own", "body": "pitch", "axis": [0, 1, 0], "frame": "parent"},
                ],
                "friction": [{"gimbal": "pitch", "viscous": 0.01, "coulomb": 0.05}],
            },
            "operation": {"Omega": [0.1, 0.1, 0.1]},
            "sampling": {"rate_hz": 1000, "delay": 0.0005},
            "loop": [
                {
                    "name": "pitch",
                    "kind": "rate",
                    "gimbals": ["pitch"],
                    "sensors": ["rate"],
                    "use": "pi",
                    "design": [{"name": "pi", "method": "pi"}],
                }
            ],
            "drive": [{"torquer": "Qpitch", "friction": friction, "friction_rate": 0.02, "sensors": ["own"]}],
            "manoeuvre": [
                {
                    "name": "turn",
                    "mode": "caged",
                    "axis": 2,
                    "duration": 0.2,
                    "rate": 0.1,
                    "rise": 0.05,
                    "hold": 0.1,
                    "command": [{"reading": "rate", "step": step, "at": 0.02}],
                }
            ],
            "campaign": {
                "runs": 4,
                "vary": [
                    {
                        "parameter": "drive.Qpitch.friction",
                        "distribution": "uniform",
                        "low": 0.7,
                        "high": 1.3,
                        "relative": True,
                    },
                    {"parameter": "command.rate.step", "distribution": "uniform", "low": 0.1, "high": 0.3},
                ],
            },
        }
    )


def test_a_campaign_with_varied_friction_fed_forward_is_separate_runs_bit_for_bit() -> None:
    made = plan(job(), [K])
    columns = simulate_runs(made, range(4))
    factors, steps = columns["drive.Qpitch.friction"], columns["command.rate.step"]
    assert len({*columns["angle"].tolist()}) == 4
    for run, (factor, step) in enumerate(zip(factors.tolist(), steps.tolist(), strict=True)):
        own = job(friction=0.05 * factor, step=step)
        scenario = replaced(manoeuvre_scenario(own, own.manoeuvres[0]), {"seed": made.noise_seed, "run": run})
        alone = simulate_batch([scenario], [K], period=0.001, step=made.step)
        assert alone.angle.max() == columns["angle"][run]
        drawn = made.scenario(run)
        assert (scenario.drives[0].friction, scenario.commands[0].step) == (
            drawn.drives[0].friction,
            drawn.commands[0].step,
        )


def test_runs_with_other_drives_are_another_campaign() -> None:
    """Kept runs are continued only by runs that follow from the same: what drives feed forward moves the gimbals."""
    one, other = (identity(plan(job(friction=friction), [K])) for friction in (0.05, 0.04))
    assert {key for key in one if one[key] != other[key]} == {"job"}
