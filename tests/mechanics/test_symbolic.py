"""The equations in symbols: the paper's matrices term by term, and any tree against the numeric route."""

import dataclasses
import json
import re

import numpy as np
import pytest
import sympy
from hypothesis import example, given, settings
from hypothesis import strategies as st

import three_gyro_paper
from oracle_trees import for_all
from platform_ctrl import equations, linearise, matrices, read_platform, subsystems
from three_gyro_paper import C6, C8, C11, J4, J5, J7, J9, J10, L6, L8, L11
from tree_cases import exact_slope, platforms

SEEDS = st.integers(0, 2**32 - 1)
GYROS = read_platform("three_gyro_platform")


def assert_same(found, expected):
    difference = sympy.Matrix(found) - sympy.Matrix(expected)
    assert sympy.simplify(difference) == sympy.zeros(*difference.shape)


@pytest.fixture(scope="module")
def paper():
    return equations(GYROS, "sympy")


@pytest.fixture(scope="module")
def exact():
    return equations(GYROS, "sympy", terms="exact")


# The three-gyro platform


def test_velocities_are_20_and_momenta_22(paper):
    assert_same(paper.velocity, three_gyro_paper.VELOCITY)
    assert_same(paper.L, three_gyro_paper.MOMENTA)
    assert_close(paper.evaluate(paper.L)[:, 0], matrices(GYROS).L)


def test_directions_are_21_with_the_sign_of_row_2_corrected(paper):
    assert_same(paper.B0, three_gyro_paper.B0)
    assert_same(paper.B_A, three_gyro_paper.B_A)


def test_mass_matrix_is_23_with_eight_rows(paper):
    assert_same(paper.A, three_gyro_paper.A)


def test_additional_mass_matrix_24_is_the_one_that_the_scan_lost(paper):
    assert_same(paper.BtA_RB, three_gyro_paper.BTA_RB)
    assert_same(paper.A_star, three_gyro_paper.A + three_gyro_paper.BTA_RB)


def test_coriolis_matrix_25_is_the_one_that_the_scan_lost(paper):
    assert_same(paper.G_A, three_gyro_paper.G_A)


def test_gyroscopic_matrix_is_26_and_the_root_block_stands_apart(paper):
    assert_same(paper.G_R, three_gyro_paper.G_R)
    at_rest = paper.G_root.subs(dict.fromkeys(paper.q, 0))
    assert_same(at_rest[:3, :3], [[0, 0, -L11], [0, 0, L6 - L8], [L11, L8 - L6, 0]])
    assert at_rest[3:, :] == sympy.zeros(5, 8)


def test_gimbal_equations_are_27_as_the_paper_means_them(paper):
    for equation, (left, right) in zip(paper.partially_linear, three_gyro_paper.ROWS.values(), strict=True):
        assert sympy.expand(equation.lhs - left) == 0
        assert sympy.expand(equation.rhs - right) == 0


def test_small_oscillations_19_are_27_without_products(paper):
    zero = dict.fromkeys([*paper.q, *paper.Omega_dot], 0)
    for equation, (left, right) in zip(paper.linear, three_gyro_paper.ROWS.values(), strict=True):
        assert sympy.expand(equation.lhs - left.subs(zero)) == 0
        assert sympy.expand(equation.rhs - right) == 0


def test_precession_15_is_27_without_inertia(paper):
    massless = dict.fromkeys([J4, J5, J7, J9, J10, C6, C8, C11], 0)
    for equation, (left, right) in zip(paper.precession, three_gyro_paper.ROWS.values(), strict=True):
        assert sympy.expand(equation.lhs - left.subs(massless)) == 0
        assert sympy.expand(equation.rhs - right.subs(massless)) == 0


def test_exact_equations_hold_every_term_for_any_rate(exact):
    for gimbal, terms in three_gyro_paper.EXACT_ROWS.items():
        found = {
            variable: coefficient for coefficient, variable in exact.rows["partially_linear"][GYROS.gimbal(gimbal)]
        }
        assert set(found) == set(terms), gimbal
        for variable, coefficient in terms.items():
            assert sympy.expand(found[variable] - coefficient) == 0, (gimbal, variable)


