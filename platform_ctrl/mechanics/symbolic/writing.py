"""The equations as text, as LaTeX and as a record, by SymPy's printers."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import sympy

from platform_ctrl.common.text import padded, width
from platform_ctrl.mechanics.symbolic.derivation import Equations, RowTerms
from platform_ctrl.mechanics.symbolic.symbols import Expression

# Columns of a line of text; terms in a line of LaTeX.
_LINE, _TERMS = 80, 4
_ORDINAL = {1: "first", 2: "second", 3: "third", 4: "fourth"}
_ROWS = ("partially_linear", "linear", "precession")
_VECTORS = ("q", "rates", "accelerations", "Omega", "Omega_dot", "velocity", "forces", "L")
_MATRICES = ("B0", "B_A", "A_R", "A", "BtA_RB", "A_star", "G_A", "G_R", "G_root")
Write = Callable[[Expression], str]


class _Section(NamedTuple):
    """A matrix: its number, the key of `Equations`, its notations, what it is, and its symmetry."""

    number: str
    key: str
    text: str
    latex: str
    about: str
    symmetry: str = ""


def _matrices(equations: Equations) -> list[_Section]:
    """Return the matrices in the paper's order; without rotors without theirs."""
    p, exact = equations.order, equations.terms == "exact" or equations.order is None
    to = "exact" if p is None else "at zero angles" if p == 0 else f"to {_ORDINAL[p]} order in the angles"
    to_next = "exact" if p is None else f"to {_ORDINAL[p + 1]} order"
    A = f"mass matrix without C, {to}" if exact else "mass matrix without C, taken as constant"
    G_A = f"Coriolis matrix, {to}" if exact else "Coriolis matrix, A constant: from (24) as it stands"
    h = "∂T/∂Ω of A* u + BᵀL" if exact else "∂T/∂Ω of BᵀL alone"
    root = f"−[∂T/∂Ω]× in the root's block, zero elsewhere; {h}, {to}; not in the paper"
    sections = [
        _Section("(21)", "B0", "B0", "B_0", "directions B at zero angles; rotors by [Ω, q̇]"),
        _Section("(21)", "B_A", "B_A", "B_A", f"B − B0, {to_next}"),
        _Section("(23)", "A", "A", "A", A, symmetry="symmetric"),
        _Section("(24)", "BtA_RB", "BᵀA_R B", "B^T A_R B", f"the rotors' axial inertia, {to}", symmetry="symmetric"),
        _Section("(25)", "G_A", "G_A", "G_A", G_A),
        _Section("(26)", "G_R", "G_R", "G_R", f"gyroscopic matrix, {to}, without G_root", symmetry="skew"),
        _Section("", "G_root", "G_root", r"G_\mathrm{root}", root, symmetry="skew"),
    ]
    without = set() if equations.platform.rotors else {"B0", "B_A", "BtA_RB", "G_R"}
    return [one for one in sections if one.key not in without]


def _row_sections(equations: Equations) -> list[tuple[str, str, str]]:
    """Return number, key and meaning of the gimbal equations; without rotors there is no precession."""
    kept = "the terms that the paper keeps" if equations.terms == "paper" else "every term"
    sections = [
        ("(27)", "partially_linear", f"linear in the angles, for any Ω(t); {kept}"),
        ("(19)", "linear", "linear in the angles and in Ω"),
        ("(15)", "precession", "precession: momenta and force elements alone"),
    ]
    return sections if equations.platform.rotors else sections[:2]


def _entries(equations: Equations, section: _Section) -> list[tuple[int, int, Expression]]:
    """Return row, column and value of what is not zero; of a symmetric or skew matrix one half."""
    matrix = getattr(equations, section.key)
    places = ((i, j) for i in range(matrix.rows) for j in range(matrix.cols) if j >= i or not section.symmetry)
    return [(i, j, matrix[i, j]) for i, j in places if matrix[i, j] != 0]


