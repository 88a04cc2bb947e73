"""How often requirements are violated with and without each value of the inputs that have few.

Shares of variance do not see a rare cause. A fault in one run of fifty has hardly any share of a metric's variance,
even where every violating run has it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.campaign.probability import CONFIDENCE, SIGNIFICANCE, Probability, clopper_pearson, holm
from platform_ctrl.campaign.table import ENDED, MANOEUVRE, PASSED, Array, Table, batches, input_names, was_simulated
from platform_ctrl.campaign.table_statistics import Limits, answer_columns, in_order
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value

# A number with more values than this, or with about one for each run, is no choice among a few.
_MOST_LEVELS = 12

Level = bool | float | str


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


# Runs with the limit and violations, by metric and manoeuvre.
_Pairs = dict[tuple[str, str], tuple[int, int]]


@check_arguments
def contrasts(
    table: Table, limits: Limits, *, inputs: Sequence[str] | None = None, confidence: float = CONFIDENCE
) -> tuple[Contrast, ...]:
    """Return how often each requirement is violated with and without every value of the inputs that have few.

    All runs that were simulated are counted, a chunk of the table at a time. Arguments and errors are those of
    `statistics`; `inputs` are the columns of inputs, by default all that are no outcome. Every requirement over all
    manoeuvres comes first, then within each, the least p-value first.
    """
    names = tuple(input_names(table) if inputs is None else inputs)
    counts, simulated = _counted(table, names)
    few = min(_MOST_LEVELS, simulated // 2)
    discrete = {name: levels for name, levels in counts.items() if not _numeric(levels) or len(levels) <= few}
    manoeuvres = in_order(
        sorted({m for levels in discrete.values() for one in levels.values() for _, m in one}), limits
    )
    out: list[Contrast] = []
    for manoeuvre in (None, *(manoeuvres if len(manoeuvres) > 1 else ())):
        for requirement in (*RUN_METRICS, PASSED):
            out += _of_one(requirement, manoeuvre, discrete, confidence)
    return tuple(out)


def _numeric(levels: Iterable[Level]) -> bool:
    return any(isinstance(level, float) for level in levels)


def _counted(table: Table, names: Sequence[str]) -> tuple[dict[str, dict[Level, _Pairs]], int]:
    """Return the counts by input and value, and how many runs were simulated."""
    answers = answer_columns(table)
    counts: dict[str, dict[Level, _Pairs]] = {name: {} for name in names}
    simulated = 0
    for batch in batches(table, tuple(dict.fromkeys((MANOEUVRE, *names, *answers.values(), ENDED)))):
        rows = was_simulated(batch)
        simulated += int(rows.sum())
        manoeuvres, place = np.unique(batch[MANOEUVRE][rows].astype(str), return_inverse=True)
        given = {requirement: batch[column][rows] for requirement, column in answers.items()}
        for name in list(counts):
            for level, here in _levels(batch[name][rows]):
                own = counts[name].setdefault(level, {})
                for requirement, answer in given.items():
                    limited = np.bincount(place[here & (answer >= 0)], minlength=len(manoeuvres)).tolist()
                    violated = np.bincount(place[here & (answer == 0)], minlength=len(manoeuvres)).tolist()
                    for k, manoeuvre in enumerate(manoeuvres.tolist()):
                        before = own.get((requirement, manoeuvre), (0, 0))
                        own[requirement, manoeuvre] = (before[0] + limited[k], before[1] + violated[k])
            if len(counts[name]) > _MOST_LEVELS and _numeric(counts[name]):
                del counts[name]
    return counts, simulated


def _levels(column: Array) -> Iterator[tuple[Level, Array]]:
    """Walk the values of a column with the runs that have them; of a column of numbers no more than are few."""
    if column.dtype == np.int8:
        yield from ((bool(level), column == int(level)) for level in (True, False) if np.any(column == int(level)))
    elif column.dtype.kind == "f":
        yield from ((float(level), column == level) for level in np.unique(column)[: _MOST_LEVELS + 1])
    else:
        text = column.astype(str)
        yield from ((str(level), text == level) for level in np.unique(text))


def _of_one(
    requirement: str, manoeuvre: str | None, discrete: Mapping[str, Mapping[Level, _Pairs]], confidence: float
) -> list[Contrast]:
    """Return all contrasts of a metric, over all manoeuvres or within one."""
    from scipy import stats

    found = []
    for name, levels in discrete.items():
        sums = {
            level: np.sum(
                [pair for (one, m), pair in own.items() if one == requirement and manoeuvre in (None, m)] or [(0, 0)],
                axis=0,
            )
            for level, own in levels.items()
        }
        whole = np.sum(list(sums.values()), axis=0) if sums else np.zeros(2, dtype=int)
        for level, one in sums.items():
            # That a fault does not happen is the other side of that it does.
            if level is False or not 0 < one[0] < whole[0]:
                continue
            pairs = [(int(violated), int(limited)) for limited, violated in (one, whole - one)]
            p = stats.fisher_exact([(events, runs - events) for events, runs in pairs])[1]
            found.append((name, level, [clopper_pearson(*pair, confidence) for pair in pairs], float(p)))
    p_values = holm([p for *_, p in found])
    out = [
        Contrast(
            requirement=requirement,
            manoeuvre=manoeuvre,
            parameter=name,
            level=level,
            present=present,
            absent=absent,
            p_value=float(p),
        )
        for (name, level, (present, absent), _), p in zip(found, p_values, strict=True)
    ]
    return sorted(out, key=lambda one: (one.p_value, one.parameter, str(one.level)))
