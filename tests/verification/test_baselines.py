"""Baselines: which figures they hold, how their files are judged and written, and what counts as worse."""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies
from matplotlib.figure import Figure as Drawn

import platform_ctrl as pc
from platform_ctrl.analysis.metrics import METRICS, Metric
from platform_ctrl.analysis.norms import noise_rms
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.report.failures import change_text, moved_text, write_junit
from platform_ctrl.report.figures.baseline_changes import moved_figure, write_moved_figure
from platform_ctrl.verification import JobResult
from platform_ctrl.verification.baselines import accepted, compare, read_baseline, update_baseline
from platform_ctrl.verification.baselines.file import plot_beside, remove_plot, write_baseline
from platform_ctrl.verification.baselines.record import Baseline, Tolerance, figures_of
from platform_ctrl.verification.coupled import coupled_check

JOB: dict[str, Any] = {
    "schema": 2,
    "name": "three gyros",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [0.0, 0.0, 0.0]},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "coupled": {"coupling_cost": 0.05},
    "loop": [
        {
            "name": f"caging {'-'.join(gimbals)}",
            "kind": "caging",
            "gimbals": gimbals,
            "use": "classical",
            "limits": {"bandwidth_hz": 10},
            "soft": {"damping": 0.5, "bandwidth_hz": 50},
            "design": [{"name": "classical", "method": "classical", "crossover_hz": hz, "integral_hz": 2}],
        }
        for gimbals, hz in ((["4", "5", "7"], 30), (["9", "10"], 40))
    ]
    + [
        {
            "name": "stabilisation",
            "kind": "stabilisation",
            "use": "servo",
            "design": [{"name": "servo", "method": "platform-servo", "crossover_hz": 4, "filter_hz": 50}],
        }
    ],
    "manoeuvre": [
        {
            "name": "turn",
            "mode": "caged",
            "axis": 1,
            "rate": 0.2,
            "rise": 0.01,
            "hold": 0.0,
            "duration": 0.02,
            "limits": {"angle": 0.003},
        },
        {"name": "step", "mode": "stabilised", "axis": 2, "torque": 0.1, "duration": 0.02, "limits": {}},
    ],
}


def worked_out(job: dict[str, Any]) -> JobResult:
    read = pc.read_job(job)
    return pc.verification.check_job(read, pc.design.loops(read))


@pytest.fixture(scope="module")
def result() -> JobResult:
    return worked_out(JOB)


@pytest.fixture(scope="module")
def slower() -> JobResult:
    job = copy.deepcopy(JOB)
    job["loop"][1]["design"][0]["crossover_hz"] = 35
    return worked_out(job)


@pytest.fixture
def file(result: JobResult, tmp_path: Path) -> Path:
    return write_baseline(accepted(result), tmp_path / "gyros.json")