# Any tree against the numeric route


def assert_close(found, expected, size=None):
    scale = max(np.abs(expected).max(initial=0.0), size or 0.0, np.finfo(float).tiny)
    assert np.abs(np.asarray(found) - expected).max(initial=0.0) <= 1e-12 * scale


@for_all(st.tuples(platforms(max_gimbals=4), SEEDS), 2)
def test_zero_and_first_order_are_those_of_the_numeric_route(drawn):
    platform, seed = drawn
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    velocity = rng.normal(size=3 + n)
    found = equations(platform, "sympy", terms="exact")
    at = matrices(platform, velocity=velocity)
    for name in ("A", "A_star", "B", "G_A", "G_R", "G_root"):
        assert_close(found.evaluate(getattr(found, name), velocity=velocity), getattr(at, name))
    held = np.array([r.control == "regulated" for r in platform.rotors], float)[:, None] * at.A_R
    A_change = [exact_slope(lambda q: matrices(platform, q).A_star, np.zeros(n), k) for k in range(n)]
    B_change = [exact_slope(lambda q: matrices(platform, q).B, np.zeros(n), k) for k in range(n)]
    size_A, size_B = np.abs(A_change).max(initial=0.0), np.abs(B_change).max(initial=0.0)
    for j, step in enumerate(np.eye(n)):
        up, down = ({name: found.evaluate(getattr(found, name), q=sign * step) for name in ("A_star", "B", "BtA_RB")}
                    for sign in (1, -1))  # fmt: skip
        assert_close((up["A_star"] - down["A_star"]) / 2, A_change[j], size_A)
        dBtAB = B_change[j].T @ held @ at.B
        assert_close((up["BtA_RB"] - down["BtA_RB"]) / 2, dBtAB + dBtAB.T, size_A)
        assert_close((up["B"] - down["B"]) / 2, B_change[j], size_B)
    # B, and so G_R, is of first degree in sine and cosine of each angle: half the difference at ±90° is the slope at 0.
    for step in np.eye(n):
        up, down = (matrices(platform, sign * np.pi / 2 * step).G_R for sign in (1, -1))
        assert_close(found.evaluate(found.G_R, q=step) - at.G_R, (up - down) / 2, np.abs(at.L).max(initial=0.0))


@for_all(st.tuples(platforms(max_gimbals=4), SEEDS, st.sampled_from(["paper", "exact"])), 4)
def test_coefficients_of_27_are_those_of_the_linear_model(drawn):
    platform, seed, terms = drawn
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    Omega, change = rng.normal(size=3), rng.normal(size=3)
    model = linearise(platform, Omega=Omega, terms=terms)
    found = equations(platform, "sympy", terms=terms)
    motion = [found.accelerations, found.rates, found.q]
    point = {"velocity": np.r_[Omega, np.zeros(n)], "velocity_dot": np.r_[change, np.zeros(n)]}
    coefficients = np.zeros((3, n, n))
    constant = np.zeros(n)
    for row, terms_of_row in enumerate(found.rows["partially_linear"]):
        for coefficient, variable in terms_of_row:
            number = found.evaluate(coefficient, **point)
            if variable == 1:
                constant[row] = number
            else:
                [(kind, k)] = [(i, list(v).index(variable)) for i, v in enumerate(motion) if variable in list(v)]
                coefficients[kind, row, k] = number
    # What cancels counts too: while the root turns about a gimbal's axis, rounding alone is left of the stiffness.
    turn, momentum, inertia = np.abs(Omega).max(), np.abs(matrices(platform).L).max(initial=0.0), np.abs(model.M).max()
    size = np.abs(model.G).max() + np.abs(model.K).max()
    size += turn * (momentum + turn * inertia) + np.abs(change).max() * inertia
    assert_close(coefficients[0], model.M)
    assert_close(coefficients[1], model.G, size)
    assert_close(coefficients[2], model.K + np.einsum("iaj,a->ij", model.M_Omega_q, change), size)
    assert_close(constant, model.Q0 + model.M_Omega @ change, size)


