"""Plant and sampled controllers of a job as a functional mock-up unit (FMI 3.0, co-simulation)."""

from __future__ import annotations

from platform_ctrl.export.fmu.writing import write_fmu

__all__ = ["write_fmu"]
