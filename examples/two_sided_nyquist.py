"""Two-sided Nyquist plot of gyro 9-10 in complex coordinates, z = alpha + i beta, with a cross-axis loop.

    python examples/two_sided_nyquist.py                                saves two_sided_nyquist.png
    python examples/two_sided_nyquist.py --crossover 40 --damping 20    another loop

J z'' - i h z' = q. Nutation turns one way: only the branch of positive frequencies passes through infinity at 75 Hz.
"""

from __future__ import annotations

import argparse

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import expm

import platform_ctrl as pc

parser = argparse.ArgumentParser(description="Two-sided Nyquist plot of gyro 9-10.")
parser.add_argument("--crossover", type=float, default=40.0, metavar="HZ", help="of the cross-axis gain")
parser.add_argument("--damping", type=float, default=50.0, metavar="HZ", help="strength of the direct-axis lead")
parser.add_argument("-o", default="two_sided_nyquist.png", metavar="FILE", help="where the figure goes")
given = parser.parse_args()

model = pc.linearise(pc.read_platform("three_gyro_platform"))
period, lag, w_c, w_d = 5e-4, 2e-4, 2 * np.pi * given.crossover, 2 * np.pi * given.damping
w_i, w_z, w_r = 2 * np.pi * np.array([2.0, 7.0, 900.0])  # integral, zero and pole of the lead
# The inertias of the two axes differ: units of their own make them alike. States z, z', torque, then the held torque.
J, h = np.sqrt(model.M[3, 3] * model.M[4, 4]), abs(model.G[3, 4])
F = np.array([[0, 1, 0, 0], [0, 1j * h / J, 1 / J, 0], [0, 0, -1 / lag, 1 / lag], [0, 0, 0, 0]])
A = expm(period * F)
A[3] = 0.0  # the delay is one sample
B, C = np.array([0, 0, 0, 1.0]), np.array([1.0, 0, 0, 0])


def controller(z):
    """Q = K z, by Tustin's rule: i h w_c (1 + w_i/s) across, which turns by 90 degrees, and a lead that damps."""
    s = 2 / period * (z - 1) / (z + 1)
    return 1j * h * w_c * (1 + w_i / s) - J * w_d * (s + w_z) / (s / w_r + 1)


frequency = np.concatenate([side * np.geomspace(1.0, np.pi / period, 20_000, endpoint=False) for side in (-1, 1)])
points = np.exp(1j * np.sort(frequency) * period)
plant = np.array([C @ np.linalg.solve(one * np.eye(4) - A, B) for one in points])
L = -controller(points) * plant
hz, margin = np.sort(frequency) / 6.2832, np.abs(2 * (1 + L) / (1 - L))
print(f"nutation {h / J / 6.2832:.1f} Hz, {len(A)} complex states")
print(f"disk margin {margin.min():.3f}, reached at {hz[margin.argmin()]:+.1f} Hz")
for k in np.flatnonzero(np.diff(np.abs(L) > 1.0)):
    print(f"  |L| = 1 at {hz[k]:+7.1f} Hz, phase margin {np.degrees(np.angle(-L[k])):+.0f} degrees")

figure, axes = plt.subplots(figsize=(7, 7))
L = np.where(np.abs(L) > 50.0, np.nan, L)  # through infinity at a pole: no line is drawn there
for side, label in ((hz > 0, "turning from alpha to beta"), (hz < 0, "from beta to alpha")):
    axes.plot(L[side].real, L[side].imag, label=label)
axes.plot(-1.0, 0.0, "r+", markersize=12)
axes.set(xlim=(-6, 6), ylim=(-6, 6), xlabel="real part of L", ylabel="imaginary part of L", aspect="equal")
axes.legend()
figure.savefig(given.o, dpi=120)
