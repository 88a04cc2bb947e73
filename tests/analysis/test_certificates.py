"""Certificates: what they say is true, and what is not true is never proved."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction
from typing import Any

import control
import flint
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from platform_ctrl import analysis
from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.certificate import inequality, proved
from platform_ctrl.analysis.certificates.closed_loop import closed, enclosed_by, stabilising
from platform_ctrl.analysis.certificates.intervals import balls, positive_definite, rounded
from platform_ctrl.analysis.certificates.makers import h2_certificate, norm_certificate, stability_certificate
from platform_ctrl.analysis.certificates.plant_set import region_certificate
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.errors import ArgumentError, NotCertifiedError


def random_system(
    seed: int, order: int, decay: float, dt: float
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """A, B, C, D of a system whose slowest pole decays at `decay`."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((order, order))
    A -= (np.linalg.eigvals(A).real.max() + decay) * np.eye(order)
    B, C, D = (rng.standard_normal(shape) for shape in ((order, 2), (3, order), (3, 2)))
    return (expm(A * dt) if dt > 0 else A), B, C, D


def system_of(A: Any) -> StateArrays:
    n = len(A)
    return StateArrays(np.asarray(A, dtype=float), np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), 0.0)


systems = {
    "seed": st.integers(0, 10**6),
    "order": st.integers(1, 12),
    "decay": st.floats(1e-4, 1.0),
    "dt": st.sampled_from([0.0, 0.01, 0.2]),
}


@settings(deadline=None, max_examples=40)
@given(**systems)
def test_what_is_stable_is_proved_stable_with_nearly_its_own_decay_rate(
    seed: int, order: int, decay: float, dt: float
) -> None:
    A = random_system(seed, order, decay, dt)[0]
    found = stability_certificate(A, dt)
    assert found.verify().proved
    assert 0.5 * decay < found.bound < decay


@settings(deadline=None, max_examples=15)
@given(**systems)
def test_norms_are_proved_just_above_what_analysis_finds(seed: int, order: int, decay: float, dt: float) -> None:
    A, B, C, D = random_system(seed, order, decay, dt)
    system = control.StateSpace(A, B, C, D, dt)
    found = norm_certificate(A, B, C, D, dt)
    assert found.verify().proved
    norm = analysis.hinf_norm(system)[0]
    assert norm < found.bound <= norm * (1 + 1.1e-4)
    energy = h2_certificate(A, B, C, D if dt > 0 else None, dt)
    assert energy.verify().proved
    if dt == 0:
        system = control.StateSpace(A, B, C, np.zeros_like(D))
    assert energy.bound == pytest.approx(analysis.h2_norm(system), rel=1e-6)


@pytest.mark.parametrize("dt", [0.0, 0.01])
@pytest.mark.parametrize("order", [2, 5, 8])
def test_the_bound_agrees_with_the_norm_to_a_millionth(order: int, dt: float) -> None:
    A, B, C, D = random_system(order, order, 0.3, dt)
    norm = analysis.hinf_norm(control.StateSpace(A, B, C, D, dt))[0]
    assert norm < norm_certificate(A, B, C, D, dt).bound <= norm * (1 + 1e-6)


@settings(deadline=None, max_examples=40)
@given(**systems, row=st.integers(0, 11), column=st.integers(0, 11))
def test_what_is_unstable_is_never_proved_stable(
    seed: int, order: int, decay: float, dt: float, row: int, column: int
) -> None:
    """With the X of a stable neighbour, with the identity, and by the makers."""
    A = random_system(seed, order, decay, dt)[0]
    good = stability_certificate(A, dt)
    grown = A * math.exp(2 * decay * dt) if dt > 0 else A + 2 * decay * np.eye(order)
    bad = dataclasses.replace(good, bound=0.0, loops=(closed(StateArrays(grown, *system_of(A)[1:4], dt)),))
    for X in (good.X, np.eye(order)):
        found = dataclasses.replace(bad, X=X).verify()
        assert not found.proved
        assert found.margin == 0.0
    with pytest.raises(NotCertifiedError, match="grows at"):
        stability_certificate(grown, dt)


