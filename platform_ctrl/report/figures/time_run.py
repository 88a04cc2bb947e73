"""Everything that a simulated run recorded: angles, torques, rates and attitude over time, with their limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.common.arguments import instance, known_name, positive, short
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.drawing import root_series, signal_series
from platform_ctrl.plant.platform import Platform, Torquer
from platform_ctrl.plant.sensors import LOS_ANGLES, LOS_RATES
from platform_ctrl.report.style import (
    BEYOND,
    DASHED,
    INK,
    LIMIT,
    MUTED,
    REFERENCE,
    SERIES,
    envelope,
    linear_axis,
    panels,
    settings,
    signal_style,
    standalone,
)
from platform_ctrl.simulation.closed_loop import Trajectory
from platform_ctrl.verification.simulated import Run

# Limits further away than this many times the largest value would flatten the trace: they are named instead of drawn.
_FAR = 3.7
# A trace beyond so many times its limit is cut off.
_WILD = 5.0
# Angles below this are drawn in µrad, rad.
_TINY = 1e-5


@standalone
def time_run(run: Run | Trajectory, platform: Platform, *, limits: Mapping[str, float] | None = None) -> Figure:
    """Gimbal angles, torques, platform rate and attitude of a simulated run over time, beyond their limits shaded.

    A run that diverged is drawn up to a red line at its end. A limit far beyond the signals is written in the panel's
    title instead of drawn, which would flatten them.

    Parameters
    ----------
    run
        A manoeuvre that was checked (`verification.Run`, with its limits), or a `simulation.Trajectory`.
    platform
        The plant that was run, with the torquers' limits.
    limits
        By the names of `platform_ctrl.analysis.run_metrics.RUN_METRICS`, SI units; default those of the manoeuvre,
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
    elif not isinstance(limits, Mapping):
        raise ArgumentError(f"time_run: limits must be a mapping such as {{'angle': 0.01}}, got {short(limits)}")
    for name in limits:
        known_name("time_run: limits", name, tuple(RUN_METRICS))
    allowed = {name: positive(f"time_run: limits: {name}", limit) for name, limit in limits.items()}
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
    return _drawn(recorded, torquers, signal_series(platform), allowed, duration)


def _drawn(
    t: Trajectory,
    torquers: Sequence[Torquer],
    series: Mapping[str, int],
    limits: Mapping[str, float],
    duration: float,
) -> Figure:
    """Draw a run with the colour of each signal, `series`."""
    free = t.mode == "stabilised"
    sight = t.line_of_sight.shape[1] > 0
    figure, rows = panels(2 + sight + bool(t.commanded_names), 3 if free else 2, 1.7)
    roots = [k for k, torquer in enumerate(torquers) if torquer.root_axis is not None]
    gimbals = [k for k in range(len(torquers)) if k not in roots]

    angles = {name: series[name] for name in t.angle_names}
    _angles(rows[0][0], t.t, t.q, angles, limits.get("angle"), "gimbal angles")
    _torques(rows[0][1], t, torquers, gimbals, series, "gimbal torques")
    if free:
        _torques(rows[0][2], t, torquers, roots, series, "platform torques")
        title = "inertial platform angles"
        _angles(rows[1][0], t.t, t.attitude_angles, _of_axes("θ"), limits.get("attitude"), title)
    rate = rows[1][1 if free else 0]
    factor, unit = (1e3, "mrad/s") if np.nanmax(np.abs(t.Omega), initial=0.0) < 0.5 else (1.0, "rad/s")
    title = "platform rate" if free else "platform rate, prescribed"
    _traces(rate, t.t, factor * t.Omega, _of_axes("Ω"), None, title, unit)
    _shares(rows[1][-1], t, torquers, gimbals + roots if free else gimbals, limits.get("torque_share"))
    over_time = [axes for axes in rows[:2].flat if axes is not rows[1][-1]]
    if sight:
        over_time += _line_of_sight(rows[2], t)
    if t.commanded_names:
        over_time += _commanded(rows[-1], t)
    for axes in over_time:
        if not t.completed:
            axes.axvline(t.t[-1] if t.t.size else 0.0, color=LIMIT, linewidth=1.0)
        axes.set_xlim(0.0, duration)
        axes.set_xlabel("time, s")
        linear_axis(axes.xaxis, 6)
    return figure


