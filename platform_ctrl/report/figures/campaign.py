"""The figures of a campaign: how its figures are distributed, and how far out its runs reach."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.campaign.table import METRICS
from platform_ctrl.campaign.table_statistics import CampaignStatistics, RequirementStatistics
from platform_ctrl.common.values import FloatArray
from platform_ctrl.report.plots.campaign_histograms import asked, distribution_of, histograms, shade_beyond
from platform_ctrl.report.style import (
    legend_above,
    legend_rows,
    line_style,
    linear_axis,
    log_axis,
    panels,
)

_COLUMNS = 3
# Levels beyond so many times the limit are not drawn, unless half of the runs lie there.
_REACH = 4.0


def exceedance_figure(found: CampaignStatistics) -> Figure:
    """Share of the runs above a level, each manoeuvre a line; the level counts relative to the limit."""
    figures = [name for name in METRICS if asked(found, name)]
    manoeuvres = list(dict.fromkeys(one.manoeuvre for name in figures for one in asked(found, name)))
    labels = [str(name) for name in manoeuvres]
    drawn, rows = panels(1, len(figures), 3.0 + 0.22 * legend_rows(labels), legend=legend_rows(labels))
    handles = {}
    for axes, name in zip(rows[0], figures, strict=True):
        for one in asked(found, name):
            levels, shares = _exceedance(one)
            if len(levels) == 1:  # one run, or all alike: a line needs a beginning
                levels, shares = np.append(0.0, levels), np.append(1.0, shares)
            style = line_style(manoeuvres.index(one.manoeuvre))
            handles[str(one.manoeuvre)] = axes.plot(levels, shares, drawstyle="steps-post", **style)[0]
        _exceedance_axes(axes, name, found)
    rows[0][0].set_ylabel("share of the runs above")
    legend_above(drawn, [handles[label] for label in labels], labels)
    return drawn


def _exceedance(one: RequirementStatistics) -> tuple[FloatArray, FloatArray]:
    levels, shares = distribution_of(one).exceedance()
    assert one.limit is not None
    ratios, share = levels / one.limit, shares
    finite = np.isfinite(ratios)
    # Runs that diverged lie beyond every level: the line ends above zero.
    return ratios[finite], np.where(share[finite] > 0.0, share[finite], np.nan)


def _exceedance_axes(axes: Axes, name: str, found: CampaignStatistics) -> None:
    axes.set_yscale("log")
    least = 0.5 / max(one.violation.runs for one in asked(found, name))
    axes.set_ylim(10.0 ** np.floor(np.log10(least)), 1.3)
    log_axis(axes.yaxis)
    reach = [_exceedance(one)[0].max(initial=0.0) for one in asked(found, name)]
    usual = [one.quantiles[0.5] / one.limit for one in asked(found, name) if one.limit]
    most = max([_REACH, *(1.3 * ratio for ratio in usual if np.isfinite(ratio))])
    right = float(np.clip(1.08 * max(reach), 1.25, most))
    axes.set_xlim(0.0, right)
    linear_axis(axes.xaxis)
    shade_beyond(axes, 1.0, right)
    axes.set_title(METRICS[name][0])
    axes.set_xlabel("over its limit")


def histogram_figure(found: CampaignStatistics, name: str) -> Figure:
    """How one figure is distributed in each manoeuvre that asks for it, its limit in red."""
    return histograms([(one, name) for one in asked(found, name)], _COLUMNS)
