"""Job files: what is read, and that every mistake is one line that names its place."""

from __future__ import annotations

import dataclasses
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from every_key import HERE, every_job_key
from plant.test_reading_plant import plant, refusal, toml_file
from platform_ctrl import read_job, read_platform
from platform_ctrl.common.files import toml
from platform_ctrl.common.values import replaced
from platform_ctrl.design.methods import METHODS
from platform_ctrl.errors import InputError
from platform_ctrl.job.reading import job_data
from platform_ctrl.job.requirements import limit_keys
from platform_ctrl.plant.platform import plant_data


def job() -> dict[str, Any]:
    """Return a small valid job on a shipped plant."""
    return {
        "schema": 2,
        "name": "two loops",
        "plant": "three_gyro_platform",
        "operation": {"Omega": [1.0, 0.5, 0], "seed": 7},
        "uncertainty": {"inertia": 0.1, "spin": 0.2},
        "sampling": {"rate_hz": 2000, "delay": 0.0005},
        "loop": [
            {
                "name": "caging",
                "kind": "caging",
                "gimbals": ["9", "10"],
                "use": "hand",
                "limits": {"bandwidth_hz": 40, "damping": 0.1},
                "design": [
                    {"name": "hand", "method": "classical", "tune": True, "crossover_hz": 40, "notch_depth": 0.5},
                    {"name": "machine", "method": "hinf", "bandwidth_hz": 40},
                ],
            },
            {
                "name": "servo",
                "kind": "stabilisation",
                "use": "servo",
                "design": [{"name": "servo", "method": "platform-servo", "crossover_hz": 5}],
            },
        ],
        "coupled": {"disk_margin": 0.5},
        "manoeuvre": [
            {
                "name": "turn",
                "mode": "caged",
                "axis": 1,
                "rate": -1.0,
                "rise": 0.5,
                "hold": 1,
                "duration": 2,
                "limits": {"angle": 0.003},
            },
            {"name": "push", "mode": "stabilised", "axis": 3, "torque": 0.1, "duration": 1, "limits": {"attitude": 1}},
        ],
    }


def small_job() -> dict[str, Any]:
    """Return a valid job whose plant stands in the job itself; it has one root torquer only."""
    return job() | {
        "plant": plant(),
        "loop": [dict(job()["loop"][0], gimbals=["4", "5"])],
        "manoeuvre": [],
    }


def test_the_first_mistake_in_the_files_order_is_named_wherever_it_was_found() -> None:
    data = job()
    data["sampling"]["delay"] = -1
    data["loop"][0]["design"][0]["method"] = "clasical"
    data["manoeuvre"][0]["axis"] = 0
    assert "delay must be a number >= 0, got -1" in refusal(read_job, data)
    assert refusal(read_job, data).endswith(
        ' (and 2 more: [[loop]] 1 "caging": [[loop.design]] 1 "hand": method, [[manoeuvre]] 1 "turn": axis)'
    )
    assert "axis must be 1, 2 or 3, got 0" in refusal(read_job, dict(reversed(data.items())))


def test_a_mistake_in_a_plant_file_names_both_files(tmp_path: Path) -> None:
    broken = plant()
    broken["gimbal"][0]["axis"] = [0, 0, 0]
    (tmp_path / "mine.toml").write_text(toml_file(broken), encoding="utf-8")
    (tmp_path / "job.toml").write_text(toml_file(job() | {"plant": "mine.toml"}), encoding="utf-8")
    message = refusal(read_job, tmp_path / "job.toml")
    assert message.startswith(f"{tmp_path / 'job.toml'}: plant: {tmp_path / 'mine.toml'}: [[gimbal]] 1")


@pytest.mark.parametrize("source", [None, b"job.toml", ""])
def test_a_source_that_is_no_source_is_one_line(source: object) -> None:
    assert "the argument must be the path of a job file or a dict, got " in refusal(read_job, source)


def test_a_job_that_cannot_be_opened_is_one_line(tmp_path: Path) -> None:
    assert refusal(read_job, tmp_path / "nowhere.toml").endswith(
        "nowhere.toml: there is no such file; give a TOML file (platform-ctrl new writes one)"
    )
    assert "nowhere: there is no such file" in refusal(read_job, str(tmp_path / "nowhere"))
    (tmp_path / "broken.toml").write_text("loop = [", encoding="utf-8")
    assert "is not TOML" in refusal(read_job, tmp_path / "broken.toml")