def _line_of_sight(row: Sequence[Axes], t: Trajectory) -> list[Axes]:
    """Draw what of the line of sight is across it; return the panels."""
    names = {name: k for k, name in enumerate(LOS_ANGLES[:2])}
    _angles(row[0], t.t, t.line_of_sight[:, 3:5], names, None, "line of sight, angle since the start")
    factor, unit = (1e3, "mrad/s") if np.nanmax(np.abs(t.line_of_sight[:, :2]), initial=0.0) < 0.5 else (1.0, "rad/s")
    names = {name: k for k, name in enumerate(LOS_RATES[:2])}
    _traces(row[1], t.t, factor * t.line_of_sight[:, :2], names, None, "line of sight, rate", unit)
    for axes in row[2:]:
        axes.set_visible(False)
    return [row[0], row[1]]


def _commanded(row: Sequence[Axes], t: Trajectory) -> list[Axes]:
    """Draw what is commanded, its command dashed over it; return the panels."""
    used = list(dict.fromkeys(t.commanded_units))
    for axes, unit in zip(row, used, strict=False):
        chosen = [k for k, one in enumerate(t.commanded_units) if one == unit]
        names = {t.commanded_names[k]: k for k in chosen}
        reading = t.reading[:, [t.pickoff_names.index(name) for name in names]]
        command = t.reading_command[:, chosen]
        small = np.nanmax(np.abs([reading, command]), initial=0.0) < 0.5
        factor = 1e3 if small else 1.0
        kind = "angle" if unit == "rad" else "rate"
        title = f"commanded {kind}, command dashed"
        _traces(axes, t.t, factor * reading, names, None, title, f"m{unit}" if small else unit)
        axes.plot(t.t, factor * command, color=INK, linewidth=0.9, linestyle=DASHED, zorder=3.0)
    for axes in row[len(used) :]:
        axes.set_visible(False)
    return list(row[: len(used)])


def _angles(
    axes: Axes, t: FloatArray, y: FloatArray, names: Mapping[str, int], limit: float | None, title: str
) -> None:
    """Draw angles in mrad, or in µrad if they are tiny and have no limit."""
    small = limit is None and 0.0 < float(np.nanmax(np.abs(y), initial=0.0)) < _TINY
    factor, unit = (1e6, "µrad") if small else (1e3, "mrad")
    _traces(axes, t, factor * y, names, None if limit is None else factor * limit, title, unit)


