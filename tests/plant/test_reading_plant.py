"""Plant files: what is read, and that every mistake is one line that names its place."""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import os
import pickle
import random
import sys
import tomllib
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import platform_ctrl as pc
from every_key import every_plant_key, meaning
from oracle_trees import Motion, motions
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.plant.force_elements import Friction, Unbalance
from platform_ctrl.plant.platform import Gimbal, Platform, Torquer
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.sensors import PickOff, RateSensor
from platform_ctrl.plant.source import platform_source, shipped_models
from platform_ctrl.plant.writing import plant_data

Change = Callable[[dict[str, Any]], object]


def plant() -> dict[str, Any]:
    """Return a small valid plant: gimbal 5 in gimbal 4, a rotor in 5."""
    return {
        "schema": 1,
        "name": "two gimbals",
        "source": "invented",
        "root": {"name": "platform", "inertia": [[2.0, 0.1, 0.0], [0.1, 3.0, 0.0], [0.0, 0.0, 4.0]]},
        "gimbal": [
            {"name": "4", "parent": "platform", "axis": [0, 2, 0], "inertia": [3, 4, 5], "angle": "alpha4"},
            {"name": "5", "parent": "4", "axis": [0, 0, -1], "inertia": [1, 1, 1], "stops": [-0.1, 0.2]},
        ],
        "rotor": [
            {
                "name": "6",
                "carrier": "5",
                "axis": [1, 0, 0],
                "axial_inertia": 0.5,
                "transverse_inertia": 0.3,
                "spin": 100.0,
            },
        ],
        "torquer": [{"gimbal": "4", "limit": 0.5, "lag": 0.001}, {"gimbal": "5"}, {"root_axis": 1}],
        "pickoff": [{"gimbal": "5", "noise_rms": 1e-6}, {"gimbal": "4"}],
    }


def toml(item: object) -> str:
    """Write plain data as TOML; tables within the file become inline tables."""
    if isinstance(item, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(entry)}" for key, entry in item.items()) + "}"
    if isinstance(item, list):
        return "[" + ", ".join(map(toml, item)) + "]"
    return json.dumps(item) if isinstance(item, str | bool) else repr(item)


def toml_file(data: dict[str, Any]) -> str:
    return "".join(f"{json.dumps(key)} = {toml(entry)}\n" for key, entry in data.items())


def enter(data: Any, path: tuple[str | int, ...]) -> Any:
    for step in path:
        data = data[step]
    return data


def put(value: object, *path: str | int) -> Change:
    return lambda data: enter(data, path[:-1]).__setitem__(path[-1], copy.deepcopy(value))


def drop(*path: str | int) -> Change:
    return lambda data: enter(data, path[:-1]).__delitem__(path[-1])


def add(entry: object, *path: str | int) -> Change:
    return lambda data: enter(data, path).append(copy.deepcopy(entry))


def both(*changes: Change) -> Change:
    return lambda data: [change(data) for change in changes]


def refusal(read: Callable[[Any], object], source: object) -> str:
    """Return the message, which is one line whatever was refused."""
    with pytest.raises(InputError) as caught:
        read(source)
    message = str(caught.value)
    assert message.isprintable()
    return message


def outcome(read: Callable[[Any], Any], source: object) -> Any:
    """Return what is read, or the message of the refusal; any other exception is a failure."""
    try:
        return read(source)
    except InputError as error:
        return str(error)


GIMBAL_4 = '[[gimbal]] 1 "4"'
GIMBAL_5 = '[[gimbal]] 2 "5"'
ROTOR = '[[rotor]] 1 "6"'
NEW_TORQUER = "[[torquer]] 4"

