"""The first paragraph of the report: what was designed, the verdict, and what is nearest to its limit."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.campaign.table import PASSED
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.judging import STABLE, CheckResult
from platform_ctrl.report.page.campaign_tables import causes, contrast_name, drivers_of
from platform_ctrl.report.page.captions import bandwidth_hz, number_word, quoted, sentences
from platform_ctrl.report.page.tables import verdict
from platform_ctrl.verification.verdict import PROVED, JobResult

# Of two ratios to a limit; a smaller difference is not mentioned.
_NOTABLE = 1.05
# Not mentioned as a loss: bandwidth has its own sentence, and the decay rate means little for a stable loop.
_UNCOUNTED = (METRICS["bandwidth"].name, STABLE.name)
# Requirements with margins up to this share limit a loop, beside the one with the smallest.
_NEAR = 0.05
# Requirements of a loop that are named.
_NAMED = 3
# Of more loops than these only the nearest to their limits are described.
_MOST_LOOPS = 4
# No line break between a number and its unit.
_UNIT = re.compile(r"(?<=\d) (?=(?:%|\u00b0|m?rad|k?Hz|m?N m|1/s|s)\b|%)|(?<=[\u2264\u2265]) ")


def compared_with_alternatives(outcome: LoopOutcome) -> list[str]:
    """Return sentences: order and bandwidth compared with the best alternative, and with claimed bounds."""
    return [*_against_others(outcome), *_against_bounds(outcome.closed)]


def _against_others(outcome: LoopOutcome) -> list[str]:
    """Compare with the widest of the alternatives that meet their limits; of all, where none does."""
    closed, own = outcome.closed, bandwidth_hz(outcome.closed)
    others = [design for design in outcome.alternatives if bandwidth_hz(design) > 0.0]
    if not others or own == 0.0:
        return []
    best = max(others, key=lambda design: (design.passed, bandwidth_hz(design)))
    text = sentences("against_others", closed=closed, own=own, best=best, theirs=bandwidth_hz(best))
    return [text, *_largest_cost(closed, best)]


def _largest_cost(closed: LoopDesign, best: LoopDesign) -> list[str]:
    """Name the limit, bandwidth apart, to which `closed` is nearer than `best` by most; nothing below 5 %."""
    theirs = {one.name: one for one in best.results}
    apart = [
        (one.ratio / theirs[one.name].ratio, one)
        for one in closed.results
        if one.name in theirs and theirs[one.name].ratio > 0.0 and not one.name.startswith(_UNCOUNTED)
    ]
    worse, cost = max(apart, key=lambda pair: pair[0], default=(1.0, None))
    if cost is None or not worse > _NOTABLE:
        return []
    return [sentences("largest_cost", cost=cost, other=theirs[cost.name].value)]


def _against_bounds(design: LoopDesign) -> list[str]:
    out = []
    own, claims = bandwidth_hz(design), design.claims
    bound = claims.get("bandwidth_bound_hz", np.nan)
    if np.isfinite(bound) and own > 0.0:
        out.append(sentences("bandwidth_bound", bound=bound, own=own))
    gamma, least = claims.get("gamma", np.nan), claims.get("gamma_optimal", np.nan)
    price = claims.get("price", gamma / least - 1.0 if least > 0.0 else np.nan)
    if np.isfinite(price):
        known = np.isfinite(gamma) and np.isfinite(least)
        out.append(sentences("price", gamma=gamma if known else None, least=least, price=price))
    return out


def opening(result: JobResult, campaign: Summary | None = None) -> list[str]:
    """Return three to six sentences.

    Parameters
    ----------
    result
        From `platform_ctrl.verification.check_job`.
    campaign
        From `platform_ctrl.campaign.summary.summarise`, where there is one.
    """
    found = [_designed(result), _verdict(result), _limits(result), _runs(result)]
    found.insert(3, sentences("together", check=result.coupled, loops=result.loops))
    found.append("" if campaign is None else _campaign(campaign))
    return [_UNIT.sub("\u00a0", one) for one in found if one]


def tightest(results: Sequence[CheckResult]) -> CheckResult | None:
    """Return the requirement that is missed by most, or met by least; None where nothing has a margin.

    Stability and proofs that are met are no measure of how tight a design is.
    """
    counted = [one for one in results if not (one.passed and one.name.startswith((STABLE.name, PROVED.name)))]
    return min(counted, key=lambda one: (one.passed, one.margin), default=None)


def _designed(result: JobResult) -> str:
    given = all(design.method == "given" for outcome in result.loops for design in outcome.designs)
    rate = float(np.linalg.norm(result.job.Omega, np.inf)) if result.job.Omega.size else 0.0
    return sentences("designed", job=result.job, loops=result.loops, given=given, rate=rate)


def _verdict(result: JobResult) -> str:
    if not result.requirements:
        return "There are no requirements."
    missed = sum(not one.passed for one in result.requirements)
    words = verdict(result).replace("requirements met", "requirements are met")
    words = words.replace("not met", "is not met" if missed == 1 else "are not met")
    return sentences("verdict", words=words, worst=tightest(result.requirements), missed=missed)


def _limits(result: JobResult) -> str:
    """Return what limits each loop."""
    found = [(outcome, nearest) for outcome in result.loops if (nearest := tightest(outcome.closed.results))]
    if len(found) > _MOST_LOOPS:
        found = sorted(found, key=lambda pair: (pair[1].passed, pair[1].margin))[:_MOST_LOOPS]
    return f"{'; '.join(_limited(outcome, nearest) for outcome, nearest in found)}." if found else ""


def _limited(outcome: LoopOutcome, nearest: CheckResult) -> str:
    ordered = sorted(outcome.closed.results, key=lambda one: one.margin)
    missed = [one.name for one in ordered if not one.passed]
    others = [f"{number_word(len(missed) - _NAMED)} more"] if len(missed) > _NAMED else []
    near = [one for one in ordered if one.margin <= _NEAR and tightest([one])][:_NAMED]
    own = bandwidth_hz(outcome.closed)
    named = missed[:_NAMED] + others
    return sentences("nearest_limit", outcome=outcome, own=own, missed=named, near=near, nearest=nearest)


def _runs(result: JobResult) -> str:
    if not result.runs:
        return ""
    lost = [run.manoeuvre.name for run in result.runs if not run.trajectory.completed]
    worst = tightest([one for run in result.runs for one in run.results])
    return sentences("nearest_run", runs=result.runs, lost=lost, worst=worst)


def _campaign(summary: Summary) -> str:
    overall = (one for one in summary.sensitivities if one.manoeuvre is None and one.requirement == PASSED)
    drivers = [quoted(name) for one in overall for name in drivers_of(one)[:2]]
    shared = [quoted(contrast_name(one)) for one in causes(summary) if one.in_every_violation]
    return sentences("campaign", statistics=summary.statistics, drivers=drivers, shared=shared)
