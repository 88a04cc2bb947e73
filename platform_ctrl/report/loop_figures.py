"""The figures of one loop: all designs over one another."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray
from platform_ctrl.job import LoopLimits
from platform_ctrl.report.loop_responses import LoopResponses, RootLocus
from platform_ctrl.report.style import (
    BAND,
    INK,
    LIMIT,
    MARKERS,
    MUTED,
    REFERENCE,
    SERIES,
    frequency_axes,
    gain_limits,
    legend_above,
    line_style,
    linear_axis,
    panels,
)

_HZ = 1.0 / (2.0 * np.pi)
_LABELLED_GAINS = (0.0, 0.5, 1.0, 1.5, 2.0)


def sensitivity_figure(responses: LoopResponses, limits: LoopLimits) -> Figure:
    """Singular values of S, T and (S − T)/2 over frequency, with bandwidth and disk margin."""
    figure, [[left, middle, right]] = panels(1, 3, 3.1, legend=True)
    f = responses.frequency * _HZ
    handles = []
    for k, one in enumerate(responses.designs):
        handles += left.plot(f, one.sensitivity, **line_style(k))
        left.plot(f, one.smallest_sensitivity, **line_style(k) | {"linewidth": 0.7})
        middle.plot(f, one.complementary, **line_style(k))
        right.plot(f, one.balanced, **line_style(k))
        if one.design.measures is not None and np.isfinite(one.design.measures.bandwidth):
            at = one.design.measures.bandwidth * _HZ
            left.plot([at], [np.sqrt(0.5)], MARKERS[k % 8], color=SERIES[k % 8], markersize=5)
    for axes, curves in ((left, "sensitivity"), (middle, "complementary"), (right, "balanced")):
        frequency_axes(axes, f[0], f[-1])
        gain_limits(axes, [getattr(one, curves) for one in responses.designs], low=1e-3, high=1e2)
    left.axhline(np.sqrt(0.5), color=REFERENCE, linewidth=0.8)
    left.annotate("1/√2", (f[0], np.sqrt(0.5)), (3, 2), textcoords="offset points", color=MUTED, fontsize=7)
    if limits.bandwidth_hz is not None:
        left.axvspan(f[0], limits.bandwidth_hz, color=BAND, linewidth=0, zorder=0)
    if limits.disk_margin is not None:
        _ceiling(right, 1.0 / limits.disk_margin, f"1/{limits.disk_margin:g}")
    left.set_title("S: what is left of a disturbance")
    middle.set_title("T: what passes through")
    right.set_title("(S − T)/2: 1/disk margin at its peak")
    left.set_ylabel("singular values, 1")
    _design_legend(figure, handles, responses)
    return figure


def loop_transfer_figure(responses: LoopResponses, torques: tuple[str, ...]) -> Figure:
    """Singular values of the loop transfer and of the controller, and the Bode diagram of each channel."""
    figure, rows = panels(2, 1 + len(torques), 4.4, legend=True)
    f = responses.frequency * _HZ
    handles = []
    for k, one in enumerate(responses.designs):
        for j, gain in enumerate(one.loop_gains):
            drawn = rows[0][0].plot(f, gain, **line_style(k) | ({} if j == 0 else {"linewidth": 0.8}))
            handles += drawn if j == 0 else []
        rows[1][0].plot(f, one.controller_gain, **line_style(k))
        for i, channel in enumerate(one.channels):
            rows[0][1 + i].plot(f, np.abs(channel), **line_style(k))
            rows[1][1 + i].plot(f, phase_in_degrees(channel), **line_style(k))
    for axes in rows[0]:
        frequency_axes(axes, f[0], f[-1], label=False)
        axes.axhline(1.0, color=REFERENCE, linewidth=0.8)
    gain_limits(rows[0][0], [one.loop_gains for one in responses.designs], low=1e-3, high=1e4)
    frequency_axes(rows[1][0], f[0], f[-1])
    gain_limits(rows[1][0], [one.controller_gain for one in responses.designs])
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
    _design_legend(figure, handles, responses)
    return figure


def disturbance_figure(responses: LoopResponses) -> Figure:
    """From platform rate, axis by axis, and from torque disturbance to the gimbal angles: closed against open loop."""
    acting = [a for a in range(3) if np.nanmax(responses.open_angle_per_rate[a], initial=0.0) > 1e-12]
    figure, [row] = panels(1, len(acting) + 1, 3.0, legend=True)
    f = responses.frequency * _HZ
    handles: list[Any] = []
    for axes, a in zip(row, acting, strict=False):
        opened = 1e3 * responses.open_angle_per_rate[a]
        closed = [1e3 * one.angle_per_rate[a] for one in responses.designs]
        handles = _open_and_closed(axes, f, opened, closed)
        axes.set_title(f"rate Omega{a + 1} → angles")
    row[0].set_ylabel("mrad per rad/s" if acting else "mrad per mN m")
    handles = _open_and_closed(
        row[-1], f, responses.open_angle_per_torque, [one.angle_per_torque for one in responses.designs]
    )
    row[-1].set_title("torque disturbance → angles")
    row[-1].set_ylabel("mrad per mN m")
    legend_above(figure, handles, ["open loop", *(one.design.name for one in responses.designs)])
    return figure


def pole_figure(responses: LoopResponses, limits: LoopLimits, nutation: float, period: float) -> Figure:
    """Closed-loop poles of the nominal plant (strong) and of all others (faint), with the damping that is asked."""
    figure, [[wide, close]] = panels(1, 2, 3.7, legend=True)
    nyquist = np.pi / period
    handles = []
    for axes in (wide, close):
        for k, one in enumerate(responses.designs):
            spread, own = _upper(one.spread_poles), _upper(one.poles)
            style: dict[str, Any] = {"color": SERIES[k % 8], "linestyle": "none", "marker": MARKERS[k % 8]}
            axes.plot(spread.real, spread.imag, **style | {"markersize": 1.8, "alpha": 0.35, "markeredgewidth": 0})
            drawn = axes.plot(
                own.real, own.imag, **style | {"markersize": 6, "markerfacecolor": "none", "markeredgewidth": 1.3}
            )
            handles += drawn if axes is wide else []
    _s_plane(wide, -1.1 * nyquist, 0.12 * nyquist, 1.02 * nyquist, limits, False)
    extent = 1.7 * nutation
    _s_plane(close, -1.2 * extent, 0.18 * extent, extent, limits, True)
    wide.set_title("all poles up to the Nyquist frequency")
    close.set_title("around the nutation frequency and below")
    _design_legend(figure, handles, responses)
    return figure


def root_locus_figure(locus: RootLocus, limits: LoopLimits, nutation: float, period: float) -> Figure:
    """Poles of the closed design while its gain goes from 0 to twice its value."""
    figure, [[wide, close]] = panels(1, 2, 3.9, legend=True)
    nyquist = np.pi / period
    handles: list[Any] = []
    marks = [int(np.argmin(np.abs(locus.gains - g))) for g in _LABELLED_GAINS if g <= locus.gains[-1]]
    for axes in (wide, close):
        for branch in locus.branches.T:
            shown = np.where(branch.imag > -1e-6 * nyquist, branch, np.nan)
            if np.isfinite(shown.real).any():
                axes.plot(shown.real, shown.imag, "-", color=SERIES[0], linewidth=1.1)
        for n, k in enumerate(marks):
            points = _upper(locus.branches[k])
            nominal = abs(locus.gains[k] - 1.0) < 1e-9
            drawn = axes.plot(
                points.real,
                points.imag,
                linestyle="none",
                marker=MARKERS[n % 8],
                markersize=6.5 if nominal else 4.0,
                color=SERIES[1] if nominal else SERIES[0],
                markerfacecolor="none",
            )
            handles += drawn if axes is wide else []
    _s_plane(wide, -1.1 * nyquist, 0.12 * nyquist, 1.02 * nyquist, limits, False)
    extent = 1.7 * nutation
    _s_plane(close, -1.2 * extent, 0.18 * extent, extent, limits, True)
    _label_gains(close, locus, marks, extent)
    legend_above(figure, handles, [f"{locus.gains[k]:g} × gain" for k in marks])
    wide.set_title("all branches up to the Nyquist frequency")
    close.set_title("around the nutation frequency and below")
    return figure


def _label_gains(axes: Axes, locus: RootLocus, marks: list[int], extent: float) -> None:
    """Write the gains along the two branches that matter: the least damped one and the slowest oscillating one."""
    at_one = locus.branches[int(np.argmin(np.abs(locus.gains - 1.0)))]
    inside = (at_one.imag > 0.02 * extent) & (at_one.imag < extent) & (at_one.real > -1.2 * extent)
    if not inside.any():
        return
    ratio = np.where(inside, -at_one.real / np.abs(at_one), np.inf)
    branch = locus.branches[:, int(np.argmin(ratio))]
    last: complex | None = None
    for k in marks:
        s = branch[k]
        visible = 0.0 <= s.imag < extent and -1.2 * extent < s.real < 0.18 * extent
        if visible and (last is None or abs(s - last) > 0.045 * extent):
            axes.annotate(
                f"{locus.gains[k]:g}", (s.real, s.imag), (6, 3), textcoords="offset points", fontsize=7.5, color=INK
            )
            last = s


def _s_plane(axes: Axes, left: float, right: float, top: float, limits: LoopLimits, named: bool) -> None:
    """Axes of the upper half plane; fast poles to the right of a damping line are damped too little."""
    axes.axvline(0.0, color=REFERENCE, linewidth=0.8)
    axes.axvspan(0.0, right, color=BAND, linewidth=0, zorder=0)
    for ratio, dashes, height in (
        (limits.damping, (0, (5, 2)), 0.96),
        (limits.damping_spread, (0, (1.2, 1.4)), 0.88),
    ):
        if ratio is not None and 0.0 < ratio < 1.0:
            slope = ratio / np.sqrt(1.0 - ratio**2)
            axes.plot([0.0, -slope * top], [0.0, top], color=LIMIT, linestyle=dashes, linewidth=0.9)
            if named:
                axes.annotate(
                    f"{ratio:g}",
                    (-slope * height * top, height * top),
                    (-3, 0),
                    textcoords="offset points",
                    ha="right",
                    va="center",
                    color=LIMIT,
                    fontsize=7,
                )
    axes.set_xlim(left, right)
    axes.set_ylim(0.0, top)
    linear_axis(axes.xaxis, 6)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part, 1/s")
    axes.set_ylabel("imaginary part, rad/s")


def _open_and_closed(axes: Axes, f: FloatArray, opened: FloatArray, closed: list[FloatArray]) -> list[Any]:
    handles = axes.plot(f, opened, color=REFERENCE, linewidth=1.1)
    for k, curve in enumerate(closed):
        handles += axes.plot(f, curve, **line_style(k))
    frequency_axes(axes, f[0], f[-1])
    top = 10.0 * max((float(np.nanmax(curve)) for curve in closed), default=float(np.nanmax(opened)))
    gain_limits(axes, [*closed, opened], low=1e-5 * top, high=top)
    return handles


def _ceiling(axes: Axes, level: float, text: str) -> None:
    axes.axhline(level, color=LIMIT, linewidth=0.9, linestyle=(0, (5, 2)))
    axes.annotate(
        text, (axes.get_xlim()[0], level), (3, 2), textcoords="offset points", color=LIMIT, fontsize=7, va="bottom"
    )


def _design_legend(figure: Figure, handles: list[Any], responses: LoopResponses) -> None:
    legend_above(figure, handles, [one.design.name for one in responses.designs])


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


def _upper(s: ComplexArray) -> ComplexArray:
    """Poles of the closed upper half plane that are finite."""
    return np.asarray(s[np.isfinite(s.real) & (s.imag >= -1e-9 * np.maximum(np.abs(s), 1.0))])