MISTAKES: dict[str, tuple[Change, list[str]]] = {
    # keys and tables
    "schema missing": (
        drop("schema"),
        [
            'the key "schema" is missing',
            'the key "schema" is missing; it must be 1, the format that this version reads',
        ],
    ),
    "schema 2": (
        put(2, "schema"),
        [
            "schema must be 1, the format that this version reads, got 2",
            "schema must be 1, the format that this version reads, got 2",
        ],
    ),
    "schema as text": (
        put("1", "schema"),
        [
            'schema must be 1, the format that this version reads, got "1"',
            'schema must be 1, the format that this version reads, got "1"',
        ],
    ),
    "schema true": (
        put(True, "schema"),
        [
            "schema must be 1, the format that this version reads, got true",
            "schema must be 1, the format that this version reads, got true",
        ],
    ),
    "name missing": (drop("name"), ['the key "name" is missing']),
    "name empty": (put("", "name"), ['name must be a line of text that is not empty, got "" (empty)', "empty"]),
    "name blank": (put(" ", "gimbal", 1, "name"), ["[[gimbal]] 2", "empty"]),
    "name of two lines": (put("a\nb", "gimbal", 1, "name"), ["[[gimbal]] 2", "cannot be printed"]),
    "name a number": (
        put(5, "gimbal", 1, "name"),
        [
            "[[gimbal]] 2 5",
            "[[gimbal]] 2 5: name must be a line of text that is not empty, got 5",
            "[[gimbal]] 2 5: name must be a line of text that is not empty, got 5",
        ],
    ),
    "source a number": (put(5, "source"), ["source must be a text, got 5", "source must be a text, got 5"]),
    "unknown key": (put(1, "gimbal", 1, "stop"), [GIMBAL_5, 'unknown key "stop"', 'did you mean "stops"?']),
    "unknown key far off": (put(1, "root", "zzzzzz"), ["[root]", 'unknown key "zzzzzz"', 'known: "name", "inertia"']),
    "unknown key in capitals": (put(1, "gimbal", 1, "STOPS"), [GIMBAL_5, 'did you mean "stops"?']),
    "unknown table": (put([{"name": "x"}], "gimball"), ['unknown table "gimball"', 'did you mean "gimbal"?']),
    "unknown plain table": (put({"x": 1}, "rooot"), ['unknown table "rooot"', 'did you mean "root"?']),
    "misspelt key": (
        both(put([1, 0, 0], "gimbal", 1, "axes"), drop("gimbal", 1, "axis")),
        [GIMBAL_5, 'unknown key "axes"', 'did you mean "axis"?'],
    ),
    "root missing": (drop("root"), ["the table [root] is missing"]),
    "root a number": (put(3, "root"), ["root must be a table, got 3", "root must be a table, got 3"]),
    "root an array": (
        put([{"name": "p"}], "root"),
        ["root must be a table, got an array of tables", "root must be a table, got an array of tables"],
    ),
    "gimbal a table": (
        put({"name": "4"}, "gimbal"),
        [
            "gimbal must be an array of tables, each headed [[gimbal]], got a table",
            "gimbal must be an array of tables, each headed [[gimbal]], got a table",
            "[[gimbal]]",
        ],
    ),
    "gimbal a number": (
        add(7, "gimbal"),
        ["[[gimbal]] 3", "gimbal must be a table, got 7", "gimbal must be a table, got 7"],
    ),
    "gimbal without parent": (
        drop("gimbal", 1, "parent"),
        [
            GIMBAL_5,
            'the key "parent" is missing',
            'the key "parent" is missing; it must be a line of text that is not empty',
        ],
    ),
    "gimbal without axis": (
        drop("gimbal", 1, "axis"),
        [GIMBAL_5, 'the key "axis" is missing', "vector of three numbers"],
    ),
    "gimbal without inertia": (drop("gimbal", 1, "inertia"), [GIMBAL_5, 'the key "inertia" is missing', "kg m2"]),
    "rotor without C": (
        drop("rotor", 0, "axial_inertia"),
        [ROTOR, 'the key "axial_inertia" is missing', "a number > 0"],
    ),
    # numbers
    "number as text": (
        put("0.5", "torquer", 0, "limit"),
        ['[[torquer]] 1 (gimbal "4")', 'limit must be a number > 0, got "0.5"', "a number"],
    ),
    "number a boolean": (
        put(True, "torquer", 0, "limit"),
        ["limit must be a number > 0, got true", "limit must be a number > 0, got true"],
    ),
    "number a list": (
        put([1.0], "torquer", 0, "limit"),
        ["limit must be a number > 0, got [1.0]", "limit must be a number > 0, got [1.0]"],
    ),
    "number a table": (
        put({"a": 1}, "torquer", 0, "limit"),
        ["limit must be a number > 0, got a table", "limit must be a number > 0, got a table"],
    ),
    "not finite": (
        put(math.nan, "torquer", 0, "limit"),
        ["limit must be a number > 0, got nan (not finite)", "not finite"],
    ),
    "infinite": (
        put(math.inf, "rotor", 0, "spin"),
        [ROTOR, "spin must be a number, got inf (not finite)", "not finite"],
    ),
    "huge integer": (
        put(10**400, "rotor", 0, "spin"),
        [
            ROTOR,
            "spin must be a number, got an integer of 1329 bits (too large for a floating-point numbe",
            "too large",
        ],
    ),
    "limit zero": (
        put(0, "torquer", 0, "limit"),
        ["limit must be a number > 0, got 0", "limit must be a number > 0, got 0"],
    ),
    "limit negative": (
        put(-1.5, "torquer", 0, "limit"),
        ["limit must be a number > 0, got -1.5", "limit must be a number > 0, got -1.5"],
    ),
    "lag negative": (
        put(-1e-3, "torquer", 0, "lag"),
        ["lag must be a number >= 0, got -0.001", "lag must be a number >= 0, got -0.001"],
    ),
    "noise negative": (
        put(-1e-6, "pickoff", 0, "noise_rms"),
        ['[[pickoff]] 1 (gimbal "5")', "noise_rms must be a number >= 0, got -1e-06"],
    ),
    "bandwidth zero": (
        put(0, "pickoff", 0, "noise_bandwidth_hz"),
        ["noise_bandwidth_hz must be", "got 0", "a number > 0"],
    ),
    "quantisation negative": (
        put(-1, "pickoff", 0, "quantisation"),
        ["quantisation must be", "got -1", "a number >= 0"],
    ),
    # vectors and matrices
    "axis a number": (
        put(1, "gimbal", 1, "axis"),
        [
            GIMBAL_5,
            "axis must be a vector of three numbers that is not zero, got 1",
            "axis must be a vector of three numbers that is not zero, got 1",
        ],
    ),
    "axis of two": (
        put([1, 0], "gimbal", 1, "axis"),
        [
            "axis must be a vector of three numbers that is not zero, got [1, 0] (has 2 elements)",
            "has 2 elements",
            "three numbers",
        ],
    ),
    "axis zero": (
        put([0, 0.0, 0], "gimbal", 1, "axis"),
        [
            GIMBAL_5,
            "axis must be a vector of three numbers that is not zero, got [0, 0.0, 0] (of length zero",
            "of length zero",
        ],
    ),
    "axis of words": (put([0, "1", 0], "gimbal", 1, "axis"), ["axis", 'element 2, "1", is not a number']),
    "axis with a boolean": (put([0, True, 0], "rotor", 0, "axis"), [ROTOR, "element 2, true, is not a number"]),
    "axis not finite": (put([0, 0, math.inf], "rotor", 0, "axis"), [ROTOR, "element 3, inf, is not finite"]),
    "axis nested": (
        put([[0, 1, 0]], "gimbal", 1, "axis"),
        [
            GIMBAL_5,
            "axis must be a vector of three numbers that is not zero, got [[0, 1, 0]] (has 1 element)",
            "axis must be a vector of three numbers that is not zero, got [[0, 1, 0]] (has 1 element)",
        ],
    ),
    "inertia a number": (
        put(2.0, "root", "inertia"),
        [
            "[root]",
            "inertia must be three principal moments > 0 or a symmetric 3 x 3 matrix, kg m2, got 2.0",
            "symmetric 3 x 3 matrix",
        ],
    ),
    "inertia of two": (
        put([1, 2], "gimbal", 0, "inertia"),
        [
            GIMBAL_4,
            "inertia must be three principal moments > 0 or a symmetric 3 x 3 matrix, kg m2, got [1, ",
            "has 2 elements",
        ],
    ),
    "inertia of two rows": (put([[1, 0, 0], [0, 1, 0]], "root", "inertia"), ["[root]", "has 2 rows", "3 x 3"]),
    "inertia ragged": (put([[1, 0, 0], [0, 1], [0, 0, 1]], "root", "inertia"), ["[root]", "row 2 has 2 elements"]),
    "inertia mixed": (put([1, [0, 1, 0], 1], "root", "inertia"), ["[root]", "element 2, [0, 1, 0], is not a number"]),
    "inertia zero": (put([0, 0, 0], "root", "inertia"), ["[root]", "not positive definite"]),
    "inertia not symmetric": (
        put([[2, 0.1, 0], [0.2, 2, 0], [0, 0, 2]], "root", "inertia"),
        ["[root]", "not symmetric, element (1, 2) differs from (2, 1)"],
    ),
    "inertia negative": (put([1, -1, 1], "gimbal", 0, "inertia"), [GIMBAL_4, "not positive definite", "moment is -1"]),
    "inertia indefinite": (
        put([[1, 2, 0], [2, 1, 0], [0, 0, 1]], "root", "inertia"),
        ["[root]", "not positive definite, its smallest principal moment is -1"],
    ),
    "inertia singular": (
        put([[1, 1, 0], [1, 1, 0], [0, 0, 2]], "root", "inertia"),
        ["[root]", "not positive definite"],
    ),
    "inertia of no body": (put([1, 2, 3.1], "gimbal", 0, "inertia"), [GIMBAL_4, "3.1 exceeds the sum", "1 + 2"]),
    "matrix of no body": (
        put([[2, 1, 0], [1, 2, 0], [0, 0, 4.5]], "root", "inertia"),
        ["[root]", "4.5 exceeds the sum of the others, 1 + 3"],
    ),
    # rotors
    "C not positive": (put(0, "rotor", 0, "axial_inertia"), [ROTOR, "axial_inertia must be", "got 0", "a number > 0"]),
    "A not positive": (
        put(-0.3, "rotor", 0, "transverse_inertia"),
        [ROTOR, "transverse_inertia must be a number > 0, got -0.3", "> 0"],
    ),
    "C above 2 A": (
        put(0.24, "rotor", 0, "transverse_inertia"),
        [
            ROTOR,
            "transverse_inertia must be at least half of axial_inertia = 0.5, got 0.24",
            "axial_inertia = 0.5",
            "at least half",
        ],
    ),
    "spin and momentum": (
        put(1.0, "rotor", 0, "angular_momentum"),
        [ROTOR, 'give either "angular_momentum" or "spin", not both', '"angular_momentum"'],
    ),
    "no spin": (
        drop("rotor", 0, "spin"),
        [
            ROTOR,
            'give either "angular_momentum" or "spin", one of them is needed',
            'either "angular_momentum" or "spin"',
        ],
    ),
    "larger than anything": (
        put(2e50, "rotor", 0, "spin"),
        [ROTOR, "spin must be a number, got 2e+50 (larger than 1e+50)"],
    ),
    "next to nothing": (
        put(-1e-51, "rotor", 0, "spin"),
        [ROTOR, "spin must be a number, got -1e-51 (smaller than 1e-50 and not 0)"],
    ),
    "control unknown": (
        put("regulatd", "rotor", 0, "control"),
        [ROTOR, 'control must be "regulated" or "free" or "servo", got "regulatd"', '"regulated" or "free"'],
    ),
    # names and the tree
    "parent unknown": (
        put("platfrom", "gimbal", 0, "parent"),
        [
            GIMBAL_4,
            'parent must be the name of the root or a gimbal, got "platfrom"; did you mean "platform"',
            'parent must be the name of the root or a gimbal, got "platfrom"; did you mean "platform"',
            'did you mean "platform"?',
        ],
    ),
    "parent far off": (put("%%%", "gimbal", 1, "parent"), [GIMBAL_5, 'known: "platform", "4", "5"']),
    "parent a rotor": (
        put("6", "gimbal", 1, "parent"),
        [
            GIMBAL_5,
            'parent must be the name of the root or a gimbal, got "6"; known: "platform", "4", "5"',
            "the root or a gimbal",
        ],
    ),
    "carrier unknown": (
        put("gimbal 5", "rotor", 0, "carrier"),
        [
            ROTOR,
            'carrier must be the name of the root or a gimbal, got "gimbal 5"; known: "platform", "4"',
            'carrier must be the name of the root or a gimbal, got "gimbal 5"; known: "platform", "4"',
        ],
    ),
    "cycle": (
        put("5", "gimbal", 0, "parent"),
        [
            GIMBAL_4,
            'parent = "5"',
            '"4" -> "5" -> "4"',
            'parent = "5" closes a ring of parents, "4" -> "5" -> "4"; let the chain end at the root',
        ],
    ),
    "own parent": (put("5", "gimbal", 1, "parent"), [GIMBAL_5, 'parent = "5"', '"5" -> "5"']),
    "gimbal twice": (
        add({"name": "4", "parent": "5", "axis": [1, 0, 0], "inertia": [1, 1, 1]}, "gimbal"),
        ['[[gimbal]] 3 "4"', "is the name of [[gimbal]] 1 already"],
    ),
    "gimbal named like the root": (
        add({"name": "platform", "parent": "5", "axis": [1, 0, 0], "inertia": [1, 1, 1]}, "gimbal"),
        ['[[gimbal]] 3 "platform"', "is the name of the root already"],
    ),
    "rotor twice": (
        lambda data: data["rotor"].append(dict(data["rotor"][0])),
        ['[[rotor]] 2 "6"', "is the name of [[rotor]] 1 already"],
    ),
    # stops
    "stops of one": (
        put([0.1], "gimbal", 1, "stops"),
        [
            GIMBAL_5,
            "stops must be [lower, upper] with 0 between them, got [0.1] (has 1 element)",
            "stops must be [lower, upper] with 0 between them, got [0.1] (has 1 element)",
        ],
    ),
    "stops reversed": (put([0.1, -0.1], "gimbal", 1, "stops"), [GIMBAL_5, "lower is not below", "[lower, upper]"]),
    "stops equal": (put([0, 0], "gimbal", 1, "stops"), [GIMBAL_5, "lower is not below the upper"]),
    "stops without zero": (put([0.1, 0.2], "gimbal", 1, "stops"), [GIMBAL_5, "0 is not between them"]),
    "stops in degrees without zero": (
        put([-2, -1], "gimbal", 0, "stops_deg"),
        [GIMBAL_4, "stops_deg must be [lower, upper] with 0 between them, got [-2, -1] (0 is not between the"],
    ),
    "stops of 40 rad": (
        put([-40, 40], "gimbal", 1, "stops"),
        [GIMBAL_5, "[-40, 40] rad is more than a turn; is it in degrees? then write stops_deg", "[-2291.831181, "],
    ),
    "one stop of 30 rad": (put([-0.1, 30.0], "gimbal", 1, "stops"), [GIMBAL_5, "is it in degrees?"]),
    "stops twice": (
        put([-1, 1], "gimbal", 1, "stops_deg"),
        [GIMBAL_5, 'give either "stops" or "stops_deg", not both', '"stops" or "stops_deg"'],
    ),
    # torquers and pick-offs
    "torquer on nothing": (
        put("44", "torquer", 0, "gimbal"),
        [
            '[[torquer]] 1 (gimbal "44")',
            'gimbal must be the name of a gimbal, got "44"; did you mean "4"?',
            'gimbal must be the name of a gimbal, got "44"; did you mean "4"?',
            'did you mean "4"?',
        ],
    ),
    "torquer on the root": (
        put("platform", "torquer", 0, "gimbal"),
        [
            'gimbal must be the name of a gimbal (root_axis turns the root), got "platform"; known: "',
            "root_axis turns the root",
        ],
    ),
    "torquer with both": (
        put(2, "torquer", 0, "root_axis"),
        ["[[torquer]] 1", 'give either "gimbal" or "root_axis", not both', '"root_axis"'],
    ),
    "torquer with neither": (
        add({"name": "Q"}, "torquer"),
        [f'{NEW_TORQUER} "Q"', 'give either "gimbal" or "root_axis", one of them is needed'],
    ),
    "root axis 0": (
        put(0, "torquer", 2, "root_axis"),
        ["[[torquer]] 3 (root_axis 0)", "root_axis must be 1, 2 or 3, got 0"],
    ),
    "root axis 4": (
        put(4, "torquer", 2, "root_axis"),
        ["root_axis must be 1, 2 or 3, got 4", "root_axis must be 1, 2 or 3, got 4"],
    ),
    "root axis 1.0": (
        put(1.0, "torquer", 2, "root_axis"),
        ["root_axis must be 1, 2 or 3, got 1.0", "root_axis must be 1, 2 or 3, got 1.0"],
    ),
    "root axis true": (
        put(True, "torquer", 2, "root_axis"),
        ["root_axis must be 1, 2 or 3, got true", "root_axis must be 1, 2 or 3, got true"],
    ),
    "pick-off on nothing": (
        put("55", "pickoff", 0, "gimbal"),
        [
            "[[pickoff]] 1",
            'gimbal must be the name of a gimbal, got "55"; did you mean "5"?',
            'gimbal must be the name of a gimbal, got "55"; did you mean "5"?',
        ],
    ),
    "pick-off without gimbal": (drop("pickoff", 0, "gimbal"), ["[[pickoff]] 1", 'the key "gimbal" is missing']),
    "two pick-offs": (
        add({"gimbal": "5"}, "pickoff"),
        [
            "[[pickoff]] 3",
            "already, [[pickoff]] 1",
            'gimbal: "5" has a pick-off already, [[pickoff]] 1; leave one of them out',
        ],
    ),
    # signals
    "angle twice": (put("alpha4", "gimbal", 1, "angle"), [GIMBAL_5, 'angle = "alpha4"', "angle of [[gimbal]] 1"]),
    "angle like a default": (put("q_5", "gimbal", 0, "angle"), [GIMBAL_5, 'default name "q_5"', "[[gimbal]] 1"]),
    "angle named Omega1": (put("Omega1", "gimbal", 1, "angle"), [GIMBAL_5, 'angle = "Omega1"', "a platform rate"]),
    "angle named M2": (put("M2", "gimbal", 1, "angle"), [GIMBAL_5, "a torque about a root axis"]),
    "torquer twice": (add({"gimbal": "4"}, "torquer"), [NEW_TORQUER, 'default name "Q4"', "torque of [[torquer]] 1"]),
    "torquer named like an angle": (
        put("alpha4", "torquer", 0, "name"),
        ['[[torquer]] 1 "alpha4"', 'name = "alpha4" is the name of the angle of [[gimbal]] 1 already; choose another'],
    ),
    "torquer named Omega3": (
        put("Omega3", "torquer", 0, "name"),
        ['name = "Omega3" is the name of a platform rate already; choose another'],
    ),
    "gimbal torquer named M1": (
        put("M1", "torquer", 0, "name"),
        ['name = "M1" is the name of a torque about a root axis already; choose another'],
    ),
    "root torquer named after another axis": (put("M3", "torquer", 2, "name"), ["a torque about a root axis already"]),
    "root torquer twice": (add({"root_axis": 1}, "torquer"), [NEW_TORQUER, 'default name "M1"', "[[torquer]] 3"]),
}


