"""The report as PDF, read again: the page's content in the page's order, whatever signs the names hold."""

from __future__ import annotations

import dataclasses
import html
import io
import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pypdf
import pytest

import platform_ctrl as pc
from platform_ctrl import report
from platform_ctrl.common.palette import PALETTE
from platform_ctrl.errors import InputError, PlatformCtrlError
from platform_ctrl.job.writing import job_data
from platform_ctrl.report import style
from platform_ctrl.report.page import blocks, job_page, tables
from platform_ctrl.report.page.job_page import page_html, pdf_bytes
from platform_ctrl.report.page.tables import versions
from platform_ctrl.verification import JobResult
from report_jobs import caging, checked, classical, job, turn

NAME = "a #b $c$ *d* _e_ @f \\g <h> \"i\" 'j' `k` // l /*m*/ ~ -- [n] {o} %p & r é Ω \u201cs\u201d"


@pytest.fixture(scope="module")
def result() -> JobResult:
    limits = {"bandwidth_hz": 20, "disk_margin": 0.9, "torque_noise": 0.008}
    loop = caging(
        classical("other", 30), classical(NAME), name=f"9-10 {NAME}", limits=limits, soft={"bandwidth_hz": 18}
    )
    run = turn(name=f"turn {NAME}", limits={"angle": 0.01, "torque_share": 1.0})
    return checked(job(name=NAME, loop=[loop], manoeuvre=[run]))


@pytest.fixture(scope="module")
def prepared(result: JobResult) -> blocks.Document:
    return job_page.prepared(result, command="platform-ctrl design 'my job.toml'")


@pytest.fixture(scope="module")
def made(prepared: blocks.Document) -> bytes:
    return pdf_bytes(prepared)


@pytest.fixture(scope="module")
def text(made: bytes) -> str:
    return squeezed("\n".join(page.extract_text() for page in pypdf.PdfReader(io.BytesIO(made)).pages))


def squeezed(words: str) -> str:
    """Return words without white space: lines end elsewhere on paper."""
    return "".join(words.split())


def texts(block: Any) -> list[str]:
    """Return every text of a document in its order, pictures apart."""
    if isinstance(block, str):
        return [block]
    if isinstance(block, tuple | list):
        return [words for one in block for words in texts(one)]
    # The marks of a picture say what the table of requirements says.
    if not dataclasses.is_dataclass(block) or isinstance(block, blocks.Distances):
        return []
    apart = {"svg", "kind", "name", "form", "tone", "strip", "colour", "file"}
    names = [field.name for field in dataclasses.fields(block) if field.name not in apart]
    return [words for name in names for words in texts(getattr(block, name))]


def plates(block: Any) -> list[blocks.Plate]:
    if isinstance(block, blocks.Plate):
        return [block]
    if isinstance(block, blocks.Part | blocks.Section):
        return [one for inner in block.blocks for one in plates(inner)]
    if isinstance(block, blocks.Columns):
        return [one for inner in (*block.left, *block.right) for one in plates(inner)]
    return []


def test_every_text_of_the_document_is_unchanged_in_the_pdf_and_on_the_page(
    prepared: blocks.Document, text: str
) -> None:
    page = squeezed(html.unescape(re.sub(r"<(?!h>)[^>]*>", " ", page_html(prepared))))
    shown = {squeezed(one) for one in texts(prepared.sections)}
    assert len(shown) > 100
    # The listing stands in two columns: a page may end anywhere in it.
    missing = [one for one in shown if one not in text and not one.startswith("schema=")]
    assert missing == []
    assert [one for one in shown if one not in page] == []
    assert text.count(squeezed(NAME)) > 10


def test_the_verdict_comes_first_and_on_every_page(result: JobResult, made: bytes) -> None:
    pages = [squeezed(page.extract_text()) for page in pypdf.PdfReader(io.BytesIO(made)).pages]
    words = squeezed(tables.verdict(result))
    assert not result.passed
    assert "\u2717" in pages[0]
    assert all(words in page for page in pages)
    for k, page in enumerate(pages, 1):
        assert f"{k}of{len(pages)}" in page


def test_every_requirement_has_its_value_and_limit_beside_it(result: JobResult, text: str) -> None:
    rows = tables.requirement_rows(result)
    assert len(rows) > 5
    for row in rows:
        cells = squeezed(f"{row.value}{row.limit}{row.margin}{row.stage}{row.symbol}")
        name = squeezed(row.requirement)
        assert re.search(rf"{re.escape(name)}.{{0,200}}?{re.escape(cells)}", text) or re.search(
            rf"{re.escape(name)}{re.escape(squeezed(row.evidence))}.{{0,80}}?{re.escape(squeezed(row.value))}", text
        ), row.requirement


def test_sections_and_figures_come_in_the_order_of_the_page(prepared: blocks.Document, text: str) -> None:
    titles = [one.title for section in prepared.sections for one in plates(section)]
    assert len(titles) == 13
    places = [text.index(squeezed(f"Figure {k}. {title}")) for k, title in enumerate(titles, 1)]
    assert places == sorted(places)
    names = [section.title for section in prepared.sections if section.title]
    page = page_html(prepared)
    on_page = [page.index(f"<h2>{html.escape(name, quote=False)}") if "<" not in name else 0 for name in names]
    assert [place for place in on_page if place] == sorted(place for place in on_page if place)
    outline = pypdf.PdfReader(io.BytesIO(pdf_bytes(prepared))).outline
    assert [one.title for one in outline if not isinstance(one, list)] == names


