"""Pictures of a job's loops and of the coupled system that are no plain curves over frequency, and what those show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from platform_ctrl.analysis.curves import Curve, Curves, Level, loop_phase, upper_half_plane
from platform_ctrl.analysis.feedback import channel_transfers
from platform_ctrl.analysis.poles import continuous_poles, following_grid
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import sampled
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import Design, closed_loop_poles, sampled_plant
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.job.quantities import HZ, quantity
from platform_ctrl.mechanics.modes import nutates
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.drawing import root_series, signal_series
from platform_ctrl.plant.drives import ROOT_TORQUE_NAMES
from platform_ctrl.plant.platform import OMEGA_NAMES
from platform_ctrl.report import style as styles
from platform_ctrl.report.captions import bandwidth_hz
from platform_ctrl.report.curves import ShownLoop, damping_rays
from platform_ctrl.report.figures.plant import campbell
from platform_ctrl.report.figures.root_locus import draw_locus, gain_locus
from platform_ctrl.verification.coupled import CoupledCheck
from platform_ctrl.verification.verdict import JobResult

# Range of the root locus, factors on the loop gain; and of the rotors' speed in the Campbell diagram.
_GAINS, _SPINS = (0.0, 2.0), (0.0, 1.5)
# From z = 1, of a pole at rest.
_AT_REST = 1e-6
# Cells of a panel with poles, one of which is drawn in each.
_CELLS = 400.0
# Labels on two lines that are closer than this share of the axis would overlap.
_APART = 0.05


def damping_lines(axes: Axes, spec: LoopSpec, top: float, named: bool) -> None:
    """Draw the required damping of fast poles as rays of the s-plane, up to the imaginary part `top`."""
    rays = [(ratio, styles.DASHES[dashes], styles.LIMIT) for ratio, dashes, _ in damping_rays(spec.limits)]
    rays += [(ratio, styles.DASH_DOTTED, styles.MUTED) for ratio, _, _ in damping_rays(spec.soft)]
    for k, (ratio, dashes, colour) in enumerate(rays):
        if not 0.0 < ratio < 1.0:
            continue
        slope, height = ratio / np.sqrt(1.0 - ratio**2), 0.96 - 0.08 * k
        axes.plot([0.0, -slope * top], [0.0, top], color=colour, linestyle=dashes, linewidth=0.9)
        if named:
            text = f"{ratio:g}" if colour == styles.LIMIT else f"goal {ratio:g}"
            at = (-slope * height * top, height * top)
            axes.annotate(
                text, at, (-3, 0), color=colour, ha="right", va="center", textcoords="offset points", fontsize=7
            )


def fastest_pole_line(axes: Axes, spec: LoopSpec, period: float) -> None:
    """Draw the circle of the w-plane that closed-loop poles have to stay within, carried to s = ln(z)/T."""
    for limits, colour, dashes in (
        (spec.limits, styles.LIMIT, styles.DASHED),
        (spec.soft, styles.MUTED, styles.DASH_DOTTED),
    ):
        if "fastest_pole" in limits:
            # The left upper quarter of a circle about w = 0.
            angle = np.linspace(0.5 * np.pi, np.pi, 400)[:-1]
            w = 0.5 * period * limits["fastest_pole"] * np.exp(1j * angle)
            s = np.log((1.0 + w) / (1.0 - w)) / period
            axes.plot(s.real, s.imag, color=colour, linestyle=dashes, linewidth=0.9)


def pole_figure(loop: ShownLoop) -> Figure:
    """Closed-loop poles of the nominal plant (strong), of uncertain plants (faint) and with faults (crosses)."""
    names = [one.label for one in loop.designs]
    figure, views = pole_views(names, np.pi / loop.plants.period, 1.7 * loop.plants.nutation)
    handles: list[Any] = []
    for axes in views:
        (left, right), top = axes.get_xlim(), axes.get_ylim()[1]
        drawn: list[Any] = []
        for one in loop.designs:
            place = one.series % len(styles.SERIES)
            style: dict[str, Any] = {
                "color": styles.SERIES[place],
                "linestyle": "none",
                "marker": styles.MARKERS[place],
            }
            faint = {"markersize": 1.8, "alpha": 0.35, "markeredgewidth": 0}
            crossed = {"marker": "x", "markersize": 2.6, "alpha": 0.75, "markeredgewidth": 0.7}
            strong = {"markersize": 6, "markerfacecolor": "none", "markeredgewidth": 1.3}
            for s, look in ((one.varied_poles, faint), (one.fault_poles, crossed), (one.poles, strong)):
                shown = apart(upper_half_plane(s), left, right, top)
                drawn += axes.plot(shown.real, shown.imag, **style | look)[: look is strong]
        handles = handles or drawn
        damping_lines(axes, loop.spec, top, named=axes is views[1])
        fastest_pole_line(axes, loop.spec, loop.plants.period)
    styles.legend(figure, handles, names)
    return figure


def coupled_pole_figure(result: JobResult) -> Figure:
    """Poles of the coupled closed loop: all of them, and those around the nutation frequencies and below."""
    check = _checked(result)
    s = upper_half_plane(continuous_poles(check.poles, check.period))
    nyquist = np.pi / check.period
    nutations = [o.closed.plants.nutation for o in result.loops if o.closed.plants is not None]
    slow = 1.7 * max(nutations, default=float(np.median(np.abs(s))) if s.size else nyquist)
    figure, views = pole_views([], nyquist, min(slow, nyquist))
    for axes in views:
        axes.set_ylim(-0.02 * axes.get_ylim()[1])
        good, bad = s[s.real < 0.0], s[s.real >= 0.0]
        axes.plot(good.real, good.imag, "x", color=styles.SERIES[0], markersize=5)
        axes.plot(bad.real, bad.imag, "x", color=styles.LIMIT, markersize=7, markeredgewidth=2)
    return figure


def pole_views(names: Sequence[str], nyquist: float, slow: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with the upper half plane up to the Nyquist frequency, and closer to the origin, rad/s."""
    figure, [row] = styles.panels(1, 2, 2.7, names)
    views = ((-1.1 * nyquist, 0.12 * nyquist, 1.02 * nyquist), (-1.2 * slow, 0.18 * slow, slow))
    for axes, (left, right, top) in zip(row, views, strict=True):
        axes.axvline(0.0, color=styles.REFERENCE, linewidth=0.8)
        axes.axvspan(0.0, right, color=styles.BAND, linewidth=0, zorder=0)
        axes.set_xlim(left, right)
        axes.set_ylim(0.0, top)
        styles.linear_axis(axes.xaxis, 6)
        styles.linear_axis(axes.yaxis, 6)
        axes.set_xlabel("real part, 1/s")
    row[0].set_ylabel("imaginary part, rad/s")
    row[0].set_title("all poles up to the Nyquist frequency")
    row[1].set_title("closer to the origin")
    return figure, list(row)


