"""Magnus's platform with three gyros (Ingenieur-Archiv 1976, section 4), before any loop is closed.

    python examples/three_gyro_platform.py                     prints theory and computed values
    python examples/three_gyro_platform.py -o platform.png     draws the torque pair and the conserved sum as well

With small angles, L6 = L8 and J5 = J7 the gimbals of the gyros obey (s: the platform stands still)

    J4 a4'' + L6 b5' + L8 b7' = Q4          J9  a9''  + L11 b10' = Q9
    J5 b5'' - L6 a4'          = Q5          J10 b10'' - L11 a9'  = Q10
    J7 b7'' - L8 a4'          = Q7

so that 4-5-7 nutates at sqrt(L6^2/(J4 J5) + L8^2/(J4 J7)), 9-10 at L11/sqrt(J9 J10); b5 - b7 feels no gyro and is a
double integrator; and J9 a9' + L11 b10 does not change while Q9 = 0, whatever acts on gimbal 10. On a platform that
turns, caged gimbals need Q9 = L11 Omega1, Q10 = -L11 Omega3, Q5 + Q7 = -(L6 + L8) Omega2; and L11 Omega2 acts on a9 and
b10 as a spring, for negative Omega2 as one that pushes away. Free gyros keep their direction in space.

The main job, loops that cage the gyros and stabilise the platform, is examples/three_gyro_platform.toml.
"""

from __future__ import annotations

import argparse
import dataclasses
from math import asin, atan2, sqrt

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

import platform_ctrl as pc
from platform_ctrl.plant.force_elements import Cage
from platform_ctrl.simulation.free_motion import Rollout

STEP = 5e-5  # s, a fortieth of a nutation or less
PAIR, PAIR_TIME = 2e-4, 0.05  # N m on gimbal 5, and the opposite on 7; s
KICK, PUSH, PUSH_TIME = 0.2, 1e-3, 0.05  # rad/s of gimbal 9; N m on gimbal 10; s
RATE = np.array([0.5, -0.4, 0.3])  # rad/s of the platform while its gyros are caged
TURN, TURN_TIME = np.array([0.10, -0.08, 0.06]), 0.2  # rad/s of the platform while its gyros are free, s


