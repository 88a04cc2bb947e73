"""Fast steering mirror: its suspension, its range, and the beam that turns twice as far.

    python examples/fast_steering_mirror.py                 prints theory and computed values
    python examples/fast_steering_mirror.py -o mirror.png   draws the response of the mirror as well

No loop is closed. The plant's line of sight is the normal n of the mirror: a beam r comes back as r - 2 (r n) n, so
that it turns by twice the angle that the normal turns by.
"""

from __future__ import annotations

import argparse
from math import degrees, pi, sqrt

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import platform_ctrl as pc


def row(quantity: str, theory: float, computed: float) -> None:
    """Print one line of the table."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}")


def turned_beam(mirror: pc.Platform, tip: float, tilt: float) -> float:
    """Angle between the beams that come back from the turned mirror and from the mirror at rest, rad."""
    turn = Rotation.identity()
    for gimbal, angle in zip(mirror.gimbals, (tip, tilt), strict=True):
        turn *= Rotation.from_rotvec(angle * gimbal.axis)
    rest = np.array(mirror.line_of_sight.direction)
    normal, came = turn.apply(rest), -rest
    back = came - 2.0 * (came @ normal) * normal
    return float(np.arctan2(np.linalg.norm(np.cross(back, rest)), back @ rest))


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Suspension and range of a fast steering mirror.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the mirror's response")
    file = parser.parse_args().o

    mirror = pc.read_platform("fast_steering_mirror")
    system = pc.state_space(pc.linearise(mirror))
    k, d, J = mirror.springs[1].stiffness, mirror.frictions[1].viscous, mirror.gimbals[1].inertia[1, 1]
    fastest = max(pc.state_space(pc.linearise(mirror)).poles(), key=lambda pole: (abs(pole), pole.imag))
    stop = mirror.gimbals[1].stops[1]
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    row("natural frequency of tilt, Hz", sqrt(k / J) / (2.0 * pi), abs(fastest) / (2.0 * pi))
    row("its damping ratio", d / (2.0 * sqrt(k * J)), -fastest.real / abs(fastest))
    held = -pc.element_forces(mirror, q=[0.0, stop])[4]
    row("torque that holds the largest angle, N m", k * stop, held)
    row("share of the voice coils' torque, %", 100.0 * k * stop / 0.03, 100.0 * held / mirror.torquers[1].limit)
    at = np.array([1e-3])
    tip = np.abs(pc.analysis.frequency_response(system["tip", "Qtip"], at))[0, 0, 0]
    tilt = np.abs(pc.analysis.frequency_response(system["tilt", "Qtilt"], at))[0, 0, 0]
    row("normal's turn per torque of tip, rad/(N m): 1/k", 1.0 / k, tip)
    row("normal's turn per torque of tilt, rad/(N m): 1/k", 1.0 / k, tilt)
    row("turn of the beam at 10 mrad of tilt, mrad", 20.0, 1e3 * turned_beam(mirror, 0.0, 0.01))
    row(
        "turn of the beam at the stop, deg: twice the mirror's",
        degrees(2.0 * stop),
        degrees(turned_beam(mirror, stop, 0.0)),
    )
    if not file:
        return
    figure, plot = plt.subplots(figsize=(7, 4.8), layout="constrained")
    hz = np.geomspace(1.0, 2000.0, 400)
    for name, torque, colour in (("tip", "Qtip", "C0"), ("tilt", "Qtilt", "C3")):
        response = pc.analysis.frequency_response(system[name, torque], 2.0 * pi * hz)[0, 0]
        plot.loglog(hz, 2.0 * np.abs(response), colour, label=f"beam from {torque}")
    plot.set(xlabel="frequency, Hz", ylabel="rad/(N m)", title="turn of the beam for each N m of the voice coils")
    plot.grid(alpha=0.3)
    plot.legend()
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
