"""H2 synthesis by two Riccati equations: the optimal controller is state feedback on the optimal estimate.

Continuous plants as in Zhou, Doyle and Glover, Robust and Optimal Control (1996), section 14.5, with a direct path
D11 that a static gain can cancel; sampled plants with the estimate of the present state and disturbance, so that u[k]
uses y[k]. The problem is solved in scaled units and checked by the closed loop of the plant as given.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Partition, in_w_plane, partition
from platform_ctrl.design.riccati.equations import Equation, relative_residual, riccati_solution
from platform_ctrl.design.scaling import (
    ScaledPlant,
    autoscale,
    autoscaled_with_gain,
    regularised_and_report,
    require_full_rank,
    require_no_zero_on_axis,
    require_stabilisable,
    unscale,
    widened,
    without_direct_path,
    zero_on_axis,
)
from platform_ctrl.design.synthesis import Synthesis, certify, require_regularisation
from platform_ctrl.errors import UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "h2, riccati"
# The recomputed norm may exceed the optimum by this share.
TOLERANCE = 1e-6
NO_SOLUTION = (
    "has no stabilising solution in the scaled units: u or y hardly reaches a mode on the stability boundary, or "
    "a zero is near it; give regularise=1e-3"
)


def h2(
    P: StateSpace,
    nmeas: int,
    ncon: int,
    *,
    direct: bool = True,
    regularise: float | None = None,
) -> Synthesis:
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
    regularise
        As in `hinf`, relative.

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

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, 1996, section 14.5.

    """
    require_regularisation("h2", "riccati", regularise)
    plant = partition(P, nmeas, ncon, sampled=True)
    require_stabilisable(plant, P, "h2")
    try:
        if plant.dt:
            made, least, residual = _sampled(plant, direct, P, regularise)
        else:
            made, least, residual = _continuous(plant, P, regularise)
    except np.linalg.LinAlgError as error:
        raise UnscalableError(
            f"{WHERE}: {str(error).lower()} within the scaled problem; give weights with less spread", P
        ) from None
    return certify(
        P,
        plant,
        made,
        least=least,
        backoff=0.0,
        method=WHERE,
        residual=residual,
        norm="h2",
        tolerance=TOLERANCE,
    )


def _continuous(
    plant: Partition, P: StateSpace, regularise: float | None
) -> tuple[StateArrays, float, dict[str, float]]:
    """Return the controller in the units of `plant`, the least norm, and the residuals (scaled)."""
    scaled, extra = regularised_and_report(
        autoscaled_with_gain(plant), regularise, "norm", lambda less: _optimal(less, P)[1]
    )
    require_full_rank(scaled, P, WHERE)
    made, least, residual = _optimal(scaled, P)
    return unscale(made, scaled), least, extra | residual


def _optimal(scaled: ScaledPlant, P: StateSpace) -> tuple[StateArrays, float, dict[str, float]]:
    """Return the controller of the scaled plant, the least norm in units of the plant as given, and the residuals."""
    p, gain = without_direct_path(scaled.plant, P, WHERE)
    of_X, of_Y = _solutions(p)
    if of_X is None or of_Y is None or zero_on_axis(p) is not None:
        require_no_zero_on_axis(scaled, P, WHERE)
    if of_X is None or of_Y is None:
        raise UnscalableError(f"{WHERE}: the equation of {'Y' if of_X else 'X'} {NO_SOLUTION}", P)
    (X, F, W), (Y, Lt, _) = of_X, of_Y
    square = np.trace(p.B1.T @ X @ p.B1) + np.trace(W @ F @ Y @ F.T)
    # The norm of a slower system: time is counted in units of 1/rate.
    least = scaled.gain * float(np.sqrt(max(square, 0.0) * scaled.rate))
    # D_K is outside the estimator, which counts it as part of the plant.
    made = on_estimate(p.A, p.B2, p.C2, F, -Lt.T, np.zeros_like(gain))._replace(D=gain)
    return made, least, _residuals(p, X, Y)


def on_estimate(
    A: FloatArray, B: FloatArray, C: FloatArray, F: FloatArray, L: FloatArray, present: FloatArray
) -> StateArrays:
    """Return the controller u = F x̂ + `present` (y − C x̂), with x̂ by the predictor's gain L."""
    into = B @ present + L
    return StateArrays(A=A + B @ F - into @ C, B=into, C=F - present @ C, D=present)


