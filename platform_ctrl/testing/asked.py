"""The requirements of a job by name, before anything is designed: what its tests are called."""

from __future__ import annotations

from platform_ctrl.baselines.figures import ALL_LOOPS, COST
from platform_ctrl.check.proofs import PROVED
from platform_ctrl.check.simulated import RUN_FIGURES
from platform_ctrl.job import Job
from platform_ctrl.requirements import STABLE, loop_requirements

Asked = tuple[str, str]


def asked_of(job: Job) -> tuple[Asked, ...]:
    """Return subject and name of every requirement that the verdict on `job` will rest on, in its order."""
    out: list[Asked] = []
    for spec in job.loops:
        if spec.kind == "caging":
            out += [(spec.name, one.name) for one in loop_requirements(spec.limits)]
            out.append((spec.name, PROVED.name))
    out.append((ALL_LOOPS, STABLE.name))
    if job.coupled.disk_margin is not None:
        out.append((ALL_LOOPS, "simultaneous disk margin"))
    if job.coupled.coupling_cost is not None:
        out.append((ALL_LOOPS, COST))
    for spec in job.loops:
        if spec.kind == "stabilisation" and spec.limits.torque_noise is not None:
            out.append((spec.name, "torque noise, rms"))
    out.append((ALL_LOOPS, PROVED.name))
    out += [(manoeuvre.name, RUN_FIGURES[key][0]) for manoeuvre in job.manoeuvres for key in manoeuvre.limits]
    return tuple(out)
