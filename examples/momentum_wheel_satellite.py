"""Satellite with a momentum wheel: nutation, and the wheel that a rotation about an unstable axis needs.

    python examples/momentum_wheel_satellite.py                     prints theory and computed values
    python examples/momentum_wheel_satellite.py -o satellite.png    draws the growth rate over the wheel's momentum

The satellite turns with Omega0 about axis 2, its axis of intermediate inertia. With the wheel (momentum h) held along
that axis its small motions are stable where

    (h + (J2 - J1) Omega0) (h + (J2 - J3) Omega0) > 0

Gimbals of stiffness k with dampers change two things. Energy decides, not frequencies (Kelvin, Tait): BOTH factors must
have the sign of the whole momentum J2 Omega0 + h, so that a wheel against the rotation does not help unless it
outweighs the satellite. And the wheel gives way: it is worth h k / (k + h Omega0).
"""

from __future__ import annotations

import argparse
import dataclasses
from math import pi, sqrt

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import brentq

import platform_ctrl as pc

OMEGA0 = 0.05  # rad/s


def row(quantity: str, theory: float, computed: float) -> None:
    """Print one line of the table."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}")


def variant(satellite: pc.Platform, h: float, stiffness: float | None = None, damped: bool = True) -> pc.Platform:
    """The satellite with another wheel, stiffer gimbals, or gimbals without dampers."""
    wheel = dataclasses.replace(satellite.rotors[0], angular_momentum=h)
    out = dataclasses.replace(satellite, rotors=(wheel,), frictions=satellite.frictions if damped else ())
    if stiffness is None:
        return out
    return dataclasses.replace(out, springs=tuple(dataclasses.replace(s, stiffness=stiffness) for s in out.springs))


def poles(satellite: pc.Platform, Omega0: float = OMEGA0) -> np.ndarray:
    """Poles of the free satellite about its rotation; the one at zero, for its momentum, is left out."""
    found = pc.state_space(pc.linearise(satellite, (0.0, Omega0, 0.0)), root="free").poles()
    return np.delete(found, np.abs(found).argmin())


def growth(satellite: pc.Platform) -> float:
    """Largest real part of the poles, 1/s."""
    return float(poles(satellite).real.max())


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Gyroscopic stabilisation of a satellite by a momentum wheel.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the growth rate over the wheel's momentum")
    file = parser.parse_args().o

    satellite = pc.read_platform("momentum_wheel_satellite")
    h = satellite.rotors[0].angular_momentum
    J1, J2, J3 = np.diag(pc.linearise(satellite).root_inertia)
    locked = {"stiffness": 1e6, "damped": False}

    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    slowest = np.abs(poles(variant(satellite, h, **locked), 0.0)).min()
    row("nutation at rest, rad/s: h/sqrt(J1 J3)", h / sqrt(J1 * J3), slowest)
    product = (h + (J2 - J1) * OMEGA0) * (h + (J2 - J3) * OMEGA0)
    row(
        "nutation at Omega0 = 0.05 rad/s",
        sqrt(product / (J1 * J3)),
        np.abs(poles(variant(satellite, h, **locked))).min(),
    )
    without = sqrt((J2 - J1) * (J3 - J2) / (J1 * J3)) * OMEGA0
    row("growth without the wheel, 1/s", without, growth(variant(satellite, 0.0, **locked)))

    def limit(low: float, high: float, stiffness: float, damped: bool) -> float:
        """Wheel momentum at which the growth passes a threshold far below all others."""
        return brentq(lambda x: growth(variant(satellite, x, stiffness, damped)) - 1e-8, low, high, xtol=1e-6)

    needed = (J3 - J2) * OMEGA0
    row("least wheel, locked gimbals, N m s: (J3 - J2) Omega0", needed, limit(2.0, 15.0, 1e6, False))
    row("least wheel against the rotation: -(J2 - J1) Omega0", -(J2 - J1) * OMEGA0, limit(-15.0, 2.0, 1e6, False))
    for k in (8.0, 1.0):
        row(
            f"least wheel, damped gimbals of {k:g} N m/rad",
            needed / (1.0 - needed * OMEGA0 / k),
            limit(2.0, 19.0, k, True),
        )
    held, damped = growth(variant(satellite, -20.0, **locked)), growth(variant(satellite, -20.0))
    print(f"a wheel of -20 N m s: growth {held:.1e} 1/s with locked gimbals, {damped:.1e} 1/s with damped ones")
    if not file:
        return
    momenta = np.linspace(-25.0, 25.0, 201)
    figure, axes = plt.subplots(figsize=(9, 4.8), layout="constrained")
    cases = {"gimbals locked": locked, "gimbals sprung and damped": {}}
    for (name, case), style in zip(cases.items(), ("C0", "C3"), strict=True):
        rates = np.array([growth(variant(satellite, x, **case)) for x in momenta])
        axes.semilogy(momenta, np.where(rates > 1e-9, rates, np.nan), style, linewidth=2.0, label=name)
    for edge, text in ((needed, r"$(J_3-J_2)\,\Omega_0$"), (-(J2 - J1) * OMEGA0, r"$-(J_2-J_1)\,\Omega_0$")):
        axes.axvline(edge, color="0.5", linestyle=":")
        axes.annotate(text, (edge, 2e-7), xytext=(6, 3), textcoords="offset points")
    axes.axvspan(needed / (1.0 - needed * OMEGA0 / 8.0), 25.0, color="C2", alpha=0.12, label="stable, damped or not")
    axes.set(
        xlabel="wheel momentum h, N m s", ylabel="growth rate, 1/s (no line: stable)", xlim=(-25, 25), ylim=(1e-7, 0.1)
    )
    axes.set_title(f"satellite turning about its intermediate axis once in {2 * pi / OMEGA0:.0f} s")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
