"""Design from measured frequency responses: a MIMO PID under limits at every frequency."""

from __future__ import annotations

from platform_ctrl.design.measured.design import ClosedLoopResponse, MeasuredDesign, measured_pid
from platform_ctrl.design.measured.reading import read_measurement

__all__ = ["ClosedLoopResponse", "MeasuredDesign", "measured_pid", "read_measurement"]
