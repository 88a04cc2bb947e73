"""The plots of the whole platform: natural frequencies; poles, margins and disturbances of the coupled system."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from platform_ctrl.analysis.feedback import gang
from platform_ctrl.analysis.frequency_grids import following_grid
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import sampled
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.text import at_least
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import HZ, plain, quantity
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space as linear_state_space
from platform_ctrl.plant.drawing import root_series, signal_series
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES
from platform_ctrl.report.captions import bandwidth_hz
from platform_ctrl.report.figures.campbell import campbell
from platform_ctrl.report.figures.loop import half_plane_axes
from platform_ctrl.report.figures.panels import loop_phase, phase_panel
from platform_ctrl.report.figures.pole_map import upper_half_plane
from platform_ctrl.report.modes import nutates
from platform_ctrl.report.style import (
    BAND,
    DOTTED,
    LIMIT,
    MUTED,
    REFERENCE,
    SERIES,
    frequency_axes,
    gain_limits,
    legend,
    line_style,
    linear_axis,
    panels,
)
from platform_ctrl.verification.coupled import CoupledCheck
from platform_ctrl.verification.verdict import JobResult

if TYPE_CHECKING:
    import control


# Range of the rotors' speed in the Campbell diagram, as a factor.
_SPINS = (0.0, 1.5)
# Labels on two lines that are closer than this share of the axis would overlap.
_APART = 0.05


def nutation_figure(result: JobResult) -> Figure | None:
    """Natural frequencies at rest over the rotors' speed (all alike); None for a plant without nutation.

    A Campbell diagram with the parameter uncertainty of the rotors' speed and the bandwidths of the loops.
    """
    if not nutates(result.model, result.model.gimbal_names):
        return None
    figure = campbell(result.job.platform, spins=_SPINS)
    axes = figure.axes[0]
    nominal = axes.get_xlim()[1] / _SPINS[1]
    uncertainty, (low, high) = result.job.uncertainty.spin, axes.get_ylim()
    if uncertainty > 0.0:
        axes.axvspan((1.0 - uncertainty) * nominal, (1.0 + uncertainty) * nominal, color=BAND, linewidth=0, zorder=0)
    loops = sorted(((bandwidth_hz(one.closed), one.spec.name) for one in result.loops), reverse=True)
    last = 2.0 * high
    for bandwidth, name in loops:
        if not low < bandwidth < high:
            continue
        axes.axhline(bandwidth, color=REFERENCE, linewidth=0.8, linestyle=DOTTED)
        if last - bandwidth > _APART * high:
            words = f"bandwidth of {name}, {quantity(bandwidth, 'Hz', 3)}"
            at = (axes.get_xlim()[1], bandwidth)
            axes.annotate(
                words, at, (-3, 2), textcoords="offset points", ha="right", va="bottom", fontsize=7, color=MUTED
            )
            last = bandwidth
    return figure


def _checked(result: JobResult) -> CoupledCheck:
    assert result.coupled is not None, "all loops have controllers"
    return result.coupled


def coupled_pole_figure(result: JobResult) -> Figure:
    """Poles of the coupled closed loop: all of them, and those around the nutation frequencies and below."""
    check = _checked(result)
    period = check.period
    figure, [[wide, close]] = panels(1, 2, 2.7)
    s = upper_half_plane(continuous_poles(check.poles, period))
    nyquist = np.pi / period
    nutations = [o.closed.plants.nutation for o in result.loops if o.closed.plants is not None]
    slow = 1.7 * max(nutations, default=float(np.median(np.abs(s))) if s.size else nyquist)
    for axes, left, right, top in (
        (wide, -1.1 * nyquist, 0.12 * nyquist, 1.02 * nyquist),
        (close, -1.2 * slow, 0.2 * slow, min(slow, nyquist)),
    ):
        half_plane_axes(axes, left, right, -0.02 * top, top)
        good, bad = s[s.real < 0.0], s[s.real >= 0.0]
        axes.plot(good.real, good.imag, "x", color=SERIES[0], markersize=5, clip_on=True)
        axes.plot(bad.real, bad.imag, "x", color=LIMIT, markersize=7, markeredgewidth=2)
    wide.set_ylabel("imaginary part, rad/s")
    wide.set_title("all poles up to the Nyquist frequency")
    close.set_title("closer to the origin")
    return figure


def margin_bars_figure(check: CoupledCheck) -> Figure:
    """Loop-by-loop disk margins, a bar for each torquer; of a free platform beside that in its design model."""
    # A carried platform is what the design models assume: there is nothing to compare.
    names = ["in its design model", "in the coupled system, with the change"] if check.free else []
    figure, [[axes]] = panels(1, 1, 1.95, names, titles=False)
    x = np.arange(len(check.channels), dtype=np.float64)
    decoupled = np.nan_to_num(check.decoupled, nan=0.0, posinf=0.0)
    coupled = np.nan_to_num(check.coupled, nan=0.0, posinf=0.0)
    side = 0.2 if check.free else 0.0
    handles = [axes.bar(x - side, decoupled, 0.36, color=SERIES[5], linewidth=0)] if check.free else []
    handles.append(axes.bar(x + side, coupled, 0.36, color=SERIES[0], linewidth=0))
    for k, cost in enumerate(check.cost):
        change = f"{-100.0 * cost:+.1f} %".replace("-0.0", "0.0").replace("-", "\u2212")
        text = "unstable" if not np.isfinite(cost) else change if check.free else plain(float(coupled[k]), 3, "down")
        colour = MUTED if np.isfinite(cost) else LIMIT
        top = max(decoupled[k], coupled[k])
        axes.annotate(text, (x[k], top), (0, 3), textcoords="offset points", ha="center", color=colour, fontsize=7)
    axes.set_xticks(x, check.channels)
    axes.tick_params(axis="x", length=0)
    axes.grid(False, axis="x")
    axes.set_xlim(-0.7, len(x) - 0.3)
    axes.set_ylim(0.0, 1.18 * max(0.1, float(decoupled.max(initial=0.0)), float(coupled.max(initial=0.0))))
    linear_axis(axes.yaxis)
    axes.set_ylabel("disk margin")
    axes.set_xlabel("torquer: its loop broken, all others closed")
    if names:
        legend(figure, handles, names)
    return figure


def simultaneous_margin_figure(check: CoupledCheck, limit: float | None) -> Figure:
    """Disk margin in all channels at once over frequency: guaranteed, and known to be exceeded."""
    labels = ["guaranteed", "some perturbation of this size destabilises"]
    labels += [] if limit is None else [f"limit {limit:g}"]
    figure, [[axes]] = panels(1, 1, 1.95, labels, titles=False)
    margin = check.simultaneous
    kept = margin.frequencies > 0.0
    f = margin.frequencies[kept] * HZ
    lower, upper = margin.lower_response[kept], margin.upper_response[kept]
    handles = axes.plot(f, lower, **line_style(0))
    handles += axes.plot(f, upper, **line_style(1))
    # Slower than a hundred-thousandth of the fastest nothing happens that the picture would show.
    frequency_axes(axes, max(f[0], 1e-5 * f[-1]), f[-1])
    floor = min(margin.lower, np.inf if limit is None else positive("limit", limit))
    axes.set_ylim(10.0 ** np.floor(np.log10(0.7 * floor)) if floor < 0.15 else 0.1, 10.0)
    if limit is not None:
        handles.append(axes.axhline(limit, color=LIMIT, linestyle=(0, (5, 2)), linewidth=0.9))
    axes.plot([margin.frequency * HZ], [margin.lower], "o", color=SERIES[0], markersize=5)
    crossed = limit is not None and 0.5 < limit / margin.lower < 1.0
    axes.annotate(
        f"{at_least(margin.lower, 3)} at {margin.frequency * HZ:.3g} Hz",
        (margin.frequency * HZ, margin.lower),
        (0, 6 if crossed else -11),
        textcoords="offset points",
        ha="center",
        fontsize=7.5,
    )
    axes.set_ylabel("disk margin")
    legend(figure, handles, labels)
    return figure


def coupled_grid(result: JobResult) -> FloatArray:
    """Return frequencies for the coupled system, rad/s, from below its slowest pole up to the Nyquist frequency."""
    check = _checked(result)
    period, s = check.period, continuous_poles(check.poles, check.period)
    finite = np.abs(s[np.isfinite(s.real) & (np.abs(s) > 0.0)])
    nyquist = np.pi / period
    low = float(np.clip(0.1 * finite.min(initial=nyquist), 1e-5 * nyquist, 1e-3 * nyquist))
    return following_grid(s, low, 0.999 * nyquist)


def servo_figure(result: JobResult) -> Figure | None:
    """Bode diagram of each root torquer's loop in the coupled system, others closed; None without such a torquer."""
    check = _checked(result)
    roots = {t.name for t in result.job.platform.torquers if t.root_axis is not None}
    channels = [k for k, name in enumerate(check.channels) if name in roots]
    if not channels or not check.stable or check.controller is None:
        return None
    w = coupled_grid(result)
    loops = gang(check.plant, check.controller, w).channels
    figure, [[gain, phase]] = panels(1, 2, 2.0, [check.channels[k] for k in channels])
    curves, phases, handles = [], [], []
    series = signal_series(result.job.platform)
    for k in channels:
        loop, style = loops[k], line_style(series[check.channels[k]])
        curves.append(np.abs(loop))
        handles += gain.plot(w * HZ, np.abs(loop), **style)
        phases.append(loop_phase(loop))
        phase.plot(w * HZ, phases[-1], **style)
    frequency_axes(gain, w[0] * HZ, w[-1] * HZ)
    gain_limits(gain, curves, low=1e-3, high=1e4)
    gain.axhline(1.0, color=REFERENCE, linewidth=0.8)
    gain.set_ylabel("gain, 1")
    gain.set_title("loop transfer at the torquer")
    frequency_axes(phase, w[0] * HZ, w[-1] * HZ, log_gain=False)
    phase_panel(phase, phases)
    phase.set_ylabel("phase, degrees")
    phase.set_title("its phase")
    legend(figure, handles, [check.channels[k] for k in channels])
    return figure


