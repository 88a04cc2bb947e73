"""What is asked, drawn into the figures: limits in red, goals in grey, each with its number."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from platform_ctrl.analysis.measuring import Peak
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.report.style import BEYOND, DASH_DOTTED, DASHED, DOTTED, LIMIT, MUTED

_LABEL: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7}


def limit_lines(axes: Axes, spec: LoopSpec, kind: str, *, scale: float = 1.0, from_hz: float = 0.0) -> None:
    """Draw limit and goal of a metric as levels of a gain; above the limit of a band the forbidden region is shaded.

    Parameters
    ----------
    axes
        With its limits set.
    spec
        Limits and goals.
    kind
        Key of `METRICS`: it says whether the level ends, or begins, at a frequency, and whether it is an inverse.
    scale
        The metric's unit in units of the axes.
    from_hz
        Where a level begins that holds from a frequency on.
    """
    metric = METRICS[kind]
    left, right = axes.get_xlim()
    inverse = isinstance(metric.measure, Peak) and metric.measure.reciprocal
    for limits, hard in ((spec.limits, True), (spec.soft, False)):
        if metric.key not in limits:
            continue
        limit = scale * limits[metric.key]
        if metric.band:
            start, end = max(from_hz, left), min(limits.get(metric.frequency_key, right), right)
            _step(axes, limit, start, end, hard)
            continue
        level = 1.0 / limit if inverse else limit
        colour, dashes = (LIMIT, DASHED) if hard else (MUTED, DASH_DOTTED)
        axes.axhline(level, color=colour, linewidth=0.9, linestyle=dashes)
        text = f"1/{limit:g}" if inverse else f"{limit:g}"
        # The limit's number stands above its left end, the goal's below its right one.
        label: dict[str, Any] = {"va": "bottom"} if hard else {"ha": "right", "va": "top"}
        at, shift = ((left, level), (3, 2)) if hard else ((right, level), (-3, -2))
        axes.annotate(text if hard else f"goal {text}", at, shift, color=colour, **label, **_LABEL)


def _step(axes: Axes, level: float, start: float, end: float, hard: bool) -> None:
    colour, dashes = (LIMIT, DASHED) if hard else (MUTED, DASH_DOTTED)
    top = axes.get_ylim()[1]
    if hard and (start, end) != axes.get_xlim() and level < top:
        axes.fill_between([start, end], level, top, color=BEYOND, linewidth=0, zorder=0.5)
    axes.plot([start, end], [level, level], color=colour, linewidth=0.9, linestyle=dashes)
    text = f"{level:g}" if hard else f"goal {level:g}"
    axes.annotate(text, (start, level), (3, 2 if hard else -2), color=colour, va="bottom" if hard else "top", **_LABEL)


def goal_frequency(axes: Axes, goal_hz: float | None) -> None:
    """Draw the frequency that a curve had better reach."""
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


def damping_lines(axes: Axes, spec: LoopSpec, top: float, named: bool) -> None:
    """Draw the damping that is asked of fast poles as rays of the s-plane, up to the imaginary part `top`."""
    limits = spec.limits
    rays = (
        (limits.get("damping"), DASHED, LIMIT, 0.96),
        (limits.get("damping_worst_case"), DOTTED, LIMIT, 0.88),
        (limits.get("damping_faults"), DASH_DOTTED, LIMIT, 0.80),
        (spec.soft.get("damping"), DASH_DOTTED, MUTED, 0.72),
    )
    for ratio, dashes, colour, height in rays:
        if ratio is None or not 0.0 < ratio < 1.0:
            continue
        slope = ratio / np.sqrt(1.0 - ratio**2)
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
