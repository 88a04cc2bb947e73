"""The line of sight's budget against runs of the non-linear plant."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from platform_ctrl.verification.budget import line_of_sight_budget
from platform_ctrl.verification.simulated import simulated_budget
from verification.test_budget import controllers, job


def spread(found: Any) -> float:
    """Return half of the 95 % interval over the rms of the first axis."""
    return float((found.high[0] - found.low[0]) / (2.0 * found.rms[0]))


def test_where_all_is_linear_runs_have_the_rms_of_the_budget(tmp_path: Path) -> None:
    found = simulated_budget(job(tmp_path), controllers(), 192, time=0.5)
    # Four standard errors; the interval has two.
    assert found.rms[0] == pytest.approx(found.linear[0], rel=2.0 * spread(found))
    assert spread(found) < 0.1
    assert found.low[0] < found.rms[0] < found.high[0]
    # A camera that turns about its pitch axis alone looks nowhere else.
    assert found.rms[1] == pytest.approx(0.0, abs=1e-12)
    assert found.left_out == ()


def test_the_motion_rises_from_rest_so_that_no_step_saturates_a_motor(tmp_path: Path) -> None:
    free = job(tmp_path)
    assert free.budget is not None
    free = dataclasses.replace(free, budget=dataclasses.replace(free.budget, sources=free.budget.sources[:1]))
    # A step of the base's rate, 0.1 rad/s, would ask of the controller for 0.05 N m.
    (torquer,) = free.platform.torquers
    weak = dataclasses.replace(torquer, limit=0.02)
    limited = dataclasses.replace(free, platform=dataclasses.replace(free.platform, torquers=(weak,)))
    found, expected = (simulated_budget(one, controllers(), 32, time=0.5) for one in (limited, free))
    np.testing.assert_array_equal(found.rms, expected.rms)


def test_a_bearing_that_hardly_slides_is_simulated_where_the_budget_does_not_hold(tmp_path: Path) -> None:
    stuck = job(tmp_path, friction=", coulomb = 0.05, coulomb_rate = 0.05")
    budget = line_of_sight_budget(stuck, controllers())
    assert not budget.friction.valid[0]
    assert "simulate" in budget.friction.statement[0]
    few, again = (simulated_budget(stuck, controllers(), 8, time=0.25) for _ in range(2))
    assert math.isfinite(few.ratio)
    np.testing.assert_array_equal(few.rms, again.rms)
    assert np.any(simulated_budget(stuck, controllers(), 8, seed=1, time=0.25).rms != few.rms)