@pytest.mark.parametrize("dt", [0.0, 0.05])
def test_a_perturbed_certificate_is_rejected(dt: float) -> None:
    A, B, C, D = random_system(3, 6, 0.5, dt)
    for good in (norm_certificate(A, B, C, D, dt), stability_certificate(A, dt), h2_certificate(A, B, C, None, dt)):
        assert good.verify().proved
        values, vectors = np.linalg.eigh(good.X)
        bent = good.X - 1.01 * values[0] * np.outer(vectors[:, 0], vectors[:, 0])
        changes = {
            "X is not positive definite": {"X": 0.5 * (bent + bent.T)},
            "X is not symmetric": {"X": good.X + np.eye(6, k=1) * np.abs(good.X).max() * 1e-15},
            "a matrix is not finite": {"X": good.X * np.nan},
            # More than is true: no X proves it.
            "is not positive definite": {"bound": good.bound * (1.1 if good.claim == "stability" else 0.99)},
        }
        for words, change in changes.items():
            found = dataclasses.replace(good, **change).verify()
            assert not found.proved
            assert words in found.reason
        other = closed(StateArrays(good.loops[0].A * (1.3 if dt else -1.0), *good.loops[0].rounded()[1:4], dt))
        assert "is not positive definite" in dataclasses.replace(good, loops=(other,)).verify().reason


@settings(deadline=None, max_examples=25)
@given(**systems)
def test_no_norm_below_the_true_one_is_proved(seed: int, order: int, decay: float, dt: float) -> None:
    A, B, C, D = random_system(seed, order, decay, dt)
    found = norm_certificate(A, B, C, D, dt)
    assert not dataclasses.replace(found, bound=found.bound * (1 - 1e-3)).verify().proved
    with pytest.raises(NotCertifiedError, match="no proof that the norm is below"):
        norm_certificate(A, B, C, D, dt, gamma=found.bound * (1 - 1e-3))


def test_the_first_order_lag_by_hand() -> None:
    """1/(s + 1), norm 1: X proves gamma if 2X - 1 > X²/gamma², between the roots. H2 norm 1/sqrt 2."""
    loop = closed(StateArrays(-np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), 0.0))

    def shown(X: float, gamma: float) -> bool:
        return Certificate(claim="norm", bound=gamma, loops=(loop,), X=np.array([[X]])).verify().proved

    # For gamma = 1 only X = 1 would do, and not strictly.
    assert not shown(1.0, 1.0)
    assert shown(1.0, 1.0 + 1e-15)
    gamma = 2.0
    low, high = (gamma**2 * (1 + sign * math.sqrt(1 - 1 / gamma**2)) for sign in (-1, 1))
    for X, inside in ((low - 1e-9, False), (low + 1e-9, True), (high - 1e-9, True), (high + 1e-9, False)):
        assert shown(X, gamma) is inside
    assert h2_certificate([[-1.0]], [[1.0]], [[1.0]]).bound == pytest.approx(math.sqrt(0.5), rel=1e-6)


def test_marginal_loops_are_told_from_stable_ones_at_the_last_bit() -> None:
    """An oscillator that neither decays nor grows, and its neighbours a rounding error away."""
    swing = np.array([[0.0, 1.0], [-1.0, 0.0]])

    def shown(A: np.ndarray[Any, Any], X: np.ndarray[Any, Any]) -> bool:
        return Certificate(claim="stability", bound=0.0, loops=(closed(system_of(A)),), X=X).verify().proved

    assert not shown(swing, np.eye(2))
    tiny = 1e-300
    assert shown(swing - tiny * np.eye(2), np.eye(2))
    assert not shown(swing + tiny * np.eye(2), np.eye(2))


@pytest.mark.parametrize("order", [2, 6])
def test_a_loop_that_decays_slowly_at_a_fast_sample_rate_is_proved(order: int) -> None:
    """0.05 1/s at 2 kHz: poles 2.5e-5 from the unit circle, beside fast ones, in coordinates that are not nice."""
    rng = np.random.default_rng(order)
    poles = np.concatenate([[-0.05, -0.05], -np.geomspace(1.0, 2e3, order - 2)])
    V = rng.standard_normal((order, order))
    units = np.geomspace(1e-4, 1e4, order)
    A = (units[:, None] * V) @ np.diag(np.exp(poles / 2000)) @ np.linalg.inv(units[:, None] * V)
    assert 1 - np.abs(np.linalg.eigvals(A)).max() == pytest.approx(2.5e-5, rel=1e-3)
    found = stability_certificate(A, 1 / 2000)
    assert found.verify().proved
    assert 0.04 < found.bound < 0.0501
    assert norm_certificate(A, np.ones((order, 1)) * units[:, None], np.ones((1, order)) / units, [[0.0]], 1 / 2000)


