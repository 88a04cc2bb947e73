"""The parts of the page that follow its settings, as HTML: strip, selectors, margins, sliders, table, budget.

Each part is a column of a Bokeh source (`tasks.PageState`), of which those that have changed are sent; in the browser
elements that are equal stay. Bokeh's own elements were measured instead. A `Div` replaces its content as a whole, and
with it the focus, the slider that is being dragged and what was scrolled; it stands in a shadow root, which labels and
descriptions elsewhere on the page do not reach. `bokeh.models.dom` needs a model for each of 620 elements: a page
takes .4 s longer to make, and a move of a slider sends 46 messages in place of one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.app.backend import Backend
from platform_ctrl.app.job_parts import BUDGET, BudgetState, ChipState
from platform_ctrl.app.loops import LATER
from platform_ctrl.app.pictures import Margins, Picture
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.tuning import SHARE, OptionEffects, OptionValue, candidates
from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.quantities import BOUND, DASH, HZ, MINUS, compared, count, percent, plain
from platform_ctrl.verification.budget_result import left_to_runs

if TYPE_CHECKING:
    from jinja2 import Environment

# Why the page has no verdict on a limit of the budget that is `left_to_runs`.
_BY_RUNS = "check judges it by runs: with this dry friction the linear budget does not hold"
# Least share of its ratio by which a step has to help a requirement.
_LEAST_GAIN = 5e-3
# Changes of a ratio by a move of 5 %: one that has no arrow, and one that has the full colour.
_LEAST, _MOST = 0.002, 0.1
# Shares of a mean square that count as zero.
_ROUNDING = 1e-12
# How far to both sides of a slider limits are judged by slopes.
_FARTHEST = 0.3
_GROUPS = {
    "main": "Speed and robustness", "gains": "Gains", "lead": "Lead and lag", "lag": "Lag", "notch": "Notch",
    "design": "Design",
}  # fmt: skip


@cache
def templates() -> Environment:
    """Return the templates of the page."""
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("platform_ctrl.app", "page")
    return Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)


def fragment(name: str, /, **given: Any) -> str:
    """Return what a macro of the page's fragments writes."""
    return str(getattr(templates().get_template("fragments.html").module, name)(**given))


def number(x: float | None, digits: int = 3) -> str:
    """Return a number as the page shows it: a dash for none."""
    if x is None or math.isnan(x):
        return DASH
    return plain(x, digits) if math.isfinite(x) else "∞" if x > 0.0 else f"{MINUS}∞"


def selectors(backend: Backend, settings: Settings, view: str) -> str:
    """Return the lists that say what is shown; `view` is empty where the job has no budget."""
    # The first loop of each kind, the one that is shown in place of its own.
    every = (*reversed(backend.read.loops), backend.loops.spec(settings.loop))
    modes = {one.has_plants: one.name for one in every}
    choices = {**backend.choices(settings), "mode": [modes[True], modes[False]] if len(modes) == 2 else []}
    return fragment("selectors", settings=settings, choices=choices, view=view)


def strip(states: Sequence[ChipState], said: Mapping[str, ChipState], loop: str) -> str:
    """Return the strip of the whole job: a line about all limits, and a chip for each part; `loop` is shown.

    A chip that is being measured shows what is `said` of it, dimmed.
    """
    verdict, words = job_verdict(states)
    chips = [_chip(said.get(one.chip.key, one), loop) | {"measuring": one.measuring} for one in states]
    return fragment("strip", verdict=verdict, words=words, chips=chips)


def job_verdict(states: Sequence[ChipState]) -> tuple[str, str]:
    """Return the verdict on the whole job, and a line about it."""
    count, checked, missed = (sum(getattr(one, of) for one in states) for of in ("count", "checked", "missed"))
    checking = any(one.measuring for one in states)
    left = ", checking ..." if checking else f", {count - checked} not checked" if checked < count else ""
    if missed:
        return "bad", f"{missed} of {count} missed{left}"
    if not checked and checking:
        return "open", f"Checking {count} limits ..."
    return ("open", f"{checked} of {count} met{left}") if left else ("good", f"All {count} limits met")


def _least(worst: CheckResult) -> str:
    """Return the margin of a chip, or why there is none."""
    if not worst.valid:
        return "not valid"
    return percent(worst.margin) if math.isfinite(worst.margin) else compared(worst)[0]


