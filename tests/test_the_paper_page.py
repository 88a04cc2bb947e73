"""docs/theory/the-paper.md: every equation has its row, whatever a row names is there, and so are its tests."""

import ast
import functools
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "theory" / "the-paper.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| \((\d+)\) \|(.*)\|$", TEXT, re.MULTILINE)
TEST = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")
row = pytest.mark.parametrize(("number", "cells"), ROWS, ids=[number for number, _ in ROWS])


def code_and_tests(cells):
    code, tests, _ = (cell.strip() for cell in cells.split("|"))
    return re.findall(r"`([a-z_]+(?:\.[A-Za-z_]+)+|models/\w+\.toml)`", code), TEST.findall(tests)


def resolved(dotted):
    """The object behind a dotted name of the package, None where there is none."""
    module, _, name = f"platform_ctrl.{dotted}".rpartition(".")
    return getattr(importlib.import_module(module), name, None)


@functools.cache
def functions_of(file):
    body = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
    return {node.name for node in body if isinstance(node, ast.FunctionDef)}


def test_every_equation_from_1_to_27_has_one_row():
    assert [int(number) for number, _ in ROWS] == list(range(1, 28))


@row
def test_the_code_of_an_equation_exists(number, cells):
    places, _ = code_and_tests(cells)
    assert places
    for place in places:
        assert (ROOT / place).exists() if place.startswith("models/") else resolved(place) is not None, place


def test_every_test_that_the_page_names_exists():
    named = TEST.findall(TEXT)
    assert len(named) > 27
    for file, name in named:
        assert name in functions_of(file) if name else (ROOT / file).exists(), f"{file}::{name}"
