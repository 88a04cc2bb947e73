"""The picture of the free platform with all loops closed: curves and coupled requirements."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, Index, StateArrays, state_arrays
from platform_ctrl.analysis.feedback import closed_loop, sensitivity_functions
from platform_ctrl.analysis.mu import best_mu_bounds, highest_mu
from platform_ctrl.analysis.poles import continuous_poles, minimum_damping, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.app.curves import (
    ALL,
    Band,
    Drive,
    LoopCurves,
    LoopTransfers,
    Parts,
    channel_margins,
    channel_response,
    drive,
    frequency_parts,
    gain_locus,
    locus,
    overlay,
    settling,
    step_size,
)
from platform_ctrl.app.free_plants import (
    ATTITUDE,
    FreePlants,
    Sensitivity,
    StabilisedLoop,
    disk_margins,
    loop_grid,
)
from platform_ctrl.app.pictures import Drawing, FrequencyGain, Locus, Margins, Measured, Overlay, TimeResponse
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
    torquer_metrics,
)

if TYPE_CHECKING:
    import control

# Poles with less damping than this are looked at besides the grid.
_NARROW = 0.02

# A cache of the disk margins of the caging loops alone, which do not change while the servo's sliders move.
CachedMargins = Callable[[str, Callable[[], dict[str, float]]], dict[str, float]]


def requirements(
    loop: StabilisedLoop,
    cached: CachedMargins,
    known: tuple[ComplexArray, FloatArray, Sensitivity, ComplexArray] | None = None,
) -> tuple[CheckResult, ...]:
    """Return the coupled limits of the nominal plant, as `coupled_check` judges them.

    Only the simultaneous margin is not proved: it is the least at some frequencies, with those of narrow poles, and
    lies within about a thousandth of what `coupled_check` proves. `known` are the nominal closed loop's poles, a grid,
    its sensitivity, and that on the grid, if they are known.
    """
    job, model, controllers = loop.job, loop.model, loop.controllers
    K, at, torquers = loop.joined(loop.plants)
    P = loop.plants.arrays.at(0).part(ALL, at)
    loops = closed_loop(P, K)
    s = continuous_poles(poles(loops.A), P.dt) if known is None else known[0]
    decay = -float(spectral_abscissa(s))
    m = len(torquers)
    sensors = {one.name: one for one in job.platform.sensors}
    rms = np.array([sensors[name].sampled_noise(P.dt) for name in loop.plants.sensors])
    of_torquers = torquer_metrics(loops.part(range(m), slice(m, None)), rms)
    coupled, simultaneous = np.zeros(m), (0.0, 0.0)
    if decay > 0.0:
        grid, sensitivity = (loop_grid(P, s), Sensitivity(P, K)) if known is None else known[1:3]
        S = sensitivity.at(grid) if known is None else known[3]
        coupled = disk_margins(P, K, range(m))
        closed = loops.part(range(m), range(m))
        closed = closed._replace(D=closed.D + 0.5 * np.eye(m))
        simultaneous = _simultaneous(sensitivity, grid, S, closed, s)
    decoupled = _decoupled(job, model, controllers, cached)
    alone = np.array([decoupled[name] for name in torquers])
    cost = np.where(alone > 0.0, 1.0 - coupled / np.maximum(alone, np.finfo(float).tiny), np.inf)
    return coupled_results(job, decay, torquers, cost, simultaneous, of_torquers, proved=False)


def _decoupled(
    job: Job, model: LinearModel, controllers: Sequence[control.StateSpace], cached: CachedMargins
) -> dict[str, float]:
    gimbal = {t.name for t in job.platform.torquers if t.gimbal is not None}
    caging = [K for K in controllers if set(K.output_labels) <= gimbal]

    def of_caging() -> dict[str, float]:
        return _margins_of(coupled_plant(job, model, caging).system, caging, job, set()) if caging else {}

    def of_servo() -> dict[str, float]:
        return _margins_of(
            one_way_plant(job, model, sensed_rates(job, controllers)).system, controllers, job, set(inner)
        )

    inner = cached("caging", of_caging)
    return of_servo() | inner


def _margins_of(
    plant: control.StateSpace, controllers: Sequence[control.StateSpace], job: Job, left_out: set[str]
) -> dict[str, float]:
    """Return the disk margin of every channel broken alone, by torquer; 0 where the loop is not stable."""
    K = one_controller(job, controllers, plant)
    names = list(K.output_labels)
    at = [plant.input_labels.index(name) for name in names]
    seen = [plant.output_labels.index(name) for name in K.input_labels]
    P, k = state_arrays(plant, "plant").part(seen, at), state_arrays(K, "controller")
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
    k = int(coarse[highest_mu(S[coarse] - half)])
    best = _climbed(lambda w: sensitivity.at(w) - half, grid[max(k - 3, 0)], grid[min(k + 3, len(grid) - 1)])
    narrow = s[np.isfinite(s) & (s.imag > 0.0) & (np.abs(s.real) < _NARROW * s.imag)]
    if narrow.size:

        def response(w: FloatArray) -> ComplexArray:
            return frequency_response(closed, np.minimum(w, math.pi / closed.dt), -3)

        one = narrow[highest_mu(response(narrow.imag))]
        best = max(best, _climbed(response, one.imag + 2.0 * one.real, one.imag - 2.0 * one.real))
    upper, lower = best
    return 1.0 / upper, 1.0 / lower if lower > 0.0 else math.inf


def _climbed(of: Callable[[FloatArray], ComplexArray], low: float, high: float) -> tuple[float, float]:
    """Return both bounds of the largest mu between two frequencies."""
    best = (0.0, 0.0)
    for _ in range(3):
        w = np.linspace(low, high, 9)
        found = best_mu_bounds(of(w))
        j = int(np.argmax(found.upper))
        best = max(best, (float(found.upper[j]), float(found.lower[j])))
        low, high = w[max(j - 1, 0)], w[min(j + 1, 8)]
    return best


class StabilisedCurves(LoopCurves):
    """The curves of the free platform with all loops closed; with `banded` those of the whole set too."""

    def __init__(self, loop: StabilisedLoop, settings: Settings, banded: bool = False) -> None:
        self.loop, self.job, self.axis = loop, loop.job, settings.axis
        self.controller, self.used, self.torquers = loop.joined(loop.shown)
        platform = loop.job.platform.torquers
        # The torquers on the platform that controllers set.
        self.roots = [t.name for t in platform if t.root_axis is not None and t.name in self.torquers]
        if not self.roots:
            raise DesignError(f"{loop.spec.name}: no controller sets a torque on the platform; add a servo to the job")
        self.channel = settings.channel if settings.channel in self.roots else self.roots[0]
        self.index = self.torquers.index(self.channel)
        self.plant = loop.shown.arrays.at(0).part(ALL, self.used)
        self.z_poles = poles(closed_loop(self.plant, self.controller).A)
        self.poles = continuous_poles(self.z_poles, self.plant.dt)
        self.stable = bool(spectral_abscissa(self.poles) < 0.0)
        self.sensitivity = Sensitivity(self.plant, self.controller)
        self.banded = banded

    def transfers(self, frequency: FloatArray) -> LoopTransfers:
        """Return what the loop of the plant shown consists of at `frequency` (F,), rad/s."""
        return self.sensitivity.transfers(frequency)

    def readings(self) -> tuple[list[str], str]:
        """Return the units of what the controllers read, and of what they set at the channel."""
        units = {sensor.name: sensor.unit for sensor in self.job.platform.sensors}
        return [units[name] for name in self.loop.shown.sensors], "N m"

    def step(self) -> TimeResponse:
        """Return the response to a step of torque on the platform about the axis."""
        size, title, limit = self._torque()
        period = self.plant.dt
        slow = self.poles[np.isfinite(self.poles) & (np.abs(self.poles) < math.pi / period)]
        duration = settling(slow, 50.0 / period, period, self.stable)
        step = drive(title, duration, period, lambda t: np.full(len(t), size), limit)
        return self._responses(step, self._angles | dict.fromkeys(self.torquers, "N m"))

    def disturbance(self) -> TimeResponse:
        """Return the attitude after an impulse of torque that would turn the free platform by 1 mrad/s."""
        period = self.plant.dt
        size = 1e-3 * float(self.loop.model.root_inertia[self.axis - 1, self.axis - 1]) / period
        duration = settling(self.poles, 50.0 / period, period, self.stable)
        title = f"impulse of torque: 1 mrad/s about axis {self.axis}"
        return self._responses(drive(title, duration, period, lambda t: np.where(t == 0.0, size, 0.0)), self._angles)

    @property
    def _angles(self) -> dict[str, str]:
        """Attitude and sensors with their units."""
        units = {sensor.name: sensor.unit for sensor in self.job.platform.sensors}
        return dict.fromkeys(ATTITUDE, "rad") | {name: units[name] for name in self.loop.shown.sensors}

    def _responses(self, given: Drive, signals: dict[str, str]) -> TimeResponse:
        """Return attitude, angles and torques, as many as there are signals, after a torque on the platform."""
        k, p = len(self.used), len(self.loop.shown.sensors)
        order = [*range(k + p, k + p + 3), *range(k, k + p), *range(k)][: len(signals)]
        shown, band = self._turned(self.loop.shown, order), None
        if self.banded:
            band = self._turned(self.loop.plants, order)
        return self._time_response(given, signals, shown, band, given.u[None])

    def _turned(self, plants: FreePlants, outputs: Index) -> StateArrays:
        """Return the closed loops from the torque on the platform to torques, sensors and attitude."""
        sensors = list(range(len(plants.sensors)))
        whole = closed_loop(plants.turned, self.controller, torques=self.used, angles=sensors)
        return whole.part(outputs, [self._torque_column])

    @property
    def _torque_column(self) -> int:
        return len(self.loop.shown.torquers) + self.axis - 1

    def _torque(self) -> tuple[float, str, float | None]:
        """Return the torque step of the job's stabilised manoeuvre about the axis, or one that the torquer can hold."""
        axis = self.axis
        for one in self.loop.job.manoeuvres:
            if one.mode == "stabilised" and one.axis == axis and one.torque:
                return one.torque, one.name, one.limits.get("attitude")
        limits = [t.limit for t in self.loop.job.platform.torquers if t.root_axis == axis]
        size = step_size(math.inf if not limits or limits[0] is None else limits[0])
        return size, f"{1e3 * size:g} mN m step about axis {axis}", None

    def disturbance_gain(self, frequency: FloatArray) -> FrequencyGain:
        """Return the gain from a torque on the platform to its attitude at `frequency` (F,), rad/s."""
        column, p, k, band = self._torque_column, len(self.loop.shown.sensors), len(self.used), None
        if self.banded:
            w, whole = self.loop.plants.frequency, self.loop.plants.response
            # The disturbance moves the sensors, these the torques, and both the attitude.
            K = self._K_of_set
            sensed, driven = whole[..., :p, [column]], whole[..., self.used]
            torque = np.linalg.solve(np.eye(k) - K @ driven[..., :p, :], K @ sensed)
            band = w, (whole[..., p:, [column]] + driven[..., p:, :] @ torque)[..., 0]
        shown = self._turned(self.loop.shown, slice(k + p, None)).at(0)
        own = frequency_response(shown, frequency, -3)[..., 0]
        return self._disturbance_gain(
            f"torque M{self.axis} on the platform → attitude", "rad/(N m)", frequency, own, band
        )

    @cached_property
    def _K_of_set(self) -> ComplexArray:
        """The controllers' response on the grid of the set."""
        return frequency_response(self.controller, self.loop.plants.frequency, -3)

    def set_poles(self) -> ComplexArray:
        """Return the closed-loop poles of the plants of the band, or those of the plant shown, (N, n), rad/s."""
        if not self.banded:
            return self.poles[None]
        plants = self.loop.plants.arrays.part(ALL, self.used)
        return continuous_poles(poles(closed_loop(plants, self.controller).A), plants.dt)

    def band(self) -> tuple[Band, float, str]:
        """Return the loop transfers of all plants, and the least of their disk margins with its plant."""
        plants = self.loop.plants
        response = plants.response[..., : len(plants.sensors), self.used]
        S = sensitivity_functions(-self._K_of_set @ response)[0]
        peaks = np.abs(S[..., self.index, self.index] - 0.5).max(axis=-1)
        k = int(np.argmax(peaks))
        band = Band(plants.labels, plants.frequency, channel_response(S, self.index))
        return band, 1.0 / float(peaks[k]), plants.labels[k]

    def locus(self, others: ComplexArray, crossover: float) -> Locus:
        """Return the root locus for the servo's gain on all axes; the caging loops stay closed as they are."""
        P, K = self.plant, self.controller
        nyquist = math.pi / P.dt
        reach = min(8.0 * crossover, nyquist)
        moving = np.array([name in self.roots for name in self.torquers])
        m = len(moving)
        if P.D.any():
            branches = gain_locus(P, K, reach)
        else:
            inner = StateArrays(
                K.A, K.B, np.where(moving[:, None], 0.0, K.C), np.where(moving[:, None], 0.0, K.D), K.dt
            )
            # Both parts use the same states of the controller: the inner loops first, then the rest as feedback.
            A, B, _, _, _ = closed_loop(P, inner)
            feedback = np.hstack([K.D @ P.C, K.C]) * moving[:, None]
            closed = StateArrays(A, B[:, :m], feedback, np.zeros((m, m)), P.dt)
            static = StateArrays(np.zeros((0, 0)), np.zeros((0, m)), np.zeros((m, 0)), np.eye(m), P.dt)
            branches = gain_locus(closed, static, reach)
        return locus(branches, self.poles, others.ravel(), reach, None)


