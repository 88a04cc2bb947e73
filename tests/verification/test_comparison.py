"""Comparing two results: worse, better, missing and new values, and values that are no numbers."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from platform_ctrl.verification.comparison import compare


def record(**values: float | None) -> dict[str, Any]:
    """A result with requirements on values of a loop: bandwidths at least, all others at most 1."""
    return {
        "sha256": {"plant": "p", "job": "j"},
        "controllers": [{"name": "loop", "claims": {}, **{key: [[1.0]] for key in "ABCD"}}],
        "coupled": {"stable": True},
        "runs": [],
        "requirements": [
            {"subject": "loop", "name": name, "unit": "", "limit": 1.0, "value": number}
            | {"sense": "at least" if name.startswith("bandwidth") else "at most"}
            for name, number in values.items()
        ],
    }


@pytest.mark.parametrize(
    ("before", "now", "state"),
    [
        ({"bandwidth": 100.0}, {"bandwidth": 99.0}, "within"),
        ({"bandwidth": 100.0}, {"bandwidth": 98.9}, "worse"),
        ({"bandwidth": 100.0}, {"bandwidth": 101.1}, "better"),
        ({"noise": 100.0}, {"noise": 101.1}, "worse"),
        ({"noise": -100.0}, {"noise": -98.9}, "worse"),
        ({"noise": 0.0}, {"noise": 1e-13}, "within"),
        ({"noise": 0.0}, {"noise": 1e-9}, "worse"),
        ({"noise": 1.0}, {"noise": None}, "worse"),
        ({"bandwidth": 1.0}, {"bandwidth": None}, "worse"),
        ({"noise": None}, {"noise": None}, "within"),
        ({"noise": None}, {"noise": 1.0}, "better"),
        ({"noise": 1.0}, {}, "missing"),
        ({}, {"noise": 1.0}, "new"),
        ({"disk margin lost by coupling": 1e-4}, {"disk margin lost by coupling": 9e-3}, "within"),
        ({"disk margin lost by coupling": 1e-4}, {"disk margin lost by coupling": 2e-2}, "worse"),
    ],
)
def test_a_value_is_judged_by_its_sense_and_the_tolerance(before: Any, now: Any, state: str) -> None:
    found = compare(record(**now), record(**before), 0.01)
    assert [one.state for one in found.changes] == [state]
    assert found.passed == (state not in ("worse", "missing"))


def test_what_two_results_do_not_have_in_common_is_said() -> None:
    one = record(noise=1.0)
    other = copy.deepcopy(one)
    assert compare(one, other, 0.01).differing == ()
    other["sha256"]["job"] = "k"
    other["controllers"][0]["B"] = [[1.0 + 1e-5]]
    assert compare(one, other, 0.01).differing == ("another job", "another controller of loop")
    other["sha256"]["plant"] = "q"
    assert compare(one, other, 0.01).differing == ("another plant", "another controller of loop")