@pytest.mark.parametrize(("change", "fragments"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_is_one_line_that_names_its_place(change: Change, fragments: list[str], tmp_path: Path) -> None:
    data = plant()
    change(data)
    from_dict = refusal(read_platform, data)
    file = tmp_path / "plant.toml"
    file.write_text(toml_file(data), encoding="utf-8")
    from_file = refusal(read_platform, file)
    for fragment in fragments:
        assert fragment in from_dict
    assert "more)" not in from_dict
    assert from_dict.startswith("plant given as a dict: ")
    assert from_file == from_dict.replace("plant given as a dict", str(file))


ENDLESS: list[Any] = []
ENDLESS.extend([ENDLESS] * 10)
ENDLESS_TABLE: dict[str, Any] = {"name": "4"}
ENDLESS_TABLE["axis"] = ENDLESS_TABLE

PYTHON_MISTAKES: dict[str, tuple[Change, list[str]]] = {
    "None": (
        put(None, "gimbal", 1, "angle"),
        [GIMBAL_5, "angle must not be None; leave the key out instead", "leave the key out"],
    ),
    "None in a vector": (put([0, None, 1], "gimbal", 1, "axis"), [GIMBAL_5, "element 2, None, is not a number"]),
    "None for a table": (put(None, "root"), ["root must not be None; leave the key out instead"]),
    "None in an array of tables": (put([None], "rotor"), ["[[rotor]] 1", "rotor must be a table, got None"]),
    "complex": (put(1j, "rotor", 0, "spin"), [ROTOR, "spin must be a number, got 1j", "spin must be a number, got 1j"]),
    "complex array": (put(np.array([1j, 0, 0]), "rotor", 0, "axis"), [ROTOR, "element 1, 1j, is not a number"]),
    "array of booleans": (put(np.eye(3, dtype=bool)[0], "rotor", 0, "axis"), [ROTOR, "true, is not a number"]),
    "array of words": (put(np.array(["a", "b", "c"]), "rotor", 0, "axis"), [ROTOR, 'element 1, "a", is not']),
    "array with NaN": (put(np.array([0, np.nan, 1]), "rotor", 0, "axis"), [ROTOR, "element 2, nan, is not finite"]),
    "array of four": (put(np.ones(4), "rotor", 0, "axis"), [ROTOR, "has 4 elements"]),
    "array of three dimensions": (put(np.ones((3, 3, 3)), "root", "inertia"), ["[root]", "row 1 element 1"]),
    "array of dimension zero": (
        put(np.array(2.0), "rotor", 0, "axis"),
        [
            ROTOR,
            "axis must be a vector of three numbers that is not zero, got 2.0",
            "axis must be a vector of three numbers that is not zero, got 2.0",
        ],
    ),
    "NumPy boolean": (put(np.True_, "rotor", 0, "spin"), [ROTOR, "spin must be a number, got an object of type bool"]),
    "decimal": (
        put(Decimal("0.1"), "rotor", 0, "spin"),
        [ROTOR, "an object of type Decimal", "spin must be a number, got an object of type Decimal"],
    ),
    "integer too long to print": (
        put(10**10000, "gimbal", 1, "name"),
        ["[[gimbal]] 2 an integer of 33220 bits: name must be a line of text that is not e"],
    ),
    "integer too long for a float": (put([0, 10**10000, 0], "rotor", 0, "axis"), [ROTOR, "is too large"]),
    "set": (put({1.0, 2.0}, "gimbal", 1, "stops"), [GIMBAL_5, "an object of type set", "[lower, upper]"]),
    "bytes": (
        put(b"5", "gimbal", 1, "name"),
        [
            "[[gimbal]] 2",
            "an object of type bytes",
            "name must be a line of text that is not empty, got an object of type bytes",
        ],
    ),
    "a class": (
        put(int, "rotor", 0, "spin"),
        [ROTOR, "an object of type type", "spin must be a number, got an object of type type"],
    ),
    "key not a word": (put(1, "gimbal", 1, 3), [GIMBAL_5, "the key 3", "printable text"]),
    "key of two lines": (put(1, "a\nb"), [r'the key "a\nb"', "printable text"]),
    "name with half a character": (put("\ud800", "gimbal", 1, "name"), ["[[gimbal]] 2", r"\ud800", "printed"]),
    "key with half a character": (put(1, "gimbal", 1, "\ud800"), [GIMBAL_5, r"\ud800"]),
    "list that holds itself": (put(ENDLESS, "rotor", 0, "axis"), [ROTOR, "nested deeper than"]),
    "table that holds itself": (put([ENDLESS_TABLE], "gimbal"), ['[[gimbal]] 1 "4"']),
    "long text": (
        put("x" * 10**6, "gimbal", 1, "parent"),
        [GIMBAL_5, " ...", 'parent must be the name of the root or a gimbal, got "xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx'],
    ),
}


@pytest.mark.parametrize(("change", "fragments"), PYTHON_MISTAKES.values(), ids=PYTHON_MISTAKES.keys())
def test_a_python_object_of_the_wrong_kind_is_one_short_line(change: Change, fragments: list[str]) -> None:
    data = plant()
    change(data)
    message = refusal(read_platform, data)
    assert len(message) < 400
    for fragment in fragments:
        assert fragment in message


TOML_MISTAKES = {
    "syntax": (b"schema = 1\nname = \n", ["is not TOML", "line 2, column 8"]),
    "key twice": (b"schema = 1\nschema = 1\n", ["is not TOML", "line 2"]),
    "unfinished": (b'name = "abc', ["is not TOML"]),
    "long integer": (b"schema = " + b"1" * 5000, ["is not TOML", "too many digits"]),
    "deep nesting": (b"schema = " + b"[" * 100_000, ["is not TOML", "nested too deeply"]),
    "not UTF-8": (b'name = "\xff"', ["is not UTF-8 text", "byte 8"]),
    "a date": (
        b"schema = 1\nname = 2020-01-01\n[root]\n",
        ["name must be a line of text that is not empty, got an object of type date", "(and 2 more: "],
    ),
    "empty": (b"", ['the key "schema" is missing', "(and 2 more: name, root)"]),
}


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("motor", "torquer"),
        ("Motor", "torquer"),
        ("actuator", "torquer"),
        ("gyro", "rate_sensor"),
        ("tracker", "attitude_sensor"),
        ("flywheel", "rotor"),
        ("frame", "gimbal"),
        ("bearing", "friction"),
        ("cable", "spring"),
        ("camera", "line_of_sight"),
        ("rotro", "rotor"),
        ("frictoin", "friction"),
        ("servo", None),
    ],
)
def test_another_word_for_a_table_is_no_misspelling(word: str, meant: str | None) -> None:
    message = refusal(read_platform, plant() | {word: [{"gimbal": "4"}]})
    assert (f'did you mean "{meant}"?' in message) == (meant is not None)
    assert ("known: " in message) == (meant is None)


