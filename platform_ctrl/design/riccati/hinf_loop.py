"""The full-order caging loop: mixed sensitivity in the H-infinity norm, on the exactly sampled plant.

The plant with hold, delay and torquer lag is carried to the w-plane by the bilinear map, which keeps stability and the
H-infinity norm: no Padé, no reduction. There it is weighted (see `weighting`): W_e = 1/M + ω_e/s bounds S by a line
that rises through the bandwidth to the peak M, W_t bounds T.
"""

from __future__ import annotations

from platform_ctrl.analysis.arrays import named_system
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.sampled import from_w_plane
from platform_ctrl.design.loop import completed
from platform_ctrl.design.partition import Block, Channels, series
from platform_ctrl.design.synthesis import HinfMethod, hinf
from platform_ctrl.design.weighting import default_weights, signal_names, weighted_plant


def default_options(given: dict[str, float], channel: Channels, nutation: float) -> dict[str, float]:
    """Return all options, those not given from rules of thumb."""
    out = default_weights(channel, nutation) | {"backoff": 0.05}
    return completed("hinf", given, out)


def hinf_controller(
    given: dict[str, float], channel: Channels, plants: PlantSet, method: HinfMethod | None = None
) -> tuple[Block, dict[str, float], dict[str, float]]:
    """Return the sampled controller, the complete options, and the claims ``gamma`` and ``gamma_optimal``.

    `method` is that of `design.hinf`: by default Riccati equations where their assumptions hold.
    """
    options = default_options(given, channel, plants.nutation)
    weighted = weighted_plant(options, channel, plants)
    P = named_system(weighted.arrays, *signal_names(weighted.size))
    found = hinf(P, weighted.size, weighted.size, method=method, backoff=options["backoff"])
    K = found.controller
    sampled = from_w_plane(*series(weighted.weight(), (K.A, K.B, K.C, K.D)), plants.period)
    controller = weighted.at_gimbals(sampled, channel)
    return controller, options, {"gamma": found.gamma, "gamma_optimal": found.gamma_optimal}
