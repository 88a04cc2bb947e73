"""Flying runs of a plan: the columns that a campaign keeps of them, and one run again with all that it recorded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.campaign.table import ENDED, FIGURES, PASSED, RUN, Array

if TYPE_CHECKING:
    from platform_ctrl.campaign.plan import Plan
    from platform_ctrl.scenario import Scenario
    from platform_ctrl.simulation import Figures, Trajectory


def fly(plan: Plan, runs: Sequence[int], *, threads: int = 1, device: str = "cpu") -> dict[str, Array]:
    """Fly runs of a plan and return their columns, each with one entry a run.

    Parameters
    ----------
    plan
        What is flown.
    runs
        Numbers of the runs.
    threads
        On how many threads.
    device
        ``"cpu"`` or ``"cuda"``.

    Returns
    -------
    dict
        ``run``; the inputs by their names; ``angle``, ``attitude``, ``torque_share``: largest figures, infinite where
        the run diverged; ``stop_contacts``; ``saturated``: largest share of samples at a torquer's limit;
        ``angle_passed`` and so on: bool, None where nothing is asked; ``passed``; ``ended``.

    Raises
    ------
    PlatformCtrlError
        A run cannot be set up.
    """
    from platform_ctrl import simulation

    columns = inputs_of(plan, runs)
    scenarios = plan.scenarios_with(columns, runs)
    flown = simulation.fly(
        scenarios, plan.controllers, period=plan.job.sampling.period, step=plan.step, threads=threads, device=device
    )
    return {**columns, **_outcomes(scenarios, flown)}


def inputs_of(plan: Plan, runs: Sequence[int]) -> dict[str, Array]:
    """Return the columns ``run`` and inputs of some runs."""
    numbers = np.asarray(runs, dtype=np.int64)
    first, last = (int(numbers.min()), int(numbers.max()) + 1) if len(numbers) else (0, 0)
    inputs = plan.inputs(first, last)
    return {RUN: numbers, **{name: np.asarray(column)[numbers - first] for name, column in inputs.items()}}


def trajectory(plan: Plan, scenario: Scenario) -> Trajectory:
    """Fly one scenario and return all that it recorded.

    Raises
    ------
    ArgumentError
        The controllers do not fit the plant.
    """
    from platform_ctrl import simulation

    used = simulation.acting(plan.controllers, scenario.platform, scenario.mode)
    return simulation.flight(scenario, used, period=plan.job.sampling.period, step=plan.step)


def _outcomes(scenarios: Sequence[Scenario], flown: Figures) -> dict[str, Array]:
    """What the runs came to, by the names of the columns."""
    done = flown.completed
    found = {
        "angle": flown.angle.max(axis=1, initial=0.0),
        "attitude": flown.attitude.max(axis=1, initial=0.0),
        "torque_share": flown.torque_share.max(axis=1, initial=0.0),
    }
    figures = {name: np.where(done, found[name], np.inf) for name in FIGURES}
    passed = done.copy()
    answers: dict[str, Array] = {}
    for name in FIGURES:
        limits = np.array([one.limits.get(name, np.nan) for one in scenarios])
        asked = ~np.isnan(limits)
        met = figures[name] <= np.where(asked, limits, np.inf)
        passed &= met | ~asked
        told = [bool(one) if wanted else None for one, wanted in zip(met, asked, strict=True)]
        answers[f"{name}_passed"] = np.array(told, dtype=object)
    return {
        **figures,
        "stop_contacts": flown.stop_contacts.sum(axis=1),
        "saturated": flown.saturated.max(axis=1, initial=0) / np.maximum(flown.samples, 1),
        **answers,
        PASSED: passed,
        ENDED: np.array(flown.ended, dtype=object),
    }
