"""Time responses against matrix exponentials in many digits."""

from __future__ import annotations

import control
import flint
import numpy as np
import pytest

from platform_ctrl import PlatformCtrlError, analysis
from platform_ctrl.analysis.time_responses import Hold


def exact(system: control.StateSpace, t: np.ndarray, u: np.ndarray, hold: Hold, x0: np.ndarray) -> np.ndarray:
    """Return the outputs from exp of [A B 0; 0 0 I; 0 0 0] h, interval by interval, in 300 bits."""
    n, m = system.B.shape
    whole = np.zeros((n + 2 * m, n + 2 * m))
    whole[:n, :n], whole[:n, n : n + m], whole[n : n + m, n + m :] = system.A, system.B, np.eye(m)
    out = np.empty((system.noutputs, len(t)))
    with flint.ctx.workprec(300):
        A = matrix(whole)
        C, D = matrix(system.C), matrix(system.D)
        x = matrix(x0[:, None])
        exponentials: dict[float, flint.arb_mat] = {}
        for k in range(len(t)):
            now = matrix(u[:, [k]])
            y = C * x + D * now
            out[:, k] = [float(y[i, 0]) for i in range(system.noutputs)]
            if k + 1 == len(t):
                break
            h = flint.arb(float(t[k + 1])) - flint.arb(float(t[k]))
            key = float(t[k + 1] - t[k])
            if key not in exponentials:
                exponentials[key] = (A * h).exp()
            rise = (matrix(u[:, [k + 1]]) - now) / h if hold == "foh" else now * 0
            stacked = flint.arb_mat([[item[i, 0]] for item in (x, now, rise) for i in range(item.nrows())])
            after = exponentials[key] * stacked
            x = flint.arb_mat([[after[i, 0]] for i in range(n)])
    return out


def matrix(values: np.ndarray) -> flint.arb_mat:
    return flint.arb_mat([[flint.arb(float(x)) for x in row] for row in values])


def random_system(n: int, m: int, p: int, seed: int) -> control.StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.05) * np.eye(n)
    D = rng.normal(size=(p, m))
    return control.ss(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), D)


def close(system: control.StateSpace, t: np.ndarray, hold: Hold, seed: int, to: float = 1e-12) -> None:
    rng = np.random.default_rng(seed)
    u, x0 = rng.normal(size=(system.ninputs, t.size)), rng.normal(size=system.nstates)
    truth = exact(system, t, u, hold, x0)
    out = analysis.time_response(system, t, u, hold=hold, initial_state=x0, squeeze=False)
    np.testing.assert_allclose(out, truth, rtol=0, atol=to * np.abs(truth).max())


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize(("n", "m", "p", "N"), [(1, 1, 1, 2), (3, 1, 2, 7), (6, 4, 1, 65), (12, 2, 3, 130)])
def test_equal_steps(hold: Hold, n: int, m: int, p: int, N: int) -> None:
    # Steps of 1/16 s are exact in binary: what is compared is the same problem.
    close(random_system(n, m, p, N), 0.5 + np.arange(N) / 16.0, hold, n)


def test_defective_stiff_and_badly_scaled_systems() -> None:
    rng = np.random.default_rng(0)
    defective = -0.3 * np.eye(5) + np.eye(5, k=1)
    close(control.ss(defective, np.eye(5)[:, 2:], np.eye(5)[:2], 0), np.arange(200) / 8.0, "foh", 1)
    for fastest in (1e2, 1e5, 1e9):
        stiff = np.diag(-np.geomspace(1e-3, fastest, 5)) + np.diag(np.geomspace(1.0, 0.1 * fastest, 4), -1)
        s = 10.0 ** rng.uniform(-5.0, 5.0, 5)
        system = control.ss(stiff * s / s[:, None], np.ones((5, 1)) / s[:, None], np.ones((1, 5)) * s, 0)
        u, t = rng.normal(size=(1, 100)), np.arange(100) / 1024.0
        truth = exact(system, t, u, "foh", np.zeros(5))
        out = analysis.time_response(system, t, u, squeeze=False)
        np.testing.assert_allclose(out, truth, rtol=0, atol=1e-14 * (1.0 + fastest / 1024.0) * np.abs(truth).max())


def test_undamped_oscillation_keeps_its_phase_over_thousands_of_samples() -> None:
    system = control.ss([[0.0, 3.0], [-3.0, 0.0]], [[0.0], [0.0]], np.eye(2), np.zeros((2, 1)))
    t = np.arange(20001) / 128.0
    out = analysis.time_response(system, t, np.zeros(t.size), initial_state=[1.0, 0.0])
    np.testing.assert_allclose(out, [np.cos(3.0 * t), -np.sin(3.0 * t)], rtol=0, atol=2e-11)


def test_what_cannot_be_is_refused() -> None:
    system = control.ss([[-1.0]], [[1.0]], [[1.0]], 0.0)
    with pytest.raises(PlatformCtrlError, match="foh"):
        analysis.time_response(system, [0.0, 1.0], [0.0, 1.0], hold="linear")
    with pytest.raises(PlatformCtrlError, match="equal steps, got steps of 1 to 2 s"):
        analysis.time_response(system, [0.0, 1.0, 3.0], [0.0, 1.0, 1.0])
