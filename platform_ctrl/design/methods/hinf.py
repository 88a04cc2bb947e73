"""The full-order H-infinity loops: mixed sensitivity on the exactly sampled plant.

In the channels of the gyros (see `design.loop_signals`), in the w-plane of the exactly sampled plant,

    ::

        n ──────────────►(+)──► W_e ──► z1, and to K
                          ▲
        d ──►(+)──► P ────┴───► W_t ──► z2
              ▲
        u ────┴───► W_u ──────────────► z3

    W_e = 1/M + ω_e/s,   W_t constant,   W_u constant,   d scaled by `disturbance`.

W_e's integrator is in the path to the controller, so that the loop has integral action and norms stay finite. The
torque disturbance d is what sets the damping of nutation: from the noise n alone nutation would be cancelled, not
damped. Torques count in units of h ω_nutation (pairs) and J ω_nutation² (inertial directions).

The plant with hold, delay and torquer lag is carried to the w-plane by the bilinear map, which keeps stability and the
H-infinity norm: no Padé, no reduction. W_e bounds S by a line that rises through the bandwidth to the peak M, W_t
bounds T.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.sampling import from_w_plane, to_w_plane
from platform_ctrl.analysis.system import System, block
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import Design, LoopOutcome, given_design
from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.method import LoopProblem, Method, Option, hertz, number
from platform_ctrl.design.sections import between
from platform_ctrl.design.synthesis import HinfMethod, hinf
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.job.methods import DesignSpec

if TYPE_CHECKING:
    from control import StateSpace


# Noise of a further reading over what it shows where n is 1: with a tenth the loop has hardly a margin beside S.
FURTHER = 0.3


@value
class WeightedPlant:
    """The plant of the synthesis and what leads back."""

    arrays: System  # w-plane arrays with inputs [n, d, u] and outputs [z1, z2, z3, measurement]
    weight: System  # W_e; its integrator belongs to the controller: W_e is in series before K
    torque_unit: FloatArray  # (size,): N m, of each channel

    @property
    def further(self) -> int:
        """Number of readings beside the channels, behind them among n and the measurements."""
        return len(self.weight.D) - len(self.torque_unit)

    def at_gimbals(self, K: System, channel: Channels, period: float) -> System:
        """Return a controller of the channels as a sampled one from angles to torques in N m, W_e before it."""
        K = from_w_plane(self.weight.series(K), period)
        return between(channel.turned(len(self.weight.D)), K, channel.basis.T * self.torque_unit)


def signal_names(size: int, further: int) -> tuple[list[str], list[str]]:
    """Return the names of a weighted plant's inputs and outputs, for `size` channels and so many further readings."""
    inputs = [f"n{k + 1}" for k in range(size + further)] + [f"{kind}{k + 1}" for kind in "du" for k in range(size)]
    outputs = [f"{kind}{k + 1}" for kind in ("error", "angle", "torque") for k in range(size)]
    return inputs, outputs + [f"measured{k + 1}" for k in range(size + further)]


def error_weight(gain: FloatArray, rate: FloatArray, further: int) -> System:
    """Return W_e = gain + rate/s, channel by channel, (size,) each; further readings are not weighted."""
    size = len(rate)
    D, rest = np.diag(np.append(gain, np.ones(further))), np.zeros((further, size))
    return System(np.zeros((size, size)), np.hstack([np.eye(size), rest.T]), np.vstack([np.diag(rate), rest]), D)


def torque_units(channel: Channels, nutation: float) -> FloatArray:
    """Return the units of the channels' torques, N m, for 1 rad or, where rates are measured, 1 rad/s.

    h ω_nutation of pairs, J ω_nutation² or J ω_nutation of inertial directions.
    """
    pairs = 2 * len(channel.momenta)
    inertial = channel.inertias[pairs:] * nutation**channel.order
    return np.concatenate([np.repeat(channel.momenta, 2) * nutation, inertial])


def mixed_sensitivity(
    plant: System,
    disturbed: System,
    gain: FloatArray,
    rate: FloatArray,
    constant: tuple[FloatArray, ...],
    noise: FloatArray,
) -> System:
    """Return the weighted plant from [n, d, u] to [z1, z2, z3, measurement], states those of the plant and of W_e.

    `plant` leads from u to the angles, `disturbed`, with the same states, from any number of d; `constant` are W_t and
    W_u. Readings behind the angles are measured as they are, with a `noise` of their own behind n.
    """
    (A, B, C, D, _), k = plant, len(rate)
    B_d, D_d, (angle, torque) = disturbed.B, disturbed.D, constant
    n, more = np.eye(k, k + len(noise)), np.diag(noise)
    error: list[FloatArray | Literal[0]] = [
        gain[:, None] * C[:k],
        np.diag(rate),
        *(gain[:, None] * D_j for D_j in (n, D_d[:k], D[:k])),
    ]
    whole = block(
        [
            [A, 0, 0, B_d, B],
            [C[:k], 0, n, D_d[:k], D[:k]],
            error,
            [angle @ C[:k], 0, 0, angle @ D_d[:k], angle @ D[:k]],
            [0, 0, 0, 0, torque],
            error,
            [C[k:], 0, np.hstack([np.zeros((len(noise), k)), more]), D_d[k:], D[k:]],
        ]
    )
    return System.split(whole, len(A) + k, 0.0)


