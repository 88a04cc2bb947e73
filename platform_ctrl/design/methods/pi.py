"""The classical rate loop: in every channel PI, a second integral, lag, notch and low-pass.

A torque turns a body of inertia J at the rate ω = ∫Q/J dt, so that

    Q = −J ωc (1 + ωi/s) (1 + ω2/s) F(s) N(s) ω/(s/ωr + 1)

crosses over near ωc. Dry friction is a torque that jumps: behind it the rate decays as the integrals take it up, of
which the second one, where there is one, also takes out what changes linearly. The loop that commands a rate from an
angle, a tracker's, has the same plant with J = 1. Every block is sampled by Tustin's rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.method import Option, SectionedMethod, hertz
from platform_ctrl.design.methods.classical import OPTIONS as CLASSICAL
from platform_ctrl.design.methods.classical import integrated, notch_stage
from platform_ctrl.design.sections import Section, first_order, gain
from platform_ctrl.job.methods import DesignSpec

# Default crossover over the reference frequency of the plants' grids, and the integral's corner over the crossover.
_CROSSOVER, _INTEGRAL = 0.4, 0.15


OPTIONS: dict[str, Option] = {
    "crossover_hz": hertz("crossover ωc", "gains", "gain over inertia: where each channel crosses over", high=0.2),
    "integral_hz": hertz("integral", "gains", "below this frequency the integral acts"),
    "double_integral_hz": hertz(
        "second integral", "gains", "below this frequency a second integral acts, against friction", part="second"
    ),
    "rolloff_hz": hertz("roll-off", "lead", "pole of the low-pass behind", high=0.45, below_nyquist=True),
    **{name: option for name, option in CLASSICAL.items() if name.startswith(("notch_", "lag_"))},
}


class PI(SectionedMethod):
    """The classical rate loop."""

    key = "pi"
    kinds = ("rate", "tracking")
    options = OPTIONS
    advice = "a lower crossover_hz, or tune = true"
    tunable = ("crossover_hz", "integral_hz", "double_integral_hz", "notch_hz", "notch_depth", "notch_width")
    instant = True
    parts: ClassVar = {
        "second": ("second integral", "takes out what dry friction does at low frequencies"),
        "lag": ("lag", "raises the gain at low frequencies"),
        "notch": ("notch", "takes gain out at a resonance"),
    }
    families: ClassVar = {
        "speed": dict.fromkeys(("crossover_hz", "integral_hz", "double_integral_hz", "lag_hz"), 1.0),
        "robustness": dict.fromkeys(("integral_hz", "double_integral_hz", "lag_hz"), -1.0),
    }

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options, those that are not given by rules of thumb."""
        given = design.options
        crossover = given.get("crossover_hz", _CROSSOVER * nutation / (2.0 * np.pi))
        out = {"crossover_hz": crossover, "integral_hz": _INTEGRAL * crossover, "rolloff_hz": 0.4 / period}
        if "double_integral_hz" in given:
            out["double_integral_hz"] = 0.5 * _INTEGRAL * crossover
        if any(name.startswith("lag") for name in given):
            out |= {"lag_hz": 0.1 * crossover, "lag_ratio": 3.0}
        if any(name.startswith("notch") for name in given):
            out |= {"notch_hz": 3.0 * crossover, "notch_depth": 0.3, "notch_width": 0.3}
        return self.completed(given, out, period)

    def along(
        self, options: dict[str, float], channel: Channels, period: float, inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[Section]:
        """Return the sections from what is measured in the directions to the torques there."""
        signals = enumerate(zip(inputs, outputs, strict=True))
        return [one for k, (source, target) in signals for one in _channel(options, channel, k, period, source, target)]


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