def _traces(
    axes: Axes, t: FloatArray, y: FloatArray, names: Mapping[str, int], limit: float | None, title: str, unit: str
) -> None:
    """Draw the columns of `y` (N, k) under their names, each in the colour of the palette that its name has."""
    # The noisiest signal is drawn first, so that it hides no other.
    noise = np.argsort(np.argsort(-np.nan_to_num(np.abs(np.diff(y, axis=0))).sum(axis=0)))
    handles: list[Any] = []
    for k, colour in enumerate(names.values()):
        good = np.isfinite(y[:, k])
        handles += axes.plot(*envelope(t[good], y[good, k]), zorder=2.0 + 0.01 * noise[k], **signal_style(colour))
    finite = y[np.isfinite(y)]
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0))
    largest = max(-low, high)
    if limit is not None and largest > _WILD * limit:
        # Its beginning and the limit matter more than its end.
        low, high = max(low, -_WILD * limit), min(high, _WILD * limit)
    if limit is not None and limit <= _FAR * largest:
        low, high = min(low, -1.12 * limit), max(high, 1.12 * limit)
        for sign in (-1.0, 1.0):
            axes.axhspan(sign * limit, sign * 10.0 * max(-low, high), color=BEYOND, linewidth=0, zorder=0)
            axes.axhline(sign * limit, color=LIMIT, linewidth=0.9, linestyle=DASHED)
        at: dict[str, Any] = {"xycoords": axes.get_yaxis_transform(), "textcoords": "offset points"}
        axes.annotate(f"limit {limit:g} {unit}", (0.0, limit), (3, 2), color=LIMIT, fontsize=7, **at)
    elif limit is not None:
        title += f" (limit ±{limit:g} {unit})"
    extent = (high - low) or 1.0
    # Room for the legend inside the panel, above the traces.
    columns = 3 if len(names) > 3 and axes.get_position().width < 0.3 else 5
    axes.set_ylim(low - 0.08 * extent, high + (0.12 + 0.12 * -(-len(names) // columns)) * extent)
    linear_axis(axes.yaxis)
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


def _torques(
    axes: Axes,
    t: Trajectory,
    torquers: Sequence[Torquer],
    columns: list[int],
    series: Mapping[str, int],
    title: str,
) -> None:
    names = {t.torquer_names[k]: series[t.torquer_names[k]] for k in columns}
    torque_limits = {torquers[k].limit for k in columns}
    largest = float(np.nanmax(np.abs(t.torque[:, columns]), initial=0.0)) if columns else 0.0
    factor, unit = (1e3, "mN m") if largest < 1.0 else (1.0, "N m")
    common = torque_limits.pop() if len(torque_limits) == 1 else None
    _traces(axes, t.t, factor * t.torque[:, columns], names, None if common is None else factor * common, title, unit)


def _shares(axes: Axes, t: Trajectory, torquers: Sequence[Torquer], columns: list[int], limit: float | None) -> None:
    """Bars of the largest commanded torque of every torquer over its own limit."""
    allowed = limit if limit is not None else 1.0
    chosen = [k for k in columns if torquers[k].limit is not None]
    axes.set_title("largest command over its limit")
    if not chosen or not t.t.size:
        axes.set_axis_off()
        look: dict[str, Any] = {"textcoords": "offset points", "color": MUTED, "fontsize": 7}
        axes.annotate("no torquer has a limit", (0.0, 0.0), (4, 4), xycoords="axes fraction", **look)
        return
    peaks = np.nanmax(np.abs(t.command[:, chosen]), axis=0, initial=0.0)
    share = peaks / np.array([torquers[k].limit for k in chosen], dtype=np.float64)
    share = np.where(np.isfinite(share), share, 10.0 * allowed)
    place = np.arange(len(chosen), dtype=np.float64)[::-1]
    right = 1.12 * max(1.0, allowed, min(float(share.max()), 3.0))
    axes.barh(
        place, np.minimum(share, right), 0.6, color=[SERIES[0] if s <= allowed else LIMIT for s in share], linewidth=0
    )
    for y, s in zip(place, share, strict=True):
        inside = s > 0.8 * right
        axes.annotate(
            f"{100.0 * s:.0f} %",
            (min(s, right), y),
            (-3 if inside else 3, 0),
            textcoords="offset points",
            va="center",
            ha="right" if inside else "left",
            fontsize=7.5,
            color="#ffffff" if inside else MUTED,
        )
    axes.axvline(allowed, color=LIMIT, linewidth=0.9, linestyle=DASHED)
    at: dict[str, Any] = {"xycoords": axes.get_xaxis_transform(), "textcoords": "offset points"}
    axes.annotate(f"limit {allowed:g}", (allowed, 1.0), (-3, -1), color=LIMIT, fontsize=7, ha="right", va="top", **at)
    axes.set_yticks(place, [t.torquer_names[k] for k in chosen])
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    axes.set_xlim(0.0, right)
    axes.set_ylim(-0.6, len(chosen) - 0.4)
    axes.axvline(0.0, color=REFERENCE, linewidth=0.8)
    linear_axis(axes.xaxis, 6)
    axes.set_xlabel("share of the limit, 1")


def _of_axes(symbol: str) -> dict[str, int]:
    """Return a symbol with the index of each root axis, and the colour of that axis."""
    return {f"{symbol}{index}": root_series(axis) for axis, index in ((1, "₁"), (2, "₂"), (3, "₃"))}


def write_run_figure(run: Run, platform: Platform, title: str, path: Path) -> None:
    """Draw everything that a run recorded and write it to `path` as SVG, whole or not at all."""
    out = StringIO()
    with settings():
        figure = time_run(run, platform)
        above = 1.0 + 0.12 / figure.get_size_inches()[1]
        figure.text(0.0, above, title, color=INK, fontsize=9.0, fontweight="bold", ha="left", va="bottom")
        figure.savefig(
            out, format="svg", facecolor="white", bbox_inches="tight", pad_inches=0.1, metadata={"Date": None}
        )
    write_whole(path, out.getvalue())