def weighted_plant(options: dict[str, float], channel: Channels, plants: PlantSet) -> WeightedPlant:
    """Return the weighted w-plane plant of the nominal loop for complete `options`."""
    unit, size = torque_units(channel, plants.nutation), len(channel.basis)
    flat = to_w_plane(between(channel.basis.T * unit, plants.of_torques(), channel.turned(len(plants.angles))))
    gain, rate, disturbance, torque = by_direction(options, channel)
    disturbed = between(np.diag(disturbance), flat, np.eye(len(flat.C)))
    constant = options["complementary"] * np.eye(size), np.diag(torque)
    noise = FURTHER * channel.shown(plants)[size:]
    arrays = mixed_sensitivity(flat, disturbed, gain, rate, constant, noise)
    return WeightedPlant(arrays=arrays, weight=error_weight(gain, rate, len(noise)), torque_unit=unit)


def by_direction(options: dict[str, float], channel: Channels) -> FloatArray:
    """Return gain and rate of W_e, scale of d, and W_u, (4, size)."""
    pairs = 2 * len(channel.momenta)
    of = [
        [options.get(name, 0.0)] * pairs + [options.get(f"inertial_{name}", 0.0)] * channel.inertial
        for name in ("bandwidth_hz", "disturbance", "torque")
    ]
    rate = 2.0 * np.pi * np.array(of[0])
    return np.array([np.full(len(rate), 1.0 / options["sensitivity_peak"]), rate, of[1], of[2]])


def default_weights(channel: Channels, nutation: float) -> dict[str, float]:
    """Return the options of the weights from rules of thumb."""
    out = {"sensitivity_peak": 1.9, "complementary": 0.5}
    bandwidth = 0.5 * nutation / (2.0 * np.pi)
    if len(channel.momenta):
        out |= {"bandwidth_hz": bandwidth, "disturbance": 0.25, "torque": 0.1}
    if channel.inertial:
        out |= {"inertial_bandwidth_hz": bandwidth, "inertial_disturbance": 0.04, "inertial_torque": 0.15}
    return out


WEIGHTS: dict[str, Option] = {
    "bandwidth_hz": hertz("bandwidth", "design", "where the bound on S rises"),
    "sensitivity_peak": number("sensitivity peak", "height to which the bound on S rises", 1.05, 20),
    "complementary": number("weight on T", "bounds T", 0.01, 10.0),
    "disturbance": number("disturbance", "torque disturbance: damps nutation", 1e-3, 10.0),
    "torque": number("weight on torque", "larger: less torque", 1e-3, 10.0),
    "inertial_bandwidth_hz": hertz("inertial bandwidth", "design", "the same where no gyro acts"),
    "inertial_disturbance": number("inertial disturbance", "the same where no gyro acts", 1e-3, 10.0),
    "inertial_torque": number("inertial weight on torque", "the same where no gyro acts", 1e-3, 10.0),
}
BACKOFF = number("backoff", "relative distance from the least norm", 1e-3, 1.0)