def test_stops_beyond_a_turn_are_read_in_degrees_and_written_so() -> None:
    data = plant()
    data["gimbal"][1]["stops"] = [-2.0 * math.pi, 6.2]
    read_platform(data)
    del data["gimbal"][1]["stops"]
    data["gimbal"][1]["stops_deg"] = [-720, 540.1]
    platform = read_platform(data)
    assert platform.gimbals[1].stops == (math.radians(-720), math.radians(540.1))
    assert read_back(platform).gimbals[1].stops == platform.gimbals[1].stops


@pytest.mark.parametrize(("content", "fragments"), TOML_MISTAKES.values(), ids=TOML_MISTAKES.keys())
def test_a_broken_file_is_one_line(content: bytes, fragments: list[str], tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_bytes(content)
    message = refusal(read_platform, file)
    assert message.startswith(f"{file}: ")
    for fragment in fragments:
        assert fragment in message


def test_a_file_that_cannot_be_opened_is_one_line(tmp_path: Path) -> None:
    missing = tmp_path / "nowhere.toml"
    assert refusal(read_platform, missing) == f"{missing}: there is no such file"
    assert refusal(read_platform, str(missing)) == f"{missing}: there is no such file"
    assert "is a directory" in refusal(read_platform, tmp_path) or os.name == "nt"
    assert "cannot be read" in refusal(read_platform, "a\0b.toml")
    assert "cannot be read" in refusal(read_platform, "x" * 10_000 + ".toml")
    assert "\\n" in refusal(read_platform, "a\nb.toml")
    file = tmp_path / "file.toml"
    file.write_text("")
    assert refusal(read_platform, file / "plant.toml").startswith(str(file))


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_a_file_that_links_to_itself_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    assert "cannot be read" in refusal(read_platform, tmp_path / "loop.toml")


@pytest.mark.parametrize("source", [None, 3, b"three_gyro_platform", [], "", object(), 1j])
def test_a_source_that_is_no_source_is_one_line(source: object) -> None:
    assert "the argument must be the name of a shipped model, a path or a dict, got " in refusal(read_platform, source)


def test_an_unknown_shipped_name_gets_the_nearest_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    message = refusal(read_platform, "three_gyro_platfrom")
    assert 'no shipped model "three_gyro_platfrom"' in message
    assert 'did you mean "three_gyro_platform"?' in message
    assert "known: " in refusal(read_platform, "zzz")
    assert '"three_gyro_platform"' in refusal(read_platform, "zzz")
    for odd in ("x" * 10_000, "a\0b", "a\nb", " ", "\ud800"):
        assert "there is no shipped model" in refusal(read_platform, odd)
    assert 'the name of a shipped model must be a string, got ["three_gyro_platform"]' in refusal(
        platform_source, ["three_gyro_platform"]
    )
    monkeypatch.chdir(tmp_path)
    (tmp_path / "zzz").write_text(toml_file(plant()), encoding="utf-8")
    assert 'a file of that name is read as "./zzz"' in refusal(read_platform, "zzz")
    assert read_platform("./zzz").name == "two gimbals"
    assert read_platform(Path("zzz")).name == "two gimbals"


def test_of_several_mistakes_the_first_in_the_files_order_is_told_and_the_others_placed() -> None:
    data = plant()
    put(-1, "torquer", 0, "limit")(data)
    put("nobody", "rotor", 0, "carrier")(data)
    put([0, 0, 0], "gimbal", 1, "axis")(data)
    put("platfrom", "gimbal", 0, "parent")(data)
    for path, fragment, more in (
        (
            ("gimbal", 0, "parent"),
            'parent must be the name of the root or a gimbal, got "platfrom"; did you mean "platform"',
            ' (and 3 more: [[gimbal]] 2 "5": axis, [[rotor]] 1 "6": carrier, [[torquer]] 1 (gimbal "4"): limit)',
        ),
        (
            ("gimbal", 1, "axis"),
            "of length zero",
            ' (and 2 more: [[rotor]] 1 "6": carrier, [[torquer]] 1 (gimbal "4"): limit)',
        ),
        (
            ("rotor", 0, "carrier"),
            'carrier must be the name of the root or a gimbal, got "nobody"; known: "platform", "4", ',
            ' (and 1 more: [[torquer]] 1 (gimbal "4"): limit)',
        ),
        (("torquer", 0, "limit"), "limit must be a number > 0, got -1", ""),
    ):
        message = refusal(read_platform, data)
        assert fragment in message
        assert message.endswith(more)
        assert ("more: " in message) == bool(more)
        put(enter(plant(), path) if path != ("rotor", 0, "carrier") else "5", *path)(data)
    read_platform(data)


def test_the_files_order_counts_and_not_ours() -> None:
    data = plant()
    data["rotor"][0]["axis"] = [0, 0, 0]
    data["gimbal"][0]["axis"] = [0, 0, 0]
    assert "[[gimbal]] 1" in refusal(read_platform, data)
    assert "[[rotor]] 1" in refusal(read_platform, dict(reversed(data.items())))


def test_a_name_that_cannot_be_read_does_not_make_its_references_wrong() -> None:
    data = plant()
    data["gimbal"].reverse()
    data["gimbal"][1]["name"] = 4
    message = refusal(read_platform, data)
    assert "[[gimbal]] 2 4: name must be a line of text that is not empty, got 4" in message
    assert "more)" not in message


def test_a_gimbal_that_hangs_on_a_cycle_is_not_blamed_for_it() -> None:
    data = plant()
    data["gimbal"].insert(0, dict(data["gimbal"][1], name="0", parent="4"))
    data["gimbal"][1]["parent"] = "5"
    message = refusal(read_platform, data)
    assert '[[gimbal]] 2 "4"' in message
    assert "more)" not in message


def test_what_is_read_is_in_si_units_and_normalised() -> None:
    data = plant()
    data["gimbal"][0]["stops_deg"] = [-90, 180]
    data["gimbal"][0]["axis"] = [0, 3e300, 4e300]
    data["rotor"].append(dict(data["rotor"][0], name="7", carrier="platform", control="free"))
    platform = read_platform(data)
    assert (platform.name, platform.source, platform.root_name) == ("two gimbals", "invented", "platform")
    assert platform.gimbal_names == ("4", "5")
    assert platform.angle_names == ("alpha4", "q_5")
    assert platform.parents.tolist() == [-1, 0]
    assert platform.carriers.tolist() == [1, -1]
    assert platform.gimbals[0].stops == pytest.approx((-math.pi / 2, math.pi))
    assert platform.gimbals[1].stops == (-0.1, 0.2)
    np.testing.assert_allclose(platform.gimbals[0].axis, [0, 0.6, 0.8], rtol=1e-15)
    np.testing.assert_array_equal(platform.gimbals[1].axis, [0, 0, -1])
    np.testing.assert_array_equal(platform.gimbals[0].inertia, np.diag([3, 4, 5]))
    np.testing.assert_array_equal(platform.root_inertia, data["root"]["inertia"])
    assert [rotor.angular_momentum for rotor in platform.rotors] == [50.0, 50.0]
    assert [rotor.control for rotor in platform.rotors] == ["regulated", "free"]
    assert [torquer.name for torquer in platform.torquers] == ["Q4", "Q5", "M1"]
    assert [torquer.limit for torquer in platform.torquers] == [0.5, None, None]
    assert [torquer.lag for torquer in platform.torquers] == [0.001, 0.0, 0.0]
    assert [torquer.root_axis for torquer in platform.torquers] == [None, None, 1]
    assert [pickoff.name for pickoff in platform.pickoffs] == ["q_5", "alpha4"]
    assert [pickoff.noise_rms for pickoff in platform.pickoffs] == [1e-6, 0.0]


def test_rounding_of_printed_numbers_is_forgiven() -> None:
    data = plant()
    data["rotor"][0] |= {"axial_inertia": 2.0, "transverse_inertia": 1.0 - 1e-12}
    data["gimbal"][0]["inertia"] = [1.0, 2.0, 3.0 + 1e-10]
    data["root"]["inertia"] = [[1, 0.1 + 1e-12, 0], [0.1, 1, 0], [0, 0, 1]]
    inertia = read_platform(data).root_inertia
    np.testing.assert_array_equal(inertia, inertia.T)


def test_only_a_root_is_a_platform_too() -> None:
    platform = read_platform({"schema": 1, "name": "rigid", "root": {"name": "case", "inertia": (1, 1, 1)}})
    assert platform.gimbals == platform.rotors == platform.torquers == platform.pickoffs == ()


def test_tuples_arrays_and_numpy_numbers_read_like_lists_and_numbers() -> None:
    data = plant()
    data["root"]["inertia"] = np.array(data["root"]["inertia"])
    data["gimbal"] = tuple(data["gimbal"])
    data["gimbal"][0]["axis"] = np.array([0, 2, 0])
    data["gimbal"][1]["stops"] = (np.float32(-0.5), np.int64(1))
    data["torquer"][2]["root_axis"] = np.int8(1)
    data["rotor"][0]["name"] = np.str_("6")
    platform = read_platform(data)
    np.testing.assert_array_equal(platform.gimbals[0].axis, [0, 1, 0])
    assert platform.gimbals[1].stops == (-0.5, 1.0)
    assert platform.torquers[2].name == "M1"


def test_reading_leaves_the_dict_alone() -> None:
    data = plant()
    read_platform(data)
    assert data == plant()


def test_a_byte_order_mark_and_windows_line_ends_are_read_over(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_bytes(b"\xef\xbb\xbf" + toml_file(plant()).replace("\n", "\r\n").encode())
    assert read_platform(file).name == "two gimbals"


def arrays_of(platform: Any) -> list[np.ndarray]:
    bodies = [*platform.gimbals, *platform.rotors]
    return [platform.root_inertia, *(b.axis for b in bodies), *(g.inertia for g in platform.gimbals)]


def test_arrays_are_read_only_and_stay_so_through_pickle_and_deepcopy() -> None:
    platform = read_platform(plant())
    for copied in (platform, copy.deepcopy(platform), pickle.loads(pickle.dumps(platform))):
        for array, original in zip(arrays_of(copied), arrays_of(platform), strict=True):
            np.testing.assert_array_equal(array, original)
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0
        assert copied.gimbal_names == platform.gimbal_names


def test_every_shipped_model_is_read_by_name_and_from_a_copy_of_its_text(tmp_path: Path) -> None:
    assert "three_gyro_platform" in shipped_models()
    for name in shipped_models():
        copied = tmp_path / f"{name}.toml"
        copied.write_text(platform_source(name), encoding="utf-8")
        platform = read_platform(name)
        assert platform.source
        assert plant_data(read_platform(copied)) == plant_data(platform)


def test_the_three_gyro_platform_has_the_sums_and_nutations_of_its_comments() -> None:
    platform = read_platform("three_gyro_platform")
    assert platform.gimbal_names == ("4", "5", "7", "9", "10")
    assert platform.angle_names == ("alpha4", "beta5", "beta7", "alpha9", "beta10")
    assert [t.name for t in platform.torquers] == ["Q4", "Q5", "Q7", "Q9", "Q10", "M1", "M2", "M3"]
    assert [p.name for p in platform.pickoffs] == list(platform.angle_names)
    body = {gimbal.name: gimbal.inertia.copy() for gimbal in platform.gimbals}
    for rotor in platform.rotors:
        body[rotor.carrier] += rotor.transverse_inertia * (np.eye(3) - np.outer(rotor.axis, rotor.axis))
    j4 = body["4"][1, 1] + body["5"][1, 1] + body["7"][1, 1]
    j5, j7, j10 = body["5"][2, 2], body["7"][2, 2], body["10"][0, 0]
    j9 = body["9"][2, 2] + body["10"][2, 2]
    np.testing.assert_allclose([j4, j5, j7, j9, j10], [8e-4, 2e-4, 2e-4, 5e-4, 2e-4], rtol=1e-14)
    momentum = {rotor.name: rotor.angular_momentum for rotor in platform.rotors}
    assert momentum == {"6": 0.15, "8": 0.15, "11": 0.15}
    assert math.sqrt(2) * momentum["6"] / math.sqrt(j4 * j5) == pytest.approx(530.3, abs=0.05)
    assert momentum["11"] / math.sqrt(j9 * j10) == pytest.approx(474.3, abs=0.05)
    turns = {g.name: (g.parent, g.axis.tolist()) for g in platform.gimbals}
    assert turns == {
        "4": ("platform", [0, 1, 0]),
        "5": ("4", [0, 0, 1]),
        "7": ("4", [0, 0, -1]),
        "9": ("platform", [0, 0, 1]),
        "10": ("9", [1, 0, 0]),
    }
    spins = {r.name: (r.carrier, r.axis.tolist()) for r in platform.rotors}
    assert spins == {"6": ("5", [1, 0, 0]), "8": ("7", [-1, 0, 0]), "11": ("10", [0, 1, 0])}


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([0, -1, 10**400, 10**5000, math.nan, math.inf, 1e308, 5e-324, 1j, b"x", object(), int]),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from(["4", "5", "6", "platform", "M1", "Omega1", "alpha4", "free", "caging", "a\nb", "\u2028"]),
    st.lists(st.floats(), max_size=4),
    st.lists(st.floats(), min_size=3, max_size=3).map(np.array),
    st.recursive(
        st.integers() | st.none() | st.text(max_size=3),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4) | st.integers(), inner),
        max_leaves=8,
    ),
)


