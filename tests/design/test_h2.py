"""H2 output feedback: slycot, one route against the other, sampled plants, singular problems, and refusals."""

from __future__ import annotations

import control
import numpy as np
import pytest

from platform_ctrl import analysis
from platform_ctrl.design import h2
from platform_ctrl.errors import IllPosedError


def random_plant(seed, n=6, nw=4, nz=4, ny=2, nu=2, dt=0.0, D11=False):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A = 1.2 * A / np.abs(np.linalg.eigvals(A)).max() if dt else A - (np.linalg.eigvals(A).real.max() - 0.3) * np.eye(n)
    D = 0.5 * rng.normal(size=(nz + ny, nw + nu))
    D[nz:, nw:] = 0
    if not D11:
        D[:nz, :nw] = 0
    return control.ss(A, rng.normal(size=(n, nw + nu)), rng.normal(size=(nz + ny, n)), D, dt)


@pytest.mark.parametrize("seed", range(2))
def test_slycot_agrees(seed):
    pytest.importorskip("slycot")
    P = random_plant(seed)
    K = control.h2syn(P, 2, 2)
    result = h2(P, 2, 2)
    assert result.gamma == pytest.approx(analysis.h2_norm(P.lft(K, 2, 2)), rel=1e-10)
    assert result.gamma_optimal == pytest.approx(result.gamma, rel=1e-10)
    assert result.norm == "h2"


def test_integrator_has_its_textbook_norm():
    # x' = u + w1, y = x + w2, z = [x, u]: X = Y = 1, F = L = -1, norm² = tr(B1' X B1) + F Y F' = 2.
    D = [[0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]
    P = control.ss(0.0, [[1.0, 0, 1]], [[1.0], [0], [1]], D)
    result = h2(P, 1, 1)
    assert result.gamma == pytest.approx(np.sqrt(2), rel=1e-12)
    K = result.controller
    assert (K.A.item(), K.B.item() * K.C.item()) == (pytest.approx(-2), pytest.approx(-1))


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_no_nearby_controller_is_better(dt, direct):
    P = random_plant(6, dt=dt, D11=dt > 0)
    D = P.D.copy()
    D[4:, 4:] = [[0.3, -0.2], [0.1, 0.4]]
    P = control.ss(P.A, P.B, P.C, D, dt)
    result = h2(P, 2, 2, direct=direct)
    rng = np.random.default_rng(0)
    norms = []
    for _ in range(40):
        K = [1e-4 * rng.normal(size=m.shape) + m for m in (getattr(result.controller, name) for name in "ABC")]
        change = 1e-4 * rng.normal(size=(2, 2)) if dt and direct else 0.0
        norms.append(analysis.h2_norm(P.lft(control.ss(*K, result.controller.D + change, dt), 2, 2)))
    assert min(norms) > result.gamma


def test_a_direct_path_is_cancelled_where_a_gain_can_and_named_where_none_can():
    P = random_plant(9)
    D = P.D.copy()
    D[:4, :4] = -D[:4, 4:] @ [[0.3, 0.1], [-0.2, 0.5]] @ D[4:, :4]
    result = h2(control.ss(P.A, P.B, P.C, D), 2, 2)
    np.testing.assert_allclose(result.controller.D, [[0.3, 0.1], [-0.2, 0.5]], rtol=1e-9)
    assert result.gamma == pytest.approx(result.gamma_optimal, rel=1e-8)
    D = P.D.copy()
    D[1, 2] = 0.1
    with pytest.raises(IllPosedError, match=r"no gain .* cancels the direct path D11 from u\[2\] to y\[1\]"):
        h2(control.ss(P.A, P.B, P.C, D), 2, 2)


@pytest.mark.parametrize("missing", ["D12", "D21"])
def test_singular_problems_are_named(missing):
    P = random_plant(10, n=4)
    D = P.D.copy()
    if missing == "D12":
        D[:4, 5] = 0
    else:
        D[5, :4] = 0
    P = control.ss(
        P.A, P.B, P.C, D, inputs=["d1", "d2", "d3", "d4", "Q9", "Q10"], outputs=["e1", "e2", "e3", "e4", "a", "b"]
    )
    name = "Q10" if missing == "D12" else "b"
    with pytest.raises(IllPosedError, match=rf"{missing} must have .* but has 1: .* {name} directly"):
        h2(P, 2, 2)


def test_a_zero_on_the_axis_is_named():
    # z does not see the integrator.
    D = [[0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]
    P = control.ss([[0.0, 1], [0, -1]], [[1.0, 0, 0], [0, 0, 1]], [[0, 1.0], [0, 0], [1, 0]], D)
    with pytest.raises(
        IllPosedError, match=r"\[A − jωI, B2; C1, D12\] loses column rank at 0 rad/s in the states x\[0\]"
    ):
        h2(P, 1, 1)
