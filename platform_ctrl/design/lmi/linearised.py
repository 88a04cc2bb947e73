"""Closed loops in the variables in which they are linear, and the inequalities that bound their norms and poles.

Scherer, Gahinet and Chilali (1997): with one Lyapunov matrix V for all of a loop's inequalities, a congruence turns
V, V A, V B, C, D of the closed loop into matrices linear in X, Y and the transformed controller Â, B̂, Ĉ, D̂. The
expressions are those of cvxpy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.design.lmi.conic import cvxpy
from platform_ctrl.design.lmi.regions import Region
from platform_ctrl.design.partition import Partition, Realisation


class LinearLoop(NamedTuple):
    """V, V A, V B, C and D of a closed loop w -> z, possibly after a congruence; all linear in the unknowns."""

    V: Any
    VA: Any
    VB: Any
    C: Any
    D: Any


class Hats(NamedTuple):
    """Transformed controller variables."""

    A: Any
    B: Any
    C: Any
    D: Any

    def values(self) -> Realisation:
        """Return what the solver found."""
        return Realisation(**{name: np.asarray(getattr(part, "value", part)) for name, part in self._asdict().items()})


def output_feedback(p: Partition, X: Any, Y: Any, hat: Hats) -> LinearLoop:
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
