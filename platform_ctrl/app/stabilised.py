"""The picture of the free platform with all loops closed: curves and coupled requirements."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
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
    Parts,
    channel_margins,
    channel_response,
    frequency_gain,
    gain_crossings,
)
from platform_ctrl.app.excitation import SampledInput, drive, settling, step_size
from platform_ctrl.app.pictures import Bode, FrequencyGain, Margins, Measured, TimeResponse
from platform_ctrl.app.plants import ATTITUDE, FreePlants
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.quantities import quantity
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.verification.coupled import CoupledCheck

if TYPE_CHECKING:
    import control

_ALL = slice(None)


@value
class StabilisedLoop:
    """All loops of a job closed around the free platform.

    `model` is the platform at rest, and `controllers` has a
    `control.StateSpace` for each loop in the job's order. `plants` is the set (the nominal plant alone without a band),
    and `shown` the plant that is shown.
    """

    job: Job
    model: LinearModel
    spec: LoopSpec
    controllers: tuple[control.StateSpace, ...]
    plants: FreePlants
    shown: FreePlants

    def joined(self, plants: FreePlants) -> tuple[System, list[int], tuple[str, ...]]:
        """Return all controllers as one, the plants' inputs that it sets, and its torquers."""
        used = {name for K in self.controllers for name in K.output_labels}
        torquers = [name for name in plants.torquers if name in used]
        K = interconnected(self.controllers, plants.sensors, torquers, plants.period)
        return K, [plants.torquers.index(name) for name in torquers], tuple(torquers)


