"""Nyquist plots: channel by channel, closed around undamped poles by arcs; of a complex loop, two-sided."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system, scaled
from platform_ctrl.analysis.margins import disk_margin
from platform_ctrl.analysis.poles import poles
from platform_ctrl.analysis.response import LinearSystem
from platform_ctrl.analysis.singular_values import boundary_poles
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import short
from platform_ctrl.common.text import at_least
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.classical.complex_shaping import ComplexLoop, TwoSidedNyquist
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, count, disk_gain_or_phase
from platform_ctrl.job.quantities import plain as number
from platform_ctrl.report.plots.curves import channels
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.panels import control_plot
from platform_ctrl.report.plots.systems import DrawnSystem, drawable, drawn_systems, grid
from platform_ctrl.report.style import (
    BAND,
    DASHES,
    INK,
    LIMIT,
    MUTED,
    REFERENCE,
    SERIES,
    legend,
    line_style,
    linear_axis,
    panel_width,
    panels,
    standalone,
)

if TYPE_CHECKING:
    import control


# How far from the origin the view goes; larger |L| lies on the rim.
_REACH = 3.0
# Radius of the half circle around a pole on the axis, as a share of its frequency.
_INDENT = 1e-3
# Steps of the curve, of the rim's radius, at most; how often they are halved, and points at most.
_STEP, _HALVINGS, _MOST = 0.03, 7, 8000
_COLUMNS = 3
_RIM = (0, (1.2, 1.8))
# Least distance of the dots at round frequencies, points.
_APART = 20.0


@value
class ChannelCurve:
    """One channel's loop transfer along the Nyquist contour of positive frequencies."""

    frequency: FloatArray  # (N,), rad/s; constant along an arc round a pole
    loop_transfer: ComplexArray  # (N,), All other channels closed
    # Disk margin, and where it is reached, rad/s; 0 where the closed loop is unstable, NaN for data
    margin: float
    margin_frequency: float
    unstable: int  # Poles of the closed loop beyond the stability boundary; −1 for data


