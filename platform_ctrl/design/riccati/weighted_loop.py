"""The full-order H-infinity loops: mixed sensitivity on the exactly sampled plant.

In the channels of the gyros (see `channels`), in the w-plane of the exactly sampled plant,

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

import numpy as np

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.sampling import from_w_plane, to_w_plane
from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import Designed, LoopProblem, completed
from platform_ctrl.design.partition import Channels, between
from platform_ctrl.design.synthesis import HinfMethod, hinf
from platform_ctrl.job.job import DesignSpec


@value
class WeightedPlant:
    """The plant of the synthesis and what leads back."""

    arrays: System  # w-plane arrays with inputs [n, d, u] and outputs [z1, z2, z3, measurement]
    size: int  # number of channels
    # weight_gain, weight_rate: (size,): W_e = weight_gain + weight_rate/s, channel by channel.
    weight_gain: FloatArray
    weight_rate: FloatArray
    torque_unit: FloatArray  # (size,): N m

    def weight(self) -> System:
        """Return W_e in the w-plane. Its integrator belongs to the controller: W_e is in series before K."""
        return error_weight(self.weight_gain, self.weight_rate)

    def at_gimbals(self, controller: System, channel: Channels) -> System:
        """Return a controller of the channels, in units of torque, as one from angles to torques in N m."""
        return between(channel.basis, controller, channel.basis.T * self.torque_unit)


def signal_names(size: int) -> tuple[list[str], list[str]]:
    """Return the names of a weighted plant's inputs and outputs, for `size` channels."""
    inputs = [f"{kind}{k + 1}" for kind in ("n", "d", "u") for k in range(size)]
    outputs = [f"{kind}{k + 1}" for kind in ("error", "angle", "torque", "measured") for k in range(size)]
    return inputs, outputs


def error_weight(gain: FloatArray, rate: FloatArray) -> System:
    """Return W_e = gain + rate/s, channel by channel, (size,) each."""
    size = len(rate)
    return System(np.zeros((size, size)), np.eye(size), np.diag(rate), np.diag(gain))


def torque_units(channel: Channels, nutation: float) -> FloatArray:
    """Return the units of the channels' torques, N m, for 1 rad or, where rates are measured, 1 rad/s.

    h ω_nutation of pairs, J ω_nutation² or J ω_nutation of inertial directions.
    """
    pairs = 2 * len(channel.momenta)
    inertial = channel.inertias[pairs:] * nutation**channel.order
    return np.concatenate([np.repeat(channel.momenta, 2) * nutation, inertial])


def mixed_sensitivity(
    plant: System, disturbed: System, gain: FloatArray, rate: FloatArray, constant: tuple[FloatArray, ...]
) -> System:
    """Return the weighted plant from [n, d, u] to [z1, z2, z3, measurement], states those of the plant and of W_e.

    `plant` leads from u to the angles, `disturbed`, with the same states, from d; `constant` are W_t and W_u.
    """
    A, B, C, D, _ = plant
    B_d, D_d = disturbed.B, disturbed.D
    n, size = len(A), len(C)
    eye, none, wide = np.eye(size), np.zeros((size, size)), np.zeros((n, size))
    angle, torque = constant
    A_w = np.block([[A, wide], [C, none]])
    B_w = np.block([[wide, B_d, B], [eye, D_d, D]])
    error, error_direct = np.hstack([gain[:, None] * C, np.diag(rate)]), gain[:, None] * np.hstack([eye, D_d, D])
    C_w = np.vstack([error, angle @ np.hstack([C, none]), np.zeros((size, n + size)), error])
    D_w = np.vstack([error_direct, angle @ np.hstack([none, D_d, D]), np.hstack([none, none, torque]), error_direct])
    return System(A_w, B_w, C_w, D_w, 0.0)


def weighted_plant(options: dict[str, float], channel: Channels, plants: PlantSet) -> WeightedPlant:
    """Return the weighted w-plane plant of the nominal loop for complete `options`."""
    pairs, single = 2 * len(channel.momenta), channel.inertial
    size = pairs + single

    def by_channel(name: str) -> FloatArray:
        return np.array([options.get(name, 0.0)] * pairs + [options.get(f"inertial_{name}", 0.0)] * single)

    unit = torque_units(channel, plants.nutation)
    flat = to_w_plane(between(channel.basis.T * unit, plants.of_torques(), channel.basis))
    gain, rate = np.full(size, 1.0 / options["sensitivity_peak"]), 2.0 * np.pi * by_channel("bandwidth_hz")
    disturbed = between(np.diag(by_channel("disturbance")), flat, np.eye(size))
    constant = options["complementary"] * np.eye(size), np.diag(by_channel("torque"))
    arrays = mixed_sensitivity(flat, disturbed, gain, rate, constant)
    return WeightedPlant(arrays=arrays, size=size, weight_gain=gain, weight_rate=rate, torque_unit=unit)


def default_weights(channel: Channels, nutation: float) -> dict[str, float]:
    """Return the options of the weights from rules of thumb."""
    out = {"sensitivity_peak": 1.9, "complementary": 0.5}
    bandwidth = 0.5 * nutation / (2.0 * np.pi)
    if len(channel.momenta):
        out |= {"bandwidth_hz": bandwidth, "disturbance": 0.25, "torque": 0.1}
    if channel.inertial:
        out |= {"inertial_bandwidth_hz": bandwidth, "inertial_disturbance": 0.04, "inertial_torque": 0.15}
    return out


def hinf_options(design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
    """Return all options of the H-infinity loop, those not given from rules of thumb."""
    return completed("hinf", design.options, default_weights(channel, nutation) | {"backoff": 0.05})


def hinf_design(problem: LoopProblem, method: HinfMethod | None = None) -> Designed:
    """Return the H-infinity loop; `method` as for `design.hinf`. Claims: ``gamma`` and ``gamma_optimal``."""
    channel, plants = problem.channel, problem.plants.regular()
    options = hinf_options(problem.design, channel, plants.nutation, plants.period)
    weighted = weighted_plant(options, channel, plants)
    P = weighted.arrays.to_control(*signal_names(weighted.size))
    found = hinf(P, weighted.size, weighted.size, method=method, backoff=options["backoff"])
    sampled = from_w_plane(weighted.weight().series(System.of(found.controller, "controller")), plants.period)
    claims = {"gamma": found.gamma, "gamma_optimal": found.gamma_optimal}
    return Designed(controller=weighted.at_gimbals(sampled, channel), options=options, claims=claims)
