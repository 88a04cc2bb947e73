"""Bode plots: loops with their margins, plants entry by entry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from platform_ctrl.analysis.response import LinearSystem
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.text import greek
from platform_ctrl.common.values import value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import HZ, plain
from platform_ctrl.report.plots.curves import Curve, Margins, channels, curve, entry_curves
from platform_ctrl.report.plots.curves import margins as margins_of
from platform_ctrl.report.plots.label_placement import LabelPlacer
from platform_ctrl.report.plots.panels import (
    GainCurve,
    control_plot,
    draw,
    gain_curves,
    gain_label,
    phase_panel,
)
from platform_ctrl.report.plots.systems import DrawnSystem, drawable, drawn_systems, grid, shared_unit, unit_of_gain
from platform_ctrl.report.style import SERIES, panels, standalone

if TYPE_CHECKING:
    import control

# Curves in one panel up to which every margin is written where it is; beyond that in the legend.
_WRITTEN = 4
_COLUMNS = 4


@value
class _Block:
    """A gain panel and the phase panel below it."""

    title: str
    curves: tuple[Curve, ...]


@check_arguments
@standalone
def bode(
    systems: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    *,
    frequency: ArrayLike | None = None,
    labels: Sequence[str] | None = None,
    margins: bool = True,
    loops: bool | None = None,
    outputs: Sequence[str | int] | None = None,
    inputs: Sequence[str | int] | None = None,
    dB: bool = False,
) -> control.ControlPlot:
    """Draw gain and phase of loops with their margins, or of plants entry by entry.

    A loop is drawn channel by channel, each broken with all others closed (1/S_ii − 1); every crossover is marked, with
    the phase margin where the gain is 1 and the gain margin where the phase is −180°. The legend names the disk margin.
    Poles of any damping have their shape; at one without damping the gain runs out of the panel and the phase falls by
    180°, at a zero without damping it rises.

    Parameters
    ----------
    systems
        `control.StateSpace`, `TransferFunction` or `FrequencyResponseData`, continuous or sampled; several in a
        sequence, or a mapping from labels. Loops are loop transfers with negative feedback, such as
        `analysis.loop_transfer` returns.
    frequency : (N,) or (2,), optional
        rad/s: the frequencies themselves, or two numbers as the ends of a range. Default: wherever poles and zeros are;
        for sampled systems up to the Nyquist frequency, which is marked. Data have their own.
    labels
        One for each system; default their names.
    margins
        Whether margins are marked and named; of loops only.
    loops
        Whether the systems are loop transfers. Default: square ones whose inputs and outputs have the same names,
        and those with one input and one output whose names have no different units.
    outputs, inputs
        Names or numbers of the entries that are drawn of plants; default all.
    dB
        Whether gains are in decibels.

    Returns
    -------
    control.ControlPlot
        ``axes`` (2 × rows, columns): gain panels above their phase panels; ``lines`` the curves in each.

    Raises
    ------
    ArgumentError
        No system, another type, unknown outputs or inputs, loops that are not square or cannot be closed, or
        frequencies that are not ascending and positive.

    References
    ----------
    K. J. Åström, R. M. Murray, Feedback Systems, 2008, ch. 9.

    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """
    drawn = drawn_systems("bode", systems, labels, square=loops is True)
    as_loops = all(_is_loop(one) for one in drawn) if loops is None else loops
    if as_loops and (outputs is not None or inputs is not None):
        as_loops = False
        if loops:
            raise ArgumentError("bode: outputs and inputs choose entries of plants; leave them out with loops=True")
    rows = _loop_blocks(drawn, frequency) if as_loops else _entry_blocks(drawn, frequency, outputs, inputs)
    every = [block for row in rows for block in row]
    measured = {id(one): margins_of(one) for block in every for one in block.curves if as_loops and margins}
    written = max(len(block.curves) for block in every) <= _WRITTEN and len(every) <= 2 * _COLUMNS
    names = {
        id(one): _with(one.label, "" if len(every) > 1 else _words(measured.get(id(one)), written))
        for block in every
        for one in block.curves
    }
    together = list(dict.fromkeys(name for name in names.values() if name))
    tall = (2.3, 1.8) if len(rows) == 1 else (1.5, 1.15)
    _, axes = panels(len(rows), len(rows[0]), tall, together, titles=any(block.title for block in every))
    lines: dict[tuple[int, int], list[Any]] = {at: [] for at in np.ndindex(axes.shape)}
    handles: dict[str, Any] = {}
    for i, row in enumerate(rows):
        for j, block in enumerate(row):
            pair = axes[2 * i, j], axes[2 * i + 1, j]
            lines[2 * i, j], lines[2 * i + 1, j] = _draw_block(pair, block, dB, as_loops)
            for one, line in zip(block.curves, lines[2 * i, j], strict=True):
                handles.setdefault(names[id(one)], line)
            if measured:
                _mark(pair, block, dB, measured, written)
            if j == 0 or (not as_loops and not dB):
                pair[0].set_ylabel(gain_label("gain", shared_unit([one.system for one in block.curves]), dB))
            if len(every) > 1 and measured:
                _corner(pair[0], [_words(measured[id(one)], written) for one in block.curves])
            if j == 0:
                pair[1].set_ylabel("phase, degrees")
    for unused in axes[-2:, len(rows[-1]) :].flat:
        unused.set_visible(False)
    return control_plot(axes, list(lines.values()), [handles[name] for name in together], together)


def _is_loop(one: DrawnSystem) -> bool:
    if one.shape == (1, 1):
        return unit_of_gain(one) in ("", "1")
    return one.inputs == one.outputs


def _loop_blocks(drawn: Sequence[DrawnSystem], frequency: ArrayLike | None) -> list[list[_Block]]:
    if len({one.shape for one in drawn}) != 1:
        numbers = sorted({len(one.inputs) for one in drawn})
        raise ArgumentError(f"bode: the loops have different numbers of channels, {numbers}; draw them one by one")
    own = [channels("bode", one) for one in drawn]
    every = grid([one for part in own for one in part], frequency, name="bode", loops=True)
    names = [drawable(greek(name)) for name in drawn[0].inputs]
    if len(names) == 1:
        curves = [curve(part[0], every, one.label or "L") for one, part in zip(drawn, own, strict=True)]
        return [[_Block(title="", curves=tuple(curves))]]
    if len(drawn) == 1:
        curves = [curve(part, every, f"at {name}") for name, part in zip(names, own[0], strict=True)]
        title = "broken at one channel, the others closed"
        return [[_Block(title=title, curves=tuple(curves))]]
    out = []
    for k, name in enumerate(names):
        curves = [curve(part[k], every, one.label) for one, part in zip(drawn, own, strict=True)]
        title = f"broken at {name}, the others closed" if len(names) < 4 else f"at {name}, others closed"
        out.append(_Block(title=title, curves=tuple(curves)))
    return [out[k : k + _COLUMNS] for k in range(0, len(out), _COLUMNS)]


def _entry_blocks(
    drawn: Sequence[DrawnSystem],
    frequency: ArrayLike | None,
    outputs: Sequence[str | int] | None,
    inputs: Sequence[str | int] | None,
) -> list[list[_Block]]:
    if len({one.shape for one in drawn}) != 1:
        shapes = ", ".join(sorted({"{} × {}".format(*one.shape) for one in drawn}))
        raise ArgumentError(f"bode: the systems have different shapes, {shapes} outputs × inputs; draw them one by one")
    rows = chosen("bode: outputs", outputs, drawn[0].outputs)
    columns = chosen("bode: inputs", inputs, drawn[0].inputs)
    every = grid(drawn, frequency, name="bode")
    to, of = ([drawable(greek(name)) for name in names] for names in (drawn[0].outputs, drawn[0].inputs))
    alone = len(rows) == 1
    if len(drawn) == 1:
        # One panel an input, one curve an output.
        words = ["" if alone else f"to {name}" for name in to]
        [own] = [entry_curves(drawn[0], every, [[word] * len(of) for word in words])]
        out = [
            _Block(
                title=f"from {of[column]}" + (f" to {to[rows[0]]}" if alone else ""),
                curves=tuple(own[row][column] for row in rows),
            )
            for column in columns
        ]
        return [out[k : k + _COLUMNS] for k in range(0, len(out), _COLUMNS)]
    parts = [entry_curves(one, every, [[one.label] * len(of)] * len(to)) for one in drawn]
    return [
        [
            _Block(
                title=f"from {of[column]} to {to[row]}",
                curves=tuple(part[row][column] for part in parts),
            )
            for column in columns
        ]
        for row in rows
    ]


def chosen(name: str, given: Sequence[str | int] | str | int | None, known: Sequence[str]) -> list[int]:
    """Return the numbers of signals that are named or numbered, in the order given; default all."""
    if given is None:
        return list(range(len(known)))
    out = []
    for one in [given] if isinstance(given, str | int) else given:
        if isinstance(one, str):
            out.append(known_name(name, one, known))
        elif isinstance(one, int | np.integer) and not isinstance(one, bool) and 0 <= one < len(known):
            out.append(int(one))
        else:
            raise ArgumentError(f"{name} must be names, or numbers below {len(known)}, got {short(one)}")
    if not out:
        raise ArgumentError(f"{name} must be at least one, got none")
    return out


def _draw_block(pair: tuple[Axes, Axes], block: _Block, dB: bool, as_loops: bool) -> tuple[list[Any], list[Any]]:
    above, below = pair
    above.set_title(block.title)
    curves = [GainCurve(one.system, one.frequency, np.abs(one.response), k) for k, one in enumerate(block.curves)]
    upper = gain_curves(above, curves, dB=dB, below=[below], unity=as_loops)
    lower = [draw(below, one.frequency, one.phase, k) for k, one in enumerate(block.curves)]
    phase_panel(below, [one.phase for one in block.curves], critical=as_loops)
    return upper, lower


def _mark(pair: tuple[Axes, Axes], block: _Block, dB: bool, measured: Mapping[int, Margins], written: bool) -> None:
    """Mark the margins of the curves of a block, and write them."""
    above, below = pair
    unity = 0.0 if dB else 1.0
    places = []
    for axes, level in zip(pair, (unity, -180.0), strict=True):
        places.append(LabelPlacer(axes, axes.get_lines()))
        places[-1].avoid([np.column_stack([axes.get_xlim(), [level, level]])])
    # Small margins are written first: they find the best places.
    notes: list[tuple[float, LabelPlacer, str, float, float, str]] = []
    for k, one in enumerate(block.curves):
        found, colour = measured[id(one)], SERIES[k % len(SERIES)]
        dot: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 4.2, "linestyle": "none", "zorder": 4}
        bar: dict[str, Any] = {"color": colour, "linewidth": 2.6, "alpha": 0.55, "zorder": 2.5}
        bar["solid_capstyle"] = "butt"
        for w, margin in zip(found.gain_crossovers, found.phase_margins, strict=True):
            phase = float(np.interp(w, one.frequency, one.phase))
            # The margin's own −180°, on whichever turn the curve is.
            level = 360.0 * round((phase - margin + 180.0) / 360.0) - 180.0
            below.plot([w * HZ] * 2, [level, level + margin], **bar)
            below.plot([w * HZ], [level + margin], **dot)
            above.plot([w * HZ], [unity], **dot | {"markersize": 2.8})
            text = f"{degrees_words(margin)} at {plain(w * HZ, 3)} Hz"
            notes.append((abs(margin) / 60.0, places[1], text, w * HZ, level + margin, colour))
        shown = {nearest[1] for nearest in (found.lowest_gain, found.highest_gain) if nearest is not None}
        for w, factor in zip(found.phase_crossovers, found.gain_margins, strict=True):
            gain = -20.0 * np.log10(factor) if dB else 1.0 / factor
            if w in shown:
                above.plot([w * HZ] * 2, [gain, unity], **bar)
                above.plot([w * HZ], [gain], **dot)
                text = f"{gain_words(factor, dB)} at {plain(w * HZ, 3)} Hz"
                notes.append((abs(np.log2(factor)), places[0], text, w * HZ, gain, colour))
            else:
                above.plot([w * HZ], [gain], **dot | {"markersize": 2.8, "markerfacecolor": "none"})
    if written:
        for _, place, _, x, y, _ in notes:
            place.reserve(x, y)
        for rank, (_, place, text, x, y, colour) in enumerate(sorted(notes, key=lambda note: note[0])):
            place.write(text, x, y, colour=colour, bold=True, required=rank < 2)


def degrees_words(angle: float) -> str:
    """Return a phase margin in words, whole degrees above 10."""
    text = f"{angle:.0f}" if abs(angle) >= 9.95 else f"{angle:.1f}"
    return ("0" if float(text) == 0.0 else text.replace("-", "−")) + "°"


def gain_words(factor: float, dB: bool = False) -> str:
    """Return a gain margin in words: a factor, or decibels."""
    if dB:
        return f"{20.0 * np.log10(factor):+.1f} dB".replace("-", "−")
    return f"× {plain(factor, 3 if factor >= 9.95 else 2)}"


def _with(label: str, words: str) -> str:
    return f"{label}: {words}" if label and words else label or words


def _corner(axes: Axes, words: Sequence[str]) -> None:
    """Write the margins into the lower left corner, where loops do not go."""
    lines = [(word, k) for k, word in enumerate(words) if word]
    for rank, (word, k) in enumerate(reversed(lines)):
        axes.annotate(
            word,
            (0.0, 0.0),
            (4, 4 + 9.5 * rank),
            xycoords="axes fraction",
            textcoords="offset points",
            fontsize=7,
            color=SERIES[k % len(SERIES)],
        )


def _words(found: Margins | None, written: bool) -> str:
    """Return words about margins: the disk margin, and the others where there is no room for them."""
    if found is None:
        return ""
    words = []
    if found.stable is False:
        words.append("closed loop not stable")
    if not written:
        smallest = found.phase_margin
        words += [degrees_words(smallest[0])] if smallest else []
        words += [gain_words(one[0]) for one in (found.lowest_gain, found.highest_gain) if one is not None]
    if found.disk is not None and found.stable is not False:
        at = f" at {plain(found.disk.frequency * HZ, 3)} Hz" if np.isfinite(found.disk.frequency) and written else ""
        words.append(f"disk margin {plain(found.disk.alpha, 2, 'down')}{at}" if np.isfinite(found.disk.alpha) else "")
    return ", ".join(word for word in words if word)
