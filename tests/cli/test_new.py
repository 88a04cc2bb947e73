"""``platform-ctrl new``: what it writes is read, designed and flown; nothing is overwritten, nothing is half there."""

from __future__ import annotations

import errno
import json
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import design, verification
from platform_ctrl.cli import main
from platform_ctrl.cli.atomic_output import written_together
from platform_ctrl.cli.starting.kinds import KINDS
from platform_ctrl.cli.starting.loops import RISE, safe_turn
from platform_ctrl.design.cases import subsystems_over
from platform_ctrl.job.quantities import simulated_words
from platform_ctrl.job.writing import job_data
from platform_ctrl.plant.source import platform_source, shipped_models
from platform_ctrl.plant.writing import toml
from platform_ctrl.verification.budget import line_of_sight_budget
from refused_command import refused


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_what_is_written_is_designed_simulated_and_varied_as_it_is(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", "gyro"]) == 0
    told = capsys.readouterr()
    assert names(there) == ["gyro.toml", "gyro_plant.toml"]
    assert "next:  platform-ctrl design gyro.toml" in told.out.splitlines()
    assert main(["design", "gyro.toml", "-q"]) == 0
    assert main(["simulate", "gyro.toml", "--manoeuvre", "turn", "-q"]) == 0
    assert "PASSED" in capsys.readouterr().out
    job = pc.read_job(there / "gyro.toml")
    assert job.campaign is not None
    assert len(job.campaign.vary) == 2
    assert main(["equations", "gyro_plant.toml"]) == 0


def test_the_design_that_is_commented_out_can_be_switched_on(there: Path) -> None:
    assert main(["new", "gyro"]) == 0
    text = (there / "gyro.toml").read_text(encoding="utf-8")
    for line in ("[[loop.design]]", 'name = "H-infinity"', 'method = "hinf"'):
        assert f"# {line}" in text
        text = text.replace(f"# {line}", line)
    (there / "gyro.toml").write_text(text, encoding="utf-8")
    [outcome] = design.loops(there / "gyro.toml")
    assert [one.name for one in outcome.designs] == ["classical", "H-infinity"]


# Eight gimbals in one loop: what it claims takes ten seconds to measure.
LONG = {"multirotor_gimbal", "suspended_platform"}
# What the loops of the shipped plants are for; of the others gyros are caged.
PURPOSES = {
    "camera_gimbal": ["rate"],
    "fast_steering_mirror": ["pointing"],
    "floated_gyro_platform": ["pointing"],
    "multirotor_gimbal": ["rate"],
    "seeker_head": ["rate"],
    "three_gyro_platform": ["caging", "caging", "stabilisation"],
}


def designed(job: pc.Job) -> verification.JobResult:
    result = verification.check_job(job, design.loops(job))
    assert result.passed, [one for one in result.requirements if not one.passed]
    return result


@pytest.mark.parametrize(
    "model", [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in shipped_models()]
)
def test_every_shipped_plant_has_a_job_that_passes(model: str, there: Path) -> None:
    assert main(["new", "start", "--like", model, "-q"]) == 0
    job = pc.read_job(there / "start.toml")
    kinds = [loop.kind for loop in job.loops]
    assert kinds == PURPOSES.get(model, ["caging"] * len(kinds))
    if "rate" not in kinds:
        own = {loop.gimbals for loop in job.loops if loop.gimbals}
        assert own == set(subsystems_over(job.platform, job.Omega, job.Omega_grid))
    designed(job)
    made, shipped = job.platform, pc.read_platform(model)
    assert made.gimbal_names == shipped.gimbal_names
    assert {one.name for one in shipped.torquers} <= {one.name for one in made.torquers}
    text = (there / "start.toml").read_text(encoding="utf-8")
    assert len(text.splitlines()) < 160
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.slow
def test_every_kind_takes_the_job_of_its_plant(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for kind, one in KINDS.items():
        given = ["--like", one.plant] if one.plant is not None else []
        assert main(["new", "mine", "--kind", kind, "-o", kind, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["kind"] == kind
        assert main(["new", "mine", *given, "-o", f"{kind} again", "--json"]) == 0
        capsys.readouterr()
        for file in ("mine.toml", "mine_plant.toml"):
            assert (there / kind / file).read_bytes() == (there / f"{kind} again" / file).read_bytes()
    assert {"caged-gyro", "camera-gimbal", "stabilised-platform", "control-moment-gyro"} <= set(KINDS)


def test_the_job_of_a_camera_holds_its_line_of_sight_while_the_vehicle_moves(there: Path) -> None:
    """The base moves about the axes across the line of sight; the motors hold the unbalance from the start on."""
    assert main(["new", "eye", "--kind", "camera-gimbal", "-q"]) == 0
    job = pc.read_job(there / "eye.toml")
    [loop], [run] = job.loops, job.manoeuvres
    assert set(loop.sensors) == {"pitch_rate", "yaw_rate"}
    assert {"disk_margin_worst_case", "attenuation_db_worst_case", "attenuation_hz"} <= set(loop.limits)
    assert run.start == "equilibrium"
    assert {one.axis for one in run.sines} == {2, 3}
    assert "attenuation_db" in run.limits
    assert not job.platform.added
    result = designed(job)
    found = {one.name: one.value for one in result.requirements if one.stage == "simulated"}
    # In the run dry friction acts as it is: what the describing function promised is there.
    assert found["attenuation of base motion, simulated"] > loop.limits["attenuation_db_worst_case"]
    # The verdict of a campaign says what its runs rest on.
    assert simulated_words(job, job.manoeuvres) == (
        ", assuming that constant torques of the motors hold the gimbals from the start on and the gimbals start at "
        "the angles zero"
    )
    # What the base's motion does to the line of sight is there from the start: `budget` has something to say.
    budget = line_of_sight_budget(job, [outcome.closed.controller for outcome in result.loops])
    assert {"base about axis 2", "base about axis 3"} <= set(budget.names)
    assert 0.0 < budget.jitter < 1e-3


@pytest.mark.parametrize(
    ("kept", "sensors"),
    [
        # Its tracker is late by twenty samples, which are states of every plant.
        pytest.param("attitude_sensor", ("track_pitch", "track_yaw"), marks=pytest.mark.slow),
        ("", ("azimuth", "elevation")),
    ],
)
def test_a_body_whose_sensors_measure_angles_alone_is_pointed(kept: str, sensors: tuple[str, ...], there: Path) -> None:
    """The camera without its gyros has a tracker, and without that its encoders."""
    removed = {"rate_sensor", "attitude_sensor"} - {kept}
    tables = platform_source("camera_gimbal").split("\n\n")
    bare = [table for table in tables if not any(f"[[{kind}]]" in table for kind in removed)]
    (there / "bare.toml").write_text("\n\n".join(bare), encoding="utf-8")
    assert main(["new", "start", "--like", "bare.toml", "-q"]) == 0
    job = pc.read_job(there / "start.toml")
    assert [(loop.kind, loop.sensors) for loop in job.loops] == [("pointing", sensors)]
    designed(job)


def test_a_loop_that_falls_short_of_the_usual_margin_asks_for_what_it_reaches(there: Path) -> None:
    assert main(["new", "start", "--like", "suspended_platform", "-q"]) == 0
    [loop] = pc.read_job(there / "start.toml").loops
    assert loop.limits["disk_margin"] == 0.3
    assert "gain x 0.74 to 1.35 alone, phase +-17 degrees" in (there / "start.toml").read_text(encoding="utf-8")


def test_what_a_caging_loop_needs_is_added_and_told(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "ecp", "--like", "ecp_750", "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    record = json.loads(out)
    assert record["added"] == ["a torquer on A", "a torquer on B"]
    assert record["loops"] == ["caging A-B-C"]
    assert Path(record["plant"]).is_file()
    assert Path(record["job"]).is_file()
    assert record["next"][0] == "platform-ctrl design ecp.toml"
    text = (there / "ecp_plant.toml").read_text(encoding="utf-8")
    assert text.startswith("# ECP")  # the plant's own comments
    assert "not part of the plant" in text


def test_what_was_added_stands_in_every_verdict_and_report(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "start", "--like", "ecp_750", "-q"]) == 0
    assert [part.name for part in pc.read_job(there / "start.toml").platform.added] == ["QA", "QB"]
    words = "all 6 requirements met, with torquers on A and B added that the device does not have"
    for command in (["design", "start.toml"], ["check", "start.toml", "--controllers", "out/result.json"]):
        assert main([*command, "-q"]) == 0
        assert f"PASSED: {words}; tightest: " in " ".join(capsys.readouterr().out.split())
        page = (there / "out" / "report.html").read_text(encoding="utf-8")
        assert f"A{words[1:]}<" in page
        assert page.count(", no limit, added<") == 2
        assert json.loads((there / "out" / "result.json").read_text(encoding="utf-8"))["added"] == ["QA", "QB"]
    # The job in the report is read back as it was.
    listed = toml(job_data(pc.read_job(there / "start.toml")))
    assert listed.count("added = true") == 2
    assert "added = false" not in listed


TWO_AXES = """
schema = 1
name = "two axes"
source = "assumed"
[root]
name = "base"
inertia = [1, 1, 1]
[[gimbal]]
name = "yaw"
parent = "base"
axis = [0, 0, 1]
inertia = [0.05, 0.06, 0.07]
[[gimbal]]
name = "pitch"
parent = "yaw"
axis = [0, 1, 0]
inertia = [0.02, 0.03, 0.04]
"""


def test_without_rotors_the_platform_turns_about_an_axis_that_loads_the_gimbals(there: Path) -> None:
    """Axis 1 is across both gimbals: a turn about it asks no torque of them."""
    (there / "two.toml").write_text(TWO_AXES, encoding="utf-8")
    assert main(["new", "start", "--like", "two.toml", "-q"]) == 0
    job = pc.read_job(there / "start.toml")
    assert {loop.kind for loop in job.loops} == {"pointing"}
    load = np.abs(pc.linearise(job.platform).M_Omega).sum(axis=0)
    shaken = {one.axis for run in job.manoeuvres for one in run.sines}
    assert shaken == {2, 3} == set(1 + np.flatnonzero(load))
    text = (there / "start.toml").read_text(encoding="utf-8")
    assert "any will do" not in text


@pytest.mark.parametrize("name", shipped_models())
def test_the_turn_of_a_start_asks_a_torque_of_the_gimbals(name: str) -> None:
    platform = pc.read_platform(name)
    axis, rate = safe_turn(pc.linearise(platform), {})
    velocity = np.zeros(3 + len(platform.gimbals))
    velocity[axis - 1] = rate
    rising = velocity * 0.5 * np.pi / RISE
    torques = [
        pc.inverse_dynamics(platform, np.zeros(len(platform.gimbals)), *motion)[3:]
        for motion in ((velocity, 0.0 * velocity), (0.0 * velocity, rising))
    ]
    still = pc.inverse_dynamics(platform, np.zeros(len(platform.gimbals)), 0.0 * velocity, 0.0 * velocity)[3:]
    assert max(np.abs(one - still).max() for one in torques) > 0.0


def test_a_plant_file_of_ones_own_gets_a_job(there: Path) -> None:
    assert main(["new", "first", "-o", "one"]) == 0
    assert main(["new", "second", "--like", str(Path("one") / "first_plant.toml"), "-o", "two"]) == 0
    first, second = (there / "one" / "first_plant.toml"), (there / "two" / "second_plant.toml")
    assert first.read_text(encoding="utf-8") == second.read_text(encoding="utf-8")
    assert [loop.gimbals for loop in pc.read_job(there / "two" / "second.toml").loops] == [("outer", "inner")]


def test_names_that_need_quotes_come_through(there: Path) -> None:
    main(["new", "first"])
    plain = (there / "first_plant.toml").read_text(encoding="utf-8")
    odd = plain.replace('"outer"', '"\\"äußerer\\" \\\\ # 1"').replace('"rotor"', '"a rotor"')
    (there / "odd.toml").write_text(odd, encoding="utf-8")
    assert main(["new", "second", "--like", "odd.toml"]) == 0
    job = pc.read_job(there / "second.toml")
    assert job.loops[0].gimbals == ('"äußerer" \\ # 1', "inner")


def test_files_that_are_there_stay_unless_told_otherwise(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (there / "gyro.toml").write_text("mine", encoding="utf-8")
    assert "gyro.toml: exists already" in refused(capsys, "new", "gyro")
    assert names(there) == ["gyro.toml"]
    assert (there / "gyro.toml").read_text(encoding="utf-8") == "mine"
    assert main(["new", "gyro", "--force"]) == 0
    assert tomllib.loads((there / "gyro.toml").read_text(encoding="utf-8"))["plant"] == "gyro_plant.toml"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["new"], "Missing argument 'NAME'"),
        (["new", "a/b"], "NAME: 'a/b' may contain only letters, digits"),
        (["new", ""], "NAME: ''"),
        (["new", ".."], "NAME: '..'"),
        (["new", "x", "--like", "ecp_75"], 'did you mean "ecp_750"?'),
        (["new", "x", "--like", "none.toml"], "none.toml: there is no such file"),
        (["new", "x", "--like", "bare.toml"], "--like bare.toml: this plant has no gimbals"),
        (["new", "x", "--like", "inline.toml"], "--like inline.toml: a torquer on g, a pick-off on g"),
        (["new", "x", "--kind", "gyro"], "--kind gyro: must be one of caged-gyro, camera-gimbal"),
        (["new", "x", "--kind", "caged-gyro", "--like", "ecp_750"], "--like and --kind exclude each other"),
        (["new", "x", "-o", "bare.toml"], "-o bare.toml: is no folder"),
    ],
)
def test_wrong_input_is_one_line_and_nothing_is_written(
    arguments: list[str], words: str, there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = 'schema = 1\nname = "bare"\n'
    root = '[root]\nname = "r"\ninertia = [1, 1, 1]\n'
    gimbals = '{ name = "g", parent = "r", axis = [1, 0, 0], inertia = [1, 1, 1] }'
    gimbals += ', { name = "h", parent = "g", axis = [0, 1, 0], inertia = [1, 1, 1] }'
    (there / "bare.toml").write_text(bare + root, encoding="utf-8")
    (there / "inline.toml").write_text(
        f'{bare}gimbal = [{gimbals}]\ntorquer = [{{ gimbal = "h" }}]\n{root}', encoding="utf-8"
    )
    assert words in refused(capsys, *arguments)
    assert names(there) == ["bare.toml", "inline.toml"]


def test_both_files_appear_or_neither(there: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = Path.write_text

    def interrupted(self: Path, *given: object, **named: object) -> int:
        if self.name == "gyro.toml":
            raise KeyboardInterrupt
        return written(self, *given, **named)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_text", interrupted)
        assert main(["new", "gyro"]) == 130
    assert names(there) == []


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="a folder that may not be written to")
def test_a_folder_that_cannot_be_written_to_is_one_line(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (there / "closed").mkdir(mode=0o500)
    assert "cannot be written to" in refused(capsys, "new", "gyro", "-o", "closed")


def test_a_name_too_long_for_a_file_is_told_before_anything_is_written(
    there: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "File name too long" in refused(capsys, "new", 300 * "x")
    assert names(there) == []


def test_a_full_disk_is_told_by_the_name_that_the_file_was_to_have(there: Path) -> None:
    (there / "out").mkdir()
    with (
        pytest.raises(pc.PlatformCtrlError, match=r"^out/report\.html: cannot be written: No space left"),
        written_together(Path("out")) as unfinished,
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(unfinished / "report.html"))
    assert names(there / "out") == []


@pytest.mark.parametrize("viscous", [1e-3, 0.1])
def test_a_damped_axis_needs_no_faster_computer(viscous: float, there: Path) -> None:
    """The pole b/J of an axis is up to 16 kHz here, and no loop has to be faster because of it."""
    plant = {
        "schema": 1,
        "name": "pan and tilt in oil",
        "root": {"name": "base", "inertia": [1.0, 1.0, 1.0]},
        "gimbal": [
            {"name": "pan", "parent": "base", "axis": [0, 0, 1], "inertia": [2e-6, 2e-6, 2e-6]},
            {"name": "tilt", "parent": "pan", "axis": [0, 1, 0], "inertia": [1e-6, 1e-6, 1e-6]},
        ],
        "torquer": [{"gimbal": "pan", "limit": 0.5}, {"gimbal": "tilt", "limit": 0.5}],
        "pickoff": [{"gimbal": "pan"}, {"gimbal": "tilt"}],
        "friction": [{"gimbal": "pan", "viscous": viscous}, {"gimbal": "tilt", "viscous": viscous}],
    }
    (there / "oil.toml").write_text(toml(plant), encoding="utf-8")
    assert main(["new", "start", "--like", "oil.toml", "-q"]) == 0
    job = pc.read_job(there / "start.toml")
    assert 1.0 / job.sampling.period == pytest.approx(1000.0)
    [outcome] = design.loops(job)
    assert outcome.closed.passed
    if viscous == 0.1:
        # Its runs take the steps that such friction needs.
        assert all(one.passed for one in verification.check_job(job, [outcome]).requirements)
