"""Drone gimbal with offsets: what masses off their axes add, the belt drive, the mode of the arms.

    python examples/drone_gimbal.py                 prints theory and computed values
    python examples/drone_gimbal.py -o drone.png    draws how the inertia about yaw changes with pitch and roll as well

No loop is closed.
"""

from __future__ import annotations

import argparse
from math import pi, radians

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc


def row(quantity: str, theory: float, computed: float) -> None:
    """Print one line of the table."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}")


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Offsets, belt and mode of a drone gimbal.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the inertia about yaw")
    file = parser.parse_args().o

    drone = pc.read_platform("drone_gimbal")
    bodies, model = drone.gimbals, pc.linearise(drone)
    M = model.M
    # At level all axes are parallel to those of the airframe: centres of mass from the yaw joint.
    joints = np.cumsum([np.zeros(3), bodies[1].origin, bodies[2].origin], axis=0)
    centres = joints + [one.centre for one in bodies]
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    belt, direct = drone.motors[0], drone.motors[1]
    yaw = sum(b.inertia[2, 2] + b.mass * (c[0] ** 2 + c[1] ** 2) for b, c in zip(bodies, centres, strict=True))
    row("inertia about yaw, kg m2", yaw + belt.gear**2 * belt.rotor_inertia, M[0, 0])
    off = centres - joints[1]
    roll = sum(b.inertia[0, 0] + b.mass * (c[1] ** 2 + c[2] ** 2) for b, c in zip(bodies[1:], off[1:], strict=True))
    row("inertia about roll, kg m2", roll + direct.rotor_inertia, M[1, 1])
    # Share of the base's acceleration about yaw that a free gimbal takes; its joint is beside the base's axis, too.
    moment = sum(b.mass * c for b, c in zip(bodies, centres, strict=True))
    beside = float(moment[:2] @ bodies[0].origin[:2])
    share = (belt.gear * (belt.gear - 1.0) * belt.rotor_inertia - beside) / M[0, 0]
    row("share of the base's acceleration that the belt brings in", share, 1.0 - model.M_Omega[0, 2] / M[0, 0])
    row("weight on pitch at level, N m", 0.080 * 9.81 * bodies[2].centre[0], model.Q0[2])
    row("largest torque at yaw, N m", 3 * 0.03 * 0.5 * 0.93, drone.torquers[0].limit)
    fastest = np.abs(pc.state_space(model).poles()).max()
    row("first mode of the arms, Hz", 85.0, fastest / (2.0 * pi))
    if not file:
        return
    figure, plot = plt.subplots(figsize=(7, 4.8), layout="constrained")
    angles = np.linspace(-90.0, 30.0, 41)
    for degrees, style in ((0.0, "C0"), (30.0, "C3")):
        about = [pc.linearise(drone, q=[0.0, radians(degrees), radians(p)]).M[0, 0] for p in angles]
        plot.plot(angles, 1e6 * np.array(about), style, label=f"roll {degrees:g} deg")
    plot.set(xlabel="pitch, deg", ylabel="inertia about yaw, 1e-6 kg m2", title="what turns with the yaw arm")
    plot.legend()
    plot.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
