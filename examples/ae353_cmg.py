"""AE353 control moment gyro: the published equations, and ideal speed control against the real, saturating loop.

    python examples/ae353_cmg.py                     prints what theory says beside what the equations give
    python examples/ae353_cmg.py -o ae353.png        draws the difference as well

Without gravity the platform turns as the gimbal tilts: J w = h sin q2. While the gimbal swings, the loop holds the
speed with a torque far below its limit, as good as ideal. When the rotor is too slow by more than 5 rad/s the loop is
at its limit, and what it puts into the rotor it takes from the platform: ideal speed control knows nothing of that.
"""

from __future__ import annotations

import argparse
import tomllib

import numpy as np

import platform_ctrl as pc

J1z, J2, J3, M, R, G, SPEED = 0.5, 0.001, 0.01, 1.0, 2.0, 9.81, 1000.0  # published
h, LIMIT = J3 * SPEED, 5.0
J = J1z + M * R**2 + J2 + J3  # of the platform with all that it carries


def published(q: list[float], v: list[float], torque: float) -> np.ndarray:
    """Accelerations of platform and gimbal by the course's own equations of motion, rad/s2."""
    c = np.cos(q[1])
    platform = J3 * np.sin(2.0 * q[1]) * v[0] * v[1] + 2.0 * J3 * c * v[1] * SPEED - 2.0 * G * M * R * np.sin(q[0])
    gimbal = (torque - J3 * c * v[0] * SPEED) / (J2 + J3)  # J3y = J3z: what has sin 2 q2 drops out
    return np.array([platform / (2.0 * (J1z + J2 + M * R**2) + 2.0 * J3 * c**2), gimbal])


def run(plant: pc.Platform, rates: list[float], seconds: float, tilt: float = 0.0, spin: float = SPEED):
    """Run the exact plant without control for some seconds."""
    spins = [[spin]] if plant.rotors[0].control == "servo" else None
    start = [[0.0, 0.0, 0.0, *rates]]
    return pc.simulation.rollout(plant, [[0.0, tilt]], start, 5e-4, round(seconds / 5e-4), every=1, spin=spins)


def main() -> None:
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(description="Ideal and real speed control of the AE353 control moment gyro.")
    parser.add_argument("-o", metavar="FILE", help="draw the figure into this file")
    file = parser.parse_args().o

    # The published equations leave the motor out: they are those of a free rotor at its momentary speed.
    hanging = pc.read_platform("ae353_cmg")
    q, v, torque = [0.5, 0.7], [0.3, -0.8], 2.0
    velocity = np.array([0.0, 0.0, 0.0, *v])
    force = pc.element_forces(hanging, q, velocity) + np.array([0.0, 0.0, 0.0, 0.0, torque])
    kinds = {"free": pc.with_free_rotors, "regulated": pc.with_regulated_rotors}
    found = {
        kind: pc.forward_dynamics(make(hanging, q, velocity), q, velocity, force)[3:] for kind, make in kinds.items()
    }
    expected = published(q, v, torque)
    rows = [(f"published acceleration {k + 1}, rad/s2", expected[k], found["free"][k]) for k in range(2)]

    weightless = tomllib.loads(pc.platform_source("ae353_cmg"))
    del weightless["root"]["specific_force"]
    real = pc.read_platform(weightless)
    ideal = pc.with_regulated_rotors(real)
    kick, seconds = 20.0, 1.0  # rad/s of the gimbal at the start
    swing, swing_ideal = run(real, [0.0, kick], seconds), run(ideal, [0.0, kick], seconds)
    tilt, rate = swing.q_history[0, :, 1], swing.velocity_history[0, :, 3]
    top = int(np.argmax(rate))
    rows.append(("fastest turn of the platform, h sin q2 / J, rad/s", h * np.sin(tilt[top]) / J, rate[top]))
    rows.append(("the same swing with ideal control, rad/s", rate[top], swing_ideal.velocity_history[0, :, 3].max()))

    # The rotor starts 100 rad/s too slow, its axis along the platform's.
    slow = run(real, [0.0, 0.0], 0.4, np.pi / 2, SPEED - 100.0)
    ramp = LIMIT * (1.0 / J3 + 1.0 / (J - J3))
    rows.append(("speed after 0.1 s at the limit, rad/s", SPEED - 100.0 + 0.1 * ramp, slow.spin_history[0, 200, 0]))
    rows.append(("platform rate when the speed is reached, rad/s", J3 * 100.0 / J, slow.velocity[0, 3]))

    print(f"{'quantity':<52}{'theory':>12}{'computed':>12}")
    for name, by_theory, computed in rows:
        print(f"{name:<52}{by_theory:>12.6g}{computed:>12.6g}")
    # Ideal control gives the rotor whatever the acceleration of its carrier asks for; the loop does so with some lag.
    along = swing_ideal.velocity_history[0, :, 3] * np.sin(swing_ideal.q_history[0, :, 1])
    asked = np.abs(J3 * np.gradient(along, swing_ideal.t)).max()
    given = np.abs(swing.spin_history - SPEED).max()  # 1 N m for each rad/s
    print(f"motor torque in the swing: ideal control asks for {asked:.2f} N m, the loop gives {given:.2f} of its 5 N m")
    apart = found["regulated"] / found["free"] - 1.0
    print(f"ideal speed control against the published equations: acceleration 1 {100.0 * apart[0]:+.2g} %")
    if file:
        draw(file, real, ideal)


def draw(file: str, real: pc.Platform, ideal: pc.Platform) -> None:
    """Platform rate and rotor speed after a kick, with a rotor that starts 5 % too slow."""
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
    for plant, spin, label, style in (
        (real, SPEED, "real loop", "C0-"),
        (real, SPEED - 100.0, "real loop, 10 % too slow at first", "C1-"),
        (ideal, SPEED, "ideal speed control", "k:"),
    ):
        moved = run(plant, [0.0, 20.0], 0.5, np.radians(30.0), spin)
        above.plot(moved.t, moved.velocity_history[0, :, 3], style, label=label)
        speed = moved.spin_history[0, :, 0] if moved.spin_history.size else np.full(len(moved.t), SPEED)
        below.plot(moved.t, speed, style, label=label)
    above.set(ylabel="platform rate, rad/s", title="gimbal at 30 deg, kicked with 20 rad/s, no gravity")
    below.set(xlabel="t, s", ylabel="rotor speed, rad/s")
    below.legend()
    for axes in (above, below):
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
