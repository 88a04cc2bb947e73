"""The limits of a job's budget, compared with what the line of sight does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.dry_friction import FrictionBalance
from platform_ctrl.analysis.metrics import BUDGET_METRICS
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.job.budget import Budget
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult, Requirement
from platform_ctrl.plant.sensors import LOS_ANGLES

if TYPE_CHECKING:
    from platform_ctrl.verification.budget_result import WindowBudget
    from platform_ctrl.verification.simulated_budget import SimulatedBudget

LINE_OF_SIGHT = "line of sight"  # subject of what is required of it


def across(rms: FloatArray) -> float:
    """Return the rms of both axes across the line of sight together, rad."""
    return float(math.hypot(rms[0], rms[1]))


def assumption(friction: FrictionBalance | None, where: str) -> str:
    """Return what verdicts rest on, in words."""
    fed = friction is not None and any(one is not None for one in friction.drives)
    valid = () if friction is None else zip(friction.statement, friction.valid, strict=True)
    unsure = [words for words, holds in valid if not holds]
    dry = "" if friction is None else f", with dry friction{' less what is fed forward' if fed else ''}"
    return "; ".join([f"linear budget{f' at {where}' if where else ''}{dry}", *unsure])


def balance_holds(friction: FrictionBalance | None) -> bool:
    """Return whether what stands for dry friction in a linear budget is valid."""
    return friction is None or bool(np.all(friction.valid))


def judged(
    budget: Budget,
    rms: FloatArray,
    total: FloatArray,
    windows: Sequence[WindowBudget],
    linear: str,
    valid: bool = True,
) -> tuple[CheckResult, ...]:
    """Return the limits compared with the budget; `linear` is what the values rest on.

    Of a budget that is not `valid` none is met: see `by_simulation`.
    """
    worst = int(np.argmax(total[:2]))
    measured: dict[tuple[str, str], tuple[float, str]] = {
        ("jitter", ""): (across(total), f"both axes, {linear}"),
        ("jitter_per_axis", ""): (float(total[worst]), f"{LOS_ANGLES[worst]}, {linear}"),
    }
    for key, of in (("windowed_jitter", "about_mean"), ("smear", "smear")):
        if windows:
            found, exposure = max((across(getattr(one, of)), one.exposure) for one in windows)
            measured[key, ""] = (found, f"exposure {exposure:g} s, both axes, {linear}")
    for source, own in zip(budget.sources, rms, strict=False):
        measured["limit", source.name] = (across(own), f"both axes, {linear}")
    judgements = [
        one.judge(measured[key][0], subject=LINE_OF_SIGHT, stage="coupled", evidence=measured[key][1], method="exact")
        for key, one in _requirements(budget)
    ]
    return tuple(judgements) if valid else tuple(_not_held(one) for one in judgements)


def _not_held(one: CheckResult) -> CheckResult:
    cure = "not met by a value that does not hold: state runs in [budget], or a limit of a manoeuvre"
    return replaced(one, {"ratio": math.inf, "passed": False, "evidence": f"{one.evidence}; {cure}"})


def by_simulation(results: Sequence[CheckResult], simulated: SimulatedBudget) -> tuple[CheckResult, ...]:
    """Return limits that a linear budget cannot decide, judged by runs where these show them."""
    axis = int(np.argmax(simulated.rms[:2]))
    found = {
        BUDGET_METRICS["jitter"].name: (across(simulated.rms), across(simulated.high), "both axes"),
        BUDGET_METRICS["jitter_per_axis"].name: (
            float(simulated.rms[axis]),
            float(simulated.high[axis]),
            LOS_ANGLES[axis],
        ),
    }
    out = []
    for one in results:
        if one.passed or math.isfinite(one.ratio) or one.name not in found:
            out.append(one)
            continue
        rms, high, axes = found[one.name]
        evidence = (
            f"{axes}, {simulated.runs} runs of {simulated.time:g} s, at most {high:.4g} {one.unit} with 95 %, about "
            f"the mean; the linear budget, {one.value:.4g} {one.unit}, does not hold"
        )
        limit = Requirement(name=one.name, limit=one.limit, unit=one.unit, sense=one.sense)
        out.append(limit.judge(rms, subject=one.subject, stage="simulated", evidence=evidence, method="simulated"))
    return tuple(out)


def _requirements(budget: Budget) -> list[tuple[tuple[str, str], Requirement]]:
    """Return the limits with their keys and the names of the sources that they are of, if they are of one."""
    out = []
    for key, metric in BUDGET_METRICS.items():
        of = [("", metric.name, getattr(budget.limits, key, None))]
        if key == "limit":
            of = [(one.name, f"{metric.name} from {one.name}", one.limit) for one in budget.sources]
        for source, name, limit in of:
            if limit is not None:
                out.append(((key, source), Requirement(name=name, limit=limit, unit=metric.unit, sense=metric.sense)))
    return out


def is_limited(job: Job) -> bool:
    """Return whether a job has a budget with limits."""
    return job.budget is not None and bool(_requirements(job.budget))


def unstable_results(job: Job) -> tuple[CheckResult, ...]:
    """Return the limits of a job's budget as they are judged where the loop is not stable; none without a budget."""
    of = [] if job.budget is None else _requirements(job.budget)
    evidence = "the loop is not stable"
    return tuple(
        one.judge(math.inf, subject=LINE_OF_SIGHT, stage="coupled", evidence=evidence, method="exact") for _, one in of
    )
