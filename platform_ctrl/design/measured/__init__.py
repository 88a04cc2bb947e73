"""Design from measured frequency responses: a MIMO PID under limits at every frequency."""

from __future__ import annotations

from platform_ctrl.design.measured.data import read_measurement
from platform_ctrl.design.measured.design import ClosedLoopResponse, MeasuredDesign, measured_pid

__all__ = ["ClosedLoopResponse", "MeasuredDesign", "measured_pid", "read_measurement"]
