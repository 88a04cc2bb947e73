"""The jitter budget of a sampled loop beside a simulation in time, and how long a slider's step takes.

    python benchmarks/budget.py

Ten states, two controls, eight random sources, two lines of sight; one sample of delay. Both give the rms of the line
of sight; the simulation steps 32 loops with eight instants in a period until it knows the rms to about one per cent.
"""

from __future__ import annotations

import math
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from platform_ctrl.analysis.hybrid_plant import Density, HybridPlant, RandomDisturbance
from platform_ctrl.analysis.jitter_budget import JitterBudget
from platform_ctrl.analysis.sampling import held_input
from platform_ctrl.analysis.system import System

PERIOD, SOURCES, INSTANTS, LOOPS, PERIODS = 1e-3, 8, 8, 32, 20_000
# First-order noise of the disturbances: corner, rad/s; its density is cut where it hardly counts.
CORNER = 300.0


def plant() -> HybridPlant:
    """Return two rate axes with four lightly damped modes."""
    rng = np.random.default_rng(1)
    A = np.zeros((10, 10))
    A[0, 0] = A[1, 1] = -0.2
    for i, w in enumerate((300.0, 420.0, 600.0, 900.0)):
        A[2 + 2 * i : 4 + 2 * i, 2 + 2 * i : 4 + 2 * i] = [[0.0, w], [-w, -0.02 * w]]
    B = rng.normal(size=(10, 2 + SOURCES))
    B[:, :2] = 0.0
    B[0, 0] = B[1, 1] = 50.0
    C = np.zeros((2, 10))
    C[0, 0] = C[1, 1] = 1.0
    C[:, 2::2] = 0.05 * rng.normal(size=(2, 4))
    return HybridPlant(
        plant=System(A, B, np.vstack([C, C]), np.zeros((4, 2 + SOURCES))),
        controls=2,
        measured=2,
        period=PERIOD,
        delay=PERIOD,
    )


def controller(gain: float) -> System:
    """Return proportional and integral control of both rates."""
    one = np.eye(2)
    return System(one, 20.0 * PERIOD * one, -gain * one, -gain * one, PERIOD)


def sources() -> list[RandomDisturbance]:
    """Return eight independent noises, one-sided density 2/(1 + (ω/corner)²)² per Hz."""
    knots = np.array([0.0, 30.0, 100.0, 300.0, 1e3, 3e3, 3e4])
    density = Density(knots=knots, density=lambda w: 2.0 / (1.0 + (w / CORNER) ** 2) ** 2)
    return [RandomDisturbance(name=f"source {i}", inputs=(i,), spectra=(density,)) for i in range(SOURCES)]


def simulated(of: HybridPlant, K: System) -> np.ndarray:
    """Return the rms of both outputs in a simulation: noise of second order drives the plant, held over an instant."""
    rng = np.random.default_rng(0)
    A, B, C, _, _ = of.plant
    h = PERIOD / INSTANTS
    n, k = len(A), SOURCES
    whole = np.zeros((n + 2 * k, n + 2 * k))
    whole[:n, :n], whole[:n, n : n + k] = A, B[:, 2:]
    whole[n : n + k, n : n + k] = whole[n + k :, n + k :] = -CORNER * np.eye(k)
    whole[n : n + k, n + k :] = CORNER * np.eye(k)
    white = np.zeros((n + 2 * k, k))
    white[n + k :] = CORNER * np.eye(k)
    step, held = held_input(whole, np.hstack([np.vstack([B[:, :2], np.zeros((2 * k, 2))]), white]), h)
    x = np.zeros((LOOPS, n + 2 * k))
    state, u = np.zeros((LOOPS, 2)), np.zeros((LOOPS, 2))
    square, start = np.zeros(2), PERIODS // 10
    for period in range(PERIODS):
        y = x[:, :n] @ C[:2].T
        late, u = u, state @ K.C.T + y @ K.D.T
        state = state @ K.A.T + y @ K.B.T
        for _ in range(INSTANTS):
            noise = rng.standard_normal((LOOPS, k)) / math.sqrt(h)
            x = x @ step.T + np.hstack([late, noise]) @ held.T
            if period >= start:
                square += np.sum((x[:, :n] @ C[2:].T) ** 2, axis=0)
    return np.sqrt(square / (LOOPS * INSTANTS * (PERIODS - start)))


def main() -> None:
    """Print both answers and their times."""
    of = plant()
    began = time.process_time()
    prepared = JitterBudget(of, sources())
    prepared.of(controller(1.0))
    first = time.process_time() - began
    steps = []
    for gain in np.linspace(0.8, 1.2, 41):
        began = time.process_time()
        found = prepared.of(controller(float(gain)))
        steps.append(time.process_time() - began)
    found = prepared.of(controller(1.0))
    began = time.process_time()
    brute = simulated(of, controller(1.0))
    taken = time.process_time() - began
    print(f"first budget, with the plant's responses   {1e3 * first:8.1f} ms")
    print(
        f"budget with another controller, median     {1e3 * np.median(steps):8.1f} ms  (largest {1e3 * max(steps):.1f})"
    )
    print(f"  {len(found.edges)} frequencies, error of integration {found.error:.0e}")
    times = taken / float(np.median(steps))
    print(f"simulation in time                         {1e3 * taken:8.1f} ms  ({times:,.0f} times as long)")
    for axis in range(2):
        off = brute[axis] / found.total[axis] - 1.0
        print(f"  rms {found.total[axis]:.5f} by the budget, {brute[axis]:.5f} simulated ({off:+.2%})")


if __name__ == "__main__":
    main()