def mutate(data: Any, chance: random.Random, junk: Any) -> None:
    """Change, delete, double or misspell one entry somewhere in nested tables."""
    while True:
        keys = list(data) if isinstance(data, dict) else list(range(len(data)))
        if not keys:
            return
        key = chance.choice(keys)
        if isinstance(data[key], dict | list) and data[key] and chance.random() < 0.8:
            data = data[key]
            continue
        match chance.randrange(4):
            case 0:
                del data[key]
            case 1 if isinstance(data, list):
                data.append(copy.deepcopy(data[key]))
            case 1:
                data[str(key)[::-1]] = data.pop(key)
            case _:
                data[key] = junk
        return


@settings(max_examples=100, deadline=None)
@given(junk=st.lists(JUNK, min_size=1, max_size=4), chance=st.randoms(use_true_random=False))
def test_whatever_is_changed_a_plant_is_read_or_refused_in_one_line(junk: list[Any], chance: random.Random) -> None:
    data = plant()
    for item in junk:
        mutate(data, chance, item)
    platform = outcome(read_platform, data)
    if isinstance(platform, str):
        assert platform.isprintable()
    else:
        assert all(np.isfinite(array).all() for array in arrays_of(platform))
        assert platform.parents.max(initial=-1) < len(platform.gimbals)


