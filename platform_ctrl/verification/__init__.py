"""The coupled check, the simulated runs, and the verdict."""

from __future__ import annotations

from platform_ctrl.verification.coupled import CoupledCheck, coupled_check
from platform_ctrl.verification.given import outcomes_from, read_controllers
from platform_ctrl.verification.records import result_record, write_record
from platform_ctrl.verification.simulated import Run, fly, largest
from platform_ctrl.verification.verdict import JobResult, checked

__all__ = [
    "CoupledCheck",
    "JobResult",
    "Run",
    "checked",
    "coupled_check",
    "fly",
    "largest",
    "outcomes_from",
    "read_controllers",
    "result_record",
    "write_record",
]
