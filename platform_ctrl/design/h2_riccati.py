"""H2 synthesis by two Riccati equations: the optimal controller is state feedback on the optimal estimate.

Continuous plants as in Zhou, Doyle and Glover, Robust and Optimal Control (1996), section 14.5, with a direct path
D11 that a static gain can cancel; sampled plants with the estimate of the present state and disturbance, so that u[k]
uses y[k]. The problem is solved in scaled units and checked by the closed loop of the plant as given.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Partition, partition
from platform_ctrl.design.riccati import Equation, Solution, riccati_solution
from platform_ctrl.design.scaling import autoscaled_with_gain, require_assumptions, require_stabilisable, unscale
from platform_ctrl.design.synthesis import Synthesis, certify, or_regularised
from platform_ctrl.errors import IllPosedError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "h2, riccati"
# The recomputed norm may exceed the optimum by this share.
TOLERANCE = 1e-6
# A direct path below this share of D11 counts as zero.
NO_DIRECT_PATH = 1e-10


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
    plant = partition(P, nmeas, ncon, sampled=True)
    require_stabilisable(plant, P, "h2")
    made, least, residual = or_regularised(partial(_optimal, direct=direct, P=P), plant, regularise, "norm")
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


def _optimal(plant: Partition, direct: bool, P: StateSpace) -> tuple[System, float, dict[str, float]]:
    """Return the controller in the units of `plant`, the least norm, and the residuals (scaled).

    Of a sampled plant present state and disturbance are estimated as x̂ + Y C2' S⁻¹ e and D21' S⁻¹ e, with S the
    covariance of the innovation e = y − C2 x̂; u is the state feedback F and the disturbance feedback F0 of these.
    """
    scaled = autoscaled_with_gain(plant)
    p, gain = scaled.plant, np.zeros_like(plant.D22.T)
    if not plant.dt:
        require_assumptions(scaled, P, WHERE)
        p, gain = _without_direct_path(p, P)
    try:
        for_X, for_Y = _solutions(p)
    except UnscalableError:
        # Sampled plants need less, but this is what to look at.
        require_assumptions(scaled, P, WHERE)
        raise
    (X, F, W, *_), (Y, Lt, S, *_) = for_X, for_Y
    L = -Lt.T  # the predictor's gain
    square = float(np.trace(p.D11.T @ p.D11 + p.B1.T @ X @ p.B1) + np.trace(W @ F @ Y @ F.T))
    present = np.zeros_like(gain)
    if plant.dt and direct:
        F0 = -np.linalg.solve(W, p.B2.T @ X @ p.B1 + p.D12.T @ p.D11)
        present = np.asarray(np.linalg.solve(S, (F @ Y @ p.C2.T + F0 @ p.D21.T).T).T)
        square -= float(np.trace(W @ present @ S @ present.T))
    # u = F x̂ + present (y − C2 x̂). The gain that cancels D11 is outside the estimator, which counts it as plant.
    into = p.B2 @ present + L
    made = System(p.A + p.B2 @ F - into @ p.C2, into, F - present @ p.C2, present + gain)
    # The norm of a slower system: time is counted in units of 1/rate.
    least = scaled.gain * float(np.sqrt(max(square, 0.0) * scaled.rate))
    residual = {
        f"relative residual of the Riccati equation of {name}": one.relative
        for name, one in zip("XY", (for_X, for_Y), strict=True)
    }
    return unscale(made, scaled), least, residual


def _solutions(p: Partition) -> list[Solution]:
    """Return the solutions of the equations of X and of Y."""
    return [
        riccati_solution(
            Equation(one.A, one.B2, one.C1.T @ one.C1, one.D12.T @ one.D12, one.C1.T @ one.D12, discrete=p.dt > 0),
            f"{WHERE}: the Riccati equation of {name}",
        )
        for name, one in zip("XY", (p, p.dual), strict=True)
    ]


def _without_direct_path(plant: Partition, P: StateSpace) -> tuple[Partition, FloatArray]:
    """Return the plant with the gain D_K closed that cancels D11, and D_K; D12 and D21 are orthonormal."""
    gain = -plant.D12.T @ plant.D11 @ plant.D21.T
    closed = plant.with_gain(gain)
    rest = closed.D11
    if np.linalg.norm(rest) > NO_DIRECT_PATH * np.linalg.norm(plant.D11):
        z, w = np.unravel_index(int(np.argmax(np.abs(rest))), rest.shape)
        raise IllPosedError(
            f"{WHERE}: the H2 norm is infinite: no gain from y to u cancels the direct path D11 from "
            f"{P.input_labels[int(w)]} to {P.output_labels[int(z)]}; put a low-pass on that w or z",
            P,
        )
    return dataclasses.replace(closed, D11=np.zeros_like(rest)), gain