def _chip(one: ChipState, loop: str) -> dict[str, Any]:
    chip, worst = one.chip, one.worst
    whole = one.checked >= one.count and not one.error
    short = "not run" if one.on_request else DASH if one.error else "…" if one.count else "no limits"
    if one.error:
        words = one.error
    elif worst is None:
        runs = "judged by the runs of check" if chip.key == BUDGET else "not simulated for these settings"
        words = f"{count(one.count, 'limit')}, {runs if one.on_request else 'not measured'}"
    else:
        met = f"{one.missed} of {one.count} missed" if one.missed else f"{one.checked} of {one.count} met"
        words = f"{met}; nearest limit: {worst.name}" + (f", {worst.subject}" if worst.subject != chip.label else "")
        words += "" if worst.valid else f"; {worst.reason}"
    return {
        **chip._asdict(),
        "verdict": "bad" if one.missed else "good" if whole else "open",
        "margin": short if worst is None else _least(worst),
        "words": words,
        "shown": bool(chip.loop) and chip.loop == loop and chip.key.startswith("loop "),
    }


def figures(picture: Picture, caged: bool) -> str:
    """Return the verdict on the loop that is shown, and its margins."""
    verdict, words, more = loop_verdict(picture)
    numbers = _numbers(picture.measured.margins, picture.stable, caged)
    return fragment("figures", verdict=verdict, words=words, more=more, numbers=numbers)


def loop_verdict(picture: Picture) -> tuple[str, str, str]:
    """Return the verdict on the loop that is shown, in words, and what they rest on."""
    if not picture.stable:
        return "bad", "Unstable", f"plant shown: {picture.settings.plant}"
    measured = [one for one in picture.requirements if one.reason != LATER]
    missed, count = [one.name for one in measured if not one.passed], len(measured)
    if not picture.all_stable:
        return "bad", "Unstable for a plant of the set", picture.measured.margins.worst_plant
    if missed:
        return "bad", f"{len(missed)} of {count} missed", ", ".join(missed)
    if count == 0:
        return "good", "Stable", "this loop has no requirements"
    least = min(measured, key=lambda one: one.margin)
    # What lies between the frequencies of a grid is no verdict. The job's own verdict stands in the strip.
    sampled = any(one.method == "sampled" for one in measured)
    left = f"nearest limit: {least.name}, {100 * least.margin:.1f} %"
    met = "limit is" if count == 1 else "limits are"
    left += f"; {picture.requirements[-1].name} is {LATER}" if len(measured) < len(picture.requirements) else ""
    return "good", f"This loop's {met} met" + ", sampled" * sampled, left


# What the numbers are of, stabilised and caged: channels, angles, and what poles have to be faster than to count.
_OF = (
    ("broken at the torquer that is shown, all others closed", "the platform's axes", "crossover"),
    ("all channels of the loop at once", "all angles of the loop", "loop's reference frequency"),
)


def _numbers(margins: Margins, stable: bool, caged: bool) -> list[tuple[str, str, str, str, bool]]:
    channels, axes, above = _OF[caged]
    sampled = margins.worst_sampled
    worst = f"Disk margin of {margins.worst_plant}" + ", the least at the frequencies of a grid" * sampled
    damping = f"Least of the closed-loop poles beyond a tenth of the {above}"
    crossover = None if margins.crossover is None else HZ * margins.crossover
    # Label, value, unit, what it is, whether it is bad.
    rows: tuple[tuple[str, float | str | None, str, str, bool], ...] = (
        ("Disk margin, shown", margins.disk, "", f"Of the plant shown, {channels}", not stable),
        ("Disk margin, worst" + ", sampled" * sampled, margins.worst_disk, "", worst, margins.worst_disk <= 0.0),
        ("Gain margin", _decibels(margins), "dB", "How far the shown channel's gain may rise and fall", False),
        ("Phase margin", margins.phase, "°", "What the shown channel may lose", False),
        ("Delay margin", 1e3 * margins.delay, "ms", "How much later the torque may come", False),
        ("Crossover of L", crossover, "Hz", "Highest frequency at which the shown channel's gain is 1", False),
        ("Bandwidth", HZ * margins.bandwidth, "Hz", f"S of {axes} reaches 1/√2", False),
        ("Damping", margins.damping, "", damping, margins.damping <= 0.0),
    )
    # Of a loop that is not stable the others have no meaning.
    known = ("Disk", "Crossover", "Damping") if not stable else ""
    return [
        (label, x if isinstance(x, str) else number(x if label.startswith(known) else None), unit, tip, bad)
        for label, x, unit, tip, bad in rows
    ]


