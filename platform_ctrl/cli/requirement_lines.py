"""Requirements on a terminal: aligned columns, the worst first, within the width."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.common.values import value
from platform_ctrl.job.judging import CheckResult

if TYPE_CHECKING:
    from platform_ctrl.verification import JobResult

# Columns between columns, fewest for the name of a requirement, and by which what follows is indented.
_GAP, _NAME, _INDENT = 2, 16, 2
# From this relative distance on a value that must be small is none: +100 %.
_NOTHING = 0.995


@value
class Line:
    """A line and what it shows."""

    text: str
    # "title", "missed", "met", "goal" or "plain"
    kind: str = "plain"


def requirement_lines(
    results: Sequence[CheckResult], width: int, result: JobResult | None = None, titles: bool = True
) -> Iterator[Line]:
    """Walk the lines for requirements and goals by subject, the worst first.

    `result` has the proofs; without `titles` the subjects are not named.

    A line has whether it is met, the name, the value, the limit and the relative distance to the limit, all of them at
    any width: names are wrapped. Of what is met by as much as it can be only the names are told, in the last line.
    """
    from platform_ctrl.report.page.tables import requirement_row

    told = [one for one in results if not _as_good_as_can_be(one)]
    rows = [(one, requirement_row(one, result)) for one in told]
    cells = [(_mark(one), row.requirement, row.value, row.limit, row.margin) for one, row in rows]
    heads = ("", "", "value", "limit", "margin") if cells else ("",) * 5
    widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]
    numbers = sum(widths[2:]) + 3 * _GAP
    name = max(min(widths[1], width - widths[0] - _GAP - numbers), _NAME)
    if cells:
        yield Line(text=_row(("", "", *heads[2:]), name, widths), kind="goal")
    order = sorted(range(len(rows)), key=lambda k: (_group_severity(rows[k][0], told), severity(told[k])))
    for subject, places in groupby(order, key=lambda k: subject_of(told[k])):
        yield from (Line(text=line, kind="title") for line in textwrap.wrap(subject, width) if titles)
        for k in places:
            kind = "goal" if not told[k].hard else "met" if told[k].passed else "missed"
            first, *more = textwrap.wrap(cells[k][1], name, break_long_words=False, break_on_hyphens=False)
            yield Line(text=_row((cells[k][0], first, *cells[k][2:]), name, widths), kind=kind)
            for line in more:
                yield Line(text=f"{'':{widths[0] + _GAP}}{line}", kind=kind)
    yield from _folded([one for one in results if _as_good_as_can_be(one)], width)


def _row(cells: tuple[str, ...], name: int, widths: Sequence[int]) -> str:
    numbers = "".join(f"{'':{_GAP}}{cell:>{size}}" for cell, size in zip(cells[2:], widths[2:], strict=True))
    return f"{cells[0]:{widths[0]}}{'':{_GAP}}{cells[1]:{name}}{numbers}".rstrip()


def severity(one: CheckResult) -> tuple[bool, bool, float]:
    """Return by what results are sorted: missed requirements, then met ones by their distance, then goals."""
    return not one.hard, one.passed, one.margin


def subject_of(one: CheckResult) -> str:
    """Return the loop or manoeuvre that a result is about, and its design."""
    return f"{one.subject}, {one.design}" if one.design else one.subject


def _group_severity(one: CheckResult, results: Sequence[CheckResult]) -> tuple[tuple[bool, bool, float], str]:
    subject = subject_of(one)
    return min(severity(other) for other in results if subject_of(other) == subject), subject


def _mark(one: CheckResult) -> str:
    return "met" if one.passed else "NOT MET" if one.hard else "not met"


def tells_nothing(one: CheckResult) -> bool:
    """Whether a requirement that is met says nothing of how tight a design is.

    That is how slow the slowest pole is, if it decays at all, and that everything is proved.
    """
    return one.passed and one.name.startswith((METRICS["stability"].name, "certified properties"))


def summary_words(results: Sequence[CheckResult], more: str = "") -> str:
    """Return how many requirements are met, `more`, and which one is the worst or the tightest."""
    from platform_ctrl.report.quantities import percent

    missed = sum(not one.passed for one in results)
    words = f"{missed} of {len(results)} requirements not met" if missed else f"all {len(results)} requirements met"
    words += more
    telling = [one for one in results if not tells_nothing(one)]
    if telling:
        worst = min(telling, key=severity)
        words += f"; {'worst' if missed else 'tightest'}: {subject_of(worst)}, {worst.name}"
        words += f" ({percent(worst.margin)})" if abs(worst.margin) < 10.0 else ""
    return words


def _as_good_as_can_be(one: CheckResult) -> bool:
    return one.hard and (tells_nothing(one) or (one.passed and one.sense == "at most" and one.margin >= _NOTHING))


def _folded(results: Sequence[CheckResult], width: int) -> Iterator[Line]:
    if not results:
        return
    counts = {name: sum(one.name == name for one in results) for name in dict.fromkeys(one.name for one in results)}
    names = [name if number == 1 else f"{name} ({number} times)" for name, number in counts.items()]
    text = f"also met, by 100 % or more: {'; '.join(names)}"
    for line in textwrap.wrap(text, width, subsequent_indent=" " * _INDENT, break_on_hyphens=False):
        yield Line(text=line, kind="goal")
