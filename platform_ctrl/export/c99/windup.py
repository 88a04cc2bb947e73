"""Anti-windup by back-calculation: x⁺ = A x + B y + E (limited u − u).

With V the states that integrate (A V = V Λ) and C the outputs' share in them,

    E = V (Λ − (1 − T/Tt) I) (C V)^+,

so that while torques are at their limits these states follow the share that remains of them, with the time constant Tt;
the other poles stay. Tt is the integral time: where the controller's integral action becomes its proportional one.

Åström, Hägglund, Advanced PID Control, 2006, section 3.5.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import schur, solve_sylvester

from platform_ctrl.analysis.arrays import scaled, state_scaling
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.export.c99.controller import Controller

# A state integrates if it decays by less than this share in a sample.
_DECAY = 1e-3
# Least and largest T/Tt.
_SLOWEST, _FASTEST = 1e-4, 0.1
# Integrals that share outputs to a part smaller than this of the largest cannot be distinguished by them.
_BLIND = 1e-9


@value
class Windup:
    """The anti-windup of a controller."""

    gain: FloatArray  # (states, outputs): E; zero: none
    remark: str  # Description for the header
    note: str = ""  # What a user should know, or empty


def back_calculation(controller: Controller) -> Windup:
    """Return the anti-windup by back-calculation."""
    K, limits = controller.arrays, controller.limits
    none, limited = np.zeros((len(K.A), len(limits))), np.isfinite(limits)
    if not limited.any():
        return Windup(gain=none, remark="Anti-windup: none, for no output is limited.")
    A, B, C = scaled(K.A, K.B, K.C)
    t, Z, k = schur(A, output="real", sort=_integrates) if len(A) else (A, A, 0)
    if not k:
        return Windup(gain=none, remark="Anti-windup: none, for no state integrates.")
    V, own = state_scaling(K.A, K.B, K.C)[:, None] * Z[:, :k], t[:k, :k]
    # Outputs in units of their limits; outputs without limit have no excess.
    seen = np.where(limited[:, None], K.C @ V, 0.0) / np.where(limited, limits, 1.0)[:, None]
    sizes = np.linalg.norm(seen, axis=0)
    sizes[sizes == 0.0] = 1.0
    share = _integral_share(t, Z.T @ B, C @ Z, K.D, k)
    inverse = np.linalg.pinv(seen / sizes, rcond=_BLIND) / np.where(limited, limits, 1.0)
    # Every integral in units of its share of a limit.
    gain = V @ ((own - (1.0 - share) * np.eye(k)) / sizes) @ inverse
    gain[np.abs(gain) < 1e-12 * np.abs(gain).max(axis=1, keepdims=True, initial=0.0)] = 0.0
    rank = int(np.linalg.matrix_rank(seen / sizes, tol=_BLIND * np.sqrt(k)))
    radius = float(np.abs(np.linalg.eigvals(K.A - gain @ np.where(limited[:, None], K.C, 0.0))).max())
    remark = (
        "Anti-windup: back-calculation. While a torque is at its limit, the integrals follow what acts with the time "
        f"constant {K.dt / share:.4g} s, the integral time: x+ = A x + B y + E (limited - commanded). "
    )
    if rank == k and radius < 1.0:
        return Windup(
            gain=gain, remark=f"{remark}The states then stay bounded: their slowest pole is |z| = {radius:.6g}."
        )
    left = f"{k - rank} of {k} integrating states are not protected against windup: no limited output shows them alone"
    return Windup(gain=gain, remark=f"{remark}{left}.", note=f"{controller.name}: anti-windup: {left}")


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
