"""docs/the-paper.md: every equation has its row, whatever a row names is there, and its tests use its code."""

import ast
import functools
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "the-paper.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| \((\d+)\) \|(.*)\|$", TEXT, re.MULTILINE)
TEST = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")
row = pytest.mark.parametrize(("number", "cells"), ROWS, ids=[number for number, _ in ROWS])


def code_and_tests(cells):
    _, code, tests, _ = (cell.strip() for cell in cells.split("|"))
    return re.findall(r"`([a-z_]+(?:\.[A-Za-z_]+)+|models/\w+\.toml)`", code), TEST.findall(tests)


def resolved(dotted):
    """The object behind a dotted name of the package, None where there is none."""
    module, _, name = f"platform_ctrl.{dotted}".rpartition(".")
    return getattr(importlib.import_module(module), name, None)


@functools.cache
def module_of(file):
    """Top-level definitions by name, and what of the package a file imports, by the name that it goes by there."""
    defined, imported = {}, {}
    for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defined[node.name] = node
        elif isinstance(node, ast.Assign):
            defined |= {n.id: node for target in node.targets for n in ast.walk(target) if isinstance(n, ast.Name)}
        elif isinstance(node, ast.Import | ast.ImportFrom):
            start = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
            for name in node.names:
                whole = start + name.name
                if whole.split(".")[0] == "platform_ctrl":
                    imported[name.asname or name.name] = whole.removeprefix("platform_ctrl").removeprefix(".")
    return defined, imported


def used(file, test):
    """What a test (without a name: a whole file) uses of the package, itself or by what it calls in its own module.

    Returns objects of the package, and strings.
    """
    defined, imported = module_of(file)
    waiting, seen, objects, strings = [test] if test else list(defined), set(), [], set()
    while waiting:
        name = waiting.pop()
        if name in seen or name not in defined:
            continue
        seen.add(name)
        for node in ast.walk(defined[name]):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                strings.add(node.value)
            elif isinstance(node, ast.arg):  # a fixture
                waiting.append(node.arg)
            elif isinstance(node, ast.Name):
                waiting.append(node.id)
                if imported.get(node.id):
                    objects.append(resolved(imported[node.id]))
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in imported:
                objects.append(resolved(f"{imported[node.value.id]}.{node.attr}".removeprefix(".")))
    return objects, strings


def test_every_equation_from_1_to_27_has_one_row():
    assert [int(number) for number, _ in ROWS] == list(range(1, 28))


@row
def test_the_code_of_an_equation_exists(number, cells):
    places, _ = code_and_tests(cells)
    assert places
    for place in places:
        assert (ROOT / place).exists() if place.startswith("models/") else resolved(place) is not None, place


@row
def test_every_code_of_an_equation_is_used_by_one_of_its_tests(number, cells):
    places, tests = code_and_tests(cells)
    uses = [used(file, name) for file, name in tests]
    for place in places:
        if place.startswith("models/"):
            assert any(Path(place).stem in strings for _, strings in uses), place
        else:
            wanted = resolved(place)
            assert any(thing is wanted for objects, _ in uses for thing in objects), place


def test_every_test_that_the_page_names_exists():
    named = TEST.findall(TEXT)
    assert len(named) > 27
    for file, name in named:
        assert not name or isinstance(module_of(file)[0].get(name), ast.FunctionDef), f"{file}::{name}"
