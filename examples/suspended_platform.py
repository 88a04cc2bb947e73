"""Platform in its suspension: what of the vehicle's motion reaches it, and what gimbal lock does.

    python examples/suspended_platform.py                      prints theory and computed values
    python examples/suspended_platform.py -o suspension.png    draws isolation and gimbal lock as well

No loop is closed. Viscous friction d of the roll bearing takes the platform (inertia J with the frames) along with
d/(J s + d) of the vehicle's roll rate; dry friction F accelerates it by F/J. The gyros keep their direction and
show it.

At a pitch angle the suspension follows a yaw rate of the vehicle by turning 1/cos(pitch) times as fast in azimuth and
tan(pitch) times in roll. Massless frames do so without any torque on the platform; real ones take it along, the more
the closer to 90 degrees, where nothing isolates it any more.
"""

from __future__ import annotations

import argparse
import dataclasses
from math import cos, pi, radians, tan

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import platform_ctrl as pc

ROLL_RATE, TIME = 0.3, 0.2  # rad/s of the vehicle, s
FRAMES = ("roll", "pitch")


def row(quantity: str, theory: float, computed: float, good_to: str = "") -> None:
    """Print one line of the table; `good_to` says how good an approximate theory is, if not to 0.1 %."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}" + (f"  (theory to {good_to})" if good_to else ""))


def without_frames(suspended: pc.Platform) -> pc.Platform:
    """The same with massless roll and pitch frames."""
    light = [dataclasses.replace(g, inertia=np.zeros((3, 3))) if g.name in FRAMES else g for g in suspended.gimbals]
    return dataclasses.replace(suspended, gimbals=tuple(light))


def at_pitch(suspended: pc.Platform, degrees: float) -> np.ndarray:
    """The angles q with that pitch and all others zero."""
    q = np.zeros(len(suspended.gimbals))
    q[suspended.gimbal_names.index("pitch")] = radians(degrees)
    return q


def following(suspended: pc.Platform, degrees: float) -> tuple[np.ndarray, float]:
    """Gimbal rates when the vehicle begins to yaw by 1 rad/s, and the rate that the platform gets of it."""
    q = at_pitch(suspended, degrees)
    model = pc.linearise(suspended, q=q)
    rates = -np.linalg.solve(model.M, model.M_Omega[:, 2])  # the joint momenta stay zero
    taken, turned = np.array([0.0, 0.0, 1.0]), Rotation.identity()
    for gimbal, angle, rate in zip(suspended.gimbals[:3], q[:3], rates[:3], strict=True):
        taken += rate * turned.as_matrix() @ gimbal.axis
        turned *= Rotation.from_rotvec(angle * gimbal.axis)
    return rates, float(np.linalg.norm(taken))


def isolation(suspended: pc.Platform, hz: np.ndarray) -> np.ndarray:
    """Roll rate of the platform in space over that of the vehicle, from the linear model."""
    system = pc.state_space(pc.linearise(suspended))["roll", "Omega1"]
    frequency = 2.0 * pi * np.atleast_1d(hz)
    return 1.0 + 1j * frequency * pc.analysis.frequency_response(system, frequency)[0, 0]


def main() -> None:
    """Print the tables, and draw."""
    parser = argparse.ArgumentParser(description="Isolation and gimbal lock of a suspended platform.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of isolation and gimbal lock")
    file = parser.parse_args().o

    suspended = pc.read_platform("suspended_platform")
    ideal = without_frames(suspended)
    J, bearing = pc.linearise(suspended).M[0, 0], suspended.frictions[0]
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    for hz in (0.01, 1.0):
        theory = abs(bearing.viscous / (2j * pi * hz * J + bearing.viscous))
        row(f"platform's share of a roll oscillation of {hz:g} Hz", theory, abs(isolation(suspended, hz)[0]), "0.4 %")

    rates = np.zeros(3 + len(suspended.gimbals))
    rates[[0, 3]] = ROLL_RATE, -ROLL_RATE  # the vehicle rolls, the platform stands
    moved = pc.simulation.rollout(suspended, [0.0 * rates[3:]], [rates], 1e-4, round(TIME / 1e-4))
    torque = bearing.coulomb[1] + bearing.viscous * ROLL_RATE
    roll = 0.5 * torque / J * TIME**2
    row(
        "platform's tilt after 0.2 s of rolling, mrad: F t^2/(2 J)",
        1e3 * roll,
        1e3 * (ROLL_RATE * TIME + moved.q[0, 0]),
        "0.2 %",
    )
    beta10 = moved.q[0, suspended.gimbal_names.index("10")]
    row("what gyro 11 shows of it, mrad: beta10 = -tilt", -1e3 * roll, 1e3 * beta10, "0.2 %")

    for degrees in (60.0, 80.0, 89.0, 89.9):
        rate, _ = following(ideal, degrees)
        row(f"azimuth rate per yaw rate at pitch {degrees:g} deg: -1/cos", -1.0 / cos(radians(degrees)), rate[2])
        row(f"roll rate per yaw rate at pitch {degrees:g} deg: tan", tan(radians(degrees)), rate[0])
    print(
        f"\n{'pitch, deg':>12s}{'cond M, massless frames':>26s}{'real frames':>14s}{'yaw that the platform takes':>30s}"
    )
    for degrees in (0.0, 60.0, 80.0, 89.0, 89.9, 90.0):
        real, light = (np.linalg.cond(pc.linearise(p, q=at_pitch(p, degrees)).M[:3, :3]) for p in (suspended, ideal))
        print(f"{degrees:12g}{light:26.3g}{real:14.3g}{following(suspended, degrees)[1]:30.3f}")
    try:
        pc.state_space(pc.linearise(ideal, q=at_pitch(ideal, 90.0)))
    except pc.PlatformCtrlError as error:
        print(f"massless frames at 90 deg: {error}")
    if not file:
        return
    figure, (bode, lock) = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    hz = np.geomspace(1e-4, 10.0, 300)
    bode.loglog(hz, np.abs(isolation(suspended, hz)), "C0", linewidth=2.0, label="linear model")
    bode.loglog(
        hz, np.abs(bearing.viscous / (2j * pi * hz * J + bearing.viscous)), "k--", linewidth=1.0, label="d/(J s + d)"
    )
    bode.set(xlabel="frequency, Hz", ylabel="platform's roll rate / vehicle's", title="friction in the roll bearing")
    pitch = np.linspace(0.0, 90.0, 91)
    rates, taken = zip(*(following(suspended, p) for p in pitch), strict=True)
    lock.plot(pitch, taken, "C3", linewidth=2.0, label="taken by the platform")
    lock.plot(pitch, [abs(rate[2]) for rate in rates], "C0", linewidth=2.0, label="turned by the azimuth bearing")
    lock.plot(
        pitch[:-5], 1.0 / np.cos(np.radians(pitch[:-5])), "k--", linewidth=1.0, label="1/cos(pitch): massless frames"
    )
    lock.set(xlabel="pitch, deg", ylabel="share of the vehicle's yaw rate", title="gimbal lock", ylim=(0.0, 4.0))
    for axes in (bode, lock):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
