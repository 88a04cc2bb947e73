"""Output feedback for a plant w, u -> z, y: the choice of a route, and the check of what it returns.

    w ──►┌───┐──► z
         │ P │
    u ┌─►└───┘──┐ y        u = K y (positive feedback)
      │  ┌───┐  │
      └──┤ K │◄─┘
         └───┘

A route gets a plant whose states, controls, measurements and time are scaled; its result is checked by the closed loop
of the plant as given.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from platform_ctrl.analysis.norms import h2_norm, hinf_norm
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.analysis.system import System
from platform_ctrl.common.arguments import one_of, positive
from platform_ctrl.common.values import value
from platform_ctrl.design import partition as parts
from platform_ctrl.errors import ArgumentError, DesignError, IllPosedError, NotCertifiedError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

HinfMethod = Literal["lmi", "riccati"]
Norm = Literal["hinf", "h2"]

# How much more than the backed-off bound the recomputed norm may be, relative to the bound.
TOLERANCE: dict[Norm, float] = {"hinf": 0.01, "h2": 1e-6}
CURE = "give a larger backoff, the other method, or weights with less spread between slow and fast poles"
# A direct term of a closed loop below this share of what it is the sum of is rounding.
DIRECT_ROUNDING = 1e-9


@value
class Synthesis:
    """A controller with the evidence that it does what is claimed.

    Attributes
    ----------
    plant
        The plant P with inputs [w, u] and outputs [z, y].
    controller
        K, u = K y (positive feedback, as in `control.hinfsyn`).
    closed_loop
        The lower linear fractional transformation of P and K, from w to z.
    gamma, frequency
        Norm of `closed_loop` in units of z per w, recomputed from it, and for the H-infinity norm the frequency of the
        peak, rad/s.
    gamma_optimal
        The least level that the route found, in the same units, from which the controller was backed off; `gamma` where
        that is less.
    backoff
        Relative back-off from the least level.
    level
        What the controller was made for: (1 + backoff) times the least level, in the same units.
    method
        The route.
    poles : complex (n + nK,)
        Poles of the closed loop: rad/s, or in z (dimensionless) where the plant is sampled.
    norm
        Which norm `gamma` is: ``"hinf"`` or ``"h2"``.
    reason
        Why the route was taken; empty where it was requested.
    """

    plant: StateSpace
    controller: StateSpace
    closed_loop: StateSpace
    gamma: float
    frequency: float
    gamma_optimal: float
    backoff: float
    level: float
    method: str
    poles: np.ndarray[Any, Any]
    norm: Norm = "hinf"
    reason: str = ""

    @property
    def spectral_abscissa(self) -> float:
        """Largest real part of the closed-loop poles, rad/s; of ln(z)/T where the plant is sampled. Negative."""
        return float(np.max(continuous_poles(self.poles, float(self.plant.dt or 0.0)).real, initial=-np.inf))


def hinf(
    P: StateSpace,
    nmeas: int,
    ncon: int,
    *,
    method: HinfMethod | None = None,
    backoff: float = 0.02,
    time_limit: float = 60.0,
) -> Synthesis:
    """Full-order H-infinity output feedback, certified by the actual closed loop.

    The plant is scaled, the least gamma is found, a controller is made for ``(1 + backoff)`` times that gamma (at the
    least gamma itself controllers have arbitrarily fast poles), the scaling is undone, and the closed loop with the
    plant as given is measured.

    Parameters
    ----------
    P
        Plant with inputs [w, u] and outputs [z, y], as in `control.hinfsyn`. A sampled one (dt > 0) is carried to the
        w-plane by the bilinear map, which keeps stability and norm, and its controller is sampled, too.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    method
        ``"riccati"``: two Riccati equations (Glover and Doyle 1988), which need D12 and D21 of full rank and no zero on
        the imaginary axis; ``"lmi"``: linear matrix inequalities (Gahinet and Apkarian 1994), any D12, D21 and D11, but
        slower and less accurate. None: Riccati equations, and matrix inequalities where these fail; `reason` says why.
    backoff
        Relative distance from the least gamma, positive.
    time_limit
        Longest time that one call of the LMI solver may take, s.

    Returns
    -------
    Synthesis
        With ``norm = "hinf"``.

    Raises
    ------
    ArgumentError
        P, nmeas, ncon, method or backoff do not make sense.
    NotStabilisableError, IllPosedError
        A mode is out of reach, or an assumption does not hold; the message names it.
    UnscalableError, TimeLimitError, InfeasibleError
        The route failed.
    NotCertifiedError
        The controller does not reach what was promised.

    References
    ----------
    P. Gahinet, P. Apkarian, Int. J. Robust and Nonlinear Control 4, 1994.

    K. Glover, J. C. Doyle, Systems & Control Letters 11, 1988.

    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, 1996, theorem 17.1.

    See docs/methods/full-order.md.

    Examples
    --------
    A lightly damped oscillator: torque disturbance and noise in w, angle and control in z.

    >>> import control
    >>> from platform_ctrl import design
    >>> P = control.ss(
    ...     [[0, 1], [-1, -0.2]],
    ...     [[0, 0, 0], [1, 0, 1]],
    ...     [[1, 0], [0, 0], [1, 0]],
    ...     [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    ... )
    >>> found = design.hinf(P, nmeas=1, ncon=1)
    >>> found.method, round(found.gamma_optimal, 3), found.gamma < 1.02 * found.gamma_optimal
    ('hinf, riccati', 1.445, True)
    """
    if method is not None:
        one_of("hinf: method", method, ("lmi", "riccati"))
    backoff = positive("hinf: backoff", backoff)
    time_limit = positive("hinf: time_limit", time_limit)
    plant = parts.partition(P, nmeas, ncon, sampled=True)
    parts.require_stabilisable(plant, P, "hinf")
    try:
        flat = parts.in_w_plane(plant)
    except ArgumentError:
        raise IllPosedError(
            "hinf: the plant has a pole at z = -1, which the bilinear map sends to infinity; "
            "sample with another period, or close a small gain from y to u first",
            P,
        ) from None

    def by(route: HinfMethod, reason: str = "") -> Synthesis:
        try:
            if route == "lmi":
                from platform_ctrl.design.inequalities import hinf_lmi

                made, least = hinf_lmi(flat, backoff, time_limit, P)
            else:
                from platform_ctrl.design.riccati import hinf_riccati

                made, least = hinf_riccati(flat, backoff, P)
            made = parts.out_of_w_plane(made, plant.dt)
        except (ArgumentError, np.linalg.LinAlgError) as error:
            raise UnscalableError(f"hinf, {route}: {str(error).lower()} within the scaled problem; {CURE}", P) from None
        name = f"hinf, {route}"
        found = certify(P, plant, made, least=least, backoff=backoff, method=name)
        return replace(found, reason=reason)

    if method is not None:
        return by(method)
    try:
        return by("riccati", "the assumptions of the Riccati equations hold")
    except (IllPosedError, UnscalableError, NotCertifiedError) as error:
        refused = error
    try:
        # The error without its advice.
        return by("lmi", str(refused).rpartition(";")[0])
    except DesignError as error:
        raise type(error)(f"{error} (the other route fails, too: {refused})", P) from None


def h2(P: StateSpace, nmeas: int, ncon: int, *, direct: bool = True) -> Synthesis:
    """Full-order H2 output feedback (LQG in its general form), certified by the actual closed loop.

    Parameters
    ----------
    P
        Continuous or sampled plant with inputs [w, u] and outputs [z, y], as in `control.h2syn`. The norm is the rms of
        z for white w of unit density (sampled: unit variance).
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    direct
        Sampled plants: whether u[k] may use y[k]. False gives the best strictly proper controller.

    Returns
    -------
    Synthesis
        With ``norm = "h2"``.

    Raises
    ------
    ArgumentError
        P, nmeas, ncon or an option do not make sense.
    NotStabilisableError, IllPosedError
        A mode is out of reach, or an assumption does not hold; the message names it.
    UnscalableError
        The equations have no accurate solution.
    NotCertifiedError
        The controller does not reach what was promised.
    """
    from platform_ctrl.design.riccati import H2, h2_riccati

    plant = parts.partition(P, nmeas, ncon, sampled=True)
    parts.require_stabilisable(plant, P, "h2")
    made, least = h2_riccati(plant, direct, P)
    return certify(P, plant, made, least=least, backoff=0.0, method=H2, norm="h2")


def certify(
    P: StateSpace,
    plant: parts.Partition,
    controller: System,
    *,
    least: float,
    backoff: float,
    method: str,
    norm: Norm = "hinf",
) -> Synthesis:
    """Close the loop with the plant as given; return the result if it is stable and has the promised norm.

    `least` is the least level that the route found; the norm may exceed ``(1 + backoff) least`` by a share of it.
    """
    if not all(np.all(np.isfinite(matrix)) for matrix in controller[:4]):
        raise NotCertifiedError(f"{method}: the controller is not finite; {CURE}", P)
    try:
        loop = parts.closed_loop(plant, controller)
    except ArgumentError:
        raise NotCertifiedError(f"{method}: I − D_K D22 is singular: the loop is not well posed; {CURE}", P) from None
    poles = np.asarray(np.linalg.eigvals(loop.A), dtype=np.complex128)
    decay = -continuous_poles(poles, plant.dt).real
    if poles.size and not np.min(decay) > 0.0:
        worst = poles[np.argmin(decay)]
        place = ", not within the unit circle" if plant.dt else " rad/s, not within the left half-plane"
        pole = f"{worst.real:.4g}{worst.imag:+.4g}j{place}"
        raise NotCertifiedError(f"{method}: the closed loop has a pole at {pole}; {CURE}", P)
    loop = loop._replace(dt=plant.dt)
    try:
        if norm == "h2":
            gamma, frequency = _h2_norm(loop, plant, controller), float("nan")
        else:
            gamma, frequency = hinf_norm(loop, allow_unstable=True)
    except ArgumentError as error:
        raise NotCertifiedError(f"{method}: no finite H2 norm: {error}; {CURE}", P) from None
    limit = (1 + backoff + TOLERANCE[norm]) * least
    if not gamma <= limit:
        shown = f"the H2 norm {gamma:.6g}" if norm == "h2" else f"the norm {gamma:.6g} at {frequency:.4g} rad/s"
        raise NotCertifiedError(
            f"{method}: the closed loop has {shown}, more than {limit:.6g} for the least gamma {least:.6g}; {CURE}", P
        )
    return Synthesis(
        plant=P,
        controller=parts.controller_system(P, controller),
        closed_loop=parts.closed_loop_system(P, loop),
        gamma=gamma,
        frequency=frequency,
        gamma_optimal=float(min(least, gamma)),
        backoff=float(backoff),
        level=float((1 + backoff) * least),
        method=method,
        poles=poles,
        norm=norm,
    )


def _h2_norm(loop: System, plant: parts.Partition, controller: System) -> float:
    """Return the norm of a closed loop, whose direct term a controller may have cancelled but for rounding."""
    through = np.linalg.norm(plant.D12) * np.linalg.norm(controller.D) * np.linalg.norm(plant.D21)
    if not plant.dt and np.linalg.norm(loop.D) <= DIRECT_ROUNDING * (np.linalg.norm(plant.D11) + through):
        loop = loop._replace(D=np.zeros_like(loop.D))
    return h2_norm(loop)
