"""H-infinity output feedback: partition and scaling of the plant, dispatch to a route, certificate of the result.

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

from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.frozen import FloatArray, value

if TYPE_CHECKING:
    from control import StateSpace

HinfMethod = Literal["lmi", "riccati"]

# Singular values below this share of the largest (of unit columns or rows) count as zero.
RANK_TOLERANCE = 1e-8
# How much more than the backed-off bound the recomputed norm may be, relative to the bound.
NORM_TOLERANCE = 0.01
CURE = "give a larger backoff, the other method, or weights with less spread between slow and fast poles"


@value
class Partition:
    """The matrices of a plant with inputs [w, u] and outputs [z, y]; see `partition`."""

    A: FloatArray
    B1: FloatArray
    B2: FloatArray
    C1: FloatArray
    C2: FloatArray
    D11: FloatArray
    D12: FloatArray
    D21: FloatArray
    D22: FloatArray


@value
class Realisation:
    """A state-space realisation as bare matrices."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


@value
class ScaledPlant:
    """A plant in units where its matrices are near one, and what leads back.

    Attributes
    ----------
    plant
        The scaled plant; its D22 is zero, its D12 (D21) has orthonormal columns (rows) where it has full rank.
    state : (n,)
        x = diag(state) x_scaled.
    rate
        Unit of frequency, rad/s.
    control : (nu, nu)
        u = control @ u_scaled.
    measurement : (ny, ny)
        y_scaled = measurement @ (y − D22 u).
    gain
        gamma = gain * gamma_scaled.
    D22 : (ny, nu)
        The part of the plant that is undone by a loop shift.
    control_rank, measurement_rank
        Ranks of D12 and D21.
    """

    plant: Partition
    state: FloatArray
    rate: float
    control: FloatArray
    measurement: FloatArray
    gain: float
    D22: FloatArray
    control_rank: int
    measurement_rank: int


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


def partition(P: StateSpace, nmeas: int, ncon: int) -> Partition:
    """Split a continuous plant at its last `nmeas` outputs and last `ncon` inputs.

    Raises
    ------
    ArgumentError
        P is not a continuous state-space system with finite matrices, or the numbers do not fit.
    """
    from control import StateSpace

    if not isinstance(P, StateSpace):
        raise ArgumentError(f"plant: given a {type(P).__name__}; expected a control.StateSpace")
    if P.isdtime(strict=True):
        raise ArgumentError(
            f"plant: sampled (dt = {P.dt}); expected a continuous plant, for example in the bilinear w-plane"
        )
    for name, number, total, what in (("nmeas", nmeas, P.noutputs, "outputs"), ("ncon", ncon, P.ninputs, "inputs")):
        if not (isinstance(number, int | np.integer) and 1 <= number < total):
            raise ArgumentError(
                f"plant: {name} = {number!r} of {total} {what}; expected a whole number from 1 to {total - 1}"
            )
    if P.nstates == 0:
        raise ArgumentError("plant: no states; expected a dynamic plant")
    A, B, C, D = (np.asarray(m, dtype=np.float64) for m in (P.A, P.B, P.C, P.D))
    for name, m in zip("ABCD", (A, B, C, D), strict=True):
        if not np.all(np.isfinite(m)):
            raise ArgumentError(f"plant: matrix {name} is not finite; expected finite entries")
    nz, nw = P.noutputs - nmeas, P.ninputs - ncon
    return Partition(
        A=A, B1=B[:, :nw], B2=B[:, nw:], C1=C[:nz], C2=C[nz:],
        D11=D[:nz, :nw], D12=D[:nz, nw:], D21=D[nz:, :nw], D22=D[nz:, nw:],
    )  # fmt: skip


def _unit_controls(B2: FloatArray, D12: FloatArray) -> tuple[FloatArray, int]:
    """S in u = S u' that makes the columns of D12 S orthonormal, or zero where D12 loses rank; and the rank."""
    ncon = D12.shape[1]
    size = np.linalg.norm(D12, axis=0)
    size[size == 0] = 1.0
    S = np.diag(1 / size)
    _, sigma, Vt = np.linalg.svd(D12 @ S, full_matrices=True)
    rank = int(np.sum(sigma > RANK_TOLERANCE))
    S = S @ Vt.T
    # A control that z does not see directly gets its unit from what it does to the states.
    sigma = np.concatenate([sigma[:rank], np.linalg.norm(B2 @ S[:, rank:], axis=0)])
    sigma[sigma == 0] = 1.0
    return S / sigma[:ncon], rank


def autoscale(plant: Partition, gain: float = 1.0) -> ScaledPlant:
    """Scale a plant: D22 shifted out, D12 and D21 to unit columns and rows, time, states; the norm scales by `gain`.

    Time is measured by the geometric mean of the poles' moduli, states by Osborne's balancing of [A B; C 0].
    """
    root = np.sqrt(gain)
    moduli = np.abs(np.linalg.eigvals(plant.A))
    # Poles at 0 come out at the level of rounding, defective ones well above it: they say nothing about time.
    moduli = moduli[moduli > 1e-6 * np.max(moduli, initial=0.0)]
    rate = float(np.exp(np.mean(np.log(moduli)))) if moduli.size else 1.0

    A, B1, C1 = plant.A / rate, plant.B1 / rate / root, plant.C1 / root
    S, control_rank = _unit_controls(plant.B2 / rate, plant.D12 / root)
    St, measurement_rank = _unit_controls(plant.C2.T, plant.D21.T / root)
    B2, D12 = plant.B2 / rate @ S, plant.D12 / root @ S
    C2, D21 = St.T @ plant.C2, St.T @ plant.D21 / root
    # Exactly: what is below the rank tolerance is rounding.
    D12[:, control_rank:] = 0.0
    D21[measurement_rank:] = 0.0

    d = balance(A, np.hstack([B1, B2]), np.vstack([C1, C2]))
    return ScaledPlant(
        plant=Partition(
            A=A / d[:, None] * d, B1=B1 / d[:, None], B2=B2 / d[:, None], C1=C1 * d, C2=C2 * d,
            D11=plant.D11 / gain, D12=D12, D21=D21, D22=np.zeros_like(plant.D22),
        ),
        state=d, rate=rate, control=S, measurement=St.T, gain=gain, D22=plant.D22,
        control_rank=control_rank, measurement_rank=measurement_rank,
    )  # fmt: skip


