"""The first screen of the report: what limits each loop, and how far every requirement is from its limit."""

from __future__ import annotations

import re

import numpy as np
import pytest

from analysis.test_disk_pairs import inside
from camera_job import camera_job, tracking_loop
from platform_ctrl.analysis.margins import disk_margin
from platform_ctrl.design.loop import sampled_plant
from platform_ctrl.job.quantities import compared, disk_words
from platform_ctrl.report import first_screen, style, tables
from platform_ctrl.report.blocks import Cell, Columns, Distances, PageContent, Plate, Subsection, Table
from platform_ctrl.report.figures.nichols import nichols_figure
from platform_ctrl.report.first_screen import worst_plant
from platform_ctrl.report.job_page import prepared
from platform_ctrl.verification.changes import changes
from platform_ctrl.verification.verdict import JobResult
from report_jobs import caging, checked, classical, job, page_html, turn


@pytest.fixture(scope="module")
def result() -> JobResult:
    limits = {"bandwidth_hz": 60, "disk_margin_worst_case": 0.3, "torque_noise": 0.05}
    loop = caging(classical("slow", 25), classical(), limits=limits, use="classical")
    return checked(job(loop=[loop], uncertainty={"inertia": 0.1}, manoeuvre=[turn()]))


@pytest.fixture(scope="module")
def document(result: JobResult) -> PageContent:
    return prepared(result)


def test_every_requirement_has_one_mark_at_its_distance_and_the_missed_ones_are_left_of_the_limit(
    result: JobResult,
) -> None:
    _, shown = first_screen.distances(result)
    assert isinstance(shown, Distances)
    rows = tables.requirement_rows(result)
    assert sorted(mark.row for mark in shown.marks) == sorted(tables.row_name(k) for k in range(len(rows)))
    assert [mark.at for mark in shown.marks] == sorted(mark.at for mark in shown.marks)
    assert {mark.passed for mark in shown.marks} == {True, False}
    for mark in shown.marks:
        assert mark.passed == (mark.at >= shown.limit)
        row = rows[int(mark.row.rpartition("-")[2]) - 1]
        assert row.checked.name in mark.words
        assert row.checked.passed == mark.passed
    places = [(mark.at, mark.level) for mark in shown.marks]
    apart = [abs(a - b) >= 0.02 for k, (a, i) in enumerate(places) for b, j in places[:k] if i == j]
    assert all(apart)


def test_a_mark_leads_to_the_row_of_its_requirement(result: JobResult, document: PageContent) -> None:
    page = page_html(document)
    links = re.findall(r'<a href="#(requirement-\d+)" aria-label="([^"]+)"', page)
    assert len(links) == len(result.requirements)
    for place, words in links:
        [row] = re.findall(rf'<tr id="{place}"[^>]*>(.*?)</tr>', page, flags=re.DOTALL)
        name = re.sub(r"<span.*", "", re.findall(r"<th[^>]*>(.*?)</th>", row, flags=re.DOTALL)[0])
        assert name in words


def test_the_chain_names_the_tightest_requirement_of_each_loop_and_its_plant(result: JobResult) -> None:
    table = first_screen.chain_table(result)
    assert table is not None
    [[row]] = [group.rows for group in table.groups]
    missed = [one for one in result.loops[0].closed.results if not one.passed]
    assert row.missed
    assert row.cells[1].text == min(missed, key=lambda one: one.margin).name == "bandwidth"
    assert row.cells[1].note == "with nominal plant"
    # The platform is carried: no other loop can cost this one anything.
    assert [column.title for column in table.columns] == ["loop", "limited by", "margin"]


