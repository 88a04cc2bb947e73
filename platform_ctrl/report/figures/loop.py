"""The figures of one loop: all designs over one another."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.report.figures.limit_lines import goal_frequency, limit_lines
from platform_ctrl.report.loop_responses import LoopResponses
from platform_ctrl.report.plots.nichols import nichols
from platform_ctrl.report.quantities import HZ
from platform_ctrl.report.style import (
    BAND,
    MARKERS,
    MUTED,
    REFERENCE,
    SERIES,
    emphasised,
    frequency_axes,
    gain_limits,
    legend_above,
    legend_rows,
    line_style,
    panels,
)

# With more designs than this only the closed one shows all its singular values.
_ALL_LINES = 2
# More panels than this are drawn in two rows.
_ONE_ROW = 4


def sensitivity_figure(responses: LoopResponses, spec: LoopSpec) -> Figure:
    """Singular values of S, T and (S − T)/2 over frequency, with what is asked of bandwidth, peaks and disk margin."""
    names = design_names(responses)
    figure, [[left, middle, right]] = panels(1, 3, 3.1, legend=legend_rows(names))
    f = responses.frequency * HZ
    limits, soft = spec.limits, spec.soft
    handles = []
    for k, one in enumerate(responses.designs):
        chosen = one.design.name == responses.closed
        handles += left.plot(f, one.sensitivity, **emphasised(k, chosen))
        if chosen or len(responses.designs) <= _ALL_LINES:
            left.plot(f, one.smallest_sensitivity, **line_style(k) | {"linewidth": 0.7})
        middle.plot(f, one.complementary, **emphasised(k, chosen))
        right.plot(f, one.balanced, **emphasised(k, chosen))
        if one.design.measures is not None and np.isfinite(one.design.measures.bandwidth):
            at = one.design.measures.bandwidth * HZ
            left.plot([at], [np.sqrt(0.5)], MARKERS[k % 8], color=SERIES[k % 8], markersize=5, zorder=4)
    for axes, curves in ((left, "sensitivity"), (middle, "complementary"), (right, "balanced")):
        frequency_axes(axes, f[0], f[-1])
        gain_limits(axes, [getattr(one, curves) for one in responses.designs], low=1e-3, high=1e2)
    left.axhline(np.sqrt(0.5), color=REFERENCE, linewidth=0.8)
    at_end: dict[str, Any] = {"textcoords": "offset points", "color": MUTED, "fontsize": 7, "ha": "right", "va": "top"}
    left.annotate("1/√2", (f[-1], np.sqrt(0.5)), (-3, -2), **at_end)
    if "bandwidth_hz" in limits:
        left.axvspan(f[0], limits["bandwidth_hz"], color=BAND, linewidth=0, zorder=0)
    goal_frequency(left, soft.get("bandwidth_hz"))
    peaks = (
        (left, "sensitivity peak"),
        (left, "tracking"),
        (middle, "complementary sensitivity peak"),
        (right, "disk margin"),
    )
    for axes, kind in peaks:
        limit_lines(axes, spec, kind)
    left.set_title("S: what is left of a disturbance")
    middle.set_title("T: what passes through")
    right.set_title("(S − T)/2: 1/disk margin at its peak")
    left.set_ylabel("singular values, 1")
    legend_above(figure, handles, names)
    return figure


def loop_transfer_figure(responses: LoopResponses, spec: LoopSpec, torques: tuple[str, ...], nutation: float) -> Figure:
    """Singular values of the loop transfer and of the controller, and the Bode diagram of each channel."""
    require_each_channel(responses, torques)
    names = design_names(responses)
    figure, rows = panels(2, 1 + len(torques), 4.4, legend=legend_rows(names))
    f = responses.frequency * HZ
    handles = []
    for k, one in enumerate(responses.designs):
        chosen = one.design.name == responses.closed
        every = chosen or len(responses.designs) <= _ALL_LINES
        for j, gain in enumerate(one.loop_gains if every else one.loop_gains[:1]):
            drawn = rows[0][0].plot(f, gain, **emphasised(k, chosen) | ({} if j == 0 else {"linewidth": 0.8}))
            handles += drawn if j == 0 else []
        rows[1][0].plot(f, one.controller_gain, **emphasised(k, chosen))
        for i, channel in enumerate(one.channels):
            rows[0][1 + i].plot(f, np.abs(channel), **emphasised(k, chosen))
            rows[1][1 + i].plot(f, phase_in_degrees(channel), **emphasised(k, chosen))
    for axes in rows[0]:
        frequency_axes(axes, f[0], f[-1], label=False)
        axes.axhline(1.0, color=REFERENCE, linewidth=0.8)
    gain_limits(rows[0][0], [one.loop_gains for one in responses.designs], low=1e-3, high=1e4)
    frequency_axes(rows[1][0], f[0], f[-1])
    gain_limits(rows[1][0], [one.controller_gain for one in responses.designs])
    limit_lines(rows[1][0], spec, "controller gain", from_hz=nutation / 10.0 * HZ)
    for i, name in enumerate(torques):
        gain_limits(rows[0][1 + i], [np.abs(one.channels[i]) for one in responses.designs], low=1e-3, high=1e4)
        rows[0][1 + i].set_title(f"{name}, others closed")
        phase_axes(rows[1][1 + i], f)
    rows[0][0].set_title("loop transfer")
    rows[0][0].set_ylabel("singular values, 1")
    rows[0][1].set_ylabel("gain, 1")
    rows[1][0].set_title("controller, largest gain")
    rows[1][0].set_ylabel("N m/rad")
    rows[1][1].set_ylabel("phase, degrees")
    legend_above(figure, handles, names)
    return figure


def disturbance_figure(responses: LoopResponses, spec: LoopSpec) -> Figure:
    """From platform rate and torque disturbance to the gimbal angles, and the torque that the rate asks for."""
    acting = [a for a in range(3) if np.nanmax(responses.open_angle_per_rate[a], initial=0.0) > 1e-12]
    shares = [one.torque_share for one in responses.designs]
    limited = bool(np.nanmax(shares, initial=0.0) > 0.0)
    names = ["open loop", *design_names(responses)]
    number = len(acting) + 1 + limited
    columns = number if number <= _ONE_ROW else -(-number // 2)
    rows = -(-number // columns)
    figure, grid = panels(rows, columns, 3.0 * rows, legend=legend_rows(names))
    cells = [axes for row in grid for axes in row]
    for unused in cells[number:]:
        unused.remove()
    f = responses.frequency * HZ
    handles: list[Any] = []
    for axes, a in zip(cells, acting, strict=False):
        opened = 1e3 * responses.open_angle_per_rate[a]
        handles = _open_and_closed(
            axes, f, opened, [1e3 * one.angle_per_rate[a] for one in responses.designs], responses
        )
        axes.set_title(f"rate Omega{a + 1} → angles")
        limit_lines(axes, spec, "Omega rejection", scale=1e3)
    cells[0].set_ylabel("mrad per rad/s" if acting else "mrad per mN m")
    axes = cells[len(acting)]
    closed = [one.angle_per_torque for one in responses.designs]
    handles = _open_and_closed(axes, f, responses.open_angle_per_torque, closed, responses)
    axes.set_title("torque disturbance → angles")
    axes.set_ylabel("mrad per mN m")
    limit_lines(axes, spec, "torque rejection")
    if limited:
        _torque_share(cells[number - 1], f, responses, spec)
    legend_above(figure, handles, names)
    return figure


def _torque_share(axes: Axes, f: FloatArray, responses: LoopResponses, spec: LoopSpec) -> None:
    for k, one in enumerate(responses.designs):
        axes.plot(f, one.torque_share, **emphasised(k, one.design.name == responses.closed))
    frequency_axes(axes, f[0], f[-1])
    gain_limits(axes, [one.torque_share for one in responses.designs], low=1e-3, high=1e2)
    axes.axhline(1.0, color=REFERENCE, linewidth=0.8)
    limit_lines(axes, spec, "torque limit")
    axes.set_title("full Omega → torque")
    axes.set_ylabel("torque over its limit, 1")


def _open_and_closed(
    axes: Axes, f: FloatArray, opened: FloatArray, closed: list[FloatArray], responses: LoopResponses
) -> list[Any]:
    handles = axes.plot(f, opened, color=REFERENCE, linewidth=1.1)
    for k, (curve, one) in enumerate(zip(closed, responses.designs, strict=True)):
        handles += axes.plot(f, curve, **emphasised(k, one.design.name == responses.closed))
    frequency_axes(axes, f[0], f[-1])
    top = 10.0 * max((float(np.nanmax(curve)) for curve in closed), default=float(np.nanmax(opened)))
    gain_limits(axes, [*closed, opened], low=1e-5 * top, high=top)
    return handles


def require_each_channel(responses: LoopResponses, torques: tuple[str, ...]) -> None:
    """Judge the names of the loop's torques."""
    for one in responses.designs:
        if len(one.channels) != len(torques):
            raise ArgumentError(
                f"torques: given {short(torques)}; expected the names of the loop's {len(one.channels)} torques"
            )


