"""The figure of one simulated run as a file of its own."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from platform_ctrl.writing import write_whole

if TYPE_CHECKING:
    from platform_ctrl.check import Run
    from platform_ctrl.description import Platform


def write_run_figure(run: Run, platform: Platform, title: str, path: Path) -> None:
    """Draw everything that a run recorded and write it to `path` as SVG, whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written there.
    """
    from platform_ctrl.report.run_figures import run_figure
    from platform_ctrl.report.style import INK, settings

    out = StringIO()
    with settings():
        figure = run_figure(run, platform)
        above = 1.0 + 0.12 / figure.get_size_inches()[1]
        figure.text(0.0, above, title, color=INK, fontsize=9.0, fontweight="bold", ha="left", va="bottom")
        figure.savefig(
            out, format="svg", facecolor="white", bbox_inches="tight", pad_inches=0.1, metadata={"Date": None}
        )
    write_whole(path, out.getvalue())
