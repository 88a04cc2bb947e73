"""The coupled limits held against the nominal plant with all loops closed, fast enough for a slider that moves."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.mu import mu_bounds
from platform_ctrl.analysis.norms import noise_rms
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.app.free_plants import Sensitivity, StabilisedLoop, disk_margins, loop_grid, used_arrays
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.verification.coupled import (
    coupled_plant,
    coupled_results,
    one_controller,
    one_way_plant,
    sensed_rates,
)

if TYPE_CHECKING:
    import control

# Relative tolerance of the structured singular value on a grid.
_MU = 1e-4
# Damping of poles at which is looked besides.
_NARROW = 0.02

# What a caging loop's margins are without the platform's reaction: the same while the servo moves.
Kept = Callable[[str, Callable[[], dict[str, float]]], dict[str, float]]


def requirements(
    loop: StabilisedLoop,
    kept: Kept,
    known: tuple[ComplexArray, FloatArray, Sensitivity, ComplexArray] | None = None,
) -> tuple[CheckResult, ...]:
    """Return the coupled limits held against the nominal plant, as `coupled_check` does.

    The simultaneous margin alone is not proved: it is the least at some frequencies, those of narrow poles among them,
    and lies within about a thousandth of what `coupled_check` proves. `known` are the nominal closed loop's poles, a
    grid, its sensitivity, and that on the grid, where they are at hand.
    """
    job, model, controllers = loop.job, loop.model, loop.controllers
    K, at, torquers = loop.joined(loop.plants)
    P = used_arrays(loop.plants.arrays, 0, at)
    A, B, C, D, _ = closed_loop(P, K)
    s = continuous_poles(poles(A), P.dt) if known is None else known[0]
    decay = -float(spectral_abscissa(s))
    m = len(torquers)
    sensors = {one.name: one for one in job.platform.sensors}
    rms = np.array([sensors[name].sampled_noise(P.dt) for name in loop.plants.sensors])
    noise = noise_rms(StateArrays(A, B[:, m:], C[:m], D[:m, m:], P.dt), rms, allow_unstable=True)
    coupled, simultaneous = np.zeros(m), (0.0, 0.0)
    if decay > 0.0:
        grid, sensitivity = (loop_grid(P, s), Sensitivity(P, K)) if known is None else known[1:3]
        S = sensitivity.at(grid) if known is None else known[3]
        coupled = disk_margins(P, K, range(m))
        closed = StateArrays(A, B[:, :m], C[:m], D[:m, :m] + 0.5 * np.eye(m), P.dt)
        simultaneous = _simultaneous(sensitivity, grid, S, closed, s)
    decoupled = _decoupled(job, model, controllers, kept)
    alone = np.array([decoupled[name] for name in torquers])
    cost = np.where(alone > 0.0, 1.0 - coupled / np.maximum(alone, np.finfo(float).tiny), np.inf)
    return coupled_results(job, decay, torquers, cost, simultaneous, noise, proved=False)


def _decoupled(job: Job, model: LinearModel, controllers: Sequence[control.StateSpace], kept: Kept) -> dict[str, float]:
    gimbal = {t.name for t in job.platform.torquers if t.gimbal is not None}
    caging = [K for K in controllers if set(K.output_labels) <= gimbal]

    def of_caging() -> dict[str, float]:
        return _margins_of(coupled_plant(job, model, caging), caging, job, set()) if caging else {}

    def of_servo() -> dict[str, float]:
        return _margins_of(one_way_plant(job, model, sensed_rates(job, controllers)), controllers, job, set(inner))

    inner = kept("caging", of_caging)
    return of_servo() | inner


def _margins_of(
    plant: control.StateSpace, controllers: Sequence[control.StateSpace], job: Job, left_out: set[str]
) -> dict[str, float]:
    """Return the disk margin of every channel broken alone, by torquer; 0 where the loop is not stable."""
    K = one_controller(job, controllers, plant)
    names = list(K.output_labels)
    at = [plant.input_labels.index(name) for name in names]
    seen = [plant.output_labels.index(name) for name in K.input_labels]
    arrays, k = state_arrays(plant, "plant"), state_arrays(K, "controller")
    P = StateArrays(arrays.A, arrays.B[:, at], arrays.C[seen], arrays.D[np.ix_(seen, at)], arrays.dt)
    s = continuous_poles(poles(closed_loop(P, k).A), P.dt)
    if not spectral_abscissa(s) < 0.0:
        return dict.fromkeys(names, 0.0)
    chosen = [j for j, name in enumerate(names) if name not in left_out]
    return {names[j]: float(x) for j, x in zip(chosen, disk_margins(P, k, chosen), strict=True)}


def _simultaneous(
    sensitivity: Sensitivity, grid: FloatArray, S: ComplexArray, closed: StateArrays, s: ComplexArray
) -> tuple[float, float]:
    """Return both bounds of the simultaneous disk margin: the grid every third point, then around the worst.

    At narrow poles `s`, which the grid leaves out, from the closed loop's own states: (S − T)/2 is `closed`.
    """
    half = 0.5 * np.eye(S.shape[-1])
    coarse = np.arange(0, len(grid), 3)
    k = int(coarse[int(np.argmax(mu_bounds(S[coarse] - half, 1e-3).upper))])
    best = _climbed(lambda w: sensitivity.at(w) - half, grid[max(k - 3, 0)], grid[min(k + 3, len(grid) - 1)])
    narrow = s[np.isfinite(s) & (s.imag > 0.0) & (np.abs(s.real) < _NARROW * s.imag)]
    if narrow.size:

        def response(w: FloatArray) -> ComplexArray:
            return frequency_response(closed, np.minimum(w, math.pi / closed.dt), -3)

        one = narrow[int(np.argmax(mu_bounds(response(narrow.imag), 1e-3).upper))]
        best = max(best, _climbed(response, one.imag + 2.0 * one.real, one.imag - 2.0 * one.real))
    upper, lower = best
    return 1.0 / upper, 1.0 / lower if lower > 0.0 else math.inf


def _climbed(of: Callable[[FloatArray], ComplexArray], low: float, high: float) -> tuple[float, float]:
    """Return both bounds of the largest mu between two frequencies."""
    best = (0.0, 0.0)
    for _ in range(3):
        w = np.linspace(low, high, 9)
        found = mu_bounds(of(w), _MU)
        j = int(np.argmax(found.upper))
        best = max(best, (float(found.upper[j]), float(found.lower[j])))
        low, high = w[max(j - 1, 0)], w[min(j + 1, 8)]
    return best
