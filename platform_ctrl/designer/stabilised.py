"""The picture of the loop on a free platform: all caging loops closed, the servo broken at one root torquer."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays
from platform_ctrl.analysis.diagonal_mu import mu_bounds
from platform_ctrl.analysis.feedback import closed_loop_arrays, sensitivities
from platform_ctrl.analysis.joining import joined_arrays
from platform_ctrl.analysis.norms import noise_rms_arrays
from platform_ctrl.analysis.poles import continuous_poles, minimum_damping, pole_arrays, spectral_abscissa
from platform_ctrl.analysis.response import AxisResponse, frequency_response_arrays
from platform_ctrl.check.coupled import coupled_plant, coupled_results, one_controller, one_way_plant, sensed_rates
from platform_ctrl.designer.curves import (
    arrays_of,
    channel_response,
    dense_grid,
    gain_locus,
    held_responses,
    moved_by_gain,
    sample_times,
)
from platform_ctrl.designer.free_plants import ATTITUDE, FreePlants
from platform_ctrl.designer.parts import (
    EDGE,
    POINTS,
    Band,
    Drawn,
    Measured,
    Parts,
    around_in_time,
    channel_margins,
    frequency_parts,
    settling,
    step_size,
)
from platform_ctrl.designer.pictures import FrequencyGain, Locus, Margins, TimeResponse
from platform_ctrl.designer.values import Settings
from platform_ctrl.errors import DesignError
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.job import Job, LoopSpec
from platform_ctrl.linearisation import LinearModel
from platform_ctrl.requirements import CheckResult

if TYPE_CHECKING:
    import control

# Relative tolerance of the structured singular value on a grid.
_MU = 1e-4

# What a caging loop's margins are without the platform's reaction: the same while the servo moves.
Kept = Callable[[str, Callable[[], dict[str, float]]], dict[str, float]]


@value
class StabilisedLoop:
    """All loops of a job closed around the free platform.

    Attributes
    ----------
    job
        With the settings' spins, sampling and range of Omega.
    model
        At rest.
    spec
        The stabilisation loop.
    controllers
        `control.StateSpace` of each loop, in the job's order.
    plants, shown
        The set (the nominal plant alone without a band), and the plant that is shown.
    """

    job: Job
    model: LinearModel
    spec: LoopSpec
    controllers: tuple[control.StateSpace, ...]
    plants: FreePlants
    shown: FreePlants

    def joined(self, plants: FreePlants) -> tuple[StateArrays, list[int], tuple[str, ...]]:
        """Return all controllers as one, the plants' inputs that it sets, and its torquers."""
        used = {name for K in self.controllers for name in K.output_labels}
        torquers = [name for name in plants.torquers if name in used]
        K = joined_arrays(self.controllers, plants.sensors, torquers, plants.period)
        return K, [plants.torquers.index(name) for name in torquers], tuple(torquers)


