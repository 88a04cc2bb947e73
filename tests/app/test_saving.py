"""A state of the designer as a link, as a job file with its controllers, and what is worked out beside the page."""

from __future__ import annotations

import json
import math
import re
import threading
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cli.test_cli import JOB as THREE
from platform_ctrl.analysis.system import System
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.settings import Settings, stated_limits
from platform_ctrl.app.tasks import checked_settings, decode_state, encode_state
from platform_ctrl.cli import main
from platform_ctrl.common.files import toml
from platform_ctrl.design.jobs import loops
from platform_ctrl.design.methods import read_job
from platform_ctrl.errors import DesignError, InputError, PlatformCtrlError
from platform_ctrl.plant.source import platform_source

SHIPPED = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
LOOP = "caging 9-10"
TWO = """# Kept: what the user wrote.
schema = 2
name = "two designs"
plant = "three_gyro_platform"   # a shipped one

[operation]
Omega = [1.0, 1.0, 1.0]

[uncertainty]
spin = 0.05

[sampling]
rate_hz = 2000                  # of both
delay = 0.0005

[[loop]]
name = "caging 9-10"
kind = "caging"
gimbals = ["9", "10"]
use = "by hand"

[loop.limits]
bandwidth_hz = 30
disk_margin = 0.4
damping = 0.05

[[loop.design]]
name = "by hand"
method = "classical"
tune = true
crossover_hz = 66               # the gain
notch_hz = 200

[[loop.design]]
name = "lqg"
method = "lqg"

[[manoeuvre]]
name = "turn"
mode = "caged"
axis = 1
rate = 1.0
rise = 0.1
hold = 0.05
duration = 0.3
limits = { angle = 0.01 }
"""


@pytest.fixture
def job_file(tmp_path: Path) -> Path:
    path = tmp_path / "gyro.toml"
    path.write_text(TWO)
    return path


@pytest.fixture
def bench(job_file: Path) -> Backend:
    return Backend(job_file)


@pytest.fixture(scope="module")
def shipped() -> Backend:
    return Backend(SHIPPED)


def _moved(bench: Backend, settings: Settings, **sliders: float) -> Settings:
    for name, number in sliders.items():
        settings = bench.moved(settings, name, number)
    return settings


def test_a_link_reproduces_the_state_and_is_short(shipped: Backend) -> None:
    start = shipped.start()
    assert encode_state(shipped, start) == ""
    assert decode_state(shipped, "").data() == start.data()
    settings = _moved(shipped, shipped.start(LOOP), crossover_hz=61.123456789)
    settings = shipped.with_part(settings, "lag", True)
    settings = settings.but(fixed=frozenset({"lead_hz"}), overlays=("H-infinity",), axis=3, band=False, channel="Q10")
    text = encode_state(shipped, settings)
    assert decode_state(shipped, text).data() == settings.data()
    assert len(text) < 400
    assert set(text) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_")
    servo = _moved(shipped, shipped.start("stabilisation"), position_hz=1.0)
    assert decode_state(shipped, encode_state(shipped, servo)).data() == servo.data()


