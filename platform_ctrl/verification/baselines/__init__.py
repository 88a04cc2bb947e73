"""Baselines: figures of a job that were once accepted, kept under version control, and what has moved since."""

from __future__ import annotations

from platform_ctrl.verification.baselines.comparison import compare
from platform_ctrl.verification.baselines.file import (
    read_baseline,
    update_baseline,
)
from platform_ctrl.verification.baselines.record import accepted

__all__ = [
    "accepted",
    "compare",
    "read_baseline",
    "update_baseline",
]
