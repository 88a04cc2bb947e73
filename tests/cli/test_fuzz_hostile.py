"""What fuzzing and people with bad luck have found, by name; and paths that are no files."""

from __future__ import annotations

import copy
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import platform_ctrl as pc
from fuzz_files import EVERY_JOB_KEY, EVERY_PLANT_KEY, HERE, put, written
from fuzz_run import ended
from platform_ctrl.plant.source import MOST_OF_TOML

CONTROLLERS = ("--controllers", "controllers.json")


@pytest.fixture(autouse=True)
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("every_plant_key.toml", "every_job_key.toml", "vehicle.csv", "controllers.json"):
        shutil.copy(HERE / name, tmp_path)
    return tmp_path


def plant_error(plant: dict[str, Any] | str) -> str:
    Path("plant.toml").write_text(plant if isinstance(plant, str) else written(plant), encoding="utf-8")
    return ended("equations", "plant.toml", "-q", folder=Path()).error


def job_error(job: dict[str, Any] | str) -> str:
    Path("job.toml").write_text(job if isinstance(job, str) else written(job), encoding="utf-8")
    return ended("check", "job.toml", *CONTROLLERS, "-q", folder=Path()).error


def gimbals(count: int, parent: str = "platform") -> dict[str, Any]:
    plant = EVERY_PLANT_KEY.data
    return {
        "schema": 1,
        "name": "many",
        "root": plant["root"],
        "gimbal": [
            {"name": f"g{k}", "parent": parent, "axis": [1, 0, 0], "inertia": [1.0, 1.0, 1.0]} for k in range(count)
        ],
    }


@pytest.mark.parametrize("parent", ["platform", "nobody", "g1"])
def test_thousands_of_gimbals_are_counted_and_not_judged_one_by_one(parent: str) -> None:
    assert "gimbal has 5000 elements; at most 100 are allowed" in plant_error(gimbals(5000, parent))


def test_a_hundred_gimbals_that_hang_on_nobody_are_one_line_of_a_few_names() -> None:
    error = plant_error(gimbals(100, "nobody"))
    assert '[[gimbal]] 1 "g0": parent must be the name of the root or a gimbal, got "nobody"' in error
    assert len(error) < 400


def test_a_file_of_any_size_is_refused_by_its_size() -> None:
    assert "plant.toml: is larger than 1 MiB" in plant_error("a = [" + "1, " * MOST_OF_TOML + "]")


