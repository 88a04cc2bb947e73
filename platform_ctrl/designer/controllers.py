"""The controller that settings stand for: built from its knobs at once, or made by a method beforehand."""

from __future__ import annotations

import math
from collections.abc import Mapping

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.design.channels import Channels
from platform_ctrl.design.classical import TUNABLE, classical_controller, starting_values
from platform_ctrl.designer.knobs import CLASSICAL, PARTS
from platform_ctrl.errors import DesignError
from platform_ctrl.job import DesignSpec

# Which optional parts each method knows.
OPTIONAL: dict[str, tuple[str, ...]] = {"classical": ("lag", "notch", "spin_notch")}
# What pulling and tuning may move.
MOVABLE: dict[str, frozenset[str]] = {
    "classical": frozenset(TUNABLE),
    "platform-servo": frozenset({"crossover_hz", "position_hz", "filter_hz", "filter_damping"}),
}


def part_of(option: str) -> str:
    """Return the optional part that an option of a classical loop belongs to, else an empty text."""
    kind = CLASSICAL.get(option)
    return "" if kind is None else kind.part


def parts_given(options: Mapping[str, float]) -> tuple[str, ...]:
    """Return the optional parts that a job's options ask for."""
    return tuple(part for part in PARTS if any(part_of(name) == part for name in options))


def meaningful(options: Mapping[str, float], channel: Channels) -> dict[str, float]:
    """Return those options of a classical loop that mean something with these gyros."""
    pairs, single = len(channel.momenta) > 0, channel.inertial > 0
    own = {"damping_hz", "damping2_hz", "lead_hz", "rolloff_hz"}

    def means(name: str) -> bool:
        if name.startswith("inertial_"):
            return single
        return pairs or not (name in own or part_of(name) == "notch")

    return {name: x for name, x in options.items() if means(name)}


def full_options(design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
    """Return all options of a classical design, those of parts that it does not have as well."""
    given = meaningful(design.options, channel)
    rate_hz = 1.0 / period
    more = {"lag_hz": 0.1 * starting_values(given, channel, nutation, period)["crossover_hz"], "lag_ratio": 3.0}
    if len(channel.momenta):
        more |= {"notch_hz": min(nutation / math.tau, 0.35 * rate_hz), "notch_depth": 0.7, "notch_width": 0.3}
    if len(channel.spins):
        spin = float(channel.spins.mean()) / math.tau
        more |= {"spin_notch_hz": min(spin, 0.4 * rate_hz), "spin_notch_depth": 0.1, "spin_notch_width": 0.1}
    return starting_values(more | given, channel, nutation, period)


def classical_numbers(options: Mapping[str, float], parts: tuple[str, ...], channel: Channels) -> dict[str, float]:
    """Return the options of a classical design without those of parts that are off, or that mean nothing here."""
    return {name: x for name, x in meaningful(options, channel).items() if not part_of(name) or part_of(name) in parts}


def default_numbers(design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
    """Return all options of a method that designs, those that are not given by its rules of thumb.

    Raises
    ------
    DesignError
        An option has no meaning for this loop.
    """
    if design.method == "hinf":
        from platform_ctrl.design.hinf_loop import default_options

        return default_options(design.options, channel, nutation)
    if design.method == "lqg":
        from platform_ctrl.design.lqg_loop import default_options as of_lqg

        return of_lqg(design.options, channel, nutation)
    from platform_ctrl.design.structured.caging import default_options as of_structure

    return of_structure(design.options, design.structure or "pid", channel, nutation, period)


def classical_arrays(
    options: Mapping[str, float], parts: tuple[str, ...], channel: Channels, nutation: float, period: float
) -> tuple[StateArrays, dict[str, float]]:
    """Return the sampled controller of a classical design, and the options it was made of.

    Raises
    ------
    DesignError
        An option makes no sense.
    """
    complete = starting_values(classical_numbers(options, parts, channel), channel, nutation, period)
    controller = StateArrays(*classical_controller(complete, channel, period), dt=period)
    if not all(bool((abs(item) < 1e300).all()) for item in controller[:4]):
        raise DesignError("classical: the options make a controller beyond floating-point numbers; expected others")
    return controller, complete
