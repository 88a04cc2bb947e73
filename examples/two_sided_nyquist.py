"""Two-sided Nyquist plot of gyro 9-10 in complex coordinates, z = alpha + i beta, with a cross-axis loop.

    python examples/two_sided_nyquist.py                                saves two_sided_nyquist.png
    python examples/two_sided_nyquist.py --crossover 40 --damping 20    another loop

Nutation turns one way: only the branch of positive frequencies passes through infinity at 75 Hz.
"""

from __future__ import annotations

import argparse

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc

parser = argparse.ArgumentParser(description="Two-sided Nyquist plot of gyro 9-10.")
parser.add_argument("--crossover", type=float, default=40.0, metavar="HZ", help="of the cross-axis gain")
parser.add_argument("--damping", type=float, default=50.0, metavar="HZ", help="strength of the direct-axis lead")
parser.add_argument("-o", default="two_sided_nyquist.png", metavar="FILE", help="where the figure goes")
given = parser.parse_args()

model = pc.linearise(pc.read_platform("three_gyro_platform"))
# The inertias of the two axes differ: units of their own make them alike.
plant = pc.design.complex_plant(model, ("9", "10"), period=0.0005, delay=0.0005, balance=True)
loop = pc.design.complex_loop(
    plant,
    crossover_hz=given.crossover,
    integral_hz=2.0,
    damping_hz=given.damping,
    lead_hz=7.0,
    rolloff_hz=900.0,
)
curve = loop.nyquist
print(f"nutation {plant.momentum / plant.inertia / 6.2832:.1f} Hz, {len(plant.A)} complex states")
print(f"turns round -1: {curve.encirclements}; unstable poles of the closed loop: {curve.closed_unstable}")
print(f"disk margin {curve.disk_margin:.3f}, reached at {curve.margin_frequency / 6.2832:+.1f} Hz")
for frequency, margin in zip(curve.crossings, curve.phase_margins, strict=True):
    print(f"  |L| = 1 at {frequency / 6.2832:+7.1f} Hz, phase margin {margin * 57.29578:+.0f} degrees")

figure, axes = plt.subplots(figsize=(7, 7))
for side, label in ((1.0, "turning from alpha to beta"), (-1.0, "from beta to alpha")):
    L = curve.loop_transfer[curve.frequency * side > 0.0]
    L = np.where(np.abs(L) > 50.0, np.nan, L)  # through infinity at a pole: no line is drawn there
    axes.plot(L.real, L.imag, label=label)
axes.plot(-1.0, 0.0, "r+", markersize=12)
axes.set(xlim=(-6, 6), ylim=(-6, 6), xlabel="real part of L", ylabel="imaginary part of L", aspect="equal")
axes.grid(alpha=0.3)
axes.legend()
figure.savefig(given.o, dpi=120)
print(f"saved {given.o}")
