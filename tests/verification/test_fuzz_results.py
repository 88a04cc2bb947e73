"""Controller files that nobody meant: refused in one line that names the place, or read as what they say."""

from __future__ import annotations

import copy
import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fuzz_bytes import mangled
from fuzz_files import HERE, NEVER_RIGHT, SOMETIMES_RIGHT, Place, at, key_of, places, put
from fuzz_run import cases, chances, ended

TEXT = (HERE / "controllers.json").read_text(encoding="utf-8")
DATA: dict[str, Any] = json.loads(TEXT)
PLACES = list(places(DATA))
JSON_VALUES = [item for item in NEVER_RIGHT + SOMETIMES_RIGHT if not hasattr(item, "isoformat")]
# What a controller may be called, and what is said of it, may be any text.
FREE = ("name", "design")


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        for name in ("every_plant_key.toml", "every_job_key.toml", "vehicle.csv"):
            shutil.copy(HERE / name, path)
        yield path


def read(controllers: str | bytes) -> tuple[bool, str]:
    """Return whether controllers are accepted, and what is said if not: the folder asked for afterwards is a file."""
    Path("k.json").write_bytes(controllers if isinstance(controllers, bytes) else controllers.encode())
    given = ["--controllers", "k.json", "-o", "every_job_key.toml"]
    error = ended("check", "every_job_key.toml", *given, "-q", folder=Path()).error
    accepted = error.startswith("-o every_job_key.toml: is no folder")
    assert accepted or error.startswith(("k.json: ", "controllers: ", "controller "))
    return accepted, error


def test_the_controllers_to_begin_with_are_read() -> None:
    assert read(TEXT)[0]


@cases(200)
@given(chances)
def test_mangled_bytes_are_refused_or_read(how: random.Random) -> None:
    mutant = mangled(TEXT.encode(), how)
    accepted, error = read(mutant)
    try:
        json.loads(mutant.decode("utf-8-sig"))
    except UnicodeDecodeError:
        assert "is not UTF-8 text" in error
    except (ValueError, RecursionError):
        assert not accepted
        assert "JSON" in error or "cannot be read" in error


@cases(350)
@given(st.sampled_from(PLACES), st.sampled_from(JSON_VALUES))
@example(("controllers", 0, "A", 0, 0), 1e308)
def test_any_value_is_read_or_refused_by_its_name(place: Place, item: object) -> None:
    accepted, error = read(json.dumps(put(DATA, place, item)))
    before = at(DATA, place)
    if type(item) is not type(before) and not (
        isinstance(item, int | float) and not isinstance(item, bool) and isinstance(before, int | float)
    ):
        assert accepted is (place[-1] == "design")
        assert accepted or key_of(place) in error


@cases(50)
@given(st.sampled_from([place for place in PLACES if isinstance(place[-1], str)]))
def test_every_key_but_the_designs_name_is_needed(place: Place) -> None:
    data = copy.deepcopy(DATA)
    del at(data, place[:-1])[place[-1]]
    accepted, error = read(json.dumps(data))
    assert accepted is (place[-1] == "design")
    assert accepted or ("is missing" in error and str(place[-1]) in error)
