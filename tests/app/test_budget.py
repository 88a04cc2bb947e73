"""The line of sight's budget on the page: the command's numbers at rest, quick ones while a slider moves."""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")
pytest.importorskip("tomlkit")

import tomlkit
from bokeh.document import Document

from browser import screen, served
from camera_job import camera_job, camera_plant
from platform_ctrl import read_job
from platform_ctrl.app import fragments
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.fragments import next_step
from platform_ctrl.app.job_parts import BUDGET, ChipState
from platform_ctrl.app.session import Pages, Session
from platform_ctrl.app.settings import Settings
from platform_ctrl.app.tasks import Connection
from platform_ctrl.cli import main
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.quantities import plain
from platform_ctrl.verification.budget_result import LineOfSightBudget

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SPECTRUM = {"kind": "base-rate", "frequencies_hz": [0.5, 100.0], "densities": [1e-2, 1e-6]}
SOURCES = [{"name": f"base {axis}", "axis": axis, **SPECTRUM} for axis in (2, 3)]
JITTER = {"from_hz": 0.5, "to_hz": 200.0, "exposure": [0.01], "limits": {"jitter": 1e-3}, "source": SOURCES}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sight") / "camera.toml"
    job = camera_job(operation={"Omega": [0.2, 0.2, 0.2], "angles": {"q_el": [0.9]}}, budget=JITTER)
    out.write_text(tomlkit.dumps(job), encoding="utf-8")
    return out


@pytest.fixture(scope="module")
def backend(path: Path) -> Iterator[Backend]:
    made = Backend(path)
    measured(made, made.start())
    yield made
    made.close()


def chip(backend: Backend, settings: Settings) -> ChipState:
    """Return what the strip says about the budget."""
    states = backend.job_parts.states(backend.job_parts.parts(settings))
    return next(one for one in states if one.chip.key == BUDGET)


def measured(backend: Backend, settings: Settings) -> ChipState:
    """Measure the budget, as the page does once its sliders rest."""
    for part in backend.job_parts.parts(settings):
        if part.chip.key == BUDGET:
            backend.job_parts.measure(part)
    return chip(backend, settings)


def found(backend: Backend, settings: Settings) -> LineOfSightBudget:
    state = backend.budget(settings)
    assert state is not None
    assert state.found is not None
    return state.found


