"""Gimbal equations linear in the angles while Omega(t) stays: eq. (27), whose parameters are Omega and Omega'.

About angles q0, with no restriction on Omega(t), the rows of the gimbals are to first order in q − q0

    M q̈ + G(Omega) q̇ + K(Omega, Omega') (q − q0) + M_Omega Omega' + Q0(Omega) = Q

and the dependence is exactly polynomial: G affine, Q0 quadratic, K quadratic in Omega and affine in Omega'.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.arguments import known_names
from platform_ctrl.description import Platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.linearisation import Terms, linearise
from platform_ctrl.parameter_varying.coefficients import acceleration_part, inertia_part, rotor_part
from platform_ctrl.parameter_varying.model import AffineModel, Form, FrozenRows, FrozenSystem, ParameterVaryingModel
from platform_ctrl.parameter_varying.polynomial import MatrixPolynomial, monomial_values, polynomial, total
from platform_ctrl.signatures import check_arguments

__all__ = [
    "AffineModel",
    "FrozenRows",
    "FrozenSystem",
    "MatrixPolynomial",
    "ParameterVaryingModel",
    "monomial_values",
    "parameter_varying",
]


@check_arguments
def parameter_varying(
    platform: Platform,
    gimbals: Sequence[str] | None = None,
    q: ArrayLike | None = None,
    terms: Terms = "exact",
    form: Form = "rates",
    specific_force: ArrayLike | None = None,
    rate_amplitude: ArrayLike | None = None,
) -> ParameterVaryingModel:
    """Linearise in gimbal angles alone and keep Omega(t): eq. (27).

    Parameters
    ----------
    platform
        The platform.
    gimbals
        Names of the gimbals whose angles are coordinates, default all. The others are held.
    q : (n,)
        Angles of all gimbals about which is linearised, or at which they are held, rad; default zero.
    terms
        ``"exact"`` or ``"paper"``, see `linearise`.
    form
        What the states p of the state-space form are. ``"rates"``: p = M q̇; the parameters are monomials of Omega and
        Omega'. ``"momenta"``: p = M q̇ + (∂A*/∂q Omega) (q − q0) + M_Omega Omega; Omega' drops out, without
        approximation, and fewer parameters are left.
    specific_force : (3,)
        For unbalance, see `linearise`, m/s²; constant.
    rate_amplitude : (n,)
        For dry friction, see `linearise`, rad/s.

    Returns
    -------
    ParameterVaryingModel
        Exact in Omega and Omega', first order in the angles.

    Raises
    ------
    ArgumentError
        Wrong shape, not finite, no gimbal, an unknown one, or unknown `terms` or `form`.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).

    See docs/parameter-varying.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> platform = pc.read_platform("three_gyro_platform")
    >>> varying = pc.parameter_varying(platform, gimbals=("9", "10"), form="momenta")
    >>> varying.affine().parameters
    ('Omega2', 'Omega1^2', 'Omega1*Omega3', 'Omega2^2', 'Omega3^2')
    """
    if form not in ("rates", "momenta"):
        raise ArgumentError(f"form: given {form!r}; expected 'rates' or 'momenta'")
    # Its L and J parts vanish at Omega = 0, except the gyroscopic action: what is left is that of the force elements.
    rest = linearise(platform, terms=terms, q=q, specific_force=specific_force, rate_amplitude=rate_amplitude)
    rows, n = _rows(platform, gimbals), len(platform.gimbals)
    parts = [rotor_part(platform, rest.q0)]
    if terms == "exact":
        parts.append(inertia_part(platform, rest.q0))
    turning = acceleration_part(platform, rest.q0, terms)
    friction, springs = polynomial({"1": -rest.Q_rate}, (n, n)), polynomial({"1": -rest.Q_angle}, (n, n))
    return ParameterVaryingModel(
        platform=platform,
        terms=terms,
        form=form,
        gimbals=tuple(platform.gimbal_names[k] for k in rows),
        angles=tuple(platform.angle_names[k] for k in rows),
        q0=rest.q0,
        M=rest.M[np.ix_(rows, rows)],
        M_Omega=rest.M_Omega[rows],
        G=total(friction, *(part.G for part in parts)).part(rows, rows),
        K=total(springs, turning, *(part.K for part in parts)).part(rows, rows),
        Q0=total(polynomial({"1": rest.Q0}, (n,)), *(part.Q0 for part in parts)).part(rows),
    )


def _rows(platform: Platform, gimbals: Sequence[str] | None) -> list[int]:
    names = platform.gimbal_names
    rows = known_names("gimbals", names if gimbals is None else gimbals, names)
    if not rows:
        where = f"platform {platform.name!r} has none" if not names else "given none"
        raise ArgumentError(f"gimbals: {where}; expected at least one whose angle is a coordinate")
    return rows