def _equations(p: Partition) -> list[Equation]:
    """Return the Riccati equations of X and Y."""
    return [
        Equation(one.A, one.B2, one.C1.T @ one.C1, one.D12.T @ one.D12, one.C1.T @ one.D12, discrete=p.dt > 0)
        for one in (p, p.dual)
    ]


def _solutions(p: Partition) -> list[tuple[FloatArray, FloatArray, FloatArray] | None]:
    """Return X, gain and weight of both equations; None where there is no solution or none is found."""
    out: list[tuple[FloatArray, FloatArray, FloatArray] | None] = []
    for equation in _equations(p):
        try:
            out.append(riccati_solution(equation))
        except np.linalg.LinAlgError:
            out.append(None)
    return out


def _residuals(p: Partition, X: FloatArray, Y: FloatArray) -> dict[str, float]:
    return {
        f"relative residual of the Riccati equation of {name}": relative_residual(equation, V)
        for name, equation, V in zip("XY", _equations(p), (X, Y), strict=True)
    }


def _sampled(
    plant: Partition, direct: bool, P: StateSpace, regularise: float | None
) -> tuple[StateArrays, float, dict[str, float]]:
    """Return the controller in the units of `plant`, the least norm, and the residuals (scaled)."""
    scaled = autoscaled_with_gain(plant)
    found = _optimal_sampled(scaled.plant, direct)
    extra: dict[str, float] = {}
    if found is None and regularise is not None:
        found = _optimal_sampled(_regular(scaled.plant, regularise), direct)
        less = _optimal_sampled(_regular(scaled.plant, 0.1 * regularise), direct)
        extra = {
            "regularisation of controls, measurements and the unit circle": regularise,
            "least norm at a tenth of it": float("nan") if less is None else less[1] * scaled.gain,
        }
    if found is None:
        # Where D12 or D21 of the w-plane loses rank, a zero lies at z = −1.
        flat = autoscale(in_w_plane(plant))
        require_full_rank(flat, P, WHERE)
        require_no_zero_on_axis(flat, P, WHERE)
        raise UnscalableError(f"{WHERE}: an equation {NO_SOLUTION}", P)
    made, least, residual = found
    return unscale(made, scaled), least * scaled.gain, extra | residual


def _optimal_sampled(p: Partition, direct: bool) -> tuple[StateArrays, float, dict[str, float]] | None:
    """Return controller, least norm and residuals of a sampled plant with D22 = 0; None without a solution.

    With S the covariance of the innovation e = y − C2 x̂, present state and disturbance are estimated as
    x̂ + Y C2' S⁻¹ e and D21' S⁻¹ e; u is the state feedback F and the disturbance feedback F0 of these.
    """
    for_X, for_Y = _solutions(p)
    if for_X is None or for_Y is None:
        return None
    (X, F, W), (Y, Lt, S) = for_X, for_Y
    L = -Lt.T  # the predictor's gain
    square = float(np.trace(p.D11.T @ p.D11 + p.B1.T @ X @ p.B1) + np.trace(W @ F @ Y @ F.T))
    present: FloatArray = np.zeros((len(F), len(p.C2)))
    if direct:
        F0 = -np.linalg.solve(W, p.B2.T @ X @ p.B1 + p.D12.T @ p.D11)
        present = np.asarray(np.linalg.solve(S, (F @ Y @ p.C2.T + F0 @ p.D21.T).T).T)
        square -= float(np.trace(W @ present @ S @ present.T))
    made = on_estimate(p.A, p.B2, p.C2, F, L, present)
    return made, float(np.sqrt(max(square, 0.0))), _residuals(p, X, Y)


def _regular(p: Partition, size: float) -> Partition:
    """Return the plant with rows `size` u in z, columns `size` in w for y, and z / (1 + `size`) in place of z.

    Every closed-loop norm from the old w to the old z is at most that of this plant, as in `scaling.regularised`.
    """
    nu, ny, grow = p.B2.shape[1], p.C2.shape[0], 1.0 + size
    p = dataclasses.replace(p, A=grow * p.A, B1=grow * p.B1, B2=grow * p.B2)
    return widened(p, size * np.eye(nu), size * np.eye(ny))
