"""Figures that are taken from a store instead of being drawn again: only where all that they show is the same."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from one_change import leaves, mutated
from platform_ctrl.common.processes import SecondProcess
from platform_ctrl.common.store import Store, key_of
from platform_ctrl.report import style
from platform_ctrl.report.page import job_page, kept_blocks
from platform_ctrl.report.page.blocks import Paragraph, Plate, html, missing
from platform_ctrl.report.page.kept_blocks import Drawing, kept_or_drawn, keys_of
from platform_ctrl.verification import JobResult
from report_jobs import caging, checked, classical, job, turn


@pytest.fixture(scope="module")
def result() -> JobResult:
    loop = caging(classical(), limits={"bandwidth_hz": 20, "disk_margin": 0.4})
    return checked(job(loop=[loop], uncertainty={}, manoeuvre=[turn()]))


@pytest.fixture(scope="module")
def drawings(result: JobResult) -> list[Drawing]:
    return job_page._drawings(result)


def test_the_second_page_is_the_first_and_nothing_is_drawn_for_it(
    result: JobResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path / "reuse")
    first = html(job_page._document(result, None, None, None, store=store))

    def drawn(*_: object, **__: object) -> str:
        raise AssertionError("a figure is drawn")

    monkeypatch.setattr(style, "svg", drawn)
    monkeypatch.setattr(job_page, "axes_picture", drawn)
    monkeypatch.setattr(job_page, "changes", drawn)
    assert html(job_page._document(result, None, None, None, store=store)) == first
    lost = missing(job_page._document(result, None, None, None, store=Store(store.folder, fresh=True)))
    assert all("not drawn: AssertionError: a figure is drawn" in line for line in lost)
    assert len(lost) > 5
    # What failed once is not kept.
    monkeypatch.undo()
    assert html(job_page._document(result, None, None, None, store=store)) == first


def test_figures_of_loops_drawn_ahead_are_those_of_the_page_and_are_not_drawn_again(
    result: JobResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = html(job_page._document(result, None, None, None))
    store = Store(tmp_path / "reuse", fresh=True)
    monkeypatch.setenv("PLATFORM_CTRL_PROCESSES", "2")
    with SecondProcess() as beside:
        ahead = job_page.loops_ahead(result.job, result.loops, beside, store)
        assert len(ahead.keys) == len(result.loops)
        beside.finished(ahead.work)
        assert beside._process is not None  # it did not die of them
        monkeypatch.setattr(job_page, "loop_responses", None)  # figures of loops cannot be drawn here any more
        assert html(job_page.drawn_beside(result, beside, store, ahead)) == page
        kept = Store(store.folder)
        assert job_page.loops_ahead(result.job, result.loops, beside, kept).keys == []


def test_each_value_that_a_drawing_is_given_is_in_its_key(drawings: list[Drawing]) -> None:
    before = keys_of(drawings)
    assert "" not in before
    assert len(set(before)) == len(before)
    # The drawings of the whole have the same argument: one stands for all.
    for drawing in drawings[:3]:
        for k, argument in enumerate(drawing.arguments):
            swapped = [*drawing.arguments]
            swapped[k] = "another"
            assert keys_of([drawing._replace(arguments=tuple(swapped))]) != keys_of([drawing])
            key = key_of(argument)
            for place, _ in leaves(argument):
                assert key_of(mutated(argument, place)) != key, (drawing.draw, place)


def test_what_a_figure_does_not_show_is_not_given_to_its_drawing(drawings: list[Drawing]) -> None:
    whole = drawings[-1].arguments[0]
    assert whole.runs == ()


def test_settings_and_the_function_are_in_the_key(drawings: list[Drawing]) -> None:
    before = keys_of(drawings)
    with mpl.rc_context({"path.snap": False}):
        assert not set(keys_of(drawings)) & set(before)
    with mpl.rc_context({"axes.linewidth": 3.0}):  # the report has its own
        assert keys_of(drawings) == before
    assert keys_of([Drawing(_plate, ("a",))]) != keys_of([Drawing(_paragraph, ("a",))])


def test_what_cannot_be_hashed_is_drawn_each_time(tmp_path: Path) -> None:
    store = Store(tmp_path / "reuse")
    made: list[Any] = kept_or_drawn([Drawing(_paragraph, (object(),)), Drawing(_paragraph, ("kept",))], store, None)
    assert [one.text for one in made] == ["drawn", "drawn"]
    assert len(list(store.folder.iterdir())) == 1


@pytest.mark.parametrize("content", ["", "text", 3, [], {"": "Plate"}, "eJyrVlKyUgrISSxJVaoFAB0pBCM="])
def test_a_kept_file_that_holds_no_blocks_is_drawn_again(content: Any, tmp_path: Path) -> None:
    store = Store(tmp_path / "reuse")
    drawing = Drawing(_plate, ("a",))
    [key] = keys_of([drawing])
    store.keep(key, content)
    for _ in range(2):
        [found] = kept_or_drawn([drawing], store, None)
        assert vars_of(found) == vars_of(_plate("a"))


def test_blocks_come_back_as_they_were() -> None:
    blocks = (_plate("a"), [Paragraph(text="ü\n", tone="bad")], None, 1.5, np.pi)
    again = kept_blocks._read(kept_blocks._written(blocks))
    assert vars_of(again) == vars_of(blocks)


def vars_of(item: Any) -> Any:
    if dataclasses.is_dataclass(item):
        return type(item), [vars_of(getattr(item, field.name)) for field in dataclasses.fields(item)]
    return [vars_of(one) for one in item] if isinstance(item, tuple | list) else item


def _plate(title: str) -> Plate:
    return Plate(svg="<svg></svg>", title=title, caption="")


def _paragraph(_: object) -> Paragraph:
    return Paragraph(text="drawn")
