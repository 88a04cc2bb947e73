"""Manoeuvres of the three-gyro platform on a GPU: the time of a million of two seconds, beside the target.

    python benchmarks/engine_cuda.py [--runs 1000000] [--seconds 2.0]

Caging loops close at 2.5 kHz around the platform while it is turned, with noise and stops, in Runge-Kutta steps of
0.2 ms (5 kHz). A thousand runs differ in plant and initial state; the others repeat them with noise of their own. The
device's time holds the transfers to it and back, but neither the scenarios' making on the host, which is shown besides,
nor the kernel's compilation. First a few runs are held against the processor's. Ends with the reason where there is no
GPU.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import control
import numpy as np

from platform_ctrl import read_platform
from platform_ctrl.errors import SimulationError
from platform_ctrl.job.scenario import HalfCosine, Scenario
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation.batch import batch_metrics, merged_controller
from platform_ctrl.simulation.device import expect_device
from platform_ctrl.simulation.run_plan import Batch, batch, prepared

MODEL = Path(__file__).parent.parent / "models" / "three_gyro_platform.toml"
PERIOD, STEP, DIFFERENT = 4e-4, 2e-4, 1000
TARGET = 60.0  # s, for a million manoeuvres of two seconds on one H100


def caging(platform: Platform) -> control.StateSpace:
    """Return a proportional and derivative law for every gimbal with torquer and pick-off."""
    pairs = [(t.name, s.name) for t in platform.torquers for s in platform.pickoffs if t.gimbal == s.gimbal]
    size = len(pairs)
    one, decay = np.eye(size), 0.5
    return control.ss(
        decay * one, (1.0 - decay) * one, 40.0 * one, -41.0 * one, PERIOD, inputs=[s for _, s in pairs],
        outputs=[t for t, _ in pairs], name="caging",
    )  # fmt: skip


def manoeuvres(seconds: float) -> Batch:
    """Return a thousand different runs, ready for the kernel."""
    platform, rng = read_platform(MODEL), np.random.default_rng(0)
    members = []
    for run in range(DIFFERENT):
        rotors = tuple(
            dataclasses.replace(r, angular_momentum=r.angular_momentum * rng.normal(1.0, 0.01)) for r in platform.rotors
        )
        scenario = Scenario(
            platform=dataclasses.replace(platform, rotors=rotors),
            mode="caged",
            duration=seconds,
            delay=PERIOD,
            profile=HalfCosine(axis=2, rate=0.05, rise=0.25 * seconds, hold=0.25 * seconds),
            q=1e-4 * rng.standard_normal(len(platform.gimbals)),
            run=run,
        )
        members.append(prepared(scenario, PERIOD, STEP))
    return batch(members, merged_controller(platform, [caging(platform)], PERIOD, "caged"), PERIOD, True)


def repeated(batch: Batch, runs: int) -> Batch:
    """Return `runs` runs: those of the batch again and again, with noise of their own."""
    rows = np.arange(runs) % len(batch.keys)
    keys = np.stack([np.zeros(runs, dtype=np.uint64), np.arange(runs, dtype=np.uint64)], axis=1)
    return batch._replace(plants=batch.plants[rows], given=batch.given[rows], keys=keys)


def main() -> None:
    """Print the table; exit code 1 if the figures disagree or the target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=2.0)
    given = parser.parse_args()
    try:
        expect_device("cuda")
    except SimulationError as error:
        print(f"skipped: {error}")
        return
    cuda: Any = import_module("numba.cuda")
    start = time.perf_counter()
    few = manoeuvres(given.seconds)
    made = time.perf_counter() - start
    start = time.perf_counter()
    some = repeated(few, 64)
    there = batch_metrics(some, device="cuda")
    first = time.perf_counter() - start
    here = batch_metrics(some)
    deviation = float(np.abs(there - here).max() / np.abs(here).max())
    many = repeated(few, given.runs)
    start = time.perf_counter()
    batch_metrics(many, device="cuda")
    took = time.perf_counter() - start
    steps = given.runs * round(given.seconds / STEP)
    whole = took * (1_000_000 * 2.0 / STEP) / steps
    name = cuda.get_current_device().name
    print(f"device                                   {name.decode() if isinstance(name, bytes) else name}")
    print(f"64 runs, compilation included            {first:.1f} s")
    print(f"deviation from the processor, relative   {deviation:.1e}")
    print(f"{given.runs} runs of {given.seconds:g} s              {took:.1f} s, {steps / took:.3g} steps/s")
    print(f"a million of two seconds                 {whole:.1f} s; target on one H100: under {TARGET:g} s")
    print(f"making scenarios on the host             {made / DIFFERENT * 1e6:.0f} s for a million on one processor")
    if deviation > 1e-9 or whole > TARGET:
        sys.exit(1)


if __name__ == "__main__":
    main()
