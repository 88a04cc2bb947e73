"""docs/the-paper.md: every equation has its row, and whatever a row names is there."""

import ast
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "the-paper.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| \((\d+)\) \|(.*)\|$", TEXT, re.MULTILINE)


def test_every_equation_from_1_to_27_has_one_row():
    assert [int(number) for number, _ in ROWS] == list(range(1, 28))


@pytest.mark.parametrize(("number", "row"), ROWS, ids=[number for number, _ in ROWS])
def test_the_code_and_the_tests_of_an_equation_exist(number, row):
    _, code, tests, _ = (cell.strip() for cell in row.split("|"))
    places = re.findall(r"`([a-z_]+(?:\.[A-Za-z_]+)+|models/\w+\.toml)`", code)
    assert places, number
    for place in places:
        if place.startswith("models/"):
            assert (ROOT / place).exists()
            continue
        module, _, name = place.rpartition(".")
        assert hasattr(importlib.import_module(f"platform_ctrl.{module}"), name), place
    assert re.findall(r"`tests/", tests), number


def test_every_test_that_the_page_names_exists():
    named = re.findall(r"`(tests/\w+\.py)(?:::(\w+))?`", TEXT)
    assert len(named) > 27
    for file, name in named:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert not name or name in functions, f"{file}::{name}"
