"""The job's manoeuvres on the exact non-linear plant with sampled controllers, limits, stops and noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.metrics import RUN_METRICS
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.job.job import Job, Manoeuvre, manoeuvre_scenario
from platform_ctrl.job.judging import CheckResult, Requirement
from platform_ctrl.simulation import simulate
from platform_ctrl.simulation.closed_loop import Trajectory

if TYPE_CHECKING:
    import control


@value
class Run:
    """A simulated manoeuvre.

    Attributes
    ----------
    manoeuvre
        As in the job.
    trajectory
        The run, sample by sample.
    results
        The metrics of the run compared with the limits of the manoeuvre.
    """

    manoeuvre: Manoeuvre
    trajectory: Trajectory
    results: tuple[CheckResult, ...]


@check_arguments
def simulate_manoeuvre(job: Job, manoeuvre: Manoeuvre, controllers: Sequence[control.StateSpace]) -> Run:
    """Run one manoeuvre: caged with the caging loops alone and Omega prescribed, stabilised with all loops."""
    scenario = manoeuvre_scenario(job, manoeuvre)
    trajectory = simulate(scenario, controllers, period=job.sampling.period)
    return Run(manoeuvre=manoeuvre, trajectory=trajectory, results=limit_results(job, manoeuvre, trajectory))


@check_arguments
def largest(job: Job, trajectory: Trajectory) -> dict[str, tuple[float, str]]:
    """Return the run's metrics by the names of the limits, each with the signal that it belongs to.

    ``angle``: largest gimbal angle, rad; ``attitude``: largest component of the platform's rotation vector, rad;
    ``torque_share``: largest commanded torque over the torquer's limit. Infinite when the run diverged.

    Parameters
    ----------
    job
        The job that the run is from.
    trajectory
        From `simulate_manoeuvre`.

    Returns
    -------
    dict
        Value and signal by name; rad, rad and a share.
    """
    if not trajectory.completed:
        return {name: (float("inf"), trajectory.ended) for name in RUN_METRICS}
    angles = np.abs(trajectory.q).max(axis=0)
    attitude = np.abs(trajectory.attitude_angles).max(axis=0)
    limits = np.array([np.inf if t.limit is None else t.limit for t in job.platform.torquers])
    shares = np.abs(trajectory.command).max(axis=0) / limits
    return {
        "angle": (float(angles.max()), trajectory.angle_names[int(angles.argmax())])
        if angles.size
        else (0.0, "no gimbal"),
        "attitude": (float(attitude.max()), f"axis {int(attitude.argmax()) + 1}"),
        "torque_share": (float(shares.max()), trajectory.torquer_names[int(shares.argmax())]),
    }


def limit_results(job: Job, manoeuvre: Manoeuvre, trajectory: Trajectory) -> tuple[CheckResult, ...]:
    """Compare a run with the limits of its manoeuvre; one that diverges fails without limits too."""
    found = largest(job, trajectory)
    out = []
    if not trajectory.completed and not manoeuvre.limits:
        completed = Requirement(name="share of the run that was simulated", limit=1.0, unit="", sense="at least")
        share = len(trajectory.t) * trajectory.period / manoeuvre.duration
        out.append(
            completed.judge(
                share, subject=manoeuvre.name, stage="simulated", evidence=trajectory.ended, method="simulated"
            )
        )
    for key, limit in manoeuvre.limits.items():
        metric, (number, signal) = RUN_METRICS[key], found[key]
        limited = Requirement(name=metric.name, limit=limit, unit=metric.unit, sense=metric.sense)
        evidence = (
            f"{signal}; non-linear plant, {trajectory.ended}, seed {trajectory.seed}, substep {trajectory.step:g} s"
        )
        out.append(
            limited.judge(number, subject=manoeuvre.name, stage="simulated", evidence=evidence, method="simulated")
        )
    return tuple(out)
