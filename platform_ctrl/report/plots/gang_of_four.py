"""The gang of four: what a closed loop does to disturbances and noise, S, T, P S and K S."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.feedback import Gang, closed_loop, gang
from platform_ctrl.analysis.poles import is_stable
from platform_ctrl.analysis.transfer_function import LinearSystem
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.plots.frequency_grid import grid
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.panels import (
    blocks,
    bound,
    curve_style,
    draw,
    frequency_panels,
    gain_label,
    gain_panel,
    gains,
    legend,
    line_array,
    shade,
)
from platform_ctrl.report.plots.systems import (
    DrawnSystem,
    as_state_space,
    drawn_systems,
    ratio_unit,
    unit,
    unit_of_gain,
)
from platform_ctrl.report.quantities import HZ, plain
from platform_ctrl.report.style import REFERENCE, standalone

if TYPE_CHECKING:
    import control


@check_arguments
@standalone
def singular_values(
    systems: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    *,
    frequency: ArrayLike | None = None,
    labels: Sequence[str] | None = None,
    upper: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    lower: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    dB: bool = False,
) -> control.ControlPlot:
    """Draw the singular values of systems: the largest of each drawn heavier, the others of its colour lighter.

    Parameters
    ----------
    systems
        `control.StateSpace`, `TransferFunction` or `FrequencyResponseData`, continuous or sampled, of any shapes;
        several in a sequence, or a mapping from labels.
    frequency : (N,) or (2,), optional
        rad/s: the frequencies themselves, or two numbers as the ends of a range; default wherever poles and zeros are,
        for sampled systems up to the Nyquist frequency, which is marked.
    labels
        One for each system; default their names.
    upper, lower : scalar, or a pair of (N,)
        Limits, in the systems' units, shaded beyond: a number, or a pair (frequencies in rad/s, levels) that is joined
        to a polyline.
    dB
        Whether gains are in decibels; limits are given as plain numbers all the same.

    Returns
    -------
    control.ControlPlot
        One panel; ``lines`` those of the first system, largest first, then of the next.

    Raises
    ------
    ArgumentError
        No system or another type, frequencies that are not ascending and positive, or limits that are not positive.

    References
    ----------
    S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2005, ch. 3.
    """
    import control

    above, below = bound("singular_values: upper", upper), bound("singular_values: lower", lower)
    drawn = drawn_systems("singular_values", systems, labels)
    every = grid(drawn, frequency, name="singular_values")
    # One without a name needs no legend.
    names = [one.label or "largest and smallest gain" for one in drawn] if len(drawn) > 1 or drawn[0].label else []
    figure, axes = blocks(1, 1, (3.4,), names, titles=False)
    panel = axes[0, 0]
    lines = line_array(axes)
    handles, shown, ends = [], [], []
    for k, one in enumerate(drawn):
        w, response = one.along(every)
        values = singular(response)
        ends += [w[0], w[-1]]
        for n, row in enumerate(values):
            first = n == 0
            style = {"linewidth": 1.7} if first else {"linewidth": 0.9, "marker": "", "alpha": 0.85}
            line = draw(panel, w, gains(row, dB=dB), k, **style)
            lines[0, 0].append(line)
            handles += [line] if first else []
            shown.append((one, w, row))
    levels = [] if above is None else [2.0 * float(g) for g in above[1]]
    levels += [] if below is None else [0.5 * float(g) for g in below[1]]
    frequency_panels([panel], min(ends), max(ends), drawn)
    gain_panel(panel, shown, dB=dB, more=levels)
    shade(panel, above, dB=dB)
    shade(panel, below, dB=dB, below=True)
    units = {unit_of_gain(one) for one in drawn}
    panel.set_ylabel(gain_label("singular values", units.pop() if len(units) == 1 else "", dB))
    return control.ControlPlot(lines, axes, figure, legend=legend(figure, handles[: len(names)], names))


def singular(response: ComplexArray) -> FloatArray:
    """Return the singular values of (p, m, N), largest first, (min(p, m), N); NaN where the response is."""
    H = np.moveaxis(response, -1, 0)
    fine = np.all(np.isfinite(H), axis=(-2, -1))
    out = np.full((len(H), min(H.shape[1:])), math.nan)
    if fine.any():
        out[fine] = np.linalg.svd(H[fine], compute_uv=False)
    return out.T


def largest(response: ComplexArray) -> FloatArray:
    """Return the largest singular value of (p, m, N), (N,)."""
    return np.asarray(singular(response)[0], dtype=np.float64)


Limit = ArrayLike | tuple[ArrayLike, ArrayLike] | None
_TITLES = ("S: sensitivity", "T: complementary sensitivity", "P S: disturbance to output", "K S: noise to control")
_NAMED = ("", "", "P S: torque disturbance to angle", "K S: pick-off noise to torque")


@value
class _Closed:
    """A controller closed: what is drawn of it."""

    label: str
    loop: DrawnSystem
    stable: bool
    gang: Gang


@check_arguments
@standalone
def gang_of_four(
    plant: LinearSystem,
    controllers: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    *,
    frequency: ArrayLike | None = None,
    labels: Sequence[str] | None = None,
    S_limit: Limit = None,
    T_limit: Limit = None,
    PS_limit: Limit = None,
    KS_limit: Limit = None,
    dB: bool = False,
) -> control.ControlPlot:
    """Draw sensitivity S, complementary sensitivity T, P S and K S of the closed loop u = K y.

    They are computed from the closed loop's own equations (`analysis.gang`). With several channels the largest
    singular values are drawn; S and T of one controller at the plant's input and at its output, of several controllers
    the larger of both. The peaks of S and T are marked.

    Parameters
    ----------
    plant
        `control.StateSpace` or `TransferFunction`; may have more inputs and outputs than the controllers use.
    controllers
        u = K y without a hidden sign: negative feedback is in K. One, several in a sequence, or a mapping from labels;
        joined to the plant by signal names where all of them exist there, by position otherwise.
    frequency : (N,) or (2,), optional
        rad/s: the frequencies themselves, or two numbers as the ends of a range; default wherever poles and zeros are.
    labels
        One for each controller; default their names.
    S_limit, T_limit, PS_limit, KS_limit
        Levels that a curve must not exceed, shaded above: a number, or a pair (frequencies in rad/s, levels).
    dB
        Whether gains are in decibels; limits are given as plain numbers all the same.

    Returns
    -------
    control.ControlPlot
        ``axes`` (2, 2): S, T above P S, K S; ``lines`` the curves in each.

    Raises
    ------
    ArgumentError
        Systems of another type (data will not do), plant and controller that do not fit together, frequencies that are
        not ascending and positive, or limits that are not.

    References
    ----------
    K. J. Åström, R. M. Murray, Feedback Systems, 2008, ch. 11.
    """
    import control

    limits = [
        bound(f"gang_of_four: {name}_limit", given)
        for name, given in (("S", S_limit), ("T", T_limit), ("PS", PS_limit), ("KS", KS_limit))
    ]
    closed, every = _closed(plant, controllers, labels, frequency)
    several = len(closed) > 1
    sides = closed[0].gang.S_input.shape[0] > 1 or closed[0].gang.S_output.shape[0] > 1
    names = [_name(one, several) for one in closed]
    if sides and not several:
        unstable = "" if closed[0].stable else ", closed loop not stable"
        names = [f"at the plant's input{unstable}", f"at the plant's output{unstable}"]
    if not several and not sides and closed[0].stable and not closed[0].label:
        names = []
    figure, axes = blocks(2, 2, (2.0,), names)
    lines = line_array(axes)
    curves = [_curves(one, several, sides) for one in closed]
    units, titles = _units(closed[0].loop, closed[0].gang)
    for n, panel in enumerate(axes.flat):
        rows = [row for one in curves for row in one[n]]
        lines[n // 2, n % 2] = [draw(panel, every, gains(row, dB=dB), k) for k, row in enumerate(rows)]
        frequency_panels([panel], every[0], every[-1], [one.loop for one in closed])
        levels = [] if limits[n] is None else [2.0 * float(g) for g in limits[n][1]]  # type: ignore[index]  # just judged
        flat = [0.5, 2.0] if n < 2 else []
        gain_panel(panel, [(closed[0].loop, every, row) for row in rows], dB=dB, more=[*levels, *flat])
        if n < 2:
            panel.axhline(0.0 if dB else 1.0, color=REFERENCE, linewidth=0.9, zorder=1)
        shade(panel, limits[n], dB=dB)
        panel.set_title(titles[n])
        panel.set_ylabel(gain_label("gain", units[n], dB))
        if n < 2 and len(rows) <= 3:
            _peaks(panel, every, rows, dB, limits[n])
    handles = lines[0, 0][: len(names)]
    return control.ControlPlot(lines, axes, figure, legend=legend(figure, handles, names))


def _closed(
    plant: Any, controllers: Any, labels: Sequence[str] | None, frequency: ArrayLike | None
) -> tuple[list[_Closed], FloatArray]:
    [P] = drawn_systems("gang_of_four: plant", plant, data=False)
    every_K = drawn_systems("gang_of_four: controllers", controllers, labels, data=False)
    loops: list[DrawnSystem] = []
    for K in every_K:
        joined = closed_loop(as_state_space("gang_of_four: plant", P), as_state_space("gang_of_four: controllers", K))
        loops += drawn_systems("gang_of_four", joined)
    every = grid([P, *every_K, *loops], frequency, name="gang_of_four")
    top = min(one.nyquist for one in loops)
    every = every[every <= top]
    if not every.size:
        raise ArgumentError(f"gang_of_four: frequency: all above the Nyquist frequency, {top:.6g} rad/s")
    out = [
        _Closed(
            label=K.label,
            loop=loop,
            stable=is_stable(loop.source),
            gang=gang(as_state_space("gang_of_four: plant", P), as_state_space("gang_of_four: controllers", K), every),
        )
        for K, loop in zip(every_K, loops, strict=True)
    ]
    return out, every


def _name(one: _Closed, several: bool) -> str:
    label = one.label or ("" if several else "closed loop")
    return label if one.stable else f"{label}, not stable"


def _curves(one: _Closed, several: bool, sides: bool) -> list[list[FloatArray]]:
    """Return the curves of S, T, P S and K S."""
    g = one.gang
    pairs = [[largest(H) for H in pair] for pair in ((g.S_input, g.S_output), (g.T_input, g.T_output))]
    if not sides:
        pairs = [pair[:1] for pair in pairs]
    elif several:
        pairs = [[np.maximum(*pair)] for pair in pairs]
    return [*pairs, [largest(g.angle_per_torque)], [largest(g.torque_per_noise)]]


def _units(loop: DrawnSystem, g: Gang) -> tuple[list[str], list[str]]:
    """Return units and titles: those of angles and torques where the names say so."""
    p, m = g.angle_per_torque.shape[:2]
    torques = {unit(name) for name in loop.outputs[:m]}
    angles = {unit(name.removeprefix("noise_")) for name in loop.inputs[-p:]}
    if len(torques) != 1 or len(angles) != 1 or "" in torques | angles:
        return ["", "", "", ""], list(_TITLES)
    torque, angle = torques.pop(), angles.pop()
    named = torque == "N m" and angle == "rad"
    titles = [special if named and special else plain_ for plain_, special in zip(_TITLES, _NAMED, strict=True)]
    return ["", "", ratio_unit(angle, torque), ratio_unit(torque, angle)], titles


def _peaks(
    panel: Axes,
    w: FloatArray,
    rows: Sequence[FloatArray],
    dB: bool,
    limit: tuple[FloatArray, FloatArray] | None,
) -> None:
    """Mark the peak of each curve, and write it."""
    levels = [gains(row, dB=dB) for row in rows]
    places = LabelPlacer(panel, [np.column_stack([w * HZ, level]) for level in levels])
    left, right = panel.get_xlim()
    places.avoid([np.array([[left, 0.0 if dB else 1.0], [right, 0.0 if dB else 1.0]])])
    if limit is not None:
        places.avoid([np.column_stack([np.clip(limit[0] * HZ, left, right), gains(limit[1], dB=dB)])])
    written: list[float] = []
    for k, level in enumerate(levels):
        if not np.isfinite(level).any():
            continue
        at = int(np.nanargmax(level))
        colour = curve_style(k)["color"]
        panel.plot([w[at] * HZ], [level[at]], "o", color=colour, markersize=4.0, zorder=4)
        number = f"{plain(level[at], 3)} dB" if dB else plain(level[at], 3)
        text = f"{number} at {plain(w[at] * HZ, 3)} Hz"
        # At the plant's input and output it is often the same.
        if any(abs(level[at] - other) <= 2e-3 * abs(other) for other in written):
            continue
        written.append(float(level[at]))
        places.write(text, w[at] * HZ, level[at], colour=colour, bold=True, required=k == 0)
