"""The plot of the line of sight's budget: rms up to a frequency, of all sources and of the largest."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from platform_ctrl.job.budget import Budget
from platform_ctrl.report.style import frequency_axes, legend, line_style, linear_axis, panels
from platform_ctrl.verification.budget import LineOfSightBudget

MICRO = 1e6
# Sources that have a curve of their own.
_CURVES = 5


def budget_figure(budget: Budget, found: LineOfSightBudget) -> Figure:
    """Draw the rms of both axes across the line of sight up to a frequency: all sources, and the largest ones."""
    across = np.hypot(found.rms[:, 0], found.rms[:, 1])
    largest = [k for k in np.argsort(-across, kind="stable")[:_CURVES] if across[k] > 0.0]
    names = ["all sources", *(found.names[k] for k in largest)]
    figure, [[first, second]] = panels(1, 2, 2.0, names)
    handles: list[Line2D] = []
    inside = (found.frequencies_hz >= budget.from_hz) & (found.frequencies_hz <= budget.to_hz)
    f = found.frequencies_hz[inside]
    for axis, axes in enumerate((first, second)):
        curves = [found.total_cumulative[axis], *(found.cumulative[k, axis] for k in largest)]
        drawn = []
        for k, curve in enumerate(curves):
            rms = MICRO * np.sqrt(curve[inside])
            drawn += axes.plot(f, rms, **line_style(k))
        handles = handles or drawn
        frequency_axes(axes, budget.from_hz, budget.to_hz, log_gain=False)
        axes.set_ylim(0.0, 1.08 * MICRO * max(float(found.total[axis]), 1e-12))
        linear_axis(axes.yaxis)
        axes.set_title(found.axes[axis])
    first.set_ylabel("rms up to this frequency, µrad")
    legend(figure, handles, names)
    return figure