def stabilised_parts(loop: StabilisedLoop, settings: Settings, labels: tuple[str, ...], cached: CachedMargins) -> Parts:
    """Return what is drawn for the free platform, and the function that measures it; `labels` are of all plants."""
    curves = StabilisedCurves(loop, settings, bool(settings.band and len(loop.plants.labels) > 1))
    P, s, stable, channel = curves.plant, curves.poles, curves.stable, curves.index
    grid = np.union1d(loop_grid(P, s), loop.plants.frequency)
    transfers = curves.transfers(grid)
    S = transfers.S
    response = channel_response(S, channel)
    every = curves.set_poles()
    own_margins = channel_margins(grid, response, stable)
    reference = max(own_margins.crossover or 1.0, 1.0)
    at_rest = settings.plant == loop.plants.labels[0]
    all_stable = bool(np.all(spectral_abscissa(every) < 0.0)) if curves.banded else stable
    band, worst, worst_plant = curves.band() if curves.banded else (None, math.inf, settings.plant)
    bode, nichols = frequency_parts(
        curves.channel, grid, response, math.pi / P.dt, settings.plant, band, loop.job.coupled.disk_margin
    )

    def measured() -> Measured:
        own = float(disk_margins(P, curves.controller, [channel])[0]) if stable else 0.0
        rows = [curves.torquers.index(one) for one in curves.roots]
        return Measured(
            margins=Margins(
                disk=own,
                worst_disk=min(own, worst) if all_stable else 0.0,
                worst_plant=worst_plant if worst < own else settings.plant,
                worst_sampled=curves.banded,
                **own_margins._asdict(),
                bandwidth=_bandwidth(grid, S, rows) if stable else 0.0,
                damping=float(minimum_damping(curves.z_poles[None], P.dt)[0]),
            ),
            requirements=requirements(loop, cached, (s, grid, curves.sensitivity, S) if at_rest else None),
        )

    drawing = Drawing(
        settings=settings,
        plants=labels,
        bode=bode,
        closed=curves.closed_loop(transfers),
        nichols=nichols,
        locus=curves.locus(every, reference),
        step=curves.step(),
        Omega_time=curves.disturbance(),
        Omega_frequency=curves.disturbance_gain(grid),
        bandwidth=None,
        stable=stable,
        all_stable=all_stable,
    )
    return drawing, measured


def stabilised_overlay(loop: StabilisedLoop, settings: Settings, method: str, frequency: FloatArray) -> Overlay:
    """Return what is drawn of another servo at `frequency` (F,), rad/s."""
    return overlay(StabilisedCurves(loop, settings), settings.design, method, frequency)


def _bandwidth(grid: FloatArray, S: ComplexArray, rows: list[int]) -> float:
    """Lowest frequency at which the largest singular value of S on the root axes reaches 1/sqrt(2), rad/s."""
    sizes = np.linalg.norm(S[:, rows][:, :, rows], 2, axis=(-2, -1))
    above = np.flatnonzero(sizes >= math.sqrt(0.5))
    return float(grid[above[0]]) if above.size else float(grid[-1])
