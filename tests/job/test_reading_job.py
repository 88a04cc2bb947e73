"""Job files: what is read, and that every mistake is one line that names its place."""

from __future__ import annotations

import copy
import dataclasses
import math
import pickle
import random
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from every_key import HERE, every_job_key
from plant.test_reading_plant import JUNK, Change, add, both, drop, mutate, outcome, plant, put, refusal, toml_file
from platform_ctrl.common.values import replaced
from platform_ctrl.errors import InputError
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.reading import read_job
from platform_ctrl.job.requirements import limit_keys
from platform_ctrl.job.writing import job_data
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import shipped_models
from platform_ctrl.plant.writing import plant_data, toml

EXAMPLE = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"


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


CAGING = '[[loop]] 1 "caging"'
HAND = f'{CAGING}: [[loop.design]] 1 "hand"'
SERVO = '[[loop]] 2 "servo"'
TURN = '[[manoeuvre]] 1 "turn"'
PUSH = '[[manoeuvre]] 2 "push"'

MISTAKES: dict[str, tuple[Change, list[str]]] = {
    "schema missing": (drop("schema"), ['the key "schema" is missing']),
    "schema 3": (put(3, "schema"), ["schema must be 2", "got 3"]),
    "name empty": (put("", "name"), ['name must be a line of text that is not empty, got "" (empty)', "empty"]),
    "unknown table": (put([{}], "manouvre"), ['unknown table "manouvre"', 'did you mean "manoeuvre"?']),
    "plant missing": (drop("plant"), ['the key "plant" is missing', "a shipped model, a path relative to this file"]),
    "plant a number": (put(3, "plant"), ["plant must be", "got 3", "a shipped model, a path relative to this file"]),
    "plant empty": (
        put("", "plant"),
        ["plant must be the name of a shipped model, a path relative to this file, or a table, got", "empty"],
    ),
    "plant unknown": (put("three_gyro", "plant"), ["plant: ", 'no shipped model "three_gyro"', "did you mean"]),
    "plant nowhere": (put("plants/nowhere.toml", "plant"), ["plant: ", "nowhere.toml: there is no such file"]),
    "operation missing": (drop("operation"), ["the table [operation] is missing"]),
    "Omega missing": (drop("operation", "Omega"), ["[operation]", 'the key "Omega" is missing', "three numbers >= 0"]),
    "Omega a number": (
        put(1.0, "operation", "Omega"),
        ["[operation]", "Omega must be", "got 1.0", "three numbers >= 0"],
    ),
    "Omega negative": (
        put([1, -1, 1], "operation", "Omega"),
        ["Omega must be", "got [1, -1, 1]", "three numbers >= 0"],
    ),
    "Omega not finite": (put([1, math.nan, 1], "operation", "Omega"), ["element 2, nan, is not finite"]),
    "Omega in small letters": (
        both(drop("operation", "Omega"), put([1, 1, 1], "operation", "omega")),
        ['unknown key "omega"', 'did you mean "Omega"?'],
    ),
    "seed negative": (put(-1, "operation", "seed"), ["seed must be", "got -1", "a whole number >= 0"]),
    "seed a fraction": (put(0.5, "operation", "seed"), ["seed must be", "got 0.5", "a whole number >= 0"]),
    "uncertainty too large": (
        put(0.95, "uncertainty", "spin"),
        ["[uncertainty]", "spin must be", "got 0.95", "from 0 to 0.9"],
    ),
    "uncertainty negative": (
        put(-0.1, "uncertainty", "inertia"),
        ["[uncertainty]", "inertia must be", "got -0.1", "from 0 to 0.9"],
    ),
    "a fraction of a sample": (
        put(2.5, "uncertainty", "samples"),
        ["[uncertainty]", "samples must be", "got 2.5", "from 0 to 1000"],
    ),
    "samples of nothing": (
        put({"samples": 4}, "uncertainty"),
        ["[uncertainty]", "samples = 4 has no effect without inertia or spin > 0", "inertia or spin > 0"],
    ),
    "a grid of one point": (
        put(1, "operation", "Omega_grid"),
        ["Omega_grid must be", "Omega_grid must be a whole number from 2 to 9, got 1", "a whole number from 2 to 9"],
    ),
    "a rotor that is too fast": (
        put({"slow_rotor": 1.5}, "faults"),
        ["[faults]", "slow_rotor must be", "got 1.5", "from 0 to 1"],
    ),
    "a torquer without torque": (
        put({"weak_torquer": 0}, "faults"),
        ["[faults]", "weak_torquer must be", "got 0", "a share > 0"],
    ),
    "fault unknown": (put({"slow_rotors": 1}, "faults"), ['unknown key "slow_rotors"', 'did you mean "slow_rotor"?']),
    "rate zero": (put(0, "sampling", "rate_hz"), ["[sampling]", "rate_hz must be", "got 0", "a number > 0"]),
    "rate without a period": (put(1e-310, "sampling", "rate_hz"), ["rate_hz must be", "got 1e-310", "a number > 0"]),
    "delay negative": (
        put(-1e-4, "sampling", "delay"),
        ["[sampling]", "delay must be", "got -0.0001", "a number >= 0"],
    ),
    "delay of a thousand periods": (
        put({"rate_hz": 1e6, "delay": 1e-3}, "sampling"),
        [
            "[sampling]",
            "delay must be at most 100 sample periods, got 0.001 s, 1000 of them; give a shorter delay, in s: ",
            "0.001 ms is 1e-06",
        ],
    ),
    "delay missing": (drop("sampling", "delay"), ["[sampling]", 'the key "delay" is missing']),
    "no loop": (put([], "loop"), ["loop must have at least one [[loop]], got []", "at least one [[loop]]"]),
    "loop missing": (drop("loop"), ["the table [[loop]] is missing"]),
    "loop a table": (
        put({"name": "x"}, "loop"),
        ["loop must be an array of tables, each headed [[loop]], got a table", "[[loop]]"],
    ),
    "loop twice": (put("caging", "loop", 1, "name"), ['[[loop]] 2 "caging"', "is the name of [[loop]] 1 already"]),
    "kind unknown": (
        put("cage", "loop", 0, "kind"),
        [
            CAGING,
            'kind must be "caging" or "rate" or "pointing" or "tracking" or "stabilisation", got "cage"',
            '"tracking" or "stabilisation"',
        ],
    ),
    "use missing": (drop("loop", 0, "use"), [CAGING, 'the key "use" is missing']),
    "use names no design": (
        put("hnad", "loop", 0, "use"),
        [
            CAGING,
            'use must be the name of a design of this loop, got "hnad"; did you mean "hand"?',
            'did you mean "hand"?',
        ],
    ),
    "no design": (
        put([], "loop", 0, "design"),
        [CAGING, "design must have at least one [[loop.design]], got []", "at least one [[loop.design]]"],
    ),
    "design missing": (drop("loop", 0, "design"), [CAGING, "the table [[loop.design]] is missing"]),
    "design twice": (
        put("hand", "loop", 0, "design", 1, "name"),
        [f'{CAGING}: [[loop.design]] 2 "hand"', "is the name of [[loop.design]] 1 already"],
    ),
    "method unknown": (
        put("clasical", "loop", 0, "design", 0, "method"),
        [
            HAND,
            'method must be "classical" or "pi" or "hinf" or "lqg" or "lmi" or "structured" or "measured" or ',
            'or "platform-servo", ',
        ],
    ),
    "method for another kind": (
        put({"name": "machine", "method": "platform-servo", "crossover_hz": 40}, "loop", 0, "design", 1),
        [
            'method must be one for a caging loop, "classical" or "hinf" or "lqg" or "lmi" or "structured" or ',
            'or "measured", go',
            '"classical" or "hinf"',
        ],
    ),
    "option unknown": (
        put(4, "loop", 0, "design", 0, "crosover_hz"),
        [HAND, 'unknown key "crosover_hz"', 'did you mean "crossover_hz"?'],
    ),
    "option of another method": (
        put(0.02, "loop", 0, "design", 0, "backoff"),
        [HAND, 'unknown key "backoff"'],
    ),
    "option as text": (
        put("40", "loop", 0, "design", 0, "crossover_hz"),
        [HAND, 'crossover_hz must be a number, got "40"', "a number"],
    ),
    "option true": (
        put(True, "loop", 0, "design", 0, "crossover_hz"),
        [HAND, "crossover_hz must be", "got true", "a number"],
    ),
    "option not finite": (
        put(math.inf, "loop", 0, "design", 0, "integral_hz"),
        [HAND, "integral_hz must be a number, got inf (not finite)"],
    ),
    "option negative": (
        put(-4, "loop", 0, "design", 0, "integral_hz"),
        [HAND, "integral_hz must be a number > 0, got -4", "> 0"],
    ),
    "tune a number": (
        put(1, "loop", 0, "design", 0, "tune"),
        [HAND, "tune must be true or false, got 1", "true or false"],
    ),
    "no gimbals": (
        drop("loop", 0, "gimbals"),
        [CAGING, "gimbals must be the names of the gimbals that the loop cages", 'known: "4", "5", "7", "9", "10"'],
    ),
    "empty gimbals": (
        put([], "loop", 0, "gimbals"),
        [CAGING, "gimbals must be the names of the gimbals that the loop cages", 'known: "4", "5", "7", "9", "10"'],
    ),
    "gimbals a text": (
        put("9", "loop", 0, "gimbals"),
        [CAGING, 'gimbals must be a list of names, got "9"; known: "4", "5", "7", "9", "10"', "a list of names"],
    ),
    "gimbals numbers": (
        put([9, 10], "loop", 0, "gimbals"),
        [CAGING, "gimbals must be", "got [9, 10]", "a list of names", 'known: "4", "5", "7", "9", "10"'],
    ),
    "faults a text": (
        both(
            put([{"name": "deaf", "kind": "pick-off dead", "part": "alpha9", "at": 1}], "fault"),
            put("deaf", "manoeuvre", 0, "faults"),
        ),
        [TURN, 'faults must be a list of names, got "deaf"; known: "deaf"'],
    ),
    "an angle in degrees": (
        put({"alpha9": [-30]}, "operation", "angles"),
        ["[operation.angles]", "alpha9: -30 rad is outside the stops", "-30 degrees are -0.5236"],
    ),
    "gimbal unknown": (
        put(["9", "100"], "loop", 0, "gimbals"),
        [
            CAGING,
            'gimbals: "100" is no gimbal of the plant; did you mean "10"?',
            '"100" is no gimbal of the plant',
            'did you mean "10"?',
        ],
    ),
    "gimbal twice": (put(["9", "9"], "loop", 0, "gimbals"), [CAGING, '"9" is caged by [[loop]] 1 already']),
    "gimbal in two loops": (
        lambda data: data["loop"].insert(1, dict(data["loop"][0], name="more", gimbals=["4", "10"])),
        ['[[loop]] 2 "more"', '"10" is caged by [[loop]] 1 already'],
    ),
    "caging after stabilisation": (
        lambda data: data["loop"].reverse(),
        [
            '[[loop]] 2 "caging"',
            "kind: a caging loop must be before the stabilisation loop, [[loop]] 1, which uses the to",
            "kind: a caging loop must be before the stabilisation loop, [[loop]] 1, which uses the to",
        ],
    ),
    "limit of another kind of loop": (
        put({"damping": 0.1}, "loop", 1, "limits"),
        [
            f"{SERVO}: [loop.limits]",
            "damping is no limit of a stabilisation loop, which is checked in the coupled system; use ",
            "torque_noise",
        ],
    ),
    "tune where nothing tunes": (
        put(True, "loop", 0, "design", 1, "tune"),
        ["[[loop.design]]", 'method "hinf" has no tuner', '"classical"'],
    ),
    "gimbals of a stabilisation loop": (
        put(["9"], "loop", 1, "gimbals"),
        [SERVO, 'gimbals = ["9"]', "leave the key out"],
    ),
    "two stabilisation loops": (
        lambda data: data["loop"].append(dict(data["loop"][1], name="more")),
        ['[[loop]] 3 "more"', "[[loop]] 2 stabilises the root already"],
    ),
    "loop limit zero": (
        put(0, "loop", 0, "limits", "damping"),
        [f"{CAGING}: [loop.limits]", "damping must be a number > 0, got 0", "> 0"],
    ),
    "loop limit unknown": (
        put(1, "loop", 0, "limits", "dampign"),
        [f"{CAGING}: [loop.limits]", 'unknown key "dampign"', 'did you mean "damping"?'],
    ),
    "limit on faults of a job without": (
        put(0.1, "loop", 0, "limits", "damping_faults"),
        [
            f"{CAGING}: [loop.limits]",
            "damping_faults needs plants with faults; add [faults] with slow_rotor or weak_torquer",
            "slow_rotor or weak_torquer",
        ],
    ),
    "goal on faults of a job without": (
        put({"disk_margin_faults": 0.1}, "loop", 0, "soft"),
        [
            f"{CAGING}: [loop.soft]",
            "disk_margin_faults needs plants with faults; add [faults] with slow_rotor or weak_torque",
        ],
    ),
    "tracking up to nowhere": (
        put(0.1, "loop", 0, "limits", "tracking"),
        [f"{CAGING}: [loop.limits]", 'the key "tracking_hz" is missing; tracking has no effect without it'],
    ),
    "a band that ends before it begins": (
        put({"tracking": 0.1, "tracking_from_hz": 5, "tracking_hz": 5}, "loop", 0, "limits"),
        [f"{CAGING}: [loop.limits]", "tracking_from_hz must be below tracking_hz = 5, got 5"],
    ),
    "a band without an end": (
        put({"torque_limit": 0.5, "torque_limit_from_hz": 5}, "loop", 0, "limits"),
        [f"{CAGING}: [loop.limits]", "torque_limit_from_hz has no effect without torque_limit_hz"],
    ),
    "tracking nothing": (put({"tracking_hz": 5}, "loop", 0, "soft"), ["[loop.soft]", 'the key "tracking" is missing']),
    "a band without a torque limit": (
        put(5, "loop", 0, "limits", "torque_limit_hz"),
        ['the key "torque_limit" is missing; torque_limit_hz has no effect without it'],
    ),
    "goal zero": (
        put({"bandwidth_hz": 0}, "loop", 0, "soft"),
        [f"{CAGING}: [loop.soft]", "bandwidth_hz must be a number > 0, got 0", "> 0"],
    ),
    "goals of a stabilisation loop": (
        put({"torque_noise": 0.1}, "loop", 1, "soft"),
        [
            SERVO,
            "soft has no effect in a stabilisation loop: nothing is minimised; leave the table out",
            "leave the table out",
        ],
    ),
    "structure unknown": (
        put({"name": "machine", "method": "structured", "structure": "PI"}, "loop", 0, "design", 1),
        [
            'structure must be "cross-axis" or "pid" or "state-space", got "PI"',
            'structure must be "cross-axis" or "pid" or "state-space", got "PI"',
        ],
    ),
    "structure of another method": (
        put("pid", "loop", 0, "design", 0, "structure"),
        [HAND, 'unknown key "structure"'],
    ),
    "coupled limit negative": (
        put(-1, "coupled", "disk_margin"),
        ["[coupled]", "disk_margin must be a number > 0, got -1", "> 0"],
    ),
    "coupled limit unknown": (put(1, "coupled", "disc_margin"), ["[coupled]", 'did you mean "disk_margin"?']),
    "manoeuvre twice": (put("turn", "manoeuvre", 1, "name"), ['[[manoeuvre]] 2 "turn"', "[[manoeuvre]] 1 already"]),
    "mode unknown": (
        put("cage", "manoeuvre", 0, "mode"),
        [TURN, 'mode must be "caged" or "stabilised", got "cage"', '"caged" or "stabilised"'],
    ),
    "axis 4": (
        put(4, "manoeuvre", 0, "axis"),
        [TURN, "axis must be 1, 2 or 3, got 4", "axis must be 1, 2 or 3, got 4"],
    ),
    "axis as text": (
        put("1", "manoeuvre", 0, "axis"),
        [TURN, 'axis must be 1, 2 or 3, got "1"', 'axis must be 1, 2 or 3, got "1"'],
    ),
    "caged without rate": (drop("manoeuvre", 0, "rate"), [TURN, 'the key "rate" is missing', "rate, rise, hold"]),
    "caged without rise": (drop("manoeuvre", 0, "rise"), [TURN, 'the key "rise" is missing']),
    "caged without hold": (drop("manoeuvre", 0, "hold"), [TURN, 'the key "hold" is missing']),
    "caged with torque": (
        put(0.1, "manoeuvre", 0, "torque"),
        [
            TURN,
            'torque = 0.1 is for a stabilised manoeuvre; leave it out with mode = "caged"',
            'torque = 0.1 is for a stabilised manoeuvre; leave it out with mode = "caged"',
            "a stabilised manoeuvre",
        ],
    ),
    "caged at no rate": (
        put(0, "manoeuvre", 0, "rate"),
        [TURN, "rate must be a number other than 0, got 0", "other than 0"],
    ),
    "caged with no rise": (put(0, "manoeuvre", 0, "rise"), [TURN, "rise must be", "got 0", "a number > 0"]),
    "caged too short": (
        put(1.9, "manoeuvre", 0, "duration"),
        [
            TURN,
            "duration must be at least 2 rise + hold, 2 s, got 1.9",
            "duration must be at least 2 rise + hold, 2 s, got 1.9",
        ],
    ),
    "stabilised without torque": (
        drop("manoeuvre", 1, "torque"),
        [PUSH, 'the key "torque" is missing', "needs torque"],
    ),
    "stabilised with rate": (
        put(1, "manoeuvre", 1, "rate"),
        [
            PUSH,
            'rate = 1 is for a caged manoeuvre; leave it out with mode = "stabilised"',
            'rate = 1 is for a caged manoeuvre; leave it out with mode = "stabilised"',
            "a caged manoeuvre",
        ],
    ),
    "duration zero": (put(0, "manoeuvre", 1, "duration"), [PUSH, "duration must be", "got 0", "a number > 0"]),
    "manoeuvre limit negative": (
        put(-1, "manoeuvre", 0, "limits", "angle"),
        [f"{TURN}: [manoeuvre.limits]", "angle must be", "got -1", "a number > 0"],
    ),
    "manoeuvre limit unknown": (
        put(1, "manoeuvre", 0, "limits", "angel"),
        [f"{TURN}: [manoeuvre.limits]", 'unknown key "angel"', 'did you mean "angle"?'],
    ),
}

