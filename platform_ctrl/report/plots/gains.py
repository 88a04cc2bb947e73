"""Gains over frequency: singular values, the gang of four S, T, P S and K S, and platform rate to angles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, named_system
from platform_ctrl.analysis.feedback import Gang, closed_loop, gang
from platform_ctrl.analysis.poles import is_stable
from platform_ctrl.analysis.response import LinearSystem
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, plain
from platform_ctrl.plant.platform import OMEGA_NAMES, is_rate
from platform_ctrl.report.plots.bode import chosen
from platform_ctrl.report.plots.curves import entry_curves
from platform_ctrl.report.plots.label_placement import LabelPlacer, points_of
from platform_ctrl.report.plots.panels import (
    GainCurve,
    Level,
    bound,
    control_plot,
    curve_style,
    gain_curves,
    gain_label,
    gains,
)
from platform_ctrl.report.plots.systems import (
    DrawnSystem,
    as_state_space,
    drawable,
    drawn_systems,
    grid,
    ratio_unit,
    shared_unit,
    unit,
)
from platform_ctrl.report.style import REFERENCE, panels, standalone

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
    """Draw the singular values of systems: the largest of each as a thick line, the others thin in its colour.

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
    above, below = bound("singular_values: upper", upper), bound("singular_values: lower", lower)
    drawn = drawn_systems("singular_values", systems, labels)
    every = grid(drawn, frequency, name="singular_values")
    # One without a name needs no legend.
    names = [one.label or "largest and smallest gain" for one in drawn] if len(drawn) > 1 or drawn[0].label else []
    curves = []
    for k, one in enumerate(drawn):
        w, response = one.along(every)
        looks: list[dict[str, Any]] = [
            {"linewidth": 1.7},
            *[{"linewidth": 0.9, "marker": "", "alpha": 0.85}] * (min(one.shape) - 1),
        ]
        curves += [GainCurve(one, w, row, k, look) for row, look in zip(singular(response), looks, strict=True)]
    _, axes = panels(1, 1, 3.4, names, titles=False)
    lines = gain_curves(axes[0, 0], curves, dB=dB, upper=above, lower=below)
    axes[0, 0].set_ylabel(gain_label("singular values", shared_unit(drawn), dB))
    first = np.cumsum([0, *(min(one.shape) for one in drawn)])[:-1]
    return control_plot(axes, [lines], [lines[k] for k in first][: len(names)], names)


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
    """The closed loop of a controller."""

    label: str
    loop: DrawnSystem
    stable: bool
    gang: Gang


