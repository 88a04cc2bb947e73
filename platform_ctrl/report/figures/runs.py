"""The figures of the simulated runs: angles, torques, rates and attitude over time, with their limits."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from platform_ctrl.common.files import write_whole
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.plots.time_run import trajectory_figure
from platform_ctrl.report.quantities import signal_series
from platform_ctrl.report.style import (
    INK,
    settings,
)
from platform_ctrl.verification.simulated import Run

if TYPE_CHECKING:
    from platform_ctrl.plant.platform import Platform
    from platform_ctrl.verification import Run


def run_figure(run: Run, platform: Platform) -> Figure:
    """Everything that a run recorded: gimbal angles, torques, platform rate, and with a free platform its attitude."""
    limits, duration = run.manoeuvre.limits, run.manoeuvre.duration
    return trajectory_figure(run.trajectory, platform.torquers, signal_series(platform), limits, duration)


def write_run_figure(run: Run, platform: Platform, title: str, path: Path) -> None:
    """Draw everything that a run recorded and write it to `path` as SVG, whole or not at all."""
    out = StringIO()
    with settings():
        figure = run_figure(run, platform)
        above = 1.0 + 0.12 / figure.get_size_inches()[1]
        figure.text(0.0, above, title, color=INK, fontsize=9.0, fontweight="bold", ha="left", va="bottom")
        figure.savefig(
            out, format="svg", facecolor="white", bbox_inches="tight", pad_inches=0.1, metadata={"Date": None}
        )
    write_whole(path, out.getvalue())
