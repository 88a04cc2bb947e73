"""A MIMO PID from measured frequency responses: the largest integral gain under limits at every frequency.

The least singular value of Ki is what is maximised: at low frequencies the angle answers a torque disturbance with ‖P
S‖ → ω ‖Ki⁻¹‖, whatever the plant. Convex-concave procedure (Boyd, Hast and Åström, Int. J. Robust Nonlinear Control
26, 2016): from a controller that stabilises, first the limits are approached, then the gain is raised, each step a
convex problem within the limits (see `restriction`). The result is a local optimum.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import positive, whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.measured.responses import Contour
from platform_ctrl.design.measured.restriction import (
    Pattern,
    Sample,
    controller_response,
    masks,
    ratios,
    realisation,
)
from platform_ctrl.design.measured.search import PIDSearch, measured_plants
from platform_ctrl.errors import ArgumentError, NotCertifiedError

if TYPE_CHECKING:
    import control

# Time constant over the period of a filter that is not given: roll-off at 0.4 of the sample rate.
_FILTER = 1.0 / (2.0 * np.pi * 0.4)
_HZ = 1.0 / (2.0 * np.pi)


@value
class ClosedLoopResponse:
    """Responses of one closed loop at the measured frequencies, complex (N, n, n).

    Attributes
    ----------
    frequency : (N,)
        The measured frequencies, rad/s.
    S, T : complex (N, n, n)
        Sensitivity and complementary sensitivity at the angles, dimensionless.
    S_input : complex (N, n, n)
        At the torques, dimensionless.
    torque_per_noise : complex (N, n, n)
        K S, N m/rad.
    limits
        The limits by name, (N,), in their units; of a disk margin 1/α for ‖(S − T)/2‖.
    ratios
        Ratio of each response to its limit, by name, (N,): at most 1.
    """

    frequency: FloatArray
    S: ComplexArray
    T: ComplexArray
    S_input: ComplexArray
    torque_per_noise: ComplexArray
    limits: dict[str, FloatArray]
    ratios: dict[str, FloatArray]


@value
class MeasuredDesign:
    """A controller designed from measured responses, and what it does there.

    Attributes
    ----------
    controller
        u = K y, sampled; inputs are the measured angles, outputs the torques.
    gains : (3, n, n)
        Kp, N m/rad, Ki, N m/(rad s), and Kd, N m s/rad.
    filter_time
        Of the rate action, s.
    objective
        Least singular value of Ki, N m/(rad s).
    responses
        Of the closed loop with each measured plant.
    unstable_poles
        Of the closed loop with each plant, by the generalised Nyquist criterion: all 0.
    history : (steps, 2)
        Least singular value of Ki, N m/(rad s), and the worst ratio of all limits, after each step.
    ended
        Why the iterations ended: ``"no more progress"``, ``"the solver gave up"`` or ``"the steps are used up"``. The
        limits are kept in any case.
    """

    controller: control.StateSpace
    gains: FloatArray
    filter_time: float
    objective: float
    responses: tuple[ClosedLoopResponse, ...]
    unstable_poles: tuple[int, ...]
    history: FloatArray
    ended: str


def measured_pid(  # noqa: PLR0913 - options by keyword
    measurement: control.FRD | Sequence[control.FRD],
    *,
    filter_time: float | None = None,
    pattern: Pattern = "full",
    sensitivity_peak: float = 2.0,
    complementary_sensitivity_peak: float | None = None,
    disk_margin: float | None = None,
    torque_per_noise: float | None = None,
    resonance_damping: float | None = 0.05,
    unstable: int = 0,
    steps: int = 100,
    time_limit: float = 300.0,
) -> MeasuredDesign:
    """Return the PID controller with the largest integral gain that keeps every limit at every measured frequency.

    Parameters
    ----------
    measurement
        Of the sampled plant, from torques to angles, as many of both, hold and delay included; several for plants that
        one controller has to serve.
    filter_time
        Of the rate action, s; by default 0.4 periods, that is 0.4 of the sample rate.
    pattern
        Which gains are free: ``"full"``, ``"diagonal"`` or ``"cross-axis"`` (two angles: integral action across, rate
        action along).
    sensitivity_peak, complementary_sensitivity_peak
        Largest ‖S‖ and ‖T‖, at angles and at torques.
    disk_margin
        Least 1/‖(S − T)/2‖, at both.
    torque_per_noise
        Largest ‖K S‖, N m/rad.
    resonance_damping
        What a resonance that the data do not resolve has to be damped like, a damping ratio: there ‖P S‖ ≤ ‖R‖/(ζ ν), R
        the residue at its pole jν. Without it nothing keeps the controller from cancelling nutation by a zero in place
        of damping it.
    unstable
        Number of unstable poles of each plant.
    steps
        Most convex problems to be solved.
    time_limit
        Longest time in all, s.

    Returns
    -------
    MeasuredDesign
        The controller, and its closed loop with each measured plant.

    Raises
    ------
    ArgumentError
        An argument makes no sense.
    NotStabilisableError
        No stabilising start was found.
    InfeasibleError
        The procedure does not get within the limits; the message says which one fails, and where.
    NotCertifiedError
        The data do not decide whether the loop is stable.
    TimeLimitError
        The time was over before the limits were met.

    References
    ----------
    S. Boyd, M. Hast, K. J. Åström, Int. J. Robust and Nonlinear Control 26, 2016.

    See docs/methods/measured.md.
    """
    plants = measured_plants(measurement)
    free = masks(pattern, len(plants.torques))
    tau = _FILTER * plants.period if filter_time is None else positive("measured_pid: filter_time", filter_time)
    limits = {
        "sensitivity_peak": (sensitivity_peak, 1.0, np.inf),
        "complementary_sensitivity_peak": (complementary_sensitivity_peak, 1.0, np.inf),
        "disk_margin": (disk_margin, 0.0, 2.0),
        "torque_per_noise": (torque_per_noise, 0.0, np.inf),
        "resonance_damping": (resonance_damping, 0.0, 1.0),
    }
    requested: dict[str, float] = {}
    for name, (limit, least, most) in limits.items():
        if limit is not None:
            requested[name] = positive(f"measured_pid: {name}", limit)
            if not least < limit < most:
                raise ArgumentError(f"measured_pid: {name} must be between {least:g} and {most:g}, got {limit:g}")
    whole("measured_pid: unstable", unstable, 0)
    whole("measured_pid: steps", steps, 0)
    end = time.monotonic() + positive("measured_pid: time_limit", time_limit)
    search = PIDSearch(plants, free, tau, requested, unstable, end)
    gains, history = search.improved(search.start(), steps)
    return _result(search, gains, history)


def _result(search: PIDSearch, gains: FloatArray, history: FloatArray) -> MeasuredDesign:
    """Return the design, recomputed from gains and data."""
    plants = search.plants
    worst, name, at = search.worst(gains)
    unstable = search.unstable_poles(gains)
    if worst > 1.0 or any(unstable):
        raise NotCertifiedError(
            f"measured_pid: {name} is {worst:.6g} times its limit at {at * _HZ:.4g} Hz, with {max(unstable)} unstable "
            "poles; give more steps",
            plants,
        )
    controller = realisation(gains, search.filter_time, plants.period)
    return MeasuredDesign(
        controller=controller.to_control(plants.angles, plants.torques, name="measured PID"),
        gains=gains,
        filter_time=search.filter_time,
        objective=float(np.linalg.svd(gains[1], compute_uv=False)[-1]),
        responses=tuple(
            _closed_loop(path, sample, gains) for path, sample in zip(search.contours, search.samples, strict=True)
        ),
        unstable_poles=unstable,
        history=history,
        ended=search.ended,
    )


def _closed_loop(path: Contour, sample: Sample, gains: FloatArray) -> ClosedLoopResponse:
    sample = sample.only(np.flatnonzero(path.residue == 0.0))
    P, K = sample.P, controller_response(gains, sample.actions)
    S, S_input = sensitivities_of_plants(P, K)
    return ClosedLoopResponse(
        frequency=path.frequency[path.residue == 0.0],
        S=S,
        T=np.eye(P.shape[-1]) - S,
        S_input=S_input,
        torque_per_noise=K @ S,
        limits={limit.name: limit.bound for limit in sample.limits},
        ratios={limit.name: ratios(limit, P, K) for limit in sample.limits},
    )
