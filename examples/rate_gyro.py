"""Rate gyro: gain, natural frequency, damping, bandwidth, and what other motion than the input rate does to it.

    python examples/rate_gyro.py                   prints theory and computed values
    python examples/rate_gyro.py -o rate.png       draws step responses and the Bode plot as well

With the spin axis along 1, the input axis along 2 and the output axis along 3 the gimbal's angle theta follows

    J theta'' + d theta' + (k + L Omega1) theta = L Omega2 - J Omega3'

A rate Omega1 about the spin axis stiffens (or softens) the instrument: gyroscopic restraint.
"""

from __future__ import annotations

import argparse
import dataclasses
from math import degrees, sqrt

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import brentq

import platform_ctrl as pc

ABOUT_SPIN = 2.0  # rad/s
RATE = 0.3  # rad/s


def row(quantity: str, theory: float, computed: float) -> None:
    """Print one line of the table."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}")


def step_response(gyro: pc.Platform, Omega1: float, Omega2: float, duration: float = 0.15):
    """Time and angle of the non-linear gyro whose case turns at constant rates from t = 0 on."""
    heavy = dataclasses.replace(gyro, root_inertia=1e3 * np.eye(3))  # the vehicle: nothing changes its rates
    steps = round(duration / 1e-5)
    out = pc.simulation.rollout(heavy, [[0.0]], [[Omega1, Omega2, 0.0, 0.0]], 1e-5, steps, every=50)
    return out.t, out.q_history[0, :, 0]


def bandwidth(system) -> float:
    """Frequency at which the gain from Omega2 has fallen by 3 dB, rad/s."""

    def excess(frequency: float) -> float:
        gain = np.abs(pc.analysis.frequency_response(system["theta", "Omega2"], np.array([1e-3, frequency]))).ravel()
        return gain[1] / gain[0] - sqrt(0.5)

    return brentq(excess, 1.0, 1e4)


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Gain, bandwidth and errors of a rate gyro.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of step responses and the Bode plot")
    file = parser.parse_args().o

    gyro = pc.read_platform("rate_gyro")
    balanced = dataclasses.replace(gyro, unbalances=())
    model = pc.linearise(gyro)
    J, L = model.M[0, 0], gyro.rotors[0].angular_momentum
    k, d = gyro.springs[0].stiffness, gyro.frictions[0].viscous
    natural, damping = sqrt(k / J), d / (2.0 * sqrt(k * J))
    systems = {Omega1: pc.state_space(pc.linearise(balanced, (Omega1, 0, 0))) for Omega1 in (-2.0, 0.0, 2.0)}
    still, turning = systems[0.0], systems[ABOUT_SPIN]
    gain = {Omega1: float(np.real(s["theta", "Omega2"].dcgain())) for Omega1, s in systems.items()}
    pole = still.poles()[0]

    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    row("gain, rad per rad/s: L/k", L / k, gain[0.0])
    row(
        "angle at 0.3 rad/s, deg: L Omega/k, non-linear run",
        degrees(L * RATE / k),
        degrees(step_response(balanced, 0.0, RATE)[1][-1]),
    )
    row("natural frequency, rad/s: sqrt(k/J)", natural, abs(pole))
    row("damping ratio: d/(2 sqrt(k J))", damping, -pole.real / abs(pole))
    z = 1.0 - 2.0 * damping**2
    row("bandwidth (-3 dB), rad/s", natural * sqrt(z + sqrt(z**2 + 1.0)), bandwidth(still))
    stiffer = 1.0 + L * ABOUT_SPIN / k
    row("gain at Omega1 = 2 rad/s, rad per rad/s: L/(k + L Omega1)", L / k / stiffer, gain[ABOUT_SPIN])
    row("natural frequency at Omega1 = 2 rad/s", natural * sqrt(stiffer), abs(turning.poles()[0]))
    row(
        "Omega1 that takes all restraint away, rad/s: -k/L",
        -k / L,
        brentq(lambda w: model_stiffness(balanced, w), -20.0, -8.0),
    )
    moment, g = gyro.unbalances[0].moment[0], gyro.specific_force[1]
    standing = step_response(gyro, 0.0, 0.0)[1][-1] / gain[0.0]
    row(
        "error from unbalance, deg/h: -m r g/L, non-linear run",
        -3600 * degrees(moment * g / L),
        3600 * degrees(standing),
    )
    if not file:
        return
    figure, (steps, bode) = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    frequency = np.geomspace(5.0, 1000.0, 400)
    for (Omega1, system), colour in zip(systems.items(), ("C0", "C2", "C3"), strict=True):
        t, theta = step_response(balanced, Omega1, RATE)
        steps.plot(1e3 * t, np.degrees(theta), colour, label=f"$\\Omega_1$ = {Omega1:+.0f} rad/s")
        steps.axhline(degrees(gain[Omega1] * RATE), color=colour, linestyle=":", linewidth=1.0)
        response = pc.analysis.frequency_response(system["theta", "Omega2"], frequency)[0, 0]
        bode.loglog(frequency / (2.0 * np.pi), np.abs(response), colour)
    bode.axvline(natural / (2.0 * np.pi), color="0.6", linestyle=":")
    steps.set(xlabel="time, ms", ylabel="gimbal angle, deg", title="step of 0.3 rad/s about the input axis")
    bode.set(xlabel="frequency, Hz", ylabel="rad per rad/s", title="gain from the input rate")
    steps.legend()
    for axes in (steps, bode):
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


def model_stiffness(gyro: pc.Platform, Omega1: float) -> float:
    """All that stands before theta when the case turns about the spin axis, N m/rad."""
    return pc.linearise(gyro, (Omega1, 0, 0)).stiffness[0, 0]


if __name__ == "__main__":
    main()
