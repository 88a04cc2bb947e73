"""H-infinity output feedback: dispatch to a route, and the certificate of what it returns.

    w ──►┌───┐──► z
         │ P │
    u ┌─►└───┘──┐ y        u = K y, no hidden sign
      │  ┌───┐  │
      └──┤ K │◄─┘
         └───┘

No route sees SI units: it gets a plant whose states, controls, measurements and time are scaled, and what it returns
is judged by the closed loop of the plant that was given.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from platform_ctrl.design.partition import Partition, Realisation, closed_loop, partition
from platform_ctrl.design.scaling import require_stabilisable
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.frozen import value

if TYPE_CHECKING:
    from control import StateSpace

HinfMethod = Literal["lmi", "riccati"]

# How much more than the backed-off bound the recomputed norm may be, relative to the bound.
NORM_TOLERANCE = 0.01
CURE = "give a larger backoff, the other method, or weights with less spread between slow and fast poles"


@value
class Synthesis:
    """A controller with the evidence that it does what is claimed.

    Attributes
    ----------
    plant
        The plant P with inputs [w, u] and outputs [z, y].
    nmeas, ncon
        Number of measurements y and of controls u.
    controller
        K, u = K y (positive feedback, as in `control.hinfsyn`).
    closed_loop
        The lower linear fractional transformation of P and K, from w to z.
    gamma, frequency
        H-infinity norm of `closed_loop`, recomputed from it, and the frequency of the peak, rad/s.
    gamma_optimal
        The bound that was backed off from: the least gamma that the route found.
    backoff
        Relative back-off: the controller was made for (1 + backoff) gamma_optimal.
    method
        The route.
    poles : (n + nK,)
        Poles of the closed loop, rad/s.
    residual
        Figures of merit of the route by name, in scaled units.
    """

    plant: StateSpace
    nmeas: int
    ncon: int
    controller: StateSpace
    closed_loop: StateSpace
    gamma: float
    frequency: float
    gamma_optimal: float
    backoff: float
    method: str
    poles: np.ndarray[Any, Any]
    residual: dict[str, float]

    @property
    def spectral_abscissa(self) -> float:
        """Largest real part of the closed-loop poles, rad/s; negative."""
        return float(np.max(self.poles.real, initial=-np.inf))


def hinf(
    P: StateSpace,
    nmeas: int,
    ncon: int,
    *,
    method: HinfMethod = "lmi",
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
        Continuous plant with inputs [w, u] and outputs [z, y], as in `control.hinfsyn`.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    method
        ``"lmi"``: linear matrix inequalities (Gahinet and Apkarian 1994), any D12, D21 and D11;
        ``"riccati"``: two Riccati equations (Glover and Doyle 1988), faster, D12 and D21 of full rank.
    backoff
        Relative distance from the least gamma, positive.
    time_limit
        Longest time that one call of the LMI solver may take, s.

    Returns
    -------
    Synthesis

    Raises
    ------
    ArgumentError
        P, nmeas, ncon, method or backoff do not make sense.
    DesignError
        An assumption does not hold (the message names it), the solver failed, or the controller does not reach
        what was promised.
    """
    if not (np.isfinite(backoff) and backoff > 0):
        raise ArgumentError(f"hinf: backoff = {backoff!r}; expected a positive number such as 0.02")
    if not time_limit > 0:
        raise ArgumentError(f"hinf: time_limit = {time_limit!r}; expected a positive number of seconds")
    plant = partition(P, nmeas, ncon)
    require_stabilisable(plant, P)
    if method not in ("lmi", "riccati"):
        raise ArgumentError(f"hinf: method = {method!r}; expected 'lmi' or 'riccati'")
    try:
        if method == "lmi":
            from platform_ctrl.design.hinf_lmi import hinf_lmi

            made, optimal, residual = hinf_lmi(plant, backoff, time_limit, P)
        else:
            from platform_ctrl.design.hinf_riccati import hinf_riccati

            made, optimal, residual = hinf_riccati(plant, backoff, P)
    except np.linalg.LinAlgError as error:
        raise DesignError(f"hinf, {method}: {str(error).lower()} within the scaled problem; {CURE}", P) from None
    return certify(P, plant, made, gamma_optimal=optimal, backoff=backoff, method=f"hinf, {method}", residual=residual)


def certify(
    P: StateSpace,
    plant: Partition,
    controller: Realisation,
    *,
    gamma_optimal: float,
    backoff: float,
    method: str,
    residual: dict[str, float],
) -> Synthesis:
    """Close the loop with the plant as given; return the result only if it is stable and its norm is what was promised.

    Raises
    ------
    DesignError
        The loop is not well posed, not stable, or its norm exceeds ``(1 + backoff + 0.01) gamma_optimal``.
    """
    import control

    from platform_ctrl.analysis.norms import hinf_norm

    try:
        loop = closed_loop(plant, controller)
    except np.linalg.LinAlgError:
        raise DesignError(f"{method}: I − D_K D22 is singular, the loop is not well posed; {CURE}", P) from None
    if not all(np.all(np.isfinite(m)) for m in (loop.A, loop.B, loop.C, loop.D)):
        raise DesignError(f"{method}: the controller is not finite; {CURE}", P)
    poles = np.linalg.eigvals(loop.A)
    worst = poles[np.argmax(poles.real)] if poles.size else complex(-np.inf)
    if not worst.real < 0:
        raise DesignError(
            f"{method}: the closed loop has a pole at {worst.real:.4g}{worst.imag:+.4g}j rad/s; "
            f"expected all in the left half-plane; {CURE}",
            P,
        )
    u, y = P.input_labels[-plant.B2.shape[1] :], P.output_labels[-plant.C2.shape[0] :]
    w, z = P.input_labels[: -len(u)], P.output_labels[: -len(y)]
    system = control.StateSpace(loop.A, loop.B, loop.C, loop.D, inputs=w, outputs=z)
    try:
        gamma, frequency = hinf_norm(system)
    except ArgumentError:
        raise DesignError(
            f"{method}: the closed loop is on the boundary of stability; expected it stable; {CURE}", P
        ) from None
    limit = (1 + backoff + NORM_TOLERANCE) * gamma_optimal
    if not gamma <= limit:
        raise DesignError(
            f"{method}: the closed loop has the norm {gamma:.6g} at {frequency:.4g} rad/s; "
            f"expected at most {limit:.6g} for the least gamma {gamma_optimal:.6g}; {CURE}",
            P,
        )
    return Synthesis(
        plant=P,
        nmeas=len(y),
        ncon=len(u),
        controller=control.StateSpace(controller.A, controller.B, controller.C, controller.D, inputs=y, outputs=u),
        closed_loop=system,
        gamma=float(gamma),
        frequency=float(frequency),
        gamma_optimal=float(gamma_optimal),
        backoff=float(backoff),
        method=method,
        poles=poles,
        residual=dict(residual),
    )