@pytest.mark.parametrize(
    "text",
    [
        "a." * (MOST_OF_TOML // 3) + "b = 1",
        "[" + "a." * (MOST_OF_TOML // 3) + "b]",
        'x = { "a"' + ". b " * (MOST_OF_TOML // 5) + " = 1 }",
        "a = " + "[" * 100_000,
        "a = " + "{a = " * 100_000,
        "a = " + "9" * 1_000_000,
        "".join(f"k{k} = 1\n" for k in range(90_000)),
        "[campaign]\n" + "".join(f"[[campaign.vary]]\nk{k} = 1\n" for k in range(40_000)),
        "loop = [" + "1, " * 200_000 + "]",
        "".join(f"[[manoeuvre]]\nfaults = [{', '.join(repr(f'f{j}') for j in range(90))}]\n" for _ in range(900)),
    ],
    ids=lambda text: text[:20].strip(),
)
def test_what_takes_a_parser_or_a_judge_for_ever_is_refused_in_time(text: str) -> None:
    assert job_error(text).startswith("job.toml: ")


def test_numbers_that_nothing_has_are_refused_where_they_stand() -> None:
    for number, words in ((2e50, "larger than 1e+50"), (5e-324, "smaller than 1e-50")):
        error = plant_error(put(EVERY_PLANT_KEY.data, ("rotor", 0, "axial_inertia"), number))
        assert f'[[rotor]] 1 "wheel": axial_inertia must be a number > 0, got {number} ({words}' in error


@pytest.mark.parametrize(
    ("place", "number", "words"),
    [
        (
            ("manoeuvre", 0, "duration"),
            1e12,
            "duration must be at most 1e+07 sample periods, got 1000000000000.0 s, 2e+15 of them",
        ),
        (("sampling", "rate_hz"), 1e12, "sample periods"),
        (
            ("campaign", "step"),
            1e-30,
            "step must leave [[manoeuvre]] 1 at most 1e+09 steps, got 1e-30 s, 1.2e+28 steps",
        ),
        (("campaign", "runs"), 10**12, "a whole number from 1 to 2^30"),
        (("campaign", "vary", 1, "deviation"), 1e9, "times the median or more"),
        (("manoeuvre", 0, "vibration", 0, "lines"), 10**9, "a whole number from 1 to 4096"),
        (("loop", 0, "name"), "caging 9.10", "has a full stop, which no controller's name may have"),
    ],
)
def test_a_job_that_would_never_end_is_refused_when_it_is_read(
    place: tuple[str | int, ...], number: object, words: str
) -> None:
    assert words in job_error(put(EVERY_JOB_KEY.data, place, number))


def test_signals_have_no_full_stops_as_control_systems_want_it() -> None:
    error = plant_error(put(EVERY_PLANT_KEY.data, ("gimbal", 0, "angle"), "alpha.1"))
    assert 'angle = "alpha.1" has a full stop, which no signal may have' in error
    plant = gimbals(1)
    plant["gimbal"][0]["name"] = "4.1"
    assert 'the default name "q_4.1" has a full stop' in plant_error(plant)


def test_a_wrong_relative_is_blamed_itself() -> None:
    error = job_error(put(EVERY_JOB_KEY.data, ("campaign", "vary", 1, "relative"), 1))
    assert "relative must be true or false, got 1" in error


def simulated(job: dict[str, Any], which: str = "--manoeuvre", number: str = "1") -> dict[str, Any]:
    Path("job.toml").write_text(written(job), encoding="utf-8")
    found = ended("simulate", "job.toml", which, number, *CONTROLLERS, "-o", "out", "--json", seconds=60.0)
    record: dict[str, Any] = json.loads(found.out)
    assert found.code == (0 if record["passed"] else 1)
    return record


def test_a_run_that_diverges_at_a_stop_counts_its_contacts() -> None:
    record = simulated(put(EVERY_JOB_KEY.data, ("manoeuvre", 0, "initial", "q_inner_rate"), 1e12))
    assert record["ended"].startswith("diverged")
    assert all(0 <= contacts <= 2 for contacts in record["stop_contacts"].values())


def test_a_run_that_diverges_does_not_pass_because_nothing_is_asked() -> None:
    job = put(EVERY_JOB_KEY.data, ("manoeuvre", 1, "torque"), 1e12)
    job["manoeuvre"][1].pop("limits")
    record = simulated(job, number="2")
    assert (record["passed"], record["ended"]) == (False, "diverged at t = 0.0005 s")


def test_a_step_longer_than_a_period_is_a_period() -> None:
    record = simulated(put(EVERY_JOB_KEY.data, ("campaign", "step"), 1e9), "--run", "0")
    assert record["ended"] == "completed"


@pytest.mark.parametrize("name", ["[/red]", "[bold]x", ":smile:", "{0} %s {{x}}", "$x_{$"])
def test_names_stand_on_the_screen_as_they_are(name: str) -> None:
    job = put(EVERY_JOB_KEY.data, ("manoeuvre", 0, "name"), name)
    job["campaign"].pop("manoeuvre")
    Path("job.toml").write_text(written(job), encoding="utf-8")
    plant = put(EVERY_PLANT_KEY.data, ("gimbal", 1, "angle"), name)
    text = written(job).replace("q_inner_rate", f'"{name}_rate"').replace('part = "q_inner"', f'part = "{name}"')
    Path("job.toml").write_text(text, encoding="utf-8")
    Path("every_plant_key.toml").write_text(written(plant), encoding="utf-8")
    text = Path("controllers.json").read_text(encoding="utf-8").replace("q_inner", name)
    Path("controllers.json").write_text(text, encoding="utf-8")
    found = ended("simulate", "job.toml", "--manoeuvre", "1", *CONTROLLERS, "-q", seconds=60.0)
    assert found.out.splitlines()[0].rstrip() == name
    assert f"rad ({name})" in found.out


def test_a_plant_too_fast_to_be_sampled_is_refused_before_anything_is_designed() -> None:
    plant = put(put(EVERY_PLANT_KEY.data, ("rotor", 0, "spin"), 1e20), ("rotor", 0, "control"), "regulated")
    for key in ("speed_gain", "speed_integral", "torque_limit"):
        del plant["rotor"][0][key]
    Path("every_plant_key.toml").write_text(written(plant), encoding="utf-8")
    found = ended("design", "every_job_key.toml", "-q", "-o", "out")
    assert "rate_hz = 2000: in a sample period plant Jouter" in found.error
    assert "or grows as fast, more than 1e+06" in found.error


@pytest.mark.parametrize(
    ("key", "item"),
    [
        ("A", [[1.0] * 1001] * 1001),
        ("A", [[1.0]] * 9),
        ("D", [[[[[[]]]]]]),
        ("dt", [[]]),
        ("inputs", [[1]]),
        ("outputs", {}),
        ("B", None),
    ],
)
def test_hostile_matrices_are_refused_by_their_name(key: str, item: object) -> None:
    data = json.loads(Path("controllers.json").read_text(encoding="utf-8"))
    data["controllers"][0][key] = copy.deepcopy(item)
    Path("controllers.json").write_text(json.dumps(data), encoding="utf-8")
    error = ended("check", "every_job_key.toml", *CONTROLLERS, "-o", "out", "-q", folder=Path()).error
    assert error.startswith("controllers.json: controllers 1 ")
    assert len(error) < 400


POSIX = pytest.mark.skipif(os.name != "posix", reason="devices, pipes and names as POSIX has them")


@POSIX
@pytest.mark.parametrize("command", ["plant", "job", "controllers"])
@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("folder", "is a directory"),
        ("loop", "cannot be read"),
        ("dangling", "there is no such file"),
        ("/dev/zero", "is larger than"),
        ("/dev/null", ""),
        ("pipe", "is a pipe that nobody writes to"),
        ("every_job_key.toml/x", "cannot be read"),
        ("x" * 5000, "cannot be read"),
    ],
)
def test_paths_that_are_no_files_are_refused_by_their_name(path: str, words: str, command: str) -> None:
    Path("folder").mkdir()
    Path("loop").symlink_to("loop")
    Path("dangling").symlink_to("nothing")
    os.mkfifo("pipe")
    given = {
        "plant": ("equations", f"./{path}" if not path.startswith("/") else path, "-q"),
        "job": ("check", path, "-q"),
        "controllers": ("check", "every_job_key.toml", "-q", "--controllers", path, "-o", "out"),
    }[command]
    error = ended(*given, seconds=20.0).error
    assert words in error
    assert path in error


@POSIX
def test_a_pipe_that_somebody_writes_to_is_read() -> None:
    os.mkfifo("pipe.toml")
    writer = threading.Thread(target=lambda: Path("pipe.toml").write_text(EVERY_JOB_KEY.text, encoding="utf-8"))
    writer.start()
    assert ended("check", "pipe.toml", "--controllers", "none.json", "-q").error.startswith("none.json: ")
    writer.join()


def process(*arguments: str | bytes) -> subprocess.Popen[bytes]:
    path = str(Path(pc.__file__).parents[1])
    return subprocess.Popen(
        [sys.executable, "-m", "platform_ctrl", *arguments],
        env=os.environ | {"PYTHONPATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


@POSIX
@pytest.mark.skipif(sys.platform == "darwin", reason="file names there are UTF-8")
def test_a_process_names_a_file_whose_name_is_no_utf_8() -> None:
    name = b"job\xff\x1b[31m.toml"
    Path(os.fsdecode(name)).write_text("schema = nan\n", encoding="utf-8")
    started = process(b"check", name)
    out, err = started.communicate(timeout=60)
    assert (started.returncode, out) == (2, b"")
    assert err.startswith(b"platform-ctrl: error: job\\udcff\\x1b[31m.toml: the key")
    assert err.decode("ascii").rstrip("\n").isprintable()


@POSIX
def test_a_long_run_heeds_an_interrupt_at_once() -> None:
    job = put(put(EVERY_JOB_KEY.data, ("manoeuvre", 0, "duration"), 4000.0), ("campaign",), {"runs": 1})
    Path("long.toml").write_text(written(job), encoding="utf-8")
    simulated(EVERY_JOB_KEY.data)  # compiled, and kept
    started = process("simulate", "long.toml", "--manoeuvre", "1", *CONTROLLERS)
    assert started.stderr is not None
    line = b""
    while b"simulated run" not in line:
        line = started.stderr.readline()
    time.sleep(3.0)
    started.send_signal(signal.SIGINT)
    began = time.monotonic()
    _, err = started.communicate(timeout=100)
    assert started.returncode == 130
    assert err.splitlines()[-1] == b"platform-ctrl: interrupted"
    assert time.monotonic() - began < 60.0  # the run itself takes minutes