@pytest.mark.parametrize("dt", [0.0, 1e-3])
def test_poles_ten_decades_apart_are_proved_with_many_bits(dt: float) -> None:
    """From 1e-4 to 1e6 1/s; as a companion matrix no X in doubles proves anything in its own states."""
    poles = -np.array([1e-4, 2.0, 1e3, 1e6])
    coefficients = np.poly(poles)
    A = np.eye(4, k=1)
    A[-1] = -coefficients[1:][::-1]
    B, C, D = np.eye(4)[:, 3:], coefficients[-1] * np.eye(4)[:1], np.zeros((1, 1))
    if dt > 0:
        # Sampled lags in a row.
        z = np.exp(poles * dt)
        A = np.diag(z) + np.diag(1 - z[1:], -1)
        B, C = (1 - z[0]) * np.eye(4)[:, :1], np.eye(4)[3:]
    found = norm_certificate(A, B, C, D, dt)
    assert found.verify().proved
    assert found.bound == pytest.approx(1.0, rel=1e-5)
    assert stability_certificate(A, dt).bound == pytest.approx(1e-4, rel=0.02)
    energy = h2_certificate(A, B, C, D, dt)
    assert energy.verify().proved
    assert energy.bound == pytest.approx(analysis.h2_norm(control.StateSpace(A, B, C, D, dt)), rel=1e-4)
    if dt == 0:
        assert found.coordinates is not None
        singular = dataclasses.replace(found, coordinates=np.zeros((4, 4))).verify()
        assert not singular.proved
        assert "coordinates are singular" in singular.reason


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_the_riccati_solution_of_many_bits_is_that_of_scipy(dt: float) -> None:
    A, B, C, D = random_system(4, 5, 0.5, dt)
    gamma = 1.3 * analysis.hinf_norm(control.StateSpace(A, B, C, D, dt))[0]
    solve = solve_discrete_are if dt > 0 else solve_continuous_are
    theirs = solve(A, B, C.T @ C, D.T @ D - gamma**2 * np.eye(2), s=C.T @ D)
    mine = stabilising(closed(StateArrays(A, B, C, D, dt)), np.eye(5), 0.0, gamma)
    np.testing.assert_allclose(mine, theirs, rtol=1e-8, atol=1e-10)


def test_the_closed_loop_is_that_of_the_given_plant_and_controller_in_exact_arithmetic() -> None:
    """Rationals by hand against the balls, with an algebraic loop."""
    rng = np.random.default_rng(5)
    P = StateArrays(*(rng.standard_normal(shape) for shape in ((2, 2), (2, 2), (2, 2), (2, 2))), dt=0.0)
    K = StateArrays(*(rng.standard_normal(shape) for shape in ((1, 1), (1, 1), (1, 1), (1, 1))), dt=0.0)
    loop = closed(P, K)

    def exact(x: float) -> Fraction:
        return Fraction(float(x))

    # Scalar u and y: u = (D_K (c x + d21 w) + c_K x_K) / (1 - D_K d22).
    e = 1 / (1 - exact(K.D[0, 0]) * exact(P.D[1, 1]))
    u_x = [e * exact(K.D[0, 0]) * exact(P.C[1, j]) for j in range(2)]
    A00 = exact(P.A[0, 0]) + exact(P.B[0, 1]) * u_x[0]
    z_w = exact(P.D[0, 0]) + exact(P.D[0, 1]) * e * exact(K.D[0, 0]) * exact(P.D[1, 0])
    with flint.ctx.workprec(200):
        enclosed = loop.enclosed()
        for ball, number in ((enclosed.A[0, 0], A00), (enclosed.D[0, 0], z_w)):
            assert ball.contains(flint.arb(flint.fmpq(number.numerator, number.denominator)))
            assert ball.rad() < 1e-50
    rounded = loop.rounded()
    np.testing.assert_allclose(rounded.A[0, 0], float(A00), rtol=1e-12)
    np.testing.assert_allclose(rounded.D[0, 0], float(z_w), rtol=1e-12)