@standalone
def nyquist(
    loops: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    *,
    frequency: ArrayLike | None = None,
    labels: Sequence[str] | None = None,
    margin: float | None = None,
    reach: float = _REACH,
) -> control.ControlPlot:
    """Nyquist plot of loop transfers, a panel for each channel with all others closed, and −1 with a disk about it.

    The curve is closed: poles on the stability boundary (integrators, undamped nutation) are passed on the right, on
    half circles of a thousandth of their frequency, so that the arcs are finite and turn in the right sense. What is
    larger than `reach` is drawn on the rim, with its phase.

    Parameters
    ----------
    loops
        L with negative feedback as from `analysis.loop_transfer`, square; several in a list or under their labels in
        a mapping. Data (`control.FrequencyResponseData`) are drawn as they are.
    frequency : (N,) or (2,), optional
        Two ends of a range or the frequencies themselves, rad/s; default what shows all poles and zeros.
    labels
        What the legend calls the loops.
    margin
        Disk margin, dimensionless, whose disk the curve should stay out of; default: the smallest that the loops of a
        panel have.
    reach
        Radius of the rim, > 1, dimensionless.

    Returns
    -------
    control.ControlPlot
        A panel for each channel; ``lines`` one for each loop.

    Raises
    ------
    ArgumentError
        Loops that are not square, differ in their number of channels or are no linear systems; options without sense.

    References
    ----------
    K. J. Åström, R. M. Murray, Feedback Systems, 2008, ch. 9.

    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """
    systems = drawn_systems("nyquist", loops, labels, square=True)
    sizes = {system.shape[0] for system in systems}
    if len(sizes) > 1:
        raise ArgumentError(f"nyquist: the loops have different numbers of channels, {sorted(sizes)}; draw them apart")
    radius = positive("nyquist: reach", reach)
    if radius <= 1.0:
        raise ArgumentError(f"nyquist: reach must be above 1, so that -1 is in view, got {reach!r}")
    required = None if margin is None else positive("nyquist: margin", margin)
    if required is not None and required >= 2.0:
        raise ArgumentError(f"nyquist: margin must be below 2, where the disk becomes a half plane, got {margin!r}")
    [size] = sizes
    curves = [_channels(system, frequency, radius) for system in systems]
    own = [[one[k].margin for one in curves if np.isfinite(one[k].margin)] for k in range(size)]
    disks = [required or min(margins, default=0.0) for margins in own]
    with_disk = any(0.0 < alpha < 2.0 for alpha in disks)
    names = [system.label or "L, ω > 0" for system in systems]
    names += ["ω < 0", "−1", *(["disk of the margin"] if with_disk else []), f"|L| > {radius:g}: on the rim"]
    columns = min(size, _COLUMNS)
    rows, width = -(-size // columns), 6.4 if columns == 1 else 9.6
    _, panel_grid = panels(rows, columns, panel_width(columns, width), names, width=width)
    every = list(panel_grid.flat)
    lines = []
    for k, axes in enumerate(every[:size]):
        lines.append(_panel(axes, [one[k] for one in curves], radius, disks[k]))
        _title(axes, [one[k] for one in curves], drawable(systems[0].inputs[k]) if size > 1 else "")
    for axes in every[size:]:
        axes.set_axis_off()
    for row in panel_grid:
        row[0].set_ylabel("imaginary part of L")
    handles: list[Any] = [Line2D([], [], **_style(k)) for k in range(len(systems))]
    handles += [
        tuple(Line2D([], [], **_style(k, mirrored=True)) for k in range(len(systems))),
        Line2D([], [], marker="+", color=LIMIT, linestyle="none", markersize=9, markeredgewidth=1.6),
        *([Patch(facecolor=BAND, edgecolor=MUTED)] if with_disk else []),
        Line2D([], [], color=REFERENCE, linewidth=0.8, linestyle=_RIM),
    ]
    return control_plot(np.array([every[:size]]), lines, handles, names)


def _channels(system: DrawnSystem, frequency: ArrayLike | None, reach: float) -> list[ChannelCurve]:
    """Return L of every channel with the others closed."""
    out = []
    for one in channels("nyquist", system):
        own = grid([one], frequency, name="nyquist", loops=True)
        if one.arrays is None:
            w, L = one.along(own)
            out.append(
                ChannelCurve(
                    frequency=w, loop_transfer=L[0, 0], margin=math.nan, margin_frequency=math.nan, unstable=-1
                )
            )
            continue
        loop = StateArrays(*scaled(*one.arrays[:3]), *one.arrays[3:])
        direct = 1.0 + loop.D[0, 0]
        if abs(direct) <= 1e-12:
            raise ArgumentError("nyquist: 1 + D of a loop is 0, an algebraic loop; add a lag or a delay")
        closed = poles(loop.A - loop.B @ loop.C / direct)
        growth = np.abs(closed) - 1.0 if loop.dt else closed.real / np.abs(closed).max(initial=1e-300)
        margin = disk_margin(named_system(loop, one.inputs, one.outputs))
        points, curve = _traced(loop, _contour(loop.A, loop.dt, own), reach)
        out.append(
            ChannelCurve(
                frequency=np.maximum(points.imag, 0.0),
                loop_transfer=curve,
                margin=margin.alpha,
                margin_frequency=margin.frequency if margin.alpha > 0.0 else math.nan,
                unstable=int(np.count_nonzero(growth > 1e-9)),
            )
        )
    return out


def _contour(A: FloatArray, dt: float, frequency: FloatArray) -> ComplexArray:
    """Return points s of the contour of positive frequencies, upwards: right round the poles on the axis."""
    poles, on = boundary_poles(A, dt) if len(A) else (np.zeros(0, dtype=np.complex128), np.zeros(0, dtype=np.bool_))
    centres = np.unique(np.abs(poles.imag[on & np.isfinite(poles)]))
    low, high = float(frequency[0]), float(frequency[-1])
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 121)
    along, pieces = frequency, []
    done = -np.inf
    for centre in centres:
        if centre <= 1e-6 * low:
            # From the real axis on: the other half is that of negative frequencies.
            pieces.append(low * np.exp(1j * turn[60:]))
        elif low < centre < high and centre - done > 4.0 * _INDENT * centre:
            along = along[np.abs(along - centre) > _INDENT * centre]
            pieces.append(1j * centre + _INDENT * centre * np.exp(1j * turn))
        done = centre
    s = np.concatenate([1j * along, *pieces])
    return np.asarray(s[np.argsort(s.imag, kind="stable")], dtype=np.complex128)


