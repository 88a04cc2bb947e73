"""Anti-windup of a scheme: x⁺ = A x + B y + E (limited u − u).

Back-calculation: with V the states that integrate (A V = V Λ) and C the outputs' share in them,

    E = V (Λ − (1 − T/Tt) I) (C V)^+,

so that while torques are at their limits these states follow the share that remains of them, with the time constant Tt;
the other poles stay. Tt is the integral time: where the controller's integral action becomes its proportional one.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, scaled, state_scaling
from platform_ctrl.common.text import at_least
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.export.c99.scheme import Scheme, arrays
from platform_ctrl.job.job import Job

# A state integrates if it decays by less than this share in a sample.
_DECAY = 1e-3
# Least and largest T/Tt.
_SLOWEST, _FASTEST = 1e-4, 0.1
# Integrals that share outputs to a part smaller than this of the largest cannot be distinguished by them.
_BLIND = 1e-9


@value
class Windup:
    """The anti-windup of a scheme (Åström, Hägglund, Advanced PID Control, 2006, section 3.5)."""

    gain: FloatArray  # (states, outputs): E in the scheme's states per unit of its outputs; zero: none
    remark: str  # Description for the header
    notes: tuple[str, ...] = ()  # What a user should know, a line each


def integrating(K: StateArrays) -> tuple[FloatArray, FloatArray]:
    """Return the states that integrate: V with A V = V Λ, and Λ."""
    if not len(K.A):
        return np.zeros((0, 0)), np.zeros((0, 0))
    t, Z, k = _sorted(K)
    V: FloatArray = state_scaling(K.A, K.B, K.C)[:, None] * Z[:, :k]
    return V, np.asarray(t[:k, :k])


def back_calculation(scheme: Scheme) -> Windup:
    """Return the anti-windup by back-calculation."""
    K = arrays(scheme)
    none = np.zeros((len(K.A), len(scheme.outputs)))
    limits = np.array(scheme.torque_limits)
    limited = np.isfinite(limits)
    if not limited.any():
        return Windup(gain=none, remark="Anti-windup: none, for no output is limited.")
    V, own = integrating(K)
    if not V.shape[1]:
        return Windup(gain=none, remark="Anti-windup: none, for no state integrates.")
    # Outputs in units of their limits; outputs without limit have no excess.
    seen = np.where(limited[:, None], K.C @ V, 0.0) / np.where(limited, limits, 1.0)[:, None]
    sizes = np.linalg.norm(seen, axis=0)
    sizes[sizes == 0.0] = 1.0
    share = _integral_share(K)
    inverse = np.linalg.pinv(seen / sizes, rcond=_BLIND) / np.where(limited, limits, 1.0)
    step = own - (1.0 - share) * np.eye(len(own))
    # Every integral in units of its share of a limit.
    gain = V @ (step / sizes) @ inverse
    gain[np.abs(gain) < 1e-12 * np.abs(gain).max(axis=1, keepdims=True, initial=0.0)] = 0.0
    rank = int(np.linalg.matrix_rank(seen / sizes, tol=_BLIND * np.sqrt(len(own))))
    radius = float(np.abs(np.linalg.eigvals(K.A - gain @ np.where(limited[:, None], K.C, 0.0))).max())
    seconds = K.dt / share
    remark = (
        f"Anti-windup: back-calculation. While a torque is at its limit, the integrals follow what acts with the time "
        f"constant {seconds:.4g} s, the integral time: x+ = A x + B y + E (limited - commanded). The states then stay "
        f"bounded: their slowest pole is |z| = {radius:.6g}."
    )
    if rank == len(own) and radius < 1.0:
        return Windup(gain=gain, remark=remark)
    left = f"{len(own) - rank} of {len(own)} integrating states lie beyond it: no limited output shows them alone"
    remark = f"Anti-windup: back-calculation, time constant {seconds:.4g} s; {left}. Their windup is not prevented."
    return Windup(gain=gain, remark=remark, notes=(f"{scheme.name}: anti-windup: {left}",))


def proved(job: Job, scheme: Scheme) -> Windup:
    """Return the anti-windup gain of `design.anti_windup`, or back-calculation where that has none."""
    from platform_ctrl.design.antiwindup.compensator import anti_windup
    from platform_ctrl.design.caging_claims import caging_loop_limits

    K = arrays(scheme)
    if not integrating(K)[0].shape[1]:
        return back_calculation(scheme)
    sensed = {pickoff.name for pickoff in job.platform.pickoffs}
    if not set(scheme.inputs) <= sensed:
        other = back_calculation(scheme)
        note = f"{scheme.name}: back-calculation: proofs of anti-windup are for loops from pick-offs to torquers alone"
        return Windup(gain=other.gain, remark=other.remark, notes=(*other.notes, note))
    try:
        loop = caging_loop_limits(job, named_system(K, scheme.inputs, scheme.outputs), 1)
        found = anti_windup(loop)
        reason = "" if found.verification.proved else found.verification.reason
    except PlatformCtrlError as error:
        reason = str(error)
    if reason:
        other = back_calculation(scheme)
        note = f"{scheme.name}: no proved anti-windup, back-calculation instead: {reason}"
        return Windup(gain=other.gain, remark=other.remark, notes=(*other.notes, note))
    remark = (
        "Anti-windup: the static gain E of platform_ctrl.design.anti_windup, x+ = A x + B y + E (limited - commanded). "
        "Proved for the nominal linear plant with its torque limits: after a torque impulse of up to "
        f"{at_least(found.reach, 4)} N m s on any axis of the loop it comes back to rest; without E: "
        f"{at_least(found.reach_without, 4)} N m s."
    )
    return Windup(gain=found.gain, remark=remark)


def _sorted(K: StateArrays) -> tuple[FloatArray, FloatArray, int]:
    """Return the Schur form of A in balanced states, integrating states first, its vectors, and their number."""
    from scipy.linalg import schur

    A = scaled(K.A, K.B, K.C)[0]
    t, Z, k = schur(A, output="real", sort=lambda re, im=0.0: bool(abs(complex(re, im)) > 1.0 - _DECAY))
    return t, Z, int(k)


def _integral_share(K: StateArrays) -> float:
    """Return T/Tt for the integral time: gain of the integrals in one sample over that of the rest at z = 1."""
    from scipy.linalg import solve_sylvester

    t, Z, k = _sorted(K)
    _, B, C = scaled(K.A, K.B, K.C)
    into, shown, rest = Z.T @ B, C @ Z, K.D
    if k < len(t):
        # The other states, decoupled from the integrating ones, have a gain at z = 1.
        X = solve_sylvester(t[:k, :k], -t[k:, k:], -t[:k, k:])
        into[:k] -= X @ into[k:]
        shown[:, k:] += shown[:, :k] @ X
        rest = rest + shown[:, k:] @ np.linalg.solve(np.eye(len(t) - k) - t[k:, k:], into[k:])
    slow = float(np.linalg.norm(shown[:, :k] @ into[:k], 2))
    proportional = float(np.linalg.norm(rest, 2))
    return float(np.clip(slow / proportional if proportional > 0.0 else _FASTEST, _SLOWEST, _FASTEST))
