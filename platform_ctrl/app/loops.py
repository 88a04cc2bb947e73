"""The curves of a caging loop, and those of the free platform with all loops closed.

Of a caging loop one torquer is shown broken while all others stay closed, and Omega is prescribed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import get_args

import numpy as np

from platform_ctrl.analysis.feedback import commanded_loop, sensitivities_of_plants, with_error_alone
from platform_ctrl.analysis.interconnection import COMMAND, interconnected
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measured
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.norms import bandwidth_of_response, peak
from platform_ctrl.analysis.plant_set import Group, PlantSet
from platform_ctrl.analysis.poles import continuous_poles, following_grid, minimum_damping, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import ComplexArray, Index, StateSpace, System
from platform_ctrl.analysis.transfers import Transfer
from platform_ctrl.app import curves as drawn
from platform_ctrl.app.excitation import SampledInput, caged_excitation, drive, settling, step_size
from platform_ctrl.app.pictures import Bode, FrequencyGain, Margins, Measured, TimeResponse
from platform_ctrl.app.plants import ATTITUDE, FreePlants
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import limits_and_goals
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.quantities import quantity
from platform_ctrl.job.requirements import WORST_CASE, of_readings
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.verification.coupled import CoupledCheck

# Groups that a band shows: failed parts are not among them.
_BAND = WORST_CASE
# Largest number of states of a closed loop for which norms are computed while a slider moves.
_QUICK = 48


@value
class CagedLoop:
    """A caging loop: controller u = K y, the whole set of plants, and the plant that is shown alone.

    `shaped` returns a controller with its commands where the design says what to do with them.
    """

    job: Job
    spec: LoopSpec
    design: str
    plants: PlantSet
    shown: PlantSet
    controller: System
    shaped: Callable[[System], System] | None = None

    @property
    def delivered(self) -> System:
        """The controller that is measured, with its commands where it does more with them than to compare."""
        return self.controller if self.shaped is None else self.shaped(self.controller)

    @property
    def plant(self) -> System:
        """The plant shown."""
        return self.shown.arrays.at(0)

    @property
    def exact(self) -> bool:
        """Whether the loop has few enough states for exact norms while a slider moves."""
        return int(self.plants.A.shape[-1]) + len(self.controller.A) <= _QUICK


# Why there is no value yet: a budget of the line of sight takes longer than all else.
LATER = "measured as soon as the sliders rest"


class CagedCurves(drawn.LoopCurves):
    """The curves of a caging loop; with `metrics` those of the whole set too, failed parts left out."""

    def __init__(self, loop: CagedLoop, settings: Settings, metrics: Callable[..., LoopMetrics] | None = None) -> None:
        names = loop.plants
        channel = settings.channel if settings.channel in names.torques else names.torques[0]
        super().__init__(job=loop.job, settings=settings, plant=loop.plant, controller=loop.controller,
                         readings=names.angles, torquers=names.torques, channel=channel)  # fmt: skip
        self.loop, self._metrics = loop, metrics
        self.shown = Loop(loop.shown, loop.controller)
        sensors = self.job.units
        sets = sensors | {torquer.name: torquer.unit for torquer in self.job.platform.torquers}
        torques = {name: sets[name.removesuffix(COMMAND)] for name in self.torquers}
        self.units = sensors | dict.fromkeys(names.sight, "rad/s") | torques
        self.limits = {kind: loop.spec.limits.get(metric.key) for kind, metric in METRICS.items()}
        self.frequency = self._frequencies()
        self.set: Loop | None = None
        self.all_stable, self.other_poles = True, np.zeros(0, dtype=np.complex128)
        if metrics is None:
            return
        self.whole = Loop(names, loop.delivered)
        within = names.of(_BAND)
        self.all_stable = bool(np.all(self.whole.decay[within] > 0.0))
        if settings.band and len(names.labels) > 1:
            inside = np.flatnonzero(within)
            self.set = self.whole if within.all() else Loop(names.only(inside.tolist()), loop.delivered)
            own = self.set.plants
            self.band = drawn.Band(own.labels, own.frequency, drawn.channel_response(self.set.S_input, self.index))
            self.other_poles = continuous_poles(self.set.poles, self.plant.dt)

    @cached_property
    def z_poles(self) -> ComplexArray:
        """Closed-loop poles of the plant shown, in z, without those of equilibria that nothing sees."""
        return np.asarray(self.shown.poles[0])

    def _frequencies(self) -> FloatArray:
        plant, s = self.loop.shown, self.poles
        nyquist = math.pi / plant.period
        own = continuous_poles(np.linalg.eigvals(plant.A[0]), plant.period)
        low = max(min(2e-3 * plant.nutation, 0.05 * nyquist), 1e-4 * nyquist)
        # The slowest pole is inside the diagram.
        low = max(min(low, 0.2 * float(np.abs(s[np.isfinite(s)]).min(initial=np.inf))), 1e-5 * nyquist)
        grid = following_grid(np.concatenate([s, own]), low, drawn.EDGE * nyquist, drawn.GRID_POINTS)
        # With the frequencies of the band, whose phases are those of this curve and a difference.
        return np.union1d(grid, plant.frequency)

    def step(self) -> TimeResponse:
        """Return the response to a torque step at the channel, of a loop around another one to one of its command."""
        plants = self.loop.plants
        size = step_size(float(plants.torque_limit[self.index]))
        duration = settling(self.poles, self.loop.shown.nutation, plants.period, self.stable)
        title = f"{quantity(size, self.units[self.channel])} step at {self.channel}"
        step = drive(title, duration, plants.period, lambda t: np.full(len(t), size))
        return self._over_time(
            step, lambda one: one.arrays if self._sight else one.own_arrays, [self.index], step.u[None]
        )

    def disturbance(self) -> TimeResponse:
        """Return the response to the job's manoeuvre about the axis, linear model."""
        plants, m = self.loop.plants, self.shown.m
        turn, commanded, held = caged_excitation(self.job, self.axis, plants.angles, plants.nutation, plants.period)
        if self.loop.spec.kind == "rate":
            turn = turn._replace(limit=None)
        if plants.tilted:
            turn = turn._replace(title=f"{turn.title}, gravity turns with the base")
        commands = held.T
        inputs = np.vstack([turn.u, commands])
        columns = [m + self.axis - 1, *(m + 3 + plants.angles.index(name) for name in commanded)]
        if len(commands) and not turn.u.any():
            turn = turn._replace(u=commands[0])
        return self._over_time(turn, commanded_arrays if len(commands) else lambda one: one.arrays, columns, inputs)

    @property
    def _sight(self) -> tuple[str, ...]:
        """Rates across the line of sight where they are shown in place of what a rate loop reads.

        Designs that read other sensors are compared by them. A limit on the readings is shown with the readings.
        """
        read = self.loop.spec.kind != "rate" or self.limits["Omega rejection"] is not None
        return () if read else self.loop.plants.sight

    def _over_time(
        self, given: SampledInput, arrays: Callable[[Loop], System], columns: Sequence[int], inputs: FloatArray
    ) -> TimeResponse:
        m, p = self.shown.m, self.shown.p
        seen = self._sight or self.readings
        # The last outputs are those of the line of sight.
        rows = [*(range(-len(seen), 0) if self._sight else range(m, m + p)), *range(m)]
        band = None if self.set is None else arrays(self.set).part(rows, columns)
        return self.over_time(given, [*seen, *self.torquers], arrays(self.shown).part(rows, columns), band, inputs)

    def disturbance_gain(self) -> FrequencyGain:
        """Return the gain from Omega to what is read, or to the line of sight."""
        axis, band, kind = self.axis - 1, None, self.loop.spec.kind
        part = Transfer("Omega", "sight" if self._sight else "angle")
        if self.set is not None:
            every = np.arange(len(self.set.plants.labels))
            band = self.set.plants.frequency, self.set.responses(part, every)[0][..., axis]
        words = "line of sight" if self._sight else "rates" if kind == "rate" else "angles"
        shown = Loop(self.loop.shown.on(self.frequency), self.controller)
        own = shown.responses(part, np.zeros(1, dtype=np.intp))[0][0, ..., axis]
        unit, limit = of_readings(METRICS["Omega rejection"].unit, kind), self.limits["Omega rejection"]
        return drawn.frequency_gain(f"rate Omega{self.axis} → {words}", unit, self.frequency, own, band, limit)

    def measured(self, bode: Bode) -> Measured:
        """Return margins, limits and goals, by the metrics of the whole set."""
        loop, spec = self.loop, self.loop.spec
        assert self._metrics is not None, "of a loop that is drawn over another one nothing is measured"
        metrics = self._metrics(self.whole, quick=True)
        known = {kind for kind, *_ in metrics.requested}
        late = [one for one in spec.requests if METRICS[one.kind].of_sight and one.kind not in known]
        keys = {METRICS[one.kind].key for one in late}
        own, soft = ({key: x for key, x in of.items() if key not in keys} for of in (spec.limits, spec.soft))
        measured = dataclasses.replace(spec, limits=own, soft=soft)
        requirements, goals = limits_and_goals(measured, loop.design, loop.plants, metrics)
        requirements += tuple(
            dataclasses.replace(
                one.judge(math.nan, subject=spec.name, design=loop.design, stage="decoupled", evidence=LATER),
                reason=LATER,
                valid=False,
            )
            for one in late
            if one.hard
        )
        sampled = "peaks are the highest on a frequency grid: the loop is too large for exact ones while a slider moves"
        return Measured(
            margins=_margins(loop, metrics, self, bode),
            requirements=requirements,
            goals=goals,
            notes=() if loop.exact else (sampled,),
        )


