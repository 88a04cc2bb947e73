"""Anti-windup by back-calculation: x⁺ = A x + B y + E (limited u − u).

With V the states that integrate (A V = V Λ) and C the outputs' share in them,

    E = V (Λ − (1 − T/Tt) I) (C V)^+,

so that while torques are at their limits these states follow the share that remains of them, with the time constant Tt;
the other poles stay. Tt is the integral time: where the controller's integral action becomes its proportional one.

Åström, Hägglund, Advanced PID Control, 2006, section 3.5.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import schur, solve_sylvester

from platform_ctrl.analysis.system import System, scaled, state_scaling
from platform_ctrl.common.values import FloatArray, value

# A state integrates if it decays by less than this share in a sample.
_DECAY = 1e-3
# Least and largest T/Tt.
_SLOWEST, _FASTEST = 1e-4, 0.1
# Integrals that share outputs to a part smaller than this of the largest cannot be distinguished by them.
_BLIND = 1e-9


@value
class BackCalculation:
    """The anti-windup of a controller."""

    gain: FloatArray  # (states, outputs): E; zero: none
    integrals: int = 0  # States that integrate
    seen: int = 0  # How many of these the limited outputs determine
    time_constant: float = 0.0  # Tt, s
    radius: float = 0.0  # Of the slowest pole with all limited outputs at their limits


def back_calculation(K: System, limited: Sequence[bool]) -> BackCalculation:
    """Return the anti-windup of a sampled controller some of whose outputs are `limited`."""
    limits = np.array(limited, dtype=np.bool_)[:, None]
    none = np.zeros((len(K.A), len(limits)))
    A, B, C = scaled(K.A, K.B, K.C)
    t, Z, k = schur(A, output="real", sort=_integrates) if len(A) else (A, A, 0)
    if not k or not limits.any():
        return BackCalculation(gain=none, integrals=k)
    V, own = state_scaling(K.A, K.B, K.C)[:, None] * Z[:, :k], t[:k, :k]
    # Outputs without limit have no excess. The limits' sizes do not matter: simulated plants may differ in them.
    seen = np.where(limits, K.C @ V, 0.0)
    sizes = np.linalg.norm(seen, axis=0)
    sizes[sizes == 0.0] = 1.0
    share = _integral_share(t, Z.T @ B, C @ Z, K.D, k)
    gain = V @ ((own - (1.0 - share) * np.eye(k)) / sizes) @ np.linalg.pinv(seen / sizes, rcond=_BLIND)
    gain[np.abs(gain) < 1e-12 * np.abs(gain).max(axis=1, keepdims=True, initial=0.0)] = 0.0
    rank = int(np.linalg.matrix_rank(seen / sizes, tol=_BLIND * np.sqrt(k)))
    radius = float(np.abs(np.linalg.eigvals(K.A - gain @ np.where(limits, K.C, 0.0))).max())
    return BackCalculation(gain=gain, integrals=k, seen=rank, time_constant=K.dt / share, radius=radius)


def _integrates(re: float, im: float = 0.0) -> bool:
    return abs(complex(re, im)) > 1.0 - _DECAY


def _integral_share(t: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, k: int) -> float:
    """Return T/Tt for the integral time: gain of the integrals in one sample over that of the rest at z = 1."""
    if k < len(t):
        # The other states, decoupled from the integrating ones, have a gain at z = 1.
        X = solve_sylvester(t[:k, :k], -t[k:, k:], -t[:k, k:])
        B, C = B.copy(), C.copy()
        B[:k] -= X @ B[k:]
        C[:, k:] += C[:, :k] @ X
        D = D + C[:, k:] @ np.linalg.solve(np.eye(len(t) - k) - t[k:, k:], B[k:])
    slow, proportional = (float(np.linalg.norm(part, 2)) for part in (C[:, :k] @ B[:k], D))
    return float(np.clip(slow / proportional if proportional > 0.0 else _FASTEST, _SLOWEST, _FASTEST))