@settings(max_examples=100, deadline=None)
@given(text=st.text(max_size=40), at=st.integers(0, 900))
def test_whatever_is_typed_into_a_file_it_is_read_or_refused_in_one_line(
    text: str, at: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    file = tmp_path_factory.getbasetemp() / "typed.toml"
    whole = toml_file(plant())
    file.write_text(whole[:at] + text + whole[at + 3 :], encoding="utf-8", newline="")
    platform = outcome(read_platform, file)
    assert not isinstance(platform, str) or platform.isprintable()


def test_a_sensor_about_all_axes_is_one_about_each_axis_of_its_body() -> None:
    """A gyro triad and a star sensor in one table read as in three."""
    gyro: dict[str, Any] = {"name": "imu", "body": "cart", "bias": 0.01, "bandwidth_hz": 100.0}
    star: dict[str, Any] = {"body": "cart", "noise_rms": 1e-5}
    base: dict[str, Any] = {
        "schema": 1,
        "name": "cart",
        "root": {"name": "base", "inertia": [1, 1, 1]},
        "gimbal": [{"name": "cart", "parent": "base", "axis": [0, 0, 1], "inertia": [1, 1, 1]}],
    }
    axes = np.eye(3).tolist()
    short = base | {"rate_sensor": [gyro | {"axis": "all"}], "attitude_sensor": [star | {"axis": "all"}]}
    long = base | {
        "rate_sensor": [gyro | {"name": f"imu{k + 1}", "axis": axes[k]} for k in range(3)],
        "attitude_sensor": [star | {"axis": axis} for axis in axes],
    }
    one, other = read_platform(short), read_platform(long)
    assert [s.name for s in one.sensors] == ["imu1", "imu2", "imu3", "cart_theta1", "cart_theta2", "cart_theta3"]
    assert plant_data(one) == plant_data(other)
    with pytest.raises(InputError, match="no_such_body"):
        read_platform(short | {"rate_sensor": [gyro | {"axis": "all", "body": "no_such_body"}]})
    with pytest.raises(InputError, match="three numbers"):
        read_platform(base | {"rate_sensor": [gyro | {"axis": "both"}]})


def read_back(platform: Platform) -> Platform:
    return read_platform(tomllib.loads(platform.to_toml()))


@pytest.mark.parametrize("name", shipped_models())
def test_the_text_of_a_shipped_plant_is_that_plant_to_the_last_bit(name: str) -> None:
    platform = read_platform(name)
    assert meaning(read_back(platform)) == meaning(platform)


def test_the_text_of_a_plant_with_every_key_is_that_plant_to_the_last_bit() -> None:
    platform = read_platform(every_plant_key())
    assert meaning(read_back(platform)) == meaning(platform)
    assert meaning(read_platform(platform)) == meaning(platform)


@settings(max_examples=30, deadline=None)
@given(motions())
def test_the_text_of_a_random_plant_is_that_plant(motion: Motion) -> None:
    back = read_back(motion.platform)
    assert meaning(back) == meaning(read_platform(motion.platform))
    q, velocity = motion.q, motion.velocity
    ours, theirs = pc.matrices(back, q, velocity), pc.matrices(motion.platform, q, velocity)
    np.testing.assert_allclose(ours.A, theirs.A, rtol=1e-14, atol=1e-14 * np.abs(theirs.A).max())


def in_python() -> Platform:
    """Return a plant that was made in Python: names with spaces, an axis of length 2, a limit that is none."""
    return Platform(
        name="made \x7f in \u00e9 Python",
        root_name="the base",
        root_inertia=np.diag([1.0, 2.0, 2.5]),
        gimbals=(
            Gimbal(name="outer ring", parent="the base", axis=[0, 0, 2.0], inertia=0.1 * np.eye(3), stops=(-1, 1)),
            Gimbal(name="inner", parent="outer ring", axis=[0.6, 0.8, 0.0], inertia=[[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        ),
        torquers=(Torquer(gimbal="outer ring", limit=math.inf), Torquer(gimbal="inner", limit=0.1, lag=0.0)),
        pickoffs=(PickOff(gimbal="outer ring"), PickOff(gimbal="inner", noise_rms=1 / 3e6)),
        rate_sensors=(
            RateSensor(body="inner", axis=[0, 1, 1], misalignment=[0.0, 0.0, 1e-3]),
            RateSensor(gimbal="inner"),
        ),
        frictions=(Friction(gimbal="inner", coulomb=(0.01, 0.02)), Friction(gimbal="outer ring", viscous=0.1 + 0.2)),
        unbalances=(Unbalance(body="the base", moment=(0.0, 1e-20, -3.0)),),
        source='"quoted"\nand\ttwo lines \\',
    )


def test_a_plant_that_was_made_in_python_is_written_and_read_back() -> None:
    platform = in_python()
    with pytest.raises(InputError, match=r'platform "made .*": name must be a line of text .* cannot be printed'):
        read_platform(platform)
    platform = dataclasses.replace(platform, name="made in \u00e9 Python")
    back = read_back(platform)
    assert meaning(back) == meaning(read_platform(platform)) == meaning(read_back(back))
    assert back.torquers[0].limit is None
    assert back.gimbals[0].axis.tolist() == [0.0, 0.0, 1.0]
    assert (back.source, back.gimbal_names) == (platform.source, ("outer ring", "inner"))
    assert meaning((back.frictions, back.unbalances, back.pickoffs, back.rate_sensors[1])) == meaning(
        (platform.frictions, platform.unbalances, platform.pickoffs, platform.rate_sensors[1])
    )


def test_what_no_plant_file_can_say_is_refused() -> None:
    platform = dataclasses.replace(in_python(), pickoffs=(PickOff(name="resolver", gimbal="inner"),))
    with pytest.raises(ArgumentError, match="pick-off 'resolver' must be called 'q_inner', as its angle"):
        platform.to_toml()