def row(quantity: str, theory: float, computed: float) -> None:
    """Print one line of the table."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}")


def held(platform: pc.Platform) -> pc.Platform:
    """The platform so heavy that its gyros do not turn it."""
    return dataclasses.replace(platform, root_inertia=1e6 * np.eye(3))


def run(
    platform: pc.Platform, duration: float, rates: dict[str, float], torques: dict[str, float], Omega: ArrayLike = 0.0
) -> Rollout:
    """The non-linear platform under constant torques of gimbals, from zero angles and the given gimbal rates."""
    velocity, force = np.zeros((2, 3 + len(platform.gimbals)))
    velocity[:3] = Omega
    for given, vector in ((rates, velocity), (torques, force)):
        for gimbal, number in given.items():
            vector[3 + platform.gimbal(gimbal)] = number
    q = np.zeros((1, len(platform.gimbals)))
    return pc.simulation.rollout(held(platform), q, [velocity], STEP, round(duration / STEP), force=[force], every=10)


def angles_of_directions_kept(turned: np.ndarray) -> dict[str, float]:
    """Gimbal angles at which all spin axes point in space as they did before the platform turned by `turned`."""
    back = Rotation.from_rotvec(turned).inv()
    d6, d11 = back.apply([1.0, 0.0, 0.0]), back.apply([0.0, 1.0, 0.0])
    beta = asin(d6[1])
    return {"4": atan2(-d6[2], d6[0]), "5": beta, "7": -beta, "9": atan2(-d11[0], d11[1]), "10": asin(d11[2])}


def poles_with_9_caged(platform: pc.Platform, rate: float) -> np.ndarray:
    """Poles of gimbals 9 and 10 on a platform that turns about axis 2, gimbal 9 in a cage as good as rigid."""
    rigid = dataclasses.replace(platform, cages=(Cage(gimbal="9", stiffness=1e7),))
    return pc.state_space(pc.linearise(rigid, (0.0, rate, 0.0)), gimbals=("9", "10")).poles()


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Gyros of the three-gyro platform without loops.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the torque pair and of the conserved sum")
    file = parser.parse_args().o

    platform = pc.read_platform("three_gyro_platform")
    L6, L8, L11 = (rotor.angular_momentum for rotor in platform.rotors)
    model = pc.linearise(platform)
    k4, k5, k7, k9, k10 = (platform.gimbal(name) for name in ("4", "5", "7", "9", "10"))
    J4, J5, J7, J9, J10 = np.diag(model.M)
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    poles = np.sort(np.abs(pc.state_space(model).poles()))
    row("nutation of 4-5-7, rad/s", sqrt(L6**2 / (J4 * J5) + L8**2 / (J4 * J7)), poles[-1])
    row("nutation of 9-10, rad/s: L11/sqrt(J9 J10)", L11 / sqrt(J9 * J10), poles[-3])

    caged = pc.inverse_dynamics(platform, np.zeros(5), np.concatenate([RATE, np.zeros(5)]), np.zeros(8))[3:]
    row("caged gyro 11, Q9 in N m: L11 Omega1", L11 * RATE[0], caged[k9])
    row("caged gyro 11, Q10 in N m: -L11 Omega3", -L11 * RATE[2], caged[k10])
    row("caged gyros 6 and 8, Q5 + Q7 in N m: -(L6 + L8) Omega2", -(L6 + L8) * RATE[1], caged[k5] + caged[k7])

    pair = run(platform, PAIR_TIME, {}, {"5": PAIR, "7": -PAIR})
    apart = pair.q_history[0, :, k5] - pair.q_history[0, :, k7]
    row("b5 - b7 after 50 ms of a torque pair, mrad: T t^2/J5", 1e3 * PAIR * PAIR_TIME**2 / J5, 1e3 * apart[-1])
    single = run(platform, PAIR_TIME, {}, {"5": PAIR})
    difference = single.q[0, k5] - single.q[0, k7]
    row(
        "the same of the torque on 5 alone, mrad: T t^2/(2 J5)",
        1e3 * PAIR * PAIR_TIME**2 / (2.0 * J5),
        1e3 * difference,
    )

    pushed = run(platform, PUSH_TIME, {"9": KICK}, {"10": PUSH})
    shares = np.array([J9 * pushed.velocity_history[0, :, 3 + k9], L11 * pushed.q_history[0, :, k10]])
    worst = np.abs(shares.sum(axis=0) - J9 * KICK).argmax()
    row("J9 a9' + L11 b10, 1e-6 N m s, where it has changed most", 1e6 * J9 * KICK, 1e6 * shares[:, worst].sum())

    for rate, part, does in ((0.5, np.imag, "swings, rad/s"), (-0.5, np.real, "runs away, 1/s")):
        slow = min(poles_with_9_caged(platform, rate), key=abs)
        row(f"gimbal 10 with 9 caged, Omega2 = {rate:g} rad/s: {does}", sqrt(L11 * abs(rate) / J10), abs(part(slow)))

    kept = angles_of_directions_kept(TURN_TIME * TURN)
    start = {"4": -TURN[1], "5": -TURN[2], "7": TURN[2], "9": -TURN[2], "10": -TURN[0]}  # still in space
    turned = run(platform, TURN_TIME, start, {}, Omega=TURN)
    for gimbal, angle in kept.items():
        k = platform.gimbal(gimbal)
        row(f"free gyros on the turned platform, mrad: {platform.angle_names[k]}", 1e3 * angle, 1e3 * turned.q[0, k])
    if not file:
        return
    figure, (torques, conserved) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    ms = 1e3 * pair.t
    torques.plot(ms, 1e3 * apart, "C0", linewidth=2.5, label="pair on 5 and 7: β5 − β7")
    torques.plot(ms, 1e3 * PAIR * pair.t**2 / J5, "k--", linewidth=1.0, label="T t²/J5")
    torques.plot(ms, 1e3 * single.q_history[0, :, k5], "C1", label="torque on 5 alone: β5")
    torques.plot(ms, 1e3 * single.q_history[0, :, k4], "C2", label="torque on 5 alone: α4 precesses")
    torques.set(ylabel="mrad", title="β5 − β7 feels no gyro")
    ms = 1e3 * pushed.t
    for share, label in zip(shares, ("J9 α9'", "L11 β10"), strict=True):
        conserved.plot(ms, 1e6 * share, linewidth=1.2, label=label)
    conserved.plot(ms, 1e6 * shares.sum(axis=0), "C3", linewidth=2.5, label="sum")
    conserved.set(ylabel="10⁻⁶ N m s", title="kicked and pushed: Q9 = 0, Q10 = 1 mN m")
    for axes in (torques, conserved):
        axes.set_xlabel("time, ms")
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
