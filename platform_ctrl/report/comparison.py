"""The designs of a loop side by side: limits and goals, metrics, proofs, claims, options, controllers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence

from platform_ctrl.analysis.loop_metrics import ALWAYS_MEASURED, LoopMetrics
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import Group as PlantGroup
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.design.loop import Design, LoopOutcome
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.quantities import (
    BOUND,
    DASH,
    MET,
    NOT_MET,
    claimed,
    compared,
    count,
    listed,
    percent,
    plain,
    quantity,
)
from platform_ctrl.job.requirements import GOAL, SCOPE_WORDS, SCOPES, of_readings, requirement
from platform_ctrl.report.blocks import Cell, Column, Group, Row, Table, cells, table
from platform_ctrl.verification.proofs import Proofs
from platform_ctrl.verification.verdict import JobResult

_MARGIN = METRICS["disk margin"].name
_GROUPS: dict[PlantGroup, tuple[str, str]] = {
    "nominal": ("nominal", "the nominal one"),
    "uncertainty": ("parameter uncertainty", "{} of the parameter uncertainty"),
    "Omega": ("platform rates", "{} with a platform rate"),
    "angles": ("gimbal angles", "{} at other gimbal angles"),
    "friction": ("dry friction", "{} with dry friction"),
    "faults": ("faults", "{} with a fault"),
}


def design_table(result: JobResult, outcome: LoopOutcome) -> Table:
    """Return the designs of a loop side by side; the column of the one that is closed counts."""
    designs = outcome.designs
    sections = {
        "limits, measured on the closed loop": [
            _judged(name, found, lambda one: _checked(one.passed, _number(one)))
            for name, found in _results([design.results for design in designs])
        ],
        "goals, not part of the verdict": [
            _judged(name.removeprefix(GOAL), found, _goal) for name, found in _results([one.goals for one in designs])
        ],
        "measured, without a limit": measured_rows(outcome),
        "proved in interval arithmetic": proof_rows(designs, result.proofs),
        "claimed by the method": _by_name([dict(claimed(*one) for one in design.claims.items()) for design in designs]),
    }
    return _table_of_designs(outcome, sections)


def option_table(outcome: LoopOutcome) -> Table:
    """Return the options that the designs of a loop were made with, and their controllers, side by side."""
    sections = {
        "options used": _by_name([_options(design) for design in outcome.designs]),
        "controller": _by_name([signals(design) for design in outcome.designs]),
    }
    return _table_of_designs(outcome, sections)


def _table_of_designs(outcome: LoopOutcome, sections: dict[str, list[Row]]) -> Table:
    limited = any(row.cells[1].text for rows in sections.values() for row in rows)
    columns = [Column(title="design"), *([Column(title="limit", number=True)] if limited else [])]
    for design in outcome.designs:
        closed = design.name == outcome.use
        tag = f"{design.method}, closed" if closed else design.method
        columns.append(Column(title=design.name, tag=tag, number=True, strong=closed))
    if not limited:
        sections = {
            title: [dataclasses.replace(row, cells=(row.cells[0], *row.cells[2:])) for row in rows]
            for title, rows in sections.items()
        }
    groups = tuple(Group(title=title, rows=tuple(rows), quiet=True) for title, rows in sections.items() if rows)
    return Table(columns=tuple(columns), groups=groups, form="designs")


def _goal(one: CheckResult) -> Cell:
    """Return whether a goal is reached, or by how much it is missed, which is no failure."""
    return _checked(True, _number(one)) if one.passed else Cell(text=f"{_number(one)} ({percent(one.margin)})")


def _checked(met: bool, words: str) -> Cell:
    return Cell(text=f"{MET if met else NOT_MET} {words}", tone="good" if met else "bad")


def _number(one: CheckResult) -> str:
    """Return the value in the unit of the limit beside it."""
    text, limit = compared(one)
    unit = limit.partition(" ")[2]
    return text.removesuffix(f" {unit}") if unit else text


def _results(columns: Sequence[Sequence[CheckResult]]) -> list[tuple[str, list[CheckResult | None]]]:
    names = dict.fromkeys(one.name for results in columns for one in results)
    return [(name, [next((one for one in r if one.name == name), None) for r in columns]) for name in names]


def _judged(name: str, found: Sequence[CheckResult | None], cell: Callable[[CheckResult], Cell]) -> Row:
    first = next(one for one in found if one is not None)
    limit = f"{BOUND[first.sense]} {compared(first)[1]}"
    return Row(cells=(*cells(name, limit), *(Cell(text=DASH) if one is None else cell(one) for one in found)))


def measured_rows(outcome: LoopOutcome) -> list[Row]:
    """Return the metrics of every design that have no limit."""
    required = {one.name for design in outcome.designs for one in design.results}
    measured = [
        {} if design.measures is None else _measured(design.measures, outcome.spec.kind) for design in outcome.designs
    ]
    return [row for row in _by_name(measured) if row.cells[0].text not in required]


def _measured(metrics: LoopMetrics, loop: str) -> dict[str, str]:
    """Return the worst value of every metric that is always measured, by the names of its limits."""
    out = {}
    for kind in ALWAYS_MEASURED:
        metric = METRICS[kind]
        for scope in metric.scopes:
            if scope and metrics.of(SCOPES[scope]).sum() < 2:
                continue
            values = metric.in_unit(metrics.values(MetricRequest(kind=kind, over=SCOPES[scope])))
            at_least = metric.sense == "at least"
            worst = float(values.min() if at_least else values.max(initial=0.0))
            name, unit = (of_readings(words, loop) for words in (metric.name, metric.unit))
            out[name + SCOPE_WORDS[scope]] = quantity(worst, unit, rounding="down" if at_least else "up")
    return out


def proof_rows(designs: Sequence[Design], proofs: Mapping[tuple[str, str], Proofs]) -> list[Row]:
    """Return of every design what is proved with how many plants; no rows where no proofs were asked for."""
    return _rows([_proved(proofs.get((design.loop, design.name), Proofs())) for design in designs])


def _proved(proofs: Proofs) -> dict[str, Cell]:
    out = {}
    for kind, name, unit in (("stability", METRICS["stability"].name, "1/s"), ("disk margin", _MARGIN, "")):
        claims = [one for one in proofs.claims if one.kind == kind]
        shown = [one for one in claims if one.proved]
        if shown:
            least = quantity(min(one.bound for one in shown), unit, 3, rounding="down")
            part = "all" if len(shown) == len(claims) else f"{len(shown)} of"
            out[name] = _checked(len(shown) == len(claims), f"≥ {least} with {part} {len(claims)} plants")
    return out


def plants_in_words(plants: PlantSet) -> str:
    """Return how many plants there are of each group, in words."""
    parts = [
        words.format(number)
        for group, (_, words) in _GROUPS.items()
        if (number := sum(one == group for one in plants.groups))
    ]
    return f"{count(len(plants.labels), 'plant')}: {listed(parts)}" if len(parts) > 1 else "the nominal plant alone"


def group_table(design: Design) -> Table | None:
    """Return for each group of plants that a design must work with how many they are, and the least of what counts.

    That are decay, damping and disk margin, the latter with the plant in which it is. None: there is one group.
    """
    plants, measures = design.plants, design.measures
    if plants is None or measures is None or len(set(plants.groups)) == 1:
        return None
    rows = []
    for group, (name, _) in _GROUPS.items():
        chosen = measures.of((group,))
        if not chosen.any():
            continue
        margin, where = float(measures.disk_margin[0]), ""
        if group != "nominal":
            worst = requirement("disk margin", 1.0, over=(group,)).result(plants, measures)
            margin, where = worst.value, worst.where
        rows.append(
            (
                name,
                str(int(chosen.sum())),
                quantity(float(measures.decay[chosen].min()), "1/s", rounding="down"),
                plain(float(measures.damping[chosen].min()), rounding="down"),
                plain(margin, rounding="down"),
                where,
            )
        )
    numbers = "|".join(["plants", *(METRICS[kind].name for kind in ("stability", "damping", "disk margin"))])
    return table(f"group|{numbers}|with", rows, numbers=numbers, form="narrow")


def signals(design: Design) -> dict[str, str]:
    """Return a controller's inputs and outputs, its order and sample period, in words."""
    K = design.controller
    return {
        "inputs": ", ".join(K.input_labels),
        "outputs": ", ".join(K.output_labels),
        "order and sample period": f"{count(K.nstates, 'state')}, {plain(1e3 * float(K.dt or 0.0))} ms",
    }


def _options(design: Design) -> dict[str, str]:
    return {name: plain(number) for name, number in design.options.items()}


def _by_name(columns: Iterable[dict[str, str]]) -> list[Row]:
    return _rows([{name: Cell(text=text) for name, text in column.items()} for column in columns])


def _rows(columns: Sequence[dict[str, Cell]]) -> list[Row]:
    names = dict.fromkeys(name for column in columns for name in column)
    none = Cell(text=DASH)
    return [Row(cells=(*cells(name, ""), *(column.get(name, none) for column in columns))) for name in names]