def test_the_nichols_plot_is_of_the_plant_with_the_least_disk_margin(result: JobResult, document: PageContent) -> None:
    design = result.loops[0].closed
    k = worst_plant(design)
    assert design.plants is not None
    assert k > 0
    margins = [
        disk_margin(sampled_plant(design.plants, i) * -design.own_controller).alpha
        for i in range(len(design.plants.labels))
    ]
    assert margins[k] == pytest.approx(min(margins), rel=1e-3)
    [columns] = [one for one in document.sections[0].blocks if isinstance(one, Columns)]
    assert design.plants.labels[k] in columns.right[0].caption  # type: ignore[union-attr]
    with style.settings():
        [axes] = nichols_figure(result.loops[0], k).axes
    assert axes.get_xticks()[1:-1].tolist() == [-300.0, -240.0, -180.0, -120.0, -60.0]
    drawn = [line.get_xydata() for line in axes.lines if len(line.get_xydata()) > 10]
    assert len(drawn) == 4  # two channels, with the worst and the nominal plant
    # Each curve passes the critical point on one side: it is shown in the turn around −180 degrees.
    for curve in map(np.asarray, drawn):
        level = np.abs(curve[:, 1])
        assert -330.0 < curve[np.argmin(level), 0] < -30.0


def cells_of(table: Table) -> list[Cell]:
    return [cell for group in table.groups for row in group.rows for cell in row.cells]


def test_at_most_five_changes_follow_the_first_screen_with_gain_and_conflict(
    result: JobResult, document: PageContent
) -> None:
    rows = changes(result)
    assert 1 <= len(rows) <= 5
    [part] = [one for one in document.sections[0].blocks if isinstance(one, Subsection)]
    assert part.title == "What to change"
    [table] = [one for one in part.blocks if isinstance(one, Table)]
    [[*shown]] = [group.rows for group in table.groups]
    assert len(shown) == len(rows)
    for one, row in zip(rows, shown, strict=True):
        requirement, change, gain, cost = row.cells
        assert requirement.text == one.target.before.name
        assert one.name in change.text
        assert gain.text.endswith(f"→ {compared(one.target.after)[0]}")
        if one.violated:
            assert cost.tone == "bad"
            assert one.violated[0].after.name in cost.text
            assert cost.text.endswith(compared(one.violated[0].after)[1])
        else:
            assert cost.tone != "bad"


def test_a_tracking_loop_around_a_rate_loop_is_reported_in_its_own_words() -> None:
    data = camera_job()
    data["loop"][0]["limits"] = {"disk_margin": 0.5, "attenuation_db": 20, "attenuation_hz": 5}
    data["loop"].append(tracking_loop({"disk_margin": 0.5, "torque_noise": 0.1}, crossover_hz=2.0))
    sections = {one.title: one for one in prepared(checked(data)).sections}
    track, rate = (
        {one.title: one.caption for one in sections[title].blocks if isinstance(one, Plate)}
        for title in ("Track", "Rate")
    )
    # The angles drift, which is no instability of a loop that reads rates.
    assert "The loop is stable" in rate["Root locus over the loop gain"]
    assert "torquer" not in track["Loop transfer"] + track["Nichols plot"] + track["Disturbances"]
    assert "the loop that each torquer closes" in rate["Loop transfer"]
    rows = {cell.text for table in sections["Track"].blocks if isinstance(table, Table) for cell in cells_of(table)}
    assert "noise of the commanded rate, rms" in rows
    assert "\u2264 0.1 rad/s" in rows
    assert "limit ≥ 20 dB" in rate["Other gains with limits"]


def test_a_figure_carries_its_scales_for_the_script() -> None:
    with style.settings():
        figure, [[left, right]] = style.panels(1, 2, 2.0)
        left.plot([1, 2], [3, 4])
        left.set_xlim(1, 2)
        left.set_ylim(3, 4)
        right.loglog([1, 10], [0.1, 100])
        right.set_xlim(1, 10)
        right.set_ylim(0.1, 100)
        drawn = style.svg(figure, "two panels")
    [scales] = re.findall(r'data-axes="([^"]*)"', drawn)
    assert "[1,2,0],[3,4,0]]" in scales
    assert "[1,10,1],[0.1,100,1]]" in scales


@pytest.mark.parametrize("alpha", [0.05, 0.4, 0.5, 0.81, 1.0 / 3.0, 1.5, 1.9])
def test_what_a_report_says_of_a_disk_margin_lies_inside_its_disk(alpha: float) -> None:
    assert inside(disk_words(alpha), alpha) == 4
