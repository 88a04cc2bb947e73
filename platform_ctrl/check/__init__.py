"""The coupled check, the simulated runs, and the verdict."""

from __future__ import annotations

from platform_ctrl.check.coupled import CoupledCheck, coupled_check
from platform_ctrl.check.simulated import Run, fly, largest
from platform_ctrl.check.verdict import JobResult, checked

__all__ = ["CoupledCheck", "JobResult", "Run", "checked", "coupled_check", "fly", "largest"]