def apart(s: ComplexArray, left: float, right: float, top: float) -> ComplexArray:
    """Return the poles that a view shows, one of those that would cover each other."""
    s = s[(s.real > left) & (s.real < right) & (s.imag < top)]
    cells = np.round(_CELLS * np.column_stack([s.real / (right - left), s.imag / top]))
    return np.asarray(s[np.unique(cells, axis=0, return_index=True)[1]])


def root_locus_plot(design: Design, spec: LoopSpec) -> Any:
    """Return a root locus over gains up to twice the design's, with the limits on poles; `locus` has the numbers."""
    assert design.plants is not None
    assert design.measures is not None
    plant, K = sampled_plant(design.plants), design.own_controller
    every, own = closed_loop_poles(design.plants.only([0]), K)[0], design.measures.poles[0]
    # Where angles drift, the loop has poles at rest that its measures leave out.
    resting, kept = (np.count_nonzero(np.abs(z - 1.0) < _AT_REST) for z in (every, own))
    plot = draw_locus(gain_locus(plant, K, _GAINS, int(resting - kept)), "gain", "loop gain / nominal")
    axes: Axes = plot.axes[0, 0]
    damping_lines(axes, spec, axes.get_ylim()[1], named=False)
    fastest_pole_line(axes, spec, design.plants.period)
    return plot


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
        axes.axvspan(
            (1.0 - uncertainty) * nominal, (1.0 + uncertainty) * nominal, color=styles.BAND, linewidth=0, zorder=0
        )
    loops = sorted(((bandwidth_hz(one.closed), one.spec.name) for one in result.loops), reverse=True)
    last = 2.0 * high
    for bandwidth, name in loops:
        if not low < bandwidth < high:
            continue
        axes.axhline(bandwidth, color=styles.REFERENCE, linewidth=0.8, linestyle=styles.DOTTED)
        if last - bandwidth > _APART * high:
            words = f"bandwidth of {name}, {quantity(bandwidth, 'Hz', 3)}"
            at = (axes.get_xlim()[1], bandwidth)
            axes.annotate(
                words, at, (-3, 2), textcoords="offset points", ha="right", va="bottom", fontsize=7, color=styles.MUTED
            )
            last = bandwidth
    return figure


def simultaneous_margin(check: CoupledCheck, limit: float | None) -> list[list[Curves]]:
    """Disk margin in all channels at once over frequency: guaranteed, and known to be exceeded."""
    margin = check.simultaneous
    # Slower than a hundred-thousandth of the fastest nothing happens that the picture would show.
    kept = margin.frequencies > 1e-5 * margin.frequencies[-1]
    f = margin.frequencies[kept] * HZ
    bounds = {"guaranteed": margin.lower_response, "some perturbation of this size destabilises": margin.upper_response}
    curves = [Curve(x=f, y=y[kept], name=name, series=k) for k, (name, y) in enumerate(bounds.items())]
    least = Curve(x=np.array([margin.frequency * HZ]), y=np.array([margin.lower]), form="mark")
    levels = () if limit is None else (Level(y=limit, text=f"limit {limit:g}"),)
    return [[Curves(curves=(*curves, least), quantity="disk margin", high=10.0, levels=levels)]]


