"""The search behind `tune = true`: where nothing gets better it neither runs to infinity nor fails."""

from __future__ import annotations

from typing import Any

import pytest

import platform_ctrl as pc
from camera_job import camera_job, camera_loop, camera_plant
from platform_ctrl import design


def _camera_with_cables(start: dict[str, float], kind: str, **limits: float) -> Any:
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
        ("rate", {"crossover_hz": 1.0, "integral_hz": 100.0}),
        ("rate", {"crossover_hz": 900.0}),
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
