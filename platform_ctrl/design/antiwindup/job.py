"""The limits of a job's caging loops: the largest Omega without saturation, nominal and in the worst case."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.antiwindup.compensator import LargestOmega, largest_Omega
from platform_ctrl.design.antiwindup.loop import LimitedLoop, limited_loop
from platform_ctrl.design.plants import cases
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import Job
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

if TYPE_CHECKING:
    from control import StateSpace

# A torque for 1 rad/s below this share of the limit counts as zero: that rate does not load the loop.
_NO_LOAD = 1e-6
# How fast Omega rises where no manoeuvre of the job specifies it, s.
_RISE = 0.5


@value
class LoopLargestOmega:
    """The largest Omega about one axis without saturation of a caging loop.

    Attributes
    ----------
    axis
        Root axis, 1 to 3.
    rise
        Length of the half-cosine in which Omega may rise and fall, s.
    nominal
        Of the plant as it is.
    worst_case
        The least over the plants of the parameter uncertainty (at rest), rad/s, each with a proof of its own.
    worst_case_label
        Which plant that is.
    """

    axis: int
    rise: float
    nominal: LargestOmega
    worst_case: float
    worst_case_label: str


@check_arguments
def caging_loop_limits(
    job: Job,
    controller: StateSpace,
    axis: int,
    *,
    rise: float | None = None,
    platform: Platform | None = None,
) -> LimitedLoop:
    """Return the loop of a caging controller with the limits, lags and stops of the plant file, while Omega turns.

    Parameters
    ----------
    job
        The job: plant, sampling, manoeuvres.
    controller
        u = K y with the names of the pick-offs and torquers.
    axis
        Root axis of Omega, 1 to 3.
    rise
        Length of the half-cosine, s; default the shortest of the job's caged manoeuvres, 0.5 s without any.
    platform
        In place of the job's own.

    Returns
    -------
    LimitedLoop
        For `largest_Omega` and `anti_windup`.

    Raises
    ------
    ArgumentError
        Unknown signals or axis; a torquer without limit; or the loop is not stable.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).
    """
    if axis not in (1, 2, 3):
        raise ArgumentError(f"axis: must be 1, 2 or 3, got {axis!r}")
    platform = job.platform if platform is None else platform
    torquers = {t.name: t for t in platform.torquers}
    sensed = {s.name: s.gimbal for s in platform.pickoffs}
    unknown = [name for name in controller.output_labels if name not in torquers]
    unknown += [name for name in controller.input_labels if name not in sensed]
    if unknown:
        raise ArgumentError(f"controller: its signals must be torquers and pick-offs of the plant, got {unknown[0]!r}")
    used = [torquers[name] for name in controller.output_labels]
    gimbals = [str(t.gimbal) for t in used]
    without = [t.name for t in used if t.limit is None]
    if without:
        raise ArgumentError(
            f"torquer {without[0]!r}: must have a limit in the plant file: without one nothing winds up"
        )
    stops = {g.name: g.stops for g in platform.gimbals}
    reach = [stops[sensed[name]] for name in controller.input_labels]
    if rise is None:
        rise = min((m.rise for m in job.manoeuvres if m.mode == "caged" and m.rise > 0.0), default=_RISE)
    return limited_loop(
        state_space(linearise(platform), gimbals=gimbals),
        controller,
        OMEGA_NAMES[axis - 1],
        limits=[float(t.limit or 0.0) for t in used],
        stops=[np.inf if s is None else min(-s[0], s[1]) for s in reach],
        delay=job.sampling.delay,
        lag=[t.lag for t in used],
        rise=rise,
    )


@check_arguments
def caging_largest_Omega(
    job: Job, controller: StateSpace, *, rise: float | None = None, axes: Sequence[int] = (1, 2, 3)
) -> tuple[LoopLargestOmega, ...]:
    """Return the largest Omega without saturation about every root axis that loads a caging loop's torquers.

    Parameters
    ----------
    job, controller
        As in `caging_loop_limits`.
    rise
        As in `caging_loop_limits`, s.
    axes
        Root axes, 1 to 3.

    Returns
    -------
    tuple of LoopLargestOmega
        One for each axis that loads a torquer.

    Raises
    ------
    ArgumentError
        As in `caging_loop_limits`.
    NotCertifiedError
        A proof failed.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).
    """
    torquers = {t.name: str(t.gimbal) for t in job.platform.torquers}
    gimbals = tuple(torquers[name] for name in controller.output_labels if name in torquers)
    out = []
    for axis in axes:
        loop = caging_loop_limits(job, controller, axis, rise=rise)
        if np.all(np.abs(loop.u_steady) < _NO_LOAD * loop.limits):
            continue
        nominal = largest_Omega(loop)
        least, label = nominal.Omega, "nominal"
        for case in cases(job, gimbals):
            if case.group != "uncertainty":
                continue
            varied = caging_loop_limits(job, controller, axis, rise=rise, platform=case.platform)
            found = largest_Omega(varied).Omega
            if found < least:
                least, label = found, case.label
        out.append(
            LoopLargestOmega(axis=axis, rise=loop.rise, nominal=nominal, worst_case=least, worst_case_label=label)
        )
    return tuple(out)
