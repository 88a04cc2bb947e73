"""How the gyros couple the gimbals: pairs with cross-axis action, and directions that no gyro stiffens.

An orthogonal change of the angles brings the skew matrix G to 2 x 2 blocks [[0, h], [-h, 0]] and zeros (its real Schur
form). In each block the precession equations are h ẏ2 = Q1, −h ẏ1 = Q2: a torque about one axis turns the other. In the
directions of the zeros the gimbals are plain inertias.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.linearisation import LinearModel

# A block whose h is this small against the largest is no gyroscopic pair.
_NO_GYRO = 1e-9


@value
class Channels:
    """Gyroscopic pairs and inertial directions of some gimbals.

    Attributes
    ----------
    basis : (n, n)
        Orthogonal; rows are directions: y = basis @ q. First the pairs, then the inertial directions.
    momenta : (pairs,)
        h of each pair, N m s.
    inertias : (n,)
        Inertia in each direction, kg m².
    spins : (rotors,)
        Spin of the rotors that the gimbals carry, rad/s, without those that stand still.
    """

    basis: FloatArray
    momenta: FloatArray
    inertias: FloatArray
    spins: FloatArray

    @property
    def inertial(self) -> int:
        """Number of directions without gyroscopic action."""
        return len(self.basis) - 2 * len(self.momenta)


def channels(model: LinearModel, rows: list[int]) -> Channels:
    """Return the pairs and inertial directions of the gimbals in `rows`."""
    from scipy.linalg import schur

    part = np.ix_(rows, rows)
    carriers = {model.gimbal_names[k] for k in rows}
    M, G = model.M[part], model.G[part]
    block, vectors = schur(0.5 * (G - G.T), output="real")
    largest = np.abs(G).max(initial=0.0)
    pairs: list[tuple[float, FloatArray, FloatArray]] = []
    single: list[FloatArray] = []
    k = 0
    while k < len(rows):
        h = float(block[k, k + 1]) if k + 1 < len(rows) else 0.0
        if abs(h) > _NO_GYRO * largest and largest > 0.0:
            pairs.append((abs(h), *_oriented(h, vectors[:, k], vectors[:, k + 1])))
            k += 2
        else:
            single.append(_upright(vectors[:, k]))
            k += 1
    pairs.sort(key=lambda pair: -pair[0])
    basis = np.array([direction for _, first, second in pairs for direction in (first, second)] + single)
    return Channels(
        basis=basis,
        momenta=np.array([h for h, _, _ in pairs]),
        inertias=np.einsum("ki,ij,kj->k", basis, M, basis),
        spins=np.array([abs(r.spin) for r in model.platform.rotors if r.carrier in carriers and r.spin != 0.0]),
    )


def _oriented(h: float, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn a pair within its plane so that it lies along the gimbal axes where it can, with h > 0."""
    plane = np.array([first, second])
    # The gimbal axis that lies in the plane best becomes the first direction.
    along = plane.T @ plane
    lead = int(np.argmax(np.diag(along)))
    first_new = along[:, lead] / np.linalg.norm(along[:, lead])
    rotated = np.array([plane @ first_new])
    second_new = np.array([-rotated[0, 1], rotated[0, 0]]) @ plane
    return (first_new, second_new) if h > 0.0 else (first_new, -second_new)


def _upright(direction: FloatArray) -> FloatArray:
    return direction if direction[np.argmax(np.abs(direction))] > 0.0 else -direction
