"""The coupled check, the simulated runs, and the verdict."""

from __future__ import annotations

from platform_ctrl.check.coupled import CoupledCheck, coupled_check
from platform_ctrl.check.given import outcomes_from, read_controllers
from platform_ctrl.check.records import result_record, write_record
from platform_ctrl.check.simulated import Run, fly, largest
from platform_ctrl.check.verdict import JobResult, checked

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