SMALL_MISTAKES: dict[str, tuple[Change, list[str]]] = {
    "in the plant": (
        put([0, 0, 0], "plant", "gimbal", 1, "axis"),
        [
            '[[plant.gimbal]] 2 "5"',
            "axis must be a vector of three numbers that is not zero, got [0, 0, 0] (of length zero)",
            "of length zero",
        ],
    ),
    "in the plant's root": (
        put([1, 1, 3], "plant", "root", "inertia"),
        ["inertia must be three principal moments > 0 or a symmetric 3 x 3 matrix, kg m2, got [1, "],
    ),
    "in the plant's tree": (
        put("5", "plant", "gimbal", 0, "parent"),
        [
            '[[plant.gimbal]] 1 "4"',
            'parent = "5" closes a ring of parents, "4" -> "5" -> "4"; let the chain end at the root',
        ],
    ),
    "no torquer": (drop("plant", "torquer", 1), [CAGING, '"5" has no torquer in the plant']),
    "no pick-off": (drop("plant", "pickoff", 1), [CAGING, '"4" has no pick-off in the plant']),
    "no root torquers": (
        add(job()["loop"][1], "loop"),
        [
            SERVO,
            'kind = "stabilisation"',
            'kind = "stabilisation" needs root torquers; the plant has no M2, M3; add [[torquer]] wit',
        ],
    ),
}


