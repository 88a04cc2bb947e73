"""Tables of wrong inputs: each is refused by one line that names place and cure, alike from a dict and from a file."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from commanded_gimbal import commanded_job
from driven_gimbal import FRICTION, driven_job
from every_key import HERE, every_job_key
from job.test_reading_campaign import flown_job
from job.test_reading_job import job, small_job
from plant.test_reading_elements import MASSES, PLANT
from plant.test_reading_plant import enter, plant, refusal, toml_file
from platform_ctrl import read_job, read_platform
from verification.test_offset_gimbal import offset_job

# What the sections of the tables change, by the name of the file and the section.
BASES: dict[tuple[str, str], Callable[[], dict[str, Any]]] = {
    ("plants", "plant"): plant,
    ("plants", "elements"): lambda: copy.deepcopy(PLANT),
    ("plants", "masses"): lambda: copy.deepcopy(MASSES),
    ("jobs", "job"): job,
    ("jobs", "small_job"): small_job,
    ("jobs", "flown_job"): flown_job,
    ("jobs", "commanded"): lambda: commanded_job([{"reading": "gyro", "step": 0.1}]),
    ("jobs", "driven"): lambda: driven_job(FRICTION),
    ("jobs", "budget"): every_job_key,
    ("jobs", "offsets"): lambda: offset_job("floating"),
}


def cases(kind: str, section: str) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Yield a section of a table: the changes by the paths of keys, and what the line contains, in this order."""
    file = Path(__file__).parents[1] / "data" / "wrong" / f"{kind}.txt"
    text = file.read_text(encoding="utf-8").partition(f"\n[{section}]\n")[2].partition("\n\n[")[0]
    for line in text.splitlines():
        changes, _, words = line.partition("  =>  ")
        yield json.loads(changes), words.split(" … ")


def changed(data: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    for path, value in changes.items():
        *steps, last = [int(step) if step.isdecimal() else step for step in path.split("/")]
        table = enter(data, tuple(steps))
        if last == len(table) and isinstance(table, list):
            table.append(value)
        elif value is None:
            del table[last]
        else:
            table[last] = value
    return data


@pytest.mark.parametrize(("kind", "section"), BASES)
def test_what_is_wrong_is_one_line_that_names_its_place(kind: str, section: str, tmp_path: Path) -> None:
    folder = HERE if section == "budget" else None
    read: Callable[[Any], object] = partial(read_job, folder=folder) if kind == "jobs" else read_platform
    label, file, tried = f"{kind[:-1]} given as a dict", tmp_path / "wrong.toml", 0
    for changes, words in cases(kind, section):
        data = changed(BASES[kind, section](), changes)
        file.write_text(toml_file(data), encoding="utf-8")
        line = refusal(read, data)
        assert refusal(read, file).replace(f"{tmp_path}{os.sep}", "") == line.replace(label, "wrong.toml"), changes
        assert "more)" not in line, changes
        for word in words:
            assert word in line, (changes, line)
            line = line[line.index(word) :]
        tried += 1
    assert tried > 3
