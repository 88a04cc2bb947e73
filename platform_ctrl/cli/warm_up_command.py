"""``platform-ctrl warm-up``: what is compiled on first use is compiled now."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import typer

from platform_ctrl.cli.job_arguments import Json, Quiet

_LOOP = {"kind": "caging", "limits": {"bandwidth_hz": 15, "disk_margin": 0.2}}
_CLASSICAL = {"name": "classical", "method": "classical", "crossover_hz": 30, "integral_hz": 2}
# A job with the methods whose searches use compiled functions, all loops closed, and both kinds of runs.
_JOB: dict[str, Any] = {
    "schema": 2,
    "name": "warm-up",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [0.1, 0.1, 0.1]},
    "uncertainty": {"inertia": 0.01},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "coupled": {"disk_margin": 0.2},
    "loop": [
        _LOOP | {"name": "one", "gimbals": ["4", "5", "7"], "use": "classical", "design": [_CLASSICAL]},
        _LOOP
        | {
            "name": "two",
            "gimbals": ["9", "10"],
            "use": "classical",
            "design": [
                _CLASSICAL | {"crossover_hz": 40},
                {"name": "hinf", "method": "hinf"},
                {"name": "structured", "method": "structured", "evaluations": 20},
            ],
        },
        {
            "name": "servo",
            "kind": "stabilisation",
            "use": "servo",
            "design": [{"name": "servo", "method": "platform-servo", "crossover_hz": 4, "filter_hz": 50}],
        },
    ],
    "manoeuvre": [
        {"name": "turn", "mode": "caged", "axis": 1, "rate": 0.1, "rise": 0.005, "hold": 0.0, "duration": 0.01},
        {"name": "step", "mode": "stabilised", "axis": 2, "torque": 0.1, "duration": 0.01},
    ],
}


def warm_up(as_json: Json = False, quiet: Quiet = False) -> int:
    """Compile what the other commands need, once an installation.

    Simulation and analysis have functions that are compiled where they are first used, which takes about a minute
    in all, and are kept beside the installed package. This compiles them before anybody waits for it: in an image,
    before CI runs its tests, after an update. What is compiled already is not compiled again.

    \b
    platform-ctrl warm-up
        once an installation
    platform-ctrl warm-up --quiet
        in a Dockerfile: RUN platform-ctrl warm-up --quiet
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    start, found = time.monotonic(), []
    with progress(quiet or as_json, "compiling") as say:
        for name, work in (("simulation", _simulation), ("design, check and serve", _design)):
            say(f"compiling: {name}")
            before = _counts()
            work()
            made, kept = (after - one for after, one in zip(_counts(), before, strict=True))
            found.append({"for": name, "compiled": made, "there": kept})
    if as_json:
        from platform_ctrl.common.json_text import json_text

        typer.echo(json_text({"schema": 1, "compiled": found}))
        return 0
    for one in found:
        typer.echo(f"{one['for']}: {one['compiled']} compiled, {one['there']} there already")
    typer.echo(f"done in {time.monotonic() - start:.0f} s")
    return 0


def _simulation() -> None:
    from platform_ctrl import read_platform, simulation
    from platform_ctrl.simulation.batch import compile_kernel

    compile_kernel()
    simulation.rollout(read_platform("rate_gyro"), q=[[0.0]], velocity=[[0.0] * 4], step=1e-4, steps=1)


def _design() -> None:
    import control
    import numpy as np

    from platform_ctrl.analysis import disk_margin, frequency_response, time_response
    from platform_ctrl.design import loops
    from platform_ctrl.job.reading import read_job
    from platform_ctrl.verification import check_job

    job = read_job(_JOB)
    check_job(job, loops(job))
    # A loop with several channels, its response in time, and one that is almost undamped.
    loop = control.ss(-np.diag([1.0, 2.0]), np.eye(2), [[1.0, 0.2], [0.1, 1.0]], 0)
    disk_margin(loop)
    time_response(loop, np.linspace(0.0, 1.0, 50), np.ones((2, 50)))
    frequency_response(control.ss([[0.0, 1.0], [-1.0, -1e-12]], [[0.0], [1.0]], [[1.0, 0.0]], 0), [1.0])


def _counts() -> tuple[int, int]:
    """Return how many versions of functions have been compiled, and how many were taken from what is kept."""
    found: dict[int, Callable[..., Any]] = {}
    for name, module in list(sys.modules.items()):
        if name.startswith(f"{__package__.partition('.')[0]}."):
            found |= {id(one): one for one in vars(module).values() if hasattr(one, "signatures")}
    stats = [one.stats for one in found.values()]  # type: ignore[attr-defined]
    return sum(sum(one.cache_misses.values()) for one in stats), sum(sum(one.cache_hits.values()) for one in stats)