def stabilised_parts(loop: StabilisedLoop, settings: Settings, kept: Kept) -> Parts:
    """Return what is drawn for the free platform, and what measures it.

    Raises
    ------
    DesignError
        No controller acts on the platform.
    """
    K, at, torquers = loop.joined(loop.shown)
    roots = [t.name for t in loop.job.platform.torquers if t.root_axis is not None and t.name in torquers]
    if not roots:
        raise DesignError(f"{loop.spec.name}: no controller sets a torque on the platform; expected a servo")
    name = settings.channel if settings.channel in roots else roots[0]
    channel = torquers.index(name)
    P = _used(loop.shown.arrays, 0, at)
    closed = closed_loop_arrays(*P[:4], *K[:4])
    z = pole_arrays(closed[0])
    s = continuous_poles(z, P.dt)
    decay = -float(spectral_abscissa(s))
    stable = decay > 0.0
    grid = np.union1d(_grid(P, s), loop.plants.frequency)
    sensitivity = _Sensitivity(P, K)
    S = sensitivity.at(grid)
    response = channel_response(S, channel)
    banded = bool(settings.band and len(loop.plants.labels) > 1)
    poles = _set_poles(loop, K, at) if banded else s[None]
    channel_own = channel_margins(grid, response, stable)
    reference = max(channel_own.crossover or 1.0, 1.0)
    at_rest = settings.plant == loop.plants.labels[0] and not any(settings.Omega)

    inside = bool(np.all(spectral_abscissa(poles) < 0.0)) if banded else stable
    band, worst, worst_plant = _band(loop, K, at, channel) if banded else (None, math.inf, settings.plant)
    bode, nichols = frequency_parts(
        name, grid, response, math.pi / P.dt, settings.plant, band, loop.job.coupled.disk_margin
    )
    step, low_frequency = _turning(loop, settings, K, at, grid, s, stable, banded)

    def measured() -> Measured:
        own = float(_peak_margins(sensitivity, [channel], grid, S)[0]) if stable else 0.0
        return Measured(
            margins=Margins(
                disk=own,
                worst_disk=min(own, worst) if inside else 0.0,
                worst_plant=worst_plant if worst < own else settings.plant,
                **channel_own._asdict(),
                bandwidth=_bandwidth(grid, S, [torquers.index(one) for one in roots]) if stable else 0.0,
                damping=float(minimum_damping(z[None], 0.1 * reference, P.dt)[0]),
            ),
            requirements=requirements(loop, kept, (s, grid, sensitivity, S) if at_rest else None),
        )

    drawn = Drawn(
        bode=bode,
        nichols=nichols,
        locus=_locus(loop, P, K, s, poles, reference),
        step=step,
        Omega_time=_rate_step(loop, settings, K, at, s, stable, banded),
        Omega_frequency=low_frequency,
        crossover=channel_own.crossover,
        bandwidth=None,
        stable=stable,
        all_stable=inside,
    )
    return drawn, measured


def requirements(
    loop: StabilisedLoop,
    kept: Kept,
    known: tuple[ComplexArray, FloatArray, _Sensitivity, ComplexArray] | None = None,
) -> tuple[CheckResult, ...]:
    """Return the coupled limits held against the nominal plant, as `coupled_check` does; peaks are climbed on a grid.

    Margins lie within about a thousandth of what `coupled_check` proves. `known` are the nominal closed loop's poles,
    a grid, its sensitivity, and that on the grid, where they are at hand.
    """
    job, model, controllers = loop.job, loop.model, loop.controllers
    K, at, torquers = loop.joined(loop.plants)
    P = _used(loop.plants.arrays, 0, at)
    A, B, C, D = closed_loop_arrays(*P[:4], *K[:4])
    s = continuous_poles(pole_arrays(A), P.dt) if known is None else known[0]
    decay = -float(spectral_abscissa(s))
    m = len(torquers)
    sensors = {one.name: one for one in job.platform.sensors}
    rms = np.array([sensors[name].sampled_noise(P.dt) for name in loop.plants.sensors])
    noise = noise_rms_arrays(A, B[:, m:], C[:m], D[:m, m:], rms)
    coupled, simultaneous = np.zeros(m), (0.0, 0.0)
    if decay > 0.0:
        grid, sensitivity = (_grid(P, s), _Sensitivity(P, K)) if known is None else known[1:3]
        S = sensitivity.at(grid) if known is None else known[3]
        coupled = _peak_margins(sensitivity, range(m), grid, S)
        simultaneous = _simultaneous(sensitivity, grid, S)
    decoupled = _decoupled(job, model, controllers, kept)
    alone = np.array([decoupled[name] for name in torquers])
    cost = np.where(alone > 0.0, 1.0 - coupled / np.maximum(alone, np.finfo(float).tiny), np.inf)
    return coupled_results(job, decay, torquers, cost, simultaneous, noise)


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
    s = continuous_poles(pole_arrays(closed_loop_arrays(*P[:4], *k[:4])[0]), P.dt)
    if not spectral_abscissa(s) < 0.0:
        return dict.fromkeys(names, 0.0)
    grid = _grid(P, s)
    sensitivity = _Sensitivity(P, k)
    S = sensitivity.at(grid)
    chosen = [j for j, name in enumerate(names) if name not in left_out]
    return {names[j]: float(x) for j, x in zip(chosen, _peak_margins(sensitivity, chosen, grid, S), strict=True)}


