"""What is printed of requirements: within the width, the worst first, and nothing that a pipe cannot read."""

from __future__ import annotations

import re

import pytest
from rich.console import Console

from platform_ctrl.analysis.metrics import METRICS, RUN_METRICS
from platform_ctrl.cli.terminal import show_requirements
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


def lines(results: list[CheckResult], width: int) -> list[str]:
    console = Console(width=width, color_system=None, record=True, markup=False)
    with console.capture() as shown:
        show_requirements(console, results)
    return [line.rstrip() for line in shown.get().splitlines()]


@pytest.mark.parametrize("width", [60, 80, 140])
def test_rows_fit_the_width_with_value_limit_and_margin_in_columns(width: int) -> None:
    results = [result(k, "0.1 N m step about axis 1", "H-infinity", 0.4 + 0.2 * k, True) for k in range(len(KINDS))]
    shown = lines(results, width)
    assert max(map(len, shown)) <= width
    assert not any(BOXES.search(line) for line in shown)
    rows = [line for line in shown if line.startswith(("met", "NOT MET"))]
    assert all(re.search(r"  [≥≤] \S.*  (> \+999|< −999|[+−][\d.]+) %$", line) for line in rows), shown
    assert len({len(line) for line in rows}) == 1


def test_what_is_missed_comes_first_and_what_cannot_be_better_is_one_line() -> None:
    results = [
        result(1, "one", "PI", 1.2, True),
        result(2, "two", "PI", 0.9, True),
        result(3, "two", "PI", 0.5, True),
        result(3, "one", "PI", 0.4, False),
        result(0, "one", "PI", 400.0, True),
        result(6, "one", "", 1e-6, True),
    ]
    shown = lines(results, 100)
    assert [line.split()[0] for line in shown] == [*("value", "two,", "NOT", "NOT", "one,", "met", "not", "also")]
    assert "attenuation" in shown[2]
    assert shown[-1] == "also met, by 100 % or more: minimum decay rate; largest gimbal angle"
