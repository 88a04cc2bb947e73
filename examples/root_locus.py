"""Poles of the caged gyro 9-10 as the loop gain, and as the speed of the rotor, goes from low to high.

    python examples/root_locus.py                                   saves root_locus.png
    python examples/root_locus.py --gain 0.1 3 --spin 0.3 1.5 -o loci.png

--gain: factor on all of the controller's torques. --spin: factor on the rotor's speed, the controller left as it is.
The poles are those of the sampled loop, drawn in the s-plane: s = ln(z) / period.
"""

from __future__ import annotations

import argparse
import tomllib

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc
from platform_ctrl.reading import platform_source

PERIOD, DELAY = 0.0005, 0.0005  # s
CONTROLLER = {
    "name": "PI across, lead along",
    "method": "classical",
    "crossover_hz": 70,
    "integral_hz": 2,
    "damping_hz": 78,
    "damping2_hz": 92,
    "lead_hz": 7,
    "rolloff_hz": 900,
}
LOOP = {
    "name": "caging 9-10",
    "kind": "caging",
    "gimbals": ["9", "10"],
    "use": CONTROLLER["name"],
    "design": [CONTROLLER],
}


def plant_with(spin: float) -> dict:
    """The shipped plant with the momentum of rotor 11, carried by gimbal 10, changed: a plant is a dict as well."""
    plant = tomllib.loads(platform_source("three_gyro_platform"))
    for rotor in plant["rotor"]:
        if rotor["name"] == "11":
            rotor["angular_momentum"] *= spin
    return plant


def sampled_gyro(spin: float):
    """Torques Q9, Q10 to angles alpha9, beta10 as the controller sees them (a control.StateSpace)."""
    platform = pc.read_platform(plant_with(spin))
    gyro = pc.state_space(pc.linearise(platform), gimbals=("9", "10"))[["alpha9", "beta10"], ["Q9", "Q10"]]
    lag = [torquer.lag for torquer in platform.torquers if torquer.gimbal in ("9", "10")]
    return pc.analysis.sampled(gyro, PERIOD, DELAY, lag)


def closed_poles(plant, controller) -> np.ndarray:
    """Poles of the closed loop, 1/s."""
    return pc.analysis.continuous_poles(pc.analysis.poles(pc.analysis.closed_loop(plant, controller)), PERIOD)


parser = argparse.ArgumentParser(description="Root loci of the caged gyro 9-10 over loop gain and rotor speed.")
ends = ("LOW", "HIGH")
parser.add_argument("--gain", nargs=2, type=float, default=[0.05, 2.5], metavar=ends, help="loop gain / nominal")
parser.add_argument("--spin", nargs=2, type=float, default=[0.3, 1.7], metavar=ends, help="rotor speed / nominal")
parser.add_argument("-o", default="root_locus.png", metavar="FILE", help="where the figure goes")
given = parser.parse_args()

job = pc.read_job(
    {
        "schema": 1,
        "name": "gyro 9-10",
        "plant": "three_gyro_platform",
        "operation": {"Omega": [0.0, 0.0, 0.0]},
        "sampling": {"rate_hz": 1.0 / PERIOD, "delay": DELAY},
        "loop": [LOOP],
    }
)
controller = pc.design.loops(job)[0].closed.controller
nominal = sampled_gyro(1.0)

gains = np.linspace(*given.gain, 200)
spins = np.linspace(*given.spin, 120)
loci = {
    "loop gain / nominal": (gains, [closed_poles(nominal, gain * controller) for gain in gains]),
    "rotor speed / nominal": (spins, [closed_poles(sampled_gyro(spin), controller) for spin in spins]),
}
print("at the nominal values, slow to fast:")
s = closed_poles(nominal, controller)
for pole in sorted(s[s.imag >= 0.0], key=abs):
    hz, damping = abs(pole) / (2.0 * np.pi), -pole.real / abs(pole)
    print(f"  {pole.real:9.1f} {pole.imag:+9.1f}j 1/s   {hz:7.1f} Hz   damping {damping:.3f}")

figure, all_axes = plt.subplots(1, 2, figsize=(12, 6), sharey=True, layout="constrained")
for axes, (name, (values, poles)) in zip(all_axes, loci.items(), strict=True):
    stable = [bool(np.all(p.real < 0.0)) for p in poles]
    edges = [f"{values[k]:.2f}" for k in np.flatnonzero(np.diff(stable))]
    always = "stable" if stable[0] else "unstable"
    turns = f"{always} at first, changes at {', '.join(edges)}" if edges else f"{always} everywhere"
    print(f"{name} from {values[0]:g} to {values[-1]:g}: {turns}")

    x, y = np.concatenate([p.real for p in poles]), np.concatenate([p.imag for p in poles])
    colour = np.repeat(values, [len(p) for p in poles])
    shown = axes.scatter(x, y, c=colour, s=5, cmap="viridis")
    figure.colorbar(shown, ax=axes, label=name)
    labelled = list(s)  # the nominal poles have their crosses
    for k in np.linspace(0, len(values) - 1, 7).astype(int):
        for pole in poles[k][(poles[k].imag > 20.0) & (poles[k].real > -1080.0) & (poles[k].imag < 1550.0)]:
            # Where branches crowd together one label has to do.
            if all(abs(pole - other) > 60.0 for other in labelled):
                labelled.append(pole)
                axes.plot(pole.real, pole.imag, "k.", markersize=4)
                axes.annotate(
                    f"{values[k]:.2g}", (pole.real, pole.imag), xytext=(5, 3), textcoords="offset points", fontsize=8
                )
    axes.plot(s.real, s.imag, "rx", markersize=7, label="nominal")
    ray = 2000.0 * np.exp(1j * np.arccos(-0.1))
    axes.plot([0.0, ray.real], [0.0, ray.imag], "k--", linewidth=0.8, label="damping 0.1")
    axes.axvline(0.0, color="0.3", linewidth=0.8)
    axes.set_xlim(-1100.0, 300.0)
    axes.set_ylim(-30.0, 1600.0)  # the lower half is its mirror image
    axes.set_xlabel("real part, 1/s")
    axes.grid(alpha=0.3)
    axes.set_title(f"poles over {name}")
all_axes[0].set_ylabel("imaginary part, rad/s")
all_axes[0].legend(loc="upper left")
figure.savefig(given.o, dpi=120)
print(f"saved {given.o}")
