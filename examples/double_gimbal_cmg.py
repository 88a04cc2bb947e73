"""Large double-gimbal control moment gyro: torque for next to no power, and what happens on the way to gimbal lock.

    python examples/double_gimbal_cmg.py                     prints what theory says beside what the equations give
    python examples/double_gimbal_cmg.py -o lock.png         draws it as well

A gimbal that turns at w makes an output torque H w on the station. Its own motor feels none of it and works only
against the rate of the station; the other motor has to hold the whole torque, but at rest: it is power that is
saved, not torque as in a single-gimbal gyro. With the inner gimbal at beta the outer one moves no more than
H cos beta: near 90 degrees it has to run away to make the same torque, and at 90 degrees it is powerless.
"""

from __future__ import annotations

import argparse

import numpy as np

import platform_ctrl as pc

H, OUTPUT = 4760.0, 258.0  # published, N m s and N m


def torques(cmg: pc.Platform, beta: float, rates: tuple[float, float], Omega: tuple[float, float, float]) -> np.ndarray:
    """[M, Q] for steady gimbal rates while the station turns at Omega, at alpha = 0."""
    return pc.inverse_dynamics(cmg, [0.0, beta], [*Omega, *rates], np.zeros(5))


def authority(cmg: pc.Platform, beta: float) -> np.ndarray:
    """Torque on the station for each rad/s of the outer and the inner gimbal, (3, 2), N m s: the rotor's part."""
    return -pc.matrices(cmg, [0.0, beta]).G_R[:3, 3:]


def main() -> None:
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(description="Torque, power and gimbal lock of a double-gimbal CMG.")
    parser.add_argument("-o", metavar="FILE", help="draw the figure into this file")
    file = parser.parse_args().o

    cmg = pc.read_platform("double_gimbal_cmg")
    still = (0.0, 0.0, 0.0)
    rate = OUTPUT / H
    made = torques(cmg, 0.0, (rate, 0.0), still)
    orbit = 2.0 * np.pi / 5560.0  # the station turns once in 92.7 min
    moved = torques(cmg, 0.0, (rate, 0.0), (0.0, orbit, 0.0))
    model = pc.linearise(cmg)
    poles = pc.state_space(model).poles()
    rows = [
        ("nutation, rad/s", H / np.sqrt(model.M[0, 0] * model.M[1, 1]), np.abs(poles).max()),
        ("output of the outer gimbal at 3.1 deg/s, N m", OUTPUT, np.linalg.norm(made[:3])),
        ("the inner motor holds it, N m", OUTPUT, abs(made[4])),
        ("the outer motor on a station at rest, N m", 0.0, abs(made[3])),
        ("the outer motor at orbital rate, N m", H * orbit, abs(moved[3])),
        ("amplification: output / outer motor", rate / orbit, OUTPUT / abs(moved[3])),
        ("power of both motors together, W", H * orbit * rate, abs(moved[3:] @ [rate, 0.0])),
    ]
    for beta in (60.0, 85.0):
        needed = OUTPUT / np.linalg.norm(authority(cmg, np.radians(beta))[:, 0])
        rows.append((f"outer rate for 258 N m at beta = {beta:g} deg, rad/s", rate / np.cos(np.radians(beta)), needed))
    locked = np.linalg.svd(authority(cmg, np.pi / 2), compute_uv=False)
    rows.append(("at 90 deg: smallest gain of rates to torque, N m s", 0.0, locked[1]))
    rows.append(("at 90 deg: the one that is left, N m s", H, locked[0]))

    print(f"{'quantity':<52}{'theory':>12}{'computed':>12}")
    for name, expected, computed in rows:
        print(f"{name:<52}{expected:>12.5g}{computed:>12.5g}")
    if file:
        draw(file, cmg)


def draw(file: str, cmg: pc.Platform) -> None:
    """Gains of both gimbals, and the rate that the outer one needs, over the inner angle."""
    import matplotlib.pyplot as plt

    beta = np.radians(np.linspace(0.0, 180.0, 361))
    gains = np.array([np.linalg.svd(authority(cmg, b), compute_uv=False) for b in beta])
    figure, (gain, rate) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    gain.plot(np.degrees(beta), gains[:, 0], label="inner gimbal: H")
    gain.plot(np.degrees(beta), gains[:, 1], label="outer gimbal: H |cos beta|")
    gain.set(xlabel="inner gimbal angle beta, deg", ylabel="N m per rad/s", title="output torque for each rad/s")
    away = np.abs(np.cos(beta)) > 0.02
    needed = np.where(away, np.degrees(OUTPUT / np.where(away, gains[:, 1], 1.0)), np.nan)
    rate.semilogy(np.degrees(beta), needed, label="outer gimbal")
    rate.axhline(np.degrees(OUTPUT / H), color="C1", label="inner gimbal")
    rate.set(xlabel="inner gimbal angle beta, deg", ylabel="deg/s", title="gimbal rate that makes 258 N m")
    for axes in (gain, rate):
        axes.axvline(90.0, color="0.5", linestyle=":")
        axes.grid(alpha=0.3)
    gain.set_ylim(0.0, 6200.0)
    gain.legend(loc="upper center", ncols=2)
    rate.legend()
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
