"""Step responses of several systems over one another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from platform_ctrl.analysis.arrays import named_system, scaled
from platform_ctrl.analysis.response import LinearSystem
from platform_ctrl.analysis.singular_values import boundary_poles
from platform_ctrl.analysis.time_responses import time_response
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import power_of_ten
from platform_ctrl.report.plots.panels import control_plot
from platform_ctrl.report.plots.systems import DrawnSystem, drawable, drawn_systems, ratio_unit, unit
from platform_ctrl.report.style import (
    REFERENCE,
    envelope,
    line_style,
    linear_axis,
    panels,
    standalone,
)

if TYPE_CHECKING:
    import control

# Time constants of a decay or growth, and periods of an undamped motion, that are worth seeing.
_DECAYS, _GROWTHS, _PERIODS = 6.0, 3.0, 6.0
# Slower motion than this share of the fastest is left out of the default duration.
_SLOW = 1e-4
_LEAST, _MOST = 600, 20000
# Largest number of samples of a sampled system.
_SAMPLES = 200_000
# A growing response is drawn up to this: beyond it axes cannot be labelled.
_GROWN = 1e100
_PANELS = 16


@standalone
def step_response(
    systems: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    *,
    labels: Sequence[str] | None = None,
    duration: float | None = None,
) -> control.ControlPlot:
    """Outputs of one or several systems after a step of 1 at each input, exact at the drawn times.

    Sampled systems are drawn as stairs. A grey line marks the final value of a response that settles.

    Parameters
    ----------
    systems
        `control.StateSpace` or `TransferFunction` with the same numbers of inputs and outputs; several in a list or
        under their labels in a mapping. A row of panels for each output, a column for each input.
    labels
        What the legend calls them.
    duration
        Of the response, s; default what the slowest motion of them needs.

    Returns
    -------
    control.ControlPlot
        ``axes`` (outputs, inputs); ``lines`` one for each system.

    Raises
    ------
    ArgumentError
        Systems of different shapes or too many signals, something that is no system, or a duration that is not above 0.
    """
    drawn = drawn_systems("step_response", systems, labels, data=False)
    if any(system.arrays is None for system in drawn):
        raise ArgumentError("step_response: an improper transfer function has more zeros than poles; add poles")
    shapes = {system.shape for system in drawn}
    if len(shapes) > 1:
        raise ArgumentError(f"step_response: the systems must have the same shape, got {sorted(shapes)}")
    [(p, m)] = shapes
    if p * m > _PANELS:
        raise ArgumentError(
            f"step_response: at most {_PANELS} panels can be drawn, got {p} outputs and {m} inputs; "
            "choose signals, for example system[['alpha9'], ['Q9', 'Q10']]"
        )
    end = _duration(drawn) if duration is None else positive("step_response: duration", duration)
    longest = min((_SAMPLES * system.dt for system in drawn if system.dt), default=end)
    if end > longest:
        raise ArgumentError(f"step_response: duration must be at most {longest:g} s, {_SAMPLES} samples, got {end:g} s")
    names = [system.label or "step response" for system in drawn]
    names = names if len(drawn) > 1 or drawn[0].label else []
    _, grid = panels(p, m, {1: 2.6, 2: 2.15}.get(p, 1.65), names)
    lines: dict[tuple[int, int], list[Any]] = {at: [] for at in np.ndindex(p, m)}
    for k, system in enumerate(drawn):
        t = _times(system, end)
        assert system.arrays is not None
        made = named_system(system.arrays, system.inputs, system.outputs)
        for j in range(m):
            step = np.zeros((m, len(t)))
            step[j] = 1.0
            with np.errstate(all="ignore"):
                y = time_response(made, t, step, hold="zoh", squeeze=False)
                y = np.where(np.abs(y) < _GROWN, y, np.nan)
            final = _final(system)
            for i in range(p):
                shown, at = (t, y[i]) if system.dt else envelope(t, y[i], 2000)
                kind: dict[str, Any] = {"drawstyle": "steps-post"} if system.dt else {}
                lines[i, j] += grid[i, j].plot(shown, at, **line_style(k), **kind)
                if final is not None:
                    grid[i, j].axhline(final[i, j], color=REFERENCE, linewidth=0.7, zorder=1)
    for k, panel in enumerate(grid.flat):
        i, j = divmod(k, m)
        _labelled(panel, drawn[0], i, j, end, bottom=i == p - 1)
    return control_plot(grid, list(lines.values()), lines[0, 0][: len(names)], names)


def _duration(systems: Sequence[DrawnSystem]) -> float:
    stable, growing = [], []
    for system in systems:
        assert system.arrays is not None
        A, B, C, _, dt = system.arrays
        s, on = boundary_poles(scaled(A, B, C)[0], dt) if len(A) else (np.zeros(0), np.zeros(0, dtype=np.bool_))
        good = np.isfinite(s)
        s, on = s[good], on[good]
        size = np.abs(s)
        fastest = size.max(initial=0.0)
        for pole, marginal in zip(s, on, strict=True):
            if abs(pole) <= 1e-9 * fastest:
                continue
            if marginal or (pole.real < 0.0 and -pole.real < _SLOW * abs(pole)):
                stable.append(_PERIODS * 2.0 * np.pi / abs(pole))
            elif pole.real > 0.0:
                growing.append(_GROWTHS / pole.real)
            elif -pole.real > _SLOW * fastest:
                stable.append(_DECAYS / -pole.real)
        if dt:
            stable.append(20.0 * dt)
    end = float(min(growing)) if growing else float(max(stable, default=1.0))
    return min([end, *(_SAMPLES * system.dt for system in systems if system.dt)])


def _times(system: DrawnSystem, end: float) -> FloatArray:
    if system.dt:
        return np.asarray(system.dt * np.arange(max(int(np.ceil(end / system.dt - 1e-9)), 1) + 1))
    turning = system.poles[np.abs(system.poles.real) < 5.0 * np.abs(system.poles.imag)]
    fastest = float(np.abs(turning).max(initial=0.0))
    points = int(np.clip(24.0 * fastest * end / (2.0 * np.pi), _LEAST, _MOST))
    return np.linspace(0.0, end, points + 1)


def _final(system: DrawnSystem) -> FloatArray | None:
    """Return where the outputs settle, (p, m); None where they do not."""
    assert system.arrays is not None
    A, B, C, D, dt = system.arrays
    if not len(A) or system.undamped.size or np.any(system.poles.real > -1e-9 * np.abs(system.poles)):
        return None
    size = np.abs(system.poles)
    if np.any(size <= 1e-9 * max(size.max(initial=0.0), 1.0 / dt if dt else 0.0)):  # integrators, but for rounding
        return None
    A, B, C = scaled(A, B, C)
    return np.asarray(D + C @ np.linalg.solve((np.eye(len(A)) if dt else 0.0) - A, B))


def _labelled(axes: Axes, system: DrawnSystem, i: int, j: int, end: float, *, bottom: bool) -> None:
    axes.set_xlim(0.0, end)
    linear_axis(axes.xaxis, 6)
    linear_axis(axes.yaxis, 5)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6, zorder=1)
    output, source = system.outputs[i], system.inputs[j]
    axes.set_title(f"{drawable(greek(source))} → {drawable(greek(output))}")
    per = ratio_unit(unit(output), unit(source))
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=np.float64) for line in axes.lines])
    values = values[np.isfinite(values)]
    largest = float(np.abs(values).max(initial=0.0))
    exponent = 3 * int(np.floor(np.log10(largest) / 3.0)) if largest > 0.0 else 0
    if exponent < 0 or exponent > 3:
        axes.yaxis.set_major_formatter(lambda x, _: f"{x / 10.0**exponent:g}".replace("-", "−"))
        scale = power_of_ten(10.0**exponent)
        axes.set_ylabel(f"{scale} {per}".strip() if per != "1" else scale)
    else:
        axes.set_ylabel(per if per != "1" else "")
    if bottom:
        axes.set_xlabel("time, s")