def test_at_rest_the_page_has_the_numbers_of_the_command(
    backend: Backend, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = backend.moved(backend.start(), "crossover_hz", 36.0)
    measured(backend, settings)
    state = backend.budget(settings)
    assert state is not None
    assert state.exact
    backend.save(settings, tmp_path / "saved.toml")
    assert main(["budget", str(tmp_path / "saved.toml"), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    here = found(backend, settings)
    np.testing.assert_allclose(here.total, record["total"]["rms"], rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(here.rms, [one["rms"] for one in record["sources"]], rtol=1e-9, atol=1e-18)
    judged = [(one.value, one.limit, one.passed) for one in here.results]
    assert judged == [
        (pytest.approx(one["value"], rel=1e-9), one["limit"], one["passed"]) for one in record["requirements"]
    ]


def test_while_a_slider_moves_only_friction_is_that_of_the_last_rest(backend: Backend) -> None:
    settings = backend.moved(backend.start(), "crossover_hz", 31.0)
    quick = backend.budget(settings)
    assert quick is not None
    assert not quick.exact
    assert "dry friction as it was balanced" in quick.line
    before = found(backend, settings)
    measured(backend, settings)
    after = found(backend, settings)
    assert before.names == after.names
    # The linear part follows at once: all that is left is how the friction has changed, which a small step hardly does.
    np.testing.assert_allclose(before.total[:2], after.total[:2], rtol=5e-3)
    assert before.results[0].name == after.results[0].name


def test_the_limits_of_the_budget_count_in_the_strip_as_those_of_the_command_do(backend: Backend) -> None:
    met = measured(backend, backend.start())
    assert (met.count, met.checked, met.missed) == (1, 1, 0)
    assert met.worst is not None
    assert met.worst.value == found(backend, backend.start()).results[0].value
    # A loop that is not stable misses them all.
    fast = backend.moved(backend.start(), "crossover_hz", 600.0)
    unstable = measured(backend, fast)
    assert (unstable.checked, unstable.missed) == (1, 1)
    state = backend.budget(fast)
    assert state is not None
    assert state.found is None
    assert "must be stable" in state.line


def test_a_limit_of_the_budget_is_edited_judged_and_saved(backend: Backend, tmp_path: Path) -> None:
    reached = found(backend, backend.start()).jitter
    name = backend.limit_names["line of sight", "line-of-sight jitter"]
    tighter = backend.with_limit(backend.start(), name, 0.9 * reached)
    assert measured(backend, tighter).missed == 1
    assert [one.limit for one in backend.sight.quick_results(tighter)] == [0.9 * reached]
    assert measured(backend, backend.start()).missed == 0
    saved = read_job(backend.save(tighter, tmp_path / "tighter.toml").job)
    assert saved.budget is not None
    assert saved.budget.limits.jitter == 0.9 * reached


def test_a_page_shows_the_budget_once_it_is_wanted(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
    waiting: list[Any] = []
    monkeypatch.setattr(Connection, "later", lambda connection, act: waiting.append(act))
    session = Session(Pages(backend), Document(), "")
    state = session.connection.model

    def table(count: int, what: str, **more: Any) -> str:
        """Return the table of the budget after a request, empty where there is none."""
        state.request = {"n": count, "what": what, **more}
        end = time.monotonic() + 60.0
        while state.answered[0] != count or any(t.name == "page" for t in threading.enumerate()):
            assert time.monotonic() < end, "it did not come"
            while waiting:
                waiting.pop(0)()
            time.sleep(0.002)
        return str(*state.parts.data.get("budget", ()))

    assert table(1, "ready") == ""
    shown = table(2, "view", view="budget")
    first = found(backend, backend.start())
    assert re.findall('scope="row">([^<]*)<', shown)[: len(first.names)] == list(first.names)
    assert all(f">{plain(1e6 * one, 4)}<" in shown for one in first.total)
    panels = {one.name: one for one in session.plots.panels}

    def drawn(panel: str, name: str) -> Any:
        return panels[panel].figures[0].sources[name].data

    # The last bar, drawn first, is all together, and ends where the curve over frequency does.
    assert max(drawn("waterfall0", "bands")["xs"][0]) == pytest.approx((1e6 * first.total[0]) ** 2, rel=1e-5)
    assert drawn("cumulative0", "lines")["ys"][-1][-1] == pytest.approx(1e6 * first.total[0], rel=0.05)
    # Of each axis the legend names its own largest source first.
    for axis in (0, 1):
        largest = first.names[int(np.argmax(first.rms[:, axis]))]
        assert [words for words, *_ in panels[f"cumulative{axis}"].keys[:2]] == ["all sources", largest]
    loop = drawn("bode", "lines")["ys"][-1].tolist()
    moved = table(3, "move", moves=[{"slider": "crossover_hz", "value": 33.0}], gesture=1)
    assert f">{plain(1e6 * first.total[0], 4)}<" not in moved
    assert "not exact while sliders move" in moved
    # The plots of the loop follow when they are shown again.
    assert drawn("bode", "lines")["ys"][-1].tolist() == loop
    assert table(4, "view", view="loop") == moved
    assert drawn("bode", "lines")["ys"][-1].tolist() != loop
    table(5, "view", view="somewhere")
    assert "view must be one of" in state.line[0]
    session.close(None)


def test_the_table_in_a_browser_shows_the_numbers_and_the_limits(backend: Backend, browser: Browser) -> None:
    with served(Pages(backend).fill) as server, screen(browser, server.address) as seen:
        page = seen.page
        page.wait_for_selector("body:not(.starting)", state="attached")
        # There is no servo: nothing to choose between caged and stabilised.
        assert page.locator("#mode").is_hidden()
        page.locator("#view label", has_text="Budget").click()
        total = page.locator("#panel-budget tr.total td").first
        total.wait_for()
        assert float(total.text_content() or "") == pytest.approx(
            1e6 * found(backend, backend.start()).total[0], rel=1e-3
        )
        assert page.locator("#budget-limits tr").count() == 1
        assert page.locator("#panel-bode").is_hidden()
        assert page.locator("#panel-waterfall0 canvas").first.is_visible()
        page.keyboard.press("j")
        page.locator("#panel-bode").wait_for()
        assert seen.complaints == []


@pytest.fixture(scope="module")
def tight(backend: Backend) -> Iterator[Backend]:
    """The same job, whose limit of the jitter is 1 % above what it has."""
    limit = 1.01 * found(backend, backend.start()).jitter
    job = camera_job(
        operation={"Omega": [0.2, 0.2, 0.2], "angles": {"q_el": [0.9]}}, budget=JITTER | {"limits": {"jitter": limit}}
    )
    made = Backend(read_job(job))
    measured(made, made.start())
    yield made
    made.close()


def test_what_sliders_do_to_the_jitter_counts_among_their_effects(tight: Backend) -> None:
    """More gain against the base and the friction: less jitter; the arrows say so, and by how much of the limit."""
    start = tight.start()
    effects = tight.influence(start)
    (jitter,) = tight.sight.quick_results(start)
    assert effects.requirements[-1] == jitter.name
    assert effects.ratios[-1] == pytest.approx(1.0 / 1.01, rel=5e-3)
    change = dict(zip(effects.options, effects.change[-1], strict=True))
    faster = tight.moved(start, "crossover_hz", 1.05 * start.options["rate"]["pi"]["crossover_hz"])
    measured(tight, faster)
    expected = found(tight, faster).results[0].ratio - effects.ratios[-1]
    assert change["crossover_hz"] == pytest.approx(expected, rel=0.05)
    assert change["crossover_hz"] < -0.01
    step = next_step(effects, tight.sliders(start))
    assert step["slider"] == "crossover_hz"
    assert step["value"] > start.options["rate"]["pi"]["crossover_hz"]
    assert jitter.name in step["words"]


@pytest.mark.parametrize("runs", [None, 2])
def test_a_limit_that_the_linear_budget_cannot_judge_is_left_to_the_runs_of_check(runs: int | None) -> None:
    """Bearings that hardly slide: without runs the limit is missed, with runs `check` alone judges it."""
    stuck = [{"gimbal": one, "coulomb": 0.5, "coulomb_rate": 0.5} for one in ("az", "el")]
    spec = JITTER | {"limits": {"jitter": 2e-3}} | ({} if runs is None else {"runs": runs})
    made = Backend(read_job(camera_job(plant=camera_plant(friction=stuck), budget=spec)))
    start = made.start()
    state = measured(made, start)
    (jitter,) = made.sight.quick_results(start)
    assert not jitter.passed
    assert jitter.value < jitter.limit
    shown = fragments.strip([state], {}, "")
    rows = fragments.table([jitter], made.sliders(start), None, {}, False, made.read.budget)
    if runs is None:
        assert state.missed == 1
        assert "not valid" in shown
        assert "state runs in [budget]" in shown
        assert "✗" in rows
    else:
        assert (state.count, state.checked, state.missed, state.measuring) == (1, 0, 0, False)
        assert "1 limit, judged by the runs of check" in shown
        assert "✗" not in rows
        assert "by runs" in rows
    # No slider helps it: the next step is about another limit.
    assert jitter.name not in made.influence(start).requirements
    made.close()


def test_the_chip_of_loops_that_are_not_stable_says_so_in_place_of_a_margin(backend: Backend) -> None:
    state = measured(backend, backend.moved(backend.start(), "crossover_hz", 600.0))
    assert '<span class="margin">unstable</span>' in fragments.strip([state], {}, "")


def test_a_limit_that_no_loop_can_meet_is_refused(backend: Backend) -> None:
    key = next(one for one in backend.start().limits if one.endswith(".disk_margin") and ".limits." in one)
    with pytest.raises(ArgumentError, match=r"disk_margin must be at most 2, got 5; no loop has more"):
        backend.with_limit(backend.start(), key, 5)
    assert backend.with_limit(backend.start(), key, 1.5).limits[key] == 1.5
