"""Plots for scripts, and every figure of the report, by name.

Plots take plain values (systems, platforms, runs) and return a `control.ControlPlot` or a `matplotlib.figure.Figure`
with the report's look: `show` opens windows for them, `.figure.savefig` writes a file; pyplot knows nothing of them
before. What ends in ``_figure`` makes a figure of the report from a job's result; make and save those within
`style.settings`.
"""

from platform_ctrl.report.figures.coupled import (
    coupled_pole_figure,
    margin_bars_figure,
    platform_disturbance_figure,
    servo_figure,
    simultaneous_margin_figure,
)
from platform_ctrl.report.figures.loop import disturbance_figure, loop_transfer_figure, sensitivity_figure
from platform_ctrl.report.figures.plant import nutation_figure
from platform_ctrl.report.figures.poles import pole_figure, root_locus_figure
from platform_ctrl.report.figures.runs import run_figure
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
from platform_ctrl.report.plots.step_response import step_response
from platform_ctrl.report.plots.time_run import time_run
from platform_ctrl.report.plots.two_sided import two_sided_nyquist

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