def _decibels(margins: Margins) -> str | None:
    if not margins.gain_up > 0.0:
        return None
    up = "∞" if math.isinf(margins.gain_up) else f"{20 * math.log10(margins.gain_up):.1f}"
    down = f"{MINUS}∞" if margins.gain_down <= 0.0 else f"{20 * math.log10(margins.gain_down):.1f}".replace("-", MINUS)
    return f"+{up} {down}"


def sliders(backend: Backend, settings: Settings, effects: OptionEffects | None) -> str:
    """Return the sliders by group, an added section under its own name, and the buttons that add sections.

    `effects` are those of these settings, or None: with them the sliders show where all requirements are met.
    """
    parts = {one.name: one for one in backend.parts(settings)}
    groups = []
    for name, each in groupby(backend.sliders(settings), lambda one: one.part or one.group):
        part, rows = parts.get(name), [(one, admissible(effects, one.name)) for one in each]
        label = _GROUPS[name] if part is None else part.label
        groups.append({"name": name, "label": label, "part": "" if part is None else name, "sliders": rows})
    main = groups.pop(0) if groups and groups[0]["name"] == "main" else None
    return fragment("sliders", main=main, groups=groups, missing=[one for one in parts.values() if not one.on])


def admissible(effects: OptionEffects | None, slider: str) -> tuple[float, float]:
    """Return by which shares a slider may move down and up until a requirement is missed, as far as slopes tell.

    Both are 0 where one is missed now.
    """
    if effects is None or slider not in effects.options or not np.all(effects.ratios <= 1.0):
        return 0.0, 0.0
    slopes = np.nan_to_num(effects.change[:, effects.options.index(slider)] / SHARE, nan=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = (1.0 - effects.ratios) / slopes
    low, high = room[slopes < 0.0].max(initial=-_FARTHEST), room[slopes > 0.0].min(initial=_FARTHEST)
    return float(low), float(high)


def next_step(effects: OptionEffects | None, every: Sequence[Slider]) -> dict[str, Any]:
    """Return the move of a slider by 5 % after which the tightest requirement is met best, by slopes, as a sentence."""
    if effects is None:
        return {"words": "Working out the next step …"}
    if not effects.requirements:
        return {"words": ""}
    at = int(np.argmax(effects.ratios))
    tightest, ratio = effects.requirements[at], float(effects.ratios[at])
    free = [
        OptionValue(name=one.name, value=one.value, low=one.low, high=one.high)
        for one in every
        if one.name in effects.options and one.tunable and not one.fixed and one.value
    ]
    for name, after in candidates(effects, free, moves=(-SHARE, SHARE))[:1]:
        slider = next(one for one in every if one.name == name)
        change = float(effects.change[at, effects.options.index(name)]) / SHARE * (after / slider.value - 1.0)
        if change < -_LEAST_GAIN * ratio:
            way = "Raise" if after > slider.value else "Lower"
            to = f"{after:.4g} {slider.unit}".rstrip()
            return {"words": f"{way} {slider.label} to {to} for {tightest}.", "slider": name, "value": after}
    words = f"No single slider helps {tightest}." if free else f"No slider is free to help {tightest}."
    return {"words": words}


def table(
    results: Sequence[CheckResult],
    every: Sequence[Slider],
    effects: OptionEffects | None,
    names: Mapping[tuple[str, str], str],
    stale: bool,
    spec: BudgetSpec | None,
) -> str:
    """Return the table of requirements: the `names` of limits that a job states, and what each slider does to each row.

    `effects` may be those of the settings before, which is `stale`.
    """
    rows = []
    for one in results:
        # Roots, so that the last per cent before a limit can be seen.
        room = one.margin if math.isfinite(one.margin) else -1.0 if one.valid else 0.0
        bar = math.copysign(math.sqrt(min(1.0, abs(room))), room)
        cells = [_cell(slider, one.name, effects) for slider in every]
        more = {"left": 50.0 + 50.0 * min(bar, 0.0), "width": max(0.8, 50.0 * abs(bar)), "cells": cells}
        own = {"limit": f"{one.limit:.10g}", "limit_name": names.get((one.subject, one.name), "")}
        rows.append(_row(one, spec) | own | more)
    return fragment("table", sliders=every, rows=rows, stale=stale)


def tightest_first(results: Sequence[CheckResult]) -> list[CheckResult]:
    """Return results in the order of the table: missed ones first, goals last."""

    def room(one: CheckResult) -> tuple[bool, bool, float]:
        return not one.hard, bool(one.passed), one.margin if not math.isnan(one.margin) else -math.inf

    return sorted(results, key=room)


def _row(one: CheckResult, spec: BudgetSpec | None) -> dict[str, Any]:
    reached, required = compared(one)
    open_, later = left_to_runs(one, spec), one.reason == LATER
    return {
        "name": one.name,
        "full": f"{one.subject}, {one.design}: {one.name}" if one.design else f"{one.subject}: {one.name}",
        "required": f"{BOUND[one.sense]} {required}",
        "reached": "…" if later else reached,
        "margin": "by runs" if open_ else percent(one.margin),
        "why": _BY_RUNS if open_ else one.reason,
        "state": "met" if one.passed else "open" if open_ or later else "missed",
        "hard": one.hard,
        "method": one.method,
    }


def _cell(slider: Slider, requirement: str, effects: OptionEffects | None) -> dict[str, Any]:
    """Return which way to move a slider to help a requirement, and how much a move of 5 % is worth."""
    known = effects is not None and requirement in effects.requirements and slider.name in effects.options
    if effects is None or not known:
        return {"slider": slider.name, "arrow": "", "words": ""}
    at = effects.requirements.index(requirement), effects.options.index(slider.name)
    change = float(effects.change[at])
    size = abs(change) if math.isfinite(change) else 0.0 if math.isnan(change) else _MOST
    worse = change > 0.0
    if size < _LEAST:
        words = f"{requirement}: next to nothing"
    elif math.isinf(change):
        words = "the loop becomes unstable"
    else:
        way = "worse" if worse else "better"
        words = f"{requirement}: {way} by {plain(100.0 * size, 2)} % in the ratio to its limit"
    return {
        "slider": slider.name,
        "arrow": "" if size < _LEAST else "↓" if worse else "↑",
        "colour": "down" if worse else "up",
        "strength": round(0.1 + 0.45 * min(1.0, math.log(max(size, _LEAST) / _LEAST) / math.log(_MOST / _LEAST)), 3),
        "words": f"{slider.label} + 5 %: {words}",
    }


def budget(state: BudgetState, spec: BudgetSpec | None) -> str:
    """Return the table of the line of sight's budget, µrad: sources by axis, all together, and the limits."""
    found = state.found
    if found is None:
        return fragment("budget", line=state.line, exact=state.exact, axes=[], rows=[], limits=[], friction=[])

    def cells(rms: FloatArray, shares: FloatArray, digits: int) -> list[tuple[str, str]]:
        # Rounding shows in axes on which a source does not act.
        return [
            (number(1e6 * x if share > _ROUNDING else 0.0, digits), f"{plain(100.0 * share, 3)} % of the mean square")
            for x, share in zip(rms.tolist(), shares.tolist(), strict=True)
        ]

    rows = [
        {"name": name, "kind": kind, "cells": cells(rms, shares, 3)}
        for name, kind, rms, shares in zip(found.names, found.kinds, found.rms, found.shares, strict=True)
    ]
    words = "all together, at the angles zero; limits are at the worst angles of the job"
    rows.append({"name": "all, angles zero", "kind": words, "cells": cells(found.total, np.ones(len(found.total)), 4)})
    limits = [
        _row(one, spec) | {"reached": number(1e6 * one.value, 4), "required": f"≤ {number(1e6 * one.limit, 4)}"}
        for one in found.results
    ]
    friction = found.friction.statement
    return fragment(
        "budget", line=state.line, exact=state.exact, axes=found.axes, rows=rows, limits=limits, friction=friction
    )
