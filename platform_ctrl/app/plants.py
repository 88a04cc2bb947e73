"""The plants of a loop again and again, for other rotor speeds, sample rates and platform rates, in milliseconds.

The linear equations are affine in the momenta of the rotors and linear in the platform rate with them,

    G = G0 + sum L_r G_r,        K = K0 + sum L_r sum Omega_a K_ra,        G_Omega = G_Omega0 + sum L_r G_Omega_r,

whatever the inertias: what a rotor contributes is found once, and every plant of the set is changed by it.
"""

from __future__ import annotations

import dataclasses
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.feedforward import RateFeedforward
from platform_ctrl.analysis.plant_set import COMMAND, PlantSet
from platform_ctrl.app.free_plants import FreePlants, SpinningModels, corners, free_models, free_plants
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.cases import Case, with_friction, with_spins
from platform_ctrl.design.feedforward import rate_feedforward
from platform_ctrl.design.loop_signals import LoopSignals, loop_channels, loop_signals
from platform_ctrl.design.partition import Channels
from platform_ctrl.design.plants import (
    LinearPlants,
    around,
    commanded_channels,
    job_signals,
    linear_plants,
    loop_cases,
    loop_reference,
    sampled_plants,
    tracking_reference,
    tracking_signals,
)
from platform_ctrl.job.job import DesignSpec, Job, LoopSpec, Sampling
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.state_space import named_rows, whole_subsystems
from platform_ctrl.plant.platform import Platform

T = TypeVar("T")


class Bounded(Generic[T]):
    """A cache of at most `room` items; safe in several threads."""

    def __init__(self, room: int) -> None:
        self.room = room
        self._items: OrderedDict[Hashable, T] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """Return how many items are kept."""
        return len(self._items)

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


# Share of the strongest axis below which a rate about an axis does nothing to a loop.
_LOAD = 1e-6


@value
class _Share:
    """What 1 N m s of a rotor's momentum adds: G (n, n), K for unit rates about each root axis (3, n, n), G_Omega."""

    G: FloatArray
    K: FloatArray
    G_Omega: FloatArray


