"""The linear budget of the shipped camera's line of sight beside many runs of the non-linear plant.

    python benchmarks/budget_truth.py [--runs 10000] [--time 0.5]

Once with everything that is linear: viscous friction, base motion, vibration, noise of the gyros, hold, delay and lag,
without stops, limits and drives. Once as shipped, with dry friction, which a drive feeds forward: the budget replaces
both by describing functions and a noise. Once with the dry friction and without the drive.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import platform_ctrl as pc
from platform_ctrl.job.job import Job
from platform_ctrl.verification.simulated import simulated_budget

JOB = Path(__file__).parent.parent / "examples" / "camera_gimbal.toml"
DESIGN = "PI2"  # the one that takes no tuning


def camera() -> Job:
    """Return the shipped job with the design that is computed at once."""
    job = pc.read_job(JOB)
    (loop,) = job.loops
    only = tuple(one for one in loop.designs if one.name == DESIGN)
    return dataclasses.replace(job, loops=(dataclasses.replace(loop, use=DESIGN, designs=only),))


def made_linear(job: Job) -> Job:
    """Return the job with viscous friction alone, and nothing that a motion runs into."""
    none = (0.0, 0.0)
    platform = job.platform
    platform = dataclasses.replace(
        platform,
        frictions=tuple(dataclasses.replace(one, coulomb=none, breakaway=none) for one in platform.frictions),
        gimbals=tuple(dataclasses.replace(one, stops=None, restitution=0.0) for one in platform.gimbals),
        torquers=tuple(dataclasses.replace(one, limit=None, rate_limit=None) for one in platform.torquers),
    )
    return dataclasses.replace(job, platform=platform, drives=())


def main() -> None:
    """Print the comparisons."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--time", type=float, default=0.5, help="s for which a run is observed")
    given = parser.parse_args()
    job = camera()
    controllers = [outcome.closed.controller for outcome in pc.design.loops(job)]
    jobs = {"linear plant": made_linear(job), "as shipped": job, "without drives": dataclasses.replace(job, drives=())}
    for words, one in jobs.items():
        began = time.process_time()
        found = simulated_budget(one, controllers, given.runs, time=given.time)
        taken = time.process_time() - began
        print(f"{words}: {given.runs} runs of seed {found.seed}, {given.time:g} s each, {taken:.0f} s of CPU time")
        for k in (0, 1):
            simulated, linear = 1e6 * float(found.rms[k]), 1e6 * float(found.linear[k])
            low, high = (float(end[k] / found.linear[k]) for end in (found.low, found.high))
            ratio = f"{simulated / linear:.4f} (95 %: {low:.4f} to {high:.4f})"
            print(f"  axis {k + 1}: {simulated:.3f} µrad simulated, {linear:.3f} linear, ratio {ratio}", flush=True)


if __name__ == "__main__":
    main()