@for_all(st.tuples(platforms(max_gimbals=2, max_rotors=2), SEEDS), 2)
def test_without_truncation_the_matrices_are_exact_everywhere(drawn):
    platform, seed = drawn
    rng = np.random.default_rng(seed)
    n = len(platform.gimbals)
    found = equations(platform, "sympy", order=None)
    for _ in range(2):
        q, velocity = rng.uniform(-3, 3, n), rng.normal(size=3 + n)
        at = matrices(platform, q, velocity)
        for name in ("A", "A_star", "B", "G_A", "G_R", "G_root"):
            assert_close(found.evaluate(getattr(found, name), q, velocity), getattr(at, name))


@settings(max_examples=3, deadline=None)
@example(GYROS, 1)
@example(GYROS, None)
@given(platforms(max_gimbals=2), st.sampled_from([0, 1, None]))
def test_17_B0_is_B_at_zero_angles_and_B_A_vanishes_there(platform, order):
    found = equations(platform, "sympy", order=order)
    assert not found.B0.free_symbols
    at = matrices(platform).B
    assert_close(found.evaluate(found.B0), at)
    assert_close(found.evaluate(found.B_A), np.zeros_like(at), 1.0)


@pytest.mark.parametrize(
    ("name", "terms"), [("three_gyro_platform", "exact"), ("gyro_horizon", "paper"), ("camera_gimbal", "exact")]
)
def test_subsystems_are_those_of_the_state_space_model(name, terms):
    """About a rate and a specific force without a zero: in symbols no component of them vanishes."""
    platform = dataclasses.replace(read_platform(name), specific_force=np.array([1.3, -2.4, -9.5]))
    model = linearise(platform, Omega=[0.7, -0.4, 0.9], terms=terms)
    assert equations(platform, "sympy", terms=terms).groups == subsystems(model)


# Force elements

ELEMENTS = {
    "schema": 1,
    "name": "with everything",
    "root": {"name": "base", "inertia": [3, 3.1, 3.2], "specific_force": [0.4, -0.3, 9.7]},
    "gimbal": [
        {"name": "1", "parent": "base", "axis": [1, 0, 0], "inertia": [1, 1.1, 1.2], "angle": "beta"},
        {"name": "outer % ring", "parent": "1", "axis": [0, 1, 0], "inertia": [1, 1.2, 1.1], "angle": "lambda"},
        {"name": "12", "parent": "outer % ring", "axis": [1, 1, 0], "inertia": [1, 1.1, 1], "angle": "E"},
        {"name": "2_1", "parent": "base", "axis": [0, 0, 1], "inertia": [1, 1.1, 1], "angle": "roll rate"},
        {"name": "2", "parent": "base", "axis": [1, 0, 0], "inertia": [[1, 0.1, 0], [0.1, 1.2, 0], [0, 0, 1.1]]},
    ],
    "rotor": [
        {
            "name": name,
            "carrier": body,
            "axis": axis,
            "axial_inertia": 0.1,
            "transverse_inertia": 0.07,
            "spin": spin,
            "control": control,
        }
        for name, body, axis, spin, control in (
            ("1", "12", [0, 0, 1], 80.0, "regulated"),
            ("Free one", "2", [0, 1, 0], 50.0, "free"),
            ("at rest", "base", [0, 0, 1], 0.0, "regulated"),
        )
    ],
    "spring": [{"gimbal": "1", "stiffness": 2.0, "rest": 0.1}, {"gimbal": "1", "stiffness": -0.5}],
    "friction": [
        {"gimbal": "2", "viscous": 0.1, "coulomb": 0.2},
        {"gimbal": "12", "viscous": 0.3, "breakaway": 0.1, "stribeck_rate": 0.05},
    ],
    "cage": [
        {"gimbal": "12", "stiffness": 5.0, "damping": 0.2, "angle": 0.01},
        {"gimbal": "2", "stiffness": 5.0, "clearance": 0.1},
        {"gimbal": "2_1", "stiffness": 7.0, "clearance": 0.1, "angle": -0.3},
    ],
    "unbalance": [{"body": "12", "moment": [0.0, 0.1, 0.2]}, {"body": "outer % ring", "moment": [0.03, 0, 0.02]}],
    "erection": [
        {"gimbal": "1", "senses": "12", "axis": [0, 1, 0.1], "gain": 0.3},
        {"gimbal": "2", "senses": "base", "axis": [0, 0, 1], "gain": 0.3, "limit": 0.1},
    ],
}