def test_every_figure_has_a_description_for_those_who_do_not_see_it(made: bytes, prepared: blocks.Document) -> None:
    reader = pypdf.PdfReader(io.BytesIO(made))
    described = [
        item.get_object()["/Alt"] for item in map(reader.get_object, range(1, len(reader.xref[0]))) if _has_alt(item)
    ]
    assert len(described) >= sum(len(plates(section)) for section in prepared.sections)
    assert reader.trailer["/Root"]["/Lang"].startswith("en")
    assert b"pdfuaid:part" in reader.trailer["/Root"]["/Metadata"].get_object().get_data()


def _has_alt(item: Any) -> bool:
    return isinstance(item, pypdf.generic.DictionaryObject) and "/Alt" in item


def test_the_job_goes_along_as_a_file_that_reads_back(result: JobResult, made: bytes) -> None:
    [attached] = pypdf.PdfReader(io.BytesIO(made)).attachments["job.toml"]
    again = pc.read_job(tomllib.loads(attached.decode()))
    assert job_data(again) == job_data(result.job)


def test_the_command_and_the_versions_are_at_the_end(text: str) -> None:
    end = text[text.rindex("Inputsandversions") :]
    assert "platform-ctrldesign'myjob.toml'" in end
    for name, number in versions():
        assert f"{name}{number}" in end


def test_the_same_result_gives_the_same_bytes(prepared: blocks.Document, made: bytes) -> None:
    assert pdf_bytes(prepared) == made


def test_nothing_in_a_pdf_is_loaded_from_elsewhere(made: bytes) -> None:
    reader = pypdf.PdfReader(io.BytesIO(made))
    annotations = [one.get_object() for page in reader.pages for one in page.get("/Annots", [])]
    assert annotations
    assert all("/URI" not in one.get("/A", {}) for one in annotations)


def test_pictures_lose_no_colour_and_have_their_font(prepared: blocks.Document) -> None:
    colours = PALETTE["light"]
    assert colours["ink"] == style.INK
    assert [colours[f"series-{k + 1}"] for k in range(len(style.SERIES))] == list(style.SERIES)
    for section in prepared.sections:
        for plate in plates(section):
            picture = blocks.standalone_svg(plate.svg, colours)
            assert "var(" not in picture
            assert 'xmlns="http://www.w3.org/2000/svg"' in picture
    assert blocks.standalone_svg("<svg><text>var(--none)</text></svg>", colours).count("var(--none)") == 1


@pytest.mark.parametrize("title", ["\u6f22\u5b57", "\ue000 private", "a\x01b\x07", "x" * 3000, "two\nlines", ""])
def test_titles_that_no_font_holds_or_no_line_are_set_all_the_same(prepared: blocks.Document, title: str) -> None:
    short = dataclasses.replace(prepared, title=title, sections=prepared.sections[:1])
    assert pdf_bytes(short).startswith(b"%PDF-")


def test_a_word_as_long_as_a_page_ends_within_it(prepared: blocks.Document) -> None:
    word = "w" * 900
    paragraph = blocks.Section(name="one", title="one", blocks=(blocks.Paragraph(text=f"{word}."),))
    [page] = pypdf.PdfReader(io.BytesIO(pdf_bytes(dataclasses.replace(prepared, sections=(paragraph,))))).pages
    lines = [line for line in page.extract_text().splitlines() if "www" in line]
    assert len(lines) > 3
    assert "".join(lines).replace("\u200b", "") == f"{word}."


def test_runs_that_were_lost_and_loops_that_are_not_there_are_set_too(result: JobResult) -> None:
    [run] = result.runs
    cut = {
        name: getattr(run.trajectory, name)[:0]
        for name in ("t", "q", "rate", "p", "reading", "command", "torque", "Omega", "attitude")
    }
    trajectory = dataclasses.replace(run.trajectory, ended="diverged at t = 0 s", **cut)
    lost = dataclasses.replace(result, loops=(), runs=(dataclasses.replace(run, trajectory=trajectory),))
    words = "".join(page.extract_text() for page in pypdf.PdfReader(io.BytesIO(pdf_bytes(lost))).pages)
    assert squeezed("The run diverged at t = 0 s: nothing was recorded.") in squeezed(words)


def test_without_typst_one_line_says_what_to_install(
    result: JobResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "typst", None)
    with pytest.raises(InputError, match=r"pip install 'platform_ctrl\[pdf\]'") as error:
        report.write_pdf(result, tmp_path / "report.pdf")
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_what_typst_refuses_is_one_line(prepared: blocks.Document) -> None:
    wrong = blocks.Plate(svg="<svg>never closed", title="wrong", caption="")
    broken = dataclasses.replace(prepared, sections=(blocks.Section(name="one", title="one", blocks=(wrong,)),))
    with pytest.raises(PlatformCtrlError, match="cannot be typeset as PDF") as error:
        pdf_bytes(broken)
    assert "\n" not in str(error.value)


def test_a_pdf_is_written_whole_and_not_into_a_folder_that_does_not_exist(
    prepared: blocks.Document, made: bytes, tmp_path: Path
) -> None:
    assert report.write_pdf(prepared, tmp_path / "report.pdf").read_bytes() == made
    assert [one.name for one in tmp_path.iterdir()] == ["report.pdf"]
    with pytest.raises(InputError, match="cannot be written"):
        report.write_pdf(prepared, tmp_path / "nowhere" / "report.pdf")


def test_a_document_goes_in_as_data_and_never_as_code(prepared: blocks.Document) -> None:
    data = blocks.plain_data(prepared, {})
    assert json.loads(json.dumps(data))["title"] == NAME
    first = data["sections"][0]["blocks"][0]
    inside = [block for section in data["sections"] for block in section["blocks"]] + first["left"] + first["right"]
    assert {block["kind"] for block in inside} >= {"verdict", "distances", "table", "plate", "listing", "fold"}
