"""The classical rate loop: in every channel PI, a second integral, lag, notch and low-pass.

A torque turns a body of inertia J at the rate ω = ∫Q/J dt, so that

    Q = −J ωc (1 + ωi/s) (1 + ω2/s) F(s) N(s) ω/(s/ωr + 1)

crosses over near ωc. Dry friction is a torque that jumps: behind it the rate decays as the integrals take it up, of
which the second one, where there is one, also takes out what changes linearly. The loop that commands a rate from an
angle, a tracker's, has the same plant with J = 1. Every block is sampled by Tustin's rule.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.design.classical.caging import integrated, notch_stage
from platform_ctrl.design.loop import Designed, LoopProblem, completed
from platform_ctrl.design.partition import Channels, first_order, gain
from platform_ctrl.design.sections import Section, flattened
from platform_ctrl.design.tuning import tuned
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import DesignSpec
from platform_ctrl.job.methods import METHODS

# Default crossover over the frequency that the plants' grids go by, and the integral's corner over the crossover.
_CROSSOVER, _INTEGRAL = 0.4, 0.15


def rate_design(problem: LoopProblem) -> Designed:
    """Return the rate loop of a job, with ``tune = true`` moved until its limits are met."""
    channel, plants = problem.channel, problem.plants

    def build(options: dict[str, float]) -> System:
        return rate_controller(options, channel, plants.period)

    start = rate_options(problem.design, channel, plants.nutation, plants.period)
    options = tuned(problem, start, METHODS["pi"].tunable, build, upper_bounds(plants.period))
    return Designed(controller=build(options), options=options)


def upper_bounds(period: float) -> dict[str, float]:
    """Return the largest values that the tuner may use."""
    return {"crossover_hz": 0.2 / period, "notch_hz": 0.4 / period, "notch_depth": 0.999, "notch_width": 1.0}


def rate_options(design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
    """Return all options of the rate loop, those not given from rules of thumb."""
    given = design.options
    crossover = given.get("crossover_hz", _CROSSOVER * nutation / (2.0 * np.pi))
    out = {"crossover_hz": crossover, "integral_hz": _INTEGRAL * crossover, "rolloff_hz": 0.4 / period}
    if "double_integral_hz" in given:
        out["double_integral_hz"] = 0.5 * _INTEGRAL * crossover
    if any(name.startswith("lag") for name in given):
        out |= {"lag_hz": 0.1 * crossover, "lag_ratio": 3.0}
    if any(name.startswith("notch") for name in given):
        out |= {"notch_hz": 3.0 * crossover, "notch_depth": 0.3, "notch_width": 0.3}
    out = completed("pi", given, out)
    for name in ("notch_hz", "rolloff_hz"):
        if out.get(name, 0.0) >= 0.5 / period:
            raise DesignError(f"pi: {name} must be below half the sample rate, got {out[name]:g}")
    return out


def rate_controller(options: dict[str, float], channel: Channels, period: float) -> System:
    """Return the sampled controller (u = K y, positive feedback) of the channels for complete `options`."""
    names = [f"{name}_{k + 1}" for name in ("rate", "torque") for k in range(len(channel.inertias))]
    inputs, outputs = names[: len(channel.inertias)], names[len(channel.inertias) :]
    return flattened(_along(options, channel, period, inputs, outputs), inputs, outputs)


def rate_sections(problem: LoopProblem, options: dict[str, float]) -> tuple[Section, ...]:
    """Return the same controller section by section, from the readings to the torques of the loop."""
    channel, plants = problem.channel, problem.plant_set
    assert plants is not None, "a rate loop has plants"
    if channel.sense is None:
        return _along(options, channel, plants.period, plants.angles, plants.torques)
    rates = tuple(f"rate_{k + 1}" for k in range(len(channel.sense)))
    into = Section("directions", "mix", "readings along the channels", gain(channel.sense), plants.angles, rates)
    return (into, *_along(options, channel, plants.period, rates, plants.torques))


def _along(
    options: dict[str, float], channel: Channels, period: float, inputs: Sequence[str], outputs: Sequence[str]
) -> tuple[Section, ...]:
    """Return the sections of all channels."""
    signals = enumerate(zip(inputs, outputs, strict=True))
    return tuple(
        one for k, (source, target) in signals for one in _channel(options, channel, k, period, source, target)
    )


def _channel(
    options: dict[str, float], channel: Channels, k: int, period: float, source: str, target: str
) -> list[Section]:
    """Return the sections of a channel."""
    name, where = f"_{k + 1}", f"channel {k + 1}"
    out = integrated(options, name, where, source, period)
    if "double_integral_hz" in options:
        corner = options["double_integral_hz"]
        block = first_order(1.0, 2.0 * np.pi * corner, 1.0, 0.0, period)
        note = f"{where}: 1 + w2/s, corner at {corner:.6g} Hz, by Tustin's rule"
        out.append(Section(f"pi2{name}", "integral", note, block, out[-1].outputs, (f"twice{name}",)))
    if "notch_hz" in options:
        out.append(notch_stage(options, "notch", name, where, out[-1].outputs[0], f"sharp{name}", period))
    corner = options["rolloff_hz"]
    block = first_order(0.0, 1.0, 1.0 / (2.0 * np.pi * corner), 1.0, period)
    note = f"{where}: 1/(s/wr + 1), pole at {corner:.6g} Hz, by Tustin's rule"
    out.append(Section(f"low{name}", "low-pass", note, block, out[-1].outputs, (f"smooth{name}",)))
    strength = channel.inertias[k] * 2.0 * np.pi * options["crossover_hz"]
    note = f"inertia {channel.inertias[k]:.6g} kg m2 times {options['crossover_hz']:.6g} Hz"
    out.append(Section(f"gain{name}", "mix", note, gain(-strength), out[-1].outputs, (target,)))
    return out
