"""What the pages of the file formats say of every key: which values it takes, and whether it may be left out."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzz_files import Place, Seed, key_of, put, with_key, written

DOCS = Path(__file__).parents[2] / "docs"


@dataclass(frozen=True)
class Rule:
    """A row of a page's table."""

    takes: Callable[[Any], bool]
    needed: bool


def rules(page: str) -> dict[tuple[str, ...], Rule]:
    """Return the rules of a page by the keys that lead to a key, without the numbers of arrays."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found: dict[tuple[str, ...], Rule] = {}
    for title, body in re.findall(r"^##+ (.*)\n((?:(?!^##).*\n)*)", text, re.MULTILINE):
        for table in _tables_of(title):
            for row in re.findall(r"^\| (`.*)\|$", body, re.MULTILINE):
                cells = [cell.strip() for cell in row.split("|")]
                for brackets, name in re.findall(r"`(\[*)([^`\]]+)\]*`", cells[0]):
                    kind = {"[": "table", "[[": "tables"}.get(brackets, cells[1])
                    needed = cells[2] in ("required", "at least one")
                    found[*table, name.split(".")[-1]] = Rule(_taken(kind), needed)
    return found


def rule_at(known: dict[tuple[str, ...], Rule], place: Place) -> Rule | None:
    """Return the rule of the key at a place, None for an entry of an array."""
    if not isinstance(place[-1], str):
        return None
    return known.get(tuple(step for step in place if isinstance(step, str)))


# Whether a file's text is accepted, and what the command says if it is not.
Read = Callable[[str], tuple[bool, str]]


def judged_as_the_page_says(
    read: Read, known: dict[tuple[str, ...], Rule], seed: Seed, place: Place, item: Any
) -> None:
    """Put a value in a place: what the page's type does not take is refused by the key's name."""
    rule = rule_at(known, place)
    accepted, error = read(written(put(seed.data, place, item)))
    if rule is not None and not rule.takes(item):
        assert not accepted, item
        assert key_of(place) in error, error


def known_and_needed(read: Read, known: dict[tuple[str, ...], Rule], seed: Seed, place: Place, mishap: str) -> None:
    """Drop, misspell or repeat a key: it is refused by its name unless it may be left out."""
    rule = rule_at(known, place)
    assert rule is not None
    key, text = str(place[-1]), with_key(seed.data, place, mishap)
    accepted, error = read(text)
    if mishap == "again":
        assert "is not TOML" in error or text == written(seed.data), error
    elif mishap != "drop" or rule.needed:
        assert not accepted, text
        assert key in error or key.swapcase() in error, error


def _tables_of(title: str) -> list[tuple[str, ...]]:
    if title == "The whole file":
        return [()]
    if title == "`[loop.limits]`":
        return [("loop", "limits"), ("loop", "soft")]
    if name := re.fullmatch(r"`\[+([\w.]+)\]+`", title):
        return [tuple(name[1].split("."))]
    if name := re.fullmatch(r"`(\w+)` of a manoeuvre", title):
        return [("manoeuvre", name[1])]
    return []


def _number(item: Any) -> bool:
    if isinstance(item, bool) or not isinstance(item, int | float):
        return False
    try:
        return math.isfinite(float(item))
    except OverflowError:
        return False


def _numbers(item: Any, least: int = 1) -> bool:
    return isinstance(item, list) and len(item) >= least and all(map(_number, item))


def _rows(item: Any, length: int) -> bool:
    return isinstance(item, list) and bool(item) and all(_numbers(row) and len(row) == length for row in item)


def _text(item: Any) -> bool:
    return isinstance(item, str) and item.isprintable() and bool(item.strip())


def _whole(item: Any) -> bool:
    return isinstance(item, int) and not isinstance(item, bool)


def _taken(kind: str) -> Callable[[Any], bool]:
    """Return what a type in a page's table takes at most; a rule beyond the type may refuse more."""
    if kind.endswith(", or two"):
        one = _taken(kind.removesuffix(", or two"))
        return lambda item: one(item) or (isinstance(item, list) and len(item) == 2 and all(map(one, item)))
    kind = re.split("; |, N m", kind)[0].replace("numbers > 0", "number > 0")
    if words := re.findall(r'`"([^"]+)"`', kind):
        return lambda item: item in words and isinstance(item, str)
    if found := re.match(r"whole number (?:≥ (\d+)|from (\d+) to (2³⁰|\d+))", kind):
        low = int(found[1] or found[2])
        high = 2**63 - 1 if found[3] is None else 2**30 if found[3] == "2³⁰" else int(found[3])
        return lambda item: _whole(item) and low <= item <= high
    if found := re.match(r"(?:number from )?([\d.]+) to ([\d.]+)", kind):
        return lambda item: _number(item) and float(found[1]) <= item <= float(found[2])
    for start, fits in (
        ("tables", lambda item: isinstance(item, list) and all(isinstance(x, dict) for x in item)),
        ("table", lambda item: isinstance(item, dict)),
        ("text or table", lambda item: _text(item) or isinstance(item, dict)),
        ("true or false", lambda item: isinstance(item, bool)),
        ("2, or 1", lambda item: _whole(item) and item in (1, 2)),
        ("1, 2 or 3", lambda item: _whole(item) and item in (1, 2, 3)),
        ("above 0, up to 1", lambda item: _number(item) and 0 < item <= 1),
        ("number > ", lambda item: _number(item) and (item > 0 or not kind.startswith("number > 0"))),
        ("number, not 0", lambda item: _number(item) and item != 0),
        ("number ≠ 0", lambda item: _number(item) and item != 0),
        ("number ≥ 0", lambda item: _number(item) and item >= 0),
        ("three numbers ≥ 0", lambda item: _numbers(item) and len(item) == 3 and min(item) >= 0),
        ("three numbers", lambda item: _numbers(item) and len(item) == 3),
        ("rows of three numbers", lambda item: _rows(item, 3)),
        ("rows of two numbers", lambda item: _rows(item, 2)),
        ("two or more number", lambda item: _numbers(item, 2)),
        ("as many number", _numbers),
        ("numbers", lambda item: _numbers(item) or _number(item)),
        ("number", lambda item: _number(item) or _numbers(item, 2)),
        ("`[low, high]`", lambda item: _numbers(item) and len(item) == 2),
        ("inertia", lambda item: isinstance(item, list) and len(item) == 3),
        ("names", lambda item: isinstance(item, list) and all(isinstance(x, str) for x in item)),
        ("any", lambda item: True),
        ("1", lambda item: _whole(item) and item == 1),
    ):
        if kind.startswith(start):
            return fits
    assert kind in ("text", "name", "path"), kind
    return lambda item: _text(item)