def platform_disturbance_figure(result: JobResult) -> Figure:
    """Platform angle and largest gimbal angle per torque on the platform, loops closed against no controller at all."""
    w = coupled_grid(result)
    opened, closed = platform_compliance(result, w)
    carried = len(result.model.angle_names) > 0
    labels = [*(f"torque about axis {axis}" for axis in (1, 2, 3)), "no controller"]
    figure, [[platform, *others]] = panels(1, 1 + carried, 2.0, labels)
    handles = []
    f = w * HZ
    for axis in range(3):
        style = line_style(root_series(axis + 1))
        platform.plot(f, opened[:, -3 + axis, axis], **style | {"color": REFERENCE, "linewidth": 0.9})
        handles += platform.plot(f, closed[:, -3 + axis, axis], **style)
    handles += platform.plot([], [], color=REFERENCE, linewidth=0.9)
    frequency_axes(platform, f[0], f[-1])
    axes_closed = closed[:, [-3, -2, -1], [0, 1, 2]]
    gain_limits(platform, [axes_closed], low=1e-7 * float(axes_closed.max()), high=30.0 * float(axes_closed.max()))
    platform.set_ylabel("mrad per mN m")
    platform.set_title("torque on the platform → its own angle")
    for gimbals in others:
        moved = np.linalg.norm(closed[:, :-3], axis=1)
        for axis in range(3):
            gimbals.plot(f, moved[:, axis], **line_style(root_series(axis + 1)))
        frequency_axes(gimbals, f[0], f[-1])
        gain_limits(gimbals, [moved], low=1e-6 * float(moved.max(initial=1e-12)))
        gimbals.set_ylabel("mrad per mN m")
        gimbals.set_title("torque on the platform → gimbal angles")
    legend(figure, handles, labels)
    return figure