def _traced(loop: StateArrays, s: ComplexArray, radius: float) -> tuple[ComplexArray, ComplexArray]:
    """Return the points of the contour with more between them where the curve runs, and L there."""
    L = _response(loop, s)
    for _ in range(_HALVINGS):
        size = np.abs(L)
        shown = L * (radius / np.maximum(size, radius))
        long = np.flatnonzero(np.abs(np.diff(shown)) > _STEP * radius)
        if not long.size or len(s) > _MOST:
            break
        between = 0.5 * (s[long] + s[long + 1])
        s, L = np.insert(s, long + 1, between), np.insert(L, long + 1, _response(loop, between))
    return s, L


def _response(system: StateArrays, points: ComplexArray) -> ComplexArray:
    """Return the response of one channel at any points s, (N,)."""
    A, B, C, D, dt = system
    if not len(A):
        return np.full(len(points), D[0, 0], dtype=np.complex128)
    points = np.exp(points * dt) if dt else points
    resolvent = points[:, None, None] * np.eye(len(A)) - A
    states = np.linalg.solve(resolvent, np.broadcast_to(B.astype(np.complex128), (len(points), *B.shape)))
    return np.asarray((C @ states)[:, 0, 0] + D[0, 0], dtype=np.complex128)


def _on_rim(L: ComplexArray, radius: float) -> ComplexArray:
    """Return L with what lies beyond the rim drawn onto it; broken where it leaps across."""
    with np.errstate(all="ignore"):
        size = np.abs(L)
        far = size > radius
        out = np.where(far, radius * L / size, L)
        leaps = np.flatnonzero(far[1:] & far[:-1] & (np.abs(np.diff(out)) > 0.5 * radius))
    return np.insert(out, leaps + 1, complex(np.nan, np.nan))


def _style(k: int, *, mirrored: bool = False) -> dict[str, Any]:
    """Return the look of the k-th loop; that of its mirror image at negative frequencies is thinner."""
    return line_style(k) | ({"linewidth": 0.7, "zorder": 2} if mirrored else {"linewidth": 1.5, "zorder": 3})


def _panel(axes: Axes, curves: list[ChannelCurve], radius: float, alpha: float) -> list[Line2D]:
    half = 1.06 * radius
    plane_of_L(axes, 0.0, half)
    rim = radius * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    axes.plot(rim.real, rim.imag, color=REFERENCE, linewidth=0.8, linestyle=_RIM, zorder=1)
    margin_disk(axes, alpha)
    critical_point(axes)
    lines = []
    for k, curve in enumerate(curves):
        shown = _on_rim(curve.loop_transfer, radius)
        [line] = axes.plot(shown.real, shown.imag, **_style(k))
        axes.plot(shown.real, -shown.imag, **_style(k, mirrored=True))
        lines.append(line)
        inside = np.isfinite(shown) & (np.abs(shown) < 0.97 * radius)
        arrows(axes, shown, inside, radius, SERIES[k % len(SERIES)])
    places = LabelPlacer(axes, axes.lines)
    places.reserve(-1.0, 0.0, 5.0)
    for k, curve in enumerate(curves):
        _frequencies(axes, places, curve, radius, SERIES[k % len(SERIES)])
    return lines


def plane_of_L(axes: Axes, centre: float, half: float) -> None:
    """Show the square of half width `half` about a point of the real axis, with both axes of the plane."""
    axes.set_aspect("equal")
    axes.set_xlim(centre - half, centre + half)
    axes.set_ylim(-half, half)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6, zorder=0)
    axes.axvline(0.0, color=REFERENCE, linewidth=0.6, zorder=0)
    linear_axis(axes.xaxis, 6)
    linear_axis(axes.yaxis, 6)
    axes.set_xlabel("real part of L")