class QuickPlants:
    """Plants of one loop, or of the caging loop on some gimbals.

    The loop is computed at `every` how many samples; `used` says so of readings for which it is not the same.
    """

    def __init__(
        self,
        job: Job,
        loop: LoopSpec | LoopSignals | tuple[str, ...],
        every: int = 1,
        used: Mapping[str, int] | None = None,
    ) -> None:
        platform = job.platform
        self.every, self.used = every, used
        self.signals = loop if isinstance(loop, LoopSignals) else job_signals(job, loop)
        self.job, self.gimbals = job, self.signals.gimbals
        self.model = linearise(platform)
        held = self.signals.held
        self.rows = (named_rows if held else whole_subsystems)(self.model, self.gimbals)
        self.momenta = {r.name: r.angular_momentum for r in job.platform.rotors}
        self.shares = {name: self._share(name) for name in self.momenta}
        self._linear: Bounded[LinearPlants] = Bounded(4)
        self._cases: Bounded[tuple[Case, ...]] = Bounded(4)
        self._moved: Bounded[LinearPlants] = Bounded(4)
        self._sets: Bounded[PlantSet] = Bounded(6)
        self._shown: Bounded[PlantSet] = Bounded(6)

    def plants(self, spins: Mapping[str, float], sampling: Sampling, Omega: FloatArray) -> PlantSet:
        """Return the set of plants: `loop_plants` of the job with these spins, sampling and largest platform rate."""
        key = (*self._key(spins), sampling.period, sampling.delay, *map(float, Omega))
        return self._sets.get(key, lambda: self._sampled(self.linear(spins, Omega), sampling, Omega))

    def shown(
        self, label: str, at: FloatArray, spins: Mapping[str, float], sampling: Sampling, Omega: FloatArray
    ) -> PlantSet:
        """Return one plant of that set alone, by its label, linearised at the rate `at` on top of its own."""
        key = (label, *map(float, at), *self._key(spins), sampling.period, sampling.delay, *map(float, Omega))
        return self._shown.get(key, lambda: self._one(label, at, spins, sampling, Omega))

    def labels(self, Omega: FloatArray) -> tuple[str, ...]:
        """Return the labels of the set."""
        return tuple(one.label for one in self._all(Omega))

    def nutation(self, spins: Mapping[str, float], sampling: Sampling, Omega: FloatArray) -> float:
        """Return the nutation frequency of the nominal plant, rad/s, as the set has it."""
        return loop_reference(self.linear(spins, Omega), self.every * sampling.period)

    def loading_axis(self, axis: int) -> int:
        """Return the axis about which a turn loads these gimbals: `axis` where it does, else that of most.

        By its rate, or, where no rotor feels that, by the change of its rate.
        """
        load = np.linalg.norm(self.model.G_Omega[self.rows], axis=0)
        load = load if load.any() else np.linalg.norm(self.model.M_Omega[self.rows], axis=0)
        return axis if load[axis - 1] > _LOAD * load.max() or not load.any() else 1 + int(np.argmax(load))

    def linear(self, spins: Mapping[str, float], Omega: FloatArray) -> LinearPlants:
        """Return the plants before they are sampled."""
        return self._moved.get(
            (*self._key(spins), *map(float, Omega)), lambda: self._with_spins(self._base(Omega), spins)
        )

    def _one(
        self, label: str, at: FloatArray, spins: Mapping[str, float], sampling: Sampling, Omega: FloatArray
    ) -> PlantSet:
        every = self._all(Omega)
        case = next((one for one in every if one.label == label), every[0])
        if self.signals.held:
            # These loops are about rest, see `loop_cases`: the platform's rate is that at which bearings turn.
            torquers, fed = ([one.name for one in part] for part in (self.signals.torquers, self.signals.fed))
            job = dataclasses.replace(self.job, Omega=np.abs(at))
            turned = next(iter(with_friction(job, torquers, fed, [case])), case)
        else:
            turned = dataclasses.replace(case, Omega=case.Omega + at)
        return self._sampled(self._with_spins(linear_plants(self.signals, (turned,)), spins), sampling, Omega)

    def _sampled(self, linear: LinearPlants, sampling: Sampling, Omega: FloatArray) -> PlantSet:
        return sampled_plants(linear, sampling, Omega, self.every, self.used)

    def _all(self, Omega: FloatArray) -> tuple[Case, ...]:
        key = tuple(map(float, Omega))
        return self._cases.get(key, lambda: tuple(loop_cases(dataclasses.replace(self.job, Omega=Omega), self.signals)))

    def _base(self, Omega: FloatArray) -> LinearPlants:
        key = tuple(map(float, Omega))
        return self._linear.get(key, lambda: self._widened(Omega))

    def _widened(self, Omega: FloatArray) -> LinearPlants:
        """Linearise all plants; with another range of Omega only those that it moves."""
        plants = self._all(Omega)
        if np.array_equal(Omega, self.job.Omega):
            return linear_plants(self.signals, plants)
        own = self._base(np.asarray(self.job.Omega))
        known = {case.label: k for k, case in enumerate(own.cases)}
        new = tuple(case for case in plants if case.label not in known)
        fresh = linear_plants(self.signals, new) if new else own
        place = {case.label: k for k, case in enumerate(fresh.cases)} if new else {}

        def picked(name: str) -> FloatArray:
            old, other = getattr(own, name), getattr(fresh, name)
            return np.array([other[place[c.label]] if c.label in place else old[known[c.label]] for c in plants])

        names = ("A", "B", "C", "D", "B_Omega", "D_Omega", "C_sight", "D_sight")
        return dataclasses.replace(own, cases=plants, **dict[str, Any]({name: picked(name) for name in names}))

    def _changes(self, spins: Mapping[str, float]) -> dict[str, float]:
        """Return by how much the momentum of each rotor is larger than the job's, N m s."""
        inertias = {r.name: r.axial_inertia for r in self.job.platform.rotors}
        nominal = {r.name: r.spin for r in self.job.platform.rotors}
        return {
            name: inertias[name] * spin - self.momenta[name]
            for name, spin in spins.items()
            if name in inertias and spin != nominal[name]
        }

    def _key(self, spins: Mapping[str, float]) -> tuple[float, ...]:
        changes = self._changes(spins)
        return tuple(changes.get(name, 0.0) for name in self.momenta)

    def _with_spins(self, linear: LinearPlants, spins: Mapping[str, float]) -> LinearPlants:
        changes = self._changes(spins)
        if not any(changes.values()):
            return linear
        if self.signals.held:
            moved = [dataclasses.replace(one, platform=self._spun(one.platform, changes)) for one in linear.cases]
            return linear_plants(self.signals, moved)
        n = len(self.rows)
        A, B_Omega = linear.A.copy(), linear.B_Omega.copy()
        mobility, momenta = A[:, :n, n : 2 * n], slice(n, 2 * n)
        # q̇ = M⁻¹ (p − M_Omega ω): the upper rows of the input of Omega are −M⁻¹ M_Omega.
        turned = B_Omega[:, :n]
        rates = np.array([case.Omega for case in linear.cases])
        for name, change in changes.items():
            share = self.shares[name]
            # A plant of the uncertainty has this rotor's L larger by a factor.
            factor = np.array([_factor(case.platform, name, self.momenta[name]) for case in linear.cases]) * change
            G = factor[:, None, None] * share.G
            K = factor[:, None, None] * np.einsum("ka,aij->kij", rates, share.K)
            A[:, momenta, :n] -= K
            A[:, momenta, momenta] -= G @ mobility
            B_Omega[:, momenta] -= G @ turned + factor[:, None, None] * share.G_Omega
        return dataclasses.replace(linear, A=A, B_Omega=B_Omega)

    def _spun(self, platform: Platform, changes: Mapping[str, float]) -> Platform:
        for name, change in changes.items():
            factor = _factor(platform, name, self.momenta[name])
            platform = _with_momentum(platform, name, factor * (self.momenta[name] + change))
        return platform

    def _share(self, rotor: str) -> _Share:
        platform, unit = self.job.platform, 1.0
        scale = max((abs(x) for x in self.momenta.values()), default=0.0) or unit
        with_it, without = (
            _with_momentum(platform, rotor, momentum) for momentum in (self.momenta[rotor] + scale, self.momenta[rotor])
        )
        part = np.ix_(self.rows, self.rows)
        still = linearise(with_it), linearise(without)
        K = []
        for axis in range(3):
            rate = np.eye(3)[axis]
            more, less = linearise(with_it, Omega=rate), linearise(without, Omega=rate)
            K.append((more.K[part] - less.K[part]) / scale)
        return _Share(
            G=(still[0].G[part] - still[1].G[part]) / scale,
            K=np.array(K),
            G_Omega=(still[0].G_Omega[self.rows] - still[1].G_Omega[self.rows]) / scale,
        )


