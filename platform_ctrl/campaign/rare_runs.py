"""Rare events of a campaign: its own inputs, its own runs, one requirement or any."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.run_metrics import RUN_METRICS, over_limit
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.campaign.probability import CONFIDENCE, RareMethod, RareResult
from platform_ctrl.campaign.rare_events import RunNumbers, rare_event
from platform_ctrl.campaign.single_run import metric_of, metrics_of
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.scenario import Scenario


@check_arguments
def rare_probability(  # noqa: PLR0913 - options by keyword
    plan: Plan,
    requirement: str | None = None,
    *,
    samples: int = 1000,
    repetitions: int = 8,
    method: RareMethod = "splitting",
    confidence: float = CONFIDENCE,
    threads: int = 1,
    device: str = "cpu",
    say: Callable[[str], None] = lambda line: None,
) -> RareResult:
    """Return the probability that a run of the campaign violates a requirement, for those too small to be counted.

    Manoeuvres, parameters, faults and noise are drawn as in the campaign. Noise has numbers that the campaign's own
    runs do not have.

    Parameters
    ----------
    plan
        What every run is.
    requirement
        ``"angle"``, ``"attitude"`` or ``"torque_share"``; None: any of them. A manoeuvre that does not ask for it
        never violates it.
    samples, repetitions, method
        As in `platform_ctrl.campaign.rare_event`.
    confidence
        As in `platform_ctrl.campaign.rare_event`, a probability.
    threads, device
        As in `platform_ctrl.simulation.simulate_batch`.
    say
        As in `platform_ctrl.campaign.rare_event`.

    Returns
    -------
    RareResult
        Over all that the campaign draws.

    Raises
    ------
    ArgumentError
        No manoeuvre of the campaign has this limit, or a run cannot be simulated.
    SimulationError
        A run could not be carried out, or the device is not there.

    References
    ----------
    S. K. Au, J. L. Beck, Probabilistic Engineering Mechanics 16, 2001.

    See docs/campaign.md.
    """
    limited = tuple(
        name for name in RUN_METRICS if any(name in manoeuvre.limits for manoeuvre, _ in plan.job.campaign_manoeuvres)
    )
    if not limited:
        raise ArgumentError(f"job {plan.job.name!r}: no manoeuvre of the campaign has limits: give one some")
    if requirement is not None:
        known_name("requirement of the campaign", requirement, limited)

    def ratios(u: FloatArray, runs: RunNumbers) -> FloatArray:
        scenarios = plan.scenarios_with(plan.inputs_at(u), runs.tolist())
        return limit_ratios(plan, scenarios, requirement, threads=threads, device=device)

    found = rare_event(
        ratios,
        plan.dimensions,
        samples=samples,
        repetitions=repetitions,
        method=method,
        confidence=confidence,
        seed=plan.seed,
        first_run=plan.runs,
        say=say,
    )
    return dataclasses.replace(found, requirement=requirement)


def limit_ratios(
    plan: Plan, scenarios: Sequence[Scenario], requirement: str | None = None, *, threads: int = 1, device: str = "cpu"
) -> FloatArray:
    """Simulate scenarios; return the largest metric over its limit of each, infinite where it diverged."""
    from platform_ctrl.simulation import simulate_batch

    result = simulate_batch(
        scenarios, plan.controllers, period=plan.job.sampling.period, step=plan.step, threads=threads, device=device
    )
    names = metrics_of(plan) if requirement is None else (requirement,)
    out = np.zeros(len(scenarios))
    for name in names:
        limit = np.array([scenario.limits.get(name, np.nan) for scenario in scenarios])
        limited = ~np.isnan(limit)
        ratio = over_limit(name, metric_of(result, name, scenarios), np.where(limited, limit, 1.0))
        # A run that diverged violates all its limits; without any it still has not passed.
        lost = ~result.completed & (limited | (requirement is None))
        out = np.maximum(out, np.where(lost, np.inf, np.where(limited, ratio, 0.0)))
    return out
