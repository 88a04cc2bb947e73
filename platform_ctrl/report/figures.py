"""Plots for scripts, and every figure of the report, by name.

Plots take plain values (systems, platforms, runs) and return a `control.ControlPlot` or a `matplotlib.figure.Figure`
with the report's look: `show` opens windows for them, `.figure.savefig` writes a file; pyplot knows nothing of them
before. What ends in ``_figure`` makes a figure of the report out of a job's result; make and save those within
`style.settings`.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.report.complex_figures import two_sided_nyquist
from platform_ctrl.report.coupled_figures import (
    coupled_pole_figure,
    margin_bars_figure,
    platform_disturbance_figure,
    servo_figure,
    simultaneous_margin_figure,
)
from platform_ctrl.report.loop_figures import disturbance_figure, loop_transfer_figure, sensitivity_figure
from platform_ctrl.report.modes import nutation_over_speed
from platform_ctrl.report.plots.bode import bode
from platform_ctrl.report.plots.campaign_histograms import campaign_histograms
from platform_ctrl.report.plots.campbell import campbell
from platform_ctrl.report.plots.disk_region import disk_margin_region
from platform_ctrl.report.plots.gang_of_four import gang_of_four, singular_values
from platform_ctrl.report.plots.gimbal_tree import gimbal_tree
from platform_ctrl.report.plots.nichols import nichols
from platform_ctrl.report.plots.nyquist import nyquist
from platform_ctrl.report.plots.panels import show
from platform_ctrl.report.plots.pole_map import pole_map
from platform_ctrl.report.plots.rate_sensitivity import Omega_sensitivity
from platform_ctrl.report.plots.root_locus import root_locus, root_locus_over_spin
from platform_ctrl.report.plots.time_responses import step_response, time_run
from platform_ctrl.report.pole_figures import pole_figure, root_locus_figure
from platform_ctrl.report.quantities import quantity
from platform_ctrl.report.run_figures import run_figure
from platform_ctrl.report.style import BAND, MUTED, REFERENCE
from platform_ctrl.report.verdict_words import bandwidth_hz
from platform_ctrl.verification.verdict import JobResult

__all__ = [
    "Omega_sensitivity",
    "bode",
    "campaign_histograms",
    "campbell",
    "coupled_pole_figure",
    "disk_margin_region",
    "disturbance_figure",
    "gang_of_four",
    "gimbal_tree",
    "loop_transfer_figure",
    "margin_bars_figure",
    "nichols",
    "nutation_figure",
    "nyquist",
    "platform_disturbance_figure",
    "pole_figure",
    "pole_map",
    "root_locus",
    "root_locus_figure",
    "root_locus_over_spin",
    "run_figure",
    "sensitivity_figure",
    "servo_figure",
    "show",
    "simultaneous_margin_figure",
    "singular_values",
    "step_response",
    "time_run",
    "two_sided_nyquist",
]

# Range of the speed, as a factor.
_SPINS = (0.0, 1.5)
# Words on two lines that are closer than this share of the axis would overlap.
_APART = 0.05


@check_arguments
def nutation_figure(result: JobResult) -> Figure | None:
    """Natural frequencies at rest over the rotors' speed (all alike); None for a plant without nutation.

    To the Campbell chart come the spread of the rotors' speed and the bandwidths of the loops.

    Parameters
    ----------
    result
        From `check.checked`.

    Returns
    -------
    matplotlib.figure.Figure or None
        One panel.

    Raises
    ------
    ArgumentError
        An argument of another kind than annotated.
    """
    if not nutation_over_speed(result, np.array(_SPINS)):
        return None
    figure = campbell(result.job.platform, spins=_SPINS)
    axes = figure.axes[0]
    nominal = axes.get_xlim()[1] / _SPINS[1]
    spread, (low, high) = result.job.spread.spin, axes.get_ylim()
    if spread > 0.0:
        axes.axvspan((1.0 - spread) * nominal, (1.0 + spread) * nominal, color=BAND, linewidth=0, zorder=0)
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
