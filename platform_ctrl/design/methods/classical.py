"""The classical caging loop: cross-axis PI, direct-axis lead, lag, notches; PID where no gyro acts.

In a gyroscopic pair (y1, y2) with momentum h a torque about one axis turns the other, so the PI acts across:

    Q1 = −h ωc (1 + ωi/s) F(s) N(s) y2 − D1(s) y1,        Q2 = +h ωc (1 + ωi/s) F(s) N(s) y1 − D2(s) y2

with the direct-axis lead D_k = J_k d_k (s + ωz)/(s/ωr + 1), which damps nutation, the notch N, and the lag
F = (s + ωl)/(s + ωl/ratio), which is one at high frequencies and `ratio` at low ones. Cross gain alone destabilises
nutation at a growth rate about equal to ωc: d_k has to outweigh it. In an inertial direction

    Q = −J ω0² / √(1 + (ω0/ωz)²) (1 + ωi/s) F(s) (s/ωz + 1)/(s/ωr + 1) y.

A second notch at the spin frequency, in front of everything, keeps what an unbalanced rotor shakes from the torquers.

Every block is sampled by Tustin's rule; channels share their states, so that no integrator is doubled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.method import Option, SectionedMethod, hertz, number
from platform_ctrl.design.sections import Section, first_order, gain, notch
from platform_ctrl.errors import DesignError
from platform_ctrl.job.methods import DesignSpec

# Highest frequencies are shares of the sample rate.
# A roll-off at 0.45 of the sample rate: beyond 1/π of it Tustin's pole turns negative, and near −1 it rings.
OPTIONS: dict[str, Option] = {
    "crossover_hz": hertz(
        "crossover ωc", "gains", "cross-axis gain of the gyroscopic pairs: where the loop crosses over, about"
    ),
    "integral_hz": hertz("integral", "gains", "below this frequency the integral acts: trades ramp error for margin"),
    "damping_hz": hertz("damping 1", "gains", "direct-axis gain on the first axis of a pair: damps nutation"),
    "damping2_hz": hertz("damping 2", "gains", "direct-axis gain on the second axis of a pair: damps nutation"),
    "inertial_crossover_hz": hertz("inertial crossover", "gains", "crossover where no gyro stiffens the gimbals"),
    "lead_hz": hertz("lead zero", "lead", "zero of the direct-axis lead"),
    "rolloff_hz": hertz("lead roll-off", "lead", "pole of the direct-axis lead", high=0.45),
    "inertial_lead_hz": hertz("inertial lead zero", "lead", "zero of the lead where no gyro acts"),
    "inertial_rolloff_hz": hertz("inertial roll-off", "lead", "pole of that lead", high=0.45),
    "notch_hz": hertz(
        "notch", "notch", "centre of the notch in the cross-axis path", high=0.4, part="notch", below_nyquist=True
    ),
    "notch_depth": number("notch depth", "gain at its centre", 0.01, 0.999, "notch", part="notch"),
    "notch_width": number("notch width", "its damping ratio", 0.01, 1.0, "notch", part="notch"),
    "spin_notch_hz": hertz(
        "spin notch",
        "notch",
        "centre of the notch in front of everything: the rotors' spin",
        high=0.4,
        part="spin_notch",
        below_nyquist=True,
    ),
    "spin_notch_depth": number("spin notch depth", "gain at its centre", 0.01, 0.999, "notch", part="spin_notch"),
    "spin_notch_width": number("spin notch width", "its damping ratio", 0.01, 1.0, "notch", part="spin_notch"),
    "lag_hz": hertz("lag", "lag", "below this frequency the lag raises the gain", part="lag"),
    "lag_ratio": number("lag ratio", "by how much it raises it", 1.01, 100.0, "lag", part="lag"),
}


class Classical(SectionedMethod):
    """The classical caging loop."""

    key = "classical"
    kinds = ("caging", "pointing")
    options = OPTIONS
    advice = "a lower crossover_hz, or tune = true"
    # In this order: the simplex depends on it. The integral action is the user's: it trades ramp error for margin.
    tunable = (
        "crossover_hz",
        "damping_hz",
        "damping2_hz",
        "lead_hz",
        "rolloff_hz",
        "inertial_crossover_hz",
        "inertial_lead_hz",
        "inertial_rolloff_hz",
        "notch_hz",
        "notch_depth",
        "notch_width",
    )
    instant = True
    parts: ClassVar = {
        "lag": ("lag", "raises the gain at low frequencies"),
        "notch": ("notch", "takes gain out of the cross-axis path, at nutation as a rule"),
        "spin_notch": ("spin notch", "keeps what an unbalanced rotor shakes from the torquers"),
    }
    # Rules of thumb keep these frequencies in proportion. More lead and less integral action at one crossover: margin.
    families: ClassVar = {
        "speed": dict.fromkeys(
            (
                *("crossover_hz", "inertial_crossover_hz", "integral_hz", "damping_hz", "damping2_hz"),
                *("lead_hz", "inertial_lead_hz", "lag_hz"),
            ),
            1.0,
        ),
        "robustness": dict.fromkeys(("integral_hz", "lead_hz", "lag_hz", "inertial_lead_hz"), -1.0),
    }

    def movable(self, options: dict[str, float], channel: Channels) -> list[str]:
        """Return the options that the tuner moves: without a gyroscopic pair nothing crosses over across."""
        return [name for name in super().movable(options, channel) if name != "crossover_hz" or len(channel.momenta)]

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options, those that are not given from rules of thumb: the nutation frequency sets the scale."""
        given = design.options
        nutation_hz, rate_hz = nutation / (2.0 * np.pi), 1.0 / period
        out: dict[str, float] = {"crossover_hz": 0.6 * nutation_hz}
        # The slowest crossover that the loop has: the integral acts in all of its directions.
        acting = ["crossover_hz"] * bool(len(channel.momenta)) + ["inertial_crossover_hz"] * bool(channel.inertial)
        slowest = min(given.get(name, 0.6 * nutation_hz) for name in acting or ["crossover_hz"])
        out["integral_hz"] = 0.04 * slowest
        if len(channel.momenta):
            out |= {"damping_hz": 0.9 * nutation_hz, "damping2_hz": 1.1 * nutation_hz}
            out |= {"lead_hz": 0.12 * nutation_hz, "rolloff_hz": 0.4 * rate_hz}
            if any(name.startswith("notch") for name in given):
                out |= {"notch_hz": nutation_hz, "notch_depth": 0.7, "notch_width": 0.3}
        if any(name.startswith("lag") for name in given):
            out |= {"lag_hz": 0.1 * slowest, "lag_ratio": 3.0}
        if any(name.startswith("spin_notch") for name in given):
            out |= {"spin_notch_hz": _spin_hz(given, channel), "spin_notch_depth": 0.1, "spin_notch_width": 0.1}
        if channel.inertial:
            out |= {"inertial_crossover_hz": 0.6 * nutation_hz, "inertial_lead_hz": 0.2 * nutation_hz}
            out["inertial_rolloff_hz"] = 0.4 * rate_hz
        out = self.completed(given, out, period)
        if not out.get("lag_ratio", 2.0) > 1.0:
            raise DesignError(
                f"classical: lag_ratio, the gain at low frequencies, must exceed 1, got {out['lag_ratio']:g}"
            )
        return out

    def along(
        self, options: dict[str, float], channel: Channels, period: float, inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[Section]:
        """Return the sections from what is measured in the directions to the torques there."""
        inputs, out = list(inputs), list[Section]()
        if "spin_notch_hz" in options:
            for k, source in enumerate(inputs):
                inputs[k] = f"quiet_{k + 1}"
                out.append(notch_stage(options, "spin_notch", f"_{k + 1}", "rotors' spin", source, inputs[k], period))
        pairs = len(channel.momenta)
        for pair in range(pairs):
            own = slice(2 * pair, 2 * pair + 2)
            out += _pair(options, channel, pair, inputs[own], outputs[own], period)
        for k in range(2 * pairs, len(inputs)):
            out += _inertial(options, channel, k, inputs[k], outputs[k], period)
        return out


def _spin_hz(given: dict[str, float], channel: Channels) -> float:
    """Return the spin frequency of the rotors, Hz, where it is not given."""
    if "spin_notch_hz" in given:
        return given["spin_notch_hz"]
    if not len(channel.spins) or np.ptp(channel.spins) > 1e-3 * channel.spins.max():
        spins = ", ".join(f"{x / (2.0 * np.pi):.4g}" for x in channel.spins) or "none"
        raise DesignError(
            f"classical: the rotors of this loop do not have one spin frequency, but {spins} Hz; give spin_notch_hz"
        )
    return float(channel.spins.mean() / (2.0 * np.pi))


def _pair(
    options: dict[str, float],
    channel: Channels,
    pair: int,
    inputs: Sequence[str],
    outputs: Sequence[str],
    period: float,
) -> list[Section]:
    """Return the sections of a gyroscopic pair: a torque about one axis turns the other, so integrals act across."""
    out: list[Section] = []
    crosses, rates = [], []
    for axis, source in enumerate(inputs, 1):
        name, where = f"_{pair + 1}_{axis}", f"pair {pair + 1}, axis {axis}"
        out += integrated(options, name, where, source, period)
        if "notch_hz" in options:
            out.append(notch_stage(options, "notch", name, where, out[-1].outputs[0], f"sharp{name}", period))
        crosses.append(out[-1].outputs[0])
        lead = first_order(1.0, _rad(options, "lead_hz"), 1.0 / _rad(options, "rolloff_hz"), 1.0, period)
        zero, pole = options["lead_hz"], options["rolloff_hz"]
        note = f"{where}: (s + wz)/(s/wr + 1), zero at {zero:.6g} Hz, pole at {pole:.6g} Hz, by Tustin's rule"
        rates.append(f"rate{name}")
        out.append(Section(f"lead{name}", "lead", note, lead, (source,), (rates[-1],)))
    h = channel.momenta[pair]
    across = h * _rad(options, "crossover_hz")
    one, two = (
        -channel.inertias[2 * pair + i] * _rad(options, option)
        for i, option in enumerate(("damping_hz", "damping2_hz"))
    )
    mix = np.array([[0.0, one, -across, 0.0], [across, 0.0, 0.0, two]])
    note = (
        f"across: h = {h:.6g} N m s times {options['crossover_hz']:.6g} Hz; direct: inertia times "
        f"{options['damping_hz']:.6g} and {options['damping2_hz']:.6g} Hz"
    )
    sources = (crosses[0], rates[0], crosses[1], rates[1])
    out.append(Section(f"pair_{pair + 1}", "mix", note, gain(mix), sources, tuple(outputs)))
    return out


def _inertial(
    options: dict[str, float], channel: Channels, k: int, source: str, target: str, period: float
) -> list[Section]:
    """Return the sections of a direction without gyroscopic action: a PID."""
    number = k + 1 - 2 * len(channel.momenta)
    name, where = f"_inertial_{number}", f"inertial direction {number}"
    w0, wz = _rad(options, "inertial_crossover_hz"), _rad(options, "inertial_lead_hz")
    strength = channel.inertias[k] * w0**2 / np.hypot(1.0, w0 / wz)
    out = integrated(options, name, where, source, period)
    lead = first_order(1.0 / wz, 1.0, 1.0 / _rad(options, "inertial_rolloff_hz"), 1.0, period)
    zero, pole = options["inertial_lead_hz"], options["inertial_rolloff_hz"]
    note = f"{where}: (s/wz + 1)/(s/wr + 1), zero at {zero:.6g} Hz, pole at {pole:.6g} Hz, by Tustin's rule"
    out.append(Section(f"lead{name}", "lead", note, lead, out[-1].outputs, (f"rate{name}",)))
    note = f"inertia {channel.inertias[k]:.6g} kg m2, crossover at {options['inertial_crossover_hz']:.6g} Hz"
    out.append(Section(f"gain{name}", "mix", note, gain(-strength), out[-1].outputs, (target,)))
    return out


def integrated(options: dict[str, float], name: str, where: str, source: str, period: float) -> list[Section]:
    """Return the PI of a direction, and behind it the lag where there is one."""
    integral = first_order(1.0, _rad(options, "integral_hz"), 1.0, 0.0, period)
    note = f"{where}: 1 + wi/s, corner at {options['integral_hz']:.6g} Hz, by Tustin's rule"
    out = [Section(f"pi{name}", "integral", note, integral, (source,), (f"cross{name}",))]
    if "lag_hz" in options:
        corner, ratio = options["lag_hz"], options["lag_ratio"]
        lag = first_order(1.0, _rad(options, "lag_hz"), 1.0, _rad(options, "lag_hz") / ratio, period)
        note = f"{where}: (s + wl)/(s + wl/{ratio:.6g}), zero at {corner:.6g} Hz, pole at {corner / ratio:.6g} Hz"
        out.append(Section(f"lag{name}", "lag", f"{note}, by Tustin's rule", lag, out[-1].outputs, (f"lagged{name}",)))
    return out


def notch_stage(
    options: dict[str, float], option: str, name: str, where: str, source: str, target: str, period: float
) -> Section:
    """Return a notch by the options that begin with `option`."""
    depth, width = options[f"{option}_depth"], options[f"{option}_width"]
    block = notch(_rad(options, f"{option}_hz"), depth, width, period)
    hertz = options[f"{option}_hz"]
    note = f"{where}: notch at {hertz:.6g} Hz, depth {depth:.6g}, width {width:.6g}, by Tustin's rule prewarped there"
    return Section(f"{option}{name}", "notch", note, block, (source,), (target,))


def _rad(options: dict[str, float], name: str) -> float:
    return 2.0 * np.pi * options[name]
