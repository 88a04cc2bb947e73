"""Pyramid of four VSCMGs: torque amplification, the momentum envelope, and a singularity within it.

    python examples/vscmg_pyramid.py                       prints what theory says beside what the equations give
    python examples/vscmg_pyramid.py -o pyramid.png        draws the singularity as well

A gimbal rate d makes the torque h d on the spacecraft, across gimbal and wheel axis; its motor has to work only against
the spacecraft's own rate. The four directions are the columns of the Jacobian A, here the rotor part of eq. (14). Where
det(A A') = 0 no gimbal rate makes torque along one direction: with gimbals 1 and 2 at (-90, 90) deg that is axis 1.
"""

from __future__ import annotations

import argparse

import numpy as np

import platform_ctrl as pc

h, COS, SIN = 0.1 * 14.4, np.cos(np.radians(54.75)), np.sin(np.radians(54.75))  # published
RATE = np.array([0.01, -0.01, 0.005])  # published start, rad/s; gimbals at (0, 0, 90, -90) deg
START = np.radians([0.0, 0.0, 90.0, -90.0])
SIGMA = np.array([0.1, 0.2, 0.3])  # modified Rodrigues parameters


def jacobian(satellite: pc.Platform, delta: np.ndarray) -> np.ndarray:
    """Rate of the wheels' momentum for each rad/s of the gimbals, in units of h, (3, 4)."""
    return pc.matrices(satellite, delta).G_R[:3, 3:] / h


def measure(A: np.ndarray) -> float:
    """How far from singular a Jacobian is: sqrt(det(A A'))."""
    return float(np.prod(np.linalg.svd(A, compute_uv=False)))


def momentum(satellite: pc.Platform, q: np.ndarray, velocity: np.ndarray, attitude: np.ndarray) -> np.ndarray:
    """Angular momentum of the whole satellite in inertial axes, (3,)."""
    m = pc.matrices(satellite, q, velocity)
    H, (w, v) = (m.A_star @ velocity + m.B.T @ m.L)[:3], (attitude[0], attitude[1:])
    return H + 2.0 * np.cross(v, np.cross(v, H) + w * H)


