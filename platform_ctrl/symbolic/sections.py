"""What is printed, in which order and under which number: the same for text, LaTeX and JSON."""

from __future__ import annotations

from typing import Any, NamedTuple

from platform_ctrl.symbolic.notation import Notation
from platform_ctrl.symbolic.result import LINEAR, PARTIALLY_LINEAR, PRECESSION, Equations, RowTerms


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
    return [
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


def row_sections(equations: Equations) -> list[RowSection]:
    """Return the gimbal equations in the order in which they are printed."""
    kept = "the terms that the paper keeps" if equations.terms == "paper" else "every term"
    return [
        RowSection("(27)", PARTIALLY_LINEAR, f"linear in the angles, for any Ω(t); {kept}"),
        RowSection("(19)", LINEAR, "linear in the angles and in Ω"),
        RowSection("(15)", PRECESSION, "precession: momenta and force elements alone"),
    ]


_ORDINAL = {1: "first", 2: "second", 3: "third", 4: "fourth"}


def number_text(number: float | None) -> str:
    """Return a symbol's number, empty where it has none."""
    return "" if number is None else f"{number:.6g}"


def matrix_of(equations: Equations, section: MatrixSection) -> Any:
    """Return the SymPy matrix of a section."""
    return getattr(equations, section.key)


def sides(terms: RowTerms, torque: Any, write: Notation) -> tuple[str, str]:
    """Return both sides of a gimbal equation: coordinates on the left, Q and what the root does on the right."""
    left = write.signed_sum([write.times(c, v) for c, v in terms if v != 1]) or "0"
    constants = [term for c, v in terms if v == 1 for term in write.terms(c, positive_first=False)]
    return left, write.signed_sum([*write.terms(torque), *((not negative, size) for negative, size in constants)])
