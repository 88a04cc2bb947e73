"""The results of a campaign's runs: histograms with their limits, and how often a level is exceeded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.campaign.statistics import CampaignStatistics, RequirementStatistics
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.common.arguments import short
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import handy_unit, plain
from platform_ctrl.report.style import (
    BEYOND,
    DASHED,
    LIMIT,
    MUTED,
    SERIES,
    linear_axis,
    panels,
    standalone,
)

_COLUMNS = 3
_BINS = 48
# A limit beyond this multiple of the largest value would squeeze the histogram: it is written instead.
_FAR = 2.5
# Values beyond this multiple of the limit, or of the 90 % quantile, are counted and not drawn.
_WILD = 2.0
# A limit below this share of the values would squeeze the histogram: it is written instead.
_LOW = 0.25
# Largest start of the axis, as a share of the limit.
_BEFORE = 0.9
# Least share of a panel beyond the limit: the note is written there.
_BEYOND_LIMIT = 0.3
_CELL = 1.75


@standalone
def campaign_histograms(campaign: CampaignStatistics | Summary) -> Figure:
    """Histograms of a campaign's results, a panel for each limit of each manoeuvre; red beyond the limit.

    Parameters
    ----------
    campaign
        What `campaign.summarise` returned, or its statistics.

    Returns
    -------
    matplotlib.figure.Figure
        Rows of panels, a column for each figure.

    Raises
    ------
    ArgumentError
        Something else, or no limit on the runs.
    """
    if not isinstance(campaign, CampaignStatistics | Summary):
        raise ArgumentError(
            f"campaign_histograms: campaign must be what campaign.summarise returned, got {short(campaign)}"
        )
    found = campaign.statistics if isinstance(campaign, Summary) else campaign
    cells = [(one, name) for name in RUN_METRICS for one in with_limit(found, name) if one.violation.runs]
    if not cells:
        raise ArgumentError("campaign_histograms: no simulated manoeuvre has a limit; there is nothing to draw")
    return histograms(cells, 2 if len(cells) == 4 else min(_COLUMNS, len(cells)))


def histograms(wanted: Sequence[tuple[RequirementStatistics, str]], columns: int) -> Figure:
    """Return a figure with a histogram for each pair of a requirement and its metric, row by row."""
    drawn, grid = panels(-(-len(wanted) // columns), columns, _CELL)
    cells = list(grid.flat)
    for axes, (one, name) in zip(cells, wanted, strict=False):
        _histogram_panel(axes, one, name)
    for axes in cells[len(wanted) :]:
        axes.set_visible(False)
    for row in grid:
        row[0].set_ylabel("runs")
    return drawn


def _histogram_panel(axes: Axes, one: RequirementStatistics, name: str) -> None:
    """Draw the histogram of one metric in one manoeuvre, red beyond its limit."""
    values, limit = one.values[np.isfinite(one.values)], one.limit
    assert limit is not None
    factor, unit = handy_unit(RUN_METRICS[name].unit, limit)
    usual = one.quantiles[0.9]
    high = min(values.max(initial=0.0), _WILD * max(limit, usual if np.isfinite(usual) else limit)) or limit
    low = values.min() if values.size and values.min() > 0.5 * high else 0.0
    near = _LOW * low <= limit <= _FAR * high
    if near:
        low = min(low, _BEFORE * limit)
        high = max(high, low + (limit - low) / (1.0 - _BEYOND_LIMIT))
    width = 1.02 * (high - low) / _BINS or limit
    # The limit is an edge of two bins.
    first, last = math.floor((low - limit) / width), math.ceil((1.02 * high - limit) / width)
    edges = limit + width * np.arange(first, last + 1)
    counts, beyond = np.histogram(values, edges)[0], np.arange(first, last) >= 0
    axes.stairs(counts, factor * edges, fill=True, color=SERIES[0], linewidth=0)
    if beyond.any():
        axes.stairs(np.where(beyond, counts, 0), factor * edges, fill=True, color=LIMIT, linewidth=0)
        shade_beyond(axes, factor * limit, factor * edges[-1])
    axes.set_xlim(factor * edges[0], factor * edges[-1])
    axes.set_ylim(0.0, 1.18 * max(counts.max(initial=1), 1))
    linear_axis(axes.xaxis)
    linear_axis(axes.yaxis, 4)
    axes.set_title(str(one.manoeuvre))
    axes.set_xlabel(", ".join(filter(None, [RUN_METRICS[name].name, unit])))
    far = "" if counts[beyond].any() else "far "
    words = f"{one.violation.events:,} {far}beyond" if one.violation.events else "none beyond"
    words += "" if near else f" the limit, {plain(factor * limit, 4)} {unit}".rstrip()
    look: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "right", "va": "top"}
    colour = LIMIT if one.violation.events else MUTED
    axes.annotate(words, (1.0, 1.0), (-3, -2), fontsize=7, color=colour, **look)


def shade_beyond(axes: Axes, limit: float, reach: float = 0.0) -> None:
    """Shade what lies to the right of a limit, up to `reach` at least."""
    axes.axvspan(limit, max(1e3 * limit, 2.0 * reach), color=BEYOND, linewidth=0, zorder=0)
    axes.axvline(limit, color=LIMIT, linewidth=0.9, linestyle=DASHED, zorder=1.5)


def with_limit(found: CampaignStatistics, name: str) -> list[RequirementStatistics]:
    """Return the requirements on one metric, manoeuvre by manoeuvre."""
    return [one for one in found.requirements if one.requirement == name and one.manoeuvre is not None and one.limit]


def histogram_figure(found: CampaignStatistics, name: str) -> Figure:
    """Return histograms of one metric in each manoeuvre with a limit on it."""
    return histograms([(one, name) for one in with_limit(found, name)], _COLUMNS)