def test_every_limit_that_a_job_states_has_a_row_that_edits_it(tmp_path: Path) -> None:
    job = tomllib.loads(SHIPPED.read_text())
    for loop in job["loop"]:
        loop["design"] = [one for one in loop["design"] if one["method"] in ("classical", "platform-servo")]
        loop["use"] = loop["design"][0]["name"]
    job["loop"][0]["soft"] = {"bandwidth_hz": 30.0}
    job["coupled"] = {"disk_margin": 0.1, "coupling_cost": 0.9}
    path = tmp_path / "job.toml"
    path.write_text(toml(job), encoding="utf-8")
    page = Backend(path)
    rows: set[tuple[str, str]] = set()
    changed = page.start()
    for loop in page.read.loops:
        shown = page.picture(page.start(loop.name))
        rows |= {(one.subject, one.name) for one in (*shown.requirements, *shown.measured.goals)}
    # Only that loops are stable is required without being stated.
    assert all("decay" in name or "stab" in name for _, name in rows - page.limit_names.keys()), rows
    assert set(page.limit_names.values()) == set(changed.limits)
    for name, x in page.start().limits.items():
        changed = page.with_limit(changed, name, 1.25 * x)
    assert decode_state(page, encode_state(page, changed)).data() == changed.data()
    assert (page.loops.job(changed).coupled.disk_margin, page.loops.job(changed).loops[0].soft) == (
        0.125,
        {"bandwidth_hz": 37.5},
    )
    servo = page.picture(page.chosen(changed, loop="stabilisation")).requirements
    assert next(one.limit for one in servo if "simultaneous" in one.name) == pytest.approx(0.125)
    saved = page.save(changed, tmp_path / "changed.toml")
    assert stated_limits(read_job(saved.job)) == pytest.approx(changed.limits)
    for wrong, number in ((name, -1.0), (name, math.inf), (name, "x"), ("noise", 1.0)):
        with pytest.raises(PlatformCtrlError):
            page.with_limit(changed, wrong, number)
    page.close()


@pytest.mark.parametrize("text", ["x", "é", "A" * 30_000, "eJwDAAAAAAE"])
def test_a_damaged_link_is_an_error_of_one_line(shipped: Backend, text: str) -> None:
    with pytest.raises(InputError, match=r"^link: ") as error:
        decode_state(shipped, text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "changed",
    [
        [],
        {"unknown": 1},
        {"loop": "caging 1"},
        {"options": {LOOP: {"classical": {"crossover_hz": math.nan}}}},
        {"options": {LOOP: {"classical": {"bandwidth_hz": 1}}}},
        {"optional": {LOOP: {"classical": ["comb"]}}},
        {"axis": True},
        {"plant": "none"},
        {"fixed": ["comb_hz"]},
        {"overlays": ["lqg"]},
        {"closed": {LOOP: "lqg"}},
        {"design": 7},
    ],
)
def test_a_state_that_does_not_fit_the_job_is_an_error_of_one_line(shipped: Backend, changed: object) -> None:
    with pytest.raises(InputError) as error:
        checked_settings(shipped, changed)
    assert "\n" not in str(error.value)
    assert re.search("must|is unknown|is none of", str(error.value))


