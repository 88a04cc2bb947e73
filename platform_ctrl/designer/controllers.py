"""The controller that settings stand for: built from its knobs at once, or made by a method beforehand."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.design.channels import Channels
from platform_ctrl.design.classical import TUNABLE, classical_controller, starting_values
from platform_ctrl.designer.knobs import CLASSICAL, PARTS
from platform_ctrl.errors import DesignError
from platform_ctrl.job import DesignSpec

# Which optional parts each method knows.
OPTIONAL: dict[str, tuple[str, ...]] = {"classical": ("lag", "notch", "spin_notch")}
# Options that act in gyroscopic pairs alone, beside those of the notch.
_OF_PAIRS = frozenset({"crossover_hz", "damping_hz", "damping2_hz", "lead_hz", "rolloff_hz"})
# The one that a classical design takes whatever its gyros: the default of the integral's corner is a share of it.
ALWAYS = "crossover_hz"
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


def acts(option: str, channel: Channels) -> bool:
    """Return whether the controller of a classical loop with these gyros is made of an option."""
    if option.startswith("inertial_"):
        return channel.inertial > 0
    return len(channel.momenta) > 0 or not (option in _OF_PAIRS or part_of(option) == "notch")


def meaningful(options: Mapping[str, float], channel: Channels) -> dict[str, float]:
    """Return those options that a classical design with these gyros takes."""
    return {name: x for name, x in options.items() if name == ALWAYS or acts(name, channel)}


def full_options(given: Mapping[str, float], channel: Channels, nutation: float, period: float) -> dict[str, float]:
    """Return all options of a classical design, those of parts that it does not have as well."""
    own = meaningful(given, channel)
    rate_hz = 1.0 / period
    more = {"lag_hz": 0.1 * starting_values(own, channel, nutation, period)["crossover_hz"], "lag_ratio": 3.0}
    if len(channel.momenta):
        more |= {"notch_hz": min(nutation / math.tau, 0.35 * rate_hz), "notch_depth": 0.7, "notch_width": 0.3}
    if len(channel.spins):
        spin = float(channel.spins.mean()) / math.tau
        more |= {"spin_notch_hz": min(spin, 0.4 * rate_hz), "spin_notch_depth": 0.1, "spin_notch_width": 0.1}
    return starting_values(more | own, channel, nutation, period)


def acting_options(
    options: Mapping[str, float], channel: Channels, nutation: Callable[[], float], period: float
) -> dict[str, float]:
    """Return the options that a classical loop with these gyros is, or with a part switched on would be, made of.

    Rotors that were set going or stopped since the `options` were put together need others: by rules of thumb.
    """
    known = {name: x for name, x in options.items() if acts(name, channel)}
    wanted = [
        name
        for name in CLASSICAL
        if acts(name, channel) and (part_of(name) != "spin_notch" or len(channel.spins)) and name not in known
    ]
    rules = full_options({}, channel, nutation(), period) if wanted else {}
    return known | {name: rules[name] for name in wanted}


def parts_used(options: Mapping[str, float], parts: tuple[str, ...]) -> dict[str, float]:
    """Return the options of a classical design without those of parts that are off."""
    return {name: x for name, x in options.items() if not part_of(name) or part_of(name) in parts}


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


def classical_arrays(options: Mapping[str, float], channel: Channels, period: float) -> StateArrays:
    """Return the sampled controller of a classical design of complete options.

    Raises
    ------
    DesignError
        An option makes no sense.
    """
    controller = StateArrays(*classical_controller(dict(options), channel, period), dt=period)
    if not all(bool((abs(item) < 1e300).all()) for item in controller[:4]):
        raise DesignError("classical: the options make a controller beyond floating-point numbers; expected others")
    return controller