class StabilisedCurves(LoopCurves):
    """The curves of the free platform with all loops closed; with `banded` those of the whole set too."""

    def __init__(self, loop: StabilisedLoop, settings: Settings, banded: bool = False) -> None:
        controller, self.used, torquers = loop.joined(loop.shown)
        platform = loop.job.platform.torquers
        # The torquers on the platform that controllers set.
        self.roots = [t.name for t in platform if t.root_axis is not None and t.name in torquers]
        if not self.roots:
            raise DesignError(f"{loop.spec.name}: no controller sets a torque on the platform; add a servo to the job")
        plant = loop.shown.arrays.at(0).part(_ALL, self.used)
        channel = settings.channel if settings.channel in self.roots else self.roots[0]
        super().__init__(loop.job, settings, plant, controller, loop.shown.sensors, torquers, channel)
        self.loop, self.banded = loop, banded
        if banded:
            self.band = Band(loop.plants.labels, loop.plants.frequency, channel_response(self._S_of_set, self.index))

    @property
    def all_stable(self) -> bool:
        """Whether the loops of all plants of the set are stable."""
        return bool(np.all(spectral_abscissa(self._set_poles) < 0.0))

    @property
    def units(self) -> Mapping[str, str]:
        """Units of attitude, sensors and torques."""
        sensors = {sensor.name: sensor.unit for sensor in self.job.platform.sensors}
        return dict.fromkeys(ATTITUDE, "rad") | sensors | {one.name: one.unit for one in self.job.platform.torquers}

    def limit(self, metric: str) -> float | None:
        """Return the job's limit on all loops together, of the disk margin alone."""
        return self.job.coupled.disk_margin if metric == "disk margin" else None

    @cached_property
    def frequency(self) -> FloatArray:
        """Frequencies of the Bode diagram, rad/s."""
        nyquist = math.pi / self.plant.dt
        finite = self.poles[np.isfinite(self.poles)]
        slowest = float(np.abs(finite).min(initial=nyquist))
        low = max(min(0.1 * slowest, 0.01 * nyquist), 1e-5 * nyquist)
        # Free poles at z = 1 are integrators, no resonances.
        own = continuous_poles(poles(self.plant.A), self.plant.dt)
        grid = following_grid(np.concatenate([self.poles, own]), low, EDGE * nyquist, GRID_POINTS)
        return np.union1d(grid, self.loop.plants.frequency)

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
        size = 1e-3 * float(self.loop.model.root_inertia[self.axis - 1, self.axis - 1]) / period
        duration = settling(self.poles, 50.0 / period, period, self.stable)
        title = f"impulse of torque: 1 mrad/s about axis {self.axis}"
        impulse = drive(title, duration, period, lambda t: np.where(t == 0.0, size, 0.0))
        return self._over_time(impulse, [*ATTITUDE, *self.readings])

    def _over_time(self, given: SampledInput, signals: Sequence[str]) -> TimeResponse:
        """Return attitude, angles and torques, as many as there are signals, after a torque on the platform."""
        k, p = len(self.used), len(self.readings)
        order = [*range(k + p, k + p + 3), *range(k, k + p), *range(k)][: len(signals)]
        band = self._turned(self.loop.plants, order) if self.banded else None
        return self.over_time(given, signals, self._turned(self.loop.shown, order), band, given.u[None])

    def _turned(self, plants: FreePlants, outputs: Index) -> System:
        """Return the closed loops from the torque on the platform to torques, sensors and attitude."""
        sensors = range(len(self.readings))
        whole = plants.turned.feedback(self.controller, self.used, sensors)
        return whole.part(outputs, [self._torque_column])

    @property
    def _torque_column(self) -> int:
        return len(self.loop.shown.torquers) + self.axis - 1

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
            w, whole = self.loop.plants.frequency, self.loop.plants.response
            # The disturbance moves the sensors, these the torques, and both the attitude.
            K = self._K_of_set
            sensed, driven = whole[..., :p, [column]], whole[..., self.used]
            torque = np.linalg.solve(np.eye(k) - K @ driven[..., :p, :], K @ sensed)
            band = w, (whole[..., p:, [column]] + driven[..., p:, :] @ torque)[..., 0]
        shown = self._turned(self.loop.shown, slice(k + p, None)).at(0)
        own = frequency_response(shown, self.frequency, -3)[..., 0]
        return frequency_gain(f"torque M{self.axis} on the platform → attitude", "rad/(N m)", self.frequency, own, band)

    @cached_property
    def _K_of_set(self) -> ComplexArray:
        """The controllers' response on the grid of the set."""
        return frequency_response(self.controller, self.loop.plants.frequency, -3)

    @cached_property
    def _set_poles(self) -> ComplexArray:
        """Closed-loop poles of the plants of the band, or those of the plant shown, (N, n), rad/s."""
        if not self.banded:
            return self.poles[None]
        plants = self.loop.plants.arrays.part(_ALL, self.used)
        return continuous_poles(poles(plants.feedback(self.controller).A), plants.dt)

    @cached_property
    def _S_of_set(self) -> ComplexArray:
        """Sensitivity at the torquers of all plants on the grid of the set."""
        response = self.loop.plants.response[..., : len(self.readings), self.used]
        return sensitivities_of_plants(response, self._K_of_set)[1]

    @property
    def other_poles(self) -> ComplexArray:
        """Closed-loop poles of the plants of the band, in s."""
        return self._set_poles

    @property
    def moving(self) -> Sequence[bool]:
        """Which torques the servo's gain moves; the caging loops stay closed as they are."""
        return [name in self.roots for name in self.torquers]

    @property
    def reach(self) -> float:
        """How much of the s-plane is shown, rad/s: it follows from the servo, which is far slower than the gyros."""
        crossover = gain_crossings(self.frequency, channel_response(self.own.S, self.index))[0].max(initial=1.0)
        return min(8.0 * float(crossover), math.pi / self.plant.dt)

    def measured(self, bode: Bode, check: CoupledCheck) -> Measured:
        """Return margins and requirements; `check` is of all loops closed around the nominal plant."""
        own, worst, worst_plant = 0.0, math.inf, self.settings.plant
        if self.stable:
            # From a torque disturbance to the torque the closed loop is S - 1.
            one = self.plant.feedback(self.controller).part([self.index], [self.index])
            own = 1.0 / peak(one._replace(D=one.D + 0.5))[0]
        if self.banded:
            peaks = np.abs(self._S_of_set[..., self.index, self.index] - 0.5).max(axis=-1)
            k = int(np.argmax(peaks))
            worst, worst_plant = 1.0 / float(peaks[k]), self.loop.plants.labels[k]
        margins = Margins(
            disk=own,
            worst_disk=min(own, worst) if self.all_stable else 0.0,
            worst_plant=worst_plant if worst < own else self.settings.plant,
            worst_sampled=self.banded,
            **channel_margins(bode, self.stable),
            bandwidth=self._bandwidth if self.stable else 0.0,
            damping=float(minimum_damping(self.z_poles[None], self.plant.dt)[0]),
        )
        return Measured(margins=margins, requirements=check.results)

    @property
    def _bandwidth(self) -> float:
        """The bandwidth of S on the root axes, rad/s."""
        rows = [self.torquers.index(one) for one in self.roots]
        return float(bandwidth_of_response(self.frequency, self.own.S[:, rows][:, :, rows]))


def stabilised_parts(
    loop: StabilisedLoop, settings: Settings, labels: tuple[str, ...], check: Callable[[], CoupledCheck]
) -> Parts:
    """Return the curves of the free platform, and the function that measures it; `labels` are of all plants."""
    curves = StabilisedCurves(loop, settings, bool(settings.band and len(loop.plants.labels) > 1))
    drawing = curves.drawing(labels)
    return drawing, lambda: curves.measured(drawing.bode, check())