class MixedSensitivity(Method):
    """The full-order H-infinity loops."""

    key = "hinf"
    any_sensors = True
    options: ClassVar = WEIGHTS | {"backoff": BACKOFF}
    advice = "a lower bandwidth_hz, or a larger backoff"

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options, those that are not given by rules of thumb."""
        return self.completed(design.options, default_weights(channel, nutation) | {"backoff": 0.05}, period)

    def design(self, problem: LoopProblem) -> Design:
        """Return the H-infinity loop. Claims: ``gamma`` and ``gamma_optimal``."""
        return problem.made(*hinf_controller(problem))


def hinf_controller(
    problem: LoopProblem, method: HinfMethod | None = None
) -> tuple[System, dict[str, float], dict[str, float]]:
    """Return the H-infinity controller, its options and its claims; `method` as for `design.hinf`."""
    channel, plants = problem.channel, problem.plants.regular()
    options = MixedSensitivity().defaults(problem.design, channel, plants.nutation, plants.period)
    weighted = weighted_plant(options, channel, plants)
    size = len(weighted.torque_unit)
    P = weighted.arrays.to_control(*signal_names(size, weighted.further))
    found = hinf(P, size + weighted.further, size, method=method, backoff=options["backoff"])
    claims = {"gamma": found.gamma, "gamma_optimal": found.gamma_optimal}
    K = weighted.at_gimbals(System.of(found.controller, "controller"), channel, plants.period)
    return K, options, claims


# Methods whose options are these weights.
WEIGHTED = ("hinf", "lmi")


def generalised_plant(loop: LoopOutcome, **weights: float) -> StateSpace:
    """Weighted plant of a loop of a job, for `control.hinfsyn` or a convex problem of your own.

    ::

        n ──────────────►(+)──► W_e ──► error, and measured
                          ▲
        d ──►(+)──► P ────┴───► W_t ──► angle
              ▲
        u ────┴───► W_u ──────────────► torque

    P is the exactly sampled nominal plant with delay and torquer lag, in the w-plane, w = (2/T) (z − 1)/(z + 1): the
    plant is continuous, its norms and stability are those of the sampled loop. Its channels are the gyroscopic pairs
    and inertial directions of the loop. W_e = 1/M + ω_e/s is in the path to the controller.

    Parameters
    ----------
    loop
        From `loops`, with at least one design.
    weights
        Options of the method ``hinf`` (``bandwidth_hz``, ``sensitivity_peak``, ...); those not given are those of the
        closed design where it has them, else by rules of thumb.

    Returns
    -------
    control.StateSpace
        Inputs w = [n, d] and u, outputs z = [error, angle, torque] and y = measured, with a number for each channel;
        dimensionless, angles in rad, torques in units of h ω_nutation or J ω_nutation². There are as many measurements
        and controls as channels.

    Raises
    ------
    ArgumentError
        A loop without plants of its own, or an unknown weight.

    See Also
    --------
    with_controller : the loop closed by what was found.

    Examples
    --------
    >>> loop = platform_ctrl.design.loops(job)[0]  # doctest: +SKIP
    >>> K, _, gamma, _ = control.hinfsyn(generalised_plant(loop), 2, 2)  # doctest: +SKIP
    >>> with_controller(loop, K).closed.results  # doctest: +SKIP
    """
    weighted, _ = _weighted(loop, weights)
    return weighted.arrays.to_control(*signal_names(len(weighted.torque_unit), weighted.further))


def with_controller(loop: LoopOutcome, controller: StateSpace, *, name: str = "given", **weights: float) -> LoopOutcome:
    """Close a loop of a job with a controller that was found outside, and measure it as every other design.

    Parameters
    ----------
    loop
        From `loops`.
    controller
        u = K y (positive feedback): a continuous one belongs to `generalised_plant`, W_e is put before it and it is
        sampled; a sampled one leads from the loop's readings to its torques, and is taken as it is.
    name
        Of the new design.
    weights
        As of `generalised_plant`.

    Returns
    -------
    LoopOutcome
        With the new design closed, its limits judged in ``closed.results``; `verification.check_job` takes it.

    Raises
    ------
    ArgumentError
        The controller does not fit.
    """
    plants = loop.closed.plants
    if plants is None:
        raise ArgumentError(f"with_controller: the loop {loop.spec.name!r} has no plants of its own; give another")
    own = controller
    if not controller.dt:
        (weighted, channel), K = _weighted(loop, weights), System.of(controller, "controller")
        size = len(weighted.torque_unit)
        measured_signals = size + weighted.further
        if K.D.shape != (size, measured_signals):
            raise ArgumentError(
                f"controller: must have {measured_signals} inputs and {size} outputs, as the generalised plant has "
                f"measurements and controls, got {K.D.shape[1]} and {K.D.shape[0]}"
            )
        sampled = weighted.at_gimbals(K, channel, plants.period)
        own = channel.of_readings(sampled).to_control(plants.angles, plants.torques)
    made = given_design(loop.spec, name, own, plants)
    kept = tuple(one for one in loop.designs if one.name != name)
    return replace(loop, designs=(*kept, replace(made, directions=loop.closed.directions)), use=name)


def _weighted(loop: LoopOutcome, weights: dict[str, float]) -> tuple[WeightedPlant, Channels]:
    closed = loop.closed
    plants, channel = closed.plants, closed.directions
    if plants is None or channel is None:
        raise ArgumentError(f"generalised_plant: the loop {loop.spec.name!r} has no plants of its own; give another")
    own = channel.seen(plants).regular()
    rules = default_weights(channel, own.nutation)
    options = rules | {key: x for key, x in closed.options.items() if key in rules and closed.method in WEIGHTED}
    try:
        complete = MixedSensitivity.completed(weights, options, own.period, "generalised_plant")
        return weighted_plant(complete, channel, own), channel
    except DesignError as error:
        raise ArgumentError(str(error)) from None