def design_names(responses: LoopResponses) -> list[str]:
    """Return what the legend calls the designs: which one is closed, where there are several."""
    names = [one.design.name for one in responses.designs]
    return names if len(names) == 1 else [f"{name}, closed" if name == responses.closed else name for name in names]


def phase_in_degrees(channel: ComplexArray) -> FloatArray:
    """Phase in degrees, unwrapped, and shifted by whole turns so that it crosses over between −360° and 0."""
    phase = np.degrees(np.unwrap(np.angle(channel)))
    gain = np.abs(channel)
    middle = phase[int(np.argmin(np.abs(np.log(np.maximum(gain, 1e-300)))))]
    return np.asarray(phase - 360.0 * np.ceil(middle / 360.0))


def phase_axes(axes: Axes, f: FloatArray) -> None:
    """Make `axes` those of a phase over frequency, ticks at right angles, a line at −180°."""
    frequency_axes(axes, f[0], f[-1], log_gain=False)
    low, high = axes.get_ylim()
    low, high = 90.0 * np.floor(max(low, -1080.0) / 90.0), 90.0 * np.ceil(min(high, 720.0) / 90.0)
    axes.set_ylim(low, high)
    step = 90.0 if high - low <= 540.0 else 180.0
    axes.set_yticks(np.arange(step * np.ceil(low / step), high + 1.0, step))
    axes.axhline(-180.0, color=REFERENCE, linewidth=0.8)


# No loop has a larger disk margin.
_LARGEST_MARGIN = 2.0


def nichols_figure(responses: LoopResponses, spec: LoopSpec, torques: tuple[str, ...]) -> Figure:
    """Nichols plot of the closed design: the loop that each torquer closes while all the others stay closed."""
    import control

    closed = next(one for one in responses.designs if one.design.name == responses.closed)
    loops = {
        name: control.FrequencyResponseData(channel[None, None, :], responses.frequency)
        for name, channel in zip(torques, closed.channels, strict=True)
    }
    asked = spec.limits.get("disk_margin")
    figure = nichols(loops, disk_margins=() if asked is None or asked >= _LARGEST_MARGIN else (asked,)).figure
    assert isinstance(figure, Figure)
    return figure
