"""Everything that a simulated run recorded, over time with its limits, and histograms of the runs of a campaign."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.campaign.statistics import CampaignStatistics, RequirementStatistics
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.common.arguments import instance, known_name, short
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import handy_unit, plain
from platform_ctrl.plant.drawing import root_series, signal_series
from platform_ctrl.plant.drives import Torquer
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.sensors import LOS_ANGLES, LOS_RATES
from platform_ctrl.report import style
from platform_ctrl.simulation.closed_loop import Trajectory
from platform_ctrl.verification.simulated import Run

# Limits further away than this many times the largest value would flatten the trace: they are named instead of drawn.
_FAR = 3.7
# A trace beyond so many times its limit is cut off.
_WILD = 5.0
# Of histograms: columns of panels and bins; height of a panel, inches.
_COLUMNS = 3
_BINS = 48
# A limit beyond this multiple of the largest value would squeeze the histogram: it is written instead.
_FAR_LIMIT = 2.5
# Values beyond this multiple of the limit, or of the 90 % quantile, are counted and not drawn.
_FAR_VALUES = 2.0
# A limit below this share of the values would squeeze the histogram: it is written instead.
_LOW = 0.25
# Largest start of the axis, as a share of the limit.
_BEFORE = 0.9
# Least share of a panel beyond the limit: the note is written there.
_BEYOND_LIMIT = 0.3
_CELL = 1.75


@style.standalone
def time_run(run: Run | Trajectory, platform: Platform, *, limits: Mapping[str, float] | None = None) -> Figure:
    """Gimbal angles, torques, platform rate and attitude of a simulated run over time, beyond their limits shaded.

    A run that diverged is drawn up to a red line at its end. A limit far beyond the signals is written in the panel's
    title instead of drawn, which would flatten them.

    Parameters
    ----------
    run
        A manoeuvre that was checked, with its limits (one of `runs` of what `check_job` returns), or the result of
        `simulation.simulate`.
    platform
        The plant that was run, with the torquers' limits.
    limits
        By the names of `platform_ctrl.analysis.metrics.RUN_METRICS`, SI units; default those of the manoeuvre,
        none of a trajectory. ``angle``, ``attitude`` and ``torque_share`` are drawn.

    Returns
    -------
    matplotlib.figure.Figure
        Panels above each other, over time in s.

    Raises
    ------
    ArgumentError
        Something other than a run, another platform than the run's, or an unknown limit.
    """
    recorded = run.trajectory if isinstance(run, Run) else instance("time_run: run", run, Trajectory)
    if limits is None:
        limits = run.manoeuvre.limits if isinstance(run, Run) else {}
    for name in limits:
        known_name("time_run: limits", name, tuple(RUN_METRICS))
    torquers = list(instance("time_run: platform", platform, Platform).torquers)
    names, own = recorded.torquer_names, tuple(torquer.name for torquer in torquers)
    if own != names or platform.angle_names != recorded.angle_names:
        raise ArgumentError(
            f"time_run: platform must be the one that was run, with torquers {', '.join(names)}; "
            f"{platform.name!r} has {', '.join(own)}"
        )
    duration = run.manoeuvre.duration if isinstance(run, Run) else math.nan
    if not duration > 0.0:
        duration = float(recorded.t[-1]) if recorded.t.size > 1 else recorded.period
    return _drawn(recorded, torquers, signal_series(platform), limits, duration)


@value
class _Signals:
    """What one panel shows: columns of `y` (N, k) under their names, each with its place in the palette."""

    title: str
    unit: str
    y: FloatArray
    names: Mapping[str, int]
    limit: float | None = None
    command: FloatArray | None = None  # (N, k), dashed over it


def _drawn(
    t: Trajectory, torquers: Sequence[Torquer], series: Mapping[str, int], limits: Mapping[str, float], duration: float
) -> Figure:
    """Draw a run with the colour of each signal, `series`."""
    free = t.mode == "stabilised"

    def torques(title: str, of_root: bool, unit: str = "N m") -> _Signals:
        chosen = [k for k, one in enumerate(torquers) if (one.root_axis is not None) == of_root and one.unit == unit]
        names = {t.torquer_names[k]: series[t.torquer_names[k]] for k in chosen}
        # Only a common limit has a line.
        common = {torquers[k].limit for k in chosen}
        limit = common.pop() if len(common) == 1 else None
        allowed = None if limit is None else limits.get("torque_share", 1.0) * limit
        return _Signals(title=title, unit=unit, y=t.torque[:, chosen], names=names, limit=allowed)

    angles = {name: series[name] for name in t.angle_names}
    wanted = [
        _Signals(title="gimbal angles", unit="rad", y=t.q, names=angles, limit=limits.get("angle")),
        *(
            torques("gimbal torques" if unit == "N m" else "commands of servos", of_root=False, unit=unit)
            for unit in dict.fromkeys(one.unit for one in torquers if one.root_axis is None)
        ),
    ]
    if free:
        attitude: dict[str, Any] = {"names": _of_axes("θ"), "limit": limits.get("attitude")}
        wanted += [
            torques("platform torques", of_root=True),
            _Signals(title="inertial platform angles", unit="rad", y=t.attitude_angles, **attitude),
        ]
    title = "platform rate" if free else "platform rate, prescribed"
    wanted.append(_Signals(title=title, unit="rad/s", y=t.Omega, names=_of_axes("Ω")))
    if t.line_of_sight.shape[1] > 0:
        sight = {"angle since the start": ("rad", LOS_ANGLES, 3), "rate": ("rad/s", LOS_RATES, 0)}
        for what, (unit, signals, first) in sight.items():
            across = {name: k for k, name in enumerate(signals[:2])}
            y = t.line_of_sight[:, first : first + 2]
            wanted.append(_Signals(title=f"line of sight, {what}", unit=unit, y=y, names=across))
    for unit in dict.fromkeys(t.commanded_units):
        chosen = [k for k, one in enumerate(t.commanded_units) if one == unit]
        names = {t.commanded_names[k]: k for k in chosen}
        reading = t.reading[:, [t.pickoff_names.index(name) for name in names]]
        title = f"commanded {'angle' if unit == 'rad' else 'rate'}, command dashed"
        wanted.append(_Signals(title=title, unit=unit, y=reading, names=names, command=t.reading_command[:, chosen]))
    columns = 2 if len(wanted) == 4 else 3
    figure, rows = style.panels(-(-len(wanted) // columns), columns, 1.7)
    for axes in rows.flat[len(wanted) :]:
        axes.set_visible(False)
    for axes, shown in zip(rows.flat, wanted, strict=False):
        _traces(axes, t.t, shown)
        if not t.completed:
            axes.axvline(t.t[-1] if t.t.size else 0.0, color=style.LIMIT, linewidth=1.0)
        axes.set_xlim(0.0, duration)
        axes.set_xlabel("time, s")
        style.linear_axis(axes.xaxis, 6)
    return figure


def _traces(axes: Axes, t: FloatArray, shown: _Signals) -> None:
    largest = float(np.nanmax(np.abs(shown.y), initial=0.0))
    factor, unit = handy_unit(shown.unit, shown.limit or (largest if np.isfinite(largest) else 1.0) or 1e-3)
    y, names, title = factor * shown.y, shown.names, shown.title
    limit = None if shown.limit is None else factor * shown.limit
    if shown.command is not None:
        axes.plot(t, factor * shown.command, color=style.INK, linewidth=0.9, linestyle=style.DASHED, zorder=3.0)
    # The noisiest signal is drawn first, so that it hides no other.
    noise = np.argsort(np.argsort(-np.nan_to_num(np.abs(np.diff(y, axis=0))).sum(axis=0)))
    handles: list[Any] = []
    for k, colour in enumerate(names.values()):
        good = np.isfinite(y[:, k])
        look = style.line_style(colour) | {"linewidth": 1.0, "zorder": 2.0 + 0.01 * noise[k]}
        handles += axes.plot(*style.envelope(t[good], y[good, k]), **look)
    finite = y[np.isfinite(y)]
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0))
    largest = max(-low, high)
    if limit is not None and largest > _WILD * limit:
        # Its beginning and the limit matter more than its end.
        low, high = max(low, -_WILD * limit), min(high, _WILD * limit)
    if limit is not None and limit <= _FAR * largest:
        low, high = min(low, -1.12 * limit), max(high, 1.12 * limit)
        for sign in (-1.0, 1.0):
            axes.axhspan(sign * limit, sign * 10.0 * max(-low, high), color=style.BEYOND, linewidth=0, zorder=0)
            axes.axhline(sign * limit, color=style.LIMIT, linewidth=0.9, linestyle=style.DASHED)
        at: dict[str, Any] = {"xycoords": axes.get_yaxis_transform(), "textcoords": "offset points"}
        axes.annotate(f"limit {limit:g} {unit}", (0.0, limit), (3, 2), color=style.LIMIT, fontsize=7, **at)
    elif limit is not None:
        title += f" (limit ±{limit:g} {unit})"
    extent = (high - low) or 1.0
    # Room for the legend inside the panel, above the traces.
    columns = 3 if len(names) > 3 and axes.get_position().width < 0.3 else 5
    axes.set_ylim(low - 0.08 * extent, high + (0.12 + 0.12 * -(-len(names) // columns)) * extent)
    style.linear_axis(axes.yaxis)
    axes.set_title(title)
    axes.set_ylabel(unit)
    axes.legend(
        handles,
        list(names),
        loc="upper right",
        ncols=min(columns, len(names)),
        handlelength=1.1,
        columnspacing=0.9,
        borderaxespad=0.1,
        fontsize=7,
    )


def _of_axes(symbol: str) -> dict[str, int]:
    """Return a symbol with the index of each root axis, and the colour of that axis."""
    return {f"{symbol}{index}": root_series(axis) for axis, index in ((1, "₁"), (2, "₂"), (3, "₃"))}


def write_run_figure(run: Run, platform: Platform, title: str, path: Path) -> None:
    """Draw everything that a run recorded and write it to `path` as SVG, whole or not at all."""
    out = StringIO()
    with style.settings():
        figure = time_run(run, platform)
        above = 1.0 + 0.12 / figure.get_size_inches()[1]
        figure.text(0.0, above, title, color=style.INK, fontsize=9.0, fontweight="bold", ha="left", va="bottom")
        figure.savefig(
            out, format="svg", facecolor="white", bbox_inches="tight", pad_inches=0.1, metadata={"Date": None}
        )
    write_whole(path, out.getvalue())


@style.standalone
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
    wanted = [one for name in RUN_METRICS for one in with_limit(found, name) if one.violation.runs]
    if not wanted:
        raise ArgumentError("campaign_histograms: no simulated manoeuvre has a limit; there is nothing to draw")
    return histograms(wanted, 2 if len(wanted) == 4 else min(_COLUMNS, len(wanted)))


def histograms(wanted: Sequence[RequirementStatistics], columns: int = _COLUMNS) -> Figure:
    """Return a figure with a histogram for each requirement, row by row."""
    drawn, grid = style.panels(-(-len(wanted) // columns), columns, _CELL)
    cells = list(grid.flat)
    for axes, one in zip(cells, wanted, strict=False):
        _histogram_panel(axes, one)
    for axes in cells[len(wanted) :]:
        axes.set_visible(False)
    for row in grid:
        row[0].set_ylabel("runs")
    return drawn


def _histogram_panel(axes: Axes, one: RequirementStatistics) -> None:
    """Draw the histogram of one metric in one manoeuvre, red beyond its limit."""
    values, limit, metric = one.values[np.isfinite(one.values)], one.limit, RUN_METRICS[one.requirement]
    assert limit is not None
    factor, unit = handy_unit(metric.unit, limit)
    usual = one.quantiles[0.9]
    high = min(values.max(initial=0.0), _FAR_VALUES * max(limit, usual if np.isfinite(usual) else limit)) or limit
    low = values.min() if values.size and values.min() > 0.5 * high else 0.0
    near = _LOW * low <= limit <= _FAR_LIMIT * high
    if near:
        low = min(low, _BEFORE * limit)
        high = max(high, low + (limit - low) / (1.0 - _BEYOND_LIMIT))
    width = 1.02 * (high - low) / _BINS or limit
    # The limit is an edge of two bins.
    first, last = math.floor((low - limit) / width), math.ceil((1.02 * high - limit) / width)
    edges = limit + width * np.arange(first, last + 1)
    counts, beyond = np.histogram(values, edges)[0], np.arange(first, last) >= 0
    axes.stairs(counts, factor * edges, fill=True, color=style.SERIES[0], linewidth=0)
    if beyond.any():
        axes.stairs(np.where(beyond, counts, 0), factor * edges, fill=True, color=style.LIMIT, linewidth=0)
        end = factor * limit
        axes.axvspan(end, max(1e3 * end, 2.0 * factor * edges[-1]), color=style.BEYOND, linewidth=0, zorder=0)
        axes.axvline(end, color=style.LIMIT, linewidth=0.9, linestyle=style.DASHED, zorder=1.5)
    axes.set_xlim(factor * edges[0], factor * edges[-1])
    axes.set_ylim(0.0, 1.18 * max(counts.max(initial=1), 1))
    style.linear_axis(axes.xaxis)
    style.linear_axis(axes.yaxis, 4)
    axes.set_title(str(one.manoeuvre))
    axes.set_xlabel(", ".join(filter(None, [metric.name, unit])))
    far = "" if counts[beyond].any() else "far "
    words = f"{one.violation.events:,} {far}beyond" if one.violation.events else "none beyond"
    words += "" if near else f" the limit, {plain(factor * limit, 4)} {unit}".rstrip()
    look: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "right", "va": "top"}
    colour = style.LIMIT if one.violation.events else style.MUTED
    axes.annotate(words, (1.0, 1.0), (-3, -2), fontsize=7, color=colour, **look)


def with_limit(found: CampaignStatistics, name: str) -> list[RequirementStatistics]:
    """Return the requirements on one metric, manoeuvre by manoeuvre."""
    return [one for one in found.requirements if one.requirement == name and one.manoeuvre is not None and one.limit]
