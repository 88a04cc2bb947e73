"""Poles of the caged gyro 9-10 over the loop gain, and over the speed of the rotor with the controller left as it is.

python examples/root_locus.py                                   saves root_locus.png, root_locus_over_spin.png
python examples/root_locus.py --gain 0.1 3 --spin 0.3 1.5 -o loci.png

The poles are those of the sampled loop, drawn in the s-plane: s = ln(z) / period.
"""

import argparse
from pathlib import Path

import platform_ctrl as pc
from platform_ctrl.report import figures

PERIOD, DELAY = 0.0005, 0.0005  # s
NUMBERS = {"crossover_hz": 70, "integral_hz": 2, "damping_hz": 78, "damping2_hz": 92, "lead_hz": 7, "rolloff_hz": 900}
DESIGN = {"name": "PI across, lead along", "method": "classical", **NUMBERS}
LOOP = {"name": "caging 9-10", "kind": "caging", "gimbals": ["9", "10"], "use": DESIGN["name"], "design": [DESIGN]}
JOB = {"schema": 2, "name": "gyro 9-10", "plant": "three_gyro_platform", "operation": {"Omega": [0.0, 0.0, 0.0]}}
JOB |= {"sampling": {"rate_hz": 1.0 / PERIOD, "delay": DELAY}, "loop": [LOOP]}

parser = argparse.ArgumentParser(description="Root loci of the caged gyro 9-10 over loop gain and rotor speed.")
parser.add_argument("--gain", nargs=2, type=float, default=[0.05, 2.5], metavar="K", help="loop gain / nominal")
parser.add_argument("--spin", nargs=2, type=float, default=[0.3, 1.7], metavar="N", help="rotor speed / nominal")
parser.add_argument("-o", default="root_locus.png", metavar="FILE", help="where the first figure goes")
given = parser.parse_args()

job = pc.read_job(JOB)
made = pc.design.loops(job)[0].closed
plant, controller = made.plant[["alpha9", "beta10"], ["Q9", "Q10"]], made.controller
over_gain = figures.root_locus(plant, controller, gains=given.gain)
spins = {"spins": given.spin, "period": PERIOD, "delay": DELAY}
over_spin = figures.root_locus_over_spin(job.platform, ("9", "10"), controller, **spins)
for name, plot, word in (("loop gain", over_gain, ""), ("rotor speed", over_spin, "_over_spin")):
    locus, edges = plot.locus, ", ".join(f"{edge:.2f}" for edge in plot.locus.edges)
    begins = "stable" if locus.stable[0] else "unstable"
    turns = f"{begins} at first, changes at {edges}" if edges else f"{begins} everywhere"
    print(f"{name} / nominal from {locus.values[0]:g} to {locus.values[-1]:g}: {turns}")
    plot.figure.savefig(Path(given.o).with_stem(f"{Path(given.o).stem}{word}"), dpi=120)
