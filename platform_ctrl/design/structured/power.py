"""The H2 norm of a closed loop and its gradient: two Lyapunov equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.design.partition import Partition
from platform_ctrl.design.structured.norm import ClosedLoop
from platform_ctrl.design.structured.objective import Parametrisation
from platform_ctrl.frozen import FloatArray

# A direct term above this share of the plant's own direct terms makes the norm infinite.
_ROUNDING = 1e-9


class WorstPower:
    """The H2 norms of all plants as pieces for `minimax.minimise`, one a plant."""

    def __init__(self, plants: Sequence[Partition], controller: Parametrisation) -> None:
        self.plants, self.controller = tuple(plants), controller

    def pieces(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the norms and their gradients; inf where the loop has a direct term or is not stable."""
        refused = np.array([np.inf]), np.zeros((1, len(x)))
        M, J = self.controller.matrix(x), self.controller.jacobian(x)
        values, slopes = [], []
        for plant in self.plants:
            try:
                found = _norm(ClosedLoop(plant, M))
            except np.linalg.LinAlgError:
                return refused
            if found is None:
                return refused
            values.append(found[0])
            slopes.append(np.einsum("ij,ijx->x", found[1], J))
        return np.array(values), np.array(slopes)


def _norm(loop: ClosedLoop) -> tuple[float, FloatArray] | None:
    """Return the norm and its gradient with respect to M."""
    from scipy.linalg import solve_continuous_lyapunov

    plant = loop.plant
    size = max(float(np.abs(plant.D11).max(initial=0.0)), float(np.abs(plant.D12).max(initial=0.0)), 1e-300)
    if np.abs(loop.D).max(initial=0.0) > _ROUNDING * size or not loop.abscissa() < 0.0:
        return None
    X = solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)
    Y = solve_continuous_lyapunov(loop.A.T, -loop.C.T @ loop.C)
    square = float(np.trace(loop.C @ X @ loop.C.T))
    if not (np.isfinite(square) and square > 0.0):
        return None
    norm = float(np.sqrt(square))
    # d(norm²) = 2 tr(Y X dA') + 2 tr(Y B dB') + 2 tr(C X dC'), and dA = B2 dM C2, dB = B2 dM D21, dC = D12 dM C2.
    into = loop.B2.T @ (Y @ X @ loop.C2.T + Y @ loop.B @ loop.D21.T)
    return norm, np.asarray((into + loop.D12.T @ loop.C @ X @ loop.C2.T) / norm)
