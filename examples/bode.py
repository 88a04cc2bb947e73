"""Bode plot of the caged gyro 9-10: the loop broken at both torques, and its margins.

    python examples/bode.py                 shows the plot
    python examples/bode.py -o bode.png     saves it

Take this file as a start: change the plant, the gimbals and the controller's numbers.
"""

import argparse
import math

import platform_ctrl as pc
from platform_ctrl.report import figures

NUMBERS = {"crossover_hz": 70, "integral_hz": 2, "damping_hz": 78, "damping2_hz": 92, "lead_hz": 7, "rolloff_hz": 900}
DESIGN = {"name": "PI across, lead along", "method": "classical", **NUMBERS}
LOOP = {"name": "caging 9-10", "kind": "caging", "gimbals": ["9", "10"], "use": DESIGN["name"], "design": [DESIGN]}
JOB = {"schema": 2, "name": "gyro 9-10", "plant": "three_gyro_platform", "operation": {"Omega": [0.0, 0.0, 0.0]}}
JOB |= {"sampling": {"rate_hz": 2000, "delay": 0.0005}, "loop": [LOOP]}

parser = argparse.ArgumentParser(description="Bode plot of gyro 9-10, caged.")
parser.add_argument("-o", metavar="FILE", help="save the figure instead of showing it")
file = parser.parse_args().o

made = pc.design.loops(JOB)[0].closed
plant, controller = made.plant[["alpha9", "beta10"], ["Q9", "Q10"]], made.controller
L = pc.analysis.loop_transfer(plant, controller, at="input")
one, both = pc.analysis.loop_margins(plant, controller), pc.analysis.disk_margin(L)
for name, alpha in [*zip(one.channels, one.alpha, strict=True), ("Q9 and Q10 at once", both.lower)]:
    high, phase = (2.0 + alpha) / (2.0 - alpha), math.degrees(2.0 * math.atan(alpha / 2.0))
    print(f"{name}: disk margin {alpha:.3f}, so gain x {1.0 / high:.2f} to x {high:.2f} or phase {phase:.0f} deg")

plot = figures.bode(L, Hz=True)
if file:
    plot.figure.set_size_inches(9.0, 8.0)
    plot.figure.savefig(file, dpi=120)
else:
    try:
        figures.show(plot)
    except pc.PlatformCtrlError:
        parser.error("there is no screen to show the plot on; save it with -o bode.png")
