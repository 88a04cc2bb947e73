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

import numpy as np

from platform_ctrl.design.blocks import Block, first_order, gain, notch
from platform_ctrl.design.channels import Channels
from platform_ctrl.design.diagram import Stage, flattened
from platform_ctrl.design.options import completed
from platform_ctrl.errors import DesignError
from platform_ctrl.frozen import FloatArray

# Which options may be moved by the tuner; the integral action is the user's: it trades ramp error for margin.
TUNABLE = (
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


def upper_bounds(period: float) -> dict[str, float]:
    """Return the largest values that the tuner may use.

    A roll-off at 0.45 of the sample rate: beyond 1/π of it Tustin's pole turns negative, and near −1 it rings.
    """
    rate_hz = 1.0 / period
    return {
        "rolloff_hz": 0.45 * rate_hz,
        "inertial_rolloff_hz": 0.45 * rate_hz,
        "notch_hz": 0.4 * rate_hz,
        "notch_depth": 0.999,
        "notch_width": 1.0,
    }


def starting_values(given: dict[str, float], channel: Channels, nutation: float, period: float) -> dict[str, float]:
    """Return all options, those not given from rules of thumb: the nutation frequency sets the scale."""
    nutation_hz, rate_hz = nutation / (2.0 * np.pi), 1.0 / period
    out: dict[str, float] = {"crossover_hz": 0.6 * nutation_hz}
    out["integral_hz"] = 0.04 * given.get("crossover_hz", out["crossover_hz"])
    if len(channel.momenta):
        out |= {
            "damping_hz": 0.9 * nutation_hz,
            "damping2_hz": 1.1 * nutation_hz,
            "lead_hz": 0.12 * nutation_hz,
            "rolloff_hz": 0.4 * rate_hz,
        }
        if any(name.startswith("notch") for name in given):
            out |= {"notch_hz": nutation_hz, "notch_depth": 0.7, "notch_width": 0.3}
    if any(name.startswith("lag") for name in given):
        out |= {"lag_hz": 0.1 * given.get("crossover_hz", out["crossover_hz"]), "lag_ratio": 3.0}
    if any(name.startswith("spin_notch") for name in given):
        out |= {"spin_notch_hz": _spin_hz(given, channel), "spin_notch_depth": 0.1, "spin_notch_width": 0.1}
    if channel.inertial:
        out |= {
            "inertial_crossover_hz": 0.6 * nutation_hz,
            "inertial_lead_hz": 0.2 * nutation_hz,
            "inertial_rolloff_hz": 0.4 * rate_hz,
        }
    out = completed("classical", given, out)
    for name in ("notch_hz", "spin_notch_hz"):
        if out.get(name, 0.0) >= 0.5 * rate_hz:
            raise DesignError(f"classical: {name} = {out[name]:g}; expected less than half the sample rate")
    if not out.get("lag_ratio", 2.0) > 1.0:
        raise DesignError(
            f"classical: lag_ratio = {out['lag_ratio']:g}; expected more than 1, the gain at low frequencies"
        )
    return out


def _spin_hz(given: dict[str, float], channel: Channels) -> float:
    """Spin frequency of the rotors, Hz, where it is not given."""
    if "spin_notch_hz" in given:
        return given["spin_notch_hz"]
    if not len(channel.spins) or np.ptp(channel.spins) > 1e-3 * channel.spins.max():
        spins = ", ".join(f"{x / (2.0 * np.pi):.4g}" for x in channel.spins) or "none"
        raise DesignError(
            f"classical: spin_notch_hz is not given, and the rotors of this loop spin at {spins} Hz; expected one "
            f"spin; "
            "give spin_notch_hz"
        )
    return float(channel.spins.mean() / (2.0 * np.pi))


def classical_controller(options: dict[str, float], channel: Channels, period: float) -> Block:
    """Return the sampled controller (u = K y, no hidden sign) for complete `options` (see `starting_values`).

    Parameters
    ----------
    options
        Frequencies in Hz. ``crossover_hz`` ωc; ``integral_hz`` ωi; ``damping_hz``, ``damping2_hz`` d_1 and d_2 of the
        pair's axes; ``lead_hz`` ωz; ``rolloff_hz`` ωr; ``lag_hz`` ωl and ``lag_ratio``, ``notch_hz``,
        ``notch_depth``, ``notch_width``, and the same with ``spin_``, where there is one; ``inertial_...`` of the
        inertial directions.
    channel
        Pairs and inertial directions.
    period
        s.
    """
    directions, torques = (
        [_measured(k) for k in range(len(channel.basis))],
        [_set(k) for k in range(len(channel.basis))],
    )
    A, B, C, D = flattened(classical_stages(options, channel, period), directions, torques)
    basis: FloatArray = channel.basis
    return A, B @ basis, basis.T @ C, basis.T @ D @ basis


def classical_diagram(
    options: dict[str, float], channel: Channels, period: float, angles: Sequence[str], torques: Sequence[str]
) -> tuple[Stage, ...]:
    """Return the same controller block by block, from the `angles` to the `torques` of the gimbals."""
    count = range(len(channel.basis))
    into, out = tuple(_measured(k) for k in count), tuple(_set(k) for k in count)
    return (
        Stage("directions", "mix", "angles in the directions of the gyros", gain(channel.basis), tuple(angles), into),
        *classical_stages(options, channel, period),
        Stage("torques", "mix", "torques back on the gimbals", gain(channel.basis.T), out, tuple(torques)),
    )


def classical_stages(options: dict[str, float], channel: Channels, period: float) -> list[Stage]:
    """Return the blocks between the measured directions and the torques in these directions."""
    rad = {name: 2.0 * np.pi * x for name, x in options.items() if name.endswith("_hz")}
    pairs = len(channel.momenta)
    inputs = [_measured(k) for k in range(len(channel.basis))]
    out: list[Stage] = []
    if "spin_notch_hz" in options:
        spin = notch(rad["spin_notch_hz"], options["spin_notch_depth"], options["spin_notch_width"], period)
        for k, source in enumerate(inputs):
            inputs[k] = f"quiet_{k + 1}"
            note = "at the spin frequency: " + _notch_note(options, "spin_notch")
            out.append(Stage(f"spin_notch_{k + 1}", "notch", note, spin, (source,), (inputs[k],)))
    integral = first_order(1.0, rad["integral_hz"], 1.0, 0.0, period)
    for k in range(2 * pairs):
        name, source = f"{k // 2 + 1}_{k % 2 + 1}", inputs[k]
        last = _integrated(out, options, integral, name, source, period)
        if "notch_hz" in options:
            sharp = notch(rad["notch_hz"], options["notch_depth"], options["notch_width"], period)
            out.append(
                Stage(f"notch_{name}", "notch", _notch_note(options, "notch"), sharp, (last,), (f"cross_{name}",))
            )
            last = f"cross_{name}"
        lead = first_order(1.0, rad["lead_hz"], 1.0 / rad["rolloff_hz"], 1.0, period)
        note = f"(s + wz)/(s/wr + 1): zero at {options['lead_hz']:.6g} Hz, pole at {options['rolloff_hz']:.6g} Hz"
        out.append(Stage(f"lead_{name}", "lead", note, lead, (source,), (f"rate_{name}",)))
        if k % 2:
            # A torque about one axis turns the other: integrals act across, leads directly.
            h = channel.momenta[k // 2]
            strength = h * rad["crossover_hz"]
            one, two = (
                -channel.inertias[k - 1 + i] * rad[option] for i, option in enumerate(("damping_hz", "damping2_hz"))
            )
            mix = np.array([[0.0, one, -strength, 0.0], [strength, 0.0, 0.0, two]])
            cross = (last.removesuffix(name) + f"{k // 2 + 1}_1", f"rate_{k // 2 + 1}_1")
            note = (
                f"across: h = {h:.6g} N m s times {options['crossover_hz']:.6g} Hz; direct: inertia times "
                f"{options['damping_hz']:.6g} and {options['damping2_hz']:.6g} Hz"
            )
            out.append(
                Stage(
                    f"pair_{k // 2 + 1}",
                    "mix",
                    note,
                    gain(mix),
                    (*cross, last, f"rate_{name}"),
                    (_set(k - 1), _set(k)),
                )
            )
    for k in range(2 * pairs, len(channel.inertias)):
        name = f"inertial_{k + 1 - 2 * pairs}"
        w0, wz = rad["inertial_crossover_hz"], rad["inertial_lead_hz"]
        strength = channel.inertias[k] * w0**2 / np.hypot(1.0, w0 / wz)
        lead = first_order(1.0 / wz, 1.0, 1.0 / rad["inertial_rolloff_hz"], 1.0, period)
        last = _integrated(out, options, integral, name, inputs[k], period)
        zero, pole = options["inertial_lead_hz"], options["inertial_rolloff_hz"]
        note = f"(s/wz + 1)/(s/wr + 1): zero at {zero:.6g} Hz, pole at {pole:.6g} Hz"
        out.append(Stage(f"lead_{name}", "lead", note, lead, (last,), (f"rate_{name}",)))
        note = f"inertia {channel.inertias[k]:.6g} kg m2, crossover at {options['inertial_crossover_hz']:.6g} Hz"
        out.append(Stage(name, "mix", note, gain(-strength), (f"rate_{name}",), (_set(k),)))
    return out


def _integrated(
    out: list[Stage], options: dict[str, float], integral: Block, name: str, source: str, period: float
) -> str:
    """Append integral and lag of a direction and return the name of what they give."""
    corner = options["integral_hz"]
    last = f"integral_{name}"
    out.append(Stage(f"pi_{name}", "integral", f"1 + wi/s: corner at {corner:.6g} Hz", integral, (source,), (last,)))
    if "lag_hz" not in options:
        return last
    zero, pole = options["lag_hz"], options["lag_hz"] / options["lag_ratio"]
    lag = first_order(1.0, 2.0 * np.pi * zero, 1.0, 2.0 * np.pi * zero / options["lag_ratio"], period)
    note = f"(s + wl)/(s + wl/ratio): zero at {zero:.6g} Hz, pole at {pole:.6g} Hz"
    out.append(Stage(f"lag_{name}", "lag", note, lag, (last,), (f"lagged_{name}",)))
    return f"lagged_{name}"


def _notch_note(options: dict[str, float], name: str) -> str:
    depth, width = options[f"{name}_depth"], options[f"{name}_width"]
    return f"notch at {options[f'{name}_hz']:.6g} Hz, depth {depth:.6g}, width {width:.6g}"


def _measured(k: int) -> str:
    return f"direction_{k + 1}"


def _set(k: int) -> str:
    return f"torque_{k + 1}"
