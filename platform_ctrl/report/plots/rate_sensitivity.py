"""From the platform's rate to the gimbal angles, without control and with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import named_system
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.poles import is_stable
from platform_ctrl.analysis.transfer_function import LinearSystem
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import greek
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.platform import OMEGA_NAMES, is_rate
from platform_ctrl.report.plots.bode import chosen
from platform_ctrl.report.plots.curves import entry_curves
from platform_ctrl.report.plots.frequency_grid import grid
from platform_ctrl.report.plots.panels import (
    blocks,
    bound,
    draw,
    frequency_panels,
    gain_label,
    gain_panel,
    gains,
    legend,
    line_array,
    no_response,
    shade,
)
from platform_ctrl.report.plots.systems import DrawnSystem, as_state_space, drawable, drawn_systems
from platform_ctrl.report.style import REFERENCE, standalone

if TYPE_CHECKING:
    import control


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
        they see it, `analysis.sampled`; the rate is then held from sample to sample.
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
    import control

    name = "Omega_sensitivity"
    level = bound(f"{name}: limit", limit)
    [P] = drawn_systems(f"{name}: plant", plant, data=False)
    rate_names = [one for one in P.inputs if one in OMEGA_NAMES]
    if not rate_names:
        raise ArgumentError(
            f"{name}: plant: its inputs are {', '.join(P.inputs[:6])}; expected {', '.join(OMEGA_NAMES)} among them, "
            "as platform_ctrl.state_space(model) has them"
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
    curves = [entry_curves(one, every, [[""] * len(rate_names)] * len(outputs)) for one in drawn]
    known = [[[bool(np.isfinite(c.response).any()) for c in row] for row in one] for one in curves]
    moves = np.logical_or.reduce(np.array(known), axis=0)
    if angles is None:
        rows = [i for i in rows if moves[i, columns].any()] or rows
    if rates is None:
        columns = [j for j in columns if moves[rows, j].any()] or columns
    names = ["without control"]
    for K, loop in zip(given, loops, strict=True):
        names.append((K.label or "controlled") + ("" if is_stable(loop) else ", not stable"))
    figure, axes = blocks(len(rows), len(columns), (1.75 if len(rows) > 1 else 2.6,), names)
    lines = line_array(axes)
    for r, i in enumerate(rows):
        for c, j in enumerate(columns):
            panel = axes[r, c]
            own = [one[i][j] for one in curves]
            for k, one in enumerate(own):
                style = {"color": REFERENCE, "linestyle": "-", "linewidth": 1.3} if k == 0 else {}
                line = draw(panel, one.frequency, gains(one.response, dB=dB), max(k - 1, 0), **style)
                lines[r, c].append(line)
            ends = [one.frequency[k] for one in own for k in (0, -1) if len(one.frequency)]
            frequency_panels([panel], min(ends), max(ends), drawn)
            levels = [] if level is None else [2.0 * float(g) for g in level[1]]
            shown = [(one.system, one.frequency, np.abs(one.response)) for one in own]
            gain_panel(panel, shown, dB=dB, more=levels)
            if any(np.isfinite(one.response).any() for one in own):
                shade(panel, level, dB=dB)
            else:
                no_response(panel)
            panel.set_title(f"{drawable(greek(rate_names[j]))} to {drawable(greek(outputs[i]))}")
            if r < len(rows) - 1:
                panel.set_xlabel("")
            if c == 0:
                panel.set_ylabel(gain_label("gain", "rad per rad/s", dB))
    return control.ControlPlot(lines, axes, figure, legend=legend(figure, lines[0, 0], names))


def _joinable(K: DrawnSystem, torquers: Sequence[str], angles: Sequence[str]) -> control.StateSpace:
    """Return a controller under the plant's names where it has none of them: products of systems lose theirs."""
    known = set(K.outputs) <= set(torquers) and set(K.inputs) <= set(angles)
    if known or K.arrays is None or K.shape != (len(torquers), len(angles)):
        return as_state_space("Omega_sensitivity: controllers", K)
    return named_system(K.arrays, angles, torquers)
