"""docs/theory/the-paper.md: its formulas (20) to (27), as they are typeset, are those that the energy gives."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import sympy
from sympy.parsing.sympy_parser import implicit_multiplication, parse_expr, standard_transformations

import platform_ctrl as pc
import three_gyro_paper as paper
from platform_ctrl import platform_source

TEXT = (Path(__file__).parents[2] / "docs" / "theory" / "the-paper.md").read_text(encoding="utf-8")
FORMULAS = [formula.strip() for formula in re.findall(r"^\$\$\n(.*?)\n\$\$", TEXT, re.MULTILINE | re.DOTALL)]
GREEK = r"alpha|beta|Omega"


def meant(latex: str) -> sympy.Expr:
    """What a formula without relations says, in the symbols of the table of corrected equations."""
    text = latex.replace(r"\tfrac{1}{2}", "Rational(1, 2) ")
    text = re.sub(r"\\ddot\{\\(alpha|beta)\}_\{?(\d+)\}?", r" \1\2_ddot ", text)
    text = re.sub(rf"\\dot\{{\\({GREEK})\}}_\{{?(\d+)\}}?", r" \1\2_dot ", text)
    text = re.sub(rf"\\({GREEK})_\{{?(\d+)\}}?", r" \1\2 ", text)
    text = re.sub(r"\b([JCLQ])_\{?(\d+)\}?", r" \1\2 ", text).replace("^2", "**2")
    assert "\\" not in text, f"not understood: {text}"
    names = {name: sympy.Symbol(name) for name in re.findall(r"[A-Za-z]+\d+(?:_d?dot)?", text)}
    return parse_expr(text, names, (*standard_transformations, implicit_multiplication))


def matrix(name: str) -> sympy.Matrix:
    """The matrix on the right of `name` =."""
    [body] = [
        found[1]
        for formula in FORMULAS
        if (found := re.fullmatch(rf"{re.escape(name)} = \\begin{{bmatrix}}(.*)\\end{{bmatrix}}", formula, re.DOTALL))
    ]
    return sympy.Matrix([[meant(cell) for cell in row.split("&")] for row in body.split(r"\\")])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (r"\mathbf{B}_0", paper.B0),
        (r"\mathbf{B}_A", paper.B_A),
        (r"\mathbf{L}", paper.MOMENTA),
        (r"\mathbf{A}", paper.A),
        (r"\mathbf{B}^T \mathbf{A}_R \mathbf{B}", paper.BTA_RB),
        (r"\mathbf{G}_R", paper.G_R),
    ],
    ids=["21, B0", "21, BA", "22", "23", "24", "26"],
)
def test_a_matrix_on_the_page_is_that_of_the_energy(name: str, expected: sympy.Matrix) -> None:
    assert sympy.simplify(matrix(name) - expected) == sympy.zeros(*expected.shape)


def test_20_names_the_velocities() -> None:
    [formula] = [formula for formula in FORMULAS if r"= [\Omega_1" in formula]
    inside = formula[formula.index("[") + 1 : formula.rindex("]")]
    assert [meant(one) for one in inside.split(", ")] == list(paper.VELOCITY)


def test_25_follows_from_the_matrix_on_the_page() -> None:
    N = matrix(r"\mathbf{N}")
    assert (N - N.T / 2 - paper.G_A).expand() == sympy.zeros(8, 8)


def test_27_on_the_page_is_that_of_the_table() -> None:
    rows = [formula for formula in FORMULAS if formula.startswith("J_") and "ddot" in formula]
    assert len(rows) == 5
    for row, (left, right) in zip(rows, paper.ROWS.values(), strict=True):
        written = [meant(side) for side in row.split("=")]
        assert [(one - other).expand() for one, other in zip(written, (left, right), strict=True)] == [0, 0]


def test_the_added_block_of_the_root_is_that_of_the_package() -> None:
    # Gyros 6 and 8 differ here: their difference stands in the block.
    momenta = {"6": 0.15, "8": 0.1, "11": 0.2}
    plant = tomllib.loads(platform_source("three_gyro_platform"))
    for rotor in plant["rotor"]:
        rotor.pop("spin", None)
        rotor["angular_momentum"] = momenta[rotor["name"]]
    block = matrix(r"\mathbf{G}_{root}").subs({f"L{name}": number for name, number in momenta.items()})
    numbers = np.array(block.tolist(), dtype=np.float64)
    assert np.allclose(numbers, pc.matrices(pc.read_platform(plant)).G_root[:3, :3], rtol=1e-12, atol=1e-15)


def test_every_equation_of_the_paper_stands_there_in_order() -> None:
    assert [int(n) for n in re.findall(r"^\((\d+)\)", TEXT, re.MULTILINE)] == list(range(1, 28))
