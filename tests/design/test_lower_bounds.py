"""What no controller can undercut: closed forms, published problems, and every controller that any route finds."""

from __future__ import annotations

import contextlib
import itertools
import json
from pathlib import Path

import control
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

from design.test_hinf import SHAPED, coprime_least, coprime_problem, random_plant
from platform_ctrl import design
from platform_ctrl.analysis.arrays import state_arrays
from platform_ctrl.analysis.norms import h2_norm, hinf_norm
from platform_ctrl.design.lower_bounds import h2_lower_bound, hinf_lower_bound
from platform_ctrl.design.partition import Partition, closed_loop, closed_loop_system, partition
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job.requirements import requirement

DATA = Path(__file__).parents[1] / "data"
PROBLEMS = {
    name: problem
    for file in ("compleib.json", "compleib-hard.json")
    for name, problem in json.loads((DATA / file).read_text(encoding="utf-8"))["problems"].items()
}
# Published with the problems: by Riccati bisection and by an LQ equation where every state is measured without noise.
KNOWN_HINF = {"AC16": 14.855616, "DIS4": 0.731455}
KNOWN_H2 = {"AC16": 12.298253, "DIS4": 1.692419, "DIS1": 2.660038}


def plant_of(name):
    p = {key: np.array(value, float) for key, value in PROBLEMS[name].items() if isinstance(value, list)}
    (ny, _), nu = p["C"].shape, p["B"].shape[1]
    D = np.block([[p["D11"], p["D12"]], [p["D21"], np.zeros((ny, nu))]])
    inputs, outputs = np.hstack([p["B1"], p["B"]]), np.vstack([p["C1"], p["C"]])
    return control.ss(p["A"], inputs, outputs, D, remove_useless_states=False), ny, nu


@pytest.mark.parametrize(("name", "infimum"), KNOWN_HINF.items())
def test_the_h_infinity_bound_of_singular_problems_is_the_published_infimum(name, infimum):
    P, ny, nu = plant_of(name)
    assert design.hinf(P, ny, nu).gamma_optimal == pytest.approx(infimum, rel=1e-6)
    assert hinf_lower_bound(partition(P, ny, nu)) == pytest.approx(infimum, rel=1e-6)


@pytest.mark.parametrize(("name", "infimum"), KNOWN_H2.items())
def test_the_h2_bound_of_singular_problems_is_the_published_infimum(name, infimum):
    P, ny, nu = plant_of(name)
    assert h2_lower_bound(partition(P, ny, nu)) == pytest.approx(infimum, rel=1e-6)


@pytest.mark.parametrize("name", PROBLEMS)
def test_no_published_controller_undercuts_the_bound(name):
    P, ny, nu = plant_of(name)
    bound = hinf_lower_bound(partition(P, ny, nu))
    # Six digits are published.
    assert 0.0 <= bound <= PROBLEMS[name]["best"] * (1 + 5e-6)
    if name not in ("AC12", "IH"):
        assert bound > 0.0


@pytest.mark.parametrize("name", SHAPED)
def test_gyros_in_si_units_have_the_closed_form_of_the_coprime_factor_problem(name):
    P, ny, nu = coprime_problem(*SHAPED[name])
    least = coprime_least(*SHAPED[name])
    assert least * (1 - 1e-9) <= hinf_lower_bound(partition(P, ny, nu)) <= least