@pytest.mark.parametrize("terms", ["paper", "exact"])
def test_force_elements_enter_27_as_they_enter_the_linear_model(terms):
    platform = read_platform(ELEMENTS)
    Omega = np.array([0.3, -0.5, 0.7])
    model = linearise(platform, Omega=Omega, terms=terms)
    found = equations(platform, "sympy", terms=terms)
    point = {"velocity": np.r_[Omega, np.zeros(5)]}
    for row, (terms_of_row, torque) in enumerate(zip(found.rows["partially_linear"], model.Q0, strict=True)):
        numbers = {str(v): float(found.evaluate(c, **point)) for c, v in terms_of_row}
        for k in range(5):
            assert numbers.get(str(found.rates[k]), 0.0) == pytest.approx(model.damping[row, k], abs=1e-13)
            assert numbers.get(str(found.q[k]), 0.0) == pytest.approx(model.stiffness[row, k], abs=1e-13)
        assert numbers.get("1", 0.0) == pytest.approx(torque, abs=1e-13)


# Text, LaTeX, JSON


@pytest.mark.parametrize(("plant", "order"), [(GYROS, None), (read_platform(ELEMENTS), 1)], ids=["gyros", "elements"])
def test_latex_is_balanced_and_holds_latex_alone(plant, order):
    found = equations(plant, "latex", order=order)
    assert found.isascii()
    body = "\n".join(line for line in found.splitlines() if not line.startswith("%"))
    stripped = re.sub(r"\\[\\{}%&#_$]", "", body)
    depth = 0
    for character in stripped:
        depth += (character == "{") - (character == "}")
        assert depth >= 0
    assert depth == 0
    opened, closed = (re.findall(rf"\\{word}{{(.*?)}}", body) for word in ("begin", "end"))
    assert sorted(opened) == sorted(closed)
    for block in re.findall(r"\\begin{align\*}(.*?)\\end{align\*}", body, re.DOTALL):
        assert "\n\n" not in block
        assert not block.rstrip().endswith(r"\\")
    assert "%" not in re.sub(r"\\%", "", body)


@pytest.mark.parametrize("form", ["text", "latex"])
def test_what_people_read_has_no_more_digits_than_the_values_of_its_symbols(form):
    weight = read_platform("camera_gimbal")  # the specific force across its unbalance is a number
    assert "3.73761" in (found := equations(weight, form))
    assert re.search(r"[1-9]\.\d{6}", found) is None


@pytest.mark.parametrize(
    ("plant", "terms"), [(GYROS, "paper"), (read_platform(ELEMENTS), "exact")], ids=["gyros", "elements"]
)
def test_sympy_reads_the_record_back(plant, terms):
    found = equations(plant, "sympy", order=1, terms=terms)
    record = json.loads(json.dumps(equations(plant, "json", order=1, terms=terms)))
    assert (record["schema"], record["order"], record["terms"]) == (1, 1, terms)
    rng = np.random.default_rng(1)
    n = len(plant.gimbals)
    point = {"q": rng.normal(size=n), "velocity": rng.normal(size=3 + n), "velocity_dot": rng.normal(size=3 + n)}
    for key, rows in record["matrices"].items():
        read, written = sympy.Matrix(sympy.sympify(rows)), getattr(found, key)
        if terms == "paper" and plant is GYROS:
            assert read == written or (read - written).expand() == sympy.zeros(*read.shape)
        assert_close(found.evaluate(read, **point), found.evaluate(written, **point))
    torques = {s.name: 0.25 for s in found.symbols if s.kind == "torque"}
    for key, rows in record["equations"].items():
        for row, equation in zip(rows, getattr(found, key), strict=True):
            for side, expression in (("left", equation.lhs), ("right", equation.rhs)):
                read = found.evaluate(sympy.sympify(row[side]), **point, values=torques)
                assert read == pytest.approx(float(found.evaluate(expression, **point, values=torques)), rel=1e-11)
    assert {s["name"] for s in record["symbols"]} == {s.name for s in found.symbols}
