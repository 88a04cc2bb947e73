"""The pytest plugin, in pytest runs of its own."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

import platform_ctrl as pc
from one_gyro_job import JOB, SLOWER, TOO_MUCH
from platform_ctrl.cli.testing.session import requirements_of
from plugged import plugged_in

pytest_plugins = ["pytester"]

ITEMS = 5

HELD = """
def test_is_not_worse(closed_loop, assert_baseline):
    assert_baseline(closed_loop("gyro.toml"), "gyro.json")
"""
MARKED = """
import pytest

@pytest.mark.platform_job("gyro.toml", baseline="gyro.json")
def test_gyro(requirement):
    requirement.assert_met()
"""


@pytest.fixture(scope="module", autouse=True)
def _loaded() -> None:
    """Load what the runs need once: a run inside this process forgets the modules that it was the first to load."""
    job = pc.read_job(_parsed(JOB))
    result = pc.verification.check_job(job, pc.design.loops(job))
    from platform_ctrl.campaign import identity  # noqa: F401
    from platform_ctrl.cli.testing import session  # noqa: F401
    from platform_ctrl.report.figures import baseline_changes  # noqa: F401

    assert len(result.requirements) == ITEMS


@pytest.fixture
def runs(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A folder with gyro.toml for pytest runs that find the plugin."""
    plugged_in(pytester, monkeypatch)
    write(pytester, "gyro.toml", JOB)
    return pytester


def _parsed(text: str) -> dict[str, object]:
    import tomllib

    return tomllib.loads(text)


def write(pytester: pytest.Pytester, name: str, text: str) -> Path:
    file = pytester.path / name
    file.write_text(text, encoding="utf-8")
    return file


