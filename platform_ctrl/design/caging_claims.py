"""What is claimed of the caging loops of a job: gains between the samples, the largest Omega without saturation."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, selected, state_arrays
from platform_ctrl.analysis.intersample import intersample_norm
from platform_ctrl.analysis.sampling import with_lag
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.antiwindup.compensator import LargestOmega, largest_Omega
from platform_ctrl.design.antiwindup.loop import LimitedLoop, limited_loop
from platform_ctrl.design.cases import cases
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.job.job import Job, Uncertainty
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform, Torquer

if TYPE_CHECKING:
    import control

# A torque for 1 rad/s below this share of the limit counts as zero: that rate does not load the loop.
_NO_LOAD = 1e-6
# How fast Omega rises where no manoeuvre of the job specifies it, s.
_RISE = 0.5


def shortest_rise(job: Job) -> float:
    """Return how fast Omega rises in the fastest of the job's caged manoeuvres, 0.5 s without any."""
    return min((m.rise for m in job.manoeuvres if m.mode == "caged" and m.rise > 0.0), default=_RISE)


def with_caging_claims(job: Job, design: LoopDesign, *, closed: bool, rise: float | None = None) -> LoopDesign:
    """Return a caging design with its gains in continuous time and, where it is closed, its largest Omega.

    `rise` is how fast Omega rises, s; default: `shortest_rise`.

    The names end in their units. What does not exist for a loop is left out: the gains of an unstable loop, the largest
    Omega of torquers without limits or of an axis that loads none.
    """
    if design.measures is None or not design.measures.decay[0] > 0.0:
        return design
    claims = dict(design.claims) | _between_samples(job, design)
    if closed:
        claims |= _at_the_limits(job, design, rise)
    return dataclasses.replace(design, claims=claims)


def largest_Omega_name(axis: int, *, worst_case: bool = False) -> str:
    """Return the name of the claim of the largest Omega without saturation about a root axis, 1 to 3."""
    return f"largest {OMEGA_NAMES[axis - 1]} without saturation{', worst case' if worst_case else ''}, rad/s"


def _between_samples(job: Job, design: LoopDesign) -> dict[str, float]:
    try:
        gains = intersample_gains(job, design.controller)
    except ArgumentError:
        return {}
    return {
        "intersample torque rejection, rad/(N m)": gains.torque_rejection,
        "intersample Omega rejection, rad/(rad/s)": gains.Omega_rejection,
    }


def _at_the_limits(job: Job, design: LoopDesign, rise: float | None) -> dict[str, float]:
    # Where one plant of the uncertainty is unstable, the claims are those of the nominal plant.
    for requested in (job, dataclasses.replace(job, uncertainty=Uncertainty())):
        try:
            found = caging_largest_Omega(requested, design.controller, rise=rise)
        except (ArgumentError, DesignError):
            continue
        out = {largest_Omega_name(one.axis): one.nominal.Omega for one in found}
        if requested.uncertainty.inertia > 0.0 or requested.uncertainty.spin > 0.0:
            out |= {largest_Omega_name(one.axis, worst_case=True): one.worst_case for one in found}
        return out
    return {}


def _caged(platform: Platform, controller: control.StateSpace) -> tuple[list[Torquer], control.StateSpace]:
    """Return the torquers of a caging controller, and the continuous plant of their gimbals at rest."""
    torquers = {t.name: t for t in platform.torquers}
    unknown = [name for name in controller.output_labels if name not in torquers]
    if unknown:
        raise ArgumentError(f"controller: its outputs must be among {', '.join(torquers)}, got {unknown[0]!r}")
    used = [torquers[name] for name in controller.output_labels]
    whole = state_space(linearise(platform), gimbals=[str(t.gimbal) for t in used])
    unseen = [name for name in controller.input_labels if name not in whole.output_labels]
    if unseen:
        raise ArgumentError(f"controller: its inputs must be among {list(whole.output_labels)}, got {unseen[0]!r}")
    return used, whole


