"""The equations (27), linear in the angles, with Omega(t) as their parameter: frozen rows, vertices, grids, ẋ."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import known_names, one_of, real_array, short, whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.linearisation import Terms, linearise
from platform_ctrl.mechanics.polynomials import (
    AffineModel,
    FrozenSystem,
    MatrixPolynomial,
    acceleration_part,
    affine_model,
    momentum_slope,
    monomial_values,
    polynomial,
    row_polynomials,
    total,
)
from platform_ctrl.plant.platform import Platform

if TYPE_CHECKING:
    import control

__all__ = [
    "AffineModel",
    "FrozenRows",
    "FrozenSystem",
    "MatrixPolynomial",
    "ParameterVaryingModel",
    "parameter_varying",
]

Form = Literal["rates", "momenta"]
Signal = ArrayLike | Callable[[float], ArrayLike]

# Points of a grid at most: a synthesis with more of them is out of reach anyway.
_MOST_POINTS = 2**14


@value
class FrozenRows:
    """The rows M q̈ + G q̇ + K (q − q0) + forcing = Q at one Omega and Omega'.

    Attributes
    ----------
    M, G, K : (k, k)
        Inertia, kg m², the coefficient of q̇ (friction included), N m s, and that of q − q0 (springs and Omega'
        included), N m/rad.
    forcing : (k,)
        M_Omega Omega' + Q0(Omega), N m.
    """

    M: FloatArray
    G: FloatArray
    K: FloatArray
    forcing: FloatArray


@value
class ParameterVaryingModel:
    """Rows of the chosen gimbals, linear in their angles, polynomial in Omega(t) and Omega'(t).

    Attributes
    ----------
    platform, terms
        What was linearised, and which terms were kept.
    form
        What the states p are, see `parameter_varying`.
    gimbals, angles
        Names of the k gimbals whose angles are coordinates, in the file's order, and of the angles.
    q0 : (n,)
        Angles of all gimbals that the model is about; the gimbals that are no coordinates are held there, rad.
    M, M_Omega
        Coefficients of q̈ and Omega', kg m². Shapes (k, k), (k, 3).
    G, K, Q0
        Matrix polynomials, (k, k), (k, k), (k,): before q̇ (G − ∂Q/∂q̇ of `linearise`), N m s, before q − q0 (K − ∂Q/∂q
        and the Omega' terms), N m/rad, and what torquers must supply at q0 while Omega' = 0, N m.
    affine
        The state-space form, affine in the monomials that occur. States: the angles (from q0), then ``p_`` + angle.
        Inputs: the gimbals' torquers in the file's order, then ``d_`` + the states that Omega drives: `forcing` says
        how. Outputs: the angles.
    """

    platform: Platform
    terms: Terms
    form: Form
    gimbals: tuple[str, ...]
    angles: tuple[str, ...]
    q0: FloatArray
    M: FloatArray
    M_Omega: FloatArray
    G: MatrixPolynomial
    K: MatrixPolynomial
    Q0: MatrixPolynomial
    affine: AffineModel

    def at(self, Omega: ArrayLike, Omega_dot: ArrayLike | None = None) -> FrozenRows:
        """Return the matrices of the chosen gimbals at a rate, rad/s, and its derivative, rad/s² (default zero)."""
        rate, change = real_array("Omega", Omega, (3,)), real_array("Omega_dot", Omega_dot, (3,), 0.0)
        forcing = self.M_Omega @ change + self.Q0.at(rate)
        return FrozenRows(M=self.M, G=self.G.at(rate), K=self.K.at(rate, change), forcing=forcing)

    def state_space(self, Omega: ArrayLike, Omega_dot: ArrayLike | None = None) -> control.StateSpace:
        """Return the system frozen at a rate, rad/s, and its derivative, rad/s²; signals as in `affine`."""
        return self.affine.system(monomial_values(self.affine.parameters, Omega, Omega_dot))

    def forcing(self, Omega: ArrayLike, Omega_dot: ArrayLike | None = None) -> FloatArray:
        """Return what Omega adds to ẋ, the values of the inputs ``d_``.

        Parameters
        ----------
        Omega, Omega_dot : (3,)
            rad/s, rad/s²; the derivative is zero by default.

        Returns
        -------
        (k,) or (2k,)
            ``form="rates"``: −M_Omega Omega' − Q0(Omega), N m. ``form="momenta"``: rad/s and N m, without Omega'.
        """
        rate, change = real_array("Omega", Omega, (3,)), real_array("Omega_dot", Omega_dot, (3,), 0.0)
        if self.form == "rates":
            return np.asarray(-self.M_Omega @ change - self.Q0.at(rate))
        to_rates = self.affine.A_0[: len(self.M), len(self.M) :]
        carried = to_rates @ self.M_Omega @ rate
        rest = (self.G.at(rate) - momentum_slope(self.K).at(rate)) @ carried - self.Q0.at(rate)
        return np.concatenate([-carried, rest])

    def state(self, q: ArrayLike, rates: ArrayLike, Omega: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
        """Return the state x of the state-space form at a motion.

        Parameters
        ----------
        q, rates : (k,)
            Angles, counted from q0, rad; gimbal rates, rad/s.
        Omega : (3,)
            Platform rate, rad/s.

        Returns
        -------
        (2k,)
            Angles, rad, and the states p, N m s.
        """
        k = len(self.M)
        angles, rate = real_array("q", q, (k,)), real_array("Omega", Omega, (3,))
        momenta = self.M @ real_array("rates", rates, (k,))
        if self.form == "momenta":
            momenta = momenta + momentum_slope(self.K).at(rate) @ angles + self.M_Omega @ rate
        return np.concatenate([angles, momenta])

    def rhs(
        self, t: float, x: ArrayLike, Omega: Signal, Omega_dot: Signal | None = None, Q: Signal | None = None
    ) -> FloatArray:
        """Return ẋ along a manoeuvre, for `scipy.integrate.solve_ivp` and the like.

        Parameters
        ----------
        t
            Time, s.
        x : (2k,)
            State, see `affine` and `state`: rad and N m s.
        Omega, Omega_dot : (3,) or functions of time
            rad/s, rad/s². ``form="momenta"`` needs no `Omega_dot`.
        Q : (k,) or a function of time
            Torques on the gimbals, N m; default zero.

        Returns
        -------
        (2k,)
            rad/s and N m.

        Raises
        ------
        ArgumentError
            `Omega_dot` is left out where the rate changes and ``form="rates"``.
        """
        if self.form == "rates" and Omega_dot is None and callable(Omega):
            raise ArgumentError(
                "Omega_dot: is needed where Omega is a function of time; give it, or take form='momenta'"
            )
        k, affine = len(self.M), self.affine
        rate = Omega(t) if callable(Omega) else Omega
        change = Omega_dot(t) if callable(Omega_dot) else Omega_dot
        A = affine.state_matrix(monomial_values(affine.parameters, rate, change))
        out: FloatArray = A @ real_array("x", x, (2 * k,))
        forcing = self.forcing(rate, change)
        out[2 * k - len(forcing) :] += forcing
        if Q is not None:
            out[k:] += real_array("Q", Q(t) if callable(Q) else Q, (k,))
        return out

    def vertices(self, Omega_max: ArrayLike, Omega_dot_max: ArrayLike | None = None) -> list[FrozenSystem]:
        """Return the vertices of the box of monomials that holds all |Omega_a| <= max and |Omega'_a| <= max.

        Squares run over [0, max²], products over ± the product of the limits: the box covers every Omega(t), and
        more, because it takes the monomials for independent. No model has more than twelve, so 2^12 vertices; one of
        a subsystem has fewer, and so has ``form="momenta"``.

        Parameters
        ----------
        Omega_max, Omega_dot_max : (3,)
            Largest sizes, >= 0, rad/s and rad/s². A zero leaves the axis out; `Omega_dot_max` is zero by default.

        Returns
        -------
        list of FrozenSystem
            One for each vertex.
        """
        affine = self.affine
        rates, changes = _limits("Omega_max", Omega_max), _limits("Omega_dot_max", Omega_dot_max)
        high = monomial_values(affine.parameters, rates, changes)
        low = np.array([0.0 if name.endswith("^2") else -1.0 for name in affine.parameters]) * high
        ends = [sorted({a, b}) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
        corners = [np.array(corner, dtype=np.float64) for corner in itertools.product(*ends)]
        return [FrozenSystem(parameters=corner, system=affine.system(corner)) for corner in corners]

    def grid(
        self, points: int | Sequence[int], Omega_max: ArrayLike, Omega_dot_max: ArrayLike | None = None
    ) -> list[FrozenSystem]:
        """Return the model frozen on a regular grid of |Omega_a| <= max (and |Omega'_a| <= max).

        Parameters
        ----------
        points
            Points along an axis, >= 1 (an odd number contains zero, 1 is zero alone): one number, three for Omega,
            or six for Omega and Omega'. An axis whose limit is zero has one point.
        Omega_max, Omega_dot_max : (3,)
            As in `vertices`, rad/s and rad/s².

        Returns
        -------
        list of FrozenSystem
            One for each point.

        Raises
        ------
        ArgumentError
            `points` that are no whole numbers >= 1, or more than 2^14 in all.
        """
        affine = self.affine
        limits = np.concatenate([_limits("Omega_max", Omega_max), _limits("Omega_dot_max", Omega_dot_max)])
        counts = [number if limit > 0.0 else 1 for number, limit in zip(_points(points), limits, strict=True)]
        if (count := math.prod(counts)) > _MOST_POINTS:
            words = f"points: {short(points)} are {count} points, at most {_MOST_POINTS} are possible"
            raise ArgumentError(f"{words}; take fewer, or a limit of zero for an axis that hardly turns")
        axes = [
            np.linspace(-end, end, number) if number > 1 else np.zeros(1)
            for end, number in zip(limits, counts, strict=True)
        ]
        out = []
        for point in itertools.product(*axes):
            rate, change = np.array(point[:3]), np.array(point[3:])
            rho = monomial_values(affine.parameters, rate, change)
            out.append(FrozenSystem(parameters=rho, system=affine.system(rho), Omega=rate, Omega_dot=change))
        return out


def _limits(name: str, given: ArrayLike | None) -> FloatArray:
    limits = real_array(name, given, (3,), 0.0)
    if np.any(limits < 0.0):
        raise ArgumentError(f"{name}: must be three numbers >= 0 (largest sizes, not ends), got {limits.tolist()}")
    return limits


def _points(points: int | Sequence[int]) -> list[int]:
    given = [points] * 6 if np.ndim(points) == 0 else list(points)  # type: ignore[arg-type]
    given += [1] * 3 if len(given) == 3 else []
    if len(given) != 6:
        raise ArgumentError(f"points: must be a whole number >= 1, or three, or six of them, got {short(points)}")
    return [whole("points", number, 1) for number in given]


def parameter_varying(
    platform: Platform,
    gimbals: Sequence[str] | None = None,
    q: ArrayLike | None = None,
    terms: Terms = "exact",
    form: Form = "rates",
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

    Returns
    -------
    ParameterVaryingModel
        Exact in Omega and Omega', first order in the angles. Gravity turns with the root.

    Raises
    ------
    ArgumentError
        Wrong shape, not finite, no gimbal, an unknown one, or unknown `terms` or `form`.
    MechanicsError
        M is singular.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).

    See docs/theory/parameter-varying.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> platform = pc.read_platform("three_gyro_platform")
    >>> varying = pc.parameter_varying(platform, gimbals=("9", "10"), form="momenta")
    >>> varying.affine.parameters
    ('Omega2', 'Omega1^2', 'Omega1*Omega3', 'Omega2^2', 'Omega3^2')
    """
    one_of("form", form, get_args(Form))
    # All but the gyroscopic action vanishes at Omega = 0: what is left there is that of the force elements.
    rest = linearise(platform, terms=terms, q=q)
    rows, n = _rows(platform, gimbals), len(platform.gimbals)
    G, K, Q0 = row_polynomials(platform, rest.q0, terms)
    G = total(G, polynomial({"1": -rest.Q_rate}, (n, n))).part(rows, rows)
    turning = acceleration_part(platform, rest.q0, terms)
    K = total(K, turning, polynomial({"1": -rest.Q_angle}, (n, n))).part(rows, rows)
    M = rest.M[np.ix_(rows, rows)]
    names, angles = (tuple(some[k] for k in rows) for some in (platform.gimbal_names, platform.angle_names))
    torquers = {t.name: names.index(t.gimbal) for t in platform.torquers if t.gimbal in names}
    return ParameterVaryingModel(
        platform=platform,
        terms=terms,
        form=form,
        gimbals=names,
        angles=angles,
        q0=rest.q0,
        M=M,
        M_Omega=rest.M_Omega[rows],
        G=G,
        K=K,
        Q0=total(Q0, polynomial({"1": rest.Q0}, (n,))).part(rows),
        affine=affine_model((M, G, K), angles, torquers, momenta=form == "momenta"),
    )


def _rows(platform: Platform, gimbals: Sequence[str] | None) -> list[int]:
    names = platform.gimbal_names
    rows = known_names("gimbals", names if gimbals is None else gimbals, names)
    if not rows:
        where = f"platform {platform.name!r} has none" if not names else "given none"
        raise ArgumentError(f"gimbals: {where}; at least one angle must be a coordinate")
    return rows
