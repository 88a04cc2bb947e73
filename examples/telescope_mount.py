"""Telescope mount: inertias with offsets, drives that give way, geared motors, and where the friction yields.

    python examples/telescope_mount.py                 prints theory and computed values
    python examples/telescope_mount.py -o mount.png    draws how motor and telescope answer the motor's torque as well

No loop is closed. The encoder of the motor shows a zero at the locked rotor frequency before the resonance, that of the
telescope none: its phase is lost for good beyond the resonance.
"""

from __future__ import annotations

import argparse
from math import cos, pi, radians, sin, sqrt

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc
from platform_ctrl import analysis


def row(quantity: str, theory: float, computed: float, percent: float = 0.1) -> None:
    """Print one line of the table."""
    near = "" if percent == 0.1 else f"  (theory to {percent:g} %)"
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}{near}")


def frequencies_hz(mount: pc.Platform) -> np.ndarray:
    """Frequencies of the oscillations without loops, Hz, the slowest first."""
    poles = pc.state_space(pc.linearise(mount)).poles()
    return np.sort(np.abs(poles[poles.imag > 1.0])) / (2.0 * pi)


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Inertias, drives and motors of a telescope mount.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the responses to the motor's torque")
    file = parser.parse_args().o

    mount = pc.read_platform("telescope_mount")
    fork, tube = mount.gimbals[:2]
    motor, drives = mount.motors[1], mount.compliances
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    for degrees in (0.0, 60.0):
        e = radians(degrees)
        # The tube on its own about the vertical, and all masses about the azimuth axis.
        own = tube.inertia[0, 0] * sin(e) ** 2 + tube.inertia[2, 2] * cos(e) ** 2
        whole = fork.inertia[2, 2] + fork.mass * fork.centre[1] ** 2 + own + tube.mass * tube.origin[1] ** 2
        M = pc.linearise(mount, q=[0.0, e, 0.0, 0.0]).M
        row(f"inertia about azimuth at elevation {degrees:g} deg, kg m2", whole, M[0, 0])
    M = pc.linearise(mount).M
    side = motor.gear**2 * motor.rotor_inertia
    row("motor side of elevation, at the joint, kg m2", side, M[3, 3])
    row("stiffness of the drive of elevation, N m/rad", (2.0 * pi * 12.0) ** 2 * M[1, 1], drives[1].strength)
    free = [12.0 * sqrt(1.0 + M[k, k] / side) for k in (1, 0)]
    for name, theory, computed in zip(("elevation", "azimuth"), free, frequencies_hz(mount), strict=True):
        row(f"{name} with its motor free, Hz", theory, computed, 2.0)
    weight = tube.mass * 9.81 * tube.centre[0]
    held = pc.linearise(mount).Q0[1]
    row("weight of the tube's unbalance, N m", weight, held)
    most = motor.gear * 0.1 * 0.7 * 3.0
    row("largest torque of the motor of elevation, N m", most, mount.torquers[1].limit)
    bristle = mount.frictions[1]
    row("friction yields at, arcsec", 1.4 / 2e4 * 206265.0, bristle.breakaway[0] / bristle.bristle_stiffness * 206265.0)
    if not file:
        return
    hertz = np.geomspace(1.0, 100.0, 400)
    system = pc.state_space(pc.linearise(mount))
    response = analysis.frequency_response(system, 2.0 * pi * hertz)[:, system.input_labels.index("Qelevation")]
    figure, plot = plt.subplots(figsize=(7, 4.8), layout="constrained")
    for name, style in (("elevation_motor", "C0"), ("elevation", "C3")):
        plot.loglog(hertz, np.abs(response[system.output_labels.index(name)]), style, label=name)
    plot.set(xlabel="frequency, Hz", ylabel="angle / torque of the motor, rad/(N m)", title="motor side and telescope")
    plot.legend()
    plot.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
