"""What is claimed of the caging loops of a job: gains between the samples, the largest Omega without saturation."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, selected, state_arrays
from platform_ctrl.analysis.intersample import intersample_norm
from platform_ctrl.analysis.loop_set import LoopSet
from platform_ctrl.analysis.sampling import with_lag
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.loop import LoopDesign, with_commands
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import Job
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform, Torquer

if TYPE_CHECKING:
    import control

# A torque for 1 rad/s below this share of the limit counts as zero: that rate does not load the loop.
_NO_LOAD = 1e-6


def with_caging_claims(job: Job, design: LoopDesign, *, closed: bool) -> LoopDesign:
    """Return a caging design with its gains in continuous time and, where it is closed, the rates that it can hold.

    The names end in their units. What does not exist for a loop is left out: the gains of an unstable loop, the largest
    Omega of torquers without limits or of an axis that loads none.
    """
    if design.measures is None or not design.measures.decay[0] > 0.0:
        return design
    claims = dict(design.claims) | _between_samples(job, design)
    if closed:
        claims |= largest_rates(design)
    return dataclasses.replace(design, claims=claims)


def largest_rates(design: LoopDesign) -> dict[str, float]:
    """Return the constant rates about the root axes at which the first torquer comes to its limit, rad/s.

    Those of the nominal plant, and where they are all stable the least over the plants of the parameter uncertainty.
    They follow from the torques in the steady state; while Omega changes the torques may be larger.
    """
    plants, measures = design.plants, design.measures
    assert plants is not None, "a caging loop has plants"
    assert measures is not None, "and is measured"
    A, B, C, D, _ = LoopSet(plants, with_commands(plants, design.controller)).arrays
    torques, rates = slice(len(plants.torques)), slice(len(plants.torques), len(plants.torques) + 3)
    varied = plants.of(("nominal", "uncertainty"))
    chosen = varied if np.all(measures.decay[varied] > 0.0) else np.arange(len(A)) == 0
    A, B, C, D = A[chosen], B[chosen][..., rates], C[chosen][:, torques], D[chosen][:, torques, rates]
    try:
        steady = D + C @ np.linalg.solve(np.eye(A.shape[-1]) - A, B)
    except np.linalg.LinAlgError:
        return {}
    # Per axis: share of its limit that the most loaded torquer needs for 1 rad/s.
    share = np.abs(steady / plants.torque_limit[:, None]).max(axis=1)
    out = {}
    for axis in map(int, np.flatnonzero(share[0] > _NO_LOAD)):
        out[largest_Omega_name(axis + 1)] = float(1.0 / share[0, axis])
        if len(share) > 1:
            out[largest_Omega_name(axis + 1, worst_case=True)] = float(1.0 / share[:, axis].max())
    return out


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
