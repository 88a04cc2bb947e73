"""H-infinity controllers by the bounded real inequality: nothing is assumed about D11, D12, D21 and zeros on the axis.

The least γ of inequality (6) of `inequalities` with α = β = γ; at (1 + backoff) times it the X and Y that are farthest
from X Y = I (9), as there the controller has arbitrarily fast poles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.design.lmi.inequalities import LinearLoop, balancing, cp, in_states, solve
from platform_ctrl.design.partition import Partition, closed_loop
from platform_ctrl.design.scaling import ScaledPlant, autoscale, unscale, weakest_mode
from platform_ctrl.errors import DesignError, TimeLimitError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "hinf, lmi"
CURE = 'give a larger backoff, other weights, or method="riccati"'
# Units of gamma tried until the first solution succeeds; solved again in others until gamma is within 1/8 .. 8.
GAINS, GAMMA_RANGE, MOST_ROUNDS = (1.0, 1e2, 1e-2, 1e4, 1e-4), 8.0, 6
# Tolerances of the first solution, which finds the states, and of the others.
ROUGH, FINE = 1e-4, 1e-7
# Largest separation; X and Y may grow to this mean, and by this factor, for it.
SEPARATION, LARGEST_MEAN, ROOM = 10.0, 100.0, 10.0
# Distance of the inequalities from zero in the last step, relative to gamma and the back-off, tried in turn.
STRICTNESS = (5e-3, 5e-4, 5e-5)


def hinf_lmi(
    plant: Partition, backoff: float, time_limit: float, P: StateSpace
) -> tuple[System, float, dict[str, float]]:
    """Return the controller in the units of `plant`, the least gamma, and figures of merit (scaled)."""

    def minimised(p: Partition, tolerance: float) -> tuple[LinearLoop, float]:
        loop, gamma = LinearLoop(p, direct=True), cp.Variable()
        problem = cp.Problem(cp.Minimize(gamma), [loop.V >> 0, _bounded(loop, gamma)])
        solve(problem, f"{WHERE}: minimising gamma", CURE, time_limit, tolerance, P)
        return loop, float(gamma.value)

    scaled, loop = _near_one(plant, minimised, P)
    failure: DesignError | None = None
    T = np.eye(len(plant.A))
    for strictness in STRICTNESS:
        try:
            T = T @ balancing(loop.X.value, loop.Y.value)
            p = in_states(scaled.plant, T)
            loop, least = minimised(p, FINE)
            last, t = LinearLoop(p, direct=True), cp.Variable()
            level = (1.0 + backoff) * least
            margin = strictness * min(backoff, 0.02) * level
            # In balanced states X = Y.
            room = max(LARGEST_MEAN, ROOM * float(np.sqrt(np.trace(loop.X.value @ loop.Y.value) / len(T))))
            inequalities = [_bounded(last, level, margin), last.separated(t), t <= SEPARATION, last.size() <= room]
            step = f"{WHERE}: separating X and Y at gamma = {level * scaled.gain:.6g}"
            solve(cp.Problem(cp.Maximize(t), inequalities), step, CURE, time_limit, FINE, P)
            made = last.controller()
            if not np.linalg.eigvals(closed_loop(p, made).A).real.max() < 0.0:
                raise UnscalableError(f"{WHERE}: the controller of the solver's X and Y is not stable; {CURE}", P)
        except TimeLimitError:
            raise
        except (DesignError, np.linalg.LinAlgError) as error:
            own = error if isinstance(error, DesignError) else UnscalableError(f"{WHERE}: {error}; {CURE}", P)
            failure = failure or own
            continue
        residual = {"separation of X and Y": float(t.value)}
        return unscale(made, scaled), least * scaled.gain, residual
    assert failure is not None
    raise failure


def _bounded(loop: LinearLoop, gamma: Any, margin: float = 0.0) -> Any:
    nz, nw = loop.plant.D11.shape
    return loop.hinf_below(range(nw), range(nz), gamma, gamma, margin)


def _near_one(plant: Partition, minimised: Any, P: StateSpace) -> tuple[ScaledPlant, LinearLoop]:
    """Return the plant in units in which the least gamma is near one, and a first solution."""
    failure: DesignError | None = None
    for first in GAINS:
        gain = first
        try:
            for _ in range(MOST_ROUNDS):
                scaled = autoscale(plant, gain)
                loop, gamma = minimised(scaled.plant, ROUGH)
                if 1 / GAMMA_RANGE <= gamma <= GAMMA_RANGE:
                    break
                # Far from one, gamma is inaccurate: a limited step.
                gain *= float(np.clip(gamma, 1e-3, 1e6))
            return scaled, loop
        except TimeLimitError:
            raise
        except DesignError as error:
            failure = failure or error
    assert failure is not None
    sigma, word, pole = weakest_mode(autoscale(plant))
    hint = f"; the mode at {pole.real:.4g}{pole.imag:+.4g}j rad/s is hardly {word}" if word and sigma < 1e-4 else ""
    raise type(failure)(f"{failure}{hint}", P) from None
