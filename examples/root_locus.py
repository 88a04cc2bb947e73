"""Poles of a caged gyro's loop over its gain, and over the speed of the rotor while the controller stays as it is.

    python examples/root_locus.py                                   saves root_locus.png, root_locus_over_spin.png
    python examples/root_locus.py --gain 0.1 3 --spin 0.3 1.5 -o loci.png

Both torquers are closed together. The poles are those of the sampled loop, drawn in the s-plane: s = ln(z) / period.
"""

import argparse
from pathlib import Path

import platform_ctrl as pc
from platform_ctrl.report import figures

parser = argparse.ArgumentParser(description="Root loci of a caged gyro over loop gain and rotor speed.")
parser.add_argument("--gain", nargs=2, type=float, default=[0.05, 2.5], metavar="K", help="loop gain / nominal")
parser.add_argument("--spin", nargs=2, type=float, default=[0.3, 1.7], metavar="N", help="rotor speed / nominal")
parser.add_argument("-o", default="root_locus.png", metavar="FILE", help="where the first figure goes")
given = parser.parse_args()

job = pc.read_job(Path(__file__).with_name("caged_gyro.toml"))
design = pc.design.loops(job)[0].closed
controller = design.controller
plant = design.plant[list(controller.input_labels), list(controller.output_labels)]

over_gain = figures.root_locus(plant, controller, gains=given.gain)
gimbals, delay = job.loops[0].gimbals, job.sampling.delay
over_spin = figures.root_locus_over_spin(job.platform, gimbals, controller, spins=given.spin, delay=delay)
for name, plot, word in (("loop gain", over_gain, ""), ("rotor speed", over_spin, "_over_spin")):
    locus, edges = plot.locus, ", ".join(f"{edge:.2f}" for edge in plot.locus.edges)
    begins = "stable" if locus.stable[0] else "unstable"
    turns = f"{begins} at first, changes at {edges}" if edges else f"{begins} everywhere"
    print(f"{name} / nominal from {locus.values[0]:g} to {locus.values[-1]:g}: {turns}")
    plot.figure.savefig(Path(given.o).with_stem(f"{Path(given.o).stem}{word}"), dpi=120)
