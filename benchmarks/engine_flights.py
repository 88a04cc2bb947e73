"""The sampled closed loop: manoeuvres flown side by side, beside the same ones flown one after another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import control
import numpy as np
from side_by_side import Comparison, DisagreementError, Section

from platform_ctrl.design import loops
from platform_ctrl.design.methods import read_job
from platform_ctrl.job.job import Job
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.simulation import simulate, simulate_batch
from platform_ctrl.simulation.closed_loop import Trajectory

JOB = Path(__file__).parent.parent / "examples" / "three_gyro_platform.toml"
RUNS, STEP, DURATION = 64, 2e-4, 1.0


@cache
def closed() -> tuple[Job, list[control.StateSpace]]:
    """Return the main job with its classical caging loops, which take least time to design, and the platform servo."""
    job = read_job(JOB)
    quick = tuple(
        replace(loop, designs=(replace(loop.designs[0], tune=False),), use=loop.designs[0].name, limits={})
        for loop in job.loops
    )
    job = replace(job, loops=quick)
    return job, [outcome.closed.controller for outcome in loops(job)]


def scenarios(job: Job, mode: str) -> list[Scenario]:
    """Return the first manoeuvre of a mode, with other noise in every run."""
    [one, *_] = [manoeuvre for manoeuvre in job.manoeuvres if manoeuvre.mode == mode]
    return [replace(job.scenario(one), duration=DURATION, run=k) for k in range(RUNS)]


def _alone(runs: list[Scenario], controllers: list[control.StateSpace], period: float) -> list[Trajectory]:
    return [simulate(one, controllers, period=period, step=STEP) for one in runs]


def _same_figures(ours: Any, theirs: Mapping[str, Any]) -> str:
    for runs in theirs.values():
        alone = np.array([np.abs(run.q).max(axis=0) for run in runs])
        if not np.array_equal(ours.angle, alone):
            raise DisagreementError("one after another: other angles")
    return "the bit"


def flights() -> Iterator[Comparison]:
    """Compare a batch with one run after another, in both modes."""
    for mode in ("caged", "stabilised"):
        job, controllers = closed()
        runs, period = scenarios(job, mode), job.sampling.period
        yield Comparison(
            name=f"{RUNS} {mode} manoeuvres of {DURATION:g} s",
            ours=partial(simulate_batch, runs, controllers, period=period, step=STEP),
            theirs={"one after another": partial(_alone, runs, controllers, period)},
            check=_same_figures,
            unit="steps/s",
            work=RUNS * round(DURATION / STEP),
            clock="cpu",
        )


SECTIONS: dict[str, Section] = {"closed-loop": flights}
