"""Failed requirements and changes since a baseline: as plain text, and verdicts as JUnit XML, which CI systems read."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from platform_ctrl.common.files import write_whole
from platform_ctrl.common.reasons import reason
from platform_ctrl.common.text import rounded
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.quantities import (
    UNSTABLE,
    count,
    distinguishing_digits,
    handy_unit,
    in_one_unit,
    listed,
    pessimistic_rounding,
    times,
)
from platform_ctrl.verification.baselines import compare, read_baseline, update_baseline
from platform_ctrl.verification.baselines.comparison import Change, Comparison
from platform_ctrl.verification.baselines.file import Update, remove_plot
from platform_ctrl.verification.baselines.record import LoopMatrices

if TYPE_CHECKING:
    from platform_ctrl.verification import JobResult

# Most lines for better, new or missing values: a baseline of another job has nothing else.
_LINES = 8


def requirement_text(one: CheckResult) -> str:
    """Return a requirement with value, limit and margin in one line."""
    shown = value_and_limit(one)
    where = f"{one.subject}, {one.design}" if one.design else one.subject
    verdict = "met" if one.passed else "not met"
    return f"{where}: {one.name} {shown[0]}, {one.sense} {shown[1]}: {verdict}, margin {margin_text(one)}"


def value_and_limit(one: CheckResult) -> tuple[str, str]:
    """Return value and limit in the same unit; the value is never printed better than it is."""
    finite = [abs(number) for number in (one.value, one.limit) if math.isfinite(number)]
    factor, name = handy_unit(one.unit, max(finite, default=1.0))
    digits = distinguishing_digits(one)
    value, limit = rounded(times(factor, one.value), digits, pessimistic_rounding(one)), times(factor, one.limit)
    shown = f"{value:.{digits}g} {name}".rstrip() if math.isfinite(value) else UNSTABLE
    return shown, f"{limit:.{max(digits, 6)}g} {name}".rstrip()


def margin_text(one: CheckResult) -> str:
    """Return the margin in per cent with its sign: negative where the requirement is missed."""
    return _percent(one.margin)


def missed_text(requirements: Sequence[CheckResult], title: str, of: str = "requirement") -> str:
    """Return a table of those `requirements` that are not met, the worst first; empty where all are."""
    missed = sorted((one for one in requirements if not one.passed), key=lambda one: one.margin)
    if not missed:
        return ""
    rows = [("", "value", "limit", "margin", "")]
    for one in missed:
        shown = value_and_limit(one)
        where = f"{one.subject}, {one.design}" if one.design else one.subject
        rows.append((f"{where}: {one.name}", shown[0], f"{one.sense} {shown[1]}", margin_text(one), one.evidence))
    head = f"{title}: {len(missed)} of {count(len(requirements), of)} not met"
    return "\n".join([head, *_table(rows)])


def moved_text(comparison: Comparison, name: str) -> str:
    """Return what has moved beyond its tolerance since the baseline `name` was accepted, and why it may have.

    First the failures, the worst first, and which loops have changed; then, in a few lines, what is better or new.
    """
    worse = sorted(comparison.of("worse"), key=lambda change: -change.of_tolerance)
    lines = [_head(comparison, name)]
    if worse:
        rows = [("", "before", "now", "change", "tolerance", "limit")]
        lines += _table(rows + [_row(change) for change in worse])
    lines += _others("not measured any more", comparison.of("missing"))
    lines += _causes(comparison.pairs) if worse else []
    lines += _others("better by more than its tolerance", comparison.of("better"))
    lines += _others("not in the baseline", comparison.of("new"))
    return "\n".join(lines)


def failure_text(comparison: Comparison, job: str, file: Path, plot: Path, accept: str) -> tuple[str, Path | None]:
    """Return what has moved, in words that end with how to accept it, and where it is drawn.

    If the plot cannot be written, the text gives the reason and is complete all the same.
    """
    title = moved_text(comparison, f"{job}, {file.name}").partition("\n")[0]
    drawn: Path | None = None
    try:
        from platform_ctrl.report.figures.baseline_changes import write_moved_figure  # loads Matplotlib

        drawn = write_moved_figure(comparison, title, plot)
        place = str(drawn)
    except Exception as error:
        place = f"none ({reason(error)})"
    return f"{moved_text(comparison, str(file))}\n  plot: {place}\n  to accept this: {accept}", drawn


def against_baseline(
    result: JobResult, file: Path, plot: Path, accept: str, *, update: bool
) -> tuple[Comparison | Update, str, Path | None]:
    """Compare a result with a baseline, or update the file; return that, the text of a failure and where it is drawn.

    Without a failure the text is empty, and the plot of an earlier one is removed.
    """
    found = update_baseline(result, file) if update else compare(result, read_baseline(file))
    if isinstance(found, Update) or found.passed:
        remove_plot(plot)
        return found, "", None
    return found, *failure_text(found, result.job.name, file, plot, accept)


def change_text(change: Change) -> str:
    """Return one figure before and now in one line."""
    if change.state == "missing":
        return f"{_named(change)}: not measured any more"
    if change.state == "new":
        return f"{_named(change)}: {in_one_unit((change.now,), change.unit)[0]}, not in the baseline"
    before, now, allowed = in_one_unit((change.before, change.now, change.allowed), change.unit)
    words = {"within": "within its tolerance", "worse": "worse", "better": "better"}[change.state]
    return f"{_named(change)}: {before} -> {now} ({_percent(change.share)}), tolerance {allowed}: {words}"


def _head(comparison: Comparison, name: str) -> str:
    worse, missing = len(comparison.of("worse")), len(comparison.of("missing"))
    compared = len(comparison.changes) - len(comparison.of("new"))
    if not worse and not missing:
        return f"{name}: none of {count(compared, 'figure')} is worse by more than its tolerance"
    parts = [f"{worse} worse by more than {'its' if worse == 1 else 'their'} tolerance"] if worse else []
    parts += [f"{missing} not measured any more"] if missing else []
    return f"{name}: of {count(compared, 'figure')} {listed(parts)}"


def _row(change: Change) -> tuple[str, ...]:
    numbers = (change.before, change.now, change.allowed, change.limit)
    before, now, allowed, limit = in_one_unit(numbers, change.unit)
    limit = f"{change.sense} {limit}" if change.limit is not None else ""
    return _named(change), before, now, _percent(change.share), allowed, limit


def _named(change: Change) -> str:
    return f"{change.subject}: {change.name}"


def _others(words: str, changes: Sequence[Change]) -> list[str]:
    """Return a few lines for changes that are no failures."""
    shown = []
    for change in changes[:_LINES]:
        before, now = in_one_unit((change.before, change.now), change.unit)
        numbers = " -> ".join(filter(None, (before, now)))
        shown.append(f"{_named(change)}, {numbers}")
    more = len(changes) - len(shown)
    return [f"  {words}: {line}" for line in shown] + ([f"  {words}: and {more} more"] if more > 0 else [])


def _causes(pairs: Sequence[tuple[LoopMatrices, LoopMatrices]]) -> Iterator[str]:
    """Walk lines with the matrices of every loop that differ from the baseline."""
    for before, now in pairs:
        plant = before.plant is not None and now.plant is not None and not before.same_plant(now)
        parts = ["its plant"] * plant + ["its controller"] * (not before.same_controller(now))
        if parts:
            design = f" ({before.design} -> {now.design})" if before.design != now.design else ""
            yield f"  {now.loop}: changed since the baseline: {listed(parts)}{design}"
        else:
            yield f"  {now.loop}: plant and controller are those of the baseline"


def _percent(share: float) -> str:
    if not math.isfinite(share):
        return "-" if math.isnan(share) else f"{share:+}"
    return f"{100.0 * share:+.{1 if abs(share) < 0.0995 else 0}f} %"


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


# What XML 1.0 cannot hold, however it is written.
_ILLEGAL = {code: None for code in range(0x20) if code not in (0x09, 0x0A, 0x0D)}


def write_junit(
    result: JobResult,
    path: str | os.PathLike[str],
    *,
    comparison: Comparison | None = None,
    baseline: str = "baseline",
) -> Path:
    """Write the verdicts of a job as JUnit XML, whole or not at all, and return the file's path.

    A comparison with a baseline (called `baseline` there) is a suite too, a test case per value: one that is worse or
    missing is a failure, a new one is skipped.
    """
    written = BytesIO()
    _suites(result, comparison, baseline).write(written, pretty=True)
    return write_whole(path, written.getvalue())


def _library() -> ModuleType:
    import junitparser

    return junitparser


def _suites(result: JobResult, comparison: Comparison | None, baseline: str) -> Any:
    out = _library().JUnitXml(_text(result.job.name))
    for subject in dict.fromkeys(one.subject for one in result.requirements):
        cases = [_requirement(result, one) for one in result.requirements if one.subject == subject]
        out.add_testsuite(_suite(subject, cases))
    if comparison is not None:
        out.add_testsuite(_suite(baseline, [_change(result, change, baseline) for change in comparison.changes]))
    out.update_statistics()
    return out


def _suite(name: str, cases: list[Any]) -> Any:
    suite = _library().TestSuite(_text(name))
    suite.add_testcases(cases)
    return suite


def _requirement(result: JobResult, one: CheckResult) -> Any:
    properties = {
        "value": f"{one.value:.9g}",
        "limit": f"{one.limit:.9g}",
        "unit": one.unit,
        "sense": one.sense,
        "margin": margin_text(one),
        "design": one.design,
        "stage": one.stage,
        "method": one.method,
        "evidence": one.evidence,
    }
    case = _case(one.name, f"{result.job.name}.{one.subject}", properties)
    if not one.passed:
        message = _text(requirement_text(one))
        failure = _library().Failure(message, "requirement not met")
        failure.text = f"{message}\n{_text(one.evidence)}"
        case.result = failure
    return case


def _change(result: JobResult, change: Change, baseline: str) -> Any:
    numbers = {"before": change.before, "now": change.now, "tolerance": change.allowed}
    properties = {name: f"{number:.9g}" for name, number in numbers.items() if number is not None}
    properties |= {"unit": change.unit, "sense": change.sense, "state": change.state}
    case = _case(f"{change.subject}: {change.name}", f"{result.job.name}.{baseline}", properties)
    message = _text(change_text(change))
    if change.state in ("worse", "missing"):
        failure = _library().Failure(
            message, "worse than the baseline" if change.state == "worse" else "no longer measured"
        )
        failure.text = message
        case.result = failure
    elif change.state == "new":
        case.result = _library().Skipped(message)
    return case


def _case(name: str, classname: str, properties: dict[str, str]) -> Any:
    case = _library().TestCase(_text(name), _text(classname), 0.0)
    listed_properties = _library().Properties()
    for key, item in properties.items():
        listed_properties.add_property(_library().Property(key, _text(item)))
    case.append(listed_properties)
    return case


def _text(words: str) -> str:
    """Return what XML can hold of a text."""
    return words.translate(_ILLEGAL).encode("utf-8", "replace").decode("utf-8")
