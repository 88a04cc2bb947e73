"""The equations as a LaTeX fragment: amsmath is all that it needs."""

from __future__ import annotations

import re
from typing import Any

from platform_ctrl.mechanics.symbolic.names import text_in_latex
from platform_ctrl.mechanics.symbolic.notation import (
    LATEX,
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

# Widths in printed characters: a line; what fits it in small print; beyond that a matrix becomes a list of entries.
_LINE, _SMALL = 54, 110
_MOST_COLUMNS = 10


def latex_of(equations: Equations) -> str:
    """Return all of it: matrices, gimbal equations, and the symbols as a table."""
    write = Notation(equations.symbols, LATEX)
    out = [
        "% A fragment: \\usepackage{amsmath}; letters beyond ASCII in names need XeLaTeX, LuaLaTeX or fontenc.",
        f"% {' '.join(equations.platform.name.split())}: equations after Magnus 1976",
        r"\begingroup\allowdisplaybreaks",
        r"\begin{align*}",
        rf"u &= {_vector(equations.velocity, write)}^T \tag{{20}} \\",
        rf"Q &= {_vector(equations.forces, write)}^T",
        r"\end{align*}",
    ]
    for section in matrix_sections(equations):
        out += [f"% {section.number} {section.key}".replace("  ", " "), *_matrix(equations, section, write)]
    for rows in row_sections(equations):
        out += [f"% {rows.number} {rows.key}", *_rows(equations, rows.key, rows.number, write)]
    notes = [text_in_latex(note).replace(r"G\_R", "$G_R$") for note in equations.notes]
    out += [rf"\par\noindent {note}." for note in notes]
    return "\n".join([*out, *_symbols(equations), r"\endgroup"]) + "\n"


def _vector(vector: Any, write: Notation) -> str:
    return r"\bigl[" + r",\ ".join(write(x) for x in vector) + r"\bigr]"


def _printed(written: str) -> int:
    """Return about how many characters a formula shows."""
    return len(
        re.sub(r"\\(dot|ddot|mathrm|,)|[{}_^&\s]", "", re.sub(r"\\(?!dot|ddot|mathrm|,)[a-zA-Z]+", "x", written))
    )


def _matrix(equations: Equations, section: MatrixSection, write: Notation) -> list[str]:
    cells = cells_of(equations, section, write)
    number = section.number.strip("()")
    tag = rf" \tag{{{number}}}" if number else ""
    if not entries_of(section, cells):
        return [r"\begin{align*}", rf"{section.latex} &= 0{tag}", r"\end{align*}"]
    columns = [max(map(_printed, column)) for column in zip(*cells, strict=True)]
    across = sum(columns) + 2 * len(columns)
    if len(columns) > _MOST_COLUMNS or across > _SMALL:
        return _entries(section, cells, tag)
    body = " \\\\\n".join("  " + " & ".join(row) for row in cells)
    block = " (root block)" if section.rows == "root" else ""
    left = section.latex + (rf"\text{{{block}}}" if block else "")
    lines = [r"\begin{align*}", rf"{left} &= \begin{{bmatrix}}", body, rf"\end{{bmatrix}}{tag}", r"\end{align*}"]
    return [r"{\footnotesize\setlength{\arraycolsep}{3pt}", *lines, "}"] if across > _LINE else lines


def _entries(section: MatrixSection, cells: list[list[str]], tag: str) -> list[str]:
    """List what is not zero by row and column from 1; of a symmetric or skew matrix one half."""
    name = f"({section.latex})"
    mirrored = rf", and ${name}_{{ji}} = {'-' * (section.symmetry == 'skew')}{name}_{{ij}}$" * bool(section.symmetry)
    lines = [rf"{name}_{{{i + 1},{j + 1}}} &= {_broken(cell)}" for i, j, cell in entries_of(section, cells)]
    lines[0] += tag
    start = rf"\par\noindent Entries of ${section.latex}$ that are not zero{mirrored}:"
    return [start, r"\begin{align*}", " \\\\\n".join(lines), r"\end{align*}"]


def _rows(equations: Equations, key: str, number: str, write: Notation) -> list[str]:
    names = equations.platform.gimbal_names
    if not names:
        return []
    lines = []
    for name, left, right in gimbal_equations(equations, key, write):
        lines.append(rf"\text{{{text_in_latex(name)}:}}\quad & {_broken(f'{left} = {right}')}")
    lines[0] += rf" \tag{{{number.strip('()')}}}"
    return [r"\begin{align*}", " \\\\\n".join(lines), r"\end{align*}"]


def _broken(written: str) -> str:
    """Break a long sum before the signs of its terms, and inside brackets only where a term alone is too long."""
    lines, line = [], ""
    for term in _terms(written, r"{}()"):
        pieces = [term] if _printed(term) <= 1.4 * _LINE else _terms(term, r"{}")
        for piece in pieces:
            if line and _printed(line + piece) > _LINE:
                lines.append(line)
                line = ""
            line += piece
    # A sign that begins a cell is unary.
    lines = [re.sub(r"^-", "{-}", one) for one in [*lines, line]]
    return " \\\\\n  & \\quad ".join(lines)


def _terms(written: str, brackets: str) -> list[str]:
    """Split before +, − and = that stand outside all of `brackets`."""
    out, depth = [""], 0
    for piece in re.split(r"(?= [+=-] )", written):
        if depth:
            out[-1] += piece
        else:
            out.append(piece)
        for mark in re.findall(r"(?<!\\)[{}()]", piece):
            depth += (mark in brackets) * (1 if mark in "{(" else -1)
    return [piece for piece in out if piece]


def _symbols(equations: Equations) -> list[str]:
    rows = []
    for symbol in equations.symbols:
        number = number_text(symbol.value)
        mantissa, _, exponent = number.partition("e")
        size = mantissa + (rf" \cdot 10^{{{int(exponent)}}}" if exponent else "")
        unit = rf"\text{{{text_in_latex(symbol.unit)}}}"
        rows.append(rf"& {symbol.latex} && {size} && {unit} && \text{{{text_in_latex(symbol.meaning)}}}")
    return [r"{\footnotesize", r"\begin{align*}", " \\\\\n".join(rows), r"\end{align*}", "}"]
