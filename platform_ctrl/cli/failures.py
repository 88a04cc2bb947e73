"""Failed requirements, and what has become worse than in an accepted result, as plain text."""

from __future__ import annotations

import math
from collections.abc import Sequence

from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.quantities import (
    compared,
    count,
    in_one_unit,
    listed,
)
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
        rows.append((f"{where}: {one.name}", shown[0], f"{one.sense} {shown[1]}", _percent(one.margin), one.evidence))
    head = f"{title}: {len(missed)} of {count(len(requirements), of)} not met"
    return "\n".join([head, *_table(rows)])


def changes_text(comparison: Comparison, name: str) -> str:
    """Return the values that are worse than in the accepted result `name`, the worst first, with causes; else a line.

    Then, in a few lines, what is better or new.
    """
    worse = sorted(comparison.of("worse"), key=lambda change: -abs(change.share))
    lines = [_head(comparison, name)]
    if worse:
        rows = [("", "before", "now", "change", "tolerance", "limit")]
        lines += _table(rows + [_row(change) for change in worse])
    lines += _others("not measured any more", comparison.of("missing"))
    lines += [f"  made with {listed(comparison.differing)}"] if comparison.differing else []
    lines += _others("better by more than its tolerance", comparison.of("better"))
    lines += _others("not in the accepted result", comparison.of("new"))
    return "\n".join(lines)


def _head(comparison: Comparison, name: str) -> str:
    worse, missing = len(comparison.of("worse")), len(comparison.of("missing"))
    compared = len(comparison.changes) - len(comparison.of("new"))
    if not worse and not missing:
        return f"{name}: none of {count(compared, 'value')} is worse by more than its tolerance"
    parts = [f"{worse} worse by more than {'its' if worse == 1 else 'their'} tolerance"] if worse else []
    parts += [f"{missing} not measured any more"] if missing else []
    return f"{name}: of {count(compared, 'value')} {listed(parts)}"


def _row(change: Compared) -> tuple[str, ...]:
    numbers = (change.before, change.now, change.allowed, change.limit)
    before, now, allowed, limit = in_one_unit(numbers, change.unit)
    limit = f"{change.sense} {limit}" if change.limit is not None else ""
    return _named(change), before, now, _percent(change.share), allowed, limit


def _named(change: Compared) -> str:
    return f"{change.subject}: {change.name}"


def _others(words: str, changes: Sequence[Compared]) -> list[str]:
    """Return a few lines for changes that are no failures."""
    shown = []
    for change in changes[:_LINES]:
        before, now = in_one_unit((change.before, change.now), change.unit)
        numbers = " -> ".join(filter(None, (before, now)))
        shown.append(f"{_named(change)}, {numbers}")
    more = len(changes) - len(shown)
    return [f"  {words}: {line}" for line in shown] + ([f"  {words}: and {more} more"] if more > 0 else [])


def _percent(share: float) -> str:
    if not math.isfinite(share):
        return "-" if math.isnan(share) else f"{share:+}"
    return f"{100.0 * share:+.{1 if abs(share) < 0.0995 else 0}f} %"


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