def test_a_saved_job_is_the_picture_and_check_accepts_it(
    bench: Backend, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = _moved(bench, bench.start(), crossover_hz=58.5)
    settings = bench.with_part(settings, "notch", False)
    picture = bench.picture(settings)
    assert all(r.passed for r in picture.requirements)
    saved = bench.save(settings, tmp_path / "new.toml")
    assert saved.controllers is not None
    assert saved.controllers.name == "new.controllers.json"
    text = saved.job.read_text()
    for comment in ("# Kept: what the user wrote.", "# of both", "# the gain"):
        assert comment in text
    data = tomllib.loads(text)
    [loop] = data["loop"]
    assert "notch_hz" not in loop["design"][0]
    assert loop["design"][0]["tune"] is False
    again = Backend(saved.job)
    for ours, theirs in zip(picture.requirements, again.picture(again.start()).requirements, strict=True):
        assert theirs.value == pytest.approx(ours.value, rel=1e-9)
    # `design` makes the same controller from the file, `check` finds the one beside it.
    made = loops(read_job(saved.job))[0].closed.controller
    written = json.loads(saved.controllers.read_text())["controllers"][0]
    for name in "ABCD":
        np.testing.assert_allclose(getattr(made, name), np.array(written[name]), rtol=1e-12, atol=1e-15)
    monkeypatch.chdir(tmp_path)
    assert main(["check", "new.toml", "--json", "-o", "checked"]) == 0
    figures = json.loads(capsys.readouterr().out)
    values = {r["name"]: r["value"] for r in figures["requirements"] if r["stage"] == "decoupled"}
    for result in picture.requirements:
        assert values[result.name] == pytest.approx(result.value, rel=1e-9)


def test_saving_never_lands_on_the_plant_or_a_folder_and_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["new", "mine", "-o", str(tmp_path)]) == 0
    bench = Backend(tmp_path / "mine.toml")
    settings = bench.start()
    plant = (tmp_path / "mine_plant.toml").read_text()
    with pytest.raises(InputError, match=r"mine_plant\.toml: the job reads its plant from it"):
        bench.save(settings, tmp_path / "mine_plant.toml", overwrite=True)
    assert (tmp_path / "mine_plant.toml").read_text() == plant
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match=r"folder\.toml: is not a file"):
        bench.save(settings, tmp_path / "folder.toml", overwrite=True)
    before = sorted(path.name for path in tmp_path.iterdir())

    def full(path: Path, text: str) -> None:
        raise InputError(f"{path}: cannot be written: no space")

    monkeypatch.setattr("platform_ctrl.app.saving.write_whole", full)
    with pytest.raises(InputError, match="no space"):
        bench.save(settings, tmp_path / "new.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_saving_replaces_files_only_with_overwrite(bench: Backend, job_file: Path, tmp_path: Path) -> None:
    settings = bench.start()
    with pytest.raises(InputError, match="exists already"):
        bench.save(settings, job_file)
    assert job_file.read_text() == TWO
    assert not (tmp_path / "gyro.controllers.json").exists()
    bench.save(settings, job_file, overwrite=True)
    assert read_job(job_file).name == "two designs"
    with pytest.raises(InputError, match="must end in"):
        bench.save(settings, tmp_path / "gyro.json")
    with pytest.raises(InputError):
        bench.save(settings, tmp_path / "nowhere" / "gyro.toml")
    with pytest.raises(InputError, match="not read from a file"):
        Backend(bench.read).save(settings, tmp_path / "other.toml")


def test_what_nobody_has_changed_stays_as_it_is_to_the_last_letter(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(THREE, encoding="utf-8")
    page = Backend(tmp_path / "job.toml")
    saved = page.save(page.start(), tmp_path / "same.toml")
    assert saved.job.read_text(encoding="utf-8") == THREE
    assert saved.notes == ()
    # One slider is one number.
    moved = page.save(page.moved(page.start("stabilisation"), "filter_hz", 55.0), tmp_path / "moved.toml")
    assert moved.job.read_text(encoding="utf-8") == THREE.replace("filter_hz = 50", "filter_hz = 55")
    assert moved.notes == ()
    # What the job leaves to a rule of thumb, which would choose otherwise now, is written, and said.
    settings = page.moved(page.start("stabilisation"), "crossover_hz", 4.5)
    moved = page.save(settings, tmp_path / "again.toml")
    said = "crossover_hz = 4.5, filter_hz = 50, position_hz = 1.2"
    assert moved.job.read_text(encoding="utf-8").replace("1.2}", "1.2 }") == THREE.replace(
        "crossover_hz = 4, filter_hz = 50", said
    )
    assert moved.notes == ("stabilisation, servo: position_hz = 1.2, for the controller to be that of the page",)
    assert Backend(moved.job).start().options["stabilisation"] == settings.options["stabilisation"]


@pytest.mark.parametrize("what", ["job", "plant", "damaged", "gone"])
def test_a_job_that_was_changed_on_disk_is_not_saved_with_the_controllers_of_the_page(
    what: str, tmp_path: Path
) -> None:
    plant = platform_source("three_gyro_platform")
    (tmp_path / "plant.toml").write_text(plant, encoding="utf-8")
    job = tmp_path / "job.toml"
    job.write_text(THREE.replace('"three_gyro_platform"', '"plant.toml"'), encoding="utf-8")
    page = Backend(job)
    settings = page.moved(page.start(LOOP), "crossover_hz", 41.0)
    text = job.read_text(encoding="utf-8")
    # A comment changes nothing, and stays.
    job.write_text(f"# mine\n{text}", encoding="utf-8")
    assert page.save(settings, tmp_path / "new.toml").job.read_text(encoding="utf-8").startswith("# mine")
    if what == "job":
        job.write_text(text.replace("disk_margin = 0.4", "disk_margin = 0.45"), encoding="utf-8")
    elif what == "plant":
        (tmp_path / "plant.toml").write_text(plant.replace("0.7e-4", "0.8e-4"), encoding="utf-8")
        assert (tmp_path / "plant.toml").read_text(encoding="utf-8") != plant
    elif what == "damaged":
        job.write_text(text + "[[loop", encoding="utf-8")
    else:
        job.unlink()
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    words = r"job\.toml: .* changed on disk .*; nothing was saved: .* platform-ctrl serve"
    for name in ("job.toml", "new.toml", "other.toml"):
        with pytest.raises(InputError, match=words):
            page.save(settings, tmp_path / name, overwrite=True)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_page_saves_over_its_own_job_again_and_again(tmp_path: Path) -> None:
    job = tmp_path / "job.toml"
    job.write_text(THREE, encoding="utf-8")
    page = Backend(job)
    moved = page.moved(page.start("stabilisation"), "crossover_hz", 4.5)
    page.save(moved, job, overwrite=True)
    assert "crossover_hz = 4.5" in job.read_text(encoding="utf-8")
    page.save(page.start("stabilisation"), job, overwrite=True)
    assert job.read_text(encoding="utf-8") == THREE
    page.save(moved, job, overwrite=True)
    job.write_text(THREE.replace("crossover_hz = 4,", "crossover_hz = 5,"), encoding="utf-8")
    with pytest.raises(InputError, match="changed on disk"):
        page.save(moved, job, overwrite=True)


def test_controllers_beside_a_job_are_taken_until_the_job_has_changed(tmp_path: Path) -> None:
    job = tmp_path / "gyro.toml"
    job.write_text(TWO, encoding="utf-8")
    page = Backend(job)
    saved = page.save(_moved(page, page.start(), crossover_hz=58.5), job, overwrite=True)
    assert saved.controllers is not None
    record = json.loads(saved.controllers.read_text(encoding="utf-8"))
    record["alternatives"] = [record["controllers"][0] | {"design": "lqg", "method": "lqg"}]
    saved.controllers.write_text(json.dumps(record), encoding="utf-8")

    def taken() -> bool:
        backend = Backend(job)
        return backend.loops.is_available(backend.start(), backend.read.loops[0], "lqg")

    assert taken()
    job.write_text(job.read_text(encoding="utf-8").replace("spin = 0.05", "spin = 0.1"), encoding="utf-8")
    assert not taken()


def test_a_plant_beside_the_job_is_found_from_another_folder(tmp_path: Path) -> None:
    (tmp_path / "plant.toml").write_text(platform_source("three_gyro_platform"))
    (tmp_path / "gyro.toml").write_text(TWO.replace('"three_gyro_platform"', '"plant.toml"'))
    (tmp_path / "deep").mkdir()
    bench = Backend(tmp_path / "gyro.toml")
    saved = bench.save(bench.start(), tmp_path / "deep" / "new.toml")
    assert read_job(saved.job).platform.name == bench.read.platform.name


def test_tuning_leaves_what_is_fixed_and_meets_what_tune_meets(bench: Backend) -> None:
    settings = bench.start().but(fixed=frozenset({"crossover_hz"}))
    settings = _moved(bench, settings, damping_hz=30.0, damping2_hz=30.0)
    assert not all(r.passed for r in bench.picture(settings).requirements)
    lines: list[str] = []
    tuned = bench.tune(settings, lines.append)
    assert lines
    assert "limited by " in lines[-1]
    before, after = (one.options[LOOP]["by hand"] for one in (settings, tuned))
    assert after["crossover_hz"] == before["crossover_hz"]
    assert after["damping_hz"] != before["damping_hz"]
    results = bench.picture(tuned).requirements
    assert max(r.ratio for r in results) <= 0.96
    assert all(r.passed for r in loops(bench.read)[0].closed.results)


def test_a_design_made_in_the_background_is_that_of_its_method(bench: Backend) -> None:
    settings = bench.chosen(bench.start(), design="lqg")
    there = threading.Event()
    end = bench.loops.listen(there.set)
    with pytest.raises(DesignError, match="is being designed"):
        bench.picture(settings)
    assert there.wait(60.0)
    end()
    picture = bench.picture(settings)
    expected = next(one for one in loops(bench.read)[0].designs if one.name == "lqg")
    np.testing.assert_allclose([r.value for r in picture.requirements], [r.value for r in expected.results], rtol=1e-6)
    # Over the classical one.
    over = bench.picture(bench.chosen(settings, design="by hand").but(overlays=("lqg",)))
    [overlay] = over.overlays
    plots = pytest.importorskip("platform_ctrl.app.plots").Plots()
    plots.show(over)
    drawn = next(one for one in plots.panels if one.name == "step").figures[0].sources["lines"].data
    ends = [x[-1] for name, x in zip(drawn["name"], drawn["xs"], strict=True) if name == "lqg" and len(x)]
    np.testing.assert_allclose(ends, overlay.step.t[-1], rtol=1e-6)
    np.testing.assert_allclose(
        np.interp(picture.bode.frequency, overlay.bode.frequency, np.abs(overlay.bode.response)),
        np.abs(picture.bode.response),
        rtol=0.05,
    )
    torque = next(k for k in bench.sliders(settings) if k.name == "largest_torque")
    assert torque.background
    assert torque.tunable
    with pytest.raises(DesignError, match="is not designed yet"):
        bench.save(bench.moved(settings, "largest_torque", 1.1 * torque.value), "unwritten.toml")


def test_controllers_of_a_result_are_shown_as_they_are(bench: Backend, tmp_path: Path) -> None:
    from platform_ctrl.verification import check_job
    from platform_ctrl.verification.result_file import result_record, write_record

    result = check_job(bench.read, loops(bench.read))
    write_record(result_record(result), tmp_path / "result.json")
    given = Backend(tmp_path / "gyro.toml", tmp_path / "result.json")
    settings = given.start()
    # What tuning made of the sliders is where they start.
    closed = next(design for design in result.loops[0].designs if design.name == "by hand")
    picture = given.picture(settings.but(overlays=("lqg",)))
    np.testing.assert_allclose([r.value for r in picture.requirements], [r.value for r in closed.results], rtol=1e-6)
    assert [o.settings.design for o in picture.overlays] == ["lqg"]
    assert not picture.measured.notes
    K = given.loops.caged(settings)[0].controller
    assert isinstance(K, System)
    assert np.allclose(K.A, closed.controller.A)


# Their designs take the page a few seconds each.
LONG = ("camera_gimbal_modes", "drone_gimbal", "telescope_mount")
JOBS = [path for path in sorted(SHIPPED.parent.glob("*_*.toml")) if "[[loop]]" in path.read_text(encoding="utf-8")]


@pytest.mark.parametrize(
    "job", [pytest.param(one, id=one.stem, marks=[pytest.mark.slow] * (one.stem in LONG)) for one in JOBS]
)
def test_a_page_that_nobody_touched_saves_its_job_to_the_last_letter(job: Path, tmp_path: Path) -> None:
    text = job.read_text(encoding="utf-8")
    for plant in job.parent.glob("*_plant.toml"):
        (tmp_path / plant.name).write_bytes(plant.read_bytes())
    (tmp_path / job.name).write_text(text, encoding="utf-8")
    page = Backend(tmp_path / job.name)
    saved = page.save(page.start(), tmp_path / "same.toml")
    page.close()
    assert saved.job.read_text(encoding="utf-8") == text
    assert (saved.controllers is None) == bool(saved.notes)
    assert all(line.startswith("nothing was changed on the page") for line in saved.notes)
