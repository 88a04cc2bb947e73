"""Controllers that exist already, closed around the plant of a job, as `check --controllers` does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import control

from platform_ctrl.verification import check_job
from platform_ctrl.verification.controllers import outcomes_from, read_controllers

Controllers = Sequence[control.StateSpace] | Mapping[str, Any]


def outcomes(job: Any, controllers: Controllers, alternatives: Sequence[control.StateSpace] = ()) -> Any:
    """Return what `design.loops` returns, of controllers or of the content of a file with them."""
    closed = read_controllers(controllers, job) if isinstance(controllers, Mapping) else controllers
    return outcomes_from(job, closed, alternatives)


def verdict(job: Any, controllers: Controllers, **options: Any) -> Any:
    """Return the verdict of the job with these controllers."""
    return check_job(job, outcomes(job, controllers), **options)
