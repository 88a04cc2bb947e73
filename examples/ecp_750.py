"""ECP 750 with axis 3 braked: nutation between axes 2 and 4, and precession under a constant torque on axis 2.

    python examples/ecp_750.py                     prints what theory says beside what the equations give
    python examples/ecp_750.py -o ecp_750.png      draws it as well

With the rotor tilted by q2 out of axis 3 nutation runs at L cos q2 / sqrt(J2 J4), J4 depending on q2; friction damps
it. A torque Q2 makes the gyro precess about axis 4 at Q2/L, with cusps from rest on; dry friction stops the nutation
at once.
"""

from __future__ import annotations

import argparse
import tomllib

import numpy as np
from scipy.optimize import brentq

import platform_ctrl as pc

TORQUE = 0.1  # N m, on axis 2


def braked(friction: bool) -> pc.Platform:
    """The shipped plant with the brake of axis 3 on: a stiff cage about gimbal B."""
    plant = tomllib.loads(pc.platform_source("ecp_750"))
    plant["cage"] = [{"gimbal": "B", "stiffness": 1e6, "damping": 300.0}]
    if not friction:
        del plant["friction"]
    return pc.read_platform(plant)


def nutation(platform: pc.Platform, q2: float) -> complex:
    """The pole of nutation at a tilt of the rotor, 1/s: the slowest that oscillates."""
    poles = pc.state_space(pc.linearise(platform, q=[0.0, 0.0, q2])).poles()
    return min(poles[poles.imag > 1.0], key=abs)


def precession(platform: pc.Platform, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and angles (N, 3) of the exact plant over 20 periods from rest, the torque acting on gimbal C."""
    force = [[0.0, 0.0, 0.0, 0.0, 0.0, TORQUE]]
    run = pc.simulation.rollout(
        platform, [[0.0] * 3], [[0.0] * 6], step=period / 1600, steps=20 * 1600, force=force, every=40
    )
    return run.t, run.q_history[0]


def main() -> None:
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(description="Nutation and precession of the ECP 750 gyroscope.")
    parser.add_argument("-o", metavar="FILE", help="draw the figure into this file")
    file = parser.parse_args().o

    free, real = braked(friction=False), braked(friction=True)
    L, J2, d2, d4 = 0.0273 * 400.0 * np.pi / 30.0, 0.0092 + 0.0148, 0.0118, 0.0027  # published

    def J4(q2: float) -> float:  # the regulated rotor counts as if it were locked in C
        return 0.0670 + 0.0297 + (0.0220 + 0.0148) * np.cos(q2) ** 2 + (0.0230 + 0.0273) * np.sin(q2) ** 2

    def theory(q2: float) -> float:
        return float(L * np.cos(q2) / np.sqrt(J2 * J4(q2)))

    rows = [
        (f"nutation at q2 = {tilt} deg, rad/s", theory(np.radians(tilt)), abs(nutation(free, np.radians(tilt))))
        for tilt in (0, 30, 60)
    ]
    damped = max(np.roots([J2 * J4(0.0), J2 * d4 + J4(0.0) * d2, L**2 + d2 * d4]), key=lambda s: s.imag)
    rows.append(("decay of nutation by viscous friction, 1/s", -damped.real, -nutation(real, 0.0).real))

    # Steady precession: axis 4 drags with d4, which tilts the rotor slowly against the friction of axis 2.
    t, q = precession(free, 2.0 * np.pi / theory(0.0))
    t_real, q_real = precession(real, 2.0 * np.pi / theory(0.0))
    dry = real.frictions[2]
    tilt_rate = brentq(
        lambda w: d4 * (TORQUE - d2 * w - dry.coulomb[1] * np.tanh(w / dry.coulomb_rate)) / L**2 - w, 0.0, 0.01
    )
    rate = abs(q_real[-1, 0] - q_real[-1 - 3 * 40, 0]) / (t_real[-1] - t_real[-1 - 3 * 40])  # the last three periods
    rows.append(("precession by 0.1 N m without friction, rad/s", TORQUE / L, abs(q[-1, 0]) / t[-1]))
    rows.append(("precession by 0.1 N m with friction, rad/s", L * tilt_rate / d4, rate))
    rows.append(("largest tilt without friction, rad", 2.0 * J4(0.0) * TORQUE / L**2, q[:, 2].max()))

    print(f"{'quantity':<48}{'theory':>12}{'computed':>12}")
    for name, expected, computed in rows:
        print(f"{name:<48}{expected:>12.5g}{computed:>12.5g}")
    if file:
        draw(file, [(t, q, "no friction"), (t_real, q_real, "friction as published")], theory, free)


def draw(file: str, runs: list, theory, platform: pc.Platform) -> None:
    """Path of the rotor axis, and nutation over tilt."""
    import matplotlib.pyplot as plt

    figure, (path, over) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    for t, q, label in runs:
        shown = t <= 2.0
        path.plot(np.degrees(q[shown, 0]), np.degrees(q[shown, 2]), label=label)
    path.set(xlabel="q4, deg (precession)", ylabel="q2, deg (tilt)", ylim=(-0.05, 1.45))
    path.set_title("path of the rotor axis, 0.1 N m on axis 2, 2 s from rest")
    path.legend(loc="upper right", ncols=2)
    tilts = np.linspace(0.0, 80.0, 60)
    over.plot(tilts, [theory(x) for x in np.radians(tilts)], label="L cos q2 / sqrt(J2 J4)")
    dots = np.arange(0.0, 81.0, 10.0)
    over.plot(dots, [abs(nutation(platform, x)) for x in np.radians(dots)], "o", label="poles of the linear model")
    over.set(xlabel="q2, deg", ylabel="nutation, rad/s", title="axis 3 braked", ylim=(0.0, None))
    over.legend()
    for axes in (path, over):
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