def _checked(result: JobResult) -> CoupledCheck:
    assert result.coupled is not None, "all loops have controllers"
    return result.coupled


def coupled_grid(result: JobResult) -> FloatArray:
    """Return frequencies for the coupled system, rad/s, from below its slowest pole up to the Nyquist frequency."""
    check = _checked(result)
    s = continuous_poles(check.poles, check.period)
    finite = np.abs(s[np.isfinite(s.real) & (np.abs(s) > 0.0)])
    nyquist = np.pi / check.period
    low = float(np.clip(0.1 * finite.min(initial=nyquist), 1e-5 * nyquist, 1e-3 * nyquist))
    return following_grid(s, low, 0.999 * nyquist)


def servo(result: JobResult) -> list[list[Curves]] | None:
    """Bode diagram of each root torquer's loop in the coupled system, others closed; None without such a torquer."""
    check = _checked(result)
    roots = set(result.job.platform.root_torquers)
    chosen = [k for k, name in enumerate(check.channels) if name in roots]
    if not chosen or not check.stable or check.controller is None:
        return None
    w = coupled_grid(result)
    loops = channel_transfers(check.plant, check.controller, w)
    series = signal_series(result.job.platform)
    looks = {k: {"name": check.channels[k], "series": series[check.channels[k]]} for k in chosen}
    size, phase = (
        tuple(Curve(x=w * HZ, y=np.asarray(of(loops[k])), **look) for k, look in looks.items())  # type: ignore[arg-type]
        for of in (np.abs, loop_phase)
    )
    gain = Curves(
        curves=size, title="loop transfer at the torquer", quantity="gain, 1", low=1e-3, high=1e4, references={1.0: ""}
    )
    return [[gain, Curves(curves=phase, title="its phase", quantity="phase, degrees", kind="phase")]]


def platform_disturbance(result: JobResult) -> list[list[Curves]]:
    """Platform angle and largest gimbal angle per torque on the platform, loops closed against no controller at all."""
    w = coupled_grid(result)
    opened, closed = platform_compliance(result, w)
    own = [closed[:, -3 + axis, axis] for axis in range(3)]
    moved, top = np.linalg.norm(closed[:, :-3], axis=1), float(np.max(own))

    def lines(values: Sequence[FloatArray]) -> list[Curve]:
        names = [f"torque about axis {axis}" for axis in (1, 2, 3)]
        looks = zip(values, names, (1, 2, 3), strict=True)
        return [Curve(x=w * HZ, y=y, name=name, series=root_series(axis)) for y, name, axis in looks]

    grey = [
        Curve(x=w * HZ, y=opened[:, -3 + axis, axis], name="no controller", series=None, dashes=root_series(axis + 1))
        for axis in range(3)
    ]
    title = "torque on the platform → "
    shown: dict[str, Any] = {"quantity": "mrad per mN m", "low": 1e-7 * top, "high": 30.0 * top}
    row = [Curves(curves=(*lines(own), *grey), title=f"{title}its own angle", **shown)]
    if result.model.angle_names:
        shown |= {"low": 1e-6 * float(moved.max(initial=1e-12)), "high": np.inf}
        row.append(Curves(curves=tuple(lines(list(moved.T))), title=f"{title}gimbal angles", **shown))
    return [row]


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
    free = observed(state_space(model, root="free"), model.platform, outputs, model.q0, model.Omega0)
    signals = [t.signal for t in job.platform.torquers]
    direct = _response(free[outputs, list(ROOT_TORQUE_NAMES)], frequency)
    # The platform's rates become angles.
    to_angle = np.ones((len(frequency), len(shown), 1), dtype=np.complex128)
    to_angle[:, -3:] = (1.0 / (1j * frequency))[:, None, None]
    driven = sampled(
        free[outputs, signals], job.sampling.period, job.sampling.delay, [t.lag for t in job.platform.torquers]
    )
    P, K = _response(driven, frequency), _response(check.controller, frequency)
    rows = [outputs.index(name) for name in check.controller.input_labels]
    columns = [[t.name for t in job.platform.torquers].index(name) for name in check.controller.output_labels]
    loop = P[:, rows][:, :, columns] @ K
    seen = np.linalg.solve(np.eye(len(rows)) - loop, direct[:, rows])
    closed = direct + P[:, :, columns] @ K @ seen
    opened, closed = direct[:, : len(shown)], closed[:, : len(shown)]
    return np.abs(to_angle * opened), np.abs(to_angle * closed)


def _response(system: control.StateSpace, frequency: FloatArray) -> ComplexArray:
    return frequency_response(System.of(system, "coupled system"), frequency, -3)