def commanded_arrays(loops: Loop) -> System:
    """Return closed loops from torques, Omega and commands to the torques and what the plants show."""
    K = with_error_alone(loops.controller, loops.plants.commanded) if loops.two_degrees is None else loops.two_degrees
    return commanded_loop(loops.plants.whole, K, range(loops.m), range(loops.p))


def _margins(loop: CagedLoop, metrics: LoopMetrics, curves: CagedCurves, bode: Bode) -> Margins:
    plants, shown = loop.plants, curves.shown
    inside = np.flatnonzero(plants.of(_BAND))
    worst = int(inside[np.argmin(metrics.disk_margin[inside])])
    disk = float(metrics.disk_margin[0])  # of the nominal plant
    if not all(map(np.array_equal, loop.shown.arrays.at(0)[:4], plants.arrays.at(0)[:4])):
        request = MetricRequest(kind="disk margin", over=get_args(Group))
        disk = float(measured(shown, request, exact=loop.exact)[0])
    bandwidth = 0.0
    if curves.stable:
        found = (bandwidth_of_response(shown.plants.frequency, S[0]) for S in shown.sensitivities)
        bandwidth = float(min(found))
    return Margins(
        disk=disk,
        worst_disk=float(metrics.disk_margin[worst]),
        worst_plant=plants.labels[worst],
        worst_sampled=not loop.exact,
        **drawn.channel_margins(bode, curves.stable),
        bandwidth=bandwidth,
        damping=float(minimum_damping(shown.poles, plants.period)[0]),
    )


