"""Baselines: figures of a job that were once accepted, kept under version control, and what has moved since."""

from __future__ import annotations

from platform_ctrl.verification.baselines.comparison import Change, Comparison, State, compare
from platform_ctrl.verification.baselines.figures import Figure, figures_of
from platform_ctrl.verification.baselines.file import (
    Update,
    plot_beside,
    read_baseline,
    update_baseline,
    write_baseline,
)
from platform_ctrl.verification.baselines.record import AcceptedFigure, Baseline, LoopMatrices, Tolerance, accepted

__all__ = [
    "AcceptedFigure",
    "Baseline",
    "Change",
    "Comparison",
    "Figure",
    "LoopMatrices",
    "State",
    "Tolerance",
    "Update",
    "accepted",
    "compare",
    "figures_of",
    "plot_beside",
    "read_baseline",
    "update_baseline",
    "write_baseline",
]
