"""Two-sided Nyquist plot of a symmetric gyro.

Gyro 9-10 in complex coordinates, α + iβ, is one loop with positive and negative frequencies. Nutation turns one way:
only the branch of positive frequencies passes through infinity at 75 Hz.
"""

import platform_ctrl as pc
from platform_ctrl.report import figures

model = pc.linearise(pc.read_platform("three_gyro_platform"))
plant = pc.design.complex_plant(model, ("9", "10"), period=0.0005, delay=0.0005, balance=True)
loop = pc.design.complex_loop(plant, crossover_hz=40.0, integral_hz=2.0, damping_hz=50.0, lead_hz=7.0, rolloff_hz=900.0)

figure = figures.two_sided_nyquist(loop.nyquist)
figure.savefig("two_sided_nyquist.png", dpi=150)