def balance(A: FloatArray, B: FloatArray, C: FloatArray, sweeps: int = 50) -> FloatArray:
    """Powers of two d, (n,), such that row i of [D⁻¹AD, D⁻¹B] is about as long as column i of [D⁻¹AD; CD], D = diag(d).

    Osborne's iteration with inputs and outputs held fixed. A state that nothing drives or nobody sees keeps its unit.
    """
    n = len(A)
    d = np.ones(n)
    square = (A - np.diag(np.diag(A))) ** 2
    rows, columns = np.sum(B**2, axis=1), np.sum(C**2, axis=0)
    for _ in range(sweeps):
        moved = False
        for i in range(n):
            row = (square[i] @ d**2 + rows[i]) / d[i] ** 2
            column = ((1 / d**2) @ square[:, i] + columns[i]) * d[i] ** 2
            if row == 0 or column == 0:
                continue
            factor = 2.0 ** np.round(0.25 * np.log2(row / column))
            if factor != 1.0:
                d[i] *= factor
                moved = True
        if not moved:
            break
    return d


def unscale(controller: Realisation, scaled: ScaledPlant) -> Realisation:
    """Bring a controller of the scaled plant back to the units of the plant that was given.

    Raises
    ------
    numpy.linalg.LinAlgError
        The loop shift that restores D22 is not well posed.
    """
    A, B = scaled.rate * controller.A, scaled.rate * controller.B @ scaled.measurement
    C, D = scaled.control @ controller.C, scaled.control @ controller.D @ scaled.measurement
    # u = K0 (y − D22 u), K0 the controller for D22 = 0.
    shift = np.linalg.inv(np.eye(len(D)) + D @ scaled.D22)
    return Realisation(
        A=A - B @ scaled.D22 @ shift @ C,
        B=B @ (np.eye(B.shape[1]) - scaled.D22 @ shift @ D),
        C=shift @ C,
        D=shift @ D,
    )


def closed_loop(plant: Partition, K: Realisation) -> Realisation:
    """Lower linear fractional transformation of a plant and u = K y, states [x, xK].

    Raises
    ------
    numpy.linalg.LinAlgError
        The loop is not well posed.
    """
    E = np.linalg.inv(np.eye(len(K.D)) - K.D @ plant.D22)
    # u = E (D_K y0 + C_K xK), y0 = C2 x + D21 w;  y = y0 + D22 u
    Ux, Uk, Uw = E @ K.D @ plant.C2, E @ K.C, E @ K.D @ plant.D21
    return Realisation(
        A=np.block(
            [
                [plant.A + plant.B2 @ Ux, plant.B2 @ Uk],
                [K.B @ (plant.C2 + plant.D22 @ Ux), K.A + K.B @ plant.D22 @ Uk],
            ]
        ),
        B=np.vstack([plant.B1 + plant.B2 @ Uw, K.B @ (plant.D21 + plant.D22 @ Uw)]),
        C=np.hstack([plant.C1 + plant.D12 @ Ux, plant.D12 @ Uk]),
        D=plant.D11 + plant.D12 @ Uw,
    )


def require_stabilisable(plant: Partition, P: StateSpace) -> None:
    """Raise a DesignError that names the mode if (A, B2) is not stabilisable or (A, C2) not detectable."""
    sigma, word, pole = weakest_mode(autoscale(plant))
    if word and sigma < 1e-10:
        verb = "no control u moves" if word == "stabilisable" else "no measurement y sees"
        raise DesignError(
            f"hinf: the plant is not {word}: {verb} the mode at {pole.real:.4g}{pole.imag:+.4g}j rad/s; expected every "
            "mode that is not stable within reach; put such weights inside the loop or shift their poles to the left",
            P,
        )


def weakest_mode(scaled: ScaledPlant) -> tuple[float, str, complex]:
    """Distance of the unstable modes to being lost: (smallest singular value relative to A, the property, the pole).

    The pole is in rad/s. The test of Popov, Belevitch and Hautus on the scaled plant; ``(inf, "", 0)`` where every
    pole is stable.
    """
    plant = scaled.plant
    size = max(1.0, float(np.linalg.norm(plant.A, 2)))
    weakest = (float("inf"), "", 0j)
    for pole in clustered(np.linalg.eigvals(plant.A), size):
        if pole.real < -1e-9 * size:
            continue
        shifted = plant.A - pole * np.eye(len(plant.A))
        for word, pencil in (
            ("stabilisable", np.hstack([shifted, plant.B2])),
            ("detectable", np.vstack([shifted, plant.C2])),
        ):
            sigma = float(np.linalg.svd(pencil, compute_uv=False)[-1]) / size
            if sigma < weakest[0]:
                weakest = (sigma, word, pole * scaled.rate)
    return weakest


def clustered(poles: np.ndarray[Any, Any], size: float) -> list[complex]:
    """Poles, and the means of their clusters: a defective pole scatters, the mean of its copies is accurate."""
    out = [complex(p) for p in poles]
    for p in poles:
        near = poles[np.abs(poles - p) < 1e-3 * size]
        if near.size > 1:
            out.append(complex(np.mean(near)))
    return out


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
