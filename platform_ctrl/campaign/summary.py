"""The result of a campaign in one value, from which its page, its terminal tables and campaign.json are made."""

from __future__ import annotations

import dataclasses
from typing import Any

from platform_ctrl.campaign.influences import Influence, influences
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.campaign.statistics import (
    CONFIDENCE,
    CampaignStatistics,
    Probability,
    RequirementStatistics,
    statistics,
)
from platform_ctrl.campaign.table import Table
from platform_ctrl.common.files import plain_types
from platform_ctrl.common.values import value

Record = dict[str, Any]


@value
class Summary:
    """The result of a campaign.

    Attributes
    ----------
    plan
        What was simulated.
    statistics
        How often each requirement is violated.
    influences
        What violating runs have in common, and what drives each requirement.
    """

    plan: Plan
    statistics: CampaignStatistics
    influences: tuple[Influence, ...]

    @property
    def passed(self) -> bool:
        """Whether every run was simulated and met all its limits."""
        return self.statistics.passed

    def inputs_of(self, run: int) -> dict[str, float | bool | str]:
        """Return the inputs of one run by their names, in plain types: SI units, names and truth values."""
        return {name: column[0].item() for name, column in self.plan.inputs(run, run + 1).items()}


def summarise(plan: Plan, table: Table, *, confidence: float = CONFIDENCE) -> Summary:
    """Return what a campaign's table says.

    Parameters
    ----------
    plan
        What was simulated.
    table
        The runs: Parquet files or columns.
    confidence
        Probability of the bounds.

    Returns
    -------
    Summary
        What the page, the terminal and campaign.json show.

    Raises
    ------
    ArgumentError
        A column is missing.
    InputError
        The files cannot be read.
    """
    limits = {manoeuvre.name: manoeuvre.limits for manoeuvre, _ in plan.job.campaign_manoeuvres}
    return Summary(
        plan=plan,
        statistics=statistics(table, limits, confidence=confidence),
        influences=influences(table, limits, inputs=plan.input_names, confidence=confidence),
    )


def summary_record(summary: Summary) -> Record:
    """Return what campaign.json holds of a summary; None where a number is not finite."""
    found = summary.statistics
    record = {
        "statistics": {
            "runs": found.runs,
            "simulated": found.simulated,
            "diverged": found.diverged,
            "endings": found.endings,
            "passed": found.passed,
            "confidence": found.confidence,
            "violation": _probability(found.violation),
            "requirements": [_requirement(one) for one in found.requirements],
            "worst": [dataclasses.asdict(one) for one in found.worst],
        },
        "influences": [_influence(one) for one in summary.influences],
    }
    out: Record = plain_types(record)
    return out


def _requirement(one: RequirementStatistics) -> Record:
    return {
        "requirement": one.requirement,
        "manoeuvre": one.manoeuvre,
        "limit": one.limit,
        **_probability(one.violation),
        "quantiles": {f"{share:g}": requirement for share, requirement in one.quantiles.items()},
        "largest": one.largest,
        "worst": [dataclasses.asdict(single) for single in one.worst],
    }


def _influence(one: Influence) -> Record:
    return {
        "requirement": one.requirement,
        "manoeuvre": one.manoeuvre,
        "parameter": one.parameter,
        "rank_correlation": one.correlation,
        "rank_correlation_p_value": one.correlation_p,
        "driver": one.driver,
        "value": one.level,
        "with": _probability(one.present),
        "without": _probability(one.absent),
        "p_value": one.p_value,
        "cause": one.cause,
        "in_every_violation": one.in_every_violation,
    }


def _probability(one: Probability) -> Record:
    return {"violations": one.events, "runs": one.runs, "probability": one.estimate, "low": one.low, "high": one.high}
