"""Poles of the caged gyro 9-10 as the loop gain, and as the speed of the rotor, goes from low to high.

    python examples/root_locus.py                                   saves root_locus.png, root_locus_over_spin.png
    python examples/root_locus.py --gain 0.1 3 --spin 0.3 1.5 -o loci.png

--gain: factor on all of the controller's torques. --spin: factor on the rotor's speed, the controller left as it is.
The poles are those of the sampled loop, drawn in the s-plane: s = ln(z) / period.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import platform_ctrl as pc
from platform_ctrl.report import figures

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


parser = argparse.ArgumentParser(description="Root loci of the caged gyro 9-10 over loop gain and rotor speed.")
ends = ("LOW", "HIGH")
parser.add_argument("--gain", nargs=2, type=float, default=[0.05, 2.5], metavar=ends, help="loop gain / nominal")
parser.add_argument("--spin", nargs=2, type=float, default=[0.3, 1.7], metavar=ends, help="rotor speed / nominal")
parser.add_argument("-o", default="root_locus.png", metavar="FILE", help="where the first figure goes")
given = parser.parse_args()

job = pc.read_job(
    {
        "schema": 2,
        "name": "gyro 9-10",
        "plant": "three_gyro_platform",
        "operation": {"Omega": [0.0, 0.0, 0.0]},
        "sampling": {"rate_hz": 1.0 / PERIOD, "delay": DELAY},
        "loop": [LOOP],
    }
)
controller = pc.design.loops(job)[0].closed.controller
gyro = pc.state_space(pc.linearise(job.platform), gimbals=("9", "10"))[["alpha9", "beta10"], ["Q9", "Q10"]]
lag = [torquer.lag for torquer in job.platform.torquers if torquer.gimbal in ("9", "10")]
plant = pc.analysis.sampled(gyro, PERIOD, DELAY, lag)

over_gain = figures.root_locus(plant, controller, gains=given.gain)
over_spin = figures.root_locus_over_spin(
    job.platform, ("9", "10"), controller, spins=given.spin, period=PERIOD, delay=DELAY
)

print("at the nominal values, slow to fast:")
damping = pc.analysis.damping(pc.analysis.closed_loop(plant, controller))
for pole, frequency, ratio in zip(damping.poles, damping.natural_frequency, damping.ratio, strict=True):
    if pole.imag >= 0.0:
        hz = frequency / (2.0 * np.pi)
        print(f"  {pole.real:9.1f} {pole.imag:+9.1f}j 1/s   {hz:7.1f} Hz   damping {ratio:.3f}")
for name, locus in (("loop gain / nominal", over_gain.locus), ("rotor speed / nominal", over_spin.locus)):
    edges = ", ".join(f"{edge:.2f}" for edge in locus.edges)
    always = "stable" if locus.stable[0] else "unstable"
    turns = f"{always} at first, changes at {edges}" if edges else f"{always} everywhere"
    print(f"{name} from {locus.values[0]:g} to {locus.values[-1]:g}: {turns}")

first = Path(given.o)
for plot, file in ((over_gain, first), (over_spin, first.with_stem(f"{first.stem}_over_spin"))):
    plot.figure.savefig(file, dpi=120)
    print(f"saved {file}")