def test_every_limit_can_be_a_goal() -> None:
    # Those of the line of sight belong to rate and pointing loops, and to jobs with a budget.
    sight = ("attenuation", "jitter", "windowed_jitter", "smear", "contrast")
    names = [key for key in limit_keys() if not key.startswith(sight)]
    data = job() | {"faults": {"slow_rotor": 0.5}}
    # A band begins below where it ends.
    limits, soft = ({key: x / 2 if "_from_" in key else x for key in names} for x in (0.5, 0.25))
    data["loop"][0]["limits"], data["loop"][0]["soft"] = limits, soft
    loop = read_job(data).loops[0]
    assert (loop.limits, loop.soft) == (limits, soft)


def text_of(item: object) -> str:
    """Return all that a value holds, numbers to the last bit."""
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return repr(item)


def test_every_key_of_a_job_file_and_its_plant_is_written() -> None:
    """To the last bit, defaults included; the plant's name, and logs, which become spectra, aside."""
    read = read_job(every_job_key(), folder=HERE)
    again = read_job(tomllib.loads(toml(job_data(read))))
    bare = {"plant": "", "budget": None}
    assert text_of(replaced(again, bare)) == text_of(replaced(read, bare))


def test_a_platform_in_a_job_is_judged_as_its_file_is() -> None:
    platform = dataclasses.replace(read_platform("three_gyro_platform"), name="mine")
    for given in (platform, tomllib.loads(platform.to_toml())):
        found = read_job(job() | {"plant": given})
        assert (found.plant, text_of(found.platform)) == ("mine", text_of(platform))
    gimbals = (dataclasses.replace(platform.gimbals[0], parent="nowhere"), *platform.gimbals[1:])
    with pytest.raises(InputError, match=r'\[\[plant.gimbal\]\] 1 "4": parent must be .*, got "nowhere"'):
        read_job(job() | {"plant": dataclasses.replace(platform, gimbals=gimbals)})


def test_names_that_are_no_bare_keys_stand_in_quotes() -> None:
    data = small_job()
    data["plant"]["gimbal"][0]["angle"] = name = 'alpha of "4" (\u00b0)'
    data["operation"]["angles"] = {name: [0.1, 0.2]}
    found = read_job(data)
    again = read_job(tomllib.loads(toml(job_data(found))))
    assert job_data(again) == job_data(found)
    assert again.angles == {name: (0.1, 0.2)}


def test_a_gimbal_in_the_place_of_its_angle_is_told_the_angle() -> None:
    data = small_job()
    gimbal = data["plant"]["gimbal"][0]
    gimbal["angle"] = "theta"
    data["operation"]["angles"] = {gimbal["name"]: [0.1]}
    assert refusal(read_job, data).endswith(f'that of gimbal "{gimbal["name"]}" is "theta"')


def test_a_plant_is_found_beside_the_job_or_in_the_folder_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = small_job() | {"plant": "plants/mine.toml"}
    (tmp_path / "plants").mkdir()
    (tmp_path / "plants" / "mine.toml").write_text(toml_file(plant()), encoding="utf-8")
    (tmp_path / "job.toml").write_text(toml_file(data), encoding="utf-8")
    assert read_job(tmp_path / "job.toml").platform.name == "two gimbals"
    assert read_job(data, folder=tmp_path).platform.name == "two gimbals"
    assert read_job(dict(data, plant=str(tmp_path / "plants" / "mine.toml"))).platform.name == "two gimbals"
    assert "no such file" in refusal(read_job, data)
    misspelt = refusal(read_job, dict(data, plant=str(tmp_path / "plants" / "mnie.toml")))
    assert misspelt.endswith('mnie.toml: there is no such file; did you mean "mine.toml"?')
    monkeypatch.chdir(tmp_path)
    assert read_job(data).plant == "plants/mine.toml"


@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_listed_option_is_read(method: str) -> None:
    data = job()
    loop = data["loop"]["stabilisation" in METHODS[method].kinds]
    if method == "pi":
        loop |= {"kind": "rate", "gimbals": ["9"], "sensors": ["gyro"], "limits": {}}
        gyro = {"name": "gyro", "body": "9", "axis": [0, 0, 1]}
        data["plant"] = plant_data(read_platform("three_gyro_platform")) | {"rate_sensor": [gyro]}
    loop["design"] = [{"name": "all", "method": method} | dict.fromkeys(METHODS[method].options, 0.5)]
    loop["use"] = "all"
    (design,) = next(spec for spec in read_job(data).loops if spec.name == loop["name"]).designs
    assert design.options == dict.fromkeys(METHODS[method].options, 0.5)
