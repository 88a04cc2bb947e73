"""Random loops that are stable when closed, for the tests of margins."""

from __future__ import annotations

import control
import numpy as np


def stable_loop(seed: int, m: int, n: int, dt: float = 0.0) -> control.StateSpace:
    """Return a random strictly proper L whose closed loop is stable: the closed loop is drawn, then opened."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A = 0.9 * A / np.abs(np.linalg.eigvals(A)).max() if dt else A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n)
    B, C = rng.normal(size=(n, m)), rng.normal(size=(m, n))
    return control.ss(A + B @ C, B, C, 0, dt)
