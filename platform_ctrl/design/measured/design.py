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
from numpy.typing import ArrayLike

from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import positive, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.measured.contour import Contour
from platform_ctrl.design.measured.data import measured_plants
from platform_ctrl.design.measured.pid import Bound, Pattern, controller_response, masks, ratios, realisation
from platform_ctrl.design.measured.restriction import Sample
from platform_ctrl.design.measured.search import Search
from platform_ctrl.errors import ArgumentError, NotCertifiedError

if TYPE_CHECKING:
    import control

# A filter of a sampled controller that is not given: roll-off at 0.4 of the sample rate.
_SAMPLED_FILTER = 1.0 / (2.0 * np.pi * 0.4)
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
        u = K y, continuous or sampled; inputs are the measured angles, outputs the torques.
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
    start : (3, n, n)
        Gains that the iterations began with, in the same units.
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
    start: FloatArray
    history: FloatArray
    ended: str


def measured_pid(  # noqa: PLR0913 - options by keyword
    measurement: control.FRD | Sequence[control.FRD],
    *,
    dead_time: float = 0.0,
    period: float | None = None,
    hold: bool = False,
    filter_time: float | None = None,
    pattern: Pattern | ArrayLike = "full",
    sensitivity_peak: Bound = 2.0,
    complementary_sensitivity_peak: Bound | None = None,
    disk_margin: Bound | None = None,
    torque_per_noise: Bound | None = None,
    angle_per_torque: Bound | None = None,
    resonance_damping: float | None = 0.05,
    start: ArrayLike | MeasuredDesign | None = None,
    unstable: int = 0,
    integrators: int | None = None,
    steps: int = 100,
    time_limit: float = 300.0,
) -> MeasuredDesign:
    """Return the PID controller with the largest integral gain that keeps every limit at every measured frequency.

    Parameters
    ----------
    measurement
        Torques to angles, as many of both; several for plants that one controller has to serve.
    dead_time
        Delay that the measurement does not hold yet, s; taken exactly.
    period
        Sample period of the controller, s; default that of the measurement, 0 for a continuous controller. A
        measurement without a period is taken as what the sampled controller sees, unless `hold`.
    hold
        Whether the measurement lacks the hold of a sampled controller.
    filter_time
        Of the rate action, s; default for a sampled controller 0.4 periods, that is 0.4 of the sample rate.
    pattern
        Which gains are free: ``"full"``, ``"diagonal"``, ``"cross-axis"`` (two angles: integral action across, rate
        action along), or zeros and ones (n, n) or (3, n, n), dimensionless.
    sensitivity_peak, complementary_sensitivity_peak
        Largest ‖S‖ and ‖T‖, at angles and at torques.
    disk_margin
        Least 1/‖(S − T)/2‖, at both.
    torque_per_noise
        Largest ‖K S‖, N m/rad.
    angle_per_torque
        Largest ‖P S‖, rad/(N m).
    resonance_damping
        What a resonance that the data do not resolve has to be damped like, a damping ratio: there ‖P S‖ ≤ ‖R‖/(ζ ν), R
        the residue at its pole jν. Without it nothing keeps the controller from cancelling nutation by a zero in place
        of damping it.
    start
        Gains (3, n, n) that stabilise every plant, in the units of `MeasuredDesign.gains`, or an earlier result;
        default found from the data.
    unstable
        Number of unstable poles of each plant.
    integrators
        Number of its poles at s = 0; default read from the data.
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

    Notes
    -----
    Every limit is a number, or a function of frequencies in rad/s.

    References
    ----------
    S. Boyd, M. Hast, K. J. Åström, Int. J. Robust and Nonlinear Control 26, 2016.

    See docs/methods/measured.md.
    """
    plants = measured_plants(measurement, dead_time, period, hold)
    n = len(plants.torques)
    free = masks(pattern, n)
    tau = _filter_time(filter_time, plants.period)
    requested: dict[str, Bound | None] = {
        "sensitivity_peak": sensitivity_peak,
        "complementary_sensitivity_peak": complementary_sensitivity_peak,
        "disk_margin": disk_margin,
        "torque_per_noise": torque_per_noise,
        "angle_per_torque": angle_per_torque,
        "resonance_damping": resonance_damping,
    }
    if sensitivity_peak is None:
        raise ArgumentError("measured_pid: sensitivity_peak must be given: it keeps the loop stable")
    for name, number in (("unstable", unstable), ("integrators", integrators), ("steps", steps)):
        if not (number is None and name == "integrators") and not _whole(number):
            raise ArgumentError(f"measured_pid: {name} must be a whole number, 0 or more, got {short(number)}")
    search = Search(
        plants, free, tau, requested, unstable, integrators, time.monotonic() + positive("time_limit", time_limit)
    )
    begun = search.start(start.gains if isinstance(start, MeasuredDesign) else start)
    gains, history = search.improved(begun, steps)
    return _result(search, gains, begun, history)


def _whole(number: object) -> bool:
    return isinstance(number, int | np.integer) and not isinstance(number, bool) and int(number) >= 0


def _filter_time(given: float | None, period: float) -> float:
    if given is not None:
        return positive("measured_pid: filter_time", given)
    if period == 0.0:
        raise ArgumentError(
            "measured_pid: filter_time must be given for a continuous controller, the time constant of its rate action"
        )
    return _SAMPLED_FILTER * period


def _result(search: Search, gains: FloatArray, begun: FloatArray, history: FloatArray) -> MeasuredDesign:
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
        start=begun,
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
