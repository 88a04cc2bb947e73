"""Gyro horizon: how it rights itself, and how wrong it is in a coordinated turn (Kurvenflug).

    python examples/gyro_horizon.py                  prints theory and computed values
    python examples/gyro_horizon.py -o horizon.png   draws the error in the turn as well

Erection makes the spin axis follow the specific force at the rate kappa = gain/L per radian. In a turn at the rate
omega the specific force is tilted inward by the bank angle phi and carried round with the aircraft. The tilt
z = forward + j right of the spin axis then obeys z' = K (j tan(phi) - z) - j omega z, where K = kappa cos(phi) because
the sensors are banked as well:

    z = j K tan(phi) / (K + j omega) * (1 - exp(-(K + j omega) t))

After a long turn the horizon stands kappa/omega sin(phi) too far forward: it erects to a false vertical, but slowly.
Erection also feeds the nutation by kappa; bearing friction has to take out more.
"""

from __future__ import annotations

import argparse
import dataclasses
from math import atan, cos, degrees, log, radians, sin, tan

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc

TURN, SPEED, G = radians(3.0), 60.0, 9.81  # rad/s, a turn of two minutes; m/s; m/s2
BANK = atan(TURN * SPEED / G)
STEP = 2e-3  # s; the nutation is far off and needs not be followed closely


def row(quantity: str, theory: float, computed: float, good_to: str = "") -> None:
    """Print one line of the table; `good_to` says how good an approximate theory is, if not to 0.1 %."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}" + (f"  (theory to {good_to})" if good_to else ""))


def fly(horizon: pc.Platform, q, Omega=(0.0, 0.0, 0.0), duration: float = 600.0):
    """Time and the angles (roll, pitch) of the non-linear horizon in an aircraft that nothing can turn but itself."""
    steady = dataclasses.replace(horizon, root_inertia=1e6 * np.eye(3))
    out = pc.simulation.rollout(steady, [q], [[*Omega, 0.0, 0.0]], STEP, round(duration / STEP), every=250)
    return out.t, out.q_history[0].T


def banked(horizon: pc.Platform) -> pc.Platform:
    """The horizon in the turn: in aircraft axes the specific force stays along -3 and is larger."""
    return dataclasses.replace(horizon, specific_force=np.array([0.0, 0.0, -G / cos(BANK)]))


def in_turn(horizon: pc.Platform, duration: float = 600.0):
    """Time and tilt z = forward + j right of the spin axis from the true vertical, from an erect start."""
    Omega = (0.0, TURN * sin(BANK), TURN * cos(BANK))
    t, (roll, pitch) = fly(banked(horizon), (-BANK, 0.0), Omega, duration)
    return t, -np.sin(pitch) + 1j * np.sin(roll + BANK) * np.cos(pitch)


def theory_in_turn(kappa: float, t):
    """The same by the formula above."""
    K = kappa * cos(BANK)
    return 1j * K * tan(BANK) / (K + 1j * TURN) * -np.expm1(-(K + 1j * TURN) * t)


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Erection and turning error of a gyro horizon.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the error in a turn")
    file = parser.parse_args().o

    horizon = pc.read_platform("gyro_horizon")
    kappa = horizon.erections[0].gain / horizon.rotors[0].angular_momentum
    print(f"turn at 3 deg/s, 60 m/s: bank {degrees(BANK):.2f} deg; erection rate {kappa:.4f} 1/s")
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    t, (_, pitch) = fly(horizon, (0.0, radians(20.0)), duration=400.0)
    time = log(sin(radians(20.0)) / sin(radians(1.0))) / kappa  # pitch' = -kappa tan(pitch)
    row("erection from 20 to 1 deg in pitch, s", time, np.interp(-radians(1.0), -pitch, t))

    t, z = in_turn(horizon)
    expected = theory_in_turn(kappa, t)
    for turned in (180, 360):
        k = round(radians(turned) / TURN / t[1])
        row(f"pitch error after a turn of {turned} deg, deg", degrees(expected[k].real), degrees(z[k].real), "1 %")
        row(f"roll error after a turn of {turned} deg, deg", degrees(expected[k].imag), degrees(z[k].imag), "3 %")
    row("pitch error in a long turn, deg", degrees(expected[-1].real), degrees(z[-1].real))
    row(
        "the same by kappa/omega sin(phi), kappa << omega",
        degrees(kappa / TURN * sin(BANK)),
        degrees(z[-1].real),
        "5 %",
    )

    model = pc.linearise(banked(horizon), (0.0, TURN * sin(BANK), TURN * cos(BANK)), q=(-BANK, 0.0))
    slow = min(pc.state_space(model).poles(), key=abs)
    row("poles in the turn, 1/s: real part -kappa cos(phi)", -kappa * cos(BANK), slow.real)
    row("poles in the turn, 1/s: imaginary part omega", TURN, abs(slow.imag))
    level = pc.linearise(horizon)
    nutation = max(pc.state_space(level).poles(), key=abs)
    friction = horizon.frictions[0].viscous * np.sum(1.0 / np.diag(level.M)) / 2.0
    row("decay of the nutation, 1/s: d (1/Jo + 1/Ji)/2 - kappa", friction - kappa, -nutation.real)
    if not file:
        return
    figure, (path, course) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    path.plot(np.degrees(z.imag), np.degrees(z.real), "C0", linewidth=2.5, label="non-linear")
    path.plot(np.degrees(expected.imag), np.degrees(expected.real), "k--", linewidth=1.0, label="theory")
    for turned in (90, 180, 270, 360):
        k = round(radians(turned) / TURN / t[1])
        path.plot(degrees(z[k].imag), degrees(z[k].real), "C3o")
        path.annotate(
            f"{turned}°", (degrees(z[k].imag), degrees(z[k].real)), xytext=(7, -13), textcoords="offset points"
        )
    path.set(
        xlabel="tilt to the right, deg",
        ylabel="tilt forward, deg",
        title="spin axis against the true vertical",
        aspect="equal",
    )
    course.plot(t / 60.0, np.degrees(z.real), "C0", label="pitch error")
    course.plot(t / 60.0, np.degrees(z.imag), "C2", label="roll error")
    course.plot(t / 60.0, np.degrees(expected.real), "k--", t / 60.0, np.degrees(expected.imag), "k--", linewidth=1.0)
    course.set(xlabel="time in the turn, min", ylabel="deg", title=f"turn at 3°/s, bank {degrees(BANK):.1f}°")
    path.set_xlim(-1.2, 3.8)
    path.legend(loc=(0.03, 0.18))
    course.legend()
    for axes in (path, course):
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
