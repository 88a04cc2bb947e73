"""The documentation runs, its examples are accepted, and it names every key that the readers know."""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
import sys
import tomllib
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from platform_ctrl import read_job, read_platform
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.cli import main
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.reading import JOB_FILE
from platform_ctrl.job.requirements import limit_keys
from platform_ctrl.plant.reading import PLANT_FILE
from platform_ctrl.plant.tables import Shape
from platform_ctrl.plant.tables import tables as tables_within
from public_modules import names

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FORMATS = {"reference/plant-file.md": PLANT_FILE, "reference/job-file.md": JOB_FILE}


def named(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


PAGE = pytest.mark.parametrize("page", PAGES, ids=named)
# Commands of a page's console that are not ours: they install, or stay until they are stopped.
NOT_RUN = ("python3 -m venv", ".venv/bin/pip install", "pip install", "dask ", "mkdocs ", "pytest")

# Pages that need a package which not every Python has wheels of.
NEEDS = {"campaign.md": "pyarrow", "cluster.md": "distributed"}

spec = importlib.util.spec_from_file_location("blocks", ROOT / "docs" / "site" / "blocks.py")
assert spec is not None
assert spec.loader is not None
site_blocks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(site_blocks)


def blocks(page: Path, language: str) -> list[str]:
    return list(site_blocks.blocks(page.read_text(encoding="utf-8"), language))


def tables(file: Shape) -> Iterator[tuple[str, set[str]]]:
    """Walk the headings of a format's tables with their keys."""
    for path, table in tables_within(file):
        parent = dict(tables_within(file))[path[:-1]]
        name = ".".join(path)
        if path[:1] == ("manoeuvre",) and len(path) == 2 and parent.keys[path[-1]].array is None:
            name = f"`{path[1]}` of a manoeuvre"
        elif path:
            name = f"`[{name}]`" if parent.keys[path[-1]].array is None else f"`[[{name}]]`"
        if name not in ("`[loop.soft]`", "`[operation.angles]`"):  # the keys of [loop.limits], and names of angles
            yield name or "The whole file", set(table.keys)


def first_cells(text: str) -> set[str]:
    """Names set as code in the first cell of a table's row."""
    rows = re.findall(r"^\|([^|]*)\|", text, re.MULTILINE)
    return {name for cell in rows for name in re.findall(r"`([^`]+)`", cell)}


def slug(heading: str) -> str:
    """Anchor of a heading as code hosts make it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def run_console(block: Any) -> None:
    """Run a console block: our own commands, and nothing may stand there that is neither run nor known."""
    for arguments, expected in site_blocks.commands(block):
        assert main(arguments) == expected, arguments
    for line in block.text.splitlines():
        assert not line.startswith("$ ") or line[2:].startswith(("platform-ctrl ", *NOT_RUN)), line


@pytest.mark.parametrize(
    "page",
    # What the commands of cluster.md do is in tests/campaign.
    [pytest.param(page, marks=[pytest.mark.slow] * (page.name == "cluster.md"), id=named(page)) for page in PAGES],
)
def test_code_on_a_page_runs_and_prints_what_the_page_says(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if page.parent.name == "how-to" and page.name in NEEDS:
        pytest.importorskip(NEEDS[page.name], reason="campaigns keep their runs as Parquet, Dask hands them out")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["page"])
    # A module as of a script: annotations of classes on the page are found in it.
    module = types.ModuleType("__page__")
    monkeypatch.setitem(sys.modules, "__page__", module)
    namespace = vars(module)
    printed = ""
    for number, piece in enumerate(site_blocks.pieces(page.read_text(encoding="utf-8")), 1):
        if isinstance(piece, site_blocks.Picture):
            assert hasattr(getattr(namespace[piece.name], "figure", None) or namespace[piece.name], "savefig")
        elif piece.title:
            (tmp_path / piece.title).write_text(piece.text, encoding="utf-8")
        elif piece.language == "python":
            capsys.readouterr()
            exec(compile(piece.text, f"{page.name}, block {number}", "exec"), namespace)
            printed = capsys.readouterr().out
        elif piece.language == "text" and piece.follows:
            assert printed == piece.text
        elif piece.language == "console":
            run_console(piece)


# What developers read and run: recipes register what is not public; pictures and measurements look inside.
FOR_DEVELOPERS = ("docs/reference/architecture.md", "docs/draw_", "docs/site/")


def code_for_users() -> Iterator[tuple[str, str]]:
    """Yield the Python code of pages and examples with where it is from."""
    for page in PAGES:
        for number, block in enumerate(blocks(page, "python"), 1):
            yield f"{page.relative_to(ROOT).as_posix()}, block {number}", block
    for folder in ("docs", "examples"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")


def imported(code: str) -> Iterator[tuple[str, str]]:
    """Yield what code imports from the package, as module and name."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "platform_ctrl":
            yield from ((str(node.module), alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((one.name, "") for one in node.names if one.name.startswith("platform_ctrl."))


@pytest.mark.parametrize(("where", "code"), [pair for pair in code_for_users() if "platform_ctrl" in pair[1]])
def test_code_for_users_imports_public_names_alone(where: str, code: str) -> None:
    if where.startswith(FOR_DEVELOPERS):
        return
    for module, name in imported(code):
        public = module in names.MODULES and (
            not name or name in names.names(module) or f"{module}.{name}" in names.MODULES
        )
        assert public or f"{module}.{name}" in names.results(), f"{module}.{name}"


@PAGE
def test_commands_that_a_page_only_shows_have_the_options_that_they_are_shown_with(page: Path) -> None:
    import typer

    from platform_ctrl.cli.commands import app

    program = typer.main.get_command(app)
    for line in re.findall(r"^    platform-ctrl (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE):
        if line.startswith("--"):
            continue  # of the program itself
        shown = re.split(r"  | \| | > ", line)[0]
        name, *given = shlex.split(re.sub(r"\[[^\]]*\]", "", shown))  # what stands in brackets may be left out
        if name == "COMMAND":
            continue
        command = program.commands[name]  # type: ignore[attr-defined]
        # A command keeps the help options of the first context that it sees.
        within = typer.Context(command, **program.context_settings)
        command.make_parser(within).parse_args(given)


@PAGE
def test_toml_on_a_page_is_read(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where a job finds the plant that the page writes before it
    for block in site_blocks.pieces(page.read_text(encoding="utf-8")):
        if not isinstance(block, site_blocks.Block) or block.language != "toml":
            continue
        if block.title:
            (tmp_path / block.title).write_text(block.text, encoding="utf-8")
        data = tomllib.loads(block.text)
        if "schema" in data:
            read_job(data) if "plant" in data else read_platform(data)


@pytest.mark.parametrize(
    ("page", "heading", "keys"), [(page, *table) for page, file in FORMATS.items() for table in tables(file)]
)
def test_the_section_of_a_table_names_its_keys_and_no_others(page: str, heading: str, keys: set[str]) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    sections = re.findall(rf"^#+ {re.escape(heading)}\n(.*?)(?=^#|\Z)", text, re.MULTILINE | re.DOTALL)
    assert len(sections) == 1
    named = {name.strip("[]").split(".")[-1] for name in first_cells(sections[0])}
    # Keys of limits are those of the table of metrics.
    assert named == (set(limit_keys()) if heading == "`[loop.limits]`" else keys)


def limit_rows() -> list[str]:
    """The rows of the table of limits: what the table of metrics says, an entry a row."""
    rows = []
    for metric in METRICS.values():
        if metric.key:
            keys = [f"{metric.key}_{scope}" if scope else metric.key for scope in metric.scopes]
            names = ", ".join(f"`{key}`" for key in (*keys, *filter(None, [metric.lowest_key, metric.frequency_key])))
            edge = f"; Hz{'' if metric.needs_frequency else ', optional'}" if metric.frequency_key else ""
            best = f"; no loop has more than {metric.best:g}" if metric.best else ""
            kind = f"number > 0{f', {metric.unit}' if metric.unit else ''}{edge}{best}"
            rows.append(f"| {names} | {kind} | {metric.sense}: {metric.meaning} |")
    return rows


def test_the_table_of_limits_is_that_of_the_metrics() -> None:
    section = (
        (ROOT / "docs" / "reference" / "job-file.md").read_text(encoding="utf-8").partition("### `[loop.limits]`\n")[2]
    )
    table = section.partition("| --- | --- | --- |\n")[2].partition("\n\n")[0]
    assert table.splitlines() == limit_rows()


@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_option_stands_in_the_table_of_its_method_and_no_other(method: str) -> None:
    text = (ROOT / "docs" / "reference" / "job-file.md").read_text(encoding="utf-8")
    section = re.search(rf"^## Method `{method}`\n(.*?)^## ", text, re.MULTILINE | re.DOTALL)
    assert section is not None
    assert first_cells(section[1]) == set(METHODS[method].options)


def keys(item: Any) -> set[str]:
    """Names of a record's keys at every depth; not those of tables whose keys are signals, options or libraries."""
    if isinstance(item, list):
        return {key for entry in item for key in keys(entry)}
    if not isinstance(item, dict):
        return set()
    own_names = {"versions", "options", "saturated", "stop_contacts"}
    return set(item) | {key for name, entry in item.items() if name not in own_names for key in keys(entry)}


def test_the_result_page_names_every_key_that_is_written() -> None:
    from platform_ctrl import design, verification
    from platform_ctrl.verification.result_file import result_record

    examples = [tomllib.loads(block) for block in blocks(ROOT / "docs" / "reference" / "job-file.md", "toml")]
    data = next(example for example in examples if "schema" in example)
    data |= {"operation": {"Omega": [1.0, 0.0, 0.0]}}
    data["uncertainty"] = {"spin": 0.1}
    data["loop"][0]["design"] = [
        {"name": "one", "method": "classical", "crossover_hz": 40.0},
        {"name": "two", "method": "classical", "crossover_hz": 30.0},
    ]
    data["loop"][0]["use"] = "one"
    data["manoeuvre"][0] |= {"rise": 0.001, "hold": 0.0, "duration": 0.01}
    job = read_job(data)
    written = keys(result_record(verification.check_job(job, design.loops(job))))
    text = (ROOT / "docs" / "reference" / "result-file.md").read_text(encoding="utf-8")
    assert {"alternatives", "loop_by_loop", "stop_contacts"} <= written
    assert not written - set(re.findall(r"`([^`\n]+)`", text))


@PAGE
def test_relative_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        linked = page.parent / path if path else page
        assert linked.exists(), target
        if anchor and linked.suffix == ".md":
            headings = re.findall(r"^#+ (.*)$", linked.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {slug(heading) for heading in headings}, target
