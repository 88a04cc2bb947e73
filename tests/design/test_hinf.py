"""H-infinity output feedback: closed forms, slycot, one route against the other, and what must be refused."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import matrix_balance, solve_continuous_are

from platform_ctrl.analysis import hinf_norm
from platform_ctrl.design import hinf
from platform_ctrl.errors import (
    DesignError,
    IllPosedError,
    NotStabilisableError,
    TimeLimitError,
)

METHODS = ("lmi", "riccati")
# The least gamma of the LMI route is as good as its solver, that of the Riccati route as its bisection.
ACCURACY = {"lmi": 1e-4, "riccati": 1e-6}
# z = (x, u) and y = x + noise, of one control and one measurement.
NOISY = [[0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]


def gyro(inertias=(5e-4, 2e-4), lag=2e-4, L=0.15):
    """A, B, C of housings in a gimbal behind torquer lags: torques to angles, states [q, p, torque], SI units."""
    n = len(inertias)
    G, Mi = np.zeros((n, n)), np.diag(1 / np.array(inertias))
    G[0, 1:], G[1:, 0] = L, -L
    Z, one = np.zeros((n, n)), np.eye(n)
    A = np.block([[Z, Mi, Z], [Z, -G @ Mi, one], [Z, Z, -one / lag]])
    return A, np.vstack([Z, Z, one / lag]), np.hstack([one, Z, Z])


def with_integrators(A, B, C, gain, frequency):
    """A plant behind gain * (s + frequency) / s in every input."""
    m = B.shape[1]
    Z = np.zeros((m, len(A)))
    return (
        np.block([[A, gain * frequency * B], [Z, np.zeros((m, m))]]),
        np.vstack([gain * B, np.eye(m)]),
        np.hstack([C, np.zeros((len(C), m))]),
    )


def coprime_problem(A, B, C):
    """[K; I] (I − G K)⁻¹ [I, G] as a plant: w = [noise, input disturbance], z = [u, y]."""
    (n, m), p = B.shape, len(C)
    D = np.zeros((m + 2 * p, p + 2 * m))
    D[:m, p + m :] = np.eye(m)
    D[m : m + p, :p] = D[m + p :, :p] = np.eye(p)
    return control.ss(A, np.hstack([np.zeros((n, p)), B, B]), np.vstack([np.zeros((m, n)), C, C]), D), p, m


def coprime_least(A, B, C):
    """sqrt(1 + lambda_max(X Z)) from the two LQG Riccati equations (McFarlane and Glover 1990)."""
    rate = np.linalg.norm(A, 2) ** 0.5
    d = matrix_balance(A / rate, permute=False, separate=True)[1][0]
    A, B, C = A / rate / d[:, None] * d, B / rate / d[:, None], C * d
    X = solve_continuous_are(A, B, C.T @ C, np.eye(B.shape[1]))
    Z = solve_continuous_are(A.T, C.T, B @ B.T, np.eye(len(C)))
    return np.sqrt(1 + np.max(np.linalg.eigvals(X @ Z).real))


def random_plant(seed, n=6, nw=4, nz=4, ny=2, nu=2, stable=False):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + (0.3 if stable else -0.3)) * np.eye(n)
    D = 0.5 * rng.normal(size=(nz + ny, nw + nu))
    D[nz:, nw:] = 0
    return control.ss(A, rng.normal(size=(n, nw + nu)), rng.normal(size=(nz + ny, n)), D)


def without(P, controls=(), measurements=()):
    """A plant whose D12 and D21 are zero in some columns and rows."""
    D = P.D.copy()
    D[:4, controls] = 0
    D[measurements, :4] = 0
    return control.ss(P.A, P.B, P.C, D, inputs=P.input_labels, outputs=P.output_labels)


def hidden_integrator():
    """z does not see the integrator."""
    return control.ss([[0.0, 1], [0, -1]], [[1.0, 0, 0], [0, 0, 1]], [[0, 1.0], [0, 0], [1, 0]], NOISY)


# With three gimbals the pole at zero is defective.
SHAPED = {"gyro": gyro(), "behind integrators": with_integrators(*gyro((1e-3, 2e-4, 2e-4)), 30.0, 50.0)}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SHAPED)
def test_gyros_in_si_units_reach_the_closed_form_of_the_coprime_factor_problem(name, method):
    P, nmeas, ncon = coprime_problem(*SHAPED[name])
    result = hinf(P, nmeas, ncon, method=method)
    least = coprime_least(*SHAPED[name])
    assert result.gamma_optimal == pytest.approx(least, rel=ACCURACY[method])
    # No controller does better than the least gamma, and this one keeps what was promised.
    assert least * (1 - 1e-6) <= result.gamma <= 1.021 * least
    assert result.gamma == pytest.approx(hinf_norm(result.closed_loop)[0], rel=1e-9)
    assert result.spectral_abscissa < 0
    assert result.controller.nstates == P.nstates
    if name == "gyro":
        # With X and Y small where the separation does not look, the LMI route had poles at 1e5 rad/s here.
        assert np.abs(result.controller.poles()).max() < 2 * 5000


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("denominator", "least"),
    [([1, 0], np.sqrt(2)), ([1, 0, 0], np.sqrt(4 + 2 * np.sqrt(2))), ([1, -1], np.sqrt(4 + 2 * np.sqrt(2)))],
)
def test_integrators_and_an_unstable_pole_have_their_textbook_gamma(denominator, least, method):
    G = control.tf2ss([1], denominator)
    result = hinf(*coprime_problem(G.A, G.B, G.C), method=method)
    assert result.gamma_optimal == pytest.approx(least, rel=ACCURACY[method])


def test_the_default_is_the_riccati_route_where_its_assumptions_hold_and_the_result_says_why():
    P = random_plant(7, n=4)
    default, asked = hinf(P, 2, 2), hinf(P, 2, 2, method="riccati")
    assert (default.method, default.reason) == ("hinf, riccati", "the assumptions of the Riccati equations hold")
    assert (default.gamma, default.gamma_optimal, asked.reason) == (asked.gamma, asked.gamma_optimal, "")
    for plant, ports, why in (
        (without(P, [4, 5]), 2, r"hinf, riccati: D12 must have full column rank 2, but has 0"),
        (hidden_integrator(), 1, r"[A − jωI, B2; C1, D12] loses column rank at 0 rad/s"),
    ):
        found = hinf(plant, ports, ports)
        assert found.method == "hinf, lmi"
        assert why in found.reason
        with pytest.raises(IllPosedError, match='method="lmi"') as refused:
            hinf(plant, ports, ports, method="riccati")
        assert why in str(refused.value)
        assert refused.value.problem is plant
    with pytest.raises(TimeLimitError, match=r"did not finish .*the other route fails, too: .*D12 must have"):
        hinf(without(P, [4, 5]), 2, 2, time_limit=1e-6)


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 50),
    exponents=st.lists(st.floats(-4, 4), min_size=6, max_size=6),
    rate=st.floats(-3, 4),
    ports=st.lists(st.floats(-5, 5), min_size=4, max_size=4),
    unit=st.floats(-9, 9),
)
def test_least_gamma_does_not_depend_on_the_units_but_for_that_of_z(seed, exponents, rate, ports, unit):
    P = random_plant(seed, stable=True)
    d, r, z = 10.0 ** np.array(exponents), 10.0**rate, 10.0**unit
    u, y = 10.0 ** np.array([0, 0, 0, 0, *ports[:2]]), 10.0 ** np.array([*[unit] * 4, *ports[2:]])
    other = control.ss(r * P.A / d[:, None] * d, r * P.B / d[:, None] * u, y[:, None] * P.C * d, y[:, None] * P.D * u)
    here, there = (hinf(p, 2, 2, method="riccati") for p in (P, other))
    assert there.gamma_optimal == pytest.approx(z * here.gamma_optimal, rel=1e-6)
    assert there.gamma == pytest.approx(z * here.gamma, rel=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_direct_feedthrough_from_u_to_y_costs_nothing(method):
    P = random_plant(5)
    D = P.D.copy()
    D[4:, 4:] = [[0.3, -0.2], [0.1, 0.4]]
    shifted = hinf(control.ss(P.A, P.B, P.C, D), 2, 2, method=method)
    plain = hinf(P, 2, 2, method=method)
    assert shifted.gamma == pytest.approx(plain.gamma, rel=1e-5)
    assert shifted.gamma_optimal == pytest.approx(plain.gamma_optimal, rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("B2", "C2", "word", "pole"),
    [
        ([[1.0], [0.0], [0.0]], [[1.0, 1.0, 1.0]], "stabilisable", r"0\+20j|-?0-20j"),
        ([[1.0], [1.0], [1.0]], [[1.0, 0.0, 0.0]], "detectable", r"20j"),
    ],
)
def test_a_mode_out_of_reach_is_named(B2, C2, word, pole, method):
    A = np.array([[-5.0, 0, 0], [0, 0, 20], [0, -20, 0]])
    B = np.hstack([np.eye(3)[:, :2], np.zeros((3, 1)), B2])
    C = np.vstack([np.eye(3)[:2], np.zeros((1, 3)), C2])
    D = np.zeros((4, 4))
    D[2, 3] = D[3, 2] = 1
    with pytest.raises(DesignError, match=rf"not {word}: .* the mode at .*({pole}) rad/s"):
        hinf(control.ss(A, B, C, D), 1, 1, method=method)


def test_a_sampled_pole_at_minus_one_is_named():
    for seen, error, match in (
        (0.0, NotStabilisableError, r"no control u moves the mode at z = -1\+0j"),
        (1.0, IllPosedError, "pole at z = -1"),
    ):
        A, B, C = np.diag([0.5, -1.0]), [[1, 0, 1], [1, 0, seen]], [[1, 1], [0, 0], [1, 1]]
        P = control.StateSpace(A, B, C, NOISY, 0.1, remove_useless_states=False)
        with pytest.raises(error, match=match) as caught:
            hinf(P, 1, 1)
        assert caught.value.problem is P


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [1, 4])
def test_sampled_plants_have_the_norm_of_their_w_plane(seed, method):
    plain = random_plant(seed, n=4)
    D = plain.D.copy()
    D[4:, 4:] = 0.2
    P = control.sample_system(control.ss(plain.A, plain.B, plain.C, D), 0.05, "bilinear")
    result = hinf(P, 2, 2, method=method)
    flat = hinf(control.ss(plain.A, plain.B, plain.C, D), 2, 2, method=method)
    assert result.controller.dt == 0.05
    assert result.gamma_optimal == pytest.approx(flat.gamma_optimal, rel=ACCURACY[method])
    # Recomputed along the unit circle from plant and controller alone.
    z = np.exp(1j * np.linspace(0, np.pi, 400))
    peaks = []
    for one in z:
        p, k = P(one), result.controller(one)
        loop = p[:4, :4] + p[:4, 4:] @ k @ np.linalg.solve(np.eye(2) - p[4:, 4:] @ k, p[4:, :4])
        peaks.append(np.linalg.norm(loop, 2))
    assert 0.98 * result.gamma < max(peaks) <= result.gamma * (1 + 1e-6)
    assert np.abs(result.poles).max() < 1
    assert result.spectral_abscissa < 0


def test_where_the_central_controller_is_not_well_posed_matrix_inequalities_find_another():
    # T = P/(1 − P K) has the norm 1 at least: T = 1/z. The central controller of the w-plane makes T vanish at z = −1.
    P = control.ss(0.5, [[1, 1]], [[1], [1]], 0, 0.1)
    result = hinf(P, 1, 1)
    assert "not well posed" in result.reason
    assert result.gamma_optimal == pytest.approx(1, rel=1e-6)
    assert 1 <= result.gamma <= 1.021


@pytest.mark.parametrize("k", [0.1, 0.01])
def test_a_double_integrator_under_force_alone_reaches_the_weight_on_its_control(k):
    # z = (x, k u), y = x, D21 = 0: u = −w in the limit. k only scales time.
    D = [[0, 0], [0, 0], [0, k], [0, 0]]
    P = control.ss([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0], [0, 1], [0, 0], [1, 0]], D)
    assert k <= hinf(P, 1, 1).gamma <= 1.03 * k


@pytest.mark.parametrize("pole", [1e6, 5e6])
def test_a_fast_pole_of_the_weight_on_the_control_changes_nothing(pole):
    """x' = A x + B (w + u), noisy angle, and u through 0.1 (s + 10)/(s/pole + 1)."""

    def plant(pole):
        A = [[0, 1, 0], [-1, -0.2, 0], [0, 0, -pole]]
        B = [[0, 0, 0], [1, 0, 1], [0, 0, 1]]
        C = [[1, 0, 0], [0, 0, 0.1 * pole * (10 - pole)], [1, 0, 0]]
        return control.ss(A, B, C, [[0, 0, 0], [0, 0, 0.1 * pole], [0, 0.1, 0]])

    found, near = (hinf(plant(one), 1, 1) for one in (pole, 1e4))
    assert found.method == "hinf, riccati"
    assert found.gamma_optimal == pytest.approx(near.gamma_optimal, rel=1e-2)
