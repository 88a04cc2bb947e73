"""Pole regions as matrix inequalities (Chilali and Gahinet 1996), and the modes that no controller moves into one.

A region is {s : L + M s + M' s* < 0}. All eigenvalues of A lie in it if some V > 0 satisfies
L ⊗ V + M ⊗ (V A) + M' ⊗ (V A)' < 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lmi.conic import cvxpy
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.scaling import ScaledPlant
from platform_ctrl.errors import ArgumentError, IllPosedError
from platform_ctrl.job.requirements import LoopRequirement

REGIONS = ("stability", "damping", "fastest pole")
# Singular value of [A − sI, B2] (or its dual), relative to A, below which a mode cannot be moved.
FIXED = 1e-9


@value
class Region:
    """L and M of a region, (k, k), and its requirement."""

    requested: LoopRequirement
    L: FloatArray
    M: FloatArray

    def contains(self, s: complex) -> bool:
        """Whether a pole lies in it."""
        return float(np.linalg.eigvalsh(self.L + s * self.M + np.conj(s) * self.M.T)[-1]) < 0


def region(requested: LoopRequirement, period: float = 0.0, rate: float = 1.0, tighter: float = 1.0) -> Region:
    """Return the region of "stability" (minimum decay rate), "damping" or "fastest pole".

    Parameters
    ----------
    requested
        The requirement.
    period
        Sample period, s: the region is one of the w-plane, w = (2/T) (z − 1)/(z + 1). A decay is a disc there, exactly;
        a damping is a sector that is narrow enough for poles up to 1/T rad/s.
    rate
        Unit of s, rad/s.
    tighter
        Factor of the limit, >= 1; of a damping, divisor of its distance from 1.
    """
    limit, kind = requested.limit, requested.kind
    sense = "at most" if kind == "fastest pole" else "at least"
    if requested.sense != sense or not (math.isfinite(limit) and limit > 0) or (kind == "damping" and limit >= 1):
        below = " below 1" if kind == "damping" else ""
        raise ArgumentError(
            f"{requested.name}: must be {sense} a positive number{below}, got {requested.sense} {limit!r}"
        )
    disc = np.array([[0.0, 1.0], [0.0, 0.0]])
    if kind == "damping":
        cosine = 1 - (1 - _sector(limit, period)) / tighter
        sine = math.sqrt(1 - cosine**2)
        # The sector |arg(−s)| < θ, cos θ the damping.
        return Region(requested=requested, L=np.zeros((2, 2)), M=np.array([[sine, cosine], [-cosine, sine]]))
    if kind == "fastest pole":
        return Region(requested=requested, L=-limit / tighter / rate * np.eye(2), M=disc)
    decay = limit * tighter
    if period == 0.0:
        return Region(requested=requested, L=np.array([[2 * decay / rate]]), M=np.eye(1))
    # |z| < exp(−decay T) is the disc |w + c|² < c² − 4/T². Its c is large: 2 Re w + 4/T²/c + |w|²/c < 0.
    near = 2 / period * math.tanh(decay * period / 2)
    centre = (near + 4 / period**2 / near) / 2 / rate
    return Region(
        requested=requested,
        L=np.diag([4 / (period * rate) ** 2 / centre, -1.0]),
        M=np.array([[1.0, 0.0], [1 / math.sqrt(centre), 0.0]]),
    )


def _sector(damping: float, period: float) -> float:
    """Return the damping in the w-plane that is sufficient for `damping` of poles up to 1 / `period`, rad/s."""
    if period == 0.0:
        return damping
    s = np.linspace(0.0, 1.0, 101)[1:] * complex(-damping, math.sqrt(1 - damping**2))
    w = np.tanh(s / 2)
    return float(np.max(-w.real / np.abs(w)))


def require_movable(scaled: ScaledPlant, wanted: Sequence[Region], where: str, P: object) -> None:
    """Raise an IllPosedError that names a mode outside a region, in units of `scaled`, that no controller moves.

    Such modes, as a rule poles of weights, are poles of every closed loop.
    """
    plant = scaled.plant
    size = max(1.0, float(np.linalg.norm(plant.A, 2)))
    for pole in np.linalg.eigvals(plant.A):
        outside = [one.requested for one in wanted if not one.contains(complex(pole))]
        shifted = plant.A - pole * np.eye(len(plant.A))
        for text, pencil in (
            ("no control u moves it", np.hstack([shifted, plant.B2])),
            ("no measurement y sees it", np.vstack([shifted, plant.C2])),
        ):
            if outside and float(np.linalg.svd(pencil, compute_uv=False)[-1]) < FIXED * size:
                real = complex(pole) * scaled.rate
                requested = outside[0]
                raise IllPosedError(
                    f"{where}: the mode at {real.real:.4g}{real.imag:+.4g}j rad/s violates {requested.name} "
                    f"{requested.sense} {requested.limit:.4g}, and {text}; relax the limit, or give the weight another "
                    "pole",
                    P,
                )


class LinearLoop(NamedTuple):
    """V, V A, V B, C and D of a closed loop w -> z, possibly after a congruence; all linear in the unknowns."""

    V: Any
    VA: Any
    VB: Any
    C: Any
    D: Any


def output_feedback(p: Partition, X: Any, Y: Any, hat: StateArrays) -> LinearLoop:
    """Return the loop of a full-order controller with transformed variables `hat`."""
    cp = cvxpy()
    one = np.eye(len(p.A))
    return LinearLoop(
        V=cp.bmat([[X, one], [one, Y]]),
        VA=cp.bmat([[p.A @ X + p.B2 @ hat.C, p.A + p.B2 @ hat.D @ p.C2], [hat.A, Y @ p.A + hat.B @ p.C2]]),
        VB=cp.vstack([p.B1 + p.B2 @ hat.D @ p.D21, Y @ p.B1 + hat.B @ p.D21]),
        C=cp.hstack([p.C1 @ X + p.D12 @ hat.C, p.C1 + p.D12 @ hat.D @ p.C2]),
        D=p.D11 + p.D12 @ hat.D @ p.D21,
    )


def state_feedback(p: Partition, X: Any, L: Any) -> LinearLoop:
    """Return the loop of u = L X⁻¹ x."""
    return LinearLoop(V=X, VA=p.A @ X + p.B2 @ L, VB=p.B1, C=p.C1 @ X + p.D12 @ L, D=p.D11)


def hinf_below(
    loop: LinearLoop, w: Sequence[int], z: Sequence[int], levels: tuple[Any, Any], margin: float
) -> list[Any]:
    """Constraints: the H-infinity norm from w to z is below the geometric mean of the two levels."""
    cp = cvxpy()
    w, z = list(w), list(z)
    B, C, D = loop.VB[:, w], loop.C[z, :], loop.D[z, :][:, w]
    block = cp.bmat(
        [
            [loop.VA + loop.VA.T, B, C.T],
            [B.T, -levels[0] * np.eye(len(w)), D.T],
            [C, D, -levels[1] * np.eye(len(z))],
        ]
    )
    return [block << -margin * np.eye(block.shape[0])]


def h2_below(loop: LinearLoop, w: Sequence[int], z: Sequence[int], levels: tuple[Any, Any], margin: float) -> list[Any]:
    """Constraints: the H2 norm from w to z is below the geometric mean of the levels; D must be zero there."""
    cp = cvxpy()
    w, z = list(w), list(z)
    B, C = loop.VB[:, w], loop.C[z, :]
    block = cp.bmat([[loop.VA + loop.VA.T, B], [B.T, -levels[0] * np.eye(len(w))]])
    Q = cp.Variable((len(z), len(z)), symmetric=True)
    cover = cp.bmat([[loop.V, C.T], [C, Q]])
    return [block << -margin * np.eye(block.shape[0]), cover >> 0, cp.trace(Q) <= levels[1]]


def poles_in(loop: LinearLoop, wanted: Region, margin: float) -> list[Any]:
    """Constraints: all poles lie in the region."""
    cp = cvxpy()
    L, M = wanted.L, wanted.M
    k = len(L)
    block = cp.bmat([[L[i, j] * loop.V + M[i, j] * loop.VA + M[j, i] * loop.VA.T for j in range(k)] for i in range(k)])
    return [block << -margin * np.eye(block.shape[0])]