def test_measured_states_without_noise_have_the_norms_of_state_feedback():
    """H2: tr(B1' X B1) of the LQ equation; the bound needs no rank of D21."""
    rng = np.random.default_rng(3)
    A, B1, B2, C1 = (rng.normal(size=size) for size in ((4, 4), (4, 2), (4, 1), (3, 4)))
    D12 = np.array([[0.0], [0.0], [1.0]])
    D = np.block([[np.zeros((3, 2)), D12], [np.zeros((4, 3))]])
    P = control.ss(A, np.hstack([B1, B2]), np.vstack([C1, np.eye(4)]), D)
    X = solve_continuous_are(A, B2, C1.T @ C1, np.eye(1), s=C1.T @ D12)
    assert h2_lower_bound(partition(P, 4, 1)) == pytest.approx(np.sqrt(np.trace(B1.T @ X @ B1)), rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(powers=st.lists(st.floats(-5, 5), min_size=4, max_size=4), a=st.floats(-3, 3))
def test_a_single_state_has_the_h2_norm_of_its_two_quadratic_equations_however_cheap_the_control(powers, a):
    """z = [c x; r u], y = x + n v: norm² = w² X + r² F² Y, in fifty digits."""
    w, c, r, n = (mpmath.mpf(10.0**power) for power in powers)
    with mpmath.workdps(50):
        pole = mpmath.mpf(a)
        X = r**2 * (pole + mpmath.sqrt(pole**2 + c**2 / r**2))
        Y = n**2 * (pole + mpmath.sqrt(pole**2 + w**2 / n**2))
        least = mpmath.sqrt(w**2 * X + (X / r) ** 2 * Y)
    P = control.StateSpace(
        a, [[float(w), 0, 1]], [[float(c)], [0], [1]], [[0, 0, 0], [0, 0, float(r)], [0, float(n), 0]]
    )  # fmt: skip
    bound = h2_lower_bound(partition(P, 1, 1))
    assert bound <= float(least)
    assert bound == 0.0 or bound >= float(least) * (1 - 1e-9)


def test_a_zero_in_the_right_half_plane_bounds_the_weighted_sensitivity():
    """Interpolation: S = 1 at a zero of the plant, so |W S| >= |W(zero)| whatever the controller; D12 is 0."""
    W, G = control.tf([0.5, 1.0], [1.0, 0.01]), control.tf([1.0, -2.0], [1.0, 3.0, 5.0])
    e, y = control.ss(W), control.ss(G)
    # z = W (w - G u), y = w - G u
    A = np.block([[y.A, np.zeros((2, 1))], [-e.B @ y.C, e.A]])
    B = np.block([[np.zeros((2, 1)), y.B], [e.B, np.zeros((1, 1))]])
    C = np.block([[-e.D @ y.C, e.C], [-y.C, np.zeros((1, 1))]])
    P = control.ss(A, B, C, [[e.D[0, 0], 0.0], [1.0, 0.0]])
    assert hinf_lower_bound(partition(P, 1, 1)) == pytest.approx(abs(W(2.0)), rel=1e-9)


def test_a_zero_on_the_axis_fixes_the_gain_at_its_frequency():
    """z = w1 + G u with G(±2j) = 0: at 2 rad/s no control changes what w does to z."""
    G = control.ss(control.tf([1.0, 0.0, 4.0], [1.0, 2.0, 5.0, 1.0]))
    D = [[0.7, 0.0, 0.0], [0.0, 1.0, 0.0]]
    P = control.ss(G.A, np.hstack([np.zeros((3, 2)), G.B]), np.vstack([G.C, G.C]), D)
    assert hinf_lower_bound(partition(P, 1, 1)) == pytest.approx(0.7, rel=1e-9)


def test_a_direct_path_that_no_controller_sees_stays():
    """At infinite frequency a proper controller leaves D11 + D12 D_K D21."""
    P = control.ss(-1.0, [[1.0, 0.0, 1.0]], [[1.0], [1.0]], [[0.3, 0.4, 0.0], [0.0, 0.0, 0.0]])
    assert hinf_lower_bound(partition(P, 1, 1)) >= 0.5 * (1 - 1e-10)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(2, 7), lost=st.sets(st.sampled_from(["D12", "D21"])))
