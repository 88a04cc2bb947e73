"""The Nichols plot of a loop with its worst plant, beside the nominal one: the report's first figure."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.feedback import gang
from platform_ctrl.analysis.frequency_grids import following_grid
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign, closed_loop_poles, sampled_plant
from platform_ctrl.report.plots.curves import loop_phase
from platform_ctrl.report.plots.nichols import exclusion
from platform_ctrl.report.style import BAND, LIMIT, MUTED, REFERENCE, legend, line_style, panels

_WIDTH, _HEIGHT = 5.2, 3.5
# What is shown, dB and degrees.
_LOW, _HIGH, _LEFT, _RIGHT = -24.0, 24.0, -300.0, -60.0


def worst_plant(design: LoopDesign) -> int:
    """Return the plant of the set with the smallest disk margin, or that is furthest from stable."""
    assert design.measures is not None
    decay, margin = design.measures.decay, design.measures.disk_margin
    return int(np.argmin(decay)) if not np.all(decay > 0.0) else int(np.argmin(margin))


def worst_plant_figure(outcome: LoopOutcome, k: int) -> Figure:
    """Return the loop at each torquer, all others closed, with plant `k`, and with the nominal one in grey."""
    design = outcome.closed
    plants = design.plants
    assert plants is not None
    others = " (others closed)" if len(plants.torques) > 1 else ""
    names = [f"at {name}{others}" for name in plants.torques]
    required = _required(outcome, k)
    words = [*names, *(["nominal plant"] if k else []), *([f"disk margin {required:g}"] if required else [])]
    figure, [[axes]] = panels(1, 1, _HEIGHT, words, titles=False, width=_WIDTH)
    handles = [axes.plot(*curve, **line_style(i))[0] for i, curve in enumerate(_curves(design, k))]
    if k:
        drawn = [axes.plot(*curve, color=REFERENCE, linewidth=0.9, zorder=1.5)[0] for curve in _curves(design, 0)]
        handles.append(drawn[0])
    if required:
        L = exclusion(required, 0.0)
        phase, level = np.degrees(np.angle(-L)), 20.0 * np.log10(np.abs(L))
        handles.append(axes.fill(-180.0 + phase, level, facecolor=BAND, edgecolor=MUTED, linewidth=0.9, zorder=0.6)[0])
    axes.plot([-180.0], [0.0], "+", color=LIMIT, markersize=10, markeredgewidth=1.6, zorder=4)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.9, zorder=1)
    axes.axvline(-180.0, color=REFERENCE, linewidth=0.9, zorder=1)
    axes.set_xlim(_LEFT, _RIGHT)
    axes.set_ylim(_LOW, _HIGH)
    axes.xaxis.set_major_locator(MultipleLocator(60.0))
    axes.yaxis.set_major_locator(MultipleLocator(12.0))
    axes.set_xlabel("phase of L, degrees")
    axes.set_ylabel("gain of L, dB")
    legend(figure, handles, words)
    return figure


def _required(outcome: LoopOutcome, k: int) -> float:
    """Return the disk margin that is required with plant `k`; 0 where none is, or none can be."""
    assert outcome.closed.plants is not None
    key, group = METRICS["disk margin"].key, outcome.closed.plants.groups[k]
    faulty = f"{key}_faults" if group == "faults" else f"{key}_worst_case"
    limit = outcome.spec.limits.get(faulty, outcome.spec.limits.get(key, 0.0) if k == 0 else 0.0)
    return limit if limit < 2.0 else 0.0


def _curves(design: LoopDesign, k: int) -> list[tuple[FloatArray, FloatArray]]:
    """Return phase in degrees, within a turn of the critical point, and gain in dB of every channel with plant `k`."""
    assert design.plants is not None
    plants = design.plants.only([k])
    poles = continuous_poles(closed_loop_poles(plants, design.own_controller)[0], plants.period)
    nyquist = np.pi / plants.period
    low = max(min(2e-3 * plants.nutation, 0.05 * nyquist), 1e-4 * nyquist)
    frequency = following_grid(poles, low, 0.999 * nyquist)
    S = np.moveaxis(gang(sampled_plant(plants), design.own_controller, frequency).S_input, -1, 0)
    with np.errstate(all="ignore"):
        found: ComplexArray = 1.0 / np.diagonal(S, axis1=-2, axis2=-1).T - 1.0
        level = 20.0 * np.log10(np.abs(found))
    return [(loop_phase(frequency, one), gain) for one, gain in zip(found, level, strict=True)]