@check_arguments
@standalone
def gang_of_four(  # noqa: PLR0913 - options by keyword
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
    _, axes = panels(2, 2, 2.0, names)
    units, titles = _units(closed[0].loop, closed[0].gang)
    lines = []
    for n, panel in enumerate(axes.flat):
        rows = [(one.loop, row) for one in closed for row in _curves(one, several, sides)[n]]
        curves = [GainCurve(loop, every, row, k) for k, (loop, row) in enumerate(rows)]
        lines.append(gain_curves(panel, curves, dB=dB, upper=limits[n], unity=n < 2))
        panel.set_title(titles[n])
        panel.set_ylabel(gain_label("gain", units[n], dB))
        if n < 2 and len(rows) <= 3:
            _peaks(panel, lines[-1], dB, limits[n])
    return control_plot(axes, lines, lines[0][: len(names)], names)


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
        raise ArgumentError(f"gang_of_four: frequency must reach below the Nyquist frequency, {top:.6g} rad/s")
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
    """Return units and titles: those of angles and torques if the signals have such names."""
    p, m = g.angle_per_torque.shape[:2]
    torques = {unit(name) for name in loop.outputs[:m]}
    angles = {unit(name.removeprefix("noise_")) for name in loop.inputs[-p:]}
    if len(torques) != 1 or len(angles) != 1 or "" in torques | angles:
        return ["", "", "", ""], list(_TITLES)
    torque, angle = torques.pop(), angles.pop()
    named = torque == "N m" and angle == "rad"
    titles = [special if named and special else plain_ for plain_, special in zip(_TITLES, _NAMED, strict=True)]
    return ["", "", ratio_unit(angle, torque), ratio_unit(torque, angle)], titles


def _peaks(panel: Axes, lines: Sequence[Line2D], dB: bool, limit: Level) -> None:
    """Mark the peak of each curve, and write it."""
    places = LabelPlacer(panel, lines)
    left, right = panel.get_xlim()
    places.avoid([np.array([[left, 0.0 if dB else 1.0], [right, 0.0 if dB else 1.0]])])
    if limit is not None:
        places.avoid([np.column_stack([np.clip(limit[0] * HZ, left, right), gains(limit[1], dB=dB)])])
    written: list[float] = []
    for k, line in enumerate(lines):
        f, level = points_of(line).T
        if not np.isfinite(level).any():
            continue
        at = int(np.nanargmax(level))
        colour = curve_style(k)["color"]
        panel.plot([f[at]], [level[at]], "o", color=colour, markersize=4.0, zorder=4)
        # At the plant's input and output it is often the same.
        if any(abs(level[at] - other) <= 2e-3 * abs(other) for other in written):
            continue
        written.append(float(level[at]))
        text = f"{plain(level[at], 3)}{' dB' if dB else ''} at {plain(f[at], 3)} Hz"
        places.write(text, f[at], level[at], colour=colour, bold=True, required=k == 0)


@check_arguments
@standalone
def Omega_sensitivity(
    plant: LinearSystem,
    controllers: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem] | None = None,
    *,
    frequency: ArrayLike | None = None,
    labels: Sequence[str] | None = None,
    angles: Sequence[str | int] | None = None,
    rates: Sequence[str | int] | None = None,
    limit: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    dB: bool = False,
) -> control.ControlPlot:
    """Draw how much the gimbal angles move per platform rate Omega, without control and with each controller closed.

    Parameters
    ----------
    plant
        From `state_space`: inputs torquers and Omega1 to Omega3, outputs angles. For sampled controllers the plant as
        they see it, `analysis.sampled`; the rate is then constant from sample to sample.
    controllers
        u = K y without a hidden sign, joined to the plant by signal names, or by position where it has others and as
        many as there are torquers and angles. One, several in a sequence, a mapping from labels, or none.
    frequency : (N,) or (2,), optional
        rad/s: the frequencies themselves, or two numbers as the ends of a range; default wherever poles and zeros are.
    labels
        One for each controller; default their names.
    angles, rates
        Names or numbers of the plant's outputs and of its rates that are drawn; default all angles that a rate moves,
        and all rates that move one.
    limit : scalar, or a pair of (N,)
        What the gain must not exceed, shaded above: a number, rad per rad/s, or a pair (frequencies in rad/s, levels).
    dB
        Whether gains are in decibels; the limit is given as a plain number all the same.

    Returns
    -------
    control.ControlPlot
        ``axes`` (angles, rates); ``lines`` in each: without control, then each controller.

    Raises
    ------
    ArgumentError
        The plant has no rate among its inputs, plant and controllers do not fit together, unknown angles or rates,
        frequencies that are not ascending and positive, or a limit that is not.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).
    """
    name = "Omega_sensitivity"
    level = bound(f"{name}: limit", limit)
    [P] = drawn_systems(f"{name}: plant", plant, data=False)
    rate_names = [one for one in P.inputs if one in OMEGA_NAMES]
    if not rate_names:
        raise ArgumentError(
            f"{name}: the plant needs {', '.join(OMEGA_NAMES)} among its inputs, got {', '.join(P.inputs[:6])}; "
            "platform_ctrl.state_space(model) has them"
        )
    given = [] if controllers is None else list(drawn_systems(f"{name}: controllers", controllers, labels, data=False))
    # Among the plant's outputs a rate of the platform itself is no angle.
    outputs = [one for one in P.outputs if not is_rate(one)]
    whole = as_state_space(f"{name}: plant", P)
    torquers = [one for one in P.inputs if one not in rate_names]
    loops = [closed_loop(whole, _joinable(K, torquers, outputs)) for K in given]
    systems = [whole[outputs, rate_names], *(loop[outputs, rate_names] for loop in loops)]
    drawn = list(drawn_systems(name, systems, ["without control", *(K.label for K in given)]))
    every = grid(drawn, frequency, name=name)
    rows, columns = chosen(f"{name}: angles", angles, outputs), chosen(f"{name}: rates", rates, rate_names)
    entries = [entry_curves(one, every, [[""] * len(rate_names)] * len(outputs)) for one in drawn]
    known = [[[bool(np.isfinite(c.response).any()) for c in row] for row in one] for one in entries]
    moves = np.logical_or.reduce(np.array(known), axis=0)
    if angles is None:
        rows = [i for i in rows if moves[i, columns].any()] or rows
    if rates is None:
        columns = [j for j in columns if moves[rows, j].any()] or columns
    names = ["without control"]
    for K, loop in zip(given, loops, strict=True):
        names.append((K.label or "controlled") + ("" if is_stable(loop) else ", not stable"))
    _, axes = panels(len(rows), len(columns), 1.75 if len(rows) > 1 else 2.6, names)
    lines = []
    uncontrolled = {"color": REFERENCE, "linestyle": "-", "linewidth": 1.3}
    for panel, (i, j) in zip(axes.flat, itertools.product(rows, columns), strict=True):
        curves = [
            GainCurve(one.system, one.frequency, np.abs(one.response), max(k - 1, 0), {} if k else uncontrolled)
            for k, one in enumerate(entry[i][j] for entry in entries)
        ]
        lines.append(gain_curves(panel, curves, dB=dB, upper=level))
        panel.set_title(f"{drawable(greek(rate_names[j]))} to {drawable(greek(outputs[i]))}")
        if i != rows[-1]:
            panel.set_xlabel("")
        if j == columns[0]:
            panel.set_ylabel(gain_label("gain", "rad per rad/s", dB))
    return control_plot(axes, lines, lines[0], names)


def _joinable(K: DrawnSystem, torquers: Sequence[str], angles: Sequence[str]) -> control.StateSpace:
    """Return a controller under the plant's names where it has none of them: products of systems lose theirs."""
    known = set(K.outputs) <= set(torquers) and set(K.inputs) <= set(angles)
    if known or K.arrays is None or K.shape != (len(torquers), len(angles)):
        return as_state_space("Omega_sensitivity: controllers", K)
    return named_system(K.arrays, angles, torquers)