def refused_alike(data: dict[str, Any], fragments: list[str], folder: Path) -> None:
    from_dict = refusal(read_job, data)
    file = folder / "job.toml"
    file.write_text(toml_file(data), encoding="utf-8")
    from_file = refusal(read_job, file)
    for fragment in fragments:
        assert fragment in from_dict
        assert fragment in from_file
    assert "more)" not in from_dict
    assert from_dict.startswith("job given as a dict: ")
    assert from_file.startswith(f"{file}: ")


@pytest.mark.parametrize(("change", "fragments"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_is_one_line_that_names_its_place(change: Change, fragments: list[str], tmp_path: Path) -> None:
    data = job()
    change(data)
    refused_alike(data, fragments, tmp_path)


@pytest.mark.parametrize(("change", "fragments"), SMALL_MISTAKES.values(), ids=SMALL_MISTAKES.keys())
def test_a_mistake_in_a_job_with_its_own_plant_is_one_line(
    change: Change, fragments: list[str], tmp_path: Path
) -> None:
    data = small_job()
    change(data)
    refused_alike(data, fragments, tmp_path)


def test_the_first_mistake_in_the_files_order_is_named_wherever_it_was_found() -> None:
    data = job()
    data["sampling"]["delay"] = -1
    data["loop"][0]["gimbals"] = ["9", "11"]
    data["manoeuvre"][0]["axis"] = 0
    assert "delay must be a number >= 0, got -1" in refusal(read_job, data)
    assert refusal(read_job, data).endswith(' (and 2 more: [[loop]] 1 "caging": gimbals, [[manoeuvre]] 1 "turn": axis)')
    assert "axis must be 1, 2 or 3, got 0" in refusal(read_job, dict(reversed(data.items())))


def test_a_mistake_in_a_plant_file_names_both_files(tmp_path: Path) -> None:
    broken = plant()
    broken["gimbal"][0]["axis"] = [0, 0, 0]
    (tmp_path / "mine.toml").write_text(toml_file(broken), encoding="utf-8")
    (tmp_path / "job.toml").write_text(toml_file(job() | {"plant": "mine.toml"}), encoding="utf-8")
    message = refusal(read_job, tmp_path / "job.toml")
    assert message.startswith(f"{tmp_path / 'job.toml'}: plant: {tmp_path / 'mine.toml'}: [[gimbal]] 1")


@pytest.mark.parametrize("source", [None, 3, b"job.toml", [], "", object()])
def test_a_source_that_is_no_source_is_one_line(source: object) -> None:
    assert "the argument must be the path of a job file or a dict, got " in refusal(read_job, source)


def test_a_folder_that_is_no_folder_is_one_line() -> None:
    assert "the argument must be a folder, got 3" in refusal(lambda source: read_job(source, folder=3), job())  # type: ignore[arg-type]


def test_a_job_that_cannot_be_opened_is_one_line(tmp_path: Path) -> None:
    assert refusal(read_job, tmp_path / "nowhere.toml").endswith("nowhere.toml: there is no such file")
    assert "nowhere: there is no such file" in refusal(read_job, str(tmp_path / "nowhere"))
    (tmp_path / "broken.toml").write_text("loop = [", encoding="utf-8")
    assert "is not TOML" in refusal(read_job, tmp_path / "broken.toml")


def test_files_of_schema_1_are_refused_with_what_to_change() -> None:
    words = "schema must be 2, the format that this version reads, got 1 (write schema = 2, [uncertainty] in place of"
    assert words in refusal(read_job, job() | {"schema": 1})


def test_what_is_read_is_the_job() -> None:
    read = read_job(job())
    assert (read.name, read.plant, read.seed) == ("two loops", "three_gyro_platform", 7)
    assert read.platform.name == "three-gyro platform"
    assert read.Omega.tolist() == [1.0, 0.5, 0.0]
    assert (read.uncertainty.inertia, read.uncertainty.spin) == (0.1, 0.2)
    assert (read.sampling.period, read.sampling.delay) == (1 / 2000, 0.0005)
    caging, servo = read.loops
    assert (caging.kind, caging.gimbals, caging.use) == ("caging", ("9", "10"), "hand")
    assert (servo.kind, servo.gimbals, servo.use) == ("stabilisation", (), "servo")
    hand, machine = caging.designs
    assert (hand.method, hand.tune, hand.options) == ("classical", True, {"crossover_hz": 40.0, "notch_depth": 0.5})
    assert (machine.method, machine.tune, machine.options) == ("hinf", False, {"bandwidth_hz": 40.0})
    assert (caging.limits.get("bandwidth_hz"), caging.limits.get("damping"), caging.limits.get("disk_margin")) == (
        40.0,
        0.1,
        None,
    )
    assert servo.limits.get("torque_noise") is None
    assert (read.coupled.disk_margin, read.coupled.coupling_cost) == (0.5, None)
    turn, push = read.manoeuvres
    assert (turn.mode, turn.axis, turn.rate, turn.rise, turn.hold, turn.duration) == ("caged", 1, -1.0, 0.5, 1.0, 2.0)
    assert (push.mode, push.axis, push.torque, push.duration) == ("stabilised", 3, 0.1, 1.0)
    assert (turn.limits, push.limits) == ({"angle": 0.003}, {"attitude": 1.0})


def test_the_set_of_plants_and_the_goals_are_read() -> None:
    data = job()
    data["operation"]["Omega_grid"] = 3
    data["uncertainty"]["samples"] = 16
    data["faults"] = {"slow_rotor": 0, "weak_torquer": 0.5}
    caging = data["loop"][0]
    caging["limits"] |= {
        "damping_faults": 0.01,
        "tracking": 0.1,
        "tracking_hz": 5,
        "torque_limit": 1,
        "Omega_rejection": 2,
    }
    caging["soft"] = {"bandwidth_hz": 60, "sensitivity_peak_worst_case": 2}
    caging["design"].append({"name": "simple", "method": "structured", "structure": "cross-axis"})
    read = read_job(data)
    assert (read.Omega_grid, read.uncertainty.samples) == (3, 16)
    assert (read.faults.slow_rotor, read.faults.weak_torquer) == (0.0, 0.5)
    limits, soft = read.loops[0].limits, read.loops[0].soft
    assert (limits.get("damping_faults"), limits.get("tracking"), limits.get("tracking_hz")) == (0.01, 0.1, 5.0)
    assert (limits.get("torque_limit"), limits.get("torque_limit_hz"), limits.get("Omega_rejection")) == (
        1.0,
        None,
        2.0,
    )
    assert (soft.get("bandwidth_hz"), soft.get("sensitivity_peak_worst_case"), soft.get("damping")) == (60.0, 2.0, None)
    assert [design.structure for design in read.loops[0].designs] == [None, None, "cross-axis"]


def test_every_limit_can_be_a_goal() -> None:
    # Those of the line of sight belong to rate and pointing loops.
    names = [key for key in limit_keys() if not key.startswith("attenuation")]
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


@pytest.mark.parametrize("name", shipped_models())
def test_a_platform_may_stand_in_a_job_in_place_of_its_name(name: str) -> None:
    platform = read_platform(name)
    torquers, pickoffs = ({one.gimbal for one in parts} for parts in (platform.torquers, platform.pickoffs))
    loop = dict(job()["loop"][0], gimbals=[one for one in platform.gimbal_names if one in torquers & pickoffs])
    data = job() | {"loop": [loop], "manoeuvre": []}
    found = []
    for plant_of in (name, platform, tomllib.loads(platform.to_toml())):
        try:
            found.append(text_of(read_job(data | {"plant": plant_of}).platform))
        except InputError as error:  # a plant without a gimbal that can be caged
            found.append(str(error))
    assert found[1:] == found[:2]


def test_a_platform_in_a_job_is_judged_as_its_file_is() -> None:
    platform = dataclasses.replace(read_platform("three_gyro_platform"), name="mine")
    found = read_job(job() | {"plant": platform})
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


def test_a_job_is_written_and_read_back_whole() -> None:
    # Those of the line of sight belong to rate and pointing loops.
    names = [key for key in limit_keys() if not key.startswith("attenuation")]
    data = job() | {"faults": {"slow_rotor": 0.5}}
    data["operation"]["Omega_grid"] = 4
    data["uncertainty"]["samples"] = 3
    data["loop"][0]["soft"] = {key: 0.1 if "_from_" in key else 0.25 for key in names}
    data["loop"][0]["design"].append({"name": "simple", "method": "structured", "structure": "pid", "order": 2})
    read = read_job(data)
    again = read_job(job_data(read))
    assert job_data(again) == job_data(read)
    assert (again.Omega_grid, again.uncertainty.samples, again.faults.slow_rotor) == (4, 3, 0.5)
    assert again.loops[0].soft.get("tracking_hz") == 0.25
    assert again.loops[0].designs[2].structure == "pid"


def test_what_may_be_left_out_asks_for_nothing() -> None:
    data = job()
    for key in ("uncertainty", "coupled", "manoeuvre"):
        del data[key]
    del data["operation"]["seed"]
    del data["loop"][0]["limits"]
    read = read_job(data)
    assert (read.uncertainty.inertia, read.uncertainty.spin, read.seed, read.manoeuvres) == (0.0, 0.0, 0, ())
    assert read.coupled.disk_margin is None
    assert read.loops[0].limits.get("bandwidth_hz") is None
    assert read.loops[0].soft.get("bandwidth_hz") is None
    assert (read.Omega_grid, read.uncertainty.samples, read.faults.slow_rotor, read.faults.weak_torquer) == (
        2,
        0,
        None,
        None,
    )


def test_the_example_is_read_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    read = read_job(EXAMPLE)
    assert [loop.name for loop in read.loops] == ["caging 4-5-7", "caging 9-10", "stabilisation"]
    assert {gimbal for loop in read.loops for gimbal in loop.gimbals} == set(read.platform.gimbal_names)
    assert len(read.manoeuvres) == 6


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
    monkeypatch.chdir(tmp_path)
    assert read_job(data).plant == "plants/mine.toml"


def test_a_plant_in_the_job_itself_is_read_and_may_hold_arrays() -> None:
    data = small_job()
    data["plant"]["gimbal"][0]["axis"] = np.array([0, 2, 0])
    read = read_job(data)
    assert read.plant == read.platform.name == "two gimbals"
    np.testing.assert_array_equal(read.platform.gimbals[0].axis, [0, 1, 0])


def test_the_largest_rate_is_read_only_and_stays_so_through_pickle_and_deepcopy() -> None:
    read = read_job(job())
    for copied in (read, copy.deepcopy(read), pickle.loads(pickle.dumps(read))):
        assert copied.Omega.tolist() == [1.0, 0.5, 0.0]
        with pytest.raises(ValueError, match="read-only"):
            copied.Omega[0] = 2.0
        with pytest.raises(ValueError, match="read-only"):
            copied.platform.root_inertia[0, 0] = 2.0


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


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    junk=st.lists(JUNK, min_size=1, max_size=4),
    chance=st.randoms(use_true_random=False),
    start=st.sampled_from([job, small_job]),
)
def test_whatever_is_changed_a_job_is_read_or_refused_in_one_line(
    junk: list[Any], chance: random.Random, start: Any
) -> None:
    data = start()
    for item in junk:
        mutate(data, chance, item)
    read = outcome(read_job, data)
    if isinstance(read, str):
        assert read.isprintable()
    else:
        assert read.sampling.period > 0
        assert all(spec.use in [design.name for design in spec.designs] for spec in read.loops)