def platform_compliance(result: JobResult, frequency: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return gimbal and platform angles per root torque without and with controllers, (N, n + 3, 3), rad/(N m).

    The disturbance acts in continuous time: its response is the continuous plant's, brought into the loop by the
    sampled loop's sensitivity, which holds below the Nyquist frequency where the samples see it.
    """
    job, model = result.job, result.model
    check = _checked(result)
    assert check.controller is not None, "loops at several rates have no frequency response"
    shown = [*model.angle_names, *OMEGA_NAMES]
    outputs = [*shown, *(name for name in check.controller.input_labels if name not in shown)]
    free = observed(linear_state_space(model, root="free"), model.platform, outputs, model.q0, model.Omega0)
    signals = [t.signal for t in job.platform.torquers]
    direct = _response(free[outputs, list(ROOT_TORQUE_NAMES)], frequency)
    # The platform's rates become angles.
    to_angle = np.ones((len(frequency), len(shown), 1), dtype=np.complex128)
    to_angle[:, -3:] = (1.0 / (1j * frequency))[:, None, None]
    driven = sampled(
        free[outputs, signals], job.sampling.period, job.sampling.delay, [t.lag for t in job.platform.torquers]
    )
    P = _response(driven, frequency)
    K = System.of(check.controller, "all loops")
    rows = [outputs.index(name) for name in check.controller.input_labels]
    columns = [[t.name for t in job.platform.torquers].index(name) for name in check.controller.output_labels]
    K_response = frequency_response(K, frequency, -3)
    loop = P[:, rows][:, :, columns] @ K_response
    seen = np.linalg.solve(np.eye(len(rows)) - loop, direct[:, rows])
    closed = direct + P[:, :, columns] @ K_response @ seen
    opened, closed = direct[:, : len(shown)], closed[:, : len(shown)]
    return np.abs(to_angle * opened), np.abs(to_angle * closed)


def _response(system: control.StateSpace, frequency: FloatArray) -> ComplexArray:
    return frequency_response(System.of(system, "coupled system"), frequency, -3)
