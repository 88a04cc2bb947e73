"""Failed requirements, and what has become worse than in an accepted result, as plain text."""

from __future__ import annotations

import math
from collections.abc import Sequence

from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.quantities import compared, count, listed, percent, pessimistic_rounding, quantity
from platform_ctrl.verification.comparison import Compared, Comparison

# Most lines for better, new or missing values: a result of another job has nothing else.
_LINES = 8


def missed_text(requirements: Sequence[CheckResult], title: str, of: str = "requirement") -> str:
    """Return a table of those `requirements` that are not met, the worst first; empty where all are."""
    missed = sorted((one for one in requirements if not one.passed), key=lambda one: one.margin)
    if not missed:
        return ""
    rows = [("", "value", "limit", "margin", "")]
    for one in missed:
        shown = compared(one)
        where = f"{one.subject}, {one.design}" if one.design else one.subject
        rows.append((f"{where}: {one.name}", shown[0], f"{one.sense} {shown[1]}", percent(one.margin), one.evidence))
    head = f"{title}: {len(missed)} of {count(len(requirements), of)} not met"
    return "\n".join([head, *_table(rows)])


def changes_text(comparison: Comparison, name: str) -> str:
    """Return the values that are worse than in the accepted result `name` as text: `changed` with a table."""
    head, rows, notes = changed(comparison, name)
    return "\n".join([head, *(_table(rows) if len(rows) > 1 else ()), *notes])


def changed(comparison: Comparison, name: str) -> tuple[str, list[tuple[str, ...]], list[str]]:
    """Return a line, the rows of a table of the values that are worse than in the accepted result `name`, and notes.

    The first row has the heads; then the worst first. The notes are causes, and what is better or new, in a few lines.
    """
    worse = sorted(comparison.of("worse"), key=lambda change: -abs(change.share))
    notes = _others("not measured any more", comparison.of("missing"))
    notes += [f"  made with {listed(comparison.differing)}"] if comparison.differing else []
    notes += _others("better by more than its tolerance", comparison.of("better"))
    notes += _others("not in the accepted result", comparison.of("new"))
    heads = ("", "before", "now", "change", "tolerance", "limit")
    return _head(comparison, name), [heads, *map(_row, worse)], notes


def _head(comparison: Comparison, name: str) -> str:
    worse, missing = len(comparison.of("worse")), len(comparison.of("missing"))
    compared = len(comparison.changes) - len(comparison.of("new"))
    if not worse and not missing:
        return f"{name}: none of {count(compared, 'value')} is worse by more than its tolerance"
    parts = [f"{worse} worse by more than {'its' if worse == 1 else 'their'} tolerance"] if worse else []
    parts += [f"{missing} not measured any more"] if missing else []
    return f"{name}: of {count(compared, 'value')} {listed(parts)}"


def _row(change: Compared) -> tuple[str, ...]:
    before, now, allowed, limit = _numbers(change, change.before, change.now, change.allowed, change.limit)
    limit = f"{change.sense} {limit}" if change.limit is not None else ""
    return _named(change), before, now, percent(change.share), allowed, limit


def _numbers(change: Compared, *numbers: float | None) -> list[str]:
    """Return numbers in one unit, rounded to the worse side, with digits enough to tell the first two apart."""
    size = max((abs(x) for x in numbers if x is not None and math.isfinite(x)), default=1.0)
    rounding, texts = pessimistic_rounding(change.sense), [""]
    for digits in (4, 6, 9):
        texts = ["" if x is None else quantity(x, change.unit, digits, size, rounding) for x in numbers]
        if numbers[0] == numbers[1] or texts[0] != texts[1]:
            break
    return texts


def _named(change: Compared) -> str:
    return f"{change.subject}: {change.name}"


def _others(words: str, changes: Sequence[Compared]) -> list[str]:
    """Return a few lines for changes that are no failures."""
    shown = []
    for change in changes[:_LINES]:
        numbers = " -> ".join(filter(None, _numbers(change, change.before, change.now)))
        shown.append(f"{_named(change)}, {numbers}")
    more = len(changes) - len(shown)
    return [f"  {words}: {line}" for line in shown] + ([f"  {words}: and {more} more"] if more > 0 else [])


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
