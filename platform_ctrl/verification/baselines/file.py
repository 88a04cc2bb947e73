"""A baseline's file: JSON with a figure a line, to be kept under version control and read in a diff."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.json_text import json_text
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.job.judging import Sense
from platform_ctrl.job.old_names import current_name
from platform_ctrl.plant.mistakes import given
from platform_ctrl.plant.source import read_json
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.baselines.comparison import Comparison, compare
from platform_ctrl.verification.baselines.record import AcceptedFigure, Baseline, LoopMatrices, Tolerance, accepted
from platform_ctrl.verification.json_tables import SCHEMA, JSONTable

_KEYS = ("schema", "job", "tolerance", "figures", "controllers", "plants")
_TOLERANCE = ("relative", "absolute")
_FIGURE = ("subject", "name", "value", "unit", "sense", *_TOLERANCE)
_CONTROLLER = ("name", "design", "method", "dt", "delay", "inputs", "outputs", "A", "B", "C", "D")
_PLANT = ("loop", "A", "B", "C", "D")


@value
class Update:
    """What accepting a result did to a baseline's file.

    Attributes
    ----------
    path
        The file.
    comparison
        With what was accepted before; None where there was no file.
    figures
        How many are accepted now.
    written
        False where nothing had changed, and the file was left alone.
    """

    path: Path
    comparison: Comparison | None
    figures: int
    written: bool

    @property
    def summary(self) -> str:
        """One line: how many figures were accepted, added and removed."""
        if self.comparison is None:
            return f"{self.path}: written, {self.figures} figures"
        if not self.written:
            return f"{self.path}: unchanged"
        counts = {
            "worse": len(self.comparison.of("worse")),
            "better": len(self.comparison.of("better")),
            "new": len(self.comparison.of("new")),
        }
        words = [f"{number} {state}" for state, number in counts.items() if number]
        gone = [f"{one.subject}: {one.name}" for one in self.comparison.of("missing")]
        words += [f"removed {', '.join(gone)}"] if gone else []
        return f"{self.path}: written, {'; '.join(words) or 'all figures within their tolerances'}"


@check_arguments
def read_baseline(path: str | os.PathLike[str]) -> Baseline:
    """Read a baseline and check it.

    Parameters
    ----------
    path
        A file that `write_baseline` wrote; tolerances may have been edited.

    Returns
    -------
    Baseline
        What is accepted.

    Raises
    ------
    InputError
        One line: the file, the entry and the key, what was given, what is expected.
    """
    label, data = read_json(path, "the JSON of a baseline")
    table = JSONTable(label, data, _KEYS)
    table.expect_schema()
    tolerance = Tolerance()
    if "tolerance" in table.data:
        own = JSONTable(f"{label}: tolerance", table.data["tolerance"], _TOLERANCE)
        tolerance = _tolerance(own, tolerance) or tolerance
    figures: dict[tuple[str, str], AcceptedFigure] = {}
    for entry in table.tables("figures", "a list of figures", _FIGURE):
        figure = _figure(entry, tolerance)
        if (figure.subject, figure.name) in figures:
            raise entry.mistake(f"the figure is listed twice for {given(figure.subject)}; leave one of them out")
        figures[figure.subject, figure.name] = figure
    plants: dict[str, JSONTable] = {}
    if "plants" in table.data:
        for entry in table.tables("plants", "a list of plants", _PLANT):
            plants[entry.text("loop", "the name of a loop")] = entry
    loops = []
    if "controllers" in table.data:
        loops = [_loop(entry, plants) for entry in table.tables("controllers", "a list of controllers", _CONTROLLER)]
    return Baseline(
        job=table.text("job", "the title of a job"),
        tolerance=tolerance,
        figures=tuple(figures.values()),
        loops=tuple(loops),
    )


@check_arguments
def write_baseline(baseline: Baseline, path: str | os.PathLike[str]) -> Path:
    """Write a baseline, whole or not at all, and return its path.

    A figure a line and a row of a matrix a line, in the order of the job: a diff shows what was accepted. Since it
    holds the controllers as ``result.json`` does, `check.read_controllers` reads them from it.
    """
    return write_whole(path, _text(baseline))


@check_arguments
def update_baseline(result: JobResult, path: str | os.PathLike[str]) -> Update:
    """Accept `result`: write its baseline, with the tolerances that stand in the file already; folders are made.

    Parameters
    ----------
    result
        From `verification.check_job`.
    path
        The file, which need not be there.

    Returns
    -------
    Update
        What moved against the figures that were accepted before, and whether anything was written.

    Raises
    ------
    InputError
        The file that is there is no baseline (it is left as it is), or cannot be written.
    """
    target = Path(path)
    before = read_baseline(target) if target.exists() else None
    now = accepted(result, before)
    text = _text(now)
    written = before is None or target.read_bytes() != text.encode()
    if written:
        with suppress(OSError):  # said by what writes
            target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, text)
    return Update(
        path=target,
        comparison=None if before is None else compare(result, before),
        figures=len(now.figures),
        written=written,
    )


@check_arguments
def plot_beside(path: str | os.PathLike[str], folder: str | os.PathLike[str] | None = None) -> Path:
    """Return where the figure of what has moved is saved: ``gyros.moved.png`` beside ``gyros.json``."""
    file = Path(path)
    return (file.parent if folder is None else Path(folder)) / f"{file.stem}.moved.png"


def remove_plot(plot: Path) -> None:
    """Remove the figure of an earlier failure; where that cannot be done it stays, and nothing else suffers."""
    with suppress(OSError):
        plot.unlink(missing_ok=True)


def _tolerance(table: JSONTable, default: Tolerance) -> Tolerance | None:
    """Return the tolerance that a table names; one bound alone is the whole of it."""
    found = {key: table.number(key, "a number >= 0", least=0.0) for key in _TOLERANCE if key in table.data}
    if not found:
        return None
    return Tolerance(relative=found.get("relative", 0.0), absolute=found.get("absolute", default.absolute))


def _figure(table: JSONTable, default: Tolerance) -> AcceptedFigure:
    number = table.item("value", "a number, or null for none")
    return AcceptedFigure(
        subject=table.text("subject", "a loop, a manoeuvre or all loops closed"),
        name=current_name(table.text("name", "the name of a figure")),
        value=math.inf if number is None else table.number("value", "a number, or null for none"),
        unit=current_name(table.text("unit", "a unit, empty for a plain number", empty=True)),
        sense=cast(Sense, table.one_of("sense", ("at least", "at most"))),
        tolerance=_tolerance(table, default),
    )


def _loop(table: JSONTable, plants: Mapping[str, JSONTable]) -> LoopMatrices:
    name = table.text("name", "the name of a loop")
    inputs, outputs = table.names("inputs"), table.names("outputs")
    dt, delay = (table.number(key, "a number >= 0, s", least=0.0) for key in ("dt", "delay"))
    if not 1e-9 <= dt <= 1e6:
        raise table.mistake(f"dt must be the sample period, from 1e-9 to 1e6 s, got {given(dt)}")
    plant = plants.get(name)
    return LoopMatrices(
        loop=name,
        design=table.text("design", "the name of a design"),
        method=table.text("method", "the name of a method"),
        delay=delay,
        controller=table.arrays(len(inputs), len(outputs), dt),
        inputs=inputs,
        outputs=outputs,
        plant=None if plant is None else plant.arrays(len(outputs), len(inputs), dt),
    )


def _text(baseline: Baseline) -> str:
    lines = [f'  "{key}": {json.dumps(item)}' for key, item in (("schema", SCHEMA), ("job", baseline.job))]
    lines.append(f'  "tolerance": {json.dumps(_shown(baseline.tolerance, baseline.tolerance))}')
    figures = [json.dumps(_figure_record(one, baseline.tolerance), allow_nan=False) for one in baseline.figures]
    lines.append('  "figures": [\n    ' + ",\n    ".join(figures) + "\n  ]" if figures else '  "figures": []')
    controllers = [_controller_record(loop) for loop in baseline.loops]
    plants = [{"loop": loop.loop, **_matrices(loop.plant)} for loop in baseline.loops if loop.plant is not None]
    for key, entries in (("controllers", controllers), ("plants", plants)):
        lines.append(f'  "{key}": {json_text(entries, "  ")}')
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _figure_record(figure: AcceptedFigure, default: Tolerance) -> dict[str, Any]:
    return {
        "subject": figure.subject,
        "name": figure.name,
        "value": figure.value if math.isfinite(figure.value) else None,
        "unit": figure.unit,
        "sense": figure.sense,
        **({} if figure.tolerance is None else _shown(figure.tolerance, default)),
    }


def _shown(tolerance: Tolerance, default: Tolerance) -> dict[str, float]:
    """Return a tolerance as in the file, in as few keys as `_tolerance` needs."""
    out = {}
    if tolerance.relative or tolerance.absolute == default.absolute:
        out["relative"] = tolerance.relative
    if tolerance is default or tolerance.absolute != default.absolute:
        out["absolute"] = tolerance.absolute
    return out


def _controller_record(loop: LoopMatrices) -> dict[str, Any]:
    return {
        "name": loop.loop,
        "design": loop.design,
        "method": loop.method,
        "dt": loop.controller.dt,
        "delay": loop.delay,
        "inputs": loop.inputs,
        "outputs": loop.outputs,
        **_matrices(loop.controller),
    }


def _matrices(arrays: StateArrays) -> dict[str, Any]:
    return {name: getattr(arrays, name) for name in "ABCD"}