def _sides(equations: Equations, key: str, write: Write) -> Iterator[tuple[str, list[str], list[str]]]:
    """Yield the gimbals' names with the terms of both sides: coordinates on the left, Q and the root on the right."""
    torques = list(equations.forces)[3:]
    for name, terms, torque in zip(equations.platform.gimbal_names, equations.rows[key], torques, strict=True):
        constants = [part for c, v in terms if v == 1 for part in sympy.Add.make_args(c)]
        yield name, [*_terms(terms, write)] or ["0"], [write(torque), *(write(-part) for part in constants)]


def _terms(terms: RowTerms, write: Write) -> Iterator[str]:
    for coefficient, variable in terms:
        for part in sympy.Add.make_args(coefficient) if variable != 1 else ():
            yield write(part * variable)


def _sum(terms: list[str], minus: str = "−") -> list[str]:
    """Return the terms with their signs in front of them."""
    return [terms[0], *(f"{minus} {t[len(minus) :].lstrip()}" if t.startswith(minus) else f"+ {t}" for t in terms[1:])]


def _short(expression: Expression) -> Expression:
    """Return an expression to be read by people: its numbers have as many digits as the values of the symbols."""
    return expression.xreplace({x: sympy.Float(f"{float(x):.6g}") for x in expression.atoms(sympy.Float)})


def text_writer(equations: Equations) -> Write:
    """Return a function that writes expressions as text."""
    shown = {sympy.Symbol(s.name): sympy.Symbol(s.text) for s in equations.symbols}

    def write(expression: Expression) -> str:
        plain = str(sympy.sstr(_short(expression).xreplace(shown), full_prec=False))
        return plain.replace("**2", "²").replace("**3", "³").replace("*", "·").replace("-", "−")

    return write


def text_of(equations: Equations) -> str:
    """Return all of it, a line of output a line."""
    write = text_writer(equations)

    def listed(vector: Expression) -> str:
        return "[" + ", ".join(map(write, vector)) + "]"

    rotors = [f"(22) L = {listed(equations.L)}"] if equations.L.rows else []
    out = [f"{equations.platform.name}: equations after Magnus 1976", ""]
    for line in (f"(20) u = {listed(equations.velocity)}", f"     Q = {listed(equations.forces)}", *rotors):
        out += _wrapped(line, 11)
    out.append("(11) A* u̇ + (G_A + G_R + G_root) u = Q    with A* = A + BᵀA_R B (12)")
    columns = [write(x) for x in equations.velocity]
    for section in _matrices(equations):
        rows = [r.name for r in equations.platform.rotors] if section.key in ("B0", "B_A") else columns
        out += ["", *_wrapped(" ".join(f"{section.number} {section.text}: {section.about}".split()), 5), ""]
        found = [(f"({rows[i]}, {columns[j]})", write(cell)) for i, j, cell in _entries(equations, section)]
        half = f", on and above the diagonal, {section.symmetry}" if section.symmetry else ""
        first = max((width(place) for place, _ in found), default=0)
        out += [f"    entries that are not zero{half}:"] if found else ["    zero"]
        for place, cell in found:
            out += _wrapped(f"    {padded(place, first)}  {cell}", first + 8)
    for number, key, about in _row_sections(equations):
        out += ["", f"{number} {about}", ""]
        first = max((width(name) for name in equations.platform.gimbal_names), default=0) + 1
        out += [] if equations.platform.gimbals else ["    there are no gimbals"]
        for name, left, right in _sides(equations, key, write):
            line = f"    {padded(name + ':', first)}  {' '.join(_sum(left))} = {' '.join(_sum(right))}"
            out += _wrapped(line, first + 8)
    if equations.notes:
        out += ["", "Notes", "", *(line for note in equations.notes for line in _wrapped(f"    {note}", 6))]
    out += ["", "Symbols", ""]
    for s in equations.symbols:
        name = "" if s.name == s.text else f" ({s.name} in SymPy)"
        number = "" if s.value is None else f" = {s.value:.6g}"
        out += _wrapped(f"    {s.text}{name}{number} {s.unit}: {s.meaning}", 6)
    return "\n".join(line.rstrip() for line in out) + "\n"


def _wrapped(line: str, indent: int) -> list[str]:
    return textwrap.wrap(line, _LINE, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False)


