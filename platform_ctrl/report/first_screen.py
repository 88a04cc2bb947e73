"""The first screen of the report: the verdict, what limits each loop, how far that is, and what to change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.design.loop import Design, LoopOutcome
from platform_ctrl.design.methods import METHODS
from platform_ctrl.job.judging import CheckResult, tightest
from platform_ctrl.job.quantities import BOUND, compared, count, listed, percent, plain
from platform_ctrl.report import blocks as page
from platform_ctrl.report import tables
from platform_ctrl.report.captions import sentences
from platform_ctrl.report.figures.nichols import nichols_figure
from platform_ctrl.verification.changes import Change
from platform_ctrl.verification.verdict import JobResult

if TYPE_CHECKING:
    from platform_ctrl.campaign.summary import Summary

# Of the axis of distances: the part beyond the limit that is shown where nothing is missed; width of a mark.
_BEYOND, _MARK = 0.15, 0.0225
_TICKS = (-1.0, -0.25, -0.05, 0.05, 0.25, 1.0)


def first_screen(result: JobResult, campaign: Summary | None) -> tuple[page.Block, ...]:
    """Return verdict, what limits each loop, and distances, beside a Nichols plot of the tightest loop if there is one.

    Where a run of a campaign violates a limit, the verdict is no pass.
    """
    left = (
        _verdict(result, campaign),
        *page.made("What limits each loop", lambda: chain_table(result)),
        *page.made("Distances to the limits", lambda: distances(result)),
    )
    picture = _nichols(result)
    return (page.Columns(left=left, right=picture),) if picture else left


def _verdict(result: JobResult, campaign: Summary | None) -> page.Verdict:
    goals = tables.goal_rows(result)
    missed = [row for row in tables.requirement_rows(result) if not row.checked.passed]
    reached = sum(goal.checked.passed for goal in goals)
    asides = [page.sentence(f"{result.assumptions}.")] if result.assumptions else []
    asides += [f"{reached} of {count(len(goals), 'goal')} reached; goals are not part of the verdict."] if goals else []
    passed, words = tables.verdict(result, campaign)
    lines = tuple(row.words for row in missed)
    return page.Verdict(passed=passed, words=page.sentence(words), lines=lines, aside=" ".join(asides))


def chain_table(result: JobResult) -> page.Table | None:
    """Return for each loop its tightest requirement, and the plant in which it is."""
    rows = []
    for outcome in result.loops:
        nearest = tightest(own_results(result, outcome))
        if nearest is None:
            continue
        number, limit = compared(nearest)
        tone = "" if nearest.passed else "bad"
        shown = (
            page.Cell(text=outcome.spec.name, note=outcome.use),
            page.Cell(text=nearest.name, note=f"with {nearest.where}" if nearest.where else ""),
            page.Cell(text=percent(nearest.margin), note=f"{number} {BOUND[nearest.sense]} {limit}", tone=tone),
        )
        rows.append(page.Row(cells=shown, missed=not nearest.passed))
    if not rows:
        return None
    titles = page.columns("loop|limited by|margin", numbers="margin")
    return page.Table(columns=titles, groups=(page.Group(rows=tuple(rows)),), form="chain")


def own_results(result: JobResult, outcome: LoopOutcome) -> list[CheckResult]:
    """Return the requirements of a loop, and of nothing else that has its name."""
    of_design = outcome.closed.plants is not None
    return [one for one in result.requirements if one.subject == outcome.spec.name and (one.design or not of_design)]


def distances(result: JobResult) -> tuple[page.Block, ...]:
    """Return a mark for each requirement at the root of its relative distance to the limit, missed ones at the left."""
    shown = tables.requirement_rows(result)
    if not shown:
        return ()
    # What has no margin, as where a loop is unstable, is furthest away.
    places = [_place(row.share if row.margin else 1.0 if row.checked.passed else -1.0) for row in shown]
    low = min(-_BEYOND, *places)
    order = sorted(range(len(shown)), key=lambda k: places[k])
    scaled = [(place - low) / (1.0 - low) for place in places]
    levels = dict(zip(order, _levels([scaled[k] for k in order]), strict=True))
    marks = tuple(
        page.Distance(
            at=round(scaled[k], 4),
            level=levels[k],
            words=row.words + (f", margin {row.margin}" if row.margin else ""),
            row=tables.row_name(k),
            passed=row.checked.passed,
        )
        for k in order
        for row in (shown[k],)
    )
    ticks = [(0.0, "0"), *((x, f"{100.0 * x:+g}".replace("-", "\u2212") + "\u00a0%") for x in _TICKS)]
    inside = sorted(((_place(x) - low) / (1.0 - low), words) for x, words in ticks if _place(x) >= low - 1e-9)
    missed = sum(not row.checked.passed for row in shown)
    words = (
        f"{count(len(shown), 'requirement')} by their distance to the limit, relative to the limit; {missed} not met"
    )
    axis = page.Distances(words=words, marks=marks, ticks=tuple(inside), limit=-low / (1.0 - low))
    return page.Paragraph(text=sentences("distances"), tone="quiet"), axis


def _place(margin: float) -> float:
    """Return the signed root: close to the limit distances can be distinguished."""
    return math.copysign(math.sqrt(abs(margin)), margin)


def _levels(places: Sequence[float]) -> list[int]:
    """Return for ascending places the lowest row of marks in which each covers no other."""
    ends: list[float] = []
    out = []
    for place in places:
        level = next((k for k, end in enumerate(ends) if place >= end), len(ends))
        ends[level : level + 1] = [place + _MARK]
        out.append(level)
    return out


def tightest_loop(result: JobResult) -> LoopOutcome | None:
    """Return the loop with plants whose requirement is missed by most, or met by least."""
    found = [
        (nearest.passed, nearest.margin, k)
        for k, outcome in enumerate(result.loops)
        if outcome.closed.plants is not None and (nearest := tightest(outcome.closed.results)) is not None
    ]
    return result.loops[min(found)[2]] if found else None


def _nichols(result: JobResult) -> tuple[page.Block, ...]:
    outcome = tightest_loop(result)
    if outcome is None:
        return ()
    design = outcome.closed
    assert design.plants is not None
    assert design.measures is not None
    k = worst_plant(design)
    caption = sentences(
        "worst_plant",
        loop=outcome.spec.name,
        design=design.name,
        label=design.plants.labels[k],
        nominal=k == 0,
        margin=float(design.measures.disk_margin[k]),
        stable=bool(np.all(design.measures.decay[k] > 0.0)),
    )
    return page.drawn("Tightest loop, worst plant", lambda: nichols_figure(outcome, k), caption)


def worst_plant(design: Design) -> int:
    """Return the plant of the set with the smallest disk margin, or that is furthest from stable."""
    assert design.measures is not None
    decay, margin = design.measures.decay, design.measures.disk_margin
    return int(np.argmin(decay)) if not np.all(decay > 0.0) else int(np.argmin(margin))


def section_verdict(results: Sequence[CheckResult]) -> tuple[str, bool]:
    """Return what stands beside the title of a section with these results: words and whether all are met."""
    hard = [one for one in results if one.hard]
    if not hard:
        return "", True
    missed = [one.name for one in hard if not one.passed]
    if missed:
        return f"{len(missed)} of {len(hard)} not met: {listed(list(dict.fromkeys(missed))[:3])}", False
    nearest = tightest(hard)
    least = "" if nearest is None else f", tightest {percent(nearest.margin)}"
    return f"{'all ' if len(hard) > 1 else ''}{len(hard)} met{least}", True


def change_part(result: JobResult, rows: tuple[Change, ...]) -> tuple[page.Block, ...]:
    """Return the rows under their heading; nothing for a job that meets its requirements."""
    missed = [one for one in result.requirements if not one.passed]
    if not missed:
        return ()
    tuned = {(spec.name, one.name) for spec in result.job.loops for one in spec.designs if one.tune}
    words = sentences("what_to_change", rows=rows)
    more = sentences(
        "changes_measured",
        rows=rows,
        runs=sum(one.stage == "simulated" for one in missed),
        tuned=any((one.loop, one.design) in tuned for one in rows if one.kind == "option"),
    )
    first, notes = (page.Paragraph(text=text, tone="quiet") for text in (words, more))
    blocks: list[page.Block] = [first, _change_table(rows)] if rows else [first]
    if notes.text:
        blocks.append(notes)
    return (page.Subsection(title="What to change", blocks=tuple(blocks)),)


def _change_table(rows: tuple[Change, ...]) -> page.Table:
    body = tuple(
        page.Row(
            cells=(
                page.Cell(text=one.target.before.name, note=one.target.before.subject),
                _change(one),
                page.Cell(
                    text=_moved(one.target.before, one.target.after),
                    note=_margins(one.target.before, one.target.after),
                    tone="good" if one.target.after.passed and not one.target.before.passed else "",
                ),
                _cost(one),
            ),
            missed=not one.target.before.passed,
        )
        for one in rows
    )
    return page.Table(
        columns=page.columns("requirement|change|gain|cost"), groups=(page.Group(rows=body),), form="changes"
    )


def _change(one: Change) -> page.Cell:
    if one.kind == "design":
        return page.Cell(text=f"close “{one.name}”", note=f"{one.loop}: a design of this job")
    where = f"{one.loop}, {one.design}"
    method = next((kind for kind in METHODS.values() if kind.instant and one.name in kind.options), None)
    unit = "" if method is None else f" {method.options[one.name].unit}"
    return page.Cell(text=f"{one.name} {plain(one.before)} → {plain(one.after)}{unit}".rstrip(), note=where)


def _cost(one: Change) -> page.Cell:
    if one.violated:
        worst = one.violated[0]
        number, limit = compared(worst.after)
        way = "below" if worst.after.sense == "at least" else "above"
        others = len(one.violated) - 1
        more = f"; {others} more violated" if others else ""
        return page.Cell(
            text=f"{worst.after.name} {compared(worst.before)[0]} → {number}: {way} {limit}",
            note=f"{_other_loop(one, worst.after)}{_margins(worst.before, worst.after)}{more}",
            tone="bad",
        )
    if one.loss is None:
        return page.Cell(text="none", tone="quiet")
    before, after = one.loss.before, one.loss.after
    note = f"{_other_loop(one, after)}{_margins(before, after)}: within its limit"
    return page.Cell(text=f"{after.name} {_moved(before, after)}", note=note)


def _other_loop(one: Change, result: CheckResult) -> str:
    return "" if result.subject == one.target.before.subject else f"{result.subject}: "


def _moved(before: CheckResult, after: CheckResult) -> str:
    return f"{compared(before)[0]} → {compared(after)[0]}"


def _margins(before: CheckResult, after: CheckResult) -> str:
    return f"margin {percent(before.margin)} → {percent(after.margin)}"
