"""The picture of the free platform with all loops closed: curves and coupled requirements."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays
from platform_ctrl.analysis.feedback import closed_loop, sensitivity_functions
from platform_ctrl.analysis.mu import mu_bounds
from platform_ctrl.analysis.norms import noise_rms
from platform_ctrl.analysis.poles import continuous_poles, minimum_damping, poles, spectral_abscissa
from platform_ctrl.analysis.resolvent import ON_A_GRID
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.app.curves import (
    POINTS,
    Band,
    Measured,
    Parts,
    channel_margins,
    channel_response,
    degrees,
    frequency_parts,
    gain_locus,
    held_responses,
    locus,
    moved_by_gain,
    sample_times,
    settling,
    step_size,
    time_response,
)
from platform_ctrl.app.free_plants import (
    ATTITUDE,
    FreePlants,
    Sensitivity,
    StabilisedLoop,
    disk_margins,
    loop_grid,
    used_arrays,
)
from platform_ctrl.app.pictures import Drawn, FrequencyGain, Locus, Margins, Overlay, TimeResponse
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import DesignError
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


def turning(
    loop: StabilisedLoop,
    settings: Settings,
    K: StateArrays,
    at: list[int],
    grid: FloatArray,
    s: ComplexArray,
    stable: bool,
    banded: bool,
) -> tuple[TimeResponse, FrequencyGain]:
    """Return how a torque on the platform turns it: over time after a step, and over the frequencies of `grid`."""
    axis, period = settings.axis, loop.shown.period
    size, title, limit = _acting(loop, axis)
    slow = s[np.isfinite(s) & (np.abs(s) < math.pi / period)]
    t, every = sample_times(settling(slow, 50.0 / period, period, stable), period, POINTS)
    u = np.full(every * (len(t) - 1) + 1, size)
    torquers = [loop.shown.torquers[k] for k in at]
    step = time_response(
        loop.job.platform,
        title,
        t,
        (*ATTITUDE, *loop.shown.sensors, *torquers),
        (*_angle_units(loop), *("N m" for _ in torquers)),
        (
            _responses(loop.shown, K, at, axis, u, every)[0],
            _responses(loop.plants, K, at, axis, u, every) if banded else None,
        ),
        np.ones(len(t)),
        limit,
    )
    m, p, k = len(loop.shown.torquers), len(loop.shown.sensors), len(at)
    column = slice(m + axis - 1, m + axis)

    def attitude(one: int, w: FloatArray, plants: FreePlants) -> FloatArray:
        A, B, C, D, dt = plants.turned
        a, b, c, d, _ = closed_loop(
            StateArrays(A[one], B[one], C[one], D[one], K.dt), K, torques=at, angles=list(range(p))
        )
        found = frequency_response(StateArrays(a, b[:, column], c[k + p :], d[k + p :, column], dt), w, -3, ON_A_GRID)
        return np.asarray(np.linalg.norm(found[..., 0], axis=-1))

    none = np.zeros(0)
    w_band, low_gain, high_gain = none, none, none
    if banded:
        w_band = loop.plants.frequency
        whole = loop.plants.response
        # What acts moves the sensors, these the torques, and both the attitude.
        k_at = frequency_response(K, w_band, -3, ON_A_GRID)
        seen, acting = whole[..., :p, at], whole[..., :p, column]
        torque = np.linalg.solve(np.eye(k) - k_at @ seen, k_at @ acting)
        moved = whole[..., p:, column] + whole[..., p:, at] @ torque
        gains = np.linalg.norm(moved[..., 0], axis=-1)
        low_gain, high_gain = gains.min(axis=0), gains.max(axis=0)
    return step, FrequencyGain(
        title=f"torque M{axis} on the platform → attitude",
        unit="rad/(N m)",
        frequency=grid,
        gain=attitude(0, grid, loop.shown),
        band_frequency=w_band,
        low=low_gain,
        high=high_gain,
    )


def rate_step(
    loop: StabilisedLoop, settings: Settings, K: StateArrays, at: list[int], s: ComplexArray, stable: bool, banded: bool
) -> TimeResponse:
    """The attitude after an impulse of torque that would turn the free platform by 1 mrad/s about the axis."""
    axis, period = settings.axis, loop.shown.period
    t, every = sample_times(settling(s, 50.0 / period, period, stable), period, POINTS)
    u = np.zeros(every * (len(t) - 1) + 1)
    u[0] = 1e-3 * float(loop.model.root_inertia[axis - 1, axis - 1]) / period
    kept = slice(0, 3 + len(loop.shown.sensors))
    drive = np.zeros(len(t))
    drive[0] = 1.0
    return time_response(
        loop.job.platform,
        f"impulse of torque: 1 mrad/s about axis {axis}",
        t,
        (*ATTITUDE, *loop.shown.sensors),
        _angle_units(loop),
        (
            _responses(loop.shown, K, at, axis, u, every)[0][kept],
            _responses(loop.plants, K, at, axis, u, every)[:, kept] if banded else None,
        ),
        drive,
    )


def _angle_units(loop: StabilisedLoop) -> tuple[str, ...]:
    """Return the units of the attitude and of the sensors."""
    angles = loop.job.platform.angle_names
    return ("rad",) * 3 + tuple("rad" if name in angles else "rad/s" for name in loop.shown.sensors)


def _responses(plants: FreePlants, K: StateArrays, at: list[int], axis: int, u: FloatArray, every: int) -> FloatArray:
    """Return attitude (3), angles and torques after a torque on the platform about `axis`."""
    m, p = len(plants.torquers), len(plants.sensors)
    a, b, c, d, _ = closed_loop(plants.turned, K, torques=at, angles=list(range(p)))
    k = len(at)
    order = [*range(k + p, k + p + 3), *range(k, k + p), *range(k)]
    column = slice(m + axis - 1, m + axis)
    return held_responses(a, b[..., column], c[..., order, :], d[..., order, column], u, every)


def _acting(loop: StabilisedLoop, axis: int) -> tuple[float, str, float | None]:
    """Return the torque step of the job's stabilised manoeuvre about an axis, or one that the torquer can hold."""
    for one in loop.job.manoeuvres:
        if one.mode == "stabilised" and one.axis == axis and one.torque:
            return one.torque, one.name, one.limits.get("attitude")
    limits = [t.limit for t in loop.job.platform.torquers if t.root_axis == axis]
    size = step_size(math.inf if not limits or limits[0] is None else limits[0])
    return size, f"{1e3 * size:g} mN m step about axis {axis}", None


