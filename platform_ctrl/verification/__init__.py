"""The coupled check, the simulated runs, and the verdict."""

from __future__ import annotations

from platform_ctrl.verification.given import read_controllers
from platform_ctrl.verification.verdict import JobResult, checked

__all__ = [
    "JobResult",
    "checked",
    "read_controllers",
]