@pytest.mark.parametrize(("states", "own"), [(3, 2), (3, 0), (0, 2), (0, 0)])
def test_closed_loops_are_those_of_analysis(states: int, own: int) -> None:
    rng = np.random.default_rng(7)
    A, B, C, D = (rng.standard_normal(shape) for shape in ((states, states), (states, 2), (3, states), (3, 2)))
    K = StateArrays(*(0.3 * rng.standard_normal(shape) for shape in ((own, own), (own, 3), (2, own), (2, 3))), dt=0.1)
    theirs = closed_loop(StateArrays(A, B, C, D, K.dt), K)[:4]
    # Inputs [d, n, u], outputs [u, y, y + n].
    P = StateArrays(
        A,
        np.hstack([B, np.zeros((states, 3)), B]),
        np.vstack([np.zeros((2, states)), C, C]),
        np.block([[np.zeros((2, 5)), np.eye(2)], [D, np.zeros((3, 3)), D], [D, np.eye(3), D]]),
        0.1,
    )
    loop = closed(P, K)
    for mine, other in zip(loop.rounded()[:4], theirs, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-11, atol=1e-12)
    with flint.ctx.workprec(100):
        for ball, other in zip(loop.enclosed(), theirs, strict=True):
            assert (ball.nrows(), ball.ncols()) == other.shape
            middle = np.array([[float(x) for x in row] for row in ball.tolist()]).reshape(other.shape)
            np.testing.assert_allclose(middle, other, rtol=1e-11, atol=1e-12)


def test_one_matrix_serves_every_system_between_the_vertices() -> None:
    """Two swings with the same damper and stiffness 1 and 1.5: any variation in between stays stable."""
    loops = tuple(closed(system_of([[0.0, 1.0], [-k, -1.0]])) for k in (1.0, 1.5))
    X = np.array([[1.75, 0.5], [0.5, 1.5]])
    common = Certificate(claim="stability", bound=0.0, loops=loops, X=X)
    assert proved(common) is common
    assert "between 2 vertices" in common.statement
    rng = np.random.default_rng(1)
    for share in rng.uniform(size=5):
        between = share * loops[0].A + (1 - share) * loops[1].A
        assert Certificate(claim="stability", bound=0.0, loops=(closed(system_of(between)),), X=X).verify().proved
    # Stiffness 1 and 40 with this damper can be switched so that it grows: no common X exists, least of all this.
    wide = dataclasses.replace(common, loops=(loops[0], closed(system_of([[0.0, 1.0], [-40.0, -1.0]]), label="stiff")))
    found = wide.verify()
    assert not found.proved
    assert "stiff" in found.reason
    with pytest.raises(NotCertifiedError, match="not proved that every system between 2 vertices"):
        proved(wide)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"claim": "gain"}, "got 'gain'"),
        ({"bound": math.nan}, "bound must be a positive number, got nan"),
        ({"bound": -1.0}, "got -1.0"),
        ({"loops": ()}, "at least one"),
        ({"X": np.eye(3)}, "X must be (2, 2), got (3, 3)"),
        ({"coordinates": np.eye(3)}, "must be (2, 2)"),
        ({"loops": (closed(system_of(np.full((2, 2), np.inf))),)}, "not finite"),
        ({"loops": (closed(system_of(-np.eye(2))), closed(system_of(-np.eye(3))))}, "different orders"),
        ({"bound": "1"}, "got '1'"),
        ({"bound": 10**400}, "must be a positive number"),
        ({"claim": ["norm"]}, "got ['norm']"),
        ({"X": [[1.0, 0.0], [0.0, 1.0]]}, "X is no matrix of doubles"),
        ({"X": np.eye(2) * 1j}, "X is no matrix of doubles"),
        ({"loops": None}, "tuple of closed loops"),
        ({"loops": (dataclasses.replace(closed(system_of(-np.eye(2))), A=np.eye(2)[:1]),)}, "do not fit together"),
        ({"loops": (dataclasses.replace(closed(system_of(-np.eye(2))), B=np.zeros((3, 1))),)}, "do not fit together"),
        ({"loops": (dataclasses.replace(closed(system_of(-np.eye(2))), dt=None),)}, "got None"),
        ({"loops": (dataclasses.replace(closed(system_of(-np.eye(2))), A_K=np.eye(1)),)}, "or none of them"),
        ({"claim": "region", "L": np.zeros((0, 0)), "M": np.zeros((0, 0))}, "L and M"),
    ],
)
def test_a_senseless_certificate_is_not_proved_and_does_not_raise(change: dict[str, Any], words: str) -> None:
    good = stability_certificate(-np.eye(2))
    found = dataclasses.replace(good, **change).verify()
    assert not found.proved
    assert words in found.reason


