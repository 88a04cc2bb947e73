"""Which input drives which requirement: estimated from the runs there are, none are flown for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.campaign.influence import Influence, influences
from platform_ctrl.campaign.statistics import Limits, limits_of
from platform_ctrl.campaign.table import (
    ENDED,
    FIGURES,
    MANOEUVRE,
    NOT_FLOWN,
    PASSED,
    RUN,
    Array,
    Table,
    batches,
    codes,
    column_names,
    input_names,
)
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.signatures import check_arguments

# Runs that are looked at: the first ones of the campaign, in whatever order the table has them.
MOST_RUNS = 1 << 16
# Fewer violations than this say nothing about what causes them.
_FEWEST_EVENTS = 5
_FEWEST_RUNS = 16
# Where a hundredth of the runs has this share of the variance, the figure's ranks stand for it: what drives a few runs
# to a hundred times the limit says nothing of the others, and is seen in whether they violate anything.
_TAIL, _TAIL_SHARE = 0.01, 0.5


@value
class Sensitivity:
    """What drives one requirement.

    Attributes
    ----------
    figure
        Name of the limit, or ``"passed"``: whether a run violates anything at all.
    manoeuvre
        Within this manoeuvre alone; None: over all, where the manoeuvre is an input like the others.
    runs
        How many were looked at.
    ranked
        Whether the figure's ranks stand for it, because some runs diverged or a few have most of its variance.
    influences
        All inputs, the strongest first.
    violations
        Likewise on whether this limit is violated; empty where fewer than five runs do, or do not. What sends a few
        runs beyond the limit may be nothing to the others.

    References
    ----------
    As `influences`.
    """

    figure: str
    manoeuvre: str | None
    runs: int
    ranked: bool
    influences: tuple[Influence, ...]
    violations: tuple[Influence, ...] = ()


@check_arguments
def sensitivities(table: Table, limits: Limits, *, inputs: Sequence[str] | None = None) -> tuple[Sensitivity, ...]:
    """Return what drives each requirement, over all manoeuvres and within each.

    Over manoeuvres that ask different things a figure counts relative to its limit. The first 65,536 runs are looked
    at, so that the memory needed does not grow with a campaign.

    Parameters
    ----------
    table, limits
        As for `statistics`.
    inputs
        Columns that are inputs; default: all that are no outcome.

    Returns
    -------
    tuple of Sensitivity
        Every requirement over all manoeuvres, then within each.

    Raises
    ------
    ArgumentError
        A column is missing.
    InputError
        The files cannot be read.

    References
    ----------
    I. M. Sobol, Mathematics and Computers in Simulation 55, 2001.

    See docs/campaign.md.
    """
    names = tuple(input_names(table) if inputs is None else inputs)
    data = _first_runs(table, names)
    known: dict[str, int] = {}
    place = codes(data[MANOEUVRE], known)
    columns = {name: data[name] for name in names}
    found = []
    for manoeuvre in (
        None,
        *sorted(known, key=lambda name: list(limits).index(name) if name in limits else len(limits)),
    ):
        chosen = np.ones(len(place), dtype=bool) if manoeuvre is None else place == known[manoeuvre]
        if manoeuvre is not None and len(known) == 1:
            continue  # the same as over all
        for figure in (*FIGURES, PASSED):
            if figure not in data:
                continue
            output, asked = _output(data, figure, manoeuvre, known, place, limits)
            rows = chosen & asked
            given = {
                name: column[rows]
                for name, column in columns.items()
                if not (manoeuvre is not None and name == MANOEUVRE)
            }
            one = _sensitivity(figure, manoeuvre, given, output[rows])
            if one is not None:
                found.append(one)
    return tuple(found)


def _first_runs(table: Table, names: Sequence[str]) -> dict[str, Array]:
    present = column_names(table)
    figures = [name for name in FIGURES if name in present]
    wanted = tuple(dict.fromkeys((RUN, MANOEUVRE, *names, *figures, PASSED, ENDED)))
    pieces: list[dict[str, Array]] = []
    for batch in batches(table, wanted):
        rows = batch[RUN] < MOST_RUNS
        rows &= np.fromiter((not str(one).startswith(NOT_FLOWN) for one in batch[ENDED]), bool, len(rows))
        if rows.any():
            pieces.append({name: column[rows] for name, column in batch.items()})
    if not pieces:
        return {name: np.zeros(0) for name in wanted}
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in wanted}


def _output(
    data: Mapping[str, Array],
    figure: str,
    manoeuvre: str | None,
    known: Mapping[str, int],
    place: NDArray[np.intp],
    limits: Limits,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return what the inputs act on, and where it is asked for."""
    if figure == PASSED:
        return (data[PASSED] == 0).astype(np.float64), np.asarray(data[PASSED] >= 0)
    bounds = limits_of(known, figure, limits)[place] if known else np.zeros(0)
    asked = ~np.isnan(bounds)
    return data[figure] / np.where(asked, bounds, 1.0), asked


def _sensitivity(
    figure: str, manoeuvre: str | None, inputs: Mapping[str, Array], output: FloatArray
) -> Sensitivity | None:
    """Return None where the runs are too few, or all the same."""
    violating = output > (0.0 if figure == PASSED else 1.0)
    telling = min(violating.sum(), len(output) - violating.sum()) >= _FEWEST_EVENTS
    if len(output) < _FEWEST_RUNS or (figure == PASSED and not telling) or (output == output[0]).all():
        return None
    from scipy import stats

    ranked = figure != PASSED and _far_out(output)
    used = stats.rankdata(np.where(np.isfinite(output), output, np.inf)) if ranked else output
    found = influences(inputs, used)
    return Sensitivity(
        figure=figure,
        manoeuvre=manoeuvre,
        runs=len(output),
        ranked=ranked,
        influences=found,
        violations=influences(inputs, violating) if telling and figure != PASSED else (),
    )


def _far_out(output: FloatArray) -> bool:
    """Whether some of the runs diverged, or a few have most of the variance."""
    if not np.isfinite(output).all():
        return True
    square = np.sort((output - output.mean()) ** 2)
    return bool(square[-max(round(_TAIL * len(square)), 1) :].sum() > _TAIL_SHARE * square.sum())
