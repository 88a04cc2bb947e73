"""Writing expressions: text, LaTeX and code, with the terms in the order that a reader expects.

Parameters first, then rates of the root, then gimbal coordinates: (L6 − L8) Ω1 α4. SymPy's own printers sort otherwise
and take many times as long on long sums.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import sympy

from platform_ctrl.common.values import value
from platform_ctrl.mechanics.symbolic.names import NamedSymbol
from platform_ctrl.mechanics.symbolic.result import LINEAR, PARTIALLY_LINEAR, PRECESSION, Equations, RowTerms

Expression = Any
Key = tuple[Any, ...]

_ANGLES = ("angle",)
_MOVING = ("rate of the root", "acceleration of the root", "acceleration", "rate")
_SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


@value
class Style:
    """How the parts of an expression look."""

    symbol: Callable[[NamedSymbol], str]
    number: Callable[[Expression], str]
    power: Callable[[str, int], str]
    function: Callable[[str, str, int], str]
    quotient: Callable[[str, str], str]
    brackets: tuple[str, str]
    times: str
    minus: str


def _text_number(number: Expression) -> str:
    if number.is_Rational:
        return "½" if (number.p, number.q) == (1, 2) else str(number)
    return f"{float(number):.6g}"


def _latex_number(number: Expression) -> str:
    if number.is_Rational:
        return str(number) if number.q == 1 else rf"\tfrac{{{number.p}}}{{{number.q}}}"
    mantissa, _, exponent = f"{float(number):.6g}".partition("e")
    return mantissa + (rf" \cdot 10^{{{int(exponent)}}}" if exponent else "")


def _code_number(number: Expression) -> str:
    if number.is_Rational:
        return str(number) if number.q == 1 else f"({number.p}/{number.q})"
    return repr(float(number))


TEXT = Style(
    symbol=lambda s: s.text,
    number=_text_number,
    power=lambda base, exponent: base + str(exponent).translate(_SUPERSCRIPT),
    function=lambda name, argument, n: f"{name}{str(n).translate(_SUPERSCRIPT) if n > 1 else ''} {argument}",
    quotient=lambda top, bottom: f"{top}/{bottom}",
    brackets=("(", ")"),
    times=" ",
    minus="−",
)
LATEX = Style(
    symbol=lambda s: s.latex,
    number=_latex_number,
    power=lambda base, exponent: f"{base}^{{{exponent}}}",
    function=lambda name, argument, n: rf"\{name}{f'^{n}' if n > 1 else ''} {argument}",
    quotient=lambda top, bottom: rf"\frac{{{top}}}{{{bottom}}}",
    brackets=("(", ")"),
    times=r" \, ",
    minus="-",
)
CODE = Style(
    symbol=lambda s: s.name,
    number=_code_number,
    power=lambda base, exponent: f"{base}**{exponent}",
    function=lambda name, argument, n: f"{name}({argument})" + (f"**{n}" if n > 1 else ""),
    quotient=lambda top, bottom: f"{top}/{bottom}",
    brackets=("(", ")"),
    times="*",
    minus="-",
)


class Notation:
    """Writes expressions in the symbols of one platform."""

    def __init__(self, symbols: tuple[NamedSymbol, ...], style: Style) -> None:
        self.style = style
        self._symbols: Mapping[str, tuple[int, NamedSymbol]] = {s.name: (k, s) for k, s in enumerate(symbols)}
        self._keys: dict[Expression, Key] = {}

    def __call__(self, expression: Expression) -> str:
        """Return the expression as written, ``0`` where it is zero."""
        return self.signed_sum([*self.terms(expression)]) or "0"

    def terms(self, expression: Expression, positive_first: bool = True) -> list[tuple[bool, str]]:
        """Return the terms of a sum in their order: whether each is negative, and its size."""
        if expression == 0:
            return []
        parts = sorted(expression.args, key=self._key) if expression.is_Add else [expression]
        written = [self._term(part) for part in parts]
        if positive_first and written[0][0] and len(written) <= 3:
            # L8 − L6 rather than −L6 + L8
            first = next((k for k, (negative, _) in enumerate(written) if not negative), 0)
            written.insert(0, written.pop(first))
        return written

    def signed_sum(self, terms: list[tuple[bool, str]]) -> str:
        """Return terms with their signs between them."""
        out = ""
        for negative, size in terms:
            sign = self.style.minus if negative else "+"
            out += f" {sign} {size}" if out else (self.style.minus if negative else "") + size
        return out

    def times(self, coefficient: Expression, variable: Expression) -> tuple[bool, str]:
        """Return coefficient × variable as one term, the coefficient kept together."""
        if variable == 1 or not coefficient.is_Add:
            return self._term(sympy.Mul(coefficient, variable, evaluate=False) if variable != 1 else coefficient)
        negative, inside = self._bracket(coefficient)
        return negative, inside + self.style.times + self._atom(variable)

    def _term(self, expression: Expression) -> tuple[bool, str]:
        """Return the sign and the size of what is not a sum."""
        if expression.is_Add:
            negative, inside = self._bracket(expression)
            return negative, inside
        number, factors = _factors(expression)
        negative = float(number) < 0.0
        size = abs(number)
        top: list[str] = []
        bottom: list[str] = []
        moving: list[str] = []
        for factor in sorted(factors, key=self._factor_key):
            if factor.is_Pow and factor.exp == -1:
                bottom.append(self._atom(factor.base))
                continue
            flipped, written = self._bracket(factor) if factor.is_Add else (False, self._atom(factor))
            negative ^= flipped
            (moving if any(self._key(factor)[:2]) else top).append(written)
        if size != 1 or not (top or moving):
            top.insert(0, self.style.number(size))
        if bottom:
            top = [self.style.quotient(self.style.times.join(top), self.style.times.join(bottom))]
        return negative, self.style.times.join(top + moving)

    def _bracket(self, expression: Expression) -> tuple[bool, str]:
        """Return a sum in brackets; where its first term is negative, the sign comes before them."""
        terms = self.terms(expression)
        flip = terms[0][0]
        opening, closing = self.style.brackets
        return flip, opening + self.signed_sum([(negative ^ flip, size) for negative, size in terms]) + closing

    def _atom(self, expression: Expression) -> str:
        if expression.is_Symbol:
            return self.style.symbol(self._symbols[expression.name][1])
        if expression.is_Pow:
            base, exponent = expression.base, int(expression.exp)
            if base.is_Function:
                return self.style.function(base.func.__name__, self._atom(base.args[0]), exponent)
            return self.style.power(self._atom(base), exponent)
        if expression.func in (sympy.sin, sympy.cos):
            return self.style.function(expression.func.__name__, self._atom(expression.args[0]), 1)
        if expression.is_Number:
            return self.style.number(expression)
        return "".join((self.style.brackets[0], self(expression), self.style.brackets[1]))

    def _key(self, expression: Expression) -> Key:
        """Return what sorts terms: degree in the angles, degree in the rates, then the symbols in their order."""
        if expression in self._keys:
            return self._keys[expression]
        if expression.is_Symbol:
            rank, symbol = self._symbols[expression.name]
            key: Key = (int(symbol.kind in _ANGLES), int(symbol.kind in _MOVING), (rank,))
        elif expression.is_Number:
            key = (0, 0, ())
        elif expression.is_Add:
            key = min(self._key(part) for part in expression.args if not part.is_Number)
        elif expression.is_Pow:
            base = self._key(expression.base)
            times = int(expression.exp)
            key = (base[0] * times, base[1] * times, base[2] * max(1, times))
        else:
            keys = [self._key(part) for part in expression.args]
            ranks = tuple(sorted(rank for key in keys for rank in key[2]))
            key = (sum(key[0] for key in keys), sum(key[1] for key in keys), ranks)
        self._keys[expression] = key
        return key

    def _factor_key(self, expression: Expression) -> Key:
        """Return the sort key of a factor: a power is placed like its base."""
        return self._key(expression.base if expression.is_Pow else expression)


def _factors(expression: Expression) -> tuple[Expression, list[Expression]]:
    """Return the number and the other factors of a product, products within it opened."""
    number, out = sympy.S.One, []
    waiting = [expression]
    while waiting:
        part = waiting.pop()
        if part.is_Number:
            number = part if number == 1 else number * part
        elif part.is_Mul:
            waiting += part.args
        else:
            out.append(part)
    return number, out


class MatrixSection(NamedTuple):
    """A matrix: its number, the key of `Equations`, its notations and what it is."""

    number: str
    key: str
    text: str
    latex: str
    about: str
    rows: str
    symmetry: str


class RowSection(NamedTuple):
    """Equations, one a gimbal."""

    number: str
    key: str
    about: str


def matrix_sections(equations: Equations) -> list[MatrixSection]:
    """Return the matrices in the paper's order."""
    p, exact = equations.order, equations.terms == "exact" or equations.order is None
    to = "exact" if p is None else "at zero angles" if p == 0 else f"to {_ORDINAL[p]} order in the angles"
    to_next = "exact" if p is None else f"to {_ORDINAL[p + 1]} order"
    A = f"mass matrix without C, {to}" if exact else "mass matrix without C, taken as constant"
    G_A = f"Coriolis matrix, {to}" if exact else "Coriolis matrix, A constant: from (24) as it stands"
    h = "∂T/∂Ω of A* u + BᵀL" if exact else "∂T/∂Ω of BᵀL alone"
    sections = [
        MatrixSection("(21)", "B0", "B0", "B_0", "directions B at zero angles; rotors by [Ω, q̇]", "rotors", ""),
        MatrixSection("(21)", "B_A", "B_A", "B_A", f"B − B0, {to_next}", "rotors", ""),
        MatrixSection("(23)", "A", "A", "A", A, "velocity", "symmetric"),
        MatrixSection(
            "(24)", "BtA_RB", "BᵀA_R B", "B^T A_R B", f"the rotors' axial inertia, {to}", "velocity", "symmetric"
        ),
        MatrixSection("(25)", "G_A", "G_A", "G_A", G_A, "velocity", ""),
        MatrixSection("(26)", "G_R", "G_R", "G_R", f"gyroscopic matrix, {to}, without G_root", "velocity", "skew"),
        MatrixSection(
            "",
            "G_root",
            "G_root",
            r"G_\mathrm{root}",
            f"−[∂T/∂Ω]× in the root's block, zero elsewhere; {h}, {to}; not in the paper",
            "root",
            "skew",
        ),
    ]
    return sections if equations.platform.rotors else [one for one in sections if one.key not in _OF_ROTORS]