def run(pytester: pytest.Pytester, *arguments: str) -> pytest.RunResult:
    """Run in this process, with no other plugin: theirs would be loaded anew each time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
        return pytester.runpytest_inprocess("-p", "platform_ctrl.cli.testing.plugin", *arguments)


def process(pytester: pytest.Pytester, *arguments: str) -> pytest.RunResult:
    """Run in a process of its own, with every plugin that is installed; a warning is an error."""
    return pytester.runpytest_subprocess("-W", "error", *arguments)


def accepted(pytester: pytest.Pytester, test: str = HELD) -> Path:
    """Write the test and the baseline of the job as it stands."""
    pytester.makepyfile(test)
    done = run(pytester, "--update-baselines")
    assert done.ret == 0
    done.stdout.fnmatch_lines(["*baselines*", "gyro.json: written, * figures"])
    return pytester.path / "gyro.json"


def test_requirements_that_are_met_are_asserted(runs: pytest.Pytester) -> None:
    runs.makepyfile(
        """
        from platform_ctrl.cli.testing import assert_requirements

        def test_gyro(closed_loop):
            assert_requirements(closed_loop("gyro.toml"), goals=True)
        """
    )
    run(runs).assert_outcomes(passed=1)


def test_a_missed_requirement_shows_value_limit_margin_and_evidence(runs: pytest.Pytester) -> None:
    write(runs, "gyro.toml", TOO_MUCH)
    runs.makepyfile(
        """
        from platform_ctrl.cli.testing import assert_requirements

        def test_gyro(closed_loop):
            assert_requirements(closed_loop("gyro.toml"))
        """
    )
    done = run(runs)
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(
        [
            ">* assert_requirements(closed_loop(*",
            "E*gyro 9-10: 1 of 5 requirements not met",
            "E*value*limit*margin*",
            "E*caging 9-10, classical: bandwidth *27.68 Hz *at least 35 Hz *-21 %*nominal plant*",
        ]
    )
    assert "assertions.py" not in done.stdout.str()


def test_missed_goals_are_asserted_where_they_are_asked_for(runs: pytest.Pytester) -> None:
    write(runs, "gyro.toml", JOB.replace("use =", "soft = { bandwidth_hz = 35 }\nuse ="))
    runs.makepyfile(
        """
        from platform_ctrl.cli.testing import assert_requirements

        def test_limits(closed_loop):
            assert_requirements(closed_loop("gyro.toml"))

        def test_goals(closed_loop):
            assert_requirements(closed_loop("gyro.toml"), goals=True)
        """
    )
    done = run(runs)
    done.assert_outcomes(passed=1, failed=1)
    done.stdout.fnmatch_lines(["E*gyro 9-10: 1 of 1 goal not met"])


def test_a_job_is_designed_once_for_all_tests_and_scopes(runs: pytest.Pytester) -> None:
    runs.makepyfile(
        """
        import pytest
        import platform_ctrl as pc

        @pytest.fixture(scope="module")
        def result(closed_loop):
            return closed_loop("gyro.toml")

        def test_same(result, closed_loop, request):
            assert closed_loop("gyro.toml") is result
            assert closed_loop(pc.read_job(request.path.parent / "gyro.toml")) is result

        def test_other_controllers_are_another_loop(result, closed_loop):
            K = result.loops[0].closed.controller
            given = closed_loop("gyro.toml", [K])
            assert given is not result and given.loops[0].closed.method == "given"
            assert closed_loop("gyro.toml", [K]) is given

        @pytest.mark.platform_job("gyro.toml")
        def test_marked(job_result, result):
            assert job_result is result
        """
    )
    run(runs).assert_outcomes(passed=3)


def test_a_job_file_is_a_test_file_with_an_item_for_every_requirement(runs: pytest.Pytester) -> None:
    write(runs, "gyro.toml", TOO_MUCH)
    done = run(runs, "gyro.toml", "-v", "--junitxml=verdicts.xml")
    done.assert_outcomes(passed=ITEMS - 1, failed=1)
    done.stdout.fnmatch_lines(
        [
            "gyro.toml::caging 9-10: disk margin PASSED*",
            "caging 9-10, classical: bandwidth 27.68 Hz, at least 35 Hz: not met, margin -21 %",
            "  nominal plant; *",
        ]
    )
    [case] = [
        one
        for one in ElementTree.parse(runs.path / "verdicts.xml").iter("testcase")
        if one.get("name") == "caging 9-10: bandwidth"
    ]
    properties = {one.get("name"): one.get("value") for one in case.iter("property")}
    assert properties["margin"] == "-21 %"
    assert float(properties["value"] or 0) == pytest.approx(27.68, rel=1e-3)
    failure = case.find("failure")
    assert failure is not None
    assert "at least 35 Hz" in (failure.text or "")


def test_job_files_are_collected_where_a_pattern_asks_for_them_and_nothing_is_designed_for_that(
    runs: pytest.Pytester,
) -> None:
    write(runs, "pyproject.toml", '[tool.pytest.ini_options]\nplatform_jobs = ["*.toml"]\n')
    (runs.mkdir("jobs") / "fine.toml").write_text(JOB, encoding="utf-8")
    assert run(runs, "--collect-only", "-q").parseoutcomes() == {"tests": 2 * ITEMS}
    write(runs, "pyproject.toml", "[tool.pytest.ini_options]\n")
    assert run(runs, "--collect-only", "-q").ret == pytest.ExitCode.NO_TESTS_COLLECTED
    assert run(runs, "--collect-only", "-q", "--platform-jobs", "jobs/*.toml").parseoutcomes() == {"tests": ITEMS}
    run(runs, "--platform-jobs", "gyro.toml", "-k", "margin").assert_outcomes(passed=1, deselected=ITEMS - 1)


def test_a_job_file_that_makes_no_sense_is_one_line(runs: pytest.Pytester) -> None:
    write(runs, "gyro.toml", JOB.replace('gimbals = ["9", "10"]', 'gimbals = ["9", "12"]'))
    done = run(runs, "gyro.toml")
    done.assert_outcomes(errors=1)
    done.stdout.fnmatch_lines(['*gyro.toml: [[][[]loop]] 1 "caging 9-10": gimbals*"12" is no gimbal of the plant*'])
    assert "Traceback" not in done.stdout.str()


def test_a_design_that_fails_fails_every_item_and_is_tried_once(runs: pytest.Pytester) -> None:
    write(runs, "gyro.toml", JOB.replace("crossover_hz = 40", "crossover_hz = 400"))
    done = run(runs, "gyro.toml", "-v")
    done.assert_outcomes(failed=ITEMS)
    assert done.stdout.str().count("gyro.toml::caging 9-10: bandwidth FAILED") == 1
    done.stdout.fnmatch_lines(["caging 9-10, classical: the closed loop grows at *it is unstable; try*"])


def test_the_names_of_the_items_are_those_of_the_verdict(shipped_requirements: tuple[pc.Job, list[str]]) -> None:
    job, found = shipped_requirements
    assert [f"{subject}: {name}" for subject, name in requirements_of(job)] == found


@pytest.fixture
def shipped_requirements() -> tuple[pc.Job, list[str]]:
    """A job with every kind of requirement, and what its verdict rests on."""
    from cli.test_cli import JOB as THREE_GYROS

    text = THREE_GYROS.replace('name = "stabilisation"', 'name = "stabilisation"\nlimits = { torque_noise = 0.01 }')
    text = text.replace(
        "limits = { bandwidth_hz = 20,", "limits = { damping_faults = 0.001, damping_worst_case = 0.01,"
    )
    text = text.replace("limits = { angle = 0.0005 }", "limits = { attitude = 0.01, angle = 0.0005 }")
    job = pc.read_job(_parsed(text + "\n[faults]\nweak_torquer = 0.9\n[uncertainty]\nspin = 0.01\n"))
    result = pc.verification.check_job(job, pc.design.loops(job))
    return job, [f"{one.subject}: {one.name}" for one in result.requirements]


def test_a_marked_test_runs_once_for_every_requirement_and_the_baseline(runs: pytest.Pytester) -> None:
    accepted(runs, MARKED)
    done = run(runs, "-v")
    done.assert_outcomes(passed=ITEMS + 1)
    done.stdout.fnmatch_lines(
        ["*::test_gyro[[]caging 9-10: bandwidth[]] PASSED*", "*::test_gyro[[]baseline[]] PASSED*"]
    )


@pytest.mark.parametrize(
    ("marker", "argument", "said"),
    [
        ('"gyro.toml"', "", "takes neither `requirement` nor `job_result`"),
        ("", "requirement", "missing a required argument: 'job'"),
        ('"gyro.toml", goals=1', "requirement", "the arguments are (job, controllers=, baseline=)"),
        ('"missing.toml"', "requirement", "missing.toml: there is no such file"),
        ('"gyro.toml", baseline=3', "requirement", "baseline: must be the path of a file, got 3"),
    ],
)
def test_a_wrong_marker_is_one_line(runs: pytest.Pytester, marker: str, argument: str, said: str) -> None:
    runs.makepyfile(f"import pytest\n@pytest.mark.platform_job({marker})\ndef test_gyro({argument}):\n    pass\n")
    done = run(runs)
    done.assert_outcomes(errors=1)
    assert said in done.stdout.str()
    assert "plugin.py" not in done.stdout.str()


@pytest.mark.parametrize("fixture", ["requirement", "job_result"])
def test_a_fixture_of_the_marker_says_that_it_needs_it(runs: pytest.Pytester, fixture: str) -> None:
    runs.makepyfile(f"def test_gyro({fixture}):\n    pass\n")
    done = run(runs)
    done.assert_outcomes(errors=1)
    done.stdout.fnmatch_lines([f"*the fixture `{fixture}` needs the marker platform_job(job)"])


def test_a_worse_figure_fails_with_a_table_and_a_plot(runs: pytest.Pytester) -> None:
    accepted(runs)
    assert run(runs).ret == 0
    write(runs, "gyro.toml", SLOWER)
    done = run(runs)
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(
        [
            ">* assert_baseline(closed_loop(*",
            "E*gyro.json: of 12 figures 3 worse by more than their tolerance",
            "E*before*now*change*tolerance*limit*",
            "E*caging 9-10: bandwidth *27.68 Hz *24.03 Hz *-13 % *0.5536 Hz *at least 20 Hz*",
            "E*caging 9-10: changed since the baseline: its controller",
            "E*plot: gyro.moved.png",
            "E*to accept this: pytest --update-baselines",
        ]
    )
    plot = runs.path / "gyro.moved.png"
    assert plot.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    # Accepted, it passes, and the plot of what no longer holds has gone.
    done = run(runs, "--update-baselines")
    done.assert_outcomes(passed=1)
    done.stdout.fnmatch_lines(["gyro.json: written, 3 worse"])
    assert not plot.exists()
    assert run(runs).ret == 0


def test_a_plot_goes_where_it_is_asked_to_go(runs: pytest.Pytester) -> None:
    accepted(runs)
    write(runs, "gyro.toml", SLOWER)
    assert run(runs, "--platform-plots", "made/plots").ret == 1
    assert (runs.path / "made" / "plots" / "gyro.moved.png").stat().st_size > 10_000
    assert not (runs.path / "gyro.moved.png").exists()


def test_a_tolerance_of_a_figure_is_respected_and_survives_an_update(runs: pytest.Pytester) -> None:
    file = accepted(runs)
    text = file.read_text(encoding="utf-8")
    widened = re.sub(r'("name": "(bandwidth|damping|disk margin)", .*)\}', r'\1, "relative": 0.2}', text)
    assert widened.count('"relative": 0.2}') == 3
    file.write_text(widened, encoding="utf-8")
    write(runs, "gyro.toml", SLOWER)
    assert run(runs).ret == 0
    assert run(runs, "--update-baselines").ret == 0
    assert file.read_text(encoding="utf-8").count('"relative": 0.2}') == 3


def test_better_is_no_failure_and_is_told(runs: pytest.Pytester) -> None:
    write(runs, "gyro.toml", SLOWER)
    accepted(runs)
    write(runs, "gyro.toml", JOB)
    done = run(runs)
    done.assert_outcomes(passed=1)
    done.stdout.fnmatch_lines(["gyro.json: 3 better; pytest --update-baselines accepts this"])


def test_a_missing_baseline_says_what_writes_it(runs: pytest.Pytester) -> None:
    runs.makepyfile(HELD)
    done = run(runs)
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(["E*gyro.json: there is no such file; pytest --update-baselines writes it"])


def test_what_is_no_result_or_no_file_is_told_in_one_line(runs: pytest.Pytester) -> None:
    runs.makepyfile(
        """
        from platform_ctrl.cli.testing import assert_requirements

        def test_no_file(closed_loop, assert_baseline):
            assert_baseline(closed_loop("gyro.toml"), 3)

        def test_no_result(assert_baseline):
            assert_baseline("gyro.toml", "gyro.json")

        def test_nothing():
            assert_requirements(None)
        """
    )
    done = run(runs)
    done.assert_outcomes(failed=3)
    for said in (
        "baseline: must be the path of a file, got 3",
        "must be a JobResult, got 'gyro.toml'",
        "got None",
    ):
        done.stdout.fnmatch_lines([f"E*ArgumentError: *{said}*"])


def test_a_corrupted_baseline_is_one_line_and_is_not_overwritten(runs: pytest.Pytester) -> None:
    runs.makepyfile(HELD)
    file = write(runs, "gyro.json", '{"schema": 1, "job": "gyro", "figures": 3}')
    for arguments in ((), ("--update-baselines",)):
        done = run(runs, *arguments)
        done.assert_outcomes(failed=1)
        done.stdout.fnmatch_lines(["E*InputError: gyro.json: figures must be a list of figures, got 3"])
    assert json.loads(file.read_text(encoding="utf-8"))["figures"] == 3


def test_a_job_file_is_held_against_the_baseline_beside_it(runs: pytest.Pytester) -> None:
    done = run(runs, "gyro.toml", "--update-baselines")
    done.assert_outcomes(passed=ITEMS + 1)
    assert (runs.path / "gyro.baseline.json").exists()
    run(runs, "gyro.toml").assert_outcomes(passed=ITEMS + 1)
    write(runs, "gyro.toml", SLOWER)
    done = run(runs, "gyro.toml")
    done.assert_outcomes(passed=ITEMS, failed=1)
    done.stdout.fnmatch_lines(["*plot: gyro.baseline.moved.png"])


def test_accepted_controllers_are_held_against_a_plant_that_has_changed(runs: pytest.Pytester) -> None:
    accepted(runs)
    runs.makepyfile(
        """
        def test_is_not_worse(closed_loop, assert_baseline):
            assert_baseline(closed_loop("gyro.toml", controllers="gyro.json"), "gyro.json")
        """
    )
    assert run(runs).ret == 0
    plant = (Path(__file__).parents[2] / "models" / "three_gyro_platform.toml").read_text(encoding="utf-8")
    write(runs, "plant.toml", re.sub(r"(?m)^lag = .*$", "lag = 0.0006", plant))
    write(runs, "gyro.toml", JOB.replace('plant = "three_gyro_platform"', 'plant = "plant.toml"'))
    done = run(runs)
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(["E*caging 9-10: changed since the baseline: its plant*"])


@pytest.mark.slow
def test_with_xdist_the_process_that_sums_up_tells_what_its_workers_wrote(runs: pytest.Pytester) -> None:
    done = process(runs, "-n", "1", "--dist", "loadfile", "--update-baselines", "gyro.toml")
    done.assert_outcomes(passed=ITEMS + 1)
    assert done.stdout.str().count("gyro.baseline.json: written, 12 figures") == 1


def test_the_plugin_adds_nothing_to_an_unrelated_run(runs: pytest.Pytester) -> None:
    runs.makepyfile(
        """
        import sys

        def test_nothing_is_loaded():
            mine = {name for name in sys.modules if name.partition(".")[0] == "platform_ctrl"}
            package = {"platform_ctrl", "platform_ctrl.errors", "platform_ctrl.cli", "platform_ctrl.cli.testing"}
            light = {"error_lines", "interrupts", "testing.plugin"}
            assert mine == package | {f"platform_ctrl.cli.{name}" for name in light}
            assert not {"numpy", "scipy", "control", "matplotlib"} & set(sys.modules)
        """
    )
    done = process(runs, "-p", "no:xdist", "-p", "no:hypothesispytest")
    done.assert_outcomes(passed=1)
    assert "baselines" not in done.stdout.str()


def test_without_the_plugin_its_fixtures_are_unknown(runs: pytest.Pytester) -> None:
    runs.makepyfile(HELD)
    done = process(runs, "-p", "no:platform_ctrl")
    done.assert_outcomes(errors=1)
    done.stdout.fnmatch_lines(["E*fixture 'closed_loop' not found"])


def test_pytest_shows_help_on_marker_fixtures_and_options(runs: pytest.Pytester) -> None:
    run(runs, "--markers").stdout.fnmatch_lines(["@pytest.mark.platform_job(job, controllers=None, baseline=None): *"])
    shown = run(runs, "--fixtures").stdout
    shown.fnmatch_lines(["closed_loop *", "    Close the loops of a job: ``result = closed_loop(*"])
    shown.fnmatch_lines(["assert_baseline *", "requirement *", "job_result *"])
    run(runs, "--help").stdout.fnmatch_lines(
        ["*--update-baselines*", "*--platform-jobs=GLOB*", "*--platform-plots=DIR*", "*platform_jobs (args):*"]
    )


def test_a_marker_is_known_where_markers_are_strict(runs: pytest.Pytester) -> None:
    write(runs, "gyro.json", "{}")
    runs.makepyfile(MARKED)
    assert run(runs, "--strict-markers", "--collect-only").ret == 0


def test_the_page_on_regression_tests_says_what_happens(runs: pytest.Pytester) -> None:
    page = (Path(__file__).parents[2] / "docs" / "regression-tests.md").read_text(encoding="utf-8")
    for name, text in re.findall(r'^```\w+ title="(.+?)"\n(.*?)^```$', page, re.MULTILINE | re.DOTALL):
        write(runs, name, text)
    run(runs, "--update-baselines").assert_outcomes(passed=2 + 1 + ITEMS + 1)
    job = (runs.path / "gyro.toml").read_text(encoding="utf-8")
    write(runs, "gyro.toml", job.replace("bandwidth_hz = 20", "bandwidth_hz = 30").replace("hz = 40", "hz = 35"))
    shown = run(runs).stdout.str()
    said = [text.splitlines() for text in re.findall(r"^```text\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)]
    # The page's first failure asks for 30 Hz, its second for 20 Hz as the file does.
    for line in (*said[0], *(one.replace("at least 20 Hz", "at least 30 Hz") for one in said[1])):
        assert line.strip() in shown