def test_the_bits_of_a_proof_are_asked_for_in_plain_numbers_and_reported_as_tried() -> None:
    good = stability_certificate(-np.eye(2))
    for precision in (0, -1, 2.5, None):
        with pytest.raises(ArgumentError, match="precision"):
            good.verify(precision)  # type: ignore[arg-type]
    assert good.verify().precision == 53
    assert good.verify(100).precision == 100
    singular = dataclasses.replace(good, coordinates=np.zeros((2, 2))).verify(16)
    assert not singular.proved
    assert singular.precision == 128


def test_a_statement_never_says_more_than_is_proved() -> None:
    loop = closed(StateArrays(-np.eye(1), np.eye(1), np.zeros((1, 1)), np.zeros((1, 1)), 0.0))
    norm = Certificate(claim="norm", bound=1.0 + 1e-12, loops=(loop,), X=np.eye(1))
    assert float(norm.statement.rpartition(" ")[2]) >= norm.bound
    decay = Certificate(claim="stability", bound=0.9999999999, loops=(loop,), X=np.eye(1))
    assert float(decay.statement.split("decays at ")[1].split()[0]) <= decay.bound


def test_matrices_beyond_floating_point_are_refused_without_a_warning() -> None:
    B, C, D = np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1))
    huge = [[-1e308, 0.0], [0.0, -1e308]]
    for A in ([[-1e-300, 1e6], [0.0, -1e9]], [[-1e-300, 0.0], [0.0, -1e300]], huge):
        with pytest.raises(NotCertifiedError):
            stability_certificate(A, 1e-3)
        with pytest.raises(NotCertifiedError):
            norm_certificate(A, B, C, D)
    for A in ([[-1e-300, 1e6], [0.0, -1e9]], [[-1e-300, 0.0], [0.0, -1e300]]):
        with pytest.raises(NotCertifiedError):
            h2_certificate(A, B, C)
    # Scaled without overflow this one is within reach: its H2 norm is 2/sqrt(2e308).
    assert 1.5e-154 < h2_certificate(huge, B, C).bound < 1e-99
    assert stability_certificate(np.array([[-1e-12, 1e6], [0.0, -1e9]])).verify().proved


def test_a_loop_that_is_not_well_posed_is_not_proved() -> None:
    P = StateArrays(-np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), 0.0)
    K = StateArrays(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)), 0.0)
    found = Certificate(claim="stability", bound=0.0, loops=(closed(P, K),), X=np.eye(1)).verify()
    assert not found.proved
    assert "not well posed" in found.reason
    with pytest.raises(NotCertifiedError, match="singular"):
        stability_certificate(P.A, 0.0, B=P.B, C=P.C, D=P.D, controller=K)


def test_a_direct_term_has_no_h2_norm() -> None:
    with pytest.raises(NotCertifiedError, match=r"the H2 norm .* is infinite"):
        h2_certificate([[-1.0]], [[1.0]], [[1.0]], [[1e-300]])
    good = h2_certificate([[-1.0]], [[1.0]], [[1.0]])
    direct = closed(StateArrays(-np.eye(1), np.eye(1), np.eye(1), np.array([[1e-300]]), 0.0))
    assert "direct term" in dataclasses.replace(good, loops=(direct,)).verify().reason


