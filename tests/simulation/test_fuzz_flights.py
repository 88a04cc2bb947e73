"""Numbers that nobody meant, flown: a job that is accepted is carried out or refused, and no number of it hurts."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fuzz_files import EVERY_JOB_KEY, EVERY_PLANT_KEY, HERE, Place, at, places, put, written
from fuzz_run import PREFIX, cases, chances, ended

# From next to nothing to more than anything, and what people write.
NUMBERS = [
    0,
    0.3,
    1,
    2,
    3,
    7,
    1000,
    10**12,
    *(10.0**n for n in (-50, -49, -20, -9, -6, -4, -3, 3, 6, 9, 12, 20, 49, 50)),
]
NUMBERS += [-number for number in NUMBERS]
# Longer runs and shorter steps than these that are accepted do what is asked, for as long as that takes.
LONG, SHORT = 10.0, 1e-6


def _numbers(data: object, above: Place = ()) -> list[Place]:
    return [
        p for p in places(data, above) if isinstance(at(data, p), int | float) and not isinstance(at(data, p), bool)
    ]


IN_PLANT = _numbers(EVERY_PLANT_KEY.data)
IN_JOB = [place for place in _numbers(EVERY_JOB_KEY.data) if place[0] not in ("loop", "schema")]


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("flights")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        for name in ("controllers.json", "vehicle.csv"):
            shutil.copy(HERE / name, path)
        yield path


def flown(plant: dict[str, object], job: dict[str, object], which: str, number: str) -> int:
    """Fly a manoeuvre of a job; return the exit code."""
    Path("every_plant_key.toml").write_text(written(plant), encoding="utf-8")
    Path("job.toml").write_text(written(job), encoding="utf-8")
    found = ended("simulate", "job.toml", which, number, "--controllers", "controllers.json", "-o", "out", "--json")
    if found.code == 2:
        return 2
    assert found.err == "" if found.out else found.err.startswith(PREFIX)
    if found.out:
        record = json.loads(found.out)
        assert found.code == (0 if record["passed"] else 1)
        assert record["passed"] <= (record["ended"] == "completed")
    return found.code


@pytest.fixture(scope="module", autouse=True)
def undrawn() -> Iterator[None]:
    """Leave out the figures, which are the same curves whatever the file was."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("platform_ctrl.report.plots.time_run.write_run_figure", lambda *anything: None)
        yield


def test_the_job_to_begin_with_flies() -> None:
    for number in ("1", "2"):
        assert flown(EVERY_PLANT_KEY.data, EVERY_JOB_KEY.data, "--manoeuvre", number) == 0


@cases(350)
@given(st.sampled_from(IN_PLANT), st.sampled_from(NUMBERS), st.sampled_from(["1", "2"]))
def test_a_plant_with_any_number_flies_or_is_refused(place: Place, number: float, manoeuvre: str) -> None:
    flown(put(EVERY_PLANT_KEY.data, place, number), EVERY_JOB_KEY.data, "--manoeuvre", manoeuvre)


@cases(250)
@given(st.sampled_from(IN_JOB), st.sampled_from(NUMBERS), st.sampled_from(["1", "2"]))
@example(("manoeuvre", 0, "rate"), 1e12, "1")
def test_a_job_with_any_number_flies_or_is_refused(place: Place, number: float, manoeuvre: str) -> None:
    job = put(EVERY_JOB_KEY.data, place, number)
    if place[-1] == "duration" and LONG < number <= 5000.0:
        return
    flown(EVERY_PLANT_KEY.data, job, "--manoeuvre", manoeuvre)


@cases(100)
@given(chances)
def test_many_numbers_at_once(how: random.Random) -> None:
    plant, job = EVERY_PLANT_KEY.data, EVERY_JOB_KEY.data
    for _ in range(how.randrange(1, 6)):
        plant = put(plant, how.choice(IN_PLANT), how.choice((0.5, 2.0, 1e-3, 1e3, 1e9, 1e-9)))
        place = how.choice([place for place in IN_JOB if place[-1] != "duration" and place[0] != "sampling"])
        job = put(job, place, how.choice((0.5, 2, 1e-3, 1e3)))
    flown(plant, job, "--manoeuvre", how.choice("12"))


@cases(150)
@given(st.sampled_from([place for place in IN_JOB if place[0] == "campaign"]), st.sampled_from(NUMBERS))
@example(("campaign", "step"), 1e9)
@example(("campaign", "vary", 1, "deviation"), 1e9)
def test_a_campaign_with_any_number_has_a_first_run_or_is_refused(place: Place, number: float) -> None:
    if place[-1] == "step" and 1e-11 <= number < SHORT:
        return
    flown(EVERY_PLANT_KEY.data, put(EVERY_JOB_KEY.data, place, number), "--run", "0")
