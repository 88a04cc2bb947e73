"""The search behind `tune = true`: where nothing gets better it neither runs to infinity nor fails."""

from __future__ import annotations

import math
from typing import Any

import pytest

import platform_ctrl as pc
from camera_job import camera_job, camera_loop, camera_plant
from platform_ctrl import design
from platform_ctrl.analysis.system import System
from platform_ctrl.design import tuning
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.loop_signals import channels
from platform_ctrl.design.methods.classical import Classical
from platform_ctrl.design.plants import plants_of
from platform_ctrl.job.job import Job
from platform_ctrl.job.methods import DesignSpec
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


def starting_values(given, channel, nutation, period):
    """All options of a classical design, those not given from rules of thumb."""
    return Classical().defaults(
        DesignSpec(name="classical", method="classical", options=given), channel, nutation, period
    )


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_options_stay_within_reach_of_their_start(direction: float, monkeypatch: pytest.MonkeyPatch) -> None:
    job = pc.read_job(JOB)
    [spec] = job.loops
    plants = plants_of(job, spec)
    assert plants is not None
    channel = channels(pc.linearise(job.platform), rows_of(pc.linearise(job.platform), GIMBALS))
    start = starting_values({}, channel, plants.nutation, plants.period)
    tried: list[float] = []

    def build(options: dict[str, float]) -> System:
        tried.append(options["crossover_hz"] / start["crossover_hz"])
        return Classical().of_directions(options, channel, plants.period)

    def downhill(*anything: Any) -> float:
        return 9.0 / (1.0 + math.exp(0.01 * direction * math.log(tried[-1])))

    monkeypatch.setattr(tuning, "worst_ratio", downhill)
    required = loop_requirements(spec.limits)
    tuner = tuning.Tuner(movable=["crossover_hz"], build=build, plants=plants, requirements=required, evaluations=100)
    tuned = tuner.run(start)
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

    def build(options: dict[str, float]) -> System:
        return Classical().of_directions(options, channel, plants.period)

    tuner = tuning.Tuner(movable=list(start), build=build, plants=plants, requirements=required, evaluations=5)
    assert tuner.run(start) == start


def _camera_with_cables(start: dict[str, float], kind: str, **limits: float) -> Job:
    """A camera whose viscous friction takes it along with its base: a slow loop attenuates nothing."""
    plant = camera_plant(friction=[{"gimbal": "az", "viscous": 0.5}, {"gimbal": "el", "viscous": 0.5}])
    limits = {"disk_margin": 0.5, "attenuation_db": 37.0, "attenuation_hz": 2.0, "torque_noise": 0.05} | limits
    method = "pi" if kind == "rate" else "classical"
    loops = camera_loop(kind=kind, limits=limits, design=[{"name": "pi", "method": method, "tune": True, **start}])
    return pc.read_job(camera_job(loop=loops, plant=plant))


@pytest.mark.parametrize(
    ("kind", "start"),
    [
        ("rate", {"crossover_hz": 1e-4}),
        ("rate", {"crossover_hz": 1.0}),
        ("rate", {"crossover_hz": 1.0, "integral_hz": 100.0}),
        ("rate", {"crossover_hz": 900.0}),
        ("pointing", {"inertial_crossover_hz": 0.05}),
        ("pointing", {"inertial_crossover_hz": 400.0, "inertial_lead_hz": 900.0}),
    ],
)
def test_a_bad_start_ends_where_a_good_one_does(kind: str, start: dict[str, float]) -> None:
    job = _camera_with_cables(start, kind)
    [outcome] = design.loops(job)
    assert outcome.closed.passed, [(one.name, one.value) for one in outcome.closed.results]


def test_where_the_tuner_stops_it_says_what_limits_it() -> None:
    lines: list[str] = []
    job = _camera_with_cables({"crossover_hz": 1.0}, "rate", attenuation_db=90.0)
    [outcome] = design.loops(job, progress=lines.append)
    assert not outcome.closed.passed
    last = next(line for line in reversed(lines) if "limited by" in line)
    assert "attenuation of base motion" in last
    assert "90 dB" in last
    assert "1000%" not in "".join(lines)
