"""The documentation runs, its examples are accepted, and it names every key that the readers know."""

from __future__ import annotations

import ast
import re
import shlex
import sys
import tomllib
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from campaign_runs import processes_here
from platform_ctrl import read_job, read_platform, shipped_models
from platform_ctrl.cli import main
from platform_ctrl.cli.commands import app
from platform_ctrl.design.methods import METHODS
from platform_ctrl.job.reading import JOB_FILE
from platform_ctrl.plant.reading import PLANT_FILE
from platform_ctrl.plant.tables import Shape
from public_modules import names

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def tables_within(table: Shape, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Shape]]:
    """Yield a file's tables and those within them, with the keys that lead there."""
    yield path, table
    for name, key in table.keys.items():
        if isinstance(key.holds, Shape):
            yield from tables_within(key.holds, (*path, name))


def named(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


PROGRAM: Any = typer.main.get_command(app)
COMMANDS: dict[str, Any] = PROGRAM.commands
PAGE = pytest.mark.parametrize("page", PAGES, ids=named)
# Commands of a page's console that are not ours: they install, or stay until they are stopped.
NOT_RUN = ("python3 -m venv", ".venv/bin/pip install", "pip install", "dask ", "mkdocs ", "pytest")

# Pages that need a package which not every Python has wheels of.
NEEDS = {"campaign.md": "pyarrow"}

sys.path.insert(0, str(ROOT / "docs" / "site"))
import blocks as site_blocks  # noqa: E402  beside the hooks of the site
import tables as site_tables  # noqa: E402


def blocks(page: Path, language: str) -> list[str]:
    return list(site_blocks.blocks(page.read_text(encoding="utf-8"), language))


def slug(heading: str) -> str:
    """Anchor of a heading as code hosts make it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def run_console(block: Any) -> None:
    """Run a console block: our own commands, and nothing may stand there that is neither run nor known."""
    for arguments, expected in site_blocks.commands(block):
        assert main(arguments) == expected, arguments
    for line in block.text.splitlines():
        assert not line.startswith("$ ") or line[2:].startswith(("platform-ctrl ", *NOT_RUN)), line


@PAGE
def test_code_on_a_page_runs_and_prints_what_the_page_says(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if page.parent.name == "how-to" and page.name in NEEDS:
        pytest.importorskip(NEEDS[page.name], reason="campaigns keep their runs as Parquet, Dask hands them out")
    monkeypatch.chdir(tmp_path)
    # Workers are tested with the engine; here each of them would load everything again.
    monkeypatch.setattr("platform_ctrl.campaign.engine.processes_here", processes_here)
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
    for line in re.findall(r"^    platform-ctrl (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE):
        if line.startswith("--"):
            continue  # of the program itself
        shown = re.split(r"  | \| | > ", line)[0]
        name, *given = shlex.split(re.sub(r"\[[^\]]*\]", "", shown))  # what stands in brackets may be left out
        if name == "COMMAND":
            continue
        command = COMMANDS[name]
        # A command keeps the help options of the first context that it sees.
        within = typer.Context(command, **PROGRAM.context_settings)
        command.make_parser(within).parse_args(given)


@PAGE
def test_toml_on_a_page_is_read(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where a job finds the plant that the page writes or imports before it
    for block in site_blocks.pieces(page.read_text(encoding="utf-8")):
        if not isinstance(block, site_blocks.Block):
            continue
        if block.title:
            (tmp_path / block.title).write_text(block.text, encoding="utf-8")
        for arguments, expected in site_blocks.commands(block):
            assert arguments[0] != "import" or main(arguments) == expected
        if block.language != "toml":
            continue
        data = tomllib.loads(block.text)
        if "schema" in data:
            read_job(data) if "plant" in data else read_platform(data)


def test_the_reference_has_every_table_once_and_each_can_be_made() -> None:
    asked = []
    for page in PAGES:
        for kind, name, notes in site_tables.MARK.findall(page.read_text(encoding="utf-8")):
            assert "| `" in site_tables.made(kind, name, notes)
            asked.append((kind, name))
    files = {
        ("keys", " ".join(filter(None, [file, ".".join(path)])))
        for file, whole in (("plant", PLANT_FILE), ("job", JOB_FILE))
        for path, table in tables_within(whole)
        if table.keys and path[-1:] not in (("limits",), ("coupled",))
    }
    commands = {("command", name) for name, command in COMMANDS.items() if len(command.params) > 2}
    limits = {("limits", name) for name in site_tables.LIMITS}
    methods = {("options", method) for method in METHODS}
    models = {("bodies", model) for model in shipped_models()}
    others = {("keys", "plant sensors"), ("kinds", "faults"), ("profiles", "budget")}
    assert sorted(asked) == sorted(files | commands | limits | methods | models | others)


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
