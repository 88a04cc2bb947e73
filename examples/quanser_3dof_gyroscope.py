"""Quanser 3-DOF gyroscope: which axes nutate with which, and the precession law up to the torque limit.

    python examples/quanser_3dof_gyroscope.py                       prints what theory says beside what comes out
    python examples/quanser_3dof_gyroscope.py -o quanser.png        draws it as well

The blue gimbal c turns the disk from the axis of the red gimbal b (0 deg) to that of the silver frame a (90 deg). It
nutates with the frame that stands across the disk, at L / sqrt(J J'); the other one is left alone. In between all
three belong together and the mode runs at L sqrt(cos^2 / J_a + sin^2 / J_b) / sqrt(J_c), nearly.
"""

from __future__ import annotations

import argparse

import numpy as np

import platform_ctrl as pc

L, Jc = 0.0056 * 750.0 * np.pi / 30.0, 0.0010 + 0.0028  # published: momentum, blue gimbal with disk
Ja, Jb = 0.0375 + 0.0213 + 0.0027 + 0.0028, 0.0179 + 0.0027 + 0.0028  # silver at 0 deg, red at 90 deg


def nutation(platform: pc.Platform, q2: float) -> float:
    """Frequency of nutation with the blue gimbal at q2, rad/s."""
    return float(np.abs(pc.state_space(pc.linearise(platform, q=[0.0, 0.0, q2])).poles()).max())


def precession(platform: pc.Platform, torque: float) -> tuple[float, float]:
    """Drift of the frame and change of the blue angle while `torque` acts on blue for 1 s, started at the drift."""
    rate = -torque / L
    start = [[0.0, 0.0, 0.0, rate, 0.0, 0.0]]
    run = pc.simulation.rollout(platform, [[0.0] * 3], start, step=1e-3, steps=1000, force=[[0.0] * 5 + [torque]])
    return float(run.q[0, 0]), float(run.q[0, 2])


def main() -> None:
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(description="Nutation and precession of the Quanser 3-DOF gyroscope.")
    parser.add_argument("-o", metavar="FILE", help="draw the figure into this file")
    file = parser.parse_args().o

    gyro = pc.read_platform("quanser_3dof_gyroscope")
    limit = gyro.torquer_on("c").limit
    rows = [
        ("nutation blue-silver, 0 deg, rad/s", L / np.sqrt(Jc * Ja), nutation(gyro, 0.0)),
        ("nutation blue-red, 90 deg, rad/s", L / np.sqrt(Jc * Jb), nutation(gyro, np.pi / 2)),
    ]
    for torque in (0.1, limit):
        drift, _ = precession(gyro, torque)
        rows.append((f"precession in 1 s by {torque:g} N m, rad", -torque / L, drift))

    # From rest: the frame starts along cusps, twice as fast at most as it drifts; the blue gimbal leans 2 Ja Q / L^2.
    torque, period = 0.05, 2.0 * np.pi * np.sqrt(Jc * Ja) / L
    run = pc.simulation.rollout(
        gyro, [[0.0] * 3], [[0.0] * 6], period / 1000, 3000, force=[[0.0] * 5 + [torque]], every=10
    )
    q, rate = run.q_history[0], run.velocity_history[0, :, 3:]
    rows.append(("from rest: largest rate of the frame, rad/s", -2.0 * torque / L, rate[:, 0].min()))
    rows.append(("from rest: largest lean of blue, rad", 2.0 * Ja * torque / L**2, q[:, 2].max()))

    print(f"{'quantity':<48}{'theory':>12}{'computed':>12}")
    for name, expected, computed in rows:
        print(f"{name:<48}{expected:>12.5g}{computed:>12.5g}")
    guide = 0.44 / np.sqrt(0.0039 * 0.0223)
    print(f"the three numbers of Quanser's laboratory guide give {guide:.1f} rad/s for blue-red")
    if file:
        draw(file, gyro, run.t, q, torque)


def draw(file: str, gyro: pc.Platform, t: np.ndarray, q: np.ndarray, torque: float) -> None:
    """Nutation over the blue angle, and the start from rest."""
    import matplotlib.pyplot as plt

    figure, (over, start) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    tilts = np.radians(np.linspace(0.0, 90.0, 61))
    over.plot(np.degrees(tilts), [nutation(gyro, x) for x in tilts], label="poles, all three axes free")
    across = L * np.sqrt(np.cos(tilts) ** 2 / Ja + np.sin(tilts) ** 2 / Jb) / np.sqrt(Jc)
    over.plot(np.degrees(tilts), across, "--", label="L sqrt(cos$^2$/J$_a$ + sin$^2$/J$_b$) / sqrt(J$_c$)")
    over.set(xlabel="blue angle q2, deg", ylabel="nutation, rad/s", ylim=(25.0, 50.0))
    over.set_title("nutation: with silver at 0 deg, with red at 90 deg")
    start.plot(t, np.degrees(q[:, 0]), label="silver frame")
    start.plot(t, np.degrees(q[:, 2]), label="blue gimbal")
    start.plot(t, np.degrees(-torque / L * t), "k:", label="precession alone, Q/L")
    start.set(xlabel="t, s", ylabel="deg", title=f"{torque:g} N m on the blue gimbal, from rest")
    for axes in (over, start):
        axes.legend()
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