def critical_point(axes: Axes) -> Line2D:
    """Draw a cross at −1."""
    [cross] = axes.plot([-1.0], [0.0], "+", color=LIMIT, markersize=10, markeredgewidth=1.6, linestyle="none", zorder=5)
    return cross


def margin_disk(axes: Axes, alpha: float) -> Polygon | None:
    """Shade the values of L that a disk margin `alpha` excludes; nothing where they are none, or a half plane."""
    if not 0.0 < alpha < 2.0:
        return None
    low, high = -(2.0 + alpha) / (2.0 - alpha), -(2.0 - alpha) / (2.0 + alpha)
    disk = 0.5 * (low + high) + 0.5 * (high - low) * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    [drawn] = axes.fill(disk.real, disk.imag, facecolor=BAND, edgecolor=MUTED, linewidth=0.9, zorder=0.5)
    return drawn


def arrows(axes: Axes, L: ComplexArray, visible: NDArray[np.bool_], half: float, colour: str, most: int = 1) -> None:
    """Point towards rising frequency in the middle of the longest visible stretches, `most` of them at most."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], visible.astype(np.int8), [0]]))).reshape(-1, 2)
    stretches = sorted(((np.abs(np.diff(L[a:b])).sum(), a, b) for a, b in edges if b - a > 2), reverse=True)
    for length, a, b in stretches[:most]:
        if length > 0.2 * half:
            k = min(a + int(np.searchsorted(np.cumsum(np.abs(np.diff(L[a:b]))), 0.5 * length)), b - 2)
            step = L[k + 1] - L[k]
            tail = L[k] - 0.01 * half * step / abs(step)
            style = {"arrowstyle": "-|>", "color": colour, "mutation_scale": 12, "linewidth": 0.0}
            axes.annotate("", (L[k].real, L[k].imag), (tail.real, tail.imag), arrowprops=style, zorder=4)


def _frequencies(axes: Axes, places: LabelPlacer, curve: ChannelCurve, radius: float, colour: str) -> None:
    """Write the margin's frequency and round ones in Hz along the curve, wherever there is room."""
    hz, L = curve.frequency * HZ, curve.loop_transfer
    if np.isfinite(curve.margin_frequency) and curve.margin > 0.0:
        k = int(np.argmin(np.abs(curve.frequency - curve.margin_frequency)))
        if abs(L[k]) < radius:
            axes.plot([L[k].real], [L[k].imag], "D", color=LIMIT, markersize=4, zorder=5)
            places.reserve(L[k].real, L[k].imag, 3.0)
            places.write(f"{hz[k]:.3g} Hz", L[k].real, L[k].imag, colour=LIMIT, bold=True, required=True)
    inside = np.where(np.abs(L) < 0.96 * radius, L, complex(np.nan, np.nan))
    places.write_frequencies(hz, np.column_stack([inside.real, inside.imag]), colour, apart=_APART, colour=INK)


def _title(axes: Axes, curves: list[ChannelCurve], name: str) -> None:
    """Write the disk margin, or the number of unstable poles, into the panel's title."""
    head = f"{name}: " if name else ""
    if len(curves) > 1 or curves[0].unstable < 0:
        axes.set_title(head.removesuffix(": ") or "frequencies in Hz")
        return
    [curve] = curves
    if curve.unstable:
        axes.set_title(f"{head}{count(curve.unstable, 'unstable pole')} of the closed loop")
        return
    allowed = " or ".join(disk_gain_or_phase(curve.margin))
    axes.set_title(f"{head}disk margin {number(curve.margin, 3, 'down')}: {allowed}")


# Half width of the close view about −1, and of the wide one.
_CLOSE, _WIDE = 1.8, 6.0


