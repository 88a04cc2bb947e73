"""The plots of one loop: all designs over one another, and the poles and root locus of the one that is closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.measuring import Peak
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.transfers import FOLLOWING, S_OUTPUT
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import LoopDesign, sampled_plant
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.job.quantities import HZ
from platform_ctrl.job.requirements import SCOPE_WORDS, of_readings
from platform_ctrl.report.figures.nichols import LoopCurve, closest, nichols_plot
from platform_ctrl.report.figures.panels import loop_phase, phase_panel
from platform_ctrl.report.figures.pole_map import upper_half_plane
from platform_ctrl.report.figures.root_locus import root_locus
from platform_ctrl.report.loop_responses import DesignResponses, LoopResponses, peak_metrics
from platform_ctrl.report.style import (
    BAND,
    BEYOND,
    DASH_DOTTED,
    DASHED,
    DOTTED,
    LIMIT,
    MARKERS,
    MUTED,
    REFERENCE,
    SERIES,
    design_style,
    frequency_axes,
    gain_limits,
    legend,
    linear_axis,
    panels,
)

_LABEL: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7}
# Dashes of a limit by the plants that it is about.
_OF_SCOPE: dict[str, tuple[Any, str]] = {
    "": (DASHED, "dashed"),
    "worst_case": (DOTTED, "dotted"),
    "faults": (DASH_DOTTED, "dash-dotted"),
}


def same_curve(kind: str, spec: LoopSpec) -> list[str]:
    """Return the metrics that are read off the curve of the metric `kind`: their limits belong beside it.

    Without a filter of the commands their errors are S.
    """
    metrics = peak_metrics()
    if kind not in metrics:
        return [kind]
    shown = set(metrics[kind].transfers)
    if S_OUTPUT in shown and not any(design.command for design in spec.designs):
        shown.add(FOLLOWING)
    return [name for name, peak in metrics.items() if set(peak.transfers) <= shown]


def limited(limits: Mapping[str, float], kind: str, spec: LoopSpec) -> list[str]:
    """Return the metrics on the curve of `kind` that have a limit (or a goal) for the nominal plant."""
    return [name for name in same_curve(kind, spec) if METRICS[name].key in limits]


def limit_lines(axes: Axes, spec: LoopSpec, kind: str, *, scale: float = 1.0, from_hz: float = 0.0) -> None:
    """Draw limits and goals as levels of a gain; above the limit of a band the forbidden region is shaded.

    The axes have their limits set and show the curve of the metric `kind`: all metrics on that curve get their lines.
    `scale` is the SI unit in units of the axes; `from_hz` is where a level begins that holds from a frequency on.
    """
    left, right = axes.get_xlim()
    for limits, hard in ((spec.limits, True), (spec.soft, False)):
        for metric in (METRICS[name] for name in limited(limits, kind, spec)):
            limit = scale * metric.in_SI(limits[metric.key])
            inverse = isinstance(metric.measure, Peak) and metric.measure.reciprocal
            if metric.band:
                end = min(limits.get(metric.frequency_key, right), right)
                level, text = (1.0 / limit if inverse else limit), f"{limit:g}"
                text = f"{limits[metric.key]:g} dB" if metric.decibels else text
                start = max(from_hz, limits.get(metric.lowest_key, left), left)
                _band_limit(axes, level, start, end, hard, text)
                continue
            level = 1.0 / limit if inverse else limit
            colour, dashes = (LIMIT, DASHED) if hard else (MUTED, DASH_DOTTED)
            axes.axhline(level, color=colour, linewidth=0.9, linestyle=dashes)
            text = f"1/{limit:g}" if inverse else f"{limit:g}"
            # The limit's number is above its left end, the goal's below its right one.
            label: dict[str, Any] = {"va": "bottom"} if hard else {"ha": "right", "va": "top"}
            at, shift = ((left, level), (3, 2)) if hard else ((right, level), (-3, -2))
            axes.annotate(text if hard else f"goal {text}", at, shift, color=colour, **label, **_LABEL)


def _band_limit(axes: Axes, level: float, start: float, end: float, hard: bool, text: str) -> None:
    colour, dashes = (LIMIT, DASHED) if hard else (MUTED, DASH_DOTTED)
    top = axes.get_ylim()[1]
    if hard and (start, end) != axes.get_xlim() and level < top:
        axes.fill_between([start, end], level, top, color=BEYOND, linewidth=0, zorder=0.5)
    axes.plot([start, end], [level, level], color=colour, linewidth=0.9, linestyle=dashes)
    text = text if hard else f"goal {text}"
    axes.annotate(text, (start, level), (3, 2 if hard else -2), color=colour, va="bottom" if hard else "top", **_LABEL)


def goal_frequency(axes: Axes, goal_hz: float | None) -> None:
    """Draw the frequency that a curve should reach."""
    if goal_hz is not None:
        axes.axvline(goal_hz, color=MUTED, linewidth=0.9, linestyle=DASH_DOTTED)
        axes.annotate(
            f"goal {goal_hz:g} Hz",
            (goal_hz, axes.get_ylim()[0]),
            (3, 3),
            color=MUTED,
            va="bottom",
            **_LABEL,
        )


def damping_rays(limits: Mapping[str, float]) -> list[tuple[float, Any, str]]:
    """Return the limits on damping: ratio, dashes of its ray in the s-plane, and in words its dashes and plants."""
    metric, rays = METRICS["damping"], []
    for scope in metric.scopes:
        ratio = limits.get(f"{metric.key}_{scope}" if scope else metric.key)
        if ratio is not None:
            dashes, words = _OF_SCOPE[scope]
            rays.append((ratio, dashes, f"{words}, {ratio:g}{SCOPE_WORDS[scope] or ' for the nominal plant'}"))
    return rays


def damping_lines(axes: Axes, spec: LoopSpec, top: float, named: bool) -> None:
    """Draw the required damping of fast poles as rays of the s-plane, up to the imaginary part `top`."""
    rays = [(ratio, dashes, LIMIT) for ratio, dashes, _ in damping_rays(spec.limits)]
    rays += [(ratio, DASH_DOTTED, MUTED) for ratio, _, _ in damping_rays(spec.soft)]
    for k, (ratio, dashes, colour) in enumerate(rays):
        if not 0.0 < ratio < 1.0:
            continue
        slope, height = ratio / np.sqrt(1.0 - ratio**2), 0.96 - 0.08 * k
        axes.plot([0.0, -slope * top], [0.0, top], color=colour, linestyle=dashes, linewidth=0.9)
        if named:
            text = f"{ratio:g}" if colour == LIMIT else f"goal {ratio:g}"
            at = (-slope * height * top, height * top)
            axes.annotate(text, at, (-3, 0), color=colour, ha="right", va="center", **_LABEL)


def fastest_pole_line(axes: Axes, spec: LoopSpec, period: float) -> None:
    """Draw the circle of the w-plane that closed-loop poles have to stay within, carried to s = ln(z)/T."""
    for limits, colour, dashes in ((spec.limits, LIMIT, DASHED), (spec.soft, MUTED, DASH_DOTTED)):
        if "fastest_pole" in limits:
            real, imag = pole_circle(limits["fastest_pole"], period)
            axes.plot(real, imag, color=colour, linestyle=dashes, linewidth=0.9)


def pole_circle(radius: float, period: float) -> tuple[FloatArray, FloatArray]:
    """Return real and imaginary parts, 1/s and rad/s, of the left upper quarter of |w| = `radius` in the s-plane."""
    angle = np.linspace(0.5 * np.pi, np.pi, 400)[:-1]
    w = 0.5 * period * radius * np.exp(1j * angle)
    s = np.log((1.0 + w) / (1.0 - w)) / period
    return np.asarray(s.real), np.asarray(s.imag)


# With more designs than this only the closed one shows all its singular values.
_ALL_LINES = 2
# More panels than this are drawn in two rows.
_ONE_ROW = 4
# Sensitivity plot, from left to right: the metric whose curve a panel shows, and its title.
SENSITIVITIES = {
    "sensitivity peak": "S: remaining share of a disturbance",
    "complementary sensitivity peak": "T: transmitted share",
    "disk margin": "(S − T)/2: 1/disk margin at its peak",
}
# A gain of this and less is none.
_NOTHING = 1e-12
# Range of the root locus, factors on the loop gain.
_GAINS = (0.0, 2.0)
# Metrics whose curves the other standard plots of a loop show.
_STANDARD = (*SENSITIVITIES, "Omega rejection", "torque rejection", "torque limit")


def sensitivity_figure(responses: LoopResponses, spec: LoopSpec) -> Figure:
    """Singular values of S, T and (S − T)/2 over frequency, with the limits on bandwidth, peaks and disk margin."""
    names = design_names(responses)
    figure, [row] = panels(1, 3, 2.1, names)
    f, left = responses.frequency * HZ, row[0]
    handles: list[Any] = []
    for axes, (kind, title) in zip(row, SENSITIVITIES.items(), strict=True):
        curves = [one.gains[kind] for one in responses.designs]
        drawn = _design_curves(axes, f, curves, responses)
        handles = handles or drawn
        gain_limits(axes, curves, low=1e-3, high=1e2)
        axes.set_title(title)
    for one in responses.designs:
        if one.design.name == responses.closed or len(responses.designs) <= _ALL_LINES:
            left.plot(f, one.smallest_sensitivity, **_look(responses, one) | {"linewidth": 0.7})
        if one.design.measures is not None and np.isfinite(one.design.measures.bandwidth):
            at = one.design.measures.bandwidth * HZ
            left.plot(
                [at],
                [np.sqrt(0.5)],
                MARKERS[_place(responses, one)],
                color=_look(responses, one)["color"],
                markersize=5,
                zorder=4,
            )
    left.axhline(np.sqrt(0.5), color=REFERENCE, linewidth=0.8)
    at_end: dict[str, Any] = {"textcoords": "offset points", "color": MUTED, "fontsize": 7, "ha": "right", "va": "top"}
    left.annotate("1/√2", (f[-1], np.sqrt(0.5)), (-3, -2), **at_end)
    bandwidth = METRICS["bandwidth"].key
    if bandwidth in spec.limits:
        left.axvspan(f[0], spec.limits[bandwidth], color=BAND, linewidth=0, zorder=0)
    goal_frequency(left, spec.soft.get(bandwidth))
    for axes, kind in zip(row, SENSITIVITIES, strict=True):
        limit_lines(axes, spec, kind)
    left.set_ylabel("singular values, 1")
    legend(figure, handles, names)
    return figure


def loop_transfer_figure(responses: LoopResponses, spec: LoopSpec, torques: tuple[str, ...], nutation: float) -> Figure:
    """Singular values of the loop transfer and of the controller, and the Bode plot of each channel."""
    for one in responses.designs:
        if len(one.channels) != len(torques):
            raise ArgumentError(
                f"loop_transfer_figure: torques must be the names of the loop's {len(one.channels)} torques, "
                f"got {short(torques)}"
            )
    names = design_names(responses)
    figure, rows = panels(2, 1 + len(torques), 1.35, names)
    f, designs = responses.frequency * HZ, responses.designs
    handles = _design_curves(rows[0][0], f, [one.loop_gains[0] for one in designs], responses, label=False)
    for one in designs:
        chosen = one.design.name == responses.closed
        for gain in one.loop_gains[1:] if chosen or len(designs) <= _ALL_LINES else ():
            rows[0][0].plot(f, gain, **_look(responses, one) | {"linewidth": 0.8})
    _design_curves(rows[1][0], f, [one.controller_gain for one in designs], responses)
    for i, name in enumerate(torques):
        above, below = rows[0][1 + i], rows[1][1 + i]
        _design_curves(above, f, [np.abs(one.channels[i]) for one in designs], responses, label=False)
        phases = [loop_phase(one.channels[i]) for one in designs]
        _design_curves(below, f, phases, responses, log_gain=False)
        phase_panel(below, phases)
        gain_limits(above, [np.abs(one.channels[i]) for one in designs], low=1e-3, high=1e4)
        above.set_title(f"{name}, others closed")
    for axes in rows[0]:
        axes.axhline(1.0, color=REFERENCE, linewidth=0.8)
    gain_limits(rows[0][0], [one.loop_gains for one in designs], low=1e-3, high=1e4)
    gain_limits(rows[1][0], [one.controller_gain for one in designs])
    limit_lines(rows[1][0], spec, "controller gain", from_hz=nutation / 10.0 * HZ)
    rows[0][0].set_title("loop transfer")
    rows[0][0].set_ylabel("singular values, 1")
    rows[0][1].set_ylabel("gain, 1")
    rows[1][0].set_title("controller, largest gain")
    rows[1][0].set_ylabel(of_readings(METRICS["controller gain"].unit, spec.kind))
    rows[1][1].set_ylabel("phase, degrees")
    legend(figure, handles, names)
    return figure


def disturbance_figure(responses: LoopResponses, spec: LoopSpec) -> Figure:
    """Gains from platform rate and torque disturbance to what the loop reads, and from the rate to the torque."""
    what, unit = ("rates", "mrad/s") if spec.kind == "rate" else ("angles", "mrad")
    disturbed, per = ("command", "mrad/s") if spec.kind == "tracking" else ("torque", "mN m")
    designs, f = responses.designs, responses.frequency * HZ
    acting = [a for a in range(3) if np.nanmax(responses.open_angle_per_rate[a], initial=0.0) > 1e-12]
    shares = [one.gains["torque limit"] for one in designs if "torque limit" in one.gains]
    limited_torque = any(np.any(one > 0.0) for one in shares)  # not a number without a limit
    names = ["open loop", *design_names(responses)]
    figure, cells = _cells(len(acting) + 1 + limited_torque, names)
    for axes, a in zip(cells, acting, strict=False):
        handles = axes.plot(f, 1e3 * responses.open_angle_per_rate[a], color=REFERENCE, linewidth=1.1)
        closed = [1e3 * one.angle_per_rate[a] for one in designs]
        handles += _design_curves(axes, f, closed, responses)
        _disturbance_limits(axes, closed, 1e3 * responses.open_angle_per_rate[a])
        axes.set_title(f"rate Omega{a + 1} → {what}")
        limit_lines(axes, spec, "Omega rejection", scale=1e3)
    cells[0].set_ylabel(f"{unit} per rad/s" if acting else f"{unit} per {per}")
    axes = cells[len(acting)]
    handles = axes.plot(f, responses.open_angle_per_torque, color=REFERENCE, linewidth=1.1)
    closed = [one.gains["torque rejection"] for one in designs]
    handles += _design_curves(axes, f, closed, responses)
    _disturbance_limits(axes, closed, responses.open_angle_per_torque)
    axes.set_title(f"{disturbed} disturbance → {what}")
    axes.set_ylabel(f"{unit} per {per}")
    limit_lines(axes, spec, "torque rejection")
    if limited_torque:
        axes = cells[-1]
        _design_curves(axes, f, shares, responses)
        gain_limits(axes, shares, low=1e-3, high=1e2)
        axes.axhline(1.0, color=REFERENCE, linewidth=0.8)
        limit_lines(axes, spec, "torque limit")
        axes.set_title("full Omega → torque")
        axes.set_ylabel("torque over its limit, 1")
    legend(figure, handles, names)
    return figure


def further_gains(responses: LoopResponses, spec: LoopSpec) -> list[str]:
    """Return the metrics with a limit or a goal that are the peak of a gain that no standard plot shows."""
    shown = {name for kind in _STANDARD for name in same_curve(kind, spec)}
    kinds = [kind for kind in responses.closed_design.gains if kind not in shown]
    return [kind for kind in kinds if limited({**spec.soft, **spec.limits}, kind, spec)]


def further_gains_figure(responses: LoopResponses, spec: LoopSpec, kinds: Sequence[str]) -> Figure:
    """Gain over frequency of each of the metrics `kinds`, with its limit and goal."""
    names = design_names(responses)
    figure, cells = _cells(len(kinds), names)
    handles: list[Any] = []
    for axes, kind in zip(cells, kinds, strict=True):
        metric = METRICS[kind]
        # What transmits nothing is drawn below everything else.
        curves = [np.maximum(one.gains[kind] / metric.scale, _NOTHING) for one in responses.designs]
        handles = _design_curves(axes, responses.frequency * HZ, curves, responses)
        gain_limits(axes, curves)
        limit_lines(axes, spec, kind, scale=1.0 / metric.scale)
        if kind == "attenuation":
            axes.set_title("line of sight per base motion, with dry friction")
            axes.set_ylabel("rate per rate, 1")
            continue
        axes.set_title(of_readings(metric.name, spec.kind))
        axes.set_ylabel(of_readings(metric.unit, spec.kind) or "1")
    legend(figure, handles, names)
    return figure


def _cells(number: int, names: Sequence[str]) -> tuple[Figure, list[Axes]]:
    """Return a figure with `number` panels in one or two rows."""
    columns = number if number <= _ONE_ROW else -(-number // 2)
    rows = -(-number // columns)
    figure, grid = panels(rows, columns, 2.0, names)
    cells = list(grid.flat)
    for unused in cells[number:]:
        unused.remove()
    return figure, cells[:number]


def _design_curves(
    axes: Axes,
    f: FloatArray,
    curves: Sequence[FloatArray],
    responses: LoopResponses,
    *,
    log_gain: bool = True,
    label: bool = True,
) -> list[Any]:
    """Draw a curve of each design over frequency, the closed one thicker, and return the lines."""
    lines: list[Any] = []
    for curve, one in zip(curves, responses.designs, strict=True):
        lines += axes.plot(f, curve, **_look(responses, one))
    frequency_axes(axes, f[0], f[-1], log_gain=log_gain, label=label)
    return lines


def _disturbance_limits(axes: Axes, closed: Sequence[FloatArray], opened: FloatArray) -> None:
    top = 10.0 * max((float(np.nanmax(curve)) for curve in closed), default=float(np.nanmax(opened)))
    gain_limits(axes, [*closed, opened], low=1e-5 * top, high=top)


def _place(responses: LoopResponses, one: DesignResponses) -> int:
    """Return which colour and marker a design has on the whole page."""
    return list(responses.palette).index(one.design.name) % len(SERIES)


def _look(responses: LoopResponses, one: DesignResponses) -> dict[str, Any]:
    name = one.design.name
    return design_style(_place(responses, one), responses.palette[name], name == responses.closed)


def design_names(responses: LoopResponses) -> list[str]:
    """Return the names of the designs for the legend; of several, the closed one is marked."""
    names = [one.design.name for one in responses.designs]
    return names if len(names) == 1 else [f"{name}, closed" if name == responses.closed else name for name in names]


def nichols_figure(responses: LoopResponses, spec: LoopSpec, torques: tuple[str, ...]) -> Figure:
    """Nichols plot of the closed design: the loop that each torquer closes while all the others stay closed."""
    design, w = responses.closed_design, responses.frequency
    stable = None if design.design.measures is None else bool(design.design.measures.decay[0] > 0.0)
    curves = []
    for name, channel in zip(torques, design.channels, strict=True):
        margin, at = closest(w, channel)
        curves.append(LoopCurve(label=name, frequency=w, response=channel, stable=stable, margin=margin, closest=at))
    metric = METRICS["disk margin"]
    # Curves of the nominal plant: its own limit, if there is one.
    limit = next((spec.limits[key] for key in (metric.key, f"{metric.key}_worst_case") if key in spec.limits), None)
    possible = limit is not None and (metric.best is None or limit < metric.best)
    figure = nichols_plot(curves, [limit] if limit is not None and possible else []).figure
    assert isinstance(figure, Figure)
    return figure


def pole_figure(responses: LoopResponses, spec: LoopSpec, nutation: float, period: float) -> Figure:
    """Closed-loop poles of the nominal plant (strong), of uncertain plants (faint) and with faults (crosses)."""
    names = design_names(responses)
    figure, [row] = panels(1, 2, 2.7, names)
    handles: list[Any] = []
    for axes in row:
        drawn: list[Any] = []
        for one in responses.designs:
            varied, faults, own = (upper_half_plane(s) for s in (one.varied_poles, one.fault_poles, one.poles))
            k = _place(responses, one)
            style: dict[str, Any] = {"color": SERIES[k], "linestyle": "none", "marker": MARKERS[k]}
            axes.plot(varied.real, varied.imag, **style | {"markersize": 1.8, "alpha": 0.35, "markeredgewidth": 0})
            crossed = {"marker": "x", "markersize": 2.6, "alpha": 0.75, "markeredgewidth": 0.7}
            axes.plot(faults.real, faults.imag, **style | crossed)
            strong = {"markersize": 6, "markerfacecolor": "none", "markeredgewidth": 1.3}
            drawn += axes.plot(own.real, own.imag, **style | strong)
        handles = handles or drawn
    _two_views(row, spec, nutation, period)
    legend(figure, handles, names)
    return figure


def root_locus_plot(design: LoopDesign, spec: LoopSpec) -> Any:
    """Return a root locus over gains up to twice the design's, with the limits on poles; `locus` has the numbers."""
    assert design.plants is not None
    plot = root_locus(sampled_plant(design.plants), design.own_controller, gains=_GAINS)
    axes: Axes = plot.axes[0, 0]
    damping_lines(axes, spec, axes.get_ylim()[1], named=False)
    fastest_pole_line(axes, spec, design.plants.period)
    return plot


def _two_views(row: Sequence[Axes], spec: LoopSpec, nutation: float, period: float) -> None:
    """Show the upper half plane as a whole, and close to the origin; limits on poles are drawn in both."""
    nyquist, extent = np.pi / period, 1.7 * nutation
    views = ((-1.1 * nyquist, 0.12 * nyquist, 1.02 * nyquist), (-1.2 * extent, 0.18 * extent, extent))
    titles = ("all poles up to the Nyquist frequency", "closer to the origin")
    for k, (axes, (left, right, top), title) in enumerate(zip(row, views, titles, strict=True)):
        damping_lines(axes, spec, top, named=k == 1)
        fastest_pole_line(axes, spec, period)
        half_plane_axes(axes, left, right, 0.0, top)
        axes.set_ylabel("imaginary part, rad/s")
        axes.set_title(title)


def half_plane_axes(axes: Axes, left: float, right: float, bottom: float, top: float) -> None:
    """Set the limits of axes that show the upper half plane, with its unstable half shaded."""
    axes.axvline(0.0, color=REFERENCE, linewidth=0.8)
    axes.axvspan(0.0, right, color=BAND, linewidth=0, zorder=0)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    linear_axis(axes.xaxis, 6)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part, 1/s")
