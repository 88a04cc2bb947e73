"""Every shipped model has an example that prints what theory says beside what the equations give, and draws it."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MODELS = sorted(file.stem for file in (EXAMPLES.parent / "models").glob("*.toml"))

NUMBER = r"[-+]?\d[\d.]*(?:e[-+]?\d+)?"
ROW = re.compile(rf"(\S.*?)\s+({NUMBER})\s+({NUMBER})(?:\s+\(theory to ([\d.]+) %\))?")


def table(text: str) -> Iterator[tuple[str, float, float, float]]:
    """Quantity, theory, computed value and tolerance of every row under the head, to the first line that is none."""
    lines = iter(text.splitlines())
    assert any(line.split() == ["quantity", "theory", "computed"] for line in lines), "no head of a table"
    for line in lines:
        row = ROW.fullmatch(line)
        if row is None:
            break
        quantity, theory, computed, percent = row.groups()
        yield quantity, float(theory), float(computed), float(percent or 0.1) / 100.0


@pytest.mark.parametrize("name", MODELS)
def test_the_example_of_a_model_agrees_with_theory_and_draws_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from matplotlib import pyplot as plt

    picture = tmp_path / "figure.png"
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "-o", str(picture)])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    rows = list(table(capsys.readouterr().out))
    assert len({quantity for quantity, *_ in rows}) == len(rows) >= 5
    for quantity, theory, computed, tolerance in rows:
        assert tolerance <= 0.05, quantity
        assert computed == pytest.approx(theory, rel=tolerance, abs=1e-9), quantity

    [figure] = [plt.figure(number) for number in plt.get_fignums()]
    height, width, _ = plt.imread(picture).shape
    assert width / height == pytest.approx(np.divide(*figure.get_size_inches()), rel=0.01)
    for axes in figure.axes:
        assert axes.get_xlabel() or axes.get_ylabel()
        drawn = [np.asarray(line.get_data(), dtype=float) for line in axes.lines]
        assert drawn or axes.collections
        for line in drawn:
            assert np.isfinite(line).any(axis=1).all()