def _used(arrays: StateArrays, k: int, at: list[int]) -> StateArrays:
    A, B, C, D, dt = arrays_of(arrays, k)
    return StateArrays(A, B[:, at], C, D[:, at], dt)


def _grid(P: StateArrays, s: ComplexArray) -> FloatArray:
    nyquist = math.pi / P.dt
    finite = s[np.isfinite(s)]
    slowest = float(np.abs(finite).min(initial=nyquist))
    low = max(min(0.1 * slowest, 0.01 * nyquist), 1e-5 * nyquist)
    own = continuous_poles(pole_arrays(P.A), P.dt)
    # Free poles at z = 1 are integrators, no resonances.
    return dense_grid(np.concatenate([s, own]), low, EDGE * nyquist)


def _peak_margins(sensitivity: _Sensitivity, channels: Sequence[int], grid: FloatArray, S: ComplexArray) -> FloatArray:
    """Return 1/max |S_ii - 1/2| of channels: the largest on the grid, climbed between its neighbours, all at once."""
    at = np.array(channels)
    sizes = np.abs(S[:, at, at] - 0.5)
    k = np.argmax(sizes, axis=0)
    each = np.arange(len(at))
    w = np.linspace(grid[np.maximum(k - 1, 0)], grid[np.minimum(k + 1, len(grid) - 1)], 13)
    found = sensitivity.at(w.ravel()).reshape(*w.shape, *S.shape[1:])
    best = np.maximum(sizes[k, each], np.abs(found[:, each, at, at] - 0.5).max(axis=0))
    return np.asarray(1.0 / best)


class _Sensitivity:
    """S at the plant's input over frequency; what does not depend on the frequency is worked out once."""

    def __init__(self, P: StateArrays, K: StateArrays) -> None:
        self._P, self._K = AxisResponse(P), AxisResponse(K)

    def at(self, w: FloatArray) -> ComplexArray:
        """Return S at `w` (F,), rad/s, complex (F, m, m)."""
        return sensitivities(-self._K.at(w) @ self._P.at(w))[0]


def _simultaneous(sensitivity: _Sensitivity, grid: FloatArray, S: ComplexArray) -> tuple[float, float]:
    """Return both bounds of the simultaneous disk margin: the grid every third point, then around the worst."""
    half = 0.5 * np.eye(S.shape[-1])
    coarse = np.arange(0, len(grid), 3)
    rough = mu_bounds(S[coarse] - half, 1e-3).upper
    k = int(coarse[int(np.argmax(rough))])
    low, high = grid[max(k - 3, 0)], grid[min(k + 3, len(grid) - 1)]
    best = (float(rough.max()), 0.0)
    for _ in range(2):
        w = np.linspace(low, high, 9)
        M = sensitivity.at(w) - half
        found = mu_bounds(M, _MU)
        j = int(np.argmax(found.upper))
        best = (float(found.upper[j]), float(found.lower[j]))
        low, high = w[max(j - 1, 0)], w[min(j + 1, 8)]
    upper, lower = best
    return 1.0 / upper, 1.0 / lower if lower > 0.0 else math.inf


def _band(loop: StabilisedLoop, K: StateArrays, at: list[int], channel: int) -> tuple[Band, float, str]:
    """Return the loops of all plants broken at a channel, and the least of their margins there with its plant."""
    w = loop.plants.frequency
    S = sensitivities(-frequency_response_arrays(*K, w) @ loop.plants.response[..., : len(loop.plants.sensors), at])[0]
    peaks = np.abs(S[..., channel, channel] - 0.5).max(axis=-1)
    k = int(np.argmax(peaks))
    return Band(loop.plants.labels, w, channel_response(S, channel)), 1.0 / float(peaks[k]), loop.plants.labels[k]


