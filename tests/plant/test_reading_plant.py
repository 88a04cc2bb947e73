"""Plant files: what is read, and that every mistake is one line that names its place."""

from __future__ import annotations

import copy
import json
import math
import os
import pickle
import random
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
from platform_ctrl import Platform, platform_source, read_platform, shipped_models
from platform_ctrl.errors import InputError

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


ENDLESS: list[Any] = []
ENDLESS.extend([ENDLESS] * 10)
ENDLESS_TABLE: dict[str, Any] = {"name": "4"}
ENDLESS_TABLE["axis"] = ENDLESS_TABLE

# What stands where, and what the line contains.
PYTHON_MISTAKES: list[tuple[tuple[Any, ...], object, str]] = [
    (("gimbal", 1, "angle"), None, '[[gimbal]] 2 "5" … angle must not be None; leave the key out instead'),
    (("gimbal", 1, "axis"), [0, None, 1], '[[gimbal]] 2 "5" … element 2, None, is not a number'),
    (("rotor",), [None], "[[rotor]] 1 … rotor must be a table, got None"),
    (("rotor", 0, "spin"), 1j, '[[rotor]] 1 "6" … spin must be a number, got 1j'),
    (("rotor", 0, "axis"), np.array([0, np.nan, 1]), '[[rotor]] 1 "6" … element 2, nan, is not finite'),
    (("root", "inertia"), np.ones((3, 3, 3)), "[root] … row 1 element 1"),
    (("rotor", 0, "spin"), np.True_, '[[rotor]] 1 "6" … spin must be a number, got true'),
    (("rotor", 0, "spin"), Decimal("0.1"), '[[rotor]] 1 "6" … must be a number, got an object of type Decimal'),
    (("gimbal", 1, "name"), 10**10000, "[[gimbal]] 2 an integer of 33220 bits: name must be a line"),
    (("rotor", 0, "axis"), [0, 10**10000, 0], '[[rotor]] 1 "6" … is too large'),
    (("gimbal", 1, 3), 1, '[[gimbal]] 2 "5" … the key 3 … printable text'),
    (("gimbal", 1, "name"), "\ud800", "[[gimbal]] 2 … \\ud800 … printed"),
    (("rotor", 0, "axis"), ENDLESS, '[[rotor]] 1 "6" … nested deeper than'),
    (("gimbal",), [ENDLESS_TABLE], '[[gimbal]] 1 "4"'),
    (("gimbal", 1, "parent"), "x" * 10**6, '[[gimbal]] 2 "5" …  ... … the root or a gimbal, got "xxxxxxxxxxxx'),
]


def test_a_python_object_of_the_wrong_kind_is_one_short_line() -> None:
    for path, value, words in PYTHON_MISTAKES:
        data = plant()
        enter(data, path[:-1])[path[-1]] = value
        message = refusal(read_platform, data)
        assert len(message) < 400
        assert all(word in message for word in words.split(" … ")), message


TOML_MISTAKES = {
    "syntax": (b"schema = 1\nname = \n", ["is not TOML", "line 2, column 8"]),
    "long integer": (b"schema = " + b"1" * 5000, ["is not TOML", "too many digits"]),
    "deep nesting": (b"schema = " + b"[" * 100_000, ["is not TOML", "nested too deeply"]),
    "not UTF-8": (b'name = "\xff"', ["is not UTF-8 text", "byte 8"]),
    "a date": (
        b"schema = 1\nname = 2020-01-01\n[root]\n",
        ["name must be a line of text that is not empty, got an object of type date", "(and 2 more: "],
    ),
    "empty": (b"", ['the key "schema" is missing', "(and 2 more: name, root)"]),
}


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
    assert refusal(read_platform, missing).startswith(f"{missing}: there is no such file; give a TOML file")
    assert refusal(read_platform, str(missing)) == refusal(read_platform, missing)
    assert "is a directory" in refusal(read_platform, tmp_path) or os.name == "nt"
    assert "cannot be read" in refusal(read_platform, "a\0b.toml")
    assert "cannot be read" in refusal(read_platform, "x" * 10_000 + ".toml")
    assert "\\n" in refusal(read_platform, "a\nb.toml")
    file = tmp_path / "file.toml"
    file.write_text("")
    assert refusal(read_platform, file / "plant.toml").startswith(str(file))


@pytest.mark.parametrize("source", [None, b"three_gyro_platform", ""])
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
    st.lists(st.integers() | st.none() | st.lists(st.text(max_size=3), max_size=2), max_size=3),
    st.dictionaries(st.text(max_size=4) | st.integers(), st.none() | st.lists(st.integers(), max_size=2), max_size=3),
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
    assert one.to_toml() == other.to_toml()
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
