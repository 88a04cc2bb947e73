"""Seeker head: what errors of the base gyros and of the resolvers put into an indirectly stabilised line of sight.

    python examples/seeker_head.py                   prints theory and computed values
    python examples/seeker_head.py -o seeker.png     draws the missile's motion that is left as well

Direct stabilisation takes the rate of the line of sight from gyros that ride on it. Indirect stabilisation adds the
missile's rate, from gyros on the base, and the rate of the gimbals, from the resolvers' angles. Scale factors e of
the gyros and r of the resolvers are wrong by little, but of two large numbers that cancel: the share e - r of the
missile's rate is left in what the loop holds at zero, and no loop can take it away: 1.5e-3 with opposite signs, or 56
dB.
"""

from __future__ import annotations

import argparse
from math import log10, pi, radians, sqrt

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc


def row(quantity: str, theory: float, computed: float, good_to: str = "") -> None:
    """Print one line of the table; `good_to` says how good an approximate theory is, if not to 0.1 %."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}" + (f"  (theory to {good_to})" if good_to else ""))


def isolation(seeker: pc.Platform, hz: float) -> float:
    """Pitch rate of the optics over that of the missile, from the linear model."""
    system = pc.state_space(pc.linearise(seeker))["pitch", "Omega2"]
    frequency = np.array([2.0 * pi * hz])
    return float(np.abs(1.0 + 1j * frequency * pc.analysis.frequency_response(system, frequency)[0, 0])[0])


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Direct and indirect stabilisation of a seeker head.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the missile's motion that is left")
    file = parser.parse_args().o

    seeker = pc.read_platform("seeker_head")
    model = pc.linearise(seeker)
    outer, inner = seeker.gimbals
    gyro = {sensor.name: sensor for sensor in seeker.rate_sensors}
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    row("pitch inertia, kg m2", outer.inertia[1, 1] + inner.inertia[1, 1], model.M[0, 0])
    at = pc.linearise(seeker, q=[0.0, radians(30.0)]).M[0, 0]
    across = inner.inertia[0, 0] * 0.25 + inner.inertia[1, 1] * 0.75
    row("pitch inertia at yaw 30 deg, kg m2", outer.inertia[1, 1] + across, at)
    # Sharp indirect loops keep the sum of what gyro and resolver read at zero: both by their scale factors.
    e, r = gyro["Omega2"].scale_error, seeker.pickoffs[0].scale_error
    gimbal_rate = -(1.0 + e) / (1.0 + r)
    row("missile's rate left by sharp indirect loops: r - e", r - e, 1.0 + gimbal_rate)
    row("attenuation that no such loop exceeds, dB", -20.0 * log10(r - e), -20.0 * log10(1.0 + gimbal_rate))
    drift = gyro["gyro_pitch"].noise_rms / sqrt(gyro["gyro_pitch"].noise_bandwidth_hz) * sqrt(0.5)
    row("angle random walk of the payload's gyro, deg/sqrt(h)", 0.15, np.degrees(drift) * 60.0, "1 %")
    bearing, spring = seeker.frictions[0], seeker.springs[0].stiffness
    s = 2j * pi * 2.0
    stiffness = spring + seeker.unbalances[0].moment[2] * -seeker.specific_force[2]
    take = bearing.viscous * s + stiffness
    row("share of 2 Hz that a free gimbal takes", abs(take / (model.M[0, 0] * s**2 + take)), isolation(seeker, 2.0))
    if not file:
        return
    figure, plot = plt.subplots(figsize=(7, 4.8), layout="constrained")
    hz = np.geomspace(0.1, 30.0, 120)
    free = [isolation(seeker, one) for one in hz]
    plot.loglog(hz, free, "C0", linewidth=2.0, label="free gimbals")
    for wrong, colour in ((r - e, "C2"), (r + e, "C3")):
        plot.axhline(wrong, color=colour, linestyle="--", label=f"best indirect loop, errors leave {wrong:.2g}")
    plot.set(xlabel="frequency, Hz", ylabel="line of sight's pitch rate / missile's", title="before any loop is closed")
    plot.grid(alpha=0.3)
    plot.legend()
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