@standalone
def two_sided_nyquist(curve: TwoSidedNyquist | ComplexLoop) -> Figure:
    """L over positive and negative frequencies: as a whole, and close to −1 with the disk that its margin keeps free.

    The disk holds the points that perturbed loops of the margin's size would need to reach −1: L touches it once.

    Parameters
    ----------
    curve
        From `design.complex_shaping.complex_loop`: the loop itself, or its ``nyquist``.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels.

    Raises
    ------
    ArgumentError
        It is something else.
    """
    curve = curve.nyquist if isinstance(curve, ComplexLoop) else curve
    if not isinstance(curve, TwoSidedNyquist):
        raise ArgumentError(
            f"two_sided_nyquist: curve must be a TwoSidedNyquist or ComplexLoop, from complex_loop, got {short(curve)}"
        )
    names = ["ω > 0: turning from α to β", "ω < 0: from β to α", "−1"]
    if 0.0 < curve.disk_margin < 2.0:
        touching = _signed(curve.margin_frequency, curve.margin_frequency * HZ)
        names.append(f"disk margin {at_least(curve.disk_margin, 2)}; L touches it at {touching} Hz")
    figure, [[wide, close]] = panels(1, 2, 3.95, names)
    handles: list[Any] = []
    for axes, centre, half in ((wide, 0.0, _WIDE), (close, -1.0, _CLOSE)):
        drawn = [_branch(axes, curve, sign) for sign in (1, -1)]
        disk = _disk(axes, curve)
        critical = critical_point(axes)
        plane_of_L(axes, centre, half)
        places = LabelPlacer(axes, drawn)
        places.reserve(-1.0, 0.0, 5.0)
        for sign in (1, -1):
            w, L = _side(curve, sign)
            visible = _inside(L, centre, half, 0.9)
            colour = SERIES[0 if sign > 0 else 1]
            arrows(axes, L, visible, half, colour, most=3)
            order = np.argsort(np.abs(w))
            shown = np.where(visible, L, complex(np.nan, np.nan))[order]
            hz, points = np.abs(w[order]) * HZ, np.column_stack([shown.real, shown.imag])
            places.write_frequencies(hz, points, colour, apart=_APART, words=partial(_signed, sign))
        handles = [*drawn, critical, *([disk] if disk is not None else [])]
    wide.set_ylabel("imaginary part of L")
    legend(figure, handles, names)
    wide.set_title(f"L = −K P, frequencies in Hz; turns round −1: {curve.encirclements}")
    close.set_title("close to −1" if curve.disk_margin else f"close to −1; {curve.closed_unstable} unstable poles")
    return figure


def _signed(sign: float, hz: float) -> str:
    return f"{'+' if sign > 0.0 else '−'}{abs(hz):.4g}"


def _side(curve: TwoSidedNyquist, sign: int) -> tuple[FloatArray, ComplexArray]:
    chosen = curve.frequency * sign > 0.0
    return curve.frequency[chosen], curve.loop_transfer[chosen]


def _branch(axes: Axes, curve: TwoSidedNyquist, sign: int) -> Any:
    _, L = _side(curve, sign)
    # Across a pole the curve goes through infinity: no line is drawn there.
    far = np.abs(L) > 50.0
    L = np.where(far, np.nan, L)
    k = 0 if sign > 0 else 1
    [line] = axes.plot(L.real, L.imag, color=SERIES[k], linestyle=DASHES[k], linewidth=1.6)
    return line


def _disk(axes: Axes, curve: TwoSidedNyquist) -> Any:
    """Values of L that a change of the margin's size in gain and phase could bring to −1, and where L touches them."""
    drawn = margin_disk(axes, curve.disk_margin)
    if drawn is not None:
        touching = curve.loop_transfer[int(np.argmin(np.abs(curve.frequency - curve.margin_frequency)))]
        axes.plot([touching.real], [touching.imag], "D", color=LIMIT, markersize=4, zorder=3)
    return drawn


def _inside(L: ComplexArray, centre: float, half: float, share: float) -> NDArray[np.bool_]:
    return np.isfinite(L) & (np.abs(L.real - centre) < share * half) & (np.abs(L.imag) < share * half)
