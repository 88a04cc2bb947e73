"""Singular values over frequency: the largest and smallest gain of a system with several inputs and outputs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.rational import LinearSystem
from platform_ctrl.frozen import FloatArray
from platform_ctrl.report.plots.frequencies import grid
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
    shade,
)
from platform_ctrl.report.plots.systems import drawn_systems, unit_of_gain
from platform_ctrl.report.style import standalone
from platform_ctrl.signatures import check_arguments

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
