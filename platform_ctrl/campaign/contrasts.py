"""How often a requirement is violated with a fault, a manoeuvre or a chosen value, and how often without it.

Shares of variance do not see a rare cause: a fault in one run of fifty has hardly any share of a metric's variance,
even where every violating run has it. Counting does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.campaign.probability import CONFIDENCE, Probability, clopper_pearson
from platform_ctrl.campaign.sensitivity import SIGNIFICANCE, holm
from platform_ctrl.campaign.table import (
    ENDED,
    MANOEUVRE,
    NOT_SIMULATED,
    PASSED,
    Array,
    Table,
    batches,
    column_names,
    input_names,
)
from platform_ctrl.campaign.table_statistics import Limits
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value

# A number with more values than this, or with about one for each run, is no choice among a few.
_MOST_LEVELS = 12

Level = bool | float | str
# Asked and violated, by metric and manoeuvre.
_Counts = dict[tuple[str, str], tuple[int, int]]


@value
class Contrast:
    """How often a requirement is violated with one value of an input, and how often with its other values.

    Attributes
    ----------
    requirement
        Name of the limit, or ``"passed"``: whether a run violates anything at all.
    manoeuvre
        Within this manoeuvre alone; None: over all.
    parameter, level
        Name of the input, and the value: True for a fault that happens, a manoeuvre's name, one of a few numbers.
    present, absent
        Violations among the runs with this value, and among the others.
    p_value
        Probability that a value without influence looks like this (Fisher's exact test, two-sided), all values of all
        such inputs for this metric and manoeuvre together (Holm).
    """

    requirement: str
    manoeuvre: str | None
    parameter: str
    level: Level
    present: Probability
    absent: Probability
    p_value: float

    @property
    def driver(self) -> bool:
        """Whether chance alone is no explanation."""
        return bool(self.p_value < SIGNIFICANCE)

    @property
    def in_every_violation(self) -> bool:
        """Whether there are violations, and none without this value."""
        return self.present.events > 0 and self.absent.events == 0


@check_arguments
def contrasts(
    table: Table, limits: Limits, *, inputs: Sequence[str] | None = None, confidence: float = CONFIDENCE
) -> tuple[Contrast, ...]:
    """Return how often each requirement is violated with and without every value of the inputs that have few.

    All runs that were simulated are counted, a chunk of the table at a time.

    Parameters
    ----------
    table, limits
        As for `statistics`; only the order of the manoeuvres matters here.
    inputs
        Columns that are inputs; default: all that are no outcome.
    confidence
        Probability of the two-sided Clopper-Pearson bounds.

    Returns
    -------
    tuple of Contrast
        Every requirement over all manoeuvres, then within each; the least p-value first.

    Raises
    ------
    ArgumentError
        A column is missing.
    InputError
        The files cannot be read.

    References
    ----------
    R. A. Fisher, Journal of the Royal Statistical Society 85, 1922.

    C. J. Clopper, E. S. Pearson, Biometrika 26, 1934.

    S. Holm, Scandinavian Journal of Statistics 6, 1979.
    """
    names = tuple(input_names(table) if inputs is None else inputs)
    counts, simulated = _counted(table, names)
    discrete = {
        name: levels
        for name, levels in counts.items()
        if not any(isinstance(level, float) for level in levels) or len(levels) <= min(_MOST_LEVELS, simulated // 2)
    }
    named = {manoeuvre for levels in discrete.values() for one in levels.values() for _, manoeuvre in one}
    ordered = sorted(named, key=lambda name: (list(limits).index(name) if name in limits else len(limits), name))
    out: list[Contrast] = []
    for manoeuvre in (None, *(ordered if len(ordered) > 1 else ())):
        for requirement in (*RUN_METRICS, PASSED):
            out += _of_one(requirement, manoeuvre, discrete, confidence)
    return tuple(out)


def _counted(table: Table, names: Sequence[str]) -> tuple[dict[str, dict[Level, _Counts]], int]:
    """Return asked and violated by input, value, metric and manoeuvre, and how many runs were simulated."""
    present = column_names(table)
    answers = {
        requirement: f"{requirement}_passed" for requirement in RUN_METRICS if f"{requirement}_passed" in present
    } | {PASSED: PASSED}
    counts: dict[str, dict[Level, _Counts]] = {name: {} for name in names}
    simulated = 0
    for batch in batches(table, tuple(dict.fromkeys((MANOEUVRE, *names, *answers.values(), ENDED)))):
        rows = np.fromiter((not str(one).startswith(NOT_SIMULATED) for one in batch[ENDED]), bool, len(batch[ENDED]))
        simulated += int(rows.sum())
        manoeuvres, place = np.unique(batch[MANOEUVRE][rows].astype(str), return_inverse=True)
        given = {requirement: batch[name][rows] for requirement, name in answers.items()}
        for name in list(counts):
            for level, here in _levels(batch[name][rows]):
                own = counts[name].setdefault(level, {})
                for requirement, answer in given.items():
                    asked = np.bincount(place[here & (answer >= 0)], minlength=len(manoeuvres))
                    violated = np.bincount(place[here & (answer == 0)], minlength=len(manoeuvres))
                    for k, manoeuvre in enumerate(manoeuvres.tolist()):
                        before = own.get((requirement, manoeuvre), (0, 0))
                        own[requirement, manoeuvre] = (before[0] + int(asked[k]), before[1] + int(violated[k]))
            if len(counts[name]) > _MOST_LEVELS and any(isinstance(level, float) for level in counts[name]):
                del counts[name]
    return counts, simulated


def _levels(column: Array) -> Iterator[tuple[Level, Array]]:
    """Walk the values of a column with the runs that have them; of a column of numbers no more than are few."""
    if column.dtype == np.int8:
        yield from ((bool(level), column == int(level)) for level in (True, False) if np.any(column == int(level)))
    elif column.dtype.kind == "f":
        values = np.unique(column)[: _MOST_LEVELS + 1]
        yield from ((float(level), column == level) for level in values)
    else:
        text = column.astype(str)
        yield from ((str(level), text == level) for level in np.unique(text))


def _of_one(
    requirement: str, manoeuvre: str | None, discrete: Mapping[str, Mapping[Level, _Counts]], confidence: float
) -> list[Contrast]:
    """Return all contrasts of a metric, over all manoeuvres or within one."""
    from scipy import stats

    found = []
    for name, levels in discrete.items():
        sums = {level: _sum(own, requirement, manoeuvre) for level, own in levels.items()}
        runs, events = (sum(pair[k] for pair in sums.values()) for k in (0, 1))
        for level, (asked, violated) in sums.items():
            # That a fault does not happen is the other side of that it does.
            if level is False or not 0 < asked < runs:
                continue
            others = (runs - asked, events - violated)
            square = [[violated, asked - violated], [others[1], others[0] - others[1]]]
            found.append((name, level, (violated, asked), (others[1], others[0]), stats.fisher_exact(square)[1]))
    p_values = holm([p for *_, p in found])
    out = [
        Contrast(
            requirement=requirement,
            manoeuvre=manoeuvre,
            parameter=name,
            level=level,
            present=clopper_pearson(*present, confidence),
            absent=clopper_pearson(*absent, confidence),
            p_value=float(p),
        )
        for (name, level, present, absent, _), p in zip(found, p_values, strict=True)
    ]
    return sorted(out, key=lambda one: (one.p_value, one.parameter, str(one.level)))


def _sum(counts: _Counts, requirement: str, manoeuvre: str | None) -> tuple[int, int]:
    own = [pair for (name, simulated), pair in counts.items() if name == requirement and manoeuvre in (None, simulated)]
    return sum(asked for asked, _ in own), sum(violated for _, violated in own)
