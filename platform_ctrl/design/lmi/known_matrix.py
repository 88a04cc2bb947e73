"""Closed loops that are linear in the controller itself, because their Lyapunov matrix is known.

The same congruence as for unknown X and Y is used, in states in which these are equal and diagonal: with V itself,
whose condition is that of X Y, a solver fails.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from platform_ctrl.design.lmi.bounded_real import Pair, balancing, turned
from platform_ctrl.design.lmi.conic import cvxpy
from platform_ctrl.design.lmi.linearised import Hats, LinearLoop, output_feedback
from platform_ctrl.design.partition import Partition, Realisation
from platform_ctrl.frozen import FloatArray


class KnownMatrix:
    """Plants and the unknown controller for a known V (2n, 2n).

    Parameters
    ----------
    plants
        Scaled plants.
    V
        Of the states [x, xK].
    D
        The unknown D_K, an expression or an array.

    Attributes
    ----------
    loops
        A closed loop for each plant, linear in the unknowns.
    unknowns
        Variables of the problem.
    A_K
        The controller's state matrix in some states of its own, an expression.
    own : (n, n)
        Those states from the states xK.
    """

    def __init__(self, plants: Sequence[Partition], V: FloatArray, D: Any) -> None:
        cp = cvxpy()
        n = len(plants[0].A)
        inverse = np.asarray(np.linalg.inv(V), dtype=np.float64)
        T = balancing(Pair(gamma=0.0, X=inverse[:n, :n], Y=V[:n, :n], separation=0.0))
        back = np.linalg.inv(T)
        X, Y = back @ inverse[:n, :n] @ back.T, T.T @ V[:n, :n] @ T
        left, sigma, right = np.linalg.svd(np.eye(n) - Y @ X)
        root = np.sqrt(sigma)
        # I − Y X = N M' with columns of N and M of equal size.
        self._N, self._M = left * root, right.T * root
        self.own = np.linalg.solve(self._N, T.T @ V[:n, n:])
        nu, ny = D.shape
        # Unknown are Â, B̂, Ĉ of the first plant, divided by the sizes of X and Y, which are large.
        half = np.sqrt(np.diag(X))
        self.unknowns = cp.Variable((n, n)), cp.Variable((n, ny)), cp.Variable((nu, n))
        sizes = np.diag(half)
        A, B, C = sizes @ self.unknowns[0] @ sizes, sizes @ self.unknowns[1], self.unknowns[2] @ sizes
        p = turned(plants[0], T)
        NB, CM = B - Y @ p.B2 @ D, C - D @ (p.C2 @ X)
        NAM = A - NB @ (p.C2 @ X) - (Y @ p.B2) @ CM - Y @ (p.A + p.B2 @ D @ p.C2) @ X
        self.A_K = np.linalg.inv(self._N) @ NAM @ np.linalg.inv(self._M.T)
        self._parts = NB, CM, D
        small = np.diag(np.tile(1 / half, 2))
        self.loops: list[LinearLoop] = []
        for plant in plants:
            q = turned(plant, T)
            hat = Hats(
                A=NAM + NB @ (q.C2 @ X) + (Y @ q.B2) @ CM + Y @ (q.A + q.B2 @ D @ q.C2) @ X,
                B=NB + Y @ q.B2 @ D,
                C=CM + D @ (q.C2 @ X),
                D=D,
            )
            loop = output_feedback(q, X, Y, hat)
            self.loops.append(
                LinearLoop(
                    V=small @ loop.V @ small, VA=small @ loop.VA @ small, VB=small @ loop.VB, C=loop.C @ small, D=loop.D
                )
            )

    def controller(self) -> Realisation:
        """Return what the solver found, in the states xK."""
        NB, CM, D = self._parts
        inverse = np.linalg.inv(self.own)
        return Realisation(
            A=inverse @ self.A_K.value @ self.own,
            B=inverse @ np.linalg.solve(self._N, NB.value),
            C=np.linalg.solve(self._M, CM.value.T).T @ self.own,
            D=np.asarray(getattr(D, "value", D)),
        )