def _with_momentum(platform: Platform, rotor: str, momentum: float) -> Platform:
    rotors = tuple(dataclasses.replace(r, angular_momentum=momentum) if r.name == rotor else r for r in platform.rotors)
    return dataclasses.replace(platform, rotors=rotors)


def _factor(platform: Platform, rotor: str, nominal: float) -> float:
    momentum = next(r.angular_momentum for r in platform.rotors if r.name == rotor)
    return momentum / nominal if nominal else 1.0


class JobPlants:
    """The plants of a job; safe in several threads."""

    def __init__(self, job: Job) -> None:
        self.read = job
        self._quick: dict[tuple[str, ...], QuickPlants] = {}
        self._loops = {spec.name: spec for spec in job.loops}
        self._lock = threading.Lock()
        self._channels: Bounded[Channels] = Bounded(12)
        self._fed: Bounded[RateFeedforward] = Bounded(12)
        self._fed_forward: Bounded[PlantSet] = Bounded(6)
        self._models: Bounded[LinearModel] = Bounded(6)
        self._free: Bounded[FreePlants] = Bounded(6)
        self._free_models: Bounded[SpinningModels] = Bounded(4)
        self._corner_labels: Bounded[tuple[str, ...]] = Bounded(4)

    def quick(self, spec: LoopSpec, around: LoopSpec | None = None) -> QuickPlants:
        """Return what makes the plants of a loop as a design reads it; of a tracking loop `around` another."""
        key = (spec.name, *spec.sensors, *(() if around is None else around.sensors))
        with self._lock:
            if key not in self._quick:
                if around is None:
                    self._quick[key] = QuickPlants(self.read, spec, self.read.every(spec))
                else:
                    used = dict.fromkeys(spec.sensors, self.read.every(spec))
                    both = tracking_signals(self.read, spec, around)
                    self._quick[key] = QuickPlants(self.read, both, self.read.every(around), used)
            return self._quick[key]

    def inside(self, spec: LoopSpec) -> LoopSpec:
        """Return the rate loop that a tracking loop commands, of other loops the loop itself."""
        return self._loops[spec.around] if spec.around is not None else spec

    def channels_of(self, spec: LoopSpec) -> tuple[str, ...]:
        """Return the torquers of a loop, of a tracking loop the commands that it sets."""
        if spec.around is not None:
            inner = self.inside(spec)
            return tuple(f"{name}{COMMAND}" for name in inner.read_by(inner.closed).sensors)
        if spec.has_plants:
            return tuple(torquer.name for torquer in loop_signals(self.read.platform, spec).torquers)
        return tuple(t.name for t in self.read.platform.torquers if t.root_axis is not None)

    def loading_axis(self, spec: LoopSpec, axis: int) -> int:
        """Return the axis of Omega to look at: `axis` unless a rate about it does nothing to this loop."""
        return self.quick(self.inside(spec)).loading_axis(axis) if spec.has_plants else axis

    def feels_Omega(self, spec: LoopSpec) -> bool:
        """Return whether a loop's plants depend on the platform rate; of those that are held only dry friction does."""
        held = spec.has_plants and self.quick(self.inside(spec)).signals.held
        return not held or any(max(one.breakaway) > 0.0 for one in self.read.platform.frictions)

    def job(self, settings: Settings) -> Job:
        """Return the job with the settings' rotors, sampling and range of Omega; its designs are as they were read."""
        return dataclasses.replace(
            self.read,
            platform=with_spins(self.read.platform, settings.spins),
            sampling=self.sampling(settings),
            Omega=self.range(settings),
        )

    def labels(self, settings: Settings, spec: LoopSpec) -> tuple[str, ...]:
        """Return the labels of a loop's plants that may be shown, the nominal one first."""
        if spec.has_plants:
            return self.quick(self.inside(spec)).labels(self.range(settings))
        # They are the same at all spins.
        of = tuple(map(float, self.range(settings)))
        return self._corner_labels.get(of, lambda: tuple(label for label, _, _ in corners(self.job(settings))))

    def caged(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> tuple[PlantSet, PlantSet]:
        """Return the plants of a design of a loop, its feedforward in them, and the one that is shown alone."""
        plants, shown = self._plants(settings, self.quick(spec.read_by(design)))
        fed = self.feedforward(settings, spec, design)
        if fed is None:
            return plants, shown
        key = (spec.name, design.name, self.key(settings))
        return self._fed_forward.get(key, lambda: plants.fed_forward(fed)), shown.fed_forward(fed)

    def around(
        self, settings: Settings, spec: LoopSpec, inner: LoopSpec, design: DesignSpec, K: StateArrays
    ) -> tuple[PlantSet, PlantSet]:
        """Return the plants of a tracking loop, `K` of the rate loop's `design` closed, and the one shown alone."""
        job, fed = self.job(settings), self.feedforward(settings, inner, design)
        plants, shown = self._plants(settings, self.quick(spec, inner.read_by(design)))
        return around(job, spec, plants, fed, K)[0], around(job, spec, shown, fed, K)[0]

    def directions_around(
        self, settings: Settings, spec: LoopSpec, inner: LoopSpec, design: DesignSpec, K: StateArrays
    ) -> Channels:
        """Return the directions of a tracking loop, which are those of the nominal plant."""
        plants, _ = self._plants(settings, self.quick(spec, inner.read_by(design)))
        return around(self.job(settings), spec, plants.only([0]), self.feedforward(settings, inner, design), K)[1]

    def feedforward(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> RateFeedforward | None:
        """Return the feedforward of a design, or None."""
        if design.feedforward is None:
            return None
        key = (spec.name, design.name, self.key(settings))
        return self._fed.get(key, lambda: rate_feedforward(self.job(settings), spec.read_by(design), design))

    def _plants(self, settings: Settings, quick: QuickPlants) -> tuple[PlantSet, PlantSet]:
        sampling, widest, at = self.sampling(settings), self.range(settings), np.array(settings.Omega)
        plants = quick.plants(settings.spins, sampling, widest)
        if at.any():
            return plants, quick.shown(settings.plant, at, settings.spins, sampling, widest)
        return plants, plants.only([plants.labels.index(settings.plant) if settings.plant in plants.labels else 0])

    def free(self, settings: Settings, rates: Sequence[str]) -> tuple[FreePlants, FreePlants]:
        """Return the plants of the free platform with sensors of the `rates`, and the one that is shown alone."""
        sampling, widest = self.sampling(settings), self.range(settings)
        key = (self.key(settings), tuple(rates), settings.band)
        base = (tuple(map(float, widest)), tuple(rates), settings.band)

        def models() -> SpinningModels:
            start = corners(dataclasses.replace(self.read, Omega=widest))
            return SpinningModels(job=self.read, cases=start if settings.band else start[:1], rates=tuple(rates))

        plants = self._free.get(
            key,
            lambda: free_plants(self._free_models.get(base, models).at(settings.spins), sampling, settings.band),
        )
        label, at = settings.plant, np.array(settings.Omega)
        if not at.any() and label in plants.labels:
            return plants, plants.only(plants.labels.index(label))
        every = corners(self.job(settings))
        case = next((one for one in every if one[0] == label), every[0])
        turned = (case[0], case[1], case[2] + at)
        shown = self._free.get(
            ("shown", key, label, settings.Omega),
            lambda: free_plants(free_models(self.job(settings), [turned], tuple(rates)), sampling, False),
        )
        return plants, shown

    def sampling(self, settings: Settings) -> Sampling:
        """Return the sampling of the settings."""
        return Sampling(period=1.0 / settings.rate_hz, delay=settings.delay)

    def period(self, settings: Settings, spec: LoopSpec) -> float:
        """Return the period at which a loop is computed, s."""
        return self.read.every(spec) / settings.rate_hz

    def nutation(self, settings: Settings, spec: LoopSpec) -> float:
        """Return the nutation frequency of a loop's nominal plant, rad/s."""
        return self.nutation_at(settings.spins, spec, self.sampling(settings), self.range(settings))

    def nutation_at(self, spins: Mapping[str, float], spec: LoopSpec, sampling: Sampling, Omega: FloatArray) -> float:
        """Return the nutation frequency of a loop's nominal plant, or the frequency that a tracking loop goes by."""
        found = self.quick(self.inside(spec)).nutation(spins, sampling, Omega)
        return found if spec.around is None else tracking_reference(self.read, spec, found, sampling.period)

    def gyros(self, spins: Mapping[str, float], spec: LoopSpec, period: float | None = None) -> Channels:
        """Return the directions in which methods see a loop as a design reads it; default of `period`: the job's.

        Those of a tracking loop are without the combination of its readings, which depends on the loop inside.
        """
        period = self.read.period_of(spec) if period is None else period
        if spec.around is not None:
            return commanded_channels(len(self.channels_of(spec)))

        def made() -> Channels:
            model = self.model(spins)
            return loop_channels(model, loop_signals(model.platform, spec), period)

        return self._channels.get((spec.name, spec.sensors, period, tuple(sorted(spins.items()))), made)

    def model(self, spins: Mapping[str, float]) -> LinearModel:
        """Return the linear model of the whole platform at rest at these spins."""
        key = tuple(sorted(spins.items()))
        return self._models.get(key, lambda: linearise(with_spins(self.read.platform, spins)))

    def range(self, settings: Settings) -> FloatArray:
        """Return the largest platform rate about each axis: the job's, or what is shown where that is more."""
        return np.maximum(self.read.Omega, np.abs(settings.Omega))

    def key(self, settings: Settings) -> tuple[float, float, tuple[tuple[str, float], ...], tuple[float, ...]]:
        """Return all that the plants depend on: rate, delay, spins and range of Omega, as `Conditions` has them."""
        return (
            settings.rate_hz,
            settings.delay,
            tuple(sorted(settings.spins.items())),
            tuple(map(float, self.range(settings))),
        )
