"""The equations as plain text."""

from __future__ import annotations

import re
import textwrap
from itertools import chain
from typing import Any

from platform_ctrl.common.text import padded, width
from platform_ctrl.mechanics.symbolic.names import NamedSymbol
from platform_ctrl.mechanics.symbolic.notation import (
    CODE,
    TEXT,
    MatrixSection,
    Notation,
    cells_of,
    entries_of,
    gimbal_equations,
    matrix_sections,
    number_text,
    row_sections,
)
from platform_ctrl.mechanics.symbolic.result import Equations

# Columns of a line; grids of more columns become lists of their entries.
_LINE, _MOST_COLUMNS = 80, 8


def text_of(equations: Equations) -> str:
    """Return all of it, a line of output a line."""
    write = Notation(equations.symbols, TEXT)
    out = [_title(equations), "", *_coordinates(equations, write)]
    for section in matrix_sections(equations):
        out += ["", *_heading(section.number, section.text, section.about), "", *_matrix(equations, section, write)]
    for rows in row_sections(equations):
        out += ["", *_heading(rows.number, "", rows.about), "", *_rows(equations, rows.key, write)]
    if equations.notes:
        notes = (
            textwrap.wrap(note, _LINE, initial_indent="    ", subsequent_indent="      ") for note in equations.notes
        )
        out += ["", "Notes", "", *chain.from_iterable(notes)]
    out += ["", "Symbols", "", *_symbols(equations)]
    return "\n".join(line.rstrip() for line in out) + "\n"


def _title(equations: Equations) -> str:
    return f"{equations.platform.name}: equations after Magnus 1976"


def _heading(number: str, symbol: str, about: str) -> list[str]:
    words = " ".join(filter(None, (number, f"{symbol}:" if symbol else "", about)))
    return textwrap.wrap(words, _LINE, subsequent_indent="     ", break_long_words=False, break_on_hyphens=False)


def _coordinates(equations: Equations, write: Notation) -> list[str]:
    def listed(vector: Any) -> str:
        return "[" + ", ".join(write(x) for x in vector) + "]"

    out = _wrapped("(20) u = ", listed(equations.velocity))
    out += _wrapped("     Q = ", listed(equations.forces))
    if equations.L.rows:
        out += _wrapped("(22) L = ", listed(equations.L))
    return [*out, "(11) A* u̇ + (G_A + G_R + G_root) u = Q    with A* = A + BᵀA_R B (12)"]


def _labels(equations: Equations, section: MatrixSection, write: Notation) -> tuple[list[str], list[str]]:
    columns = [write(x) for x in equations.velocity]
    if section.rows == "root":
        return columns[:3], columns[:3]
    return ([r.name for r in equations.platform.rotors] if section.rows == "rotors" else columns), columns


def _matrix(equations: Equations, section: MatrixSection, write: Notation) -> list[str]:
    rows, columns = _labels(equations, section, write)
    cells = cells_of(equations, section, write)
    if not entries_of(section, cells):
        return ["    zero"]
    widths = [
        max(width(t) for t in (label, *column)) for label, column in zip(columns, zip(*cells, strict=True), strict=True)
    ]
    first = max(width(label) for label in rows)
    # Labels, bars and a space beside each.
    room = _LINE - (4 + first + 4 + 2)
    if len(columns) > _MOST_COLUMNS or max(widths) > room:
        return _entries(section, rows, columns, cells)
    out: list[str] = []
    for part in _side_by_side(widths, room):
        head = "    " + " " * first + "    " + "  ".join(map(padded, columns[part], widths[part]))
        out += [*([""] if out else []), head]
        for label, row in zip(rows, cells, strict=True):
            out.append(f"    {padded(label, first)}  | " + "  ".join(map(padded, row[part], widths[part])) + " |")
    return out


def _side_by_side(widths: list[int], room: int) -> list[slice]:
    """Return the columns that stand side by side in a line, two apart, as many as there is room for."""
    out, begin = [], 0
    for k in range(1, len(widths) + 1):
        if k == len(widths) or sum(widths[begin : k + 1]) + 2 * (k - begin) > room:
            out.append(slice(begin, k))
            begin = k
    return out


