"""Two-axis camera gimbal: secant gain, what friction and cables let through of the vehicle's motion, weight.

    python examples/camera_gimbal.py                   prints theory and computed values
    python examples/camera_gimbal.py -o camera.png     draws secant gain and isolation as well

No loop is closed. The azimuth motor turns the payload's axis 3 by the cosine of the elevation e only. A free gimbal
takes its share (d s + k)/(J s^2 + d s + k) of the vehicle's rate from viscous friction d and the stiffness k of cable
and weight; dry friction F accelerates it by F/J whatever the rate is, and weighs the more the slower the vehicle
moves.
"""

from __future__ import annotations

import argparse
from math import cos, pi, radians, sin

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import platform_ctrl as pc

RATE, TIME = 0.3, 0.1  # rad/s of the vehicle, s


def row(quantity: str, theory: float, computed: float, good_to: str = "") -> None:
    """Print one line of the table; `good_to` says how good an approximate theory is, if not to 0.1 %."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}" + (f"  (theory to {good_to})" if good_to else ""))


def secant(camera: pc.Platform, degrees: float) -> float:
    """Azimuth rate for each rad/s of the line of sight across, when azimuth alone turns it."""
    line, azimuth = camera.line_of_sight.direction, camera.gimbals[0].axis
    up = Rotation.from_rotvec(radians(degrees) * camera.gimbals[1].axis).as_matrix() @ line
    return float(1.0 / np.linalg.norm(np.cross(azimuth, up)))


def isolation(camera: pc.Platform, hz: float) -> float:
    """Pitch rate of the payload over that of the vehicle, from the linear model."""
    system = pc.state_space(pc.linearise(camera))["elevation", "Omega2"]
    frequency = np.array([2.0 * pi * hz])
    return float(np.abs(1.0 + 1j * frequency * pc.analysis.frequency_response(system, frequency)[0, 0])[0])


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Secant gain, isolation and weight of a camera gimbal.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of secant gain and isolation")
    file = parser.parse_args().o

    camera = pc.read_platform("camera_gimbal")
    azimuth, elevation = camera.gimbals
    spring, bearing = camera.springs[1].stiffness, camera.frictions[1]
    moment, weight = camera.unbalances[0].moment, -camera.specific_force[2]
    J = pc.linearise(camera).M[1, 1]
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    for degrees in (0.0, 60.0):
        e = radians(degrees)
        theory = azimuth.inertia[2, 2] + elevation.inertia[0, 0] * sin(e) ** 2 + elevation.inertia[2, 2] * cos(e) ** 2
        inertia = pc.linearise(camera, q=[0.0, e]).M[0, 0]
        row(f"azimuth inertia at elevation {degrees:g} deg, kg m2", theory, inertia)
    for degrees in (30.0, 60.0):
        row(
            f"azimuth rate per rate across at {degrees:g} deg: 1/cos",
            1 / cos(radians(degrees)),
            secant(camera, degrees),
        )
    for degrees in (0.0, 60.0):
        e = radians(degrees)
        held = pc.element_forces(camera, q=[0.0, e])[4] + spring * e
        row(f"weight at elevation {degrees:g} deg, N m", -weight * (moment[0] * cos(e) + moment[2] * sin(e)), held)
    stiffness = spring + moment[2] * weight
    for hz in (0.1, 1.0):
        s = 2j * pi * hz
        take = bearing.viscous * s + stiffness
        row(f"share of the vehicle's pitch motion at {hz:g} Hz", abs(take / (J * s**2 + take)), isolation(camera, hz))
    moving = np.array([[0.0, RATE, 0.0, 0.0, -RATE]])  # the vehicle pitches, the payload stands
    out = pc.simulation.rollout(camera, [[0.0, 0.0]], moving, 1e-4, round(TIME / 1e-4))
    pushed = bearing.coulomb[1] + bearing.viscous * RATE - weight * moment[0]
    tilt = (0.5 * pushed + spring * RATE * TIME / 6.0) / J * TIME**2
    row("payload's tilt after 0.1 s, mrad: F and weight", 1e3 * tilt, 1e3 * (RATE * TIME + out.q[0, 1]), "5 %")
    if not file:
        return
    figure, (gain, bode) = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    angles = np.linspace(-40.0, 70.0, 56)
    gain.plot(angles, [secant(camera, degrees) for degrees in angles], "C0", linewidth=2.0)
    gain.set(xlabel="elevation, deg", ylabel="azimuth rate per rate across", title="secant gain")
    hz = np.geomspace(0.02, 10.0, 120)
    bode.loglog(
        hz, [isolation(camera, one) for one in hz], "C0", linewidth=2.0, label="viscous friction, cable, weight"
    )
    dry = 4.0 / pi * bearing.coulomb[1] / (J * 2.0 * pi * hz * RATE)
    bode.loglog(hz, np.minimum(dry, 1.0), "C3--", label="dry friction, vehicle at 0.3 rad/s")
    bode.set(xlabel="frequency, Hz", ylabel="payload's pitch rate / vehicle's", title="without a loop")
    bode.legend()
    for axes in (gain, bode):
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
