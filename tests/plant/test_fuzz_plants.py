"""Plant files that nobody meant: refused in one line that names the place, or read as what they say."""

from __future__ import annotations

import random
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzz_bytes import mangled
from fuzz_files import (
    MISHAPS,
    NEVER_RIGHT,
    PLANTS,
    SOMETIMES_RIGHT,
    Place,
    Seed,
    key_of,
    meaning,
    places,
    put,
    written,
)
from fuzz_rules import judged_as_the_page_says, known_and_needed, rules
from fuzz_run import cases, chances, ended
from platform_ctrl import read_platform

# A job whose last line is wrong: a plant that is refused is told first, one that is accepted leaves that line to blame.
JOB = """
schema = 2
name = "a job"
plant = "plant.toml"
operation = { Omega = [1.0, 1.0, 1.0] }
loop = [{ name = "loop", kind = "stabilisation", use = "x", design = [{ name = "x", method = "platform-servo" }] }]
sampling = { delay = 0.0, rate_hz = 0 }
"""
RULES = rules("plant-file.md")
MEANT = {plant.name: meaning(read_platform(plant.data)) for plant in PLANTS}
PLACES = [(plant, place) for plant in PLANTS for place in places(plant.data)]
KEYS = [(plant, place) for plant, place in PLACES if isinstance(place[-1], str)]


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("plants")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        (path / "job.toml").write_text(JOB, encoding="utf-8")
        yield path


def read(plant: str | bytes) -> tuple[bool, str]:
    """Return whether a plant is accepted, and what the command says if it is not."""
    path = Path("plant.toml")
    path.write_bytes(plant if isinstance(plant, bytes) else plant.encode())
    error = ended("check", "job.toml", "-q", folder=Path()).error
    if error.startswith("job.toml: plant: plant.toml: "):
        return False, error
    return True, error


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_a_plant_that_is_right_is_read(plant: Seed) -> None:
    assert read(plant.text)[0]
    assert read(written(plant.data))[0]


@cases(860)
@given(st.sampled_from(PLANTS), chances)
def test_mangled_bytes_are_refused_or_read(plant: Seed, how: random.Random) -> None:
    mutant = mangled(plant.text.encode(), how)
    accepted, error = read(mutant)
    try:
        means = tomllib.loads(mutant.decode("utf-8-sig"))
    except UnicodeDecodeError:
        assert "is not UTF-8 text" in error
    except (ValueError, RecursionError):
        assert "is not TOML" in error
    else:
        assert accepted or means != plant.data or "hundreds of parts" in error


@cases(860)
@given(st.sampled_from(PLACES), st.sampled_from(NEVER_RIGHT))
def test_what_no_key_takes_is_refused_by_its_name(where: tuple[Seed, Place], item: object) -> None:
    plant, place = where
    accepted, error = read(written(put(plant.data, place, item)))
    if key_of(place) == "source" and isinstance(item, str):
        assert accepted
    elif item == [None]:
        assert "is not TOML" in error
    else:
        assert not accepted
        assert key_of(place) in error


@cases(860)
@given(st.sampled_from(PLACES), st.sampled_from(SOMETIMES_RIGHT))
def test_a_value_is_judged_as_the_page_says(where: tuple[Seed, Place], item: object) -> None:
    judged_as_the_page_says(read, RULES, *where, item)


@cases(520)
@given(st.sampled_from(KEYS), st.sampled_from(MISHAPS))
def test_keys_are_known_and_needed(where: tuple[Seed, Place], mishap: str) -> None:
    known_and_needed(read, RULES, *where, mishap)


@cases(340)
@given(st.sampled_from(PLANTS), chances)
def test_the_same_in_other_words_is_the_same_plant(plant: Seed, how: random.Random) -> None:
    text = written(plant.data, how)
    text = how.choice(["", "\ufeff"]) + (text.replace("\n", "\r\n") if how.random() < 0.3 else text)
    assert read(text)[0]
    assert meaning(read_platform(Path("plant.toml").absolute())) == MEANT[plant.name]