def _entries(section: MatrixSection, rows: list[str], columns: list[str], cells: list[list[str]]) -> list[str]:
    """List what is not zero; of a symmetric or skew matrix one half."""
    kept = {"symmetric": "on and above the diagonal, symmetric", "skew": "above the diagonal, skew"}
    halves = section.symmetry
    out = [f"    entries that are not zero{', ' + kept[halves] if halves else ''}:"]
    listed = [(f"({rows[i]}, {columns[j]})", cell) for i, j, cell in entries_of(section, cells)]
    first = max(width(place) for place, _ in listed)
    for place, cell in listed:
        out += _wrapped(f"    {padded(place, first)}  ", cell)
    return out


def _rows(equations: Equations, key: str, write: Notation) -> list[str]:
    names = equations.platform.gimbal_names
    if not names:
        return ["    there are no gimbals"]
    first = max(width(name) for name in names) + 1
    out = []
    for name, left, right in gimbal_equations(equations, key, write):
        out += _wrapped(f"    {padded(name + ':', first)}  ", f"{left} = {right}")
    return out


def _symbols(equations: Equations) -> list[str]:
    def row(symbol: NamedSymbol) -> tuple[str, str, str, str, str]:
        name = "" if symbol.name == symbol.text else symbol.name
        return symbol.text, name, number_text(symbol.value), symbol.unit, symbol.meaning

    table = [("shown", "in SymPy", "number", "unit", "meaning"), *map(row, equations.symbols)]
    widths = [max(width(line[column]) for line in table) for column in range(4)]
    indent = " " * (6 + sum(widths) + 2 * len(widths))
    out = []
    for line in table:
        start = "    " + "  ".join(padded(cell, columns) for cell, columns in zip(line, widths, strict=False)) + "  "
        first, *more = textwrap.wrap(line[4], max(_LINE - len(indent), 20), break_on_hyphens=False)
        out += [start + first, *(indent + words for words in more)]
    return out


def _wrapped(start: str, text: str) -> list[str]:
    """Break a long line before a sign (a comma's next, in a list) and indent what follows."""
    lines, line = [], start
    indent = " " * (width(start) + 2)
    for piece in re.split(r"(?= [+−=] )|(?<=,)(?= )|(?<=:)(?= )", text):
        if line.strip() and line not in (start, indent) and width(line) + width(piece) > _LINE:
            lines.append(line)
            line = indent + piece.lstrip()
        else:
            line += piece
    return [*lines, line]


SCHEMA = 1
_VECTORS = ("q", "rates", "accelerations", "Omega", "Omega_dot", "velocity", "forces", "L")
_MATRICES = ("B0", "B_A", "A_R", "A", "BtA_RB", "A_star", "G_A", "G_R", "G_root")


def record_of(equations: Equations) -> dict[str, Any]:
    """Return the record."""
    write = Notation(equations.symbols, CODE)

    def rows(key: str) -> list[dict[str, Any]]:
        out = []
        for terms, (gimbal, left, right) in zip(
            equations.rows[key], gimbal_equations(equations, key, write), strict=True
        ):
            listed = [{"coefficient": write(c), "variable": write(v)} for c, v in terms]
            out.append({"gimbal": gimbal, "left": left, "right": right, "terms": listed})
        return out

    return {
        "schema": SCHEMA,
        "platform": equations.platform.name,
        "order": equations.order,
        "terms": equations.terms,
        "symbols": [
            {"name": s.name, "text": s.text, "latex": s.latex, "meaning": s.meaning, "unit": s.unit, "value": s.value}
            for s in equations.symbols
        ],
        "vectors": {key: [write(x) for x in getattr(equations, key)] for key in _VECTORS},
        "matrices": {
            key: [[write(matrix[i, j]) for j in range(matrix.cols)] for i in range(matrix.rows)]
            for key, matrix in ((key, getattr(equations, key)) for key in _MATRICES)
        },
        "equations": {key: rows(key) for key in equations.rows},
        "groups": [list(group) for group in equations.groups],
        "notes": list(equations.notes),
    }
