"""Runs that take the place of the simulated ones: quick, and with mishaps where a test wants them.

Worker processes import this module, so that a test can choose what they do; an environment variable holds mishaps.
"""

from __future__ import annotations

import json
import os
import time
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from one_gyro_job import JOB as ONE_LOOP
from platform_ctrl import read_job
from platform_ctrl.campaign import plan
from platform_ctrl.campaign.engine import CampaignResult
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.campaign.single_run import inputs_of
from platform_ctrl.errors import SimulationError

MANOEUVRES = """
[[manoeuvre]]
name = "turn"
mode = "caged"
axis = 1
rate = 0.2
rise = 0.01
hold = 0.0
duration = 0.02
limits = { angle = 0.003, torque_share = 1.0 }

[[manoeuvre]]
name = "step"
mode = "stabilised"
axis = 2
torque = 0.1
duration = 0.02
limits = { angle = 0.0005 }
"""
TEXT = (
    ONE_LOOP.replace('name = "gyro 9-10"', 'name = "a turn, many times"').replace("0.0] }", "0.0], seed = 7 }")
    + MANOEUVRES
    + """
[campaign]
runs = 100

[[campaign.vary]]
parameter = "rotor.11.spin"
distribution = "normal"
mean = 1.0
deviation = 0.01
relative = true

[[campaign.vary]]
parameter = "sampling.delay"
distribution = "uniform"
low = 3e-4
high = 5e-4
"""
)
JOB: dict[str, Any] = tomllib.loads(TEXT)


def planned(**options: Any) -> Plan:
    """The plan of `JOB` without a controller."""
    return plan(read_job(JOB), (), **options)


def invented_columns(plan: Plan, runs: Sequence[int], *, mishaps: dict[str, Any] | None = None) -> dict[str, Any]:
    """Figures made up out of the inputs; `mishaps`, or those of the environment's CAMPAIGN_MISHAPS, happen first."""
    mishaps = json.loads(os.environ.get("CAMPAIGN_MISHAPS", "{}")) if mishaps is None else mishaps
    time.sleep(mishaps.get("seconds", 0.0) * len(runs))
    if set(runs) & set(mishaps.get("dies", ())):
        os._exit(9)
    once = Path(mishaps.get("dies_once", {}).get("marker", os.devnull))
    if mishaps.get("dies_once", {}).get("run") in runs and not once.exists():
        once.touch()
        os._exit(9)
    if set(runs) & set(mishaps.get("raises", ())):
        raise SimulationError("the sensors\nare not there")
    if mishaps.get("log"):
        with open(mishaps["log"], "a") as log:
            log.write("".join(f"{run} {os.getpid()}\n" for run in runs))
    columns = inputs_of(plan, runs)
    numbers = columns["run"]
    angle = columns["rotor.11.spin"] * np.sin(1.0 + numbers)
    diverged = np.isin(numbers, mishaps.get("diverges", ()))
    angle[diverged] = np.inf
    turned = columns["manoeuvre"] == "turn"
    passed = angle <= 0.9
    return columns | {
        "angle": angle,
        "attitude": np.where(diverged, np.inf, 0.0),
        "torque_share": np.where(diverged, np.inf, 1e3 * columns["sampling.delay"]),
        "stop_contacts": numbers % 3,
        "saturated": (numbers % 7) / 7.0,
        "angle_passed": passed.astype(object),
        "attitude_passed": np.full(len(numbers), None),
        "torque_share_passed": np.where(turned, True, None),
        "passed": passed,
        "ended": np.where(diverged, "diverged at t = 0.01 s", "completed").astype(object),
    }


@contextmanager
def processes_here(workers: int) -> Iterator[tuple[Executor, int, tuple[type[BaseException], ...]]]:
    """Simulate in this process, where nothing is said about processes: in place of `processes`."""
    with ThreadPoolExecutor(1) as executor:
        yield executor, 1, (BrokenExecutor,)


def undisturbed(plan: Plan) -> list[dict[str, Any]]:
    """All runs simulated here at once: the rows of a campaign in which nothing goes wrong."""
    columns = {name: column.tolist() for name, column in invented_columns(plan, range(plan.runs)).items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*(columns[name] for name in columns), strict=True)]


def rows(found: CampaignResult) -> list[dict[str, Any]]:
    """The rows of a campaign's table."""
    import pyarrow.parquet

    listed: list[dict[str, Any]] = pyarrow.parquet.read_table(found.table).to_pylist()
    return listed