def changed(file: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    data = json.loads(file.read_text(encoding="utf-8"))
    change(data)
    file.write_text(json.dumps(data), encoding="utf-8")
    return file


def entry(data: dict[str, Any], subject: str, name: str) -> dict[str, Any]:
    [found] = [one for one in data["figures"] if (one["subject"], one["name"]) == (subject, name)]
    return found  # type: ignore[no-any-return]


def state(result: JobResult, baseline: Baseline, subject: str, name: str) -> str:
    [found] = [one for one in compare(result, baseline).changes if (one.subject, one.name) == (subject, name)]
    return found.state


def test_every_requirement_and_goal_is_a_figure_and_each_figure_stands_once(result: JobResult) -> None:
    figures = figures_of(result)
    names = [(one.subject, one.name) for one in figures]
    assert len(set(names)) == len(names)
    values = {(one.subject, one.name): one.value for one in figures}
    for one in result.requirements:
        assert values[one.subject, one.name] == one.value
    for outcome in result.loops:
        for goal in outcome.closed.goals:
            assert values[goal.subject, goal.name.removeprefix("goal: ")] == goal.value


def test_what_is_measured_is_a_figure_though_nothing_is_asked_of_it(result: JobResult) -> None:
    figures = {(one.subject, one.name): one for one in figures_of(result)}
    loop = result.loops[1].closed
    assert loop.measures is not None
    margin = figures["caging 9-10", "disk margin"]
    assert (margin.value, margin.limit, margin.sense) == (loop.measures.disk_margin[0], None, "at least")
    assert figures["caging 9-10", "bandwidth"].limit == 10.0
    assert figures["all loops closed", "simultaneous disk margin"].value == result.coupled.simultaneous.guaranteed
    assert figures["all loops closed", "torque noise, Q9"].unit == "N m"
    assert figures["turn", "largest gimbal angle"].limit == 0.003
    # The attitude of a caged run is prescribed: it says nothing of the loops.
    assert ("turn", "largest platform angle") not in figures
    assert figures["step", "largest platform angle"].limit is None


def test_a_new_metric_of_torquers_is_in_the_coupled_check_and_in_baselines(
    result: JobResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    variance = Metric(
        name="largest variance of a torque",
        key="torque_variance",
        unit="N² m²",
        sense="at most",
        meaning="variance of the torque command from the noise of all sensors",
        measure=METRICS["torque noise"].measure,
        of_torquers=lambda loop, rms: noise_rms(loop, rms) ** 2,
    )
    monkeypatch.setitem(METRICS, "torque variance", variance)
    limited = copy.deepcopy(JOB)
    limited["loop"][2]["limits"] = {"torque_variance": 1.0}
    check = coupled_check(pc.read_job(limited), result.model, [outcome.closed.controller for outcome in result.loops])
    [verdict] = [one for one in check.results if one.name == variance.name]
    assert verdict.value == pytest.approx(max(check.torque_noise[-3:]) ** 2, rel=1e-9)
    figures = {one.name: one.value for one in figures_of(dataclasses.replace(result, coupled=check))}
    assert figures["torque variance, Q9"] == pytest.approx(figures["torque noise, Q9"] ** 2, rel=1e-9)


def test_a_goal_in_another_band_than_the_limit_is_a_figure_of_its_own() -> None:
    job = copy.deepcopy(JOB)
    del job["loop"][2], job["loop"][0], job["manoeuvre"]
    job["loop"][0]["limits"] = {"tracking": 0.5, "tracking_hz": 5}
    job["loop"][0]["soft"] = {"tracking": 0.1, "tracking_hz": 2, "bandwidth_hz": 50}
    values = {one.name: one.value for one in figures_of(worked_out(job)) if one.subject == "caging 9-10"}
    assert values["goal: tracking error"] < values["tracking error"]
    assert "goal: bandwidth" not in values


def test_a_baseline_is_read_as_it_was_written(result: JobResult, file: Path) -> None:
    written, read = accepted(result), read_baseline(file)
    assert (read.job, read.tolerance.relative) == ("three gyros", 0.02)
    assert [one.key for one in read.figures] == [one.key for one in written.figures]
    assert [one.value for one in read.figures] == [one.value for one in written.figures]
    for before, after in zip(written.loops, read.loops, strict=True):
        assert before.agrees(after)
        np.testing.assert_array_equal(before.controller.A, after.controller.A)
    assert read.loops[2].plant is None
    again = file.read_bytes()
    assert write_baseline(read, file).read_bytes() == again


def test_the_file_has_a_figure_a_line_and_the_controllers_as_check_reads_them(result: JobResult, file: Path) -> None:
    lines = file.read_text(encoding="utf-8").splitlines()
    assert sum('"subject"' in line for line in lines) == len(figures_of(result))
    assert all(line.count('"subject"') <= 1 for line in lines)
    controllers = pc.verification.read_controllers(file, result.job)
    for K, outcome in zip(controllers, result.loops, strict=True):
        np.testing.assert_array_equal(K.C, outcome.closed.controller.C)


def test_a_baseline_with_the_row_names_of_earlier_versions_is_read_and_compared(result: JobResult, file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    for old, new in (
        ("slowest decay", "minimum decay rate"),
        (" over the spread", ", worst case"),
    ):
        assert new in text
        text = text.replace(new, old)
    file.write_text(text, encoding="utf-8")
    found = compare(result, read_baseline(file))
    assert found.passed
    assert not found.of("new", "missing")


def test_an_accepted_result_passes_and_nothing_has_moved(result: JobResult, file: Path) -> None:
    comparison = compare(result, read_baseline(file))
    assert comparison.passed
    assert {one.state for one in comparison.changes} == {"within"}
    assert all(before.agrees(now) for before, now in comparison.pairs)


def test_what_is_worse_fails_and_says_which_matrices_are_others(slower: JobResult, file: Path) -> None:
    comparison = compare(slower, read_baseline(file))
    assert not comparison.passed
    assert ("caging 9-10", "bandwidth") in {(one.subject, one.name) for one in comparison.of("worse")}
    text = moved_text(comparison, "gyros.json")
    assert "caging 9-10: changed since the baseline: its controller" in text
    assert "caging 4-5-7: plant and controller are those of the baseline" in text
    [bandwidth] = [one for one in comparison.of("worse") if one.name == "bandwidth"]
    words = "caging 9-10: bandwidth: 27.68 Hz -> 24.03 Hz (-13 %), tolerance 0.5536 Hz: worse"
    assert change_text(bandwidth) == words
    assert bandwidth.share == pytest.approx(24.03 / 27.68 - 1.0, abs=1e-3)


def test_what_is_better_is_told_and_passes(result: JobResult, slower: JobResult) -> None:
    comparison = compare(result, accepted(slower))
    assert comparison.passed
    assert "bandwidth" in {one.name for one in comparison.of("better")}
    assert "better by more than its tolerance: caging 9-10: bandwidth, 24.03 Hz -> 27.68 Hz" in moved_text(
        comparison, "gyros.json"
    )


@pytest.mark.parametrize(
    ("tolerance", "expected"),
    [({"relative": 0.2}, "within"), ({"absolute": 4.0}, "within"), ({"absolute": 3.0}, "worse"), ({}, "worse")],
)
def test_a_figure_has_the_tolerance_that_stands_beside_it(
    slower: JobResult, file: Path, tolerance: dict[str, float], expected: str
) -> None:
    changed(file, lambda data: entry(data, "caging 9-10", "bandwidth").update(tolerance))
    assert state(slower, read_baseline(file), "caging 9-10", "bandwidth") == expected


def test_the_tolerance_of_the_file_holds_for_all_other_figures(slower: JobResult, file: Path) -> None:
    changed(file, lambda data: data.update(tolerance={"relative": 0.2}))
    assert compare(slower, read_baseline(file)).passed


def test_at_the_edge_of_its_tolerance_a_figure_is_within_it() -> None:
    assert Tolerance(relative=0.02).allowed(-50.0) == 1.0
    assert Tolerance(relative=0.02, absolute=0.5).allowed(1.0) == 0.5
    with pytest.raises(ArgumentError, match="relative"):
        Tolerance(relative=-0.1)


def test_a_loss_near_zero_has_an_absolute_tolerance(result: JobResult) -> None:
    tolerances = {one.name: one.tolerance for one in accepted(result).figures}
    lost = tolerances["disk margin lost by coupling"]
    assert lost is not None
    assert lost.allowed(0.0) == lost.allowed(0.5) == 0.01


def test_a_figure_that_is_no_number_any_more_is_worse_whatever_its_tolerance(result: JobResult) -> None:
    baseline = accepted(result)
    broken = _with_value(result, math.inf)
    assert state(broken, baseline, "caging 9-10", "bandwidth") == "worse"
    text = moved_text(compare(broken, baseline), "gyros.json")
    assert "none (unstable)" in text
    unstable = accepted(broken)
    [figure] = [one for one in unstable.figures if one.key[:2] == ("caging 9-10", "bandwidth")]
    assert figure.value == math.inf
    assert state(result, unstable, "caging 9-10", "bandwidth") == "better"
    assert state(_with_value(result, math.nan), unstable, "caging 9-10", "bandwidth") == "within"


def test_what_is_no_number_is_null_in_the_file(result: JobResult, tmp_path: Path) -> None:
    file = write_baseline(accepted(_with_value(result, math.nan)), tmp_path / "gyros.json")
    data = json.loads(file.read_text(encoding="utf-8"))
    assert entry(data, "caging 9-10", "bandwidth")["value"] is None
    assert state(result, read_baseline(file), "caging 9-10", "bandwidth") == "better"


def _with_value(result: JobResult, number: float) -> JobResult:
    """The same result with another value of one requirement."""
    from platform_ctrl.common.values import replaced

    requirements = tuple(
        replaced(one, {"value": number}) if (one.subject, one.name) == ("caging 9-10", "bandwidth") else one
        for one in result.requirements
    )
    return replaced(result, {"requirements": requirements})


def test_a_figure_that_is_missing_fails_and_a_new_one_does_not(result: JobResult, file: Path) -> None:
    def change(data: dict[str, Any]) -> None:
        data["figures"].append({"subject": "gone", "name": "bandwidth", "value": 1, "unit": "Hz", "sense": "at least"})
        data["figures"].remove(entry(data, "step", "largest gimbal angle"))
        entry(data, "turn", "largest gimbal angle")["unit"] = "mrad"

    comparison = compare(result, read_baseline(changed(file, change)))
    assert not comparison.passed
    assert [one.subject for one in comparison.of("missing")] == ["turn", "gone"]
    # In another unit a figure is another figure: the numbers cannot be compared.
    assert {one.subject for one in comparison.of("new")} == {"step", "turn"}
    assert "not measured any more: gone: bandwidth" in moved_text(comparison, "gyros.json")


def test_an_update_keeps_tolerances_and_every_number_that_rounding_alone_has_moved(
    slower: JobResult, file: Path
) -> None:
    def change(data: dict[str, Any]) -> None:
        entry(data, "caging 9-10", "damping")["absolute"] = 0.05
        entry(data, "caging 4-5-7", "damping")["value"] *= 1.0 + 2e-7
        data["figures"].append({"subject": "gone", "name": "bandwidth", "value": 1, "unit": "Hz", "sense": "at least"})
        data["tolerance"] = {"relative": 0.03}

    before = read_baseline(changed(file, change))
    update = update_baseline(slower, file)
    assert update.written
    assert "1 worse" not in update.summary
    assert update.summary.endswith("removed gone: bandwidth")
    after = {one.key[:2]: one for one in read_baseline(file).figures}
    assert read_baseline(file).tolerance.relative == 0.03
    assert after["caging 9-10", "damping"].tolerance is not None
    assert after["caging 9-10", "damping"].tolerance.allowed(1.0) == 0.05
    [kept] = [one.value for one in before.figures if one.key[:2] == ("caging 4-5-7", "damping")]
    assert after["caging 4-5-7", "damping"].value == kept
    assert ("gone", "bandwidth") not in after
    written = file.read_bytes()
    update = update_baseline(slower, file)
    assert (update.written, update.summary) == (False, f"{file}: unchanged")
    assert file.read_bytes() == written


def test_an_update_makes_folders(result: JobResult, tmp_path: Path) -> None:
    update = update_baseline(result, tmp_path / "some" / "where" / "gyros.json")
    assert update.path.exists()
    assert update.summary.endswith(f"written, {update.figures} figures")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        update_baseline(result, tmp_path / "file" / "gyros.json")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data.update(schema=2), "schema must be 1, the format that this version reads, got 2"),
        (lambda data: data.pop("figures"), 'the key "figures" is missing'),
        (lambda data: data.update(figure=[]), 'unknown key "figure"; did you mean "figures"?'),
        (lambda data: data.update(job=3), "job must be the title of a job, got 3"),
        (lambda data: data.update(tolerance={"relative": -1}), "tolerance: relative must be a number >= 0, got -1"),
        (lambda data: data["figures"].insert(0, 1), "figures 1 must be a table, got 1"),
        (
            lambda data: data["figures"][1].update(value="2"),
            'worst case": value must be a number, or',
        ),
        (
            lambda data: data["figures"][0].update(value=1e999),
            '"minimum decay rate": value must be a number, or null for none, got inf',
        ),
        (lambda data: data["figures"][0].update(sense="more"), 'sense must be "at least" or "at most", got "more"'),
        (lambda data: data["figures"][0].update(realtive=0.1), 'unknown key "realtive"; did you mean "relative"?'),
        (lambda data: data["figures"][0].update(absolute=True), "absolute must be a number >= 0, got true"),
        (lambda data: data["figures"].append(data["figures"][0]), 'the figure is listed twice for "caging 4-5-7"'),
        (lambda data: data["controllers"][0].pop("A"), 'controllers 1 "caging 4-5-7": the key "A" is missing'),
        (lambda data: data["controllers"][0].update(dt=0), "dt must be the sample period, from 1e-9 to 1e6 s, got 0.0"),
        (lambda data: data["controllers"][0]["A"].pop(), "A must be 5 x 5 (square), row 1 has 6 elements"),
        (lambda data: data["controllers"][0]["B"].pop(), "B must be 6 x 3 (by inputs, outputs and A), has 5 rows"),
        (
            lambda data: data["controllers"][0].update(inputs=["a", "a"]),
            'inputs: "a" is listed twice',
        ),
        (
            lambda data: data["plants"][0]["D"][0].__setitem__(0, None),
            'plants 1 "caging 4-5-7": D: element (1, 1) must be a finite number, got None',
        ),
    ],
)
def test_a_file_that_makes_no_sense_is_one_line_with_its_name_and_the_key(
    file: Path, change: Callable[[dict[str, Any]], None], said: str
) -> None:
    changed(file, change)
    with pytest.raises(InputError) as caught:
        read_baseline(file)
    message = str(caught.value)
    assert message.startswith(str(file))
    assert said in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"{", "is not JSON"),
        (b"[" * 100_000, "nested too deeply"),
        (b"9" * 5000, "cannot be read"),
        (b"\xff", "is not UTF-8"),
        (b"[1]", "must be a table, got [1]"),
        (b"", "is not JSON"),
    ],
)
def test_a_file_that_is_no_json_is_one_line(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "gyros.json"
    file.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(said)):
        read_baseline(file)
    with pytest.raises(InputError, match="there is no such file"):
        read_baseline(tmp_path / "none.json")