@value
class IntersampleGains:
    """Largest gains of a caging loop in continuous time, L2 to L2, with their frequencies."""

    # From disturbing torques at the gimbals to the angles, rad/(N m). At the gimbals: not through hold, delay and lag
    # as the torques of the controller.
    torque_rejection: float
    # torque_frequency, Omega_frequency: where the peaks are, rad/s, up to π/T; None where the peak belongs to no
    # frequency.
    torque_frequency: float | None
    Omega_rejection: float  # from Omega to the angles, rad/(rad/s)
    Omega_frequency: float | None


@check_arguments
def intersample_gains(job: Job, controller: control.StateSpace) -> IntersampleGains:
    """Return the gains of a caging loop around the job's plant at rest, between samples as at them.

    The controller is u = K y with the names of pick-offs and torquers. Raises an ArgumentError for unknown signals and
    for an unstable loop.
    """
    plant, m, p = caging_plant(job, controller)
    names, delay = list(plant.input_labels), job.sampling.delay
    torque, at = intersample_norm(selected(plant, plant.output_labels, names[:m] + names[-m:]), controller, p, m, delay)
    rate, when = intersample_norm(selected(plant, plant.output_labels, names[m:]), controller, p, m, delay)
    return IntersampleGains(torque_rejection=torque, torque_frequency=at, Omega_rejection=rate, Omega_frequency=when)


def caging_plant(job: Job, controller: control.StateSpace) -> tuple[control.StateSpace, int, int]:
    """Return the continuous plant of a caging loop with its torquers' lags, and the numbers of torques and angles.

    Inputs [disturbing torques at the gimbals, Omega1 to Omega3, torques]; outputs [angles, angles as measured].
    """
    used, whole = _caged(job.platform, controller)
    torques, angles = list(controller.output_labels), list(controller.input_labels)
    P = state_arrays(whole[angles, [*torques, *OMEGA_NAMES, *torques]], "caging_plant")
    m, p = len(torques), len(angles)
    lags = np.concatenate([np.zeros(m + 3), [t.lag for t in used]])
    A, B, C, D, _ = with_lag(P, lags)
    names = [f"disturbing_{name}" for name in torques] + [*OMEGA_NAMES, *torques]
    arrays = StateArrays(A, B, np.vstack([C, C]), np.vstack([D, D]), 0.0)
    return named_system(arrays, names, [*angles, *(f"measured_{name}" for name in angles)]), m, p


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
    controller: control.StateSpace,
    axis: int,
    *,
    rise: float | None = None,
    platform: Platform | None = None,
) -> LimitedLoop:
    """Return the loop of a caging controller with the limits, lags and stops of the plant file, while Omega turns.

    `axis` is the root axis of Omega, 1 to 3, `rise` the length of the half-cosine, s (default: the shortest of the
    job's caged manoeuvres, 0.5 s without any), `platform` takes the place of the job's. Raises an ArgumentError for
    unknown signals, a torquer without limit and an unstable loop.
    """
    if axis not in (1, 2, 3):
        raise ArgumentError(f"axis: must be 1, 2 or 3, got {axis!r}")
    platform = job.platform if platform is None else platform
    used, plant = _caged(platform, controller)
    without = [t.name for t in used if t.limit is None]
    if without:
        raise ArgumentError(
            f"torquer {without[0]!r}: must have a limit in the plant file: without one nothing winds up"
        )
    sensed = {s.name: s.gimbal for s in platform.pickoffs}
    stops = {g.name: g.stops for g in platform.gimbals}
    reach = [stops[sensed[name]] for name in controller.input_labels]
    if rise is None:
        rise = shortest_rise(job)
    return limited_loop(
        plant,
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
    job: Job, controller: control.StateSpace, *, rise: float | None = None, axes: Sequence[int] = (1, 2, 3)
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
