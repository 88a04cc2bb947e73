"""Bode plots of gyro 9-10: from the torque on gimbal 9 to both angles, and the loop with a caging controller closed.

    python examples/bode.py                 shows the plots
    python examples/bode.py -o bode.png     saves them

Prints the margins. Take this file as a start: change the plant, the gimbals and the controller's numbers.
"""

from __future__ import annotations

import argparse

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc

# One loop of a job: what examples/three_gyro_platform.toml says about gimbals 9 and 10, without tuning.
JOB = {
    "schema": 2,
    "name": "gyro 9-10",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [0.0, 0.0, 0.0]},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "caging 9-10",
            "kind": "caging",
            "gimbals": ["9", "10"],
            "use": "PI across, lead along",
            "design": [
                {
                    "name": "PI across, lead along",
                    "method": "classical",
                    "crossover_hz": 70,
                    "integral_hz": 2,
                    "damping_hz": 78,
                    "damping2_hz": 92,
                    "lead_hz": 7,
                    "rolloff_hz": 900,
                }
            ],
        }
    ],
}
TORQUES, ANGLES = ["Q9", "Q10"], ["alpha9", "beta10"]

parser = argparse.ArgumentParser(description="Bode plots of gyro 9-10, open loop and caged.")
parser.add_argument("-o", metavar="FILE", help="save the figure instead of showing it")
file = parser.parse_args().o

# The plant: at rest, without control, torque to angle.
job = pc.read_job(JOB)
gyro = pc.state_space(pc.linearise(job.platform), gimbals=("9", "10"))[ANGLES, TORQUES]

# What the sampled controller sees, with delay and the torquers' lag; and the controller, torque = K(angle).
lag = [torquer.lag for torquer in job.platform.torquers if torquer.gimbal in ("9", "10")]
sampled = pc.analysis.sampled(gyro, job.sampling.period, job.sampling.delay, lag)
controller = pc.design.loops(job)[0].closed.controller

hz = np.geomspace(0.5, 990.0, 2000)
frequency = 2.0 * np.pi * hz
open_loop = pc.analysis.frequency_response(gyro, frequency)  # (angles, torques, frequencies)

# The loop broken at one torque while the other stays closed: L = 1/S - 1 with that torque's own sensitivity S.
S = pc.analysis.gang(sampled, controller, frequency).S_input
loop = {torque: 1.0 / S[k, k] - 1.0 for k, torque in enumerate(TORQUES)}

bandwidth = pc.analysis.bandwidth(sampled, controller, at="input")
both = pc.analysis.disk_margin(pc.analysis.loop_transfer(sampled, controller, at="input"))
one = pc.analysis.loop_margins(sampled, controller)
print(f"bandwidth (largest gain of S at 1/sqrt 2): {bandwidth / (2.0 * np.pi):.1f} Hz")
for name, alpha in [*zip(one.channels, one.alpha, strict=True), ("Q9 and Q10 at once", both.lower)]:
    high = (2.0 + alpha) / (2.0 - alpha)  # the disk of factors |f - 1| <= alpha/2 |f + 1|
    low, phase = 1.0 / high, 2.0 * np.arctan(alpha / 2.0)
    print(f"{name}: disk margin {alpha:.3f}, so gain x {low:.2f} to x {high:.2f} or phase {np.degrees(phase):.0f} deg")

figure, axes = plt.subplots(2, 2, figsize=(11, 7), sharex=True, layout="constrained")
(gain, loop_gain), (phase_axes, loop_phase) = axes


def draw(above: plt.Axes, below: plt.Axes, response: np.ndarray, label: str) -> None:
    """Gain and phase; the phase is followed from the lowest frequency on."""
    # At a pole without damping the phase jumps by 180 degrees, up as well as down; with the least damping it falls.
    tilt = 1e-6 * np.arange(len(hz))
    above.loglog(hz, np.abs(response), label=label)
    below.semilogx(hz, np.degrees(np.unwrap(np.angle(response) + tilt) - tilt), label=label)


for k, angle in enumerate(ANGLES):
    draw(gain, phase_axes, open_loop[k, 0], f"Q9 to {angle}")
for torque, response in loop.items():
    crossing = hz[np.flatnonzero(np.diff(np.abs(response) > 1.0))]
    at = ", ".join(f"{f:.0f}" for f in crossing)
    draw(loop_gain, loop_phase, response, f"broken at {torque}, the other closed: gain 1 at {at} Hz")
    loop_gain.plot(crossing, np.ones(len(crossing)), "k.")

nutation = np.abs(gyro.poles()).max() / (2.0 * np.pi)
for each in axes.flat:
    each.axvline(nutation, color="0.6", linestyle=":", zorder=0)
    each.grid(alpha=0.3)
gain.set_title("open loop, no control")
gain.set_ylabel("rad / N m")
top = gain.get_ylim()[1]
gain.annotate(f"nutation {nutation:.1f} Hz", (nutation, top), xytext=(6, -14), textcoords="offset points")
loop_gain.set_title("loop transfer, sampled, with delay")
loop_gain.axhline(1.0, color="0.3", linewidth=0.8)
loop_gain.set_ylabel("gain")
for below in (phase_axes, loop_phase):
    below.set_xlabel("frequency, Hz")
    below.set_ylabel("phase, deg")
    below.yaxis.set_major_locator(plt.MultipleLocator(90))
gain.legend()
loop_gain.legend()

if file:
    figure.savefig(file, dpi=120)
else:
    plt.show()
