"""The picture of the free platform with all loops closed: curves and coupled requirements."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.interconnection import interconnected
from platform_ctrl.analysis.norms import bandwidth_of_response, peak
from platform_ctrl.analysis.poles import continuous_poles, following_grid, minimum_damping, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import ComplexArray, Index, System
from platform_ctrl.app.curves import (
    EDGE,
    GRID_POINTS,
    Band,
    LoopCurves,
    channel_margins,
    channel_response,
    frequency_gain,
    gain_crossings,
)
from platform_ctrl.app.excitation import SampledInput, drive, settling, step_size
from platform_ctrl.app.pictures import Bode, FrequencyGain, Margins, Measured, TimeResponse
from platform_ctrl.app.plants import ATTITUDE, FreePlants
from platform_ctrl.app.settings import Settings
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import Job
from platform_ctrl.job.quantities import quantity
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.verification.coupled import CoupledCheck

if TYPE_CHECKING:
    import control

_ALL = slice(None)


class StabilisedCurves(LoopCurves):
    """The curves of the free platform with all loops closed, `controllers` in the job's order; `check` is theirs.

    `plants` is the set (the nominal plant alone without a band), and `shown` the plant that is shown.
    """

    def __init__(
        self,
        job: Job,
        settings: Settings,
        model: LinearModel,
        controllers: Sequence[control.StateSpace],
        plants: FreePlants,
        shown: FreePlants,
        check: Callable[[], CoupledCheck],
    ) -> None:
        driven = {name for K in controllers for name in K.output_labels}
        torquers = [name for name in plants.torquers if name in driven]
        controller = interconnected(controllers, plants.sensors, torquers, plants.period)
        self.used = [plants.torquers.index(name) for name in torquers]
        # The torquers on the platform that controllers set.
        self.roots = [t.name for t in job.platform.torquers if t.root_axis is not None and t.name in torquers]
        if not self.roots:
            raise DesignError(f"{settings.loop}: no controller sets a torque on the platform; add a servo to the job")
        channel = settings.channel if settings.channel in self.roots else self.roots[0]
        plant = shown.arrays.at(0).part(_ALL, self.used)
        super().__init__(job, settings, plant, controller, shown.sensors, torquers, channel)
        self.plants, self.shown, self._model, self._check = plants, shown, model, check
        sensors = {sensor.name: sensor.unit for sensor in job.platform.sensors}
        self.units = dict.fromkeys(ATTITUDE, "rad") | sensors | {one.name: one.unit for one in job.platform.torquers}
        self.limits = {"disk margin": job.coupled.disk_margin}
        nyquist = math.pi / plant.dt
        slowest = float(np.abs(self.poles[np.isfinite(self.poles)]).min(initial=nyquist))
        low = max(min(0.1 * slowest, 0.01 * nyquist), 1e-5 * nyquist)
        # Free poles at z = 1 are integrators, no resonances.
        own = continuous_poles(poles(plant.A), plant.dt)
        grid = following_grid(np.concatenate([self.poles, own]), low, EDGE * nyquist, GRID_POINTS)
        self.frequency = np.union1d(grid, plants.frequency)
        self.banded, self.other_poles = bool(settings.band and len(plants.labels) > 1), self.poles[None]
        if self.banded:
            whole = plants.arrays.part(_ALL, self.used)
            self.other_poles = continuous_poles(poles(whole.feedback(controller).A), plant.dt)
            self.band = Band(plants.labels, plants.frequency, channel_response(self._S_of_set, self.index))
        self.all_stable = bool(np.all(spectral_abscissa(self.other_poles) < 0.0))
        # The servo's gain moves its torques; the caging loops stay closed as they are.
        self.moving = [name in self.roots for name in torquers]
        # It follows from the servo, which is far slower than the gyros.
        crossover = gain_crossings(self.frequency, channel_response(self.own.S, self.index))[0].max(initial=1.0)
        self.reach = min(8.0 * float(crossover), nyquist)

    def step(self) -> TimeResponse:
        """Return the response to a step of torque on the platform about the axis."""
        size, title, limit = self._torque()
        period = self.plant.dt
        slow = self.poles[np.isfinite(self.poles) & (np.abs(self.poles) < math.pi / period)]
        duration = settling(slow, 50.0 / period, period, self.stable)
        step = drive(title, duration, period, lambda t: np.full(len(t), size), limit)
        return self._over_time(step, [*ATTITUDE, *self.readings, *self.torquers])

    def disturbance(self) -> TimeResponse:
        """Return the attitude after an impulse of torque that would turn the free platform by 1 mrad/s."""
        period = self.plant.dt
        size = 1e-3 * float(self._model.root_inertia[self.axis - 1, self.axis - 1]) / period
        duration = settling(self.poles, 50.0 / period, period, self.stable)
        title = f"impulse of torque: 1 mrad/s about axis {self.axis}"
        impulse = drive(title, duration, period, lambda t: np.where(t == 0.0, size, 0.0))
        return self._over_time(impulse, [*ATTITUDE, *self.readings])

    def _over_time(self, given: SampledInput, signals: Sequence[str]) -> TimeResponse:
        """Return attitude, angles and torques, as many as there are signals, after a torque on the platform."""
        k, p = len(self.used), len(self.readings)
        order = [*range(k + p, k + p + 3), *range(k, k + p), *range(k)][: len(signals)]
        band = self._turned(self.plants, order) if self.banded else None
        return self.over_time(given, signals, self._turned(self.shown, order), band, given.u[None])

    def _turned(self, plants: FreePlants, outputs: Index) -> System:
        """Return the closed loops from the torque on the platform to torques, sensors and attitude."""
        sensors = range(len(self.readings))
        whole = plants.turned.feedback(self.controller, self.used, sensors)
        return whole.part(outputs, [self._torque_column])

    @property
    def _torque_column(self) -> int:
        return len(self.shown.torquers) + self.axis - 1

    def _torque(self) -> tuple[float, str, float | None]:
        """Return the torque step of the job's stabilised manoeuvre about the axis, or one that the torquer can hold."""
        axis = self.axis
        for one in self.job.manoeuvres:
            if one.mode == "stabilised" and one.axis == axis and one.torque:
                return one.torque, one.name, one.limits.get("attitude")
        limits = [t.limit for t in self.job.platform.torquers if t.root_axis == axis]
        size = step_size(math.inf if not limits or limits[0] is None else limits[0])
        return size, f"{quantity(size, 'N m')} step about axis {axis}", None

    def disturbance_gain(self) -> FrequencyGain:
        """Return the gain from a torque on the platform to its attitude."""
        column, p, k, band = self._torque_column, len(self.readings), len(self.used), None
        if self.banded:
            w, whole = self.plants.frequency, self.plants.response
            # The disturbance moves the sensors, these the torques, and both the attitude.
            K = self._K_of_set
            sensed, driven = whole[..., :p, [column]], whole[..., self.used]
            torque = np.linalg.solve(np.eye(k) - K @ driven[..., :p, :], K @ sensed)
            band = w, (whole[..., p:, [column]] + driven[..., p:, :] @ torque)[..., 0]
        shown = self._turned(self.shown, slice(k + p, None)).at(0)
        own = frequency_response(shown, self.frequency, -3)[..., 0]
        return frequency_gain(f"torque M{self.axis} on the platform → attitude", "rad/(N m)", self.frequency, own, band)

    @cached_property
    def _K_of_set(self) -> ComplexArray:
        """The controllers' response on the grid of the set."""
        return frequency_response(self.controller, self.plants.frequency, -3)

    @cached_property
    def _S_of_set(self) -> ComplexArray:
        """Sensitivity at the torquers of all plants on the grid of the set."""
        response = self.plants.response[..., : len(self.readings), self.used]
        return sensitivities_of_plants(response, self._K_of_set)[1]

    def measured(self, bode: Bode) -> Measured:
        """Return margins, and the requirements of the check of all loops closed around the nominal plant."""
        own, bandwidth, worst, worst_plant = 0.0, 0.0, math.inf, self.settings.plant
        if self.stable:
            rows = [self.torquers.index(one) for one in self.roots]
            bandwidth = float(bandwidth_of_response(self.frequency, self.own.S[:, rows][:, :, rows]))
            # From a torque disturbance to the torque the closed loop is S - 1.
            one = self.plant.feedback(self.controller).part([self.index], [self.index])
            own = 1.0 / peak(one._replace(D=one.D + 0.5))[0]
        if self.banded:
            peaks = np.abs(self._S_of_set[..., self.index, self.index] - 0.5).max(axis=-1)
            k = int(np.argmax(peaks))
            worst, worst_plant = 1.0 / float(peaks[k]), self.plants.labels[k]
        margins = Margins(
            disk=own,
            worst_disk=min(own, worst) if self.all_stable else 0.0,
            worst_plant=worst_plant if worst < own else self.settings.plant,
            worst_sampled=self.banded,
            **channel_margins(bode, self.stable),
            bandwidth=bandwidth,
            damping=float(minimum_damping(self.z_poles[None], self.plant.dt)[0]),
        )
        return Measured(margins=margins, requirements=self._check().results)