def test_what_transfers_nothing_has_a_norm_as_small_as_one_likes() -> None:
    assert norm_certificate([[-1.0]], [[0.0]], [[1.0]], [[0.0]]).bound < 1e-90
    assert norm_certificate([[-1.0]], [[1.0]], [[0.0]], [[0.0]], 0.0, gamma=1e-6).verify().proved


def test_matrices_that_do_not_fit_are_refused_in_one_line() -> None:
    for call in (
        lambda: stability_certificate([[1.0, 2.0]]),
        lambda: stability_certificate("no matrix"),
        lambda: norm_certificate(-np.eye(2), np.ones((3, 1)), np.ones((1, 2)), [[0.0]]),
        lambda: norm_certificate(np.full((2, 2), np.nan), np.ones((2, 1)), np.ones((1, 2)), [[0.0]]),
        lambda: closed(system_of(-np.eye(2)), StateArrays(*(np.ones((1, 1)) for _ in range(4)), dt=0.0)),
    ):
        with pytest.raises(ArgumentError) as caught:
            call()
        assert len(str(caught.value).splitlines()) == 1


def symmetric(seed: int, n: int, spread: float, smallest: float) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    units = 10.0 ** rng.uniform(-spread, spread, n)
    M = (Q * np.append(np.linspace(1.0, 2.0, n - 1), smallest)) @ Q.T * units * units[:, None]
    return 0.5 * (M + M.T)


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(2, 12),
    spread=st.floats(0, 100),
    smallest=st.sampled_from([-1e-3, -1e-9, -1e-13, 1e-13, 1e-9, 1e-3, 1.0]),
)
def test_definiteness_is_that_of_exact_rational_arithmetic(seed: int, n: int, spread: float, smallest: float) -> None:
    M = symmetric(seed, n, spread, smallest)
    rows = [[Fraction(x) for x in row] for row in M.tolist()]
    exact = True
    for k in range(n):
        if rows[k][k] <= 0:
            exact = False
            break
        for i in range(k + 1, n):
            share = rows[i][k] / rows[k][k]
            rows[i] = [a - share * b for a, b in zip(rows[i], rows[k], strict=True)]
    with flint.ctx.workprec(256):
        definite, margin = positive_definite(balls(M))
    assert definite is exact
    # Doubles decide in one direction alone, and where there is room for their rounding.
    in_doubles, bound = positive_definite(rounded(M))
    assert in_doubles is None or exact
    assert in_doubles is not None or not (exact and smallest >= 1e-9)
    if exact:
        d = np.sqrt(np.diag(M))
        for low in [margin] if in_doubles is None else [margin, bound]:
            assert 0 < low <= np.linalg.eigvalsh(M / d / d[:, None])[0] + 1e-14
    else:
        assert margin == 0.0


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10**6), spread=st.floats(0, 300), kind=st.sampled_from(["stability", "norm", "h2"]))
def test_what_is_rounded_lies_within_its_bound(seed: int, spread: float, kind: Any) -> None:
    """The matrices of a claim, in doubles and with 2000 bits, also where products underflow."""
    rng = np.random.default_rng(seed)

    def matrix(*shape: int) -> np.ndarray[Any, Any]:
        return rng.standard_normal(shape) * 10.0 ** rng.uniform(-spread, 0, shape) * rng.integers(0, 2, shape)

    P, K = (StateArrays(matrix(3, 3), matrix(3, 2), matrix(2, 3), matrix(2, 2), 0.01 * (seed % 2)) for _ in range(2))
    P.D[1:, 1:] = 0.0
    K = StateArrays(K.A, K.B[:, :1], K.C[:1], K.D[:1, :1], K.dt)
    loop, X = closed(P, K), matrix(6, 6)
    X += X.T
    found = inequality(kind, enclosed_by(rounded, loop), rounded(X), 1.7, P.dt, rounded)
    with flint.ctx.workprec(2000):
        exact = inequality(kind, loop.enclosed(), balls(X), 1.7, P.dt)
        for i, j in np.ndindex(found.middle.shape):
            assert abs(exact[i, j] - flint.arb(found.middle[i, j])) <= flint.arb(found.radius[i, j])
            assert found.radius[i, j] <= 1e-12


