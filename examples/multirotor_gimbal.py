"""Three-axis camera gimbal: cables, weight, and which motor turns the camera about which of its axes.

    python examples/multirotor_gimbal.py                 prints theory and computed values
    python examples/multirotor_gimbal.py -o three.png    draws how the motors share the line of sight as well

No loop is closed. At a pitch angle p the yaw motor turns the camera by cos p about its own axis 3 and by -sin p about
its line of sight, the roll motor the other way round: looking straight down, yaw and roll have changed places. Both
stay normal to each other, whatever the pitch; only the middle angle, roll, brings the axes of yaw and pitch together,
by cos(roll).
"""

from __future__ import annotations

import argparse
from math import cos, radians, sin, sqrt

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import platform_ctrl as pc


def row(quantity: str, theory: float, computed: float) -> None:
    """Print one line of the table."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}")


def felt_rates(gimbal: pc.Platform, pitch: float, roll: float = 0.0) -> np.ndarray:
    """Rate of the camera in its own axes for each gimbal's rate, at angles in degrees, (3, 3)."""
    felt, turned = np.zeros((3, 3)), np.eye(3)
    for k, degrees in ((2, pitch), (1, roll), (0, 0.0)):
        axis = gimbal.gimbals[k].axis
        turned = turned @ Rotation.from_rotvec(-radians(degrees) * axis).as_matrix()
        felt[:, k] = turned @ axis
    return felt


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Cables, weight and axes of a three-axis gimbal.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the motors' shares")
    file = parser.parse_args().o

    gimbal = pc.read_platform("multirotor_gimbal")
    model = pc.linearise(gimbal)
    bodies = [one.inertia for one in gimbal.gimbals]
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    row("inertia about yaw, kg m2", sum(body[2, 2] for body in bodies), model.M[0, 0])
    row("inertia about roll, kg m2", bodies[1][0, 0] + bodies[2][0, 0], model.M[1, 1])
    weight, moment = -gimbal.specific_force[2], gimbal.unbalances[0].moment
    cable = gimbal.springs[2].stiffness
    natural = sqrt((cable + weight * moment[2]) / bodies[2][1, 1])
    swing = max(np.abs(pc.state_space(model).poles()))
    row("pitch on its cable and unbalance, rad/s", natural, swing)
    held = pc.element_forces(gimbal)[3 + 2]
    row("weight of the unbalance on pitch, N m", -weight * moment[0], held)
    for degrees in (-45.0, -80.0):
        p, felt = radians(degrees), felt_rates(gimbal, degrees)
        row(f"yaw about the camera's axis 3 at pitch {degrees:g} deg: cos", cos(p), felt[2, 0])
        row(f"yaw about the line of sight at pitch {degrees:g} deg: -sin", -sin(p), felt[0, 0])
    row("volume of the three axes at pitch -80 deg: 1", 1.0, abs(np.linalg.det(felt_rates(gimbal, -80.0))))
    row(
        "volume of the three axes at roll 40 deg: cos",
        cos(radians(40)),
        abs(np.linalg.det(felt_rates(gimbal, 0.0, 40.0))),
    )
    if not file:
        return
    figure, plot = plt.subplots(figsize=(7, 4.8), layout="constrained")
    angles = np.linspace(-90.0, 30.0, 41)
    shares = np.array([felt_rates(gimbal, degrees) for degrees in angles])
    for motor, axis, style in ((0, 2, "C0"), (0, 0, "C0--"), (1, 2, "C3"), (1, 0, "C3--")):
        about = "line of sight" if axis == 0 else "camera's axis 3"
        plot.plot(angles, shares[:, axis, motor], style, label=f"{gimbal.gimbal_names[motor]}, about the {about}")
    plot.set(xlabel="pitch, deg", ylabel="camera's rate / gimbal's rate", title="yaw and roll change places")
    plot.legend()
    plot.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
