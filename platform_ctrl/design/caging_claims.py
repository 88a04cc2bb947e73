"""What a caging loop's certificate at the samples leaves open, as claims: between the samples, and at the limits."""

from __future__ import annotations

import dataclasses

from platform_ctrl.description import OMEGA_NAMES
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.job import Job, Spread


def with_caging_claims(job: Job, design: LoopDesign, *, closed: bool) -> LoopDesign:
    """Return a caging design with its gains in continuous time and, where it is closed, the Omega that it survives.

    The names end in their units. What does not exist for a loop is left out: an unstable loop has no gains, a torquer
    without limit loses no Omega, an axis that loads no torquer has nothing to survive.
    """
    if design.measures is None or not design.measures.decay[0] > 0.0:
        return design
    claims = dict(design.claims) | _between_samples(job, design)
    if closed:
        claims |= _at_the_limits(job, design)
    return dataclasses.replace(design, claims=claims)


def survived_name(axis: int, *, spread: bool = False) -> str:
    """Return the name of the claim of the Omega that a loop survives about a root axis, 1 to 3."""
    return f"survived {OMEGA_NAMES[axis - 1]}{' over the spread' if spread else ''}, rad/s"


def _between_samples(job: Job, design: LoopDesign) -> dict[str, float]:
    from platform_ctrl.design.intersample_loop import intersample_gains

    try:
        gains = intersample_gains(job, design.controller)
    except ArgumentError:
        return {}
    return {
        "intersample torque rejection, rad/(N m)": gains.torque_rejection,
        "intersample Omega rejection, rad s/rad": gains.Omega_rejection,
    }


def _at_the_limits(job: Job, design: LoopDesign) -> dict[str, float]:
    from platform_ctrl.design.antiwindup_job import caging_survival

    # One plant of the spread may leave the loop unstable: what holds for the plant as it is stays.
    for asked in (job, dataclasses.replace(job, spread=Spread())):
        try:
            found = caging_survival(asked, design.controller)
        except (ArgumentError, DesignError):
            continue
        out = {survived_name(one.axis): one.nominal.Omega for one in found}
        if asked.spread.inertia > 0.0 or asked.spread.spin > 0.0:
            out |= {survived_name(one.axis, spread=True): one.spread for one in found}
        return out
    return {}