def stabilised_parts(loop: StabilisedLoop, settings: Settings, kept: Kept) -> Parts:
    """Return what is drawn for the free platform, and what measures it."""
    K, at, torquers = loop.joined(loop.shown)
    roots, name = _roots(loop, settings, torquers)
    channel = torquers.index(name)
    P = used_arrays(loop.shown.arrays, 0, at)
    z = poles(closed_loop(P, K).A)
    s = continuous_poles(z, P.dt)
    stable = bool(spectral_abscissa(s) < 0.0)
    grid = np.union1d(loop_grid(P, s), loop.plants.frequency)
    sensitivity = Sensitivity(P, K)
    S = sensitivity.at(grid)
    response = channel_response(S, channel)
    banded = bool(settings.band and len(loop.plants.labels) > 1)
    every = _set_poles(loop, K, at) if banded else s[None]
    channel_own = channel_margins(grid, response, stable)
    reference = max(channel_own.crossover or 1.0, 1.0)
    at_rest = settings.plant == loop.plants.labels[0] and not any(settings.Omega)
    inside = bool(np.all(spectral_abscissa(every) < 0.0)) if banded else stable
    band, worst, worst_plant = _band(loop, K, at, channel) if banded else (None, math.inf, settings.plant)
    bode, nichols = frequency_parts(
        name, grid, response, math.pi / P.dt, settings.plant, band, loop.job.coupled.disk_margin
    )
    step, low_frequency = turning(loop, settings, K, at, grid, s, stable, banded)

    def measured() -> Measured:
        own = float(disk_margins(P, K, [channel])[0]) if stable else 0.0
        return Measured(
            margins=Margins(
                disk=own,
                worst_disk=min(own, worst) if inside else 0.0,
                worst_plant=worst_plant if worst < own else settings.plant,
                worst_sampled=banded,
                **channel_own._asdict(),
                bandwidth=_bandwidth(grid, S, [torquers.index(one) for one in roots]) if stable else 0.0,
                damping=float(minimum_damping(z[None], 0.1 * reference, P.dt)[0]),
            ),
            requirements=requirements(loop, kept, (s, grid, sensitivity, S) if at_rest else None),
        )

    drawn = Drawn(
        bode=bode,
        nichols=nichols,
        locus=_locus(loop, P, K, s, every, reference),
        step=step,
        Omega_time=rate_step(loop, settings, K, at, s, stable, banded),
        Omega_frequency=low_frequency,
        bandwidth=None,
        stable=stable,
        all_stable=inside,
    )
    return drawn, measured


