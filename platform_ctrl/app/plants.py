"""The plants of a job's loops, made once: of designs, and of the whole platform, free to turn."""

from __future__ import annotations

import dataclasses
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from itertools import product
from typing import Any, Generic, TypeVar

import numpy as np

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import held_input, sampled
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.cases import changed, swung
from platform_ctrl.design.feedforward import design_plants
from platform_ctrl.design.loop_signals import Channels, loop_channels, loop_signals
from platform_ctrl.design.method import METHODS
from platform_ctrl.design.plants import commanded_channels, job_signals, tracking_reference
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import named_rows, whole_subsystems
from platform_ctrl.mechanics.state_space import state_space as linear_state_space
from platform_ctrl.plant.drives import ROOT_TORQUE_NAMES
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

T = TypeVar("T")


class Bounded(Generic[T]):
    """A cache of at most `room` items; safe in several threads."""

    def __init__(self, room: int) -> None:
        self.room = room
        self._items: OrderedDict[Hashable, T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the item of `key`, made when it is not there: two threads may both make it."""
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key]
        made = make()
        self.put(key, made)
        return made

    def put(self, key: Hashable, item: T) -> None:
        """Keep an item, and let the oldest go."""
        with self._lock:
            self._items[key] = item
            self._items.move_to_end(key)
            while len(self._items) > self.room:
                self._items.popitem(last=False)

    def found(self, key: Hashable) -> T | None:
        """Return the item of `key`, or None."""
        with self._lock:
            return self._items.get(key)


ATTITUDE = ("attitude1", "attitude2", "attitude3")
# Frequencies of the band: it needs no more to be drawn.
_BAND_POINTS = 36


@value
class FreePlants:
    """Sampled plants of the free platform: torquers → sensors, and torques on the platform → its attitude.

    `labels` are those of the N plants, the nominal one first. `arrays` are stacks (N, ...) from `torquers` to
    `sensors`; `turned` has the attitude as states and outputs too: torques M1 to M3 on the platform, held and not
    delayed, behind the torquers' inputs; ATTITUDE behind the sensors. `response` (N, F, sensors + 3, torquers + 3) is
    that of `turned` at the band's `frequency` (F,), rad/s.
    """

    labels: tuple[str, ...]
    torquers: tuple[str, ...]
    sensors: tuple[str, ...]
    arrays: System
    turned: System
    period: float
    frequency: FloatArray
    response: ComplexArray

    def only(self, k: int) -> FreePlants:
        """Return one of the plants alone, without a band."""
        at = slice(k, k + 1)
        own: dict[str, Any] = {"labels": self.labels[at], "arrays": self.arrays.at(at), "turned": self.turned.at(at)}
        return dataclasses.replace(self, **own, frequency=self.frequency[:0], response=self.response[at, :0])


def corners(job: Job) -> list[tuple[str, Platform, FloatArray]]:
    """Return label, platform and rate of the nominal plant, and of the corners of Omega and of the parameters.

    All inertias move together there, and all momenta: a corner for each sign of each would be hundreds.
    """
    platform, still = job.platform, np.zeros(3)
    out = [(label or "nominal", one, still) for label, one in swung(job)]
    gimbals, rotors = [g.name for g in platform.gimbals], [r.name for r in platform.rotors]
    widths = [("inertia", job.uncertainty.inertia, gimbals), ("spin", job.uncertainty.spin, rotors)]
    widths = [one for one in widths if one[1] > 0.0 and one[2]]
    for signs in product((-1.0, 1.0), repeat=len(widths)) if widths else ():
        moved = {of: dict.fromkeys(names, sign * width) for (of, width, names), sign in zip(widths, signs, strict=True)}
        words = (
            f"all {'J' if of == 'inertia' else 'L'}{sign * width:+.0%}"
            for (of, width, _), sign in zip(widths, signs, strict=True)
        )
        out.append((" ".join(words), changed(platform, moved), still))
    axes = [(-rate, rate) if rate > 0.0 else (0.0,) for rate in map(float, job.Omega)]
    for rates in product(*axes):
        if any(rates):
            label = f"Omega = ({rates[0]:g}, {rates[1]:g}, {rates[2]:g}) rad/s"
            out.append((label, platform, np.array(rates)))
    return out


def free_plants(
    job: Job, cases: Sequence[tuple[str, Platform, FloatArray]], rates: Sequence[str], band: bool
) -> FreePlants:
    """Return the free platform, sampled, with all of its torquers, pick-offs, and the rate sensors named in `rates`.

    `cases` have label, platform and rate of the root; with a `band` there are responses on a grid.
    """
    sensors = [*(s.name for s in job.platform.pickoffs), *rates]
    torquers = job.platform.torquers
    rows = []
    for _, platform, Omega in cases:
        system = linear_state_space(linearise(platform, Omega=Omega), root="free")
        inputs, outputs = list(system.input_labels), list(system.output_labels)
        driven = [inputs.index(t.signal) for t in torquers]
        held = [inputs.index(name) for name in ROOT_TORQUE_NAMES]
        turning = [outputs.index(name) for name in OMEGA_NAMES]
        seen = observed(system, platform, sensors, Omega=Omega).C
        rows.append((system.A, system.B[:, driven], seen, system.B[:, held], system.C[turning]))
    A, B, C, B_root, C_rate = map(np.array, zip(*rows, strict=True))
    N, n, m = B.shape
    period, delay, lags = job.sampling.period, job.sampling.delay, np.array([t.lag for t in torquers])
    own = System(A, B, C, np.zeros((N, len(sensors), m)), 0.0)
    # With the attitude as states and outputs: on the sampled plant's own states lags and held torques have no effect.
    none = np.zeros((N, 3, 3))
    turned = System(
        np.block([[A, np.zeros((N, n, 3))], [C_rate, none]]),
        np.concatenate([B, np.zeros((N, 3, m))], axis=1),
        np.block([[C, np.zeros((N, len(sensors), 3))], [np.zeros((N, 3, n)), np.broadcast_to(np.eye(3), none.shape)]]),
        np.zeros((N, len(sensors) + 3, m)),
        0.0,
    )
    acting = held_input(turned.A, np.concatenate([B_root, none], axis=1), period)[1]
    turned = sampled(turned, period, delay, lags)
    both = np.zeros((N, turned.A.shape[-1], m + 3))
    both[..., :m], both[:, : n + 3, m:] = turned.B, acting
    D = np.concatenate([turned.D, np.zeros((N, len(sensors) + 3, 3))], axis=-1)
    turned = turned._replace(B=both, D=D)
    nyquist = np.pi / period
    # Oscillating poles alone: the pole b/J of a damped axis says nothing about the loop.
    fastest = float(np.abs(np.linalg.eigvals(A[0]).imag).max(initial=0.0)) or 0.1 * nyquist
    low = min(2e-3 * fastest, 0.01 * nyquist)
    grid = np.geomspace(low, 0.999 * nyquist, _BAND_POINTS) if band else np.zeros(0)
    return FreePlants(
        labels=tuple(label for label, _, _ in cases),
        torquers=tuple(t.name for t in torquers),
        sensors=tuple(sensors),
        arrays=sampled(own, period, delay, lags),
        turned=turned,
        period=period,
        frequency=grid,
        response=frequency_response(turned, grid, -3),
    )


# Share of the strongest axis below which a rate about an axis does nothing to a loop.
_LOAD = 1e-6


class JobPlants:
    """The plants of a job; safe in several threads."""

    def __init__(self, job: Job) -> None:
        self.read = job
        self._plants: Bounded[PlantSet] = Bounded(64)
        self._channels: Bounded[Channels] = Bounded(64)
        self._free: Bounded[FreePlants] = Bounded(6)

    @cached_property
    def model(self) -> LinearModel:
        """The linear model of the whole platform at rest."""
        return linearise(self.read.platform)

    def inside(self, spec: LoopSpec) -> LoopSpec:
        """Return the rate loop that a tracking loop commands, of other loops the loop itself."""
        return self.read.loop(spec.around) if spec.around is not None else spec

    def loading_axis(self, spec: LoopSpec, axis: int) -> int:
        """Return the axis about which a turn loads the gimbals of a loop: `axis` where it does, else that of most.

        By its rate, or, where it turns no rotor's momentum, by its acceleration.
        """
        if not spec.has_plants:
            return axis
        signals = job_signals(self.read, self.inside(spec))
        rows = (named_rows if signals.held else whole_subsystems)(self.model, signals.gimbals)
        load = np.linalg.norm(self.model.G_Omega[rows], axis=0)
        load = load if load.any() else np.linalg.norm(self.model.M_Omega[rows], axis=0)
        return axis if load[axis - 1] > _LOAD * load.max() or not load.any() else 1 + int(np.argmax(load))

    def labels(self, spec: LoopSpec) -> tuple[str, ...]:
        """Return the labels of a loop's plants that may be shown, the nominal one first."""
        if not spec.has_plants:
            return tuple(label for label, _, _ in corners(self.read))
        inner = self.inside(spec)
        return self.of(inner, inner.closed).labels

    def of(self, spec: LoopSpec, design: DesignSpec) -> PlantSet:
        """Return the plants of a design of a loop, its feedforward in them."""
        name = None if design.feedforward is None else design.name

        def made() -> PlantSet:
            bare = None if name is None else self._plants.found((spec.name, spec.read_by(design).sensors, None))
            plants = design_plants(self.read, spec, design, bare)
            assert plants is not None, "the loop has plants"
            return plants

        return self._plants.get((spec.name, spec.read_by(design).sensors, name), made)

    def free(self, label: str, rates: Sequence[str], band: bool) -> tuple[FreePlants, FreePlants]:
        """Return the plants of the free platform with sensors of the `rates`, and the one that is shown alone."""
        cases = corners(self.read)

        def plants(chosen: list[int], band: bool) -> FreePlants:
            def made() -> FreePlants:
                return free_plants(self.read, [cases[k] for k in chosen], rates, band)

            return self._free.get((tuple(chosen), tuple(rates), band), made)

        at = next((k for k, (name, _, _) in enumerate(cases) if name == label), 0)
        whole = plants(list(range(len(cases))) if band else [0], band)
        return whole, whole.only(at) if at < len(whole.labels) else plants([at], False)

    def nutation(self, spec: LoopSpec, design: DesignSpec) -> float:
        """Return the nutation frequency of a loop's nominal plant, or the reference frequency of a tracking loop."""
        if spec.around is None:
            return self.of(spec, design).nutation
        inner = self.inside(spec)
        found = self.of(inner, inner.closed).nutation
        return tracking_reference(self.read, spec, found, self.read.sampling.period)

    def gyros(self, spec: LoopSpec, design: DesignSpec) -> Channels:
        """Return the directions in which methods see a loop as a design reads it.

        The directions of a tracking loop are without the combination of its readings, which depends on the inner loop.
        """
        if spec.around is not None:
            return commanded_channels(len(self.read.channels_of(spec)))
        read, any_sensors = spec.read_by(design), METHODS[design.method].any_sensors
        platform, period = self.read.platform, self.read.period_of(spec)
        return self._channels.get(
            (spec.name, read.sensors, any_sensors),
            lambda: loop_channels(self.model, loop_signals(platform, read), period, any_sensors),
        )
