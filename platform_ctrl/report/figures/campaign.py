"""The results of a campaign's runs: histograms with their limits, and how often a level is exceeded."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.campaign.statistics import CampaignStatistics, Limits, RequirementStatistics, statistics
from platform_ctrl.campaign.store import TABLE, read_record
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.campaign.table import Table
from platform_ctrl.common.arguments import one_of, short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.quantities import handy_unit, plain
from platform_ctrl.report.style import (
    BEYOND,
    DASHED,
    LIMIT,
    MUTED,
    SERIES,
    legend,
    line_style,
    linear_axis,
    log_axis,
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
def campaign_histograms(
    campaign: CampaignStatistics | Summary | Table,
    limits: Limits | None = None,
    *,
    figure: str | None = None,
) -> Figure:
    """Histograms of a campaign's results, a panel for each limit of each manoeuvre; red beyond the limit.

    Parameters
    ----------
    campaign
        What `campaign.statistics` or `campaign.summarise` returned, the folder that ``platform-ctrl campaign`` wrote,
        or its table: Parquet, or a dict of columns.
    limits
        Upper limits of each manoeuvre, {manoeuvre: {figure: limit}}, in SI units; needed for a table,
        and for a folder without statistics.
    figure
        ``"angle"``, ``"attitude"`` or ``"torque_share"``; default all that have a limit.

    Returns
    -------
    matplotlib.figure.Figure
        Rows of panels, a column for each figure.

    Raises
    ------
    ArgumentError
        Something else, a table without limits, or no limit on the runs.
    InputError
        The files cannot be read.
    """
    if figure is not None:
        one_of("campaign_histograms: figure", figure, tuple(RUN_METRICS))
    found = _statistics(campaign, limits)
    names = [name for name in RUN_METRICS if figure in (None, name)]
    cells = [(one, name) for name in names for one in with_limit(found, name) if one.violation.runs]
    if not cells:
        what = "any figure" if figure is None else repr(figure)
        raise ArgumentError(
            f"campaign_histograms: no simulated manoeuvre has a limit on {what}; there is nothing to draw"
        )
    columns = 2 if len(cells) == 4 else min(_COLUMNS, len(cells))
    return histograms(cells, columns)


def _statistics(campaign: object, limits: Limits | None) -> CampaignStatistics:
    if isinstance(campaign, CampaignStatistics | Summary):
        if limits is not None:
            raise ArgumentError("campaign_histograms: statistics have their own limits; leave limits out")
        return campaign.statistics if isinstance(campaign, Summary) else campaign
    if isinstance(campaign, str | os.PathLike):
        folder = Path(campaign)
        if not folder.exists():
            raise InputError(f"campaign_histograms: {folder} does not exist; give a campaign's folder or its table")
        record = read_record(folder) if folder.is_dir() else None
        if record is not None:
            return statistics(folder / TABLE, _limits(record, limits))
    elif not isinstance(campaign, Mapping | list | tuple):
        raise ArgumentError(
            f"campaign_histograms: campaign must be statistics, a campaign's folder or its table, got {short(campaign)}"
        )
    return statistics(campaign, _limits({}, limits))


def _limits(record: Mapping[str, Any], limits: Limits | None) -> Limits:
    """Return the limits that were given, or those that the statistics in the record were made with."""
    if limits is not None:
        return limits
    out: dict[str, dict[str, float]] = {}
    for one in record.get("statistics", {}).get("requirements", []):
        if one["manoeuvre"] is not None and one["limit"] is not None:
            out.setdefault(one["manoeuvre"], {})[one["requirement"]] = one["limit"]
    if not out:
        raise ArgumentError(
            "campaign_histograms: the table has no limits; give them, for example {'turn': {'angle': 0.003}}"
        )
    return out


def histograms(wanted: Sequence[tuple[RequirementStatistics, str]], columns: int) -> Figure:
    """Return a figure with a histogram for each pair of a requirement and its metric, row by row."""
    rows = -(-len(wanted) // columns)
    drawn, grid = panels(rows, columns, _CELL)
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
    values, limit = one.values, one.limit
    assert limit is not None
    factor, unit = handy_unit(RUN_METRICS[name].unit, limit)
    usual = one.quantiles[0.9]
    top = min(one.largest, _WILD * max(limit, usual if np.isfinite(usual) else limit)) or limit
    low = values[0] if np.isfinite(values[0]) and values[0] > 0.5 * top else 0.0
    near = _LOW * low <= limit <= _FAR * max(top, 1e-300)
    low, high = 0.98 * (min(low, _BEFORE * limit) if near else low), 1.04 * top
    if near:
        high = max(high, low + (limit - low) / (1.0 - _BEYOND_LIMIT))
    edges = _edges(low, high, limit if near else None)
    counts = np.histogram(values[np.isfinite(values)], edges)[0]
    axes.stairs(counts, factor * edges, fill=True, color=SERIES[0], linewidth=0)
    beyond = edges[:-1] >= limit * (1.0 - 1e-9)
    if beyond.any():
        axes.stairs(np.where(beyond, counts, 0), factor * edges, fill=True, color=LIMIT, linewidth=0)
        shade_beyond(axes, factor * limit, factor * high)
    axes.set_xlim(factor * low, factor * high)
    axes.set_ylim(0.0, 1.18 * max(counts.max(initial=1), 1))
    linear_axis(axes.xaxis)
    linear_axis(axes.yaxis, 4)
    axes.set_title(str(one.manoeuvre))
    axes.set_xlabel(", ".join(filter(None, [RUN_METRICS[name].name, unit])))
    _note(axes, one, near, bool(counts[beyond].any()), factor, unit)


def _note(axes: Axes, one: RequirementStatistics, near: bool, drawn: bool, factor: float, unit: str) -> None:
    assert one.limit is not None
    far = "" if drawn else "far "
    text = f"{one.violation.events:,} {far}beyond" if one.violation.events else "none beyond"
    limit = f"{plain(factor * one.limit, 4)} {unit}".rstrip()
    text += "" if near else f" the limit, {limit}"
    axes.annotate(
        text,
        (1.0, 1.0),
        (-3, -2),
        xycoords="axes fraction",
        textcoords="offset points",
        ha="right",
        va="top",
        fontsize=7,
        color=LIMIT if one.violation.events else MUTED,
    )


def _edges(low: float, high: float, limit: float | None) -> FloatArray:
    """Return equal bins, one edge of which is the limit; the first may begin below `low`."""
    width = (high - low) / _BINS
    if limit is None:
        return np.linspace(low, high, _BINS + 1)
    below = max(round((limit - low) / width), 1)
    # A limit close to `low` must not make all bins narrow.
    width = max((limit - low) / below, 0.5 * width)
    return np.asarray(limit + width * np.arange(-below, int(np.ceil((high - limit) / width)) + 1))


def shade_beyond(axes: Axes, limit: float, reach: float = 0.0) -> None:
    """Shade what lies to the right of a limit, up to `reach` at least."""
    axes.axvspan(limit, max(1e3 * limit, 2.0 * reach), color=BEYOND, linewidth=0, zorder=0)
    axes.axvline(limit, color=LIMIT, linewidth=0.9, linestyle=DASHED, zorder=1.5)


def with_limit(found: CampaignStatistics, name: str) -> list[RequirementStatistics]:
    """Return the requirements on one metric, manoeuvre by manoeuvre."""
    return [one for one in found.requirements if one.requirement == name and one.manoeuvre is not None and one.limit]


# Levels beyond so many times the limit are not drawn, unless half of the runs lie there.
_REACH = 4.0


def exceedance_figure(found: CampaignStatistics) -> Figure:
    """Share of the runs above a level, each manoeuvre a line; the level counts relative to the limit."""
    figures = [name for name in RUN_METRICS if with_limit(found, name)]
    manoeuvres = list(dict.fromkeys(one.manoeuvre for name in figures for one in with_limit(found, name)))
    labels = [str(name) for name in manoeuvres]
    drawn, rows = panels(1, len(figures), 2.2, labels)
    handles = {}
    for axes, name in zip(rows[0], figures, strict=True):
        for one in with_limit(found, name):
            levels, shares = _exceedance(one)
            if len(levels) == 1:  # one run, or all alike: a line needs a beginning
                levels, shares = np.append(0.0, levels), np.append(1.0, shares)
            style = line_style(manoeuvres.index(one.manoeuvre))
            handles[str(one.manoeuvre)] = axes.plot(levels, shares, drawstyle="steps-post", **style)[0]
        _exceedance_axes(axes, name, found)
    rows[0][0].set_ylabel("share of the runs above")
    legend(drawn, [handles[label] for label in labels], labels)
    return drawn


def _exceedance(one: RequirementStatistics) -> tuple[FloatArray, FloatArray]:
    levels, last = np.unique(one.values, return_index=True)
    shares = 1.0 - np.append(last[1:], len(one.values)) / len(one.values)
    assert one.limit is not None
    ratios, share = levels / one.limit, shares
    finite = np.isfinite(ratios)
    # Runs that diverged lie beyond every level: the line ends above zero.
    return ratios[finite], np.where(share[finite] > 0.0, share[finite], np.nan)


def _exceedance_axes(axes: Axes, name: str, found: CampaignStatistics) -> None:
    axes.set_yscale("log")
    least = 0.5 / max(one.violation.runs for one in with_limit(found, name))
    axes.set_ylim(10.0 ** np.floor(np.log10(least)), 1.3)
    log_axis(axes.yaxis)
    reach = [_exceedance(one)[0].max(initial=0.0) for one in with_limit(found, name)]
    usual = [one.quantiles[0.5] / one.limit for one in with_limit(found, name) if one.limit]
    most = max([_REACH, *(1.3 * ratio for ratio in usual if np.isfinite(ratio))])
    right = float(np.clip(1.08 * max(reach), 1.25, most))
    axes.set_xlim(0.0, right)
    linear_axis(axes.xaxis)
    shade_beyond(axes, 1.0, right)
    axes.set_title(RUN_METRICS[name].name)
    axes.set_xlabel("over its limit")


def histogram_figure(found: CampaignStatistics, name: str) -> Figure:
    """Return histograms of one metric in each manoeuvre with a limit on it."""
    return histograms([(one, name) for one in with_limit(found, name)], _COLUMNS)
