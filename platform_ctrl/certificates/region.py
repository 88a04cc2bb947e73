"""Certificates that every pole lies in a region: a sector for the damping, a disc for the fastest pole."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.certificates.certificate import Certificate
from platform_ctrl.certificates.closed_loop import closed, matrices_of
from platform_ctrl.certificates.makers import found_in_doubles
from platform_ctrl.certificates.precise import real_modes
from platform_ctrl.errors import ArgumentError, NotCertifiedError
from platform_ctrl.signatures import check_arguments


@check_arguments
@found_in_doubles
def region_certificate(
    A: ArrayLike,
    L: ArrayLike,
    M: ArrayLike,
    dt: float = 0.0,
    *,
    B: ArrayLike | None = None,
    C: ArrayLike | None = None,
    D: ArrayLike | None = None,
    controller: StateArrays | None = None,
    label: str = "",
) -> Certificate:
    """Return a proved certificate that every pole lies in the region {s : L + s M + s* M' < 0}.

    X is the identity in the coordinates of the modes, which proves whatever is true of every pole alone.

    Parameters
    ----------
    A : (n, n)
        x' = A x, or x(k+1) = A x(k), in the system's units.
    L, M : (k, k)
        The region, L symmetric, s in rad/s. Damping above cos θ: L = 0, M = [[sin θ, cos θ], [−cos θ, sin θ]].
    dt
        Sample period, s; > 0: the region is one of the w-plane, w = (2/dt) (z − 1)/(z + 1).
    B, C, D
        With a controller u = K y: A, B, C, D are the plant from u to y, in its units. Shapes (n, m), (p, n), (p, m).
    controller
        K.
    label
        What it is.

    Returns
    -------
    Certificate
        Verified.

    Raises
    ------
    ArgumentError
        Matrices that do not fit together.
    NotCertifiedError
        A pole lies outside, or poles are so nearly multiple that the modes do not show it.

    References
    ----------
    M. Chilali, P. Gahinet, IEEE Trans. Automatic Control 41, 1996.

    See docs/certificates.md.
    """
    where = "region_certificate"
    loop = closed(matrices_of(A, B, C, D, dt, where), controller, label, where)
    try:
        L, M = np.array(L, dtype=np.float64), np.array(M, dtype=np.float64)
    except (TypeError, ValueError):
        raise ArgumentError(f"{where}: L and M are no matrices of real numbers") from None
    if not loop.finite:
        raise ArgumentError(f"{where}: a matrix is not finite; expected finite numbers, dt >= 0")
    try:
        T = real_modes(loop.rounded().A)
    except np.linalg.LinAlgError:
        T = np.eye(loop.order)
    certificate = Certificate(claim="region", bound=0.0, loops=(loop,), X=np.eye(loop.order), coordinates=T, L=L, M=M)
    found = certificate.verify()
    if not found.proved:
        raise NotCertifiedError(
            f"{where}: no proof that {found.statement}: {found.reason}; try a larger region", certificate
        )
    return certificate
