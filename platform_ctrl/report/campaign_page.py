"""A campaign's page: everything that it came to, in one file that needs nothing else."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

from platform_ctrl.campaign.identity import identity
from platform_ctrl.campaign.probability import Probability
from platform_ctrl.campaign.rare_result import RareResult
from platform_ctrl.campaign.sensitivity import Sensitivity
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.campaign.table import FIGURES, PASSED
from platform_ctrl.frozen import value
from platform_ctrl.report import campaign_tables as tables
from platform_ctrl.report.document import Plate
from platform_ctrl.report.quantities import MINUS, plain, power_of_ten
from platform_ctrl.report.record import job_data, toml, versions
from platform_ctrl.report.rendering import rendered
from platform_ctrl.writing import write_whole

# Of a small picture beside a number, in pixels.
_SCALE_WIDTH = 150.0
# Violations of a rare event that are shown.
_MOST_PROBABLE = 5


@value
class Scale:
    """A logarithmic scale of probability from 10^−`decades` to 1, `width` pixels wide."""

    decades: int
    width: float = _SCALE_WIDTH

    def at(self, probability: float) -> float:
        """Return where a probability lies, in pixels."""
        place = 1.0 + math.log10(max(probability, 1e-300)) / self.decades
        return round(self.width * min(max(place, 0.0), 1.0), 1)

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Places of the decades that are drawn, and the words of every other one or two of them."""
        step = 1 if self.decades <= 4 else 2
        powers = range(-self.decades, 1)
        return [(self.at(10.0**k), power_of_ten(10.0**k) if k % step == 0 else "") for k in powers]


def write_campaign_page(
    summary: Summary, path: str | os.PathLike[str], *, command: str | None = None, again: str | None = None
) -> Path:
    """Write the page to `path`, whole or not at all.

    Parameters
    ----------
    summary
        From `platform_ctrl.campaign.summary.summarised`.
    path
        The file; one that exists is replaced.
    command
        The command line that made it.
    again
        The command line that flies one run again, without the run's number at its end.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    return write_whole(path, campaign_page(summary, command=command, again=again))


def campaign_page(summary: Summary, *, command: str | None = None, again: str | None = None) -> str:
    """Return the page as HTML: self-contained, for light and dark screens and for paper.

    Parameters
    ----------
    summary, command, again
        As in `write_campaign_page`.
    """
    from platform_ctrl.report import style

    rows = tables.probability_rows(summary)
    groups: dict[str, list[tables.ProbabilityRow]] = {}
    for row in rows:
        # A manoeuvre's name stays as people have to type it.
        everything = row.group == tables.ALL_MANOEUVRES
        heading = row.group[:1].upper() + row.group[1:] if everything else row.group
        groups.setdefault(heading, []).append(row)
    drivers = tables.all_drivers(summary)
    with style.settings():
        content = {
            "summary": summary,
            "job": summary.plan.job,
            "plan": summary.plan,
            "platform": summary.plan.job.platform,
            "found": summary.statistics,
            "flown": tables.count_words(summary.plan.runs),
            "verdict": tables.verdict(summary),
            "lines": tables.verdict_lines(summary),
            "confidence": f"{plain(100.0 * summary.statistics.confidence, 3)} %",
            "groups": groups,
            "scale": _scale([row.numbers for row in rows]),
            "plates": _plates(summary),
            "sensitivities": [
                (
                    tables.requirement_name(one.figure),
                    one,
                    *tables.influence_rows(one),
                    _tied(tables.violation_drivers(one)),
                )
                for one in summary.sensitivities
                if one.manoeuvre is None
            ],
            "within": _within(summary),
            "worst": tables.worst_rows(summary, summary.statistics.worst, drivers),
            "rare": [_rare(summary, one) for one in summary.rare],
            "endings": tables.ending_rows(summary),
            "inputs": tables.input_rows(summary),
            "identity": identity(summary.plan),
            "record": toml(job_data(summary.plan.job)),
            "versions": versions().items(),
            "command": command or "platform-ctrl campaign job.toml",
            "again": again or "platform-ctrl simulate job.toml --run",
        }
    return rendered("campaign.html", content)


def _scale(shown: list[Probability]) -> Scale:
    least = min((one.low or 0.3 * one.high for one in shown if one.runs), default=1e-2)
    return Scale(decades=max(2, min(12, math.ceil(-math.log10(max(least, 1e-12))))))


def _plates(summary: Summary) -> list[Plate]:
    from platform_ctrl.report import campaign_figures as figures
    from platform_ctrl.report import style

    found = summary.statistics
    names = [name for name in FIGURES if any(one.figure == name and one.manoeuvre for one in found.requirements)]
    if not names:
        return []
    drawn = [
        (
            figures.exceedance_figure(found),
            "How far out the runs reach",
            "Share of the runs above a level, the level relative to the limit. Where a line crosses 1 is the "
            "probability of violating it; how steeply it falls there says what a little more margin is worth.",
        )
    ]
    drawn += [
        (
            figures.histogram_figure(found, name),
            FIGURES[name][0].capitalize(),
            "Runs by their figure, red beyond the limit. Runs that diverged have none: they are counted, not drawn.",
        )
        for name in names
    ]
    return [
        Plate(svg=style.svg(one, f"{title}. {caption}"), title=title, caption=caption) for one, title, caption in drawn
    ]


def _within(summary: Summary) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return what drives what inside each manoeuvre: the requirements, and a row of words for each manoeuvre."""
    inside = [one for one in summary.sensitivities if one.manoeuvre is not None]
    figures = [name for name in (*FIGURES, PASSED) if any(one.figure == name for one in inside)]
    rows = []
    for manoeuvre in dict.fromkeys(one.manoeuvre for one in inside):
        own = {one.figure: _drivers(one) for one in inside if one.manoeuvre == manoeuvre}
        rows.append((str(manoeuvre), [own.get(figure, "") for figure in figures]))
    return [tables.requirement_name(figure) for figure in figures], rows


def _drivers(one: Sensitivity) -> str:
    violating = tables.violation_drivers(one)
    return _tied(tables.short_drivers(one) + (f"; its violations: {violating}" if violating else ""))


def _tied(words: str) -> str:
    """Return words in which no line ends between a number and its per cent sign."""
    return words.replace(" %", "\u00a0%")


def _rare(summary: Summary, rare: RareResult) -> dict[str, Any]:
    names = summary.plan.input_names
    shifts = tables.moved(summary.plan, rare)
    largest = max((abs(shift) for _, shift in shifts), default=0.0) or 1.0
    shown = rare.violations[:_MOST_PROBABLE]
    inputs = [summary.plan.inputs_at(one.u[None, :]) for one in shown]
    points = [
        ("distance", [f"{one.distance:.2f} σ" for one in shown]),
        ("over limit", ["diverged" if math.isinf(one.ratio) else plain(one.ratio, 4) for one in shown]),
        *((name, [tables.input_words(one[name][0].item()) for one in inputs]) for name in names),
        ("noise of run", [f"{one.run}" for one in shown]),
    ]
    return {
        "words": tables.rare_words(rare),
        "rows": tables.rare_rows(rare),
        "moved": [(name, f"{shift:+.1f}".replace("-", MINUS), shift / largest) for name, shift in shifts],
        "points": points if shown else [],
        "levels": [[plain(float(level), 3) for level in one.levels] for one in rare.repetitions],
        "repetitions": rare.repetitions,
        "chances": [tables.chance(one.probability) for one in rare.repetitions],
    }
