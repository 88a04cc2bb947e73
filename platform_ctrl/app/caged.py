"""The picture of a caging loop: Omega is prescribed, one torquer is shown broken while all others stay closed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import get_args

import numpy as np

from platform_ctrl.analysis.feedback import commanded_loop, with_error_alone
from platform_ctrl.analysis.loop import Loop, Transfer
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure, measured
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.norms import bandwidth_of_response
from platform_ctrl.analysis.plant_set import COMMAND, Group, PlantSet
from platform_ctrl.analysis.poles import continuous_poles, following_grid, minimum_damping
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.app.curves import (
    EDGE,
    GRID_POINTS,
    Band,
    LoopCurves,
    channel_margins,
    channel_response,
    frequency_gain,
)
from platform_ctrl.app.excitation import SampledInput, caged_excitation, drive, settling, step_size
from platform_ctrl.app.pictures import Bode, FrequencyGain, Margins, Measured, TimeResponse
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import limits_and_goals
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.quantities import quantity
from platform_ctrl.job.requirements import WORST_CASE, of_readings

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


# A cache of a loop's metrics: computes them if they are not known.
CachedMetrics = Callable[[Callable[[], LoopMetrics]], LoopMetrics]


def loop_metrics(loop: CagedLoop, whole: Loop | None = None) -> LoopMetrics:
    """Return the metrics that the page shows of a loop: peaks are norms unless it has too many states for that."""
    requests = loop.spec.requests
    if loop.exact:
        return measure(loop.plants, loop.delivered, requests, loops=whole)
    return measure(loop.plants, loop.delivered, requests, exact=False)


class CagedCurves(LoopCurves):
    """The curves of a caging loop; with a cache of metrics those of the whole set too, failed parts left out."""

    def __init__(self, loop: CagedLoop, settings: Settings, cached: CachedMetrics | None = None) -> None:
        names = loop.plants
        channel = settings.channel if settings.channel in names.torques else names.torques[0]
        super().__init__(job=loop.job, settings=settings, plant=loop.plant, controller=loop.controller,
                         readings=names.angles, torquers=names.torques, channel=channel)  # fmt: skip
        self.loop, self._cached = loop, cached
        self.shown = Loop(loop.shown, loop.controller)
        sensors = {sensor.name: sensor.unit for sensor in self.job.platform.sensors}
        sets = sensors | {torquer.name: torquer.unit for torquer in self.job.platform.torquers}
        torques = {name: sets[name.removesuffix(COMMAND)] for name in self.torquers}
        self.units = sensors | dict.fromkeys(names.sight, "rad/s") | torques
        self.limits = {kind: loop.spec.limits.get(metric.key) for kind, metric in METRICS.items()}
        self.frequency = self._frequencies()
        self.set: Loop | None = None
        self.all_stable, self.other_poles = True, np.zeros(0, dtype=np.complex128)
        if cached is None:
            return
        self.whole = Loop(names, loop.delivered)
        within = names.of(_BAND)
        self.all_stable = bool(np.all(self.whole.decay[within] > 0.0))
        if settings.band and len(names.labels) > 1:
            inside = np.flatnonzero(within)
            self.set = self.whole if within.all() else Loop(names.only(inside.tolist()), loop.delivered)
            own = self.set.plants
            self.band = Band(own.labels, own.frequency, channel_response(self.set.S_input, self.index))
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
        grid = following_grid(np.concatenate([s, own]), low, EDGE * nyquist, GRID_POINTS)
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
        return frequency_gain(f"rate Omega{self.axis} → {words}", unit, self.frequency, own, band, limit)

    def measured(self, bode: Bode) -> Measured:
        """Return margins, limits and goals, by the metrics of the whole set."""
        loop = self.loop
        assert self._cached is not None, "of a loop that is drawn over another one nothing is measured"
        metrics = self._cached(lambda: loop_metrics(loop, self.whole))
        requirements, goals = limits_and_goals(loop.spec, loop.design, loop.plants, metrics)
        sampled = "peaks are the highest on a frequency grid: the loop is too large for exact ones while a slider moves"
        return Measured(
            margins=_margins(loop, metrics, self, bode),
            requirements=requirements,
            goals=goals,
            notes=() if loop.exact else (sampled,),
        )


def commanded_arrays(loops: Loop) -> System:
    """Return closed loops from torques, Omega and commands to the torques and what the plants show."""
    K = with_error_alone(loops.controller) if loops.two_degrees is None else loops.two_degrees
    return commanded_loop(loops.plants.whole, K, range(loops.m), range(loops.p))


def _margins(loop: CagedLoop, metrics: LoopMetrics, curves: CagedCurves, bode: Bode) -> Margins:
    plants, shown = loop.plants, curves.shown
    inside = np.flatnonzero(plants.of(_BAND))
    worst = int(inside[np.argmin(metrics.disk_margin[inside])])
    disk = float(metrics.disk_margin[0])  # of the nominal plant
    if not all(np.array_equal(getattr(loop.shown, of)[0], getattr(plants, of)[0]) for of in "ABCD"):
        request = MetricRequest(kind="disk margin", over=get_args(Group))
        disk = float(measured(shown, request, exact=loop.exact)[0])
    bandwidth = 0.0
    if curves.stable:
        found = (bandwidth_of_response(shown.plants.frequency, S[0]) for S in (shown.S_output, shown.S_input))
        bandwidth = float(min(found))
    return Margins(
        disk=disk,
        worst_disk=float(metrics.disk_margin[worst]),
        worst_plant=plants.labels[worst],
        worst_sampled=not loop.exact,
        **channel_margins(bode, curves.stable),
        bandwidth=bandwidth,
        damping=float(minimum_damping(shown.poles, plants.period)[0]),
    )
