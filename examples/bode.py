"""Bode plot of a caged gyro: the loop broken at both torquers, and its margins.

    python examples/bode.py                 shows the plot
    python examples/bode.py -o bode.png     saves it

Take this file as a start; the job beside it, caged_gyro.toml, says what plant, loop and controller these are.
"""

import argparse
import math
from pathlib import Path

from matplotlib import pyplot as plt

import platform_ctrl as pc
from platform_ctrl.report import figures

parser = argparse.ArgumentParser(description="Bode plot of a caged gyro's loop.")
parser.add_argument("-o", metavar="FILE", help="save the figure instead of showing it")
file = parser.parse_args().o

job = pc.read_job(Path(__file__).with_name("caged_gyro.toml"))
design = pc.design.loops(job)[0].closed
controller = design.controller
plant = design.plant[list(controller.input_labels), list(controller.output_labels)]

L = pc.analysis.loop_transfer(plant, controller, at="input")
one, both = pc.analysis.loop_margins(plant, controller), pc.analysis.disk_margin(L)
for name, alpha in [*zip(one.channels, one.alpha, strict=True), ("both at once", both.lower)]:
    high, phase = (2.0 + alpha) / (2.0 - alpha), math.degrees(2.0 * math.atan(alpha / 2.0))
    print(f"{name}: disk margin {alpha:.3f}, so gain x {1.0 / high:.2f} to x {high:.2f} or phase {phase:.0f} deg")

plot = figures.bode(L, Hz=True)
plot.figure.set_size_inches(9.0, 8.0)
if file:
    plot.figure.savefig(file, dpi=120)
else:
    plt.show()
