"""Flying runs of a plan: the columns that a campaign keeps of them, and one run again with all that it recorded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.campaign.table import ENDED, FIGURES, PASSED, RUN, Array
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.campaign.plan import Plan
    from platform_ctrl.scenario import Scenario
    from platform_ctrl.simulation import Trajectory


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
    columns = inputs_of(plan, runs)
    scenarios = plan.scenarios_with(columns, runs)
    outcomes = [outcome(scenario, trajectory(plan, scenario)) for scenario in scenarios]
    for name in outcomes[0] if outcomes else ():
        entries = [one[name] for one in outcomes]
        columns[name] = np.array(entries, dtype=object if name.endswith("_passed") or name == ENDED else None)
    return columns


def expect_device(device: str) -> None:
    """Refuse a device that this machine or installation does not have.

    Raises
    ------
    InputError
        There is none.
    """
    if device != "cpu":
        raise InputError(f"--device {device}: runs are flown on the processor alone; expected cpu")


def inputs_of(plan: Plan, runs: Sequence[int]) -> dict[str, Array]:
    """Return the columns ``run`` and inputs of some runs."""
    numbers = np.asarray(runs, dtype=np.int64)
    first = int(numbers.min(initial=0))
    inputs = plan.inputs(first, int(numbers.max(initial=first - 1)) + 1)
    return {RUN: numbers, **{name: np.asarray(column)[numbers - first] for name, column in inputs.items()}}


def trajectory(plan: Plan, scenario: Scenario) -> Trajectory:
    """Fly one scenario and return all that it recorded.

    Raises
    ------
    ArgumentError
        The controllers do not fit the plant.
    """
    from platform_ctrl.simulation import simulate

    n = len(scenario.platform.gimbals)
    caged = scenario.mode == "caged"
    roots = {t.name for t in scenario.platform.torquers if t.root_axis is not None}
    return simulate(
        scenario.platform,
        [K for K in plan.controllers if not (caged and roots & set(K.output_labels))],
        period=plan.job.sampling.period,
        delay=scenario.delay,
        duration=scenario.duration,
        mode=scenario.mode,
        Omega_profile=scenario.profile if caged else None,
        root_torque=None if caged else scenario.torque,
        seed=int(np.random.SeedSequence((scenario.seed, scenario.run)).generate_state(1, np.uint64)[0]),
        step=plan.step,
        q=scenario.q if len(scenario.q) else np.zeros(n),
        rate=scenario.rate if len(scenario.rate) else np.zeros(n),
        Omega=None if caged else scenario.Omega,
        attitude=scenario.attitude,
        spin=scenario.spin,
    )


def outcome(scenario: Scenario, flown: Trajectory) -> dict[str, Any]:
    """Return what a run came to, by the names of the columns."""
    figures = dict.fromkeys(FIGURES, float("inf"))
    if flown.completed:
        limits = np.array([np.inf if t.limit is None else t.limit for t in scenario.platform.torquers])
        figures["angle"] = float(np.abs(flown.q).max(initial=0.0))
        figures["attitude"] = float(np.abs(flown.attitude_angles).max(initial=0.0))
        figures["torque_share"] = float((np.abs(flown.command) / limits).max(initial=0.0))
    answers = {name: figures[name] <= scenario.limits[name] if name in scenario.limits else None for name in FIGURES}
    return {
        **figures,
        "stop_contacts": int(flown.stop_contacts.sum()),
        "saturated": float(flown.saturated.max(initial=0) / max(len(flown.t), 1)),
        **{f"{name}_passed": answer for name, answer in answers.items()},
        PASSED: flown.completed and all(answer is not False for answer in answers.values()),
        ENDED: flown.ended,
    }
