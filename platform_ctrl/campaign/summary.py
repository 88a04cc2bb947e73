"""The result of a campaign in one value, from which its page, its terminal tables and campaign.json are made."""

from __future__ import annotations

import dataclasses
from typing import Any

from platform_ctrl.campaign.contrasts import Contrast, contrasts
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.campaign.probability import CONFIDENCE, Probability, RareResult
from platform_ctrl.campaign.sensitivity import Sensitivity, sensitivities
from platform_ctrl.campaign.table import Table
from platform_ctrl.campaign.table_statistics import CampaignStatistics, RequirementStatistics, statistics
from platform_ctrl.common.json_text import plain_types
from platform_ctrl.common.signatures import check_arguments
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
    sensitivities
        What drives them.
    contrasts
        How often they are violated with and without each fault, manoeuvre and chosen value.
    rare
        Probabilities too small to be counted, where they were requested.
    """

    plan: Plan
    statistics: CampaignStatistics
    sensitivities: tuple[Sensitivity, ...]
    contrasts: tuple[Contrast, ...] = ()
    rare: tuple[RareResult, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every run was simulated and met all its limits."""
        return self.statistics.passed

    @check_arguments
    def inputs_of(self, run: int) -> dict[str, float | bool | str]:
        """Return the inputs of one run by their names, in plain types: SI units, names and truth values."""
        return {name: column[0].item() for name, column in self.plan.inputs(run, run + 1).items()}


@check_arguments
def summarise(
    plan: Plan, table: Table, *, confidence: float = CONFIDENCE, rare: tuple[RareResult, ...] = ()
) -> Summary:
    """Return what a campaign's table says.

    Parameters
    ----------
    plan
        What was simulated.
    table
        The runs: Parquet files or columns.
    confidence
        Probability of the bounds.
    rare
        Rare events to go with it.

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
        sensitivities=sensitivities(table, limits, inputs=plan.input_names),
        contrasts=contrasts(table, limits, inputs=plan.input_names, confidence=confidence),
        rare=rare,
    )


@check_arguments
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
            "worst": [_fields(one) for one in found.worst],
        },
        "sensitivity": [
            _fields(one)
            | {
                name: [_fields(single, "driver") for single in getattr(one, name)]
                for name in ("influences", "violations")
            }
            for one in summary.sensitivities
        ],
        "contrasts": [_contrast(one) for one in summary.contrasts],
        "rare": [rare_record(summary.plan, one) for one in summary.rare],
    }
    out: Record = plain_types(record)
    return out


def rare_record(plan: Plan, rare: RareResult) -> Record:
    """Return a rare event in plain types, with the inputs of its violations by their names."""
    record = {
        "requirement": rare.requirement or "any",
        "method": rare.method,
        "probability": rare.probability,
        "low": rare.low,
        "high": rare.high,
        "confidence": rare.confidence,
        "variation": rare.variation,
        "runs": rare.evaluations,
        "noise_decides": rare.noise_decides,
        "repetitions": [
            {
                "probability": one.probability,
                "variation": one.variation,
                "levels": one.levels,
                "runs": one.evaluations,
                "noises": one.noises,
            }
            for one in rare.repetitions
        ],
        "shift": dict(zip(plan.input_names, rare.shift, strict=True)),
        "violations": [
            {
                "inputs": {name: column[0] for name, column in plan.inputs_at(one.u[None, :]).items()},
                "point": one.u,
                "noise_run": one.run,
                "ratio": one.ratio,
                "distance": one.distance,
            }
            for one in rare.violations
        ],
    }
    out: Record = plain_types(record)
    return out


def _fields(one: object, *properties: str) -> Record:
    """Return the fields of a value, and some of its properties, by their names."""
    names = [field.name for field in dataclasses.fields(one)]  # type: ignore[arg-type]
    return {name: getattr(one, name) for name in (*names, *properties)}


def _requirement(one: RequirementStatistics) -> Record:
    return {
        "requirement": one.requirement,
        "manoeuvre": one.manoeuvre,
        "limit": one.limit,
        **_probability(one.violation),
        "quantiles": {f"{share:g}": requirement for share, requirement in one.quantiles.items()},
        "largest": one.largest,
        "worst": [_fields(single) for single in one.worst],
    }


def _contrast(one: Contrast) -> Record:
    return {
        "requirement": one.requirement,
        "manoeuvre": one.manoeuvre,
        "parameter": one.parameter,
        "value": one.level,
        "with": _probability(one.present),
        "without": _probability(one.absent),
        "p_value": one.p_value,
        "driver": one.driver,
        "in_every_violation": one.in_every_violation,
    }


def _probability(one: Probability) -> Record:
    return {"violations": one.events, "runs": one.runs, "probability": one.estimate, "low": one.low, "high": one.high}
