"""Whether the torquers of the loops have the torque to hold their gimbals, and to turn them against their friction.

Linear loops have torque without end, and runs may last too short to show it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from math import inf

import numpy as np

from platform_ctrl.design.cases import at_angles
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult, Requirement
from platform_ctrl.mechanics.forces import resting_forces, specific_force_at, twisted

HOLDS = Requirement(name="torque at rest over its limit", limit=1.0, unit="", sense="at most")


def holding_results(job: Job, torquers: Collection[str], subject: str) -> Iterator[CheckResult]:
    """Yield a result that is missed for each gimbal that its torquers, of those that loops use, cannot hold or turn.

    At zero angles and at every combination of the job's angles, under springs, unbalance and weight, root at rest;
    breakaway of dry friction adds to them.
    """
    platform = job.platform
    f = specific_force_at(platform)
    limits: dict[str, float] = {}
    for one in platform.torquers:
        if one.gimbal is not None and one.name in torquers:
            limits[one.gimbal] = limits.get(one.gimbal, 0.0) + (inf if one.limit is None else one.gain * one.limit)
    trims = [twisted(platform, q, f) for q in job.trims]
    forces = np.abs([resting_forces(platform, q, f) for q in trims])[:, 3:]
    for gimbal, limit in limits.items():
        own = forces[:, platform.gimbal(gimbal)]
        worst = int(np.argmax(own))
        stuck = platform.breakaway(gimbal)
        if own[worst] + stuck > limit:
            where = f", {at_angles(platform, job.trims[worst])}" if worst else ""
            parts = [f"{own[worst]:.3g} N m hold it"] if own[worst] > 0.0 else []
            parts += [f"{stuck:.3g} N m of dry friction have to be overcome"] if stuck > 0.0 else []
            yield HOLDS.judge(
                (own[worst] + stuck) / limit,
                subject=subject,
                stage="coupled",
                evidence=f"gimbal {gimbal}: {' and '.join(parts)}, its torquers have {limit:.3g} N m{where}",
                method="exact",
            )