def _set_poles(loop: StabilisedLoop, K: StateArrays, at: list[int]) -> ComplexArray:
    A, B, C, D, dt = loop.plants.arrays
    return continuous_poles(pole_arrays(closed_loop_arrays(A, B[..., at], C, D[..., at], *K[:4])[0]), dt)


def _locus(
    loop: StabilisedLoop, P: StateArrays, K: StateArrays, s: ComplexArray, poles: ComplexArray, crossover: float
) -> Locus:
    """The servo's gain varies on all root axes; the caging loops stay closed as they are."""
    roots = {t.name for t in loop.job.platform.torquers if t.root_axis is not None}
    names = loop.joined(loop.shown)[2]
    moving = np.array([name in roots for name in names])
    inner = StateArrays(K.A, K.B, np.where(moving[:, None], 0.0, K.C), np.where(moving[:, None], 0.0, K.D), K.dt)
    # Both halves read the same states of the controller: close the inner rows first, then the rest as feedback.
    A, B, _, _ = closed_loop_arrays(*P[:4], *inner[:4])
    m = P.B.shape[1]
    feedback = np.hstack([K.D @ P.C, K.C]) * moving[:, None]
    if P.D.any():
        gains, branches = gain_locus(P, K, points=32)
    else:
        closed = StateArrays(A, B[:, :m], feedback, np.zeros((m, m)), P.dt)
        static = StateArrays(np.zeros((0, 0)), np.zeros((0, m)), np.zeros((m, 0)), np.eye(m), P.dt)
        gains, branches = gain_locus(closed, static, points=32)
    finite = np.isfinite(s)
    size = np.where(finite, np.abs(s), np.inf)
    nyquist = math.pi / P.dt
    reach = min(8.0 * crossover, nyquist)
    others = poles.ravel()
    return Locus(
        gains=gains,
        branches=branches,
        present=s,
        draggable=np.asarray(
            finite & (s.imag > 1e-6 * size) & (size < 0.9 * nyquist) & moved_by_gain(gains, branches, s)
        ),
        others=others[np.isfinite(others) & (np.abs(others) < 4.0 * reach)],
        reach=reach,
        damping=None,
    )


def _responses(plants: FreePlants, K: StateArrays, at: list[int], axis: int, u: FloatArray, every: int) -> FloatArray:
    """Return attitude (3), angles and torques after a torque on the platform about `axis`."""
    A, B, C, D, _ = plants.turned
    m, p = len(plants.torquers), len(plants.sensors)
    loops = closed_loop_arrays(A, B, C, D, *K[:4], torques=at, angles=list(range(p)))
    a, b, c, d = loops
    k = len(at)
    order = [*range(k + p, k + p + 3), *range(k, k + p), *range(k)]
    column = slice(m + axis - 1, m + axis)
    return held_responses(a, b[..., column], c[..., order, :], d[..., order, column], u, every)


