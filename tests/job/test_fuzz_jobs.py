"""Job files that nobody meant: refused in one line that names the place, or read as what they say."""

from __future__ import annotations

import random
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzz_bytes import mangled
from fuzz_files import (
    EVERY_JOB_KEY,
    EVERY_PLANT_KEY,
    HERE,
    JOBS,
    MISHAPS,
    NEVER_RIGHT,
    SOMETIMES_RIGHT,
    Place,
    Seed,
    key_of,
    meaning,
    places,
    put,
    written,
)
from fuzz_rules import judged_as_the_page_says, known_and_needed, rule_at, rules
from fuzz_run import cases, chances, ended
from platform_ctrl import read_job

RULES = rules("job-file.md")
MEANT = {job.name: meaning(read_job(job.data, folder=HERE)) for job in JOBS}
PLACES = [(job, place) for job in JOBS for place in places(job.data)]
KEYS = [(job, place) for job, place in PLACES if isinstance(place[-1], str) and rule_at(RULES, place) is not None]


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("jobs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        (path / "every_plant_key.toml").write_text(EVERY_PLANT_KEY.text, encoding="utf-8")
        shutil.copy(HERE / "vehicle.csv", path)
        yield path


def read(job: str | bytes) -> tuple[bool, str]:
    """Return whether a job is accepted, and what the command says if it is not: what it asks for next is not there."""
    Path("job.toml").write_bytes(job if isinstance(job, bytes) else job.encode())
    error = ended("check", "job.toml", "--controllers", "none.json", "-q", folder=Path()).error
    accepted = error == "none.json: there is no such file"
    assert accepted or error.startswith("job.toml: ")
    return accepted, error


@pytest.mark.parametrize("job", JOBS, ids=lambda job: job.name)
def test_a_job_that_is_right_is_read(job: Seed) -> None:
    assert read(job.text)[0]
    assert read(written(job.data))[0]


def test_the_files_to_begin_with_have_every_key() -> None:
    for page, seed in (("plant-file.md", EVERY_PLANT_KEY), ("job-file.md", EVERY_JOB_KEY)):
        there = {tuple(step for step in place if isinstance(step, str)) for place in places(seed.data)}
        assert [path for path in rules(page) if path not in there and path[:2] != ("loop", "soft")] == []


@cases(860)
@given(st.sampled_from(JOBS), chances)
def test_mangled_bytes_are_refused_or_read(job: Seed, how: random.Random) -> None:
    mutant = mangled(job.text.encode(), how)
    accepted, error = read(mutant)
    try:
        means = tomllib.loads(mutant.decode("utf-8-sig"))
    except UnicodeDecodeError:
        assert "is not UTF-8 text" in error
    except (ValueError, RecursionError):
        assert "is not TOML" in error
    else:
        assert accepted or means != job.data or "hundreds of parts" in error


@cases(860)
@given(st.sampled_from(PLACES), st.sampled_from(NEVER_RIGHT))
def test_what_no_key_takes_is_refused_by_its_name(where: tuple[Seed, Place], item: object) -> None:
    job, place = where
    accepted, error = read(written(put(job.data, place, item)))
    assert not accepted
    assert "is not TOML" in error if item == [None] else key_of(place) in error


@cases(860)
@given(st.sampled_from(PLACES), st.sampled_from(SOMETIMES_RIGHT))
def test_a_value_is_judged_as_the_page_says(where: tuple[Seed, Place], item: object) -> None:
    judged_as_the_page_says(read, RULES, *where, item)


@cases(520)
@given(st.sampled_from(KEYS), st.sampled_from(MISHAPS))
def test_keys_are_known_and_needed(where: tuple[Seed, Place], mishap: str) -> None:
    known_and_needed(read, RULES, *where, mishap)


@cases(340)
@given(st.sampled_from(JOBS), chances)
def test_the_same_in_other_words_is_the_same_job(job: Seed, how: random.Random) -> None:
    text = written(job.data, how)
    text = how.choice(["", "\ufeff"]) + (text.replace("\n", "\r\n") if how.random() < 0.3 else text)
    assert read(text)[0]
    assert meaning(read_job("job.toml")) == MEANT[job.name]
