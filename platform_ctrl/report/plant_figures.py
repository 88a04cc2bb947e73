"""The figure of the plant: nutation frequencies over rotor speed."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from platform_ctrl.check.verdict import JobResult
from platform_ctrl.report.modes import nutation_over_speed
from platform_ctrl.report.style import BAND, MARKERS, REFERENCE, SERIES, legend_above, line_style, linear_axis, panels


def nutation_figure(result: JobResult) -> Figure | None:
    """Nutation frequencies at rest over the rotors' speed (all alike); None for a plant without nutation."""
    speed = np.linspace(0.0, 1.5, 31)
    lines = nutation_over_speed(result, speed)
    if not lines:
        return None
    figure, [[axes]] = panels(1, 1, 2.7, legend=1, titles=False, width=6.4)
    handles = []
    nominal = int(np.argmin(np.abs(speed - 1.0)))
    for k, (_, frequency) in enumerate(lines):
        handles += axes.plot(100.0 * speed, frequency / (2.0 * np.pi), **line_style(k))
        axes.plot([100.0], [frequency[nominal] / (2.0 * np.pi)], MARKERS[k % 8], color=SERIES[k % 8], markersize=5)
    spread = result.job.spread.spin
    if spread > 0.0:
        axes.axvspan(100.0 * (1.0 - spread), 100.0 * (1.0 + spread), color=BAND, linewidth=0, zorder=0)
    bandwidths = [o.closed.measures.bandwidth for o in result.loops if o.closed.measures is not None]
    for bandwidth in bandwidths:
        if np.isfinite(bandwidth) and bandwidth > 0.0:
            axes.axhline(bandwidth / (2.0 * np.pi), color=REFERENCE, linewidth=0.8, linestyle=(0, (1.2, 1.4)))
    axes.set_xlim(0.0, 150.0)
    axes.set_ylim(0.0, None)
    linear_axis(axes.xaxis, 6)
    linear_axis(axes.yaxis)
    axes.set_xlabel("rotor speed, % of nominal")
    axes.set_ylabel("frequency, Hz")
    if bandwidths:
        handles.append(axes.plot([], [], color=REFERENCE, linewidth=0.8, linestyle=(0, (1.2, 1.4)))[0])
    labels = [f"nutation of {'-'.join(group)}" for group, _ in lines] + (
        ["bandwidth of the loops"] if bandwidths else []
    )
    legend_above(figure, handles, labels)
    return figure