def test_bounds_do_not_depend_on_the_units(seed, n, lost):
    rng = np.random.default_rng(seed)
    P = random_plant(seed, n)
    D = P.D.copy()
    for name in lost:
        D[(slice(4), slice(4, 6)) if name == "D12" else (slice(4, 6), slice(4))] = 0
    d, rate = 10.0 ** rng.uniform(-4, 4, n), 10.0 ** rng.uniform(-3, 4)
    u, y = (10.0 ** np.r_[np.zeros(4), rng.uniform(-5, 5, 2)] for _ in range(2))
    for lower, unit, kept in ((hinf_lower_bound, 1.0, 1.0), (h2_lower_bound, np.sqrt(rate), 0.0)):
        D[:4, :4] *= kept
        here = partition(control.StateSpace(P.A, P.B, P.C, D, remove_useless_states=False), 2, 2)
        other = (rate * P.A / d[:, None] * d, rate * P.B / d[:, None] * u, y[:, None] * P.C * d, y[:, None] * D * u)
        there = partition(control.StateSpace(*other, remove_useless_states=False), 2, 2)
        assert lower(there) == pytest.approx(unit * lower(here), rel=1e-9)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), ports=st.tuples(*[st.integers(1, 4)] * 5), dt=st.sampled_from([0.0, 0.1]))
def test_whatever_the_plant_the_bound_is_a_number(seed, ports, dt):
    """Zero, rounded, huge and tiny matrices: at worst nothing is shown."""
    rng = np.random.default_rng(seed)
    n, nw, nz, nu, ny = ports

    def matrix(rows, columns):
        M = rng.normal(size=(rows, columns)) * 10.0 ** rng.choice([0, 0, 0, -8, 8, -100, 100])
        return [0.0 * M, np.round(M), M][rng.integers(3)]

    plant = Partition(
        A=matrix(n, n), B1=matrix(n, nw), B2=matrix(n, nu), C1=matrix(nz, n), C2=matrix(ny, n),
        D11=matrix(nz, nw), D12=matrix(nz, nu), D21=matrix(ny, nw), D22=np.zeros((ny, nu)), dt=dt,
    )  # fmt: skip
    for lower in (h2_lower_bound,) if dt else (hinf_lower_bound, h2_lower_bound):
        assert 0.0 <= lower(plant) < np.inf


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 7),
    ports=st.tuples(*[st.integers(1, 3)] * 2),
    more=st.tuples(*[st.integers(0, 2)] * 2),
    stable=st.booleans(),
)
def test_where_the_assumptions_hold_the_h_infinity_bound_is_the_riccati_infimum(seed, n, ports, more, stable):
    (nu, ny), (z, w) = ports, more
    P = random_plant(seed, n, ny + w, nu + z, ny, nu, stable)
    try:
        made = design.hinf(P, ny, nu, method="riccati", backoff=1e-6)
    except DesignError:
        return
    bound = hinf_lower_bound(partition(P, ny, nu))
    assert bound <= made.gamma * (1 + 1e-12)
    assert bound >= made.level / (1 + made.backoff) * (1 - 1e-6) or made.gamma < 1e-9