def row_sections(equations: Equations) -> list[RowSection]:
    """Return the gimbal equations in the order in which they are printed; without rotors there is no precession."""
    kept = "the terms that the paper keeps" if equations.terms == "paper" else "every term"
    slow = RowSection("(15)", PRECESSION, "precession: momenta and force elements alone")
    return [
        RowSection("(27)", PARTIALLY_LINEAR, f"linear in the angles, for any Ω(t); {kept}"),
        RowSection("(19)", LINEAR, "linear in the angles and in Ω"),
        *([slow] if equations.platform.rotors else []),
    ]


# Matrices that are empty or zero without rotors.
_OF_ROTORS = {"B0", "B_A", "BtA_RB", "G_R"}
_ORDINAL = {1: "first", 2: "second", 3: "third", 4: "fourth"}


def number_text(number: float | None) -> str:
    """Return a symbol's number, empty where it has none."""
    return "" if number is None else f"{number:.6g}"


def cells_of(equations: Equations, section: MatrixSection, write: Notation) -> list[list[str]]:
    """Return the written elements of a section's matrix, row by row; of one about the root its block alone."""
    matrix = getattr(equations, section.key)
    matrix = matrix[:3, :3] if section.rows == "root" else matrix
    return [[write(matrix[i, j]) for j in range(matrix.cols)] for i in range(matrix.rows)]


def entries_of(section: MatrixSection, cells: list[list[str]]) -> list[tuple[int, int, str]]:
    """Return row, column and text of what is not zero; of a symmetric or skew matrix one half."""
    return [
        (i, j, cell)
        for i, row in enumerate(cells)
        for j, cell in enumerate(row)
        if cell != "0" and (not section.symmetry or j >= i)
    ]


def gimbal_equations(equations: Equations, key: str, write: Notation) -> Iterator[tuple[str, str, str]]:
    """Walk the gimbals' names with both sides of their equations."""
    torques = list(equations.forces)[3:]
    for name, terms, torque in zip(equations.platform.gimbal_names, equations.rows[key], torques, strict=True):
        yield name, *_sides(terms, torque, write)


def _sides(terms: RowTerms, torque: Any, write: Notation) -> tuple[str, str]:
    """Return both sides of a gimbal equation: coordinates on the left, Q and what the root does on the right."""
    left = write.signed_sum([write.times(c, v) for c, v in terms if v != 1]) or "0"
    constants = [term for c, v in terms if v == 1 for term in write.terms(c, positive_first=False)]
    return left, write.signed_sum([*write.terms(torque), *((not negative, size) for negative, size in constants)])