def test_balls_too_wide_to_tell_are_undecided() -> None:
    with flint.ctx.workprec(64):
        assert positive_definite(flint.arb_mat([[flint.arb(1, 2)]]))[0] is None
        third = flint.arb(1) / 3
        assert positive_definite(flint.arb_mat([[third, third], [third, third]]))[0] is None
    singular = Certificate(claim="stability", bound=0.0, loops=(closed(system_of([[0.0]])),), X=np.eye(1)).verify()
    assert not singular.proved


def sector(damping: float) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    sine = math.sqrt(1 - damping**2)
    return np.zeros((2, 2)), np.array([[sine, damping], [-damping, sine]])


@settings(deadline=None, max_examples=40)
@given(**systems)
def test_a_damping_is_proved_as_a_sector_of_the_poles(seed: int, order: int, decay: float, dt: float) -> None:
    A = random_system(seed, order, decay, dt)[0]
    z = np.linalg.eigvals(A)
    s = (2 / dt) * (z - 1) / (z + 1) if dt > 0 else z
    damping = float((-s.real / np.abs(s)).min())
    assert region_certificate(A, *sector(0.99 * damping), dt).verify().proved
    if damping < 0.99:
        with pytest.raises(NotCertifiedError, match="every pole lies in the region"):
            region_certificate(A, *sector(damping + 0.005), dt)


def test_a_region_of_vertices_is_that_of_what_lies_between_and_a_disc_holds_the_fastest_pole() -> None:
    loops = tuple(closed(system_of([[0.0, 1.0], [-k, -2.0]])) for k in (2.0, 2.2))
    X = np.array([[3.1, 1.0], [1.0, 1.0]])
    L, M = sector(0.5)
    common = Certificate(claim="region", bound=0.0, loops=loops, X=X, L=L, M=M)
    assert common.verify().proved
    assert not dataclasses.replace(common, L=L + 2.0 * np.eye(2)).verify().proved
    disc = np.array([[0.0, 1.0], [0.0, 0.0]])
    A = np.diag([-1.0, -7.0])
    assert region_certificate(A, -7.1 * np.eye(2), disc).verify().proved
    with pytest.raises(NotCertifiedError):
        region_certificate(A, -6.9 * np.eye(2), disc)
    for senseless in ({"L": None}, {"L": np.eye(3)}, {"M": np.full((2, 2), np.nan)}, {"L": np.eye(2, k=1)}):
        found = dataclasses.replace(common, **senseless).verify()
        assert not found.proved
        assert "L and M" in found.reason
    with pytest.raises(ArgumentError, match="L must be real numbers, got 'x'"):
        region_certificate(A, "x", disc)


def test_a_sampled_region_between_vertices_is_claimed_only_where_it_follows() -> None:
    """|w| < 5 holds for z = -3 and z = 0 with w = 2 (z - 1)/(z + 1), and fails at z = -1 between them."""
    disc = {"L": -5.0 * np.eye(2), "M": np.array([[0.0, 1.0], [0.0, 0.0]])}
    loops = tuple(
        closed(StateArrays(np.array([[z]]), np.zeros((1, 0)), np.zeros((0, 1)), np.zeros((0, 0)), 1.0))
        for z in (-3.0, 0.0)
    )
    both = Certificate(claim="region", bound=0.0, loops=loops, X=np.eye(1), **disc)
    assert all(dataclasses.replace(both, loops=(loop,)).verify().proved for loop in loops)
    found = both.verify()
    assert not found.proved
    assert "between vertices" in found.reason
    near = tuple(
        closed(StateArrays(np.array([[z]]), np.zeros((1, 0)), np.zeros((0, 1)), np.zeros((0, 0)), 1.0))
        for z in (-0.2, 0.7)
    )
    L, M = sector(0.5)
    assert Certificate(claim="region", bound=0.0, loops=near, X=np.eye(1), L=L, M=M).verify().proved


def test_a_certificate_holds_in_another_process() -> None:
    import pickle
    import subprocess
    import sys

    good = norm_certificate(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    program = "import pickle, sys; print(pickle.load(sys.stdin.buffer).verify().proved)"
    shown = [
        subprocess.run([sys.executable, "-c", program], input=pickle.dumps(one), capture_output=True, check=True).stdout
        for one in (good, dataclasses.replace(good, bound=0.99))
    ]
    assert [line.strip() for line in shown] == [b"True", b"False"]
