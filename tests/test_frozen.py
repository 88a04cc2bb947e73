"""What the package answers through its public surface is what it answered when tests/frozen/ was written."""

from __future__ import annotations

import numpy as np
import pytest

import frozen

NAMES = [pytest.param(name, marks=[pytest.mark.slow] * part.slow) for name, part in frozen.PARTS.items()]


@pytest.mark.parametrize("name", NAMES)
def test_nothing_has_moved(name):
    if name == "flights":
        pytest.importorskip("pyarrow")
    part = frozen.PARTS[name]
    assert list(frozen.differences(frozen.kept(name), frozen.made(part), part)) == []


def test_check_says_of_saved_controllers_what_design_said_of_them():
    found = [value for name in frozen.PARTS for path, value in frozen.kept(name).items() if "check differs" in path]
    assert len(found) == 3
    assert not any(found)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (1.0, 1.0 + 1e-8, "relative 1.0e-08"),
        (np.nan, 1.0, "nan was expected"),
        (None, 1.0, "None was expected"),
        (True, False, "True was expected"),
        ("peak 1.5 at 3", "peak 1.5 at 4", "line 1"),
        ("peak 1.5", "top 1.5", "top #"),
    ],
)
def test_what_differs_is_said(before, after, said):
    lines = list(frozen.differences({"it": before}, {"it": after}, frozen.Part(dict)))
    assert any(said in line for line in lines), lines
