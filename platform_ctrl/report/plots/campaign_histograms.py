"""How the figures of a campaign's runs are distributed, against their limits."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from platform_ctrl.campaign.engine import Campaigned
from platform_ctrl.campaign.statistics import CampaignStatistics, Limits, statistics
from platform_ctrl.campaign.store import TABLE, read_record
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.campaign.table import FIGURES, Table
from platform_ctrl.common.arguments import one_of
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.report.campaign_figures import asked, histograms
from platform_ctrl.report.style import standalone

_COLUMNS = 3


@standalone
def campaign_histograms(
    campaign: CampaignStatistics | Summary | Campaigned | Table,
    limits: Limits | None = None,
    *,
    figure: str | None = None,
) -> Figure:
    """Histograms of a campaign's figures, a panel for each manoeuvre that asks for one; beyond the limit in red.

    Parameters
    ----------
    campaign
        What `campaign.statistics` or `campaign.summarised` returned, the folder that ``platform-ctrl campaign`` wrote,
        its table (Parquet, or a dict of columns), or what `run_campaign` returned.
    limits
        What each manoeuvre asks of each figure at most, {manoeuvre: {figure: limit}}, in SI units; needed for a table,
        and for a folder without statistics.
    figure
        ``"angle"``, ``"attitude"`` or ``"torque_share"``; default all that are asked for.

    Returns
    -------
    matplotlib.figure.Figure
        Rows of panels, a column for each figure.

    Raises
    ------
    ArgumentError
        Something else, a table without limits, or nothing is asked of the runs.
    InputError
        The files cannot be read.
    """
    if figure is not None:
        one_of("campaign_histograms: figure", figure, tuple(FIGURES))
    found = _statistics(campaign, limits)
    names = [name for name in FIGURES if figure in (None, name)]
    cells = [(one, name) for name in names for one in asked(found, name) if one.violation.runs]
    if not cells:
        what = "any figure" if figure is None else repr(figure)
        raise ArgumentError(
            f"campaign_histograms: no manoeuvre has a limit on {what}, or none was flown; nothing to draw"
        )
    columns = 2 if len(cells) == 4 else min(_COLUMNS, len(cells))
    return histograms(cells, columns)


def _statistics(campaign: object, limits: Limits | None) -> CampaignStatistics:
    if isinstance(campaign, CampaignStatistics | Summary):
        if limits is not None:
            raise ArgumentError("campaign_histograms: limits are given with statistics, which have their own")
        return campaign.statistics if isinstance(campaign, Summary) else campaign
    if isinstance(campaign, Campaigned):
        return statistics(campaign.table, _limits(campaign.record, limits))
    if isinstance(campaign, str | os.PathLike):
        folder = Path(campaign)
        if not folder.exists():
            raise InputError(
                f"campaign_histograms: {folder}: does not exist; expected a campaign's folder or its table"
            )
        record = read_record(folder) if folder.is_dir() else None
        if record is not None:
            return statistics(folder / TABLE, _limits(record, limits))
    elif not isinstance(campaign, Mapping | list | tuple):
        raise ArgumentError(
            f"campaign_histograms: given {short(campaign)}; expected statistics, a campaign's folder or its table"
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
            "campaign_histograms: the table does not say what was asked; "
            "give limits, for example {'turn': {'angle': 0.003}}"
        )
    return out