def _turning(
    loop: StabilisedLoop,
    settings: Settings,
    K: StateArrays,
    at: list[int],
    grid: FloatArray,
    s: ComplexArray,
    stable: bool,
    banded: bool,
) -> tuple[TimeResponse, FrequencyGain]:
    axis, period = settings.axis, loop.shown.period
    size, title, limit = _acting(loop, axis)
    slow = s[np.isfinite(s) & (np.abs(s) < math.pi / period)]
    t, every = sample_times(settling(slow, 50.0 / period, period, stable), period, POINTS)
    u = np.full(every * (len(t) - 1) + 1, size)
    own = _responses(loop.shown, K, at, axis, u, every)[0]
    low, high = around_in_time(_responses(loop.plants, K, at, axis, u, every) if banded else None, own)
    torquers = [loop.shown.torquers[k] for k in at]
    rates = [name for name in loop.shown.sensors if name not in loop.job.platform.angle_names]
    step = TimeResponse(
        title=title,
        t=t,
        signals=(*ATTITUDE, *loop.shown.sensors, *torquers),
        units=("rad",) * 3
        + tuple("rad/s" if name in rates else "rad" for name in loop.shown.sensors)
        + ("N m",) * len(torquers),
        values=own,
        low=low,
        high=high,
        drive=np.ones(len(t)),
        limit=limit,
    )
    m, p, k = len(loop.shown.torquers), len(loop.shown.sensors), len(at)
    column = slice(m + axis - 1, m + axis)

    def attitude(one: int, w: FloatArray, plants: FreePlants) -> FloatArray:
        A, B, C, D, dt = plants.turned
        a, b, c, d = closed_loop_arrays(A[one], B[one], C[one], D[one], *K[:4], torques=at, angles=list(range(p)))
        found = frequency_response_arrays(a, b[:, column], c[k + p :], d[k + p :, column], dt, w)
        return np.asarray(np.linalg.norm(found[..., 0], axis=-1))

    none = np.zeros(0)
    w_band, low_gain, high_gain = none, none, none
    if banded:
        w_band = loop.plants.frequency
        whole = loop.plants.response
        # What acts moves the sensors, these the torques, and both the attitude.
        k_at = frequency_response_arrays(*K, w_band)
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


def _acting(loop: StabilisedLoop, axis: int) -> tuple[float, str, float | None]:
    """Return the torque step of the job's stabilised manoeuvre about an axis, or one that the torquer can hold."""
    for one in loop.job.manoeuvres:
        if one.mode == "stabilised" and one.axis == axis and one.torque:
            return one.torque, one.name, one.limits.get("attitude")
    limits = [t.limit for t in loop.job.platform.torquers if t.root_axis == axis]
    size = step_size(math.inf if not limits or limits[0] is None else limits[0])
    return size, f"{1e3 * size:g} mN m step about axis {axis}", None


def _rate_step(
    loop: StabilisedLoop, settings: Settings, K: StateArrays, at: list[int], s: ComplexArray, stable: bool, banded: bool
) -> TimeResponse:
    """The attitude after an impulse of torque that would turn the free platform by 1 mrad/s about the axis."""
    axis, period = settings.axis, loop.shown.period
    t, every = sample_times(settling(s, 50.0 / period, period, stable), period, POINTS)
    u = np.zeros(every * (len(t) - 1) + 1)
    u[0] = 1e-3 * float(loop.model.root_inertia[axis - 1, axis - 1]) / period
    own = _responses(loop.shown, K, at, axis, u, every)[0]
    low, high = around_in_time(_responses(loop.plants, K, at, axis, u, every) if banded else None, own)
    kept = slice(0, 3 + len(loop.shown.sensors))
    rates = [name for name in loop.shown.sensors if name not in loop.job.platform.angle_names]
    drive = np.zeros(len(t))
    drive[0] = 1.0
    return TimeResponse(
        title=f"impulse of torque: 1 mrad/s about axis {axis}",
        t=t,
        signals=(*ATTITUDE, *loop.shown.sensors),
        units=("rad",) * 3 + tuple("rad/s" if name in rates else "rad" for name in loop.shown.sensors),
        values=own[kept],
        low=low[kept],
        high=high[kept],
        drive=drive,
    )


def _bandwidth(grid: FloatArray, S: ComplexArray, rows: list[int]) -> float:
    """Lowest frequency at which the largest singular value of S on the root axes reaches 1/sqrt(2), rad/s."""
    sizes = np.linalg.norm(S[:, rows][:, :, rows], 2, axis=(-2, -1))
    above = np.flatnonzero(sizes >= math.sqrt(0.5))
    return float(grid[above[0]]) if above.size else float(grid[-1])
