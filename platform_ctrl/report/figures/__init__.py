"""Plots for scripts by name, and, in the modules of this package, the figures of loops in a job's report.

Plots take plain values (systems, platforms, runs) and return a `control.ControlPlot` or a `matplotlib.figure.Figure`:
`pyplot.show` opens windows for them, `.figure.savefig` writes a file. Bode and Nyquist plots and singular values are
those of python-control; the others have the report's look. Figures of a report are made from a job's result, and saved,
within `style.settings`.
"""

from platform_ctrl.report.figures.nichols import nichols
from platform_ctrl.report.figures.plant import axes_picture, campbell
from platform_ctrl.report.figures.root_locus import root_locus, root_locus_over_spin
from platform_ctrl.report.figures.runs import campaign_histograms, time_run
from platform_ctrl.report.figures.systems import bode, nyquist, singular_values

__all__ = [
    "axes_picture",
    "bode",
    "campaign_histograms",
    "campbell",
    "nichols",
    "nyquist",
    "root_locus",
    "root_locus_over_spin",
    "singular_values",
    "time_run",
]
