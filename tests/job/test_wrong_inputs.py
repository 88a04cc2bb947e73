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
from every_key import HERE, every_job_key, every_plant_key
from job.test_reading_campaign import flown_job
from job.test_reading_job import job, small_job
from mechanics import test_compliance as compliances
from mechanics import test_modes_of_structure as modes
from mechanics import test_motor_winding as windings
from plant.test_reading_elements import MASSES, PLANT
from plant.test_reading_plant import enter, plant, refusal, toml_file
from platform_ctrl import read_job, read_platform
from simulation import test_motor as motors
from simulation.test_gimbal_torques import wind_job
from verification.test_multirate import tracking_job
from verification.test_offset_gimbal import offset_job
from verification.test_wrong_verdicts import settled_job, unexercised_job

# What the sections of the tables change, by the name of the file and the section.
BASES: dict[tuple[str, str], Callable[[], dict[str, Any]]] = {
    ("plants", "plant"): plant,
    ("plants", "elements"): lambda: copy.deepcopy(PLANT),
    ("plants", "masses"): lambda: copy.deepcopy(MASSES),
    ("plants", "modes"): lambda: json.loads(json.dumps(modes.drive())),
    ("plants", "windings"): lambda: copy.deepcopy(windings.drive()),
    ("plants", "compliances"): compliances.drive,
    ("plants", "motors"): motors.plant,
    ("plants", "every_key"): every_plant_key,
    ("jobs", "job"): job,
    ("jobs", "small_job"): small_job,
    ("jobs", "flown_job"): flown_job,
    ("jobs", "commanded"): lambda: commanded_job([{"reading": "gyro", "step": 0.1}]),
    ("jobs", "driven"): lambda: driven_job(FRICTION),
    ("jobs", "budget"): every_job_key,
    ("jobs", "offsets"): lambda: offset_job("floating"),
    ("jobs", "wind"): lambda: copy.deepcopy(wind_job()),
    ("jobs", "unexercised"): unexercised_job,
    ("jobs", "unmissable"): settled_job,
    ("jobs", "tracking"): tracking_job,
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
    assert tried > 2
