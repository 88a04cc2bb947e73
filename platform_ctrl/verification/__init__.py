"""The coupled check, the simulated runs, and the verdict."""

from __future__ import annotations

from platform_ctrl.verification.controllers import read_controllers
from platform_ctrl.verification.verdict import JobResult, check_job

__all__ = [
    "JobResult",
    "check_job",
    "read_controllers",
]
