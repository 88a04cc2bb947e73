"""Platform with a floated gyro: its gain, its poles, and what the fluid does to nutation.

    python examples/floated_gyro_platform.py                  prints theory and computed values
    python examples/floated_gyro_platform.py -o floated.png   draws the roots over the fluid's damping as well

No loop is closed. With J_p of the platform, J_o of the float, C of the fluid, H of the rotor and d of the bearing the
free platform's rates follow (J_p s + d)(J_o s + C) + H^2 = 0. Without the fluid that is a nutation at H / sqrt(J_p
J_o).
"""

from __future__ import annotations

import argparse
import dataclasses
from math import sqrt

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc


def row(quantity: str, theory: float, computed: float) -> None:
    """Print one line of the table."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}")


def damped(platform: pc.Platform, fluid: float) -> pc.Platform:
    """The same with another fluid around the float."""
    frictions = [dataclasses.replace(f, viscous=fluid) if f.gimbal == "float" else f for f in platform.frictions]
    return dataclasses.replace(platform, frictions=tuple(frictions))


def rates(platform: pc.Platform) -> np.ndarray:
    """The two poles that are not an angle's own integral, fastest last."""
    poles = np.linalg.eigvals(pc.state_space(pc.linearise(platform)).A)
    return sorted(poles, key=abs)[2:]


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Gain and poles of a platform with a floated gyro.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the roots over the fluid's damping")
    file = parser.parse_args().o

    platform = pc.read_platform("floated_gyro_platform")
    model = pc.linearise(platform)
    (J_p, J_o), H = np.diag(model.M), platform.rotors[0].angular_momentum
    d, C = (friction.viscous for friction in platform.frictions)
    body, rotor = platform.gimbals[1].inertia, platform.rotors[0].transverse_inertia
    theory = sorted(np.roots([J_p * J_o, J_p * C + J_o * d, H**2 + d * C]), key=abs)
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    row("inertia about the output axis, kg m2", body[0, 0] + rotor, J_o)
    row("inertia of the platform with its gyro, kg m2", platform.gimbals[0].inertia[2, 2] + body[2, 2] + rotor, J_p)
    row("slow pole, 1/s: near -(H^2/C + d)/J_p", theory[0].real, rates(platform)[0].real)
    row("fast pole, 1/s: near -C/J_o", theory[1].real, rates(platform)[1].real)
    bare = damped(dataclasses.replace(platform, frictions=platform.frictions[1:]), 0.0)
    row("nutation without fluid, rad/s: H/sqrt(J_p J_o)", H / sqrt(J_p * J_o), abs(rates(bare)[0]))
    # The base turns slowly with the platform caged to it: the float turns by H/C of the angle.
    caged = pc.state_space(model, gimbals=["float"], others="held")
    response = pc.analysis.frequency_response(caged["float", "Omega3"], np.array([1.0]))[0, 0, 0]
    exact = abs(H / (1j * (1j * J_o + C)))
    row("float's angle per base rate at 1 rad/s: H/(C s)", exact, abs(response))
    turning = pc.simulation.rollout(damped(bare, C), [[0.0, 0.0]], [[0.0, 0.0, 0.0, 1e-3, 0.0]], 2e-5, 50_000)
    row(
        "angle by which 1 mrad/s comes to rest, mrad: J_p C/H^2",
        J_p * C / H**2,
        turning.q[0, 0] * 1e3 / (1 - np.exp(rates(damped(bare, C))[0].real)),
    )
    if not file:
        return
    figure, plot = plt.subplots(figsize=(7, 4.8), layout="constrained")
    fluids = np.geomspace(1e-4, 1.0, 160) * C
    roots = np.array([rates(damped(platform, fluid)) for fluid in fluids])
    plot.semilogx(fluids, roots.real, "C0.", markersize=3)
    plot.semilogx(fluids, roots.imag, "C3.", markersize=3)
    plot.set(xlabel="damping of the fluid, N m s", ylabel="pole, 1/s", title="real (blue) and imaginary parts (red)")
    plot.set_ylim(-60.0, 60.0)
    plot.grid(alpha=0.3)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
