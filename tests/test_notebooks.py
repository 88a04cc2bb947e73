"""The notebook runs from top to bottom, and shows results, plots and progress."""

from __future__ import annotations

from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[1] / "examples" / "notebooks" / "caged_gyro.ipynb"


@pytest.mark.slow
def test_the_notebook_runs_and_shows_results_plots_and_progress() -> None:
    nbclient = pytest.importorskip("nbclient", reason="the notebook needs the extra notebook")
    nbformat = pytest.importorskip("nbformat", reason="the notebook needs the extra notebook")
    book = nbformat.read(NOTEBOOK, as_version=4)
    assert not any(cell.get("outputs") for cell in book.cells)  # outputs are made by whoever opens it
    nbclient.NotebookClient(book, timeout=300, kernel_name="python3").execute()
    shown = [output for cell in book.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [one for one in shown if one.output_type == "stream"]  # no warning
    data = [one.data for one in shown if one.output_type in ("execute_result", "display_data")]
    assert any("('disk margin', True, " in one.get("text/plain", "") for one in data)
    assert any("image/png" in one for one in data)
    # Progress replaces itself in one output, which is empty or holds the last step in the end.
    assert any(one.output_type == "display_data" and "text/html" in one.data for one in shown)