class StabilisedCurves(drawn.LoopCurves):
    """The curves of the free platform with all loops closed, `controllers` in the job's order; `check` is theirs.

    `plants` is the set (the nominal plant alone without a band), and `shown` the plant that is shown.
    """

    def __init__(
        self,
        job: Job,
        settings: Settings,
        model: LinearModel,
        controllers: Sequence[StateSpace],
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
        plant = shown.arrays.at(0).part(slice(None), self.used)
        super().__init__(job, settings, plant, controller, shown.sensors, torquers, channel)
        self.plants, self.shown, self._model, self._check = plants, shown, model, check
        self.units = dict.fromkeys(ATTITUDE, "rad") | job.units | {one.name: one.unit for one in job.platform.torquers}
        self.limits = {"disk margin": job.coupled.disk_margin}
        nyquist = math.pi / plant.dt
        slowest = float(np.abs(self.poles[np.isfinite(self.poles)]).min(initial=nyquist))
        low = max(min(0.1 * slowest, 0.01 * nyquist), 1e-5 * nyquist)
        # Free poles at z = 1 are integrators, no resonances.
        own = continuous_poles(poles(plant.A), plant.dt)
        grid = following_grid(np.concatenate([self.poles, own]), low, drawn.EDGE * nyquist, drawn.GRID_POINTS)
        self.frequency = np.union1d(grid, plants.frequency)
        self.banded, self.other_poles = bool(settings.band and len(plants.labels) > 1), self.poles[None]
        if self.banded:
            whole = plants.arrays.part(slice(None), self.used)
            self.other_poles = continuous_poles(poles(whole.feedback(controller).A), plant.dt)
            self.band = drawn.Band(plants.labels, plants.frequency, drawn.channel_response(self._S_of_set, self.index))
        self.all_stable = bool(np.all(spectral_abscissa(self.other_poles) < 0.0))
        # The servo's gain moves its torques; the caging loops stay closed as they are.
        self.moving = [name in self.roots for name in torquers]
        # It follows from the servo, which is far slower than the gyros.
        crossover = drawn.gain_crossings(self.frequency, drawn.channel_response(self.own.S, self.index))[0].max(
            initial=1.0
        )
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
        return whole.part(outputs, [len(self.shown.torquers) + self.axis - 1])

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
        column, p, k, band = len(self.shown.torquers) + self.axis - 1, len(self.readings), len(self.used), None
        if self.banded:
            w, whole = self.plants.frequency, self.plants.response
            # The disturbance moves the sensors, these the torques, and both the attitude.
            K = self._K_of_set
            sensed, driven = whole[..., :p, [column]], whole[..., self.used]
            torque = np.linalg.solve(np.eye(k) - K @ driven[..., :p, :], K @ sensed)
            band = w, (whole[..., p:, [column]] + driven[..., p:, :] @ torque)[..., 0]
        shown = self._turned(self.shown, slice(k + p, None)).at(0)
        own = frequency_response(shown, self.frequency, -3)[..., 0]
        return drawn.frequency_gain(
            f"torque M{self.axis} on the platform → attitude", "rad/(N m)", self.frequency, own, band
        )

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
            **drawn.channel_margins(bode, self.stable),
            bandwidth=bandwidth,
            damping=float(minimum_damping(self.z_poles[None], self.plant.dt)[0]),
        )
        return Measured(margins=margins, requirements=self._check().results)
