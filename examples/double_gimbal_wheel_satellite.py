"""Satellite with a tilted momentum wheel: how torques of the wheel's suspension and of its motor turn the satellite.

    python examples/double_gimbal_wheel_satellite.py                  prints theory and computed values
    python examples/double_gimbal_wheel_satellite.py -o wheel.png     draws how roll answers torques

No loop is closed. A torque T that tilts the wheel acts on the satellite as -T, as that of a thruster would, and the
wheel precesses at T / h. So the satellite is a double integrator about each axis, and the tilt is the integral of the
torque. With a wheel that cannot tilt the satellite would nutate instead.
"""

from __future__ import annotations

import argparse
from math import pi, sqrt

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc
from platform_ctrl import analysis

T, SUN = 1e-3, 1e-4  # N m: a torque that tilts, and solar pressure


def row(quantity: str, theory: float, computed: float, percent: float = 0.1) -> None:
    """Print one line of the table."""
    near = "" if percent == 0.1 else f"  (theory to {percent:g} %)"
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}{near}")


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="What a wheel that tilts does to its satellite.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the responses to a torque that tilts the wheel")
    file = parser.parse_args().o

    satellite = pc.read_platform("double_gimbal_wheel_satellite")
    model, wheel = pc.linearise(satellite), satellite.rotors[0]
    h = wheel.angular_momentum
    J1, _, J3 = np.diag(model.root_inertia)
    system = pc.state_space(model, root="free")
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    row("momentum of the wheel, N m s: C spin", 0.02 * 450.0, h)
    tilting = sqrt(model.M[0, 0] * model.M[1, 1])
    row("nutation of the wheel, rad/s: h / sqrt(I1 I3)", h / tilting, np.abs(system.poles()).max(), 1.0)
    locked = pc.state_space(model, root="free", gimbals=(), others="held")
    row("nutation with a locked wheel, rad/s: h / sqrt(J1 J3)", h / sqrt(J1 * J3), np.abs(locked.poles()).max())
    # After the wheel's nutation has died out, before its damping turns the satellite.
    w = np.array([1.0])
    gain = analysis.frequency_response(system, w)[:, system.input_labels.index("Qouter"), 0] * w[0]
    row(
        "roll acceleration per torque, 1/(kg m2): 1 / J1",
        1.0 / J1,
        abs(gain[system.output_labels.index("Omega1")]),
        1.0,
    )
    row("tilting rate per torque, rad/s/(N m): 1 / h", 1.0 / h, abs(gain[system.output_labels.index("tilt3")]), 1.0)
    pitch = analysis.frequency_response(system, w)[
        system.output_labels.index("Omega2"), system.input_labels.index("Qrim"), 0
    ]
    row(
        "pitch acceleration per motor torque: 1 / J2 without C",
        1.0 / (model.root_inertia[1, 1] - 0.02),
        abs(pitch),
        0.2,
    )
    start = np.zeros((1, 6))
    force = np.array([[SUN, 0.0, 0.0, 0.0, 0.0, 0.0]])
    pushed = pc.simulation.rollout(satellite, np.zeros((1, 3)), start, step=1e-4, steps=100_000, force=force)
    # What the sun brings in is in satellite and wheel together.
    momentum = J1 * pushed.velocity[0, 0] + h * pushed.q[0, 1]
    row("momentum after 10 s of 0.1 mN m, N m s: M t", SUN * 10.0, momentum, 1.0)
    hours = h * np.sin(satellite.gimbals[0].stops[1]) / SUN / 3600.0
    print(f"0.1 mN m tilts the wheel to its stops within {hours:.2g} h: unloading has to come before")
    if not file:
        return
    hertz = np.geomspace(1e-3, 1.0, 400)
    figure, plot = plt.subplots(figsize=(7, 4.8), layout="constrained")
    for name, tilts, style in (("wheel tilts", system, "C0"), ("wheel locked, a thruster's torque", locked, "C3")):
        torque = tilts.input_labels.index("Qouter" if tilts is system else "M1")
        found = analysis.frequency_response(tilts, 2.0 * pi * hertz)[tilts.output_labels.index("Omega1"), torque]
        plot.loglog(hertz, np.abs(found), style, label=name)
    plot.set(xlabel="frequency, Hz", ylabel="roll rate / torque, rad/s/(N m)", title="roll of the satellite")
    plot.legend()
    plot.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