def test_an_infimum_of_zero_is_approached_although_the_riccati_equations_end_above_it():
    """All zeros in the left half plane: what w does to z can be made as small as one likes."""
    P = random_plant(454, 5, 1, 1, 1, 1, True)
    for channel in (P[0, 1], P[1, 0]):
        assert channel.zeros().real.max() < 0
    made = design.hinf(P, 1, 1, method="riccati", backoff=1e-6)
    assert hinf_lower_bound(partition(P, 1, 1)) == 0.0
    assert made.gamma < 1e-10 < 1e-4 < made.level


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 6), dt=st.sampled_from([0.0, 0.1]), direct=st.booleans())
def test_where_the_assumptions_hold_the_h2_bound_is_the_norm_of_the_optimal_loop(seed, n, dt, direct):
    plain = random_plant(seed, n, 3, 3, 1, 2)
    D = plain.D.copy()
    D[:3, :3] = 0
    A = plain.A / np.abs(np.linalg.eigvals(plain.A)).max() * 1.2 if dt else plain.A
    P = control.StateSpace(A, plain.B, plain.C, D, dt, remove_useless_states=False)
    try:
        made = design.h2(P, 1, 2, direct=direct)
    except DesignError:
        return
    bound = h2_lower_bound(partition(P, 1, 2, sampled=True), direct)
    assert made.gamma * (1 - 1e-6) <= bound <= made.gamma * (1 + 1e-12)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 5),
    lost=st.sampled_from(["D12", "D21", "both"]),
    gains=st.floats(-1.5, 1.5),
)
def test_no_stabilising_controller_undercuts_the_bounds_of_a_singular_plant(seed, n, lost, gains):
    """Optimal controllers of regular plants near it, with other weights, closed with the plant as it is."""
    regular = random_plant(seed, n, 3, 3, 1, 1)
    D, near = regular.D.copy(), regular.D.copy()
    D[:3, :3] = near[:3, :3] = 0
    scale = 10.0**gains
    if lost in ("D12", "both"):
        D[:3, 3:], near[:3, 3:] = 0, 1e-2 * scale * near[:3, 3:]
    if lost in ("D21", "both"):
        D[3:, :3], near[3:, :3] = 0, 1e-2 / scale * near[3:, :3]
    P = control.StateSpace(regular.A, regular.B, regular.C, D, remove_useless_states=False)
    plant = partition(P, 1, 1)
    bounds = hinf_lower_bound(plant), h2_lower_bound(plant)
    for synthesis in (design.hinf, design.h2):
        try:
            K = synthesis(control.StateSpace(P.A, P.B, P.C, near, remove_useless_states=False), 1, 1)
            loop = closed_loop_system(P, closed_loop(plant, state_arrays(K.controller, "K")))
            norms = hinf_norm(loop)[0], h2_norm(control.ss(loop.A, loop.B, loop.C, 0))
        except PlatformCtrlError:
            continue
        assert bounds[0] <= norms[0] * (1 + 1e-9)
        if not np.any(K.controller.D):
            assert bounds[1] <= norms[1] * (1 + 1e-9)


@pytest.mark.parametrize("name", ["AC16", "DIS4", "DIS1", "NN2"])
@pytest.mark.parametrize("kind", ["H-infinity norm", "H2 norm"])
def test_norms_of_structured_controllers_are_compared_with_the_infimum(name, kind):
    P, ny, nu = plant_of(name)
    asked = [requirement(kind, 1.0, hard=False)]
    found = design.structured(P, ny, nu, structure=design.Static(), requirements=asked, starts=4, evaluations=1000)
    assert found.gamma >= found.gamma_optimal > 0.0
    assert found.price >= 1.0
    known = (KNOWN_HINF if kind == "H-infinity norm" else KNOWN_H2).get(name, found.gamma_optimal)
    assert found.gamma_optimal == pytest.approx(known, rel=1e-6)


def test_an_infimum_of_zero_has_no_bound_above_zero():
    """AC12: z is made as small as one likes; no level above 0 is a bound."""
    P, ny, nu = plant_of("AC12")
    assert hinf_lower_bound(partition(P, ny, nu)) == 0.0
    found = design.structured(P, ny, nu, structure=design.Static(), starts=1, evaluations=30)
    assert found.gamma_optimal == 0.0
    assert found.price == float("inf")
    assert found.bound == "no H-infinity bound above 0 shown"


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_no_design_of_a_published_problem_undercuts_its_bounds(name):
    P, ny, nu = plant_of(name)
    plant = partition(P, ny, nu)
    for method, backoff in itertools.product(("riccati", "lmi"), (1e-3, 0.1)):
        if method == "lmi" and P.nstates > 10:
            continue
        try:
            found = design.hinf(P, ny, nu, method=method, backoff=backoff)
        except DesignError:
            continue
        assert hinf_lower_bound(plant) <= found.gamma
        # The least level of the matrix inequalities is within half a per cent.
        assert found.gamma_optimal == pytest.approx(found.level / (1 + found.backoff), rel=6e-3) or name in (
            "AC12",
            "IH",
        )
    with contextlib.suppress(DesignError):
        assert h2_lower_bound(plant) <= design.h2(P, ny, nu).gamma
    static = design.structured(P, ny, nu, structure=design.Static(), starts=2, evaluations=300)
    assert static.gamma >= static.gamma_optimal