def latex_of(equations: Equations) -> str:
    """Return all of it as a fragment that needs amsmath: matrices, gimbal equations, and the symbols as a table."""
    names = {sympy.Symbol(s.name): s.latex for s in equations.symbols}

    def write(expression: Expression) -> str:
        return str(sympy.latex(_short(expression), symbol_names=names))

    def align(lines: list[str]) -> list[str]:
        return [r"\begin{align*}", " \\\\\n".join(lines), r"\end{align*}"]

    out = [
        "% A fragment: \\usepackage{amsmath}; letters beyond ASCII in names need XeLaTeX, LuaLaTeX or fontenc.",
        f"% {' '.join(equations.platform.name.split())}: equations after Magnus 1976",
        r"\begingroup\allowdisplaybreaks",
    ]
    vectors = [("u", equations.velocity, "20"), ("Q", equations.forces, ""), ("L", equations.L, "22")]
    listed = [(name, r",\ ".join(map(write, vector)), tag) for name, vector, tag in vectors if vector.rows]
    out += align([rf"{name} &= [{cells}]^T" + (rf" \tag{{{tag}}}" if tag else "") for name, cells, tag in listed])
    for section in _matrices(equations):
        tag = rf" \tag{{{section.number.strip('()')}}}" if section.number else ""
        found = [
            rf"({section.latex})_{{{i + 1},{j + 1}}} &= {_broken([write(part) for part in sympy.Add.make_args(cell)])}"
            for i, j, cell in _entries(equations, section)
        ] or [rf"{section.latex} &= 0"]
        out += [f"% {section.number} {section.key}", *align([found[0] + tag, *found[1:]])]
    for number, key, _ in _row_sections(equations) if equations.platform.gimbals else ():
        found = [
            rf"\text{{{_prose(name)}:}}\quad & {_broken(left)} = {_broken(right)}"
            for name, left, right in _sides(equations, key, write)
        ]
        out += [f"% {number} {key}", *align([found[0] + rf" \tag{{{number.strip('()')}}}", *found[1:]])]
    out += [rf"\par\noindent {_prose(note)}." for note in equations.notes]
    table = []
    for s in equations.symbols:
        number = "" if s.value is None else write(sympy.Float(f"{s.value:.6g}"))
        table.append(rf"& {s.latex} && {number} && \text{{{_prose(s.unit)}}} && \text{{{_prose(s.meaning)}}}")
    return "\n".join([*out, r"{\footnotesize", *align(table), "}", r"\endgroup"]) + "\n"


def _broken(terms: list[str]) -> str:
    """Break a long sum before the signs of its terms."""
    signed = _sum(terms, "-")
    lines = [" ".join(signed[k : k + _TERMS]) for k in range(0, len(signed), _TERMS)]
    # A sign that begins a cell is unary.
    return " \\\\\n  & \\quad ".join(re.sub(r"^-", "{-}", line) for line in lines)


def _prose(text: str) -> str:
    """Return prose for text mode."""
    escaped = re.sub(r"([&%$#_{}])", r"\\\1", text)
    return escaped.replace("²", "$^2$").replace("Ω", r"$\Omega$").replace("−", "$-$")


def record_of(equations: Equations) -> dict[str, Any]:
    """Return the record: expressions are strings that `sympy.sympify` reads."""

    def rows(key: str) -> list[dict[str, Any]]:
        found = zip(equations.platform.gimbal_names, equations.rows[key], getattr(equations, key), strict=True)
        return [
            {
                "gimbal": gimbal,
                "left": str(equation.lhs),
                "right": str(equation.rhs),
                "terms": [{"coefficient": str(c), "variable": str(v)} for c, v in terms],
            }
            for gimbal, terms, equation in found
        ]

    shown = ("name", "text", "latex", "meaning", "unit", "value")
    return {
        "schema": 1,
        "platform": equations.platform.name,
        "order": equations.order,
        "terms": equations.terms,
        "symbols": [{key: getattr(s, key) for key in shown} for s in equations.symbols],
        "vectors": {key: list(map(str, getattr(equations, key))) for key in _VECTORS},
        "matrices": {key: [list(map(str, row)) for row in getattr(equations, key).tolist()] for key in _MATRICES},
        "equations": {key: rows(key) for key in _ROWS},
        "groups": [list(group) for group in equations.groups],
        "notes": list(equations.notes),
    }
