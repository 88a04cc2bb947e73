"""One requirement object passes through tuning, a matrix inequality, sampled verification, a test and the report."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import control
import numpy as np
import pytest

from platform_ctrl import design, verification
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import System
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.classical.caging import classical_controller, starting_values
from platform_ctrl.design.fixed_structure.caging import pid_structure
from platform_ctrl.design.fixed_structure.descent import Search, pieces
from platform_ctrl.design.fixed_structure.loops import ClosedLoops
from platform_ctrl.design.fixed_structure.parametrised import Parametrised
from platform_ctrl.design.partition import channels
from platform_ctrl.design.plants import plants_of
from platform_ctrl.job.job import Job
from platform_ctrl.job.reading import read_job
from platform_ctrl.job.requirements import WORST_CASE, loop_requirements, requirement
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.report import tables
from platform_ctrl.report.job_page import page_html
from platform_ctrl.verification.result_file import result_record

EXAMPLE = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
# The object that everything below is given. The slow classical loop of the fixture misses it.
DAMPED = requirement("damping", 0.12, over=WORST_CASE, name="damping, worst case")


@pytest.fixture(scope="module")
def job() -> Job:
    job = read_job(EXAMPLE)
    loop = dataclasses.replace(job.loops[1], limits={"damping_worst_case": DAMPED.limit}, soft={})
    return dataclasses.replace(job, loops=(loop,), manoeuvres=())


@pytest.fixture(scope="module")
def plants(job: Job) -> PlantSet:
    found = plants_of(job, job.loops[0])
    assert found is not None
    return found


@pytest.fixture(scope="module")
def start(job: Job, plants: PlantSet) -> Parametrised:
    """A classical loop with little damping, as a PID with free entries."""
    channel = channels(linearise(job.platform), rows_of(linearise(job.platform), job.loops[0].gimbals))
    options = starting_values({"damping_hz": 20.0, "damping2_hz": 20.0}, channel, plants.nutation, plants.period)
    block = classical_controller(options, channel, plants.period)
    return pid_structure(block, channel, plants.period, plants.nutation, 2 * np.pi * 2.0, 2 * np.pi * 900.0)


@pytest.fixture(scope="module")
def tuned(start: Parametrised, plants: PlantSet) -> System:
    """What the search for the object makes of the start: first use, tuning."""
    found = Search(plants, [DAMPED], 0.02, 200, lambda hard, soft: None).run(start)
    return start.block(found.x)


def test_the_tuner_works_on_its_ratio(start: Parametrised, plants: PlantSet, tuned: System) -> None:
    before = start.block(start.start)
    assert not DAMPED.check(plants, before).passed
    assert pieces(ClosedLoops(plants, before), DAMPED).ratio.max() > 1.0
    assert DAMPED.check(plants, tuned).passed
    assert pieces(ClosedLoops(plants, tuned), DAMPED, 0.0).ratio.max() <= 1.0


def test_sampled_verification_names_the_worst_plant(plants: PlantSet, tuned: System) -> None:
    result = DAMPED.check(plants, tuned)
    worst = min(
        control.StateSpace(*_closed(plants, tuned, k), plants.period).damp()[1][_fast(plants, tuned, k)].min()
        for k in range(len(plants.labels))
    )
    assert result.value == pytest.approx(worst, rel=1e-9)
    assert result.evidence.split(";")[0] in plants.labels or result.evidence.startswith("nominal")


def _closed(plants: PlantSet, K: System, k: int) -> tuple[np.ndarray, ...]:
    A = np.block(
        [[plants.A[k] + plants.B[k] @ K.D @ plants.C[k], plants.B[k] @ K.C], [K.B @ plants.C[k], K.A]]
    )  # D of the sampled plants is zero
    assert not np.any(plants.D)
    return A, np.zeros((len(A), 1)), np.zeros((1, len(A))), np.zeros((1, 1))


def _fast(plants: PlantSet, K: System, k: int) -> np.ndarray:
    """Poles that count: above a tenth of the nutation frequency."""
    return control.StateSpace(*_closed(plants, K, k), plants.period).damp()[0] > plants.nutation / 10.0


def test_the_report_and_the_record_of_a_job_show_it(job: Job, plants: PlantSet) -> None:
    (spec,) = job.loops
    plain = dataclasses.replace(spec.designs[0], tune=False, options={"crossover_hz": 40.0, "rolloff_hz": 850.0})
    spec = dataclasses.replace(spec, designs=(plain,), use=plain.name)
    alone = dataclasses.replace(job, loops=(spec,), coupled=dataclasses.replace(job.coupled, disk_margin=None))
    (asked,) = [one for one in loop_requirements(spec.limits) if one.kind == "damping"]
    assert dataclasses.asdict(asked) == dataclasses.asdict(DAMPED)
    result = verification.check_job(alone, design.loops(alone))
    (found,) = [one for one in result.requirements if one.name == DAMPED.name]
    made = result.loops[0].closed
    again = DAMPED.check(plants, made.controller, subject=made.loop, design=made.name)
    assert dataclasses.asdict(found) == dataclasses.asdict(again)
    assert [row for row in tables.requirement_rows(result) if DAMPED.name in dataclasses.astuple(row)]
    assert DAMPED.name in page_html(result)
    (recorded,) = [one for one in result_record(result)["requirements"] if one["name"] == DAMPED.name]
    assert (recorded["value"], recorded["limit"], recorded["passed"]) == (found.value, DAMPED.limit, found.passed)