_JSON = strategies.recursive(
    strategies.none() | strategies.booleans() | strategies.floats() | strategies.text(max_size=3),
    lambda inner: strategies.lists(inner, max_size=3) | strategies.dictionaries(strategies.text(max_size=3), inner),
    max_leaves=4,
)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(strategies.data())
def test_a_file_in_which_anything_is_changed_is_read_or_refused_in_one_line(
    result: JobResult, tmp_path: Path, data: strategies.DataObject
) -> None:
    file = write_baseline(accepted(result), tmp_path / "gyros.json")
    content = table = json.loads(file.read_text(encoding="utf-8"))
    while True:
        keys = list(table) if isinstance(table, dict) else list(range(len(table)))
        key = data.draw(strategies.sampled_from(keys))
        if not (isinstance(table[key], dict | list) and table[key]) or data.draw(strategies.booleans()):
            break
        table = table[key]
    table[key] = data.draw(_JSON)
    file.write_text(json.dumps(content), encoding="utf-8")
    try:
        read = read_baseline(file)
    except InputError as error:
        assert str(error).isprintable()  # noqa: PT017
    else:
        compare(result, read)
        write_baseline(read, file)
        read_baseline(file)


def test_an_update_does_not_overwrite_what_is_no_baseline(result: JobResult, tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    file.write_text('{"schema": 1, "controllers": []}')
    with pytest.raises(InputError, match='the key "figures" is missing'):
        update_baseline(result, file)
    assert json.loads(file.read_text()) == {"schema": 1, "controllers": []}


def test_the_figure_shows_every_bar_and_the_loops_that_have_changed(
    result: JobResult, slower: JobResult, tmp_path: Path
) -> None:
    comparison = compare(slower, accepted(result))
    figure = moved_figure(comparison, "three gyros")
    assert isinstance(figure, Drawn)
    bars, *loops = figure.axes
    assert [axes.get_title(loc="left") for axes in loops] == ["S of caging 9-10"]
    labels = [label.get_text() for label in bars.get_yticklabels()]
    assert labels[0] == "caging 9-10: bandwidth"
    assert len(labels) == 24
    assert bars.get_xlabel().endswith(f"{len(comparison.changes) - 24} figures more")
    before, now = (line.get_ydata() for line in loops[0].get_lines()[:2])
    assert np.all(np.isfinite(before))
    assert np.max(np.asarray(now) / np.asarray(before)) > 1.1
    plot = write_moved_figure(comparison, "three gyros", plot_beside(tmp_path / "made" / "gyros.json"))
    assert plot == tmp_path / "made" / "gyros.moved.png"
    assert plot.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_the_figure_stands_infinite_changes_and_nothing_to_compare(result: JobResult) -> None:
    comparison = compare(_with_value(result, math.inf), accepted(result))
    bars = moved_figure(comparison, "unstable").axes[0]
    assert np.isfinite(bars.get_xlim()).all()
    baseline = accepted(result)
    from platform_ctrl.common.values import replaced

    assert moved_figure(compare(result, replaced(baseline, {"figures": ()})), "nothing").axes


@pytest.mark.parametrize(
    ("key", "matrix", "number"),
    [("controllers", "A", 1e200), ("plants", "D", 1.6e8), ("plants", "A", 1e300), ("controllers", "D", -1e-300)],
)
def test_the_figure_stands_matrices_that_were_edited_by_hand(
    result: JobResult, file: Path, key: str, matrix: str, number: float
) -> None:
    changed(file, lambda data: data[key][0][matrix][0].__setitem__(1, number))
    figure = moved_figure(compare(result, read_baseline(file)), "edited")
    assert [axes.get_title(loc="left") for axes in figure.axes[1:]] == ["S of caging 4-5-7"]


def test_junit_says_what_was_asked_and_what_moved(result: JobResult, slower: JobResult, tmp_path: Path) -> None:
    import junitparser

    baseline = replaced_job_name(accepted(result))
    comparison = compare(slower, baseline)
    file = write_junit(slower, tmp_path / "check.xml", comparison=comparison, baseline="gyros.json")
    suites = {suite.name: suite for suite in junitparser.JUnitXml.fromfile(str(file))}
    assert list(suites) == ["caging 4-5-7", "caging 9-10", "all loops closed", "turn", "gyros.json"]
    cases = {case.name: case for case in suites["gyros.json"]}
    assert len(cases) == len(comparison.changes)
    assert cases["caging 9-10: bandwidth"].is_failure
    assert "27.68 Hz -> 24.03 Hz" in cases["caging 9-10: bandwidth"].result[0].message
    assert not cases["caging 4-5-7: bandwidth"].result
    assert suites["gyros.json"].failures == len(comparison.failed)
    root = ElementTree.parse(file).getroot()
    assert root.tag == "testsuites"
    assert int(root.get("failures", "-1")) == len(comparison.failed)
    [case] = root.findall("testsuite[@name='caging 9-10']/testcase[@name='bandwidth']")
    properties = {one.get("name"): one.get("value") for one in case.iter("property")}
    assert (properties["limit"], properties["unit"], properties["sense"]) == ("10", "Hz", "at least")


def replaced_job_name(baseline: Baseline) -> Baseline:
    """A title is no figure: what a job is called does not decide."""
    from platform_ctrl.common.values import replaced

    return replaced(baseline, {"job": "another title"})


def test_junit_holds_names_that_xml_cannot(result: JobResult, tmp_path: Path) -> None:
    from platform_ctrl.common.values import replaced

    job = replaced(result.job, {"name": 'a "gyro" & <co>\x01'})
    one = replaced(result.requirements[0], {"subject": "<a> & b", "passed": False})
    odd = replaced(result, {"job": job, "requirements": (one,)})
    root = ElementTree.parse(write_junit(odd, tmp_path / "odd.xml")).getroot()
    assert root.get("name") == 'a "gyro" & <co>'
    [suite] = root
    assert suite.get("name") == "<a> & b"
    assert suite.get("failures") == "1"


def test_a_plot_that_cannot_be_removed_is_no_error(tmp_path: Path) -> None:
    plot = plot_beside(tmp_path / "gyro.json")
    plot.mkdir()
    remove_plot(plot)
    assert plot.is_dir()
