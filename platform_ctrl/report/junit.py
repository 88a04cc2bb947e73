"""Verdicts as JUnit XML, which every CI system reads: a suite per subject, a test case per requirement."""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

from platform_ctrl.common.files import write_whole
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.report.failure_messages import change_text, margin_text, requirement_text
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.baselines import Change, Comparison

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

    Parameters
    ----------
    result
        From `check.checked`.
    path
        The file.
    comparison
        With a baseline: a suite of its own, a test case per figure. A figure that is worse or missing is a failure, a
        new one is skipped.
    baseline
        What the baseline is called in it.
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
    held = _library().Properties()
    for key, item in properties.items():
        held.add_property(_library().Property(key, _text(item)))
    case.append(held)
    return case


def _text(words: str) -> str:
    """Return what XML can hold of a text."""
    return words.translate(_ILLEGAL).encode("utf-8", "replace").decode("utf-8")