def main() -> None:
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(description="Torque amplification and singularity of a pyramid of four VSCMGs.")
    parser.add_argument("-o", metavar="FILE", help="draw the figure into this file")
    file = parser.parse_args().o
    satellite = pc.read_platform("vscmg_pyramid")

    one = [1.0, 0.0, 0.0, 0.0]  # rad/s, gimbal 1
    still = pc.inverse_dynamics(satellite, START, [0.0, 0.0, 0.0, *one], np.zeros(7))
    moving = pc.inverse_dynamics(satellite, START, [*RATE, *one], np.zeros(7))
    spin, across = RATE[1], RATE @ [-SIN, 0.0, COS]  # of gimbal 1, at zero angle
    motor = -(0.13 - 0.065) * spin * across - h * across  # published equation of the gimbal's motor
    rows = [
        ("output torque of a gimbal at 1 rad/s, N m", h, np.linalg.norm(still[:3])),
        ("its motor, spacecraft at rest, N m", 0.0, abs(still[3])),
        ("its motor at the published rate, N m", motor, moving[3]),
        ("amplification: output / motor", h / abs(motor), np.linalg.norm(still[:3]) / abs(moving[3])),
    ]

    # Every wheel may be turned by itself, so that the largest momentum along an axis is the sum of four maxima.
    around = np.array([pc.matrices(satellite, np.full(4, d)).B[:, :3] for d in np.radians(np.arange(0.0, 360.0, 1.0))])
    largest = np.abs(around).max(axis=0).sum(axis=0)
    rows.append(("largest momentum along axis 1, in h", 2.0 + 2.0 * SIN, largest[0]))
    rows.append(("largest momentum along axis 3, in h", 4.0 * COS, largest[2]))

    trapped = np.radians([-90.0, 90.0, 0.0, 0.0])
    B = pc.matrices(satellite, trapped).B[:, :3]
    near = jacobian(satellite, np.radians([-85.0, 85.0, 0.0, 0.0]))
    needed = np.linalg.norm(np.linalg.pinv(h * near) @ [1.0, 0.0, 0.0])
    rows += [
        ("sqrt(det(A A')) at zero angles", 4.0 * SIN**2 * COS, measure(jacobian(satellite, np.zeros(4)))),
        ("the same at (-90, 90, 0, 0) deg", 0.0, measure(jacobian(satellite, trapped))),
        ("gain along axis 1 there", 0.0, np.linalg.norm(jacobian(satellite, trapped)[0])),
        ("momentum along axis 1 there, in h", 2.0 * SIN, B.sum(axis=0)[0]),
        (
            "gimbal rates for 1 N m 5 deg from there, rad/s",
            1.0 / (h * SIN * np.sqrt(2) * np.sin(np.radians(5))),
            needed,
        ),
    ]

    # Left to itself from the published start: nothing is lost.
    attitude = np.array([1.0 - SIGMA @ SIGMA, *(2.0 * SIGMA)]) / (1.0 + SIGMA @ SIGMA)
    velocity = np.array([*RATE, 0.0, 0.0, 0.0, 0.0])
    run = pc.simulation.rollout(satellite, [START], [velocity], 0.01, 10000, [attitude])
    before = momentum(satellite, START, velocity, attitude)
    after = momentum(satellite, run.q[0], run.velocity[0], run.attitude[0])
    rows += [(f"inertial momentum {k + 1} after 100 s, N m s", before[k], after[k]) for k in range(3)]

    print(f"{'quantity':<50}{'theory':>13}{'computed':>13}")
    for name, expected, computed in rows:
        print(f"{name:<50}{expected:>13.6g}{computed:>13.6g}")
    print("the units' inertias, raised to what bodies can have: 0.065 N m instead of 0.03 for 1 rad/s2 of a gimbal;")
    own = np.diag(pc.matrices(satellite).A_star)[:3] - [86.0, 85.0, 113.0]
    print(f"about axes 1 to 3 all four units have {own.round(3)} kg m2 of the satellite's 86, 85, 113")
    if file:
        draw(file, satellite)


def draw(file: str, satellite: pc.Platform) -> None:
    """The measure over two pairs of angles, and the gains on the way into the singularity."""
    import matplotlib.pyplot as plt

    figure, (map_axes, way) = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    x = np.radians(np.linspace(-180.0, 180.0, 73))
    A = [jacobian(satellite, np.full(4, angle)) for angle in x]  # column k belongs to the angle of gimbal k alone
    values = [
        [measure(np.column_stack([A[-1 - i][:, 0], A[i][:, 1], A[j][:, 2], A[-1 - j][:, 3]])) for i in range(73)]
        for j in range(73)
    ]
    filled = map_axes.contourf(np.degrees(x), np.degrees(x), values, levels=20, cmap="viridis")
    figure.colorbar(filled, ax=map_axes, label="sqrt(det(A A'))")
    map_axes.plot([90.0, -90.0], [0.0, 0.0], "rx", markersize=9)
    map_axes.set(
        xlabel="delta2 = -delta1, deg", ylabel="delta3 = -delta4, deg", title="0 is singular; x: the one of the table"
    )
    a = np.radians(np.linspace(0.0, 180.0, 181))
    gains = [np.linalg.norm(jacobian(satellite, np.array([-b, b, 0.0, 0.0])), axis=1) for b in a]
    for k, label in enumerate(("along axis 1", "along axis 2", "along axis 3")):
        way.plot(np.degrees(a), np.array(gains)[:, k], label=label)
    way.set(xlabel="delta2 = -delta1, deg; delta3 = delta4 = 0", ylabel="torque / (h x gimbal rates)", title="gains")
    way.legend()
    way.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
