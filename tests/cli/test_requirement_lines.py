"""What is printed of requirements: within the width, aligned, the worst first, and nothing that a pipe cannot read."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.cli.terminal import (
    Line,
    requirement_lines,
    screen,
    severity,
    show_pairs,
    show_requirements,
    show_words,
    subject_of,
    summary_words,
)
from platform_ctrl.job.judging import CheckResult, Requirement

KINDS = [METRICS[kind] for kind in ("stability", "bandwidth", "disk margin", "attenuation", "torque noise", "tracking")]
KINDS += [RUN_METRICS[key] for key in ("angle", "torque_share", "attenuation_db")]
BOXES = re.compile(r"[─-╿|+]{2,}")


def result(kind: int, subject: str, design: str, ratio: float, hard: bool) -> CheckResult:
    metric = KINDS[kind]
    limit = {"rad": 3e-3, "N m": 0.01}.get(metric.unit, 20.0)
    name = metric.name if hard else f"goal: {metric.name}"
    requirement = Requirement(name=name, limit=limit, unit=metric.unit, sense=metric.sense, hard=hard)
    return requirement.judge(ratio * limit, subject=subject, design=design, stage="coupled", evidence="")


RESULTS = st.lists(
    st.builds(
        result,
        st.integers(0, len(KINDS) - 1),
        st.sampled_from(["caging 4-5-7", "all loops closed", "0.1 N m step about axis 1"]),
        st.sampled_from(["", "H-infinity"]),
        st.sampled_from([0.0, 1e-6, 0.4, 0.97, 0.999, 1.0, 1.001, 1.2, 3.0, 400.0]),
        st.booleans(),
    ),
    max_size=12,
)


def rows(results: list[CheckResult], width: int) -> list[Line]:
    lines = list(requirement_lines(results, width))
    return [line for line in lines if line.text.startswith(("met", "NOT MET", "not met"))]


@given(RESULTS, st.integers(60, 140))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_no_line_is_wider_than_the_terminal_and_no_word_is_broken(results: list[CheckResult], width: int) -> None:
    lines = [line.text for line in requirement_lines(results, width)]
    assert all(len(line) <= width and line == line.rstrip() for line in lines)
    assert not any(BOXES.search(line) for line in lines)
    known = {word for one in results for word in f"{one.name} {subject_of(one)}".replace(",", " ").split()}
    words = set(re.findall(r"[a-z][a-z-]+[a-z]", " ".join(lines).lower()))
    told = {"value", "limit", "margin", "also", "met", "not", "by", "or", "more", "times"}
    assert words <= told | {word.lower().strip(":,()") for word in known} | {
        "hz",
        "db",
        "mrad",
        "rad",
        "none",
        "unstable",
    }


@given(RESULTS)
@settings(derandomize=True, max_examples=60, deadline=None)
def test_value_limit_and_margin_of_every_row_end_in_the_same_columns(results: list[CheckResult]) -> None:
    shown = [line.text for line in rows(results, 80)]
    for line in shown:
        # Limit and margin, each with its unit: the margin is the distance to the limit relative to the limit.
        assert re.search(r"  [≥≤] \S.*  (> \+999|< −999|[+−][\d.]+) %$", line) or line.endswith("–"), line
    assert len({len(line) for line in shown}) <= 1


@given(RESULTS)
@settings(derandomize=True, max_examples=60, deadline=None)
def test_what_is_missed_comes_first_and_what_cannot_be_better_is_one_line(results: list[CheckResult]) -> None:
    shown = rows(results, 200)
    kinds = [line.kind for line in shown]
    missed = [one for one in results if one.hard and not one.passed]
    assert kinds.count("missed") == len(missed)
    if missed:
        assert kinds[0] == "missed"
        least = min(map(severity, missed))
        assert any(one.name in shown[0].text for one in missed if severity(one) == least)
    folded = [line.text for line in requirement_lines(results, 10_000) if line.text.startswith("also met")]
    quiet = [
        one
        for one in results
        if one.hard and one.passed and (one.name == "minimum decay rate" or one.value < 0.005 * one.limit)
    ]
    assert len(folded) == bool(quiet)
    assert all(one.name in folded[0] for one in quiet)
    assert len(shown) + len(quiet) == len(results)


def test_a_requirement_that_cannot_be_better_is_shown_where_it_fails() -> None:
    unstable = result(0, "caging", "PI", 0.0, True)
    [line] = rows([unstable], 80)
    assert line.kind == "missed"
    assert line.text.startswith("NOT MET  minimum decay rate")


def test_the_summary_names_the_worst_and_no_requirement_that_says_nothing() -> None:
    met = [result(0, "caging", "PI", 400.0, True), result(2, "caging", "PI", 1.2, True)]
    assert summary_words(met) == "all 2 requirements met; tightest: caging, PI, disk margin (+20 %)"
    missed = [*met, result(1, "caging", "PI", 0.5, True)]
    assert summary_words(missed) == "1 of 3 requirements not met; worst: caging, PI, bandwidth (−50 %)"


@pytest.mark.parametrize("columns", ["60", "80", None])
def test_a_pipe_gets_plain_lines(
    columns: str | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)
    results = [result(k, "caging", "classical", 0.8 + 0.1 * k, True) for k in range(len(KINDS))]
    words = "FAILED: 3 of 9 requirements not met, assuming that rate loops leave the gimbal angles free (+11 %), 3 rad"
    show_requirements(screen(), results)
    show_words(screen(), words)
    show_pairs(screen(), [("largest gimbal angle", "0.000761 rad (beta)"), ("ended", "completed")])
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert not BOXES.search(out)
    assert all(line == line.rstrip() for line in out.splitlines())
    if columns is None:
        assert words in out.splitlines()
    else:
        assert max(map(len, out.splitlines())) <= int(columns)
        # A number stays with its unit.
        assert not any(line.startswith(("%", "rad")) for line in out.splitlines())
