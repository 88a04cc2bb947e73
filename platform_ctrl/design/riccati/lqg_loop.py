"""The full-order caging loop in the H2 norm: LQG on the exactly sampled plant, with the weights of the H-infinity loop.

n and d are white samples, and what is least is the rms of z (see `weighting`): the peak of S is not bounded, it is the
torque disturbance and the torque that set margins and noise. The problem is posed and solved in z, where the present
sample counts; the integrator of W_e gives integral action.
"""

from __future__ import annotations

from platform_ctrl.analysis.arrays import StateArrays, named_system
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.sampled import from_w_plane
from platform_ctrl.design.loop import completed
from platform_ctrl.design.partition import Block, Channels, series
from platform_ctrl.design.riccati.h2 import h2
from platform_ctrl.design.weighting import default_weights, signal_names, weighted_plant


def default_options(given: dict[str, float], channel: Channels, nutation: float) -> dict[str, float]:
    """Return all options, those not given from rules of thumb."""
    defaults = default_weights(channel, nutation)
    # The rms of S pays for bandwidth at every frequency, the peak at one: half the bandwidth, twice the disturbance.
    factors = {"bandwidth_hz": 0.5, "disturbance": 2.0}
    defaults = {name: x * factors.get(name.removeprefix("inertial_"), 1.0) for name, x in defaults.items()}
    return completed("lqg", given, defaults)


def lqg_controller(
    given: dict[str, float], channel: Channels, plants: PlantSet
) -> tuple[Block, dict[str, float], dict[str, float]]:
    """Return the sampled controller, the complete options, and the claims ``gamma`` and ``gamma_optimal``."""
    options = default_options(given, channel, plants.nutation)
    weighted = weighted_plant(options, channel, plants)
    size, period = weighted.size, plants.period
    P = named_system(StateArrays(*from_w_plane(*weighted.arrays[:4], period), dt=period), *signal_names(size))
    found = h2(P, size, size)
    K = found.controller
    sampled = series(from_w_plane(*weighted.weight(), period), (K.A, K.B, K.C, K.D))
    controller = weighted.at_gimbals(sampled, channel)
    return controller, options, {"gamma": found.gamma, "gamma_optimal": found.gamma_optimal}
