"""The search behind `tune = true`: where nothing gets better it neither runs to infinity nor fails."""

from __future__ import annotations

import math
from typing import Any

import pytest

import platform_ctrl as pc
from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.design import tuning
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.classical.caging import classical_controller, starting_values
from platform_ctrl.design.partition import channels
from platform_ctrl.design.plants import plants_of
from platform_ctrl.job.requirements import loop_requirements

GIMBALS = ("outer", "inner")
JOB = {
    "schema": 2,
    "name": "a margin that no loop has",
    "plant": "gimballed_gyro",
    "operation": {"Omega": [0.0, 0.0, 0.0]},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "caging",
            "kind": "caging",
            "gimbals": list(GIMBALS),
            "use": "classical",
            "limits": {"disk_margin": 1.9},
            "design": [{"name": "classical", "method": "classical", "tune": True}],
        }
    ],
}


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_options_stay_within_reach_of_their_start(direction: float, monkeypatch: pytest.MonkeyPatch) -> None:
    job = pc.read_job(JOB)
    [spec] = job.loops
    plants = plants_of(job, spec)
    assert plants is not None
    channel = channels(pc.linearise(job.platform), rows_of(pc.linearise(job.platform), GIMBALS))
    start = starting_values({}, channel, plants.nutation, plants.period)
    tried: list[float] = []

    def build(options: dict[str, float]) -> StateArrays:
        tried.append(options["crossover_hz"] / start["crossover_hz"])
        return classical_controller(options, channel, plants.period)

    def downhill(*anything: Any) -> float:
        return 9.0 / (1.0 + math.exp(0.01 * direction * math.log(tried[-1])))

    monkeypatch.setattr(tuning, "worst_ratio", downhill)
    tuned = tuning.tune(start, ["crossover_hz"], build, plants, loop_requirements(spec.limits), evaluations=100)
    assert max(direction * math.log10(one) for one in tried) > 5.9
    assert all(0.99e-6 <= one <= 1.01e6 for one in tried)
    assert math.isfinite(tuned["crossover_hz"])


def test_what_need_not_move_keeps_its_number_to_the_last_digit() -> None:
    job = pc.read_job(JOB)
    [spec] = job.loops
    plants = plants_of(job, spec)
    assert plants is not None
    channel = channels(pc.linearise(job.platform), rows_of(pc.linearise(job.platform), GIMBALS))
    # exp(log(7)) is 6.999999999999999, and exp(log(900)) is 900.0000000000001.
    given = {"crossover_hz": 40.0, "lead_hz": 7.0, "rolloff_hz": 900.0}
    start = starting_values(given, channel, plants.nutation, plants.period)
    required = loop_requirements(spec.limits | {"disk_margin": 0.01})

    def build(options: dict[str, float]) -> StateArrays:
        return classical_controller(options, channel, plants.period)

    assert tuning.tune(start, list(start), build, plants, required, evaluations=5) == start
