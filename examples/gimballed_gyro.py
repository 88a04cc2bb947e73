"""Gyro in two gimbals: nutation, precession, drift from unbalance, and the drift of the Kardankreisel by nutation.

    python examples/gimballed_gyro.py                  prints theory and computed values
    python examples/gimballed_gyro.py -o drift.png     draws how the spin axis nutates and drifts as well

With the spin axis at beta0 to the plane that is normal to the outer axis, a nutation of amplitude b makes the outer
gimbal drift (K. Magnus 1955). The momentum about the outer axis, p = J(beta) alpha' - L sin(beta), is constant; to
second order in b the mean of alpha' is then L sin(beta0) b^2 (J_o + J_s) / (2 J(beta0)^2), with J_o of the outer
gimbal alone and J_s of the inner one about the spin axis. A regulated rotor adds its C to J_s, a free one does not.
"""

from __future__ import annotations

import argparse
import dataclasses
from math import cos, degrees, radians, sin, sqrt

import matplotlib.pyplot as plt
import numpy as np

import platform_ctrl as pc

BETA0, KICK = radians(30.0), 25.0  # rad; rad/s of the inner gimbal: a nutation of 1.5 degrees
STEP, EVERY = 2e-5, 10


def row(quantity: str, theory: float, computed: float, good_to: str = "") -> None:
    """Print one line of the table; `good_to` says how good an approximate theory is, if not to 0.1 %."""
    print(f"{quantity:58s}{theory:12.5g}{computed:12.5g}" + (f"  (theory to {good_to})" if good_to else ""))


def run(gyro: pc.Platform, beta: float, rates=(0.0, 0.0), torque=(0.0, 0.0), duration: float = 0.3):
    """Time, alpha and beta of the non-linear gyro on a bench so heavy that it stays at rest."""
    bench = dataclasses.replace(gyro, root_inertia=1e3 * np.eye(3))
    steps = round(duration / STEP)
    out = pc.simulation.rollout(
        bench, [[0.0, beta]], [[0, 0, 0, *rates]], STEP, steps, force=[[0, 0, 0, *torque]], every=EVERY
    )
    return out.t, *out.q_history[0].T


def whole_periods(t: np.ndarray, angle: np.ndarray) -> tuple[float, np.ndarray]:
    """Frequency of an oscillation, rad/s, and its upward zero crossings, s."""
    around = angle - 0.5 * (angle.max() + angle.min())
    k = np.flatnonzero((around[:-1] < 0.0) & (around[1:] >= 0.0))
    zero = t[k] - around[k] * (t[k + 1] - t[k]) / (around[k + 1] - around[k])
    return 2.0 * np.pi * (len(zero) - 1) / (zero[-1] - zero[0]), zero


def kardan_drift(gyro: pc.Platform):
    """Drift by theory and from a run, rad/s, and the run."""
    t, alpha, beta = run(gyro, BETA0, (0.0, KICK))
    amplitude = 0.5 * (beta.max() - beta.min())
    rotor, (outer, inner) = gyro.rotors[0], gyro.gimbals
    J_s = inner.inertia[0, 0] + (rotor.axial_inertia if rotor.control == "regulated" else 0.0)
    J_third = inner.inertia[2, 2] + rotor.transverse_inertia
    J = outer.inertia[2, 2] + J_s * sin(BETA0) ** 2 + J_third * cos(BETA0) ** 2
    L = rotor.angular_momentum
    theory = L * sin(BETA0) * amplitude**2 * (outer.inertia[2, 2] + J_s) / (2.0 * J**2)
    _, zero = whole_periods(t, beta)
    first, last = np.interp(zero[[0, -1]], t, alpha)
    return theory, (last - first) / (zero[-1] - zero[0]), t, alpha, beta


def main() -> None:
    """Print the table, and draw."""
    parser = argparse.ArgumentParser(description="Nutation, precession and drift of a gyro in two gimbals.")
    parser.add_argument("-o", metavar="FILE", help="save a figure of the drift by nutation")
    file = parser.parse_args().o

    gyro = pc.read_platform("gimballed_gyro")
    ideal = dataclasses.replace(gyro, frictions=(), unbalances=())
    model = pc.linearise(gyro)
    (J_outer, J_inner), L = np.diag(model.M), gyro.rotors[0].angular_momentum
    nutation = L / sqrt(J_outer * J_inner)
    print(f"{'quantity':58s}{'theory':>12s}{'computed':>12s}")
    row(
        "nutation, rad/s: L/sqrt(J_outer J_inner), poles",
        nutation,
        np.abs(pc.state_space(model).poles()).max(),
    )
    t, _, beta = run(ideal, 0.0, (0.0, 1.0))
    row("nutation, rad/s: non-linear run", nutation, whole_periods(t, beta)[0])

    # A torque on one gimbal turns the other one.
    t, _, beta = run(ideal, 0.0, (0.0, -0.01 / L), torque=(0.01, 0.0))
    row(
        "precession of the inner gimbal at 0.01 N m, deg/s: Q/L",
        degrees(-0.01 / L),
        degrees((beta[-1] - beta[0]) / t[-1]),
    )
    weight = gyro.unbalances[0].moment[0] * gyro.specific_force[2]
    heavy = dataclasses.replace(gyro, frictions=())
    t, alpha, _ = run(heavy, 0.0, (weight / L, 0.0))
    row(
        "drift from unbalance, deg/h: m r g/L",
        3600 * degrees(weight / L),
        3600 * degrees((alpha[-1] - alpha[0]) / t[-1]),
    )

    runs = {"regulated rotor": kardan_drift(ideal), "free rotor": kardan_drift(pc.with_free_rotors(ideal))}
    for name, (theory, computed, *_) in runs.items():
        row(f"drift by nutation, beta0 = 30 deg, deg/s: {name}", degrees(theory), degrees(computed), "0.3 %")
    if not file:
        return
    figure, all_axes = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained", sharex=True, sharey=True)
    for axes, (name, (theory, _, t, alpha, beta)) in zip(all_axes, runs.items(), strict=True):
        axes.plot(np.degrees(alpha), np.degrees(beta), color="C0", linewidth=0.5, label="spin axis")
        mean = alpha.mean() + theory * (t - t.mean())
        axes.plot(np.degrees(mean), np.full_like(t, degrees(BETA0)), "C3", linewidth=2.0, label="mean, by theory")
        axes.set_title(f"{name}: drift {degrees(theory):.2f} deg/s")
        axes.set_xlabel("outer gimbal, deg")
        axes.grid(alpha=0.3)
    all_axes[0].set_ylabel("inner gimbal, deg")
    all_axes[0].set_ylim(28.2, 32.2)
    all_axes[0].legend(loc="upper right", ncols=2)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
