"""Plots for scripts by name, and, in the modules of this package, the figures of loops in a job's report.

Plots take plain values (systems, platforms, runs) and return a `control.ControlPlot` or a `matplotlib.figure.Figure`
with the report's look: `show` opens windows for them, `.figure.savefig` writes a file; pyplot knows nothing of them
before. Figures of a report are made from a job's result, and saved, within `style.settings`.
"""

from platform_ctrl.report.axes.picture import axes_picture
from platform_ctrl.report.plots.bode import bode
from platform_ctrl.report.plots.campaign import campaign_histograms
from platform_ctrl.report.plots.campbell import campbell
from platform_ctrl.report.plots.gains import Omega_sensitivity, gang_of_four, singular_values
from platform_ctrl.report.plots.nichols import disk_margin_region, nichols
from platform_ctrl.report.plots.nyquist import nyquist, two_sided_nyquist
from platform_ctrl.report.plots.panels import show
from platform_ctrl.report.plots.pole_map import pole_map
from platform_ctrl.report.plots.root_locus import root_locus, root_locus_over_spin
from platform_ctrl.report.plots.step_response import step_response
from platform_ctrl.report.plots.time_run import time_run

__all__ = [
    "Omega_sensitivity",
    "axes_picture",
    "bode",
    "campaign_histograms",
    "campbell",
    "disk_margin_region",
    "gang_of_four",
    "nichols",
    "nyquist",
    "pole_map",
    "root_locus",
    "root_locus_over_spin",
    "show",
    "singular_values",
    "step_response",
    "time_run",
    "two_sided_nyquist",
]
