"""What a caging loop does between its samples: continuous torques and rates to continuous angles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.intersample import intersample_norm
from platform_ctrl.analysis.sampling import with_lag
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import Job
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control


@value
class IntersampleGains:
    """Largest gains of a caging loop in continuous time, L2 to L2, with their frequencies.

    Attributes
    ----------
    torque_rejection
        From disturbing torques at the gimbals to the angles, rad/(N m). At the gimbals: not through hold, delay and
        lag as the torques of the controller.
    torque_frequency, Omega_frequency
        Where the peaks are, rad/s, up to π/T; None where the peak belongs to no frequency.
    Omega_rejection
        From Omega to the angles, rad/(rad/s).
    """

    torque_rejection: float
    torque_frequency: float | None
    Omega_rejection: float
    Omega_frequency: float | None


@check_arguments
def intersample_gains(job: Job, controller: control.StateSpace) -> IntersampleGains:
    """Return the gains of a caging loop around the job's plant at rest, between samples as at them.

    Parameters
    ----------
    job
        The job: plant, sampling.
    controller
        A caging controller, u = K y with the names of pick-offs and torquers.

    Returns
    -------
    IntersampleGains
        From disturbing torques and from Omega to the angles.

    Raises
    ------
    ArgumentError
        Unknown signals, or the loop is not stable.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).

    References
    ----------
    B. Bamieh, J. B. Pearson, Systems & Control Letters 18, 1992.

    See docs/sampled-data.md.
    """
    plant, m, p = caging_plant(job, controller)
    torque, at = intersample_norm(_chosen(plant, range(m), m), controller, p, m, job.sampling.delay)
    rate, when = intersample_norm(_chosen(plant, range(m, m + 3), m), controller, p, m, job.sampling.delay)
    return IntersampleGains(torque_rejection=torque, torque_frequency=at, Omega_rejection=rate, Omega_frequency=when)


def caging_plant(job: Job, controller: control.StateSpace) -> tuple[control.StateSpace, int, int]:
    """Return the continuous plant of a caging loop with its torquers' lags, and the numbers of torques and angles.

    Inputs [disturbing torques at the gimbals, Omega1 to Omega3, torques]; outputs [angles, angles as measured].
    """
    torquers = {t.name: t for t in job.platform.torquers}
    torques, angles = list(controller.output_labels), list(controller.input_labels)
    unknown = [name for name in torques if name not in torquers]
    if unknown:
        raise ArgumentError(f"controller: its outputs must be among {', '.join(torquers)}, got {unknown[0]!r}")
    used = [torquers[name] for name in torques]
    whole = state_space(linearise(job.platform), gimbals=[str(t.gimbal) for t in used])
    unseen = [name for name in angles if name not in whole.output_labels]
    if unseen:
        raise ArgumentError(f"controller: its inputs must be among {list(whole.output_labels)}, got {unseen[0]!r}")
    P = state_arrays(whole[angles, [*torques, *OMEGA_NAMES, *torques]], "caging_plant")
    m, p = len(torques), len(angles)
    lags = np.concatenate([np.zeros(m + 3), [t.lag for t in used]])
    A, B, C, D, _ = with_lag(P, lags)
    names = [f"disturbing_{name}" for name in torques] + [*OMEGA_NAMES, *torques]
    arrays = StateArrays(A, B, np.vstack([C, C]), np.vstack([D, D]), 0.0)
    return named_system(arrays, names, [*angles, *(f"measured_{name}" for name in angles)]), m, p


def _chosen(plant: control.StateSpace, disturbances: range, m: int) -> control.StateSpace:
    columns = [*disturbances, *range(plant.ninputs - m, plant.ninputs)]
    arrays = StateArrays(plant.A, plant.B[:, columns], plant.C, plant.D[:, columns], 0.0)
    return named_system(arrays, [plant.input_labels[k] for k in columns], list(plant.output_labels))
