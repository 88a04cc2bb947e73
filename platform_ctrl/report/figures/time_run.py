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

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.common.arguments import instance, known_name
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import handy_unit
from platform_ctrl.plant.drawing import root_series, signal_series
from platform_ctrl.plant.platform import Platform, Torquer
from platform_ctrl.plant.sensors import LOS_ANGLES, LOS_RATES
from platform_ctrl.report.style import (
    BEYOND,
    DASHED,
    INK,
    LIMIT,
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
    t: Trajectory,
    torquers: Sequence[Torquer],
    series: Mapping[str, int],
    limits: Mapping[str, float],
    duration: float,
) -> Figure:
    """Draw a run with the colour of each signal, `series`."""
    free = t.mode == "stabilised"

    def torques(title: str, of_root: bool) -> _Signals:
        chosen = [k for k, torquer in enumerate(torquers) if (torquer.root_axis is not None) == of_root]
        names = {t.torquer_names[k]: series[t.torquer_names[k]] for k in chosen}
        # Only a common limit has a line.
        common = {torquers[k].limit for k in chosen}
        limit = common.pop() if len(common) == 1 else None
        allowed = None if limit is None else limits.get("torque_share", 1.0) * limit
        return _Signals(title=title, unit="N m", y=t.torque[:, chosen], names=names, limit=allowed)

    angles = {name: series[name] for name in t.angle_names}
    wanted = [
        _Signals(title="gimbal angles", unit="rad", y=t.q, names=angles, limit=limits.get("angle")),
        torques("gimbal torques", of_root=False),
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
    figure, rows = panels(-(-len(wanted) // columns), columns, 1.7)
    for axes in rows.flat[len(wanted) :]:
        axes.set_visible(False)
    for axes, shown in zip(rows.flat, wanted, strict=False):
        _traces(axes, t.t, shown)
        if not t.completed:
            axes.axvline(t.t[-1] if t.t.size else 0.0, color=LIMIT, linewidth=1.0)
        axes.set_xlim(0.0, duration)
        axes.set_xlabel("time, s")
        linear_axis(axes.xaxis, 6)
    return figure


def _traces(axes: Axes, t: FloatArray, shown: _Signals) -> None:
    largest = float(np.nanmax(np.abs(shown.y), initial=0.0))
    factor, unit = handy_unit(shown.unit, shown.limit or (largest if np.isfinite(largest) else 1.0) or 1e-3)
    y, names, title = factor * shown.y, shown.names, shown.title
    limit = None if shown.limit is None else factor * shown.limit
    if shown.command is not None:
        axes.plot(t, factor * shown.command, color=INK, linewidth=0.9, linestyle=DASHED, zorder=3.0)
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
