"""The figure of the plant: its natural frequencies beside the bandwidths of the loops."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from platform_ctrl.report.modes import nutation_over_speed
from platform_ctrl.report.page.summary import bandwidth_hz
from platform_ctrl.report.plots.campbell import campbell
from platform_ctrl.report.quantities import quantity
from platform_ctrl.report.style import BAND, MUTED, REFERENCE
from platform_ctrl.verification.verdict import JobResult

# Range of the speed, as a factor.
_SPINS = (0.0, 1.5)
# Words on two lines that are closer than this share of the axis would overlap.
_APART = 0.05


def nutation_figure(result: JobResult) -> Figure | None:
    """Natural frequencies at rest over the rotors' speed (all alike); None for a plant without nutation.

    To the Campbell diagram come the uncertainty of the rotors' speed and the bandwidths of the loops.
    """
    if not nutation_over_speed(result, np.array(_SPINS)):
        return None
    figure = campbell(result.job.platform, spins=_SPINS)
    axes = figure.axes[0]
    nominal = axes.get_xlim()[1] / _SPINS[1]
    uncertainty, (low, high) = result.job.uncertainty.spin, axes.get_ylim()
    if uncertainty > 0.0:
        axes.axvspan((1.0 - uncertainty) * nominal, (1.0 + uncertainty) * nominal, color=BAND, linewidth=0, zorder=0)
    loops = sorted(((bandwidth_hz(one.closed), one.spec.name) for one in result.loops), reverse=True)
    last = 2.0 * high
    for bandwidth, name in loops:
        if not low < bandwidth < high:
            continue
        axes.axhline(bandwidth, color=REFERENCE, linewidth=0.8, linestyle=(0, (1.2, 1.4)))
        if last - bandwidth > _APART * high:
            words = f"bandwidth of {name}, {quantity(bandwidth, 'Hz', 3)}"
            at = (axes.get_xlim()[1], bandwidth)
            axes.annotate(
                words, at, (-3, 2), textcoords="offset points", ha="right", va="bottom", fontsize=7, color=MUTED
            )
            last = bandwidth
    return figure