def stabilised_overlay(
    loop: StabilisedLoop, settings: Settings, method: str, frequency: FloatArray, kept: Kept | None = None
) -> Overlay:
    """Return what is drawn of another servo, over the picture with the bode diagram at `frequency`.

    Its limits are measured with `kept` alone.
    """
    K, at, torquers = loop.joined(loop.shown)
    _, name = _roots(loop, settings, torquers)
    P = used_arrays(loop.shown.arrays, 0, at)
    s = continuous_poles(poles(closed_loop(P, K).A), P.dt)
    stable = bool(spectral_abscissa(s) < 0.0)
    response = channel_response(Sensitivity(P, K).at(frequency), torquers.index(name))
    step, over_frequency = turning(loop, settings, K, at, frequency, s, stable, False)
    return Overlay(
        design=settings.design,
        method=method,
        response=response,
        magnitude=np.abs(response),
        phase=degrees(response),
        poles=s,
        step=step,
        Omega_step=rate_step(loop, settings, K, at, s, stable, False),
        Omega_gain=over_frequency.gain,
        requirements=() if kept is None else requirements(loop, kept),
    )


def _roots(loop: StabilisedLoop, settings: Settings, torquers: tuple[str, ...]) -> tuple[list[str], str]:
    """Return the torquers on the platform that are set, and the one at which the loop is shown broken."""
    roots = [t.name for t in loop.job.platform.torquers if t.root_axis is not None and t.name in torquers]
    if not roots:
        raise DesignError(f"{loop.spec.name}: no controller sets a torque on the platform; expected a servo")
    return roots, settings.channel if settings.channel in roots else roots[0]


def _band(loop: StabilisedLoop, K: StateArrays, at: list[int], channel: int) -> tuple[Band, float, str]:
    """Return the loops of all plants broken at a channel, and the least of their margins there with its plant."""
    w = loop.plants.frequency
    S = sensitivity_functions(
        -frequency_response(K, w, -3) @ loop.plants.response[..., : len(loop.plants.sensors), at]
    )[0]
    peaks = np.abs(S[..., channel, channel] - 0.5).max(axis=-1)
    k = int(np.argmax(peaks))
    return Band(loop.plants.labels, w, channel_response(S, channel)), 1.0 / float(peaks[k]), loop.plants.labels[k]


def _set_poles(loop: StabilisedLoop, K: StateArrays, at: list[int]) -> ComplexArray:
    A, B, C, D, dt = loop.plants.arrays
    return continuous_poles(poles(closed_loop(StateArrays(A, B[..., at], C, D[..., at], K.dt), K).A), dt)


def _locus(
    loop: StabilisedLoop, P: StateArrays, K: StateArrays, s: ComplexArray, poles: ComplexArray, crossover: float
) -> Locus:
    """The servo's gain varies on all root axes; the caging loops stay closed as they are."""
    roots = {t.name for t in loop.job.platform.torquers if t.root_axis is not None}
    names = loop.joined(loop.shown)[2]
    moving = np.array([name in roots for name in names])
    inner = StateArrays(K.A, K.B, np.where(moving[:, None], 0.0, K.C), np.where(moving[:, None], 0.0, K.D), K.dt)
    # Both halves read the same states of the controller: close the inner rows first, then the rest as feedback.
    A, B, _, _, _ = closed_loop(P, inner)
    m = P.B.shape[1]
    feedback = np.hstack([K.D @ P.C, K.C]) * moving[:, None]
    if P.D.any():
        branches = gain_locus(P, K, points=32)
    else:
        closed = StateArrays(A, B[:, :m], feedback, np.zeros((m, m)), P.dt)
        static = StateArrays(np.zeros((0, 0)), np.zeros((0, m)), np.zeros((m, 0)), np.eye(m), P.dt)
        branches = gain_locus(closed, static, points=32)
    nyquist = math.pi / P.dt
    found = locus(branches, s, poles.ravel(), min(8.0 * crossover, nyquist), nyquist, None)
    return dataclasses.replace(found, draggable=found.draggable & moved_by_gain(*branches, s))


def _bandwidth(grid: FloatArray, S: ComplexArray, rows: list[int]) -> float:
    """Lowest frequency at which the largest singular value of S on the root axes reaches 1/sqrt(2), rad/s."""
    sizes = np.linalg.norm(S[:, rows][:, :, rows], 2, axis=(-2, -1))
    above = np.flatnonzero(sizes >= math.sqrt(0.5))
    return float(grid[above[0]]) if above.size else float(grid[-1])
