"""Limits and goals in the plots of a loop: limits in red, goals in grey, each with its number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from platform_ctrl.analysis.measuring import Peak
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.job.requirements import SCOPE_WORDS
from platform_ctrl.report.loop_responses import peak_metrics
from platform_ctrl.report.style import BEYOND, DASH_DOTTED, DASHED, DOTTED, LIMIT, MUTED

_LABEL: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7}
# Dashes of a limit by the plants that it is about.
_OF_SCOPE: dict[str, tuple[Any, str]] = {
    "": (DASHED, "dashed"),
    "worst_case": (DOTTED, "dotted"),
    "faults": (DASH_DOTTED, "dash-dotted"),
}


def same_curve(kind: str) -> list[str]:
    """Return the metrics that are read off the curve of the metric `kind`: their limits belong beside it."""
    metrics = peak_metrics()
    if kind not in metrics:
        return [kind]
    return [name for name, peak in metrics.items() if set(peak.transfers) <= set(metrics[kind].transfers)]


def limited(limits: Mapping[str, float], kind: str) -> list[str]:
    """Return the metrics on the curve of `kind` that have a limit (or a goal) for the nominal plant."""
    return [name for name in same_curve(kind) if METRICS[name].key in limits]


def limit_lines(axes: Axes, spec: LoopSpec, kind: str, *, scale: float = 1.0, from_hz: float = 0.0) -> None:
    """Draw limits and goals as levels of a gain; above the limit of a band the forbidden region is shaded.

    Parameters
    ----------
    axes
        With its limits set.
    spec
        Limits and goals.
    kind
        Key of the metric whose curve the axes show: all metrics on that curve get their lines.
    scale
        The SI unit in units of the axes.
    from_hz
        Where a level begins that holds from a frequency on.
    """
    left, right = axes.get_xlim()
    for limits, hard in ((spec.limits, True), (spec.soft, False)):
        for metric in (METRICS[name] for name in limited(limits, kind)):
            limit = scale * metric.scale * limits[metric.key]
            if metric.band:
                end = min(limits.get(metric.frequency_key, right), right)
                _band_limit(axes, limit, max(from_hz, left), end, hard)
                continue
            inverse = isinstance(metric.measure, Peak) and metric.measure.reciprocal
            level = 1.0 / limit if inverse else limit
            colour, dashes = (LIMIT, DASHED) if hard else (MUTED, DASH_DOTTED)
            axes.axhline(level, color=colour, linewidth=0.9, linestyle=dashes)
            text = f"1/{limit:g}" if inverse else f"{limit:g}"
            # The limit's number is above its left end, the goal's below its right one.
            label: dict[str, Any] = {"va": "bottom"} if hard else {"ha": "right", "va": "top"}
            at, shift = ((left, level), (3, 2)) if hard else ((right, level), (-3, -2))
            axes.annotate(text if hard else f"goal {text}", at, shift, color=colour, **label, **_LABEL)


def _band_limit(axes: Axes, level: float, start: float, end: float, hard: bool) -> None:
    colour, dashes = (LIMIT, DASHED) if hard else (MUTED, DASH_DOTTED)
    top = axes.get_ylim()[1]
    if hard and (start, end) != axes.get_xlim() and level < top:
        axes.fill_between([start, end], level, top, color=BEYOND, linewidth=0, zorder=0.5)
    axes.plot([start, end], [level, level], color=colour, linewidth=0.9, linestyle=dashes)
    text = f"{level:g}" if hard else f"goal {level:g}"
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
