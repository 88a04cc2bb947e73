"""The plants of a job at what settings say of rotors, sampling and platform rate, kept while there is room."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.description import Platform
from platform_ctrl.design.channels import Channels
from platform_ctrl.design.plants import with_spins
from platform_ctrl.designer.bounded import Bounded
from platform_ctrl.designer.free_plants import FreePlants, SpinningModels, corners, free_models, free_plants
from platform_ctrl.designer.quick_plants import QuickPlants
from platform_ctrl.designer.values import Settings
from platform_ctrl.frozen import FloatArray
from platform_ctrl.job import Job, LoopSpec, Sampling
from platform_ctrl.linearisation import LinearModel, linearise


class JobPlants:
    """The plants of a job; safe in several threads.

    Parameters
    ----------
    job
        As it was read.
    """

    def __init__(self, job: Job) -> None:
        self.read = job
        self._quick: dict[str, QuickPlants] = {}
        self._lock = threading.Lock()
        self._channels: Bounded[Channels] = Bounded(12)
        self._models: Bounded[LinearModel] = Bounded(6)
        self._free: Bounded[FreePlants] = Bounded(6)
        self._free_models: Bounded[SpinningModels] = Bounded(4)
        self._corner: Bounded[list[tuple[str, Platform, FloatArray]]] = Bounded(4)

    def quick(self, spec: LoopSpec) -> QuickPlants:
        """Return what makes the plants of a caging loop."""
        with self._lock:
            if spec.name not in self._quick:
                self._quick[spec.name] = QuickPlants(self.read, spec.gimbals)
            return self._quick[spec.name]

    def channels_of(self, spec: LoopSpec) -> tuple[str, ...]:
        """Return the torquers of a loop."""
        if spec.kind == "caging":
            return tuple(self.read.platform.torquer_on(gimbal).name for gimbal in spec.gimbals)
        return tuple(t.name for t in self.read.platform.torquers if t.root_axis is not None)

    def loading_axis(self, spec: LoopSpec, axis: int) -> int:
        """Return the axis of Omega to look at: `axis` unless a rate about it does nothing to this loop."""
        return self.quick(spec).loading_axis(axis) if spec.kind == "caging" else axis

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
        if spec.kind == "caging":
            return self.quick(spec).labels(self.range(settings))
        return tuple(label for label, _, _ in self._corners(settings))

    def caged(self, settings: Settings, spec: LoopSpec) -> tuple[PlantSet, PlantSet]:
        """Return the plants of a caging loop, and the one that is shown alone."""
        quick, at = self.quick(spec), np.array(settings.Omega)
        sampling, widest = self.sampling(settings), self.range(settings)
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
        every = self._corners(settings)
        label, at = settings.plant, np.array(settings.Omega)
        if not at.any() and label in plants.labels:
            return plants, plants.only(plants.labels.index(label))
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

    def nutation(self, settings: Settings, spec: LoopSpec) -> float:
        """Return the nutation frequency of a caging loop's nominal plant, rad/s."""
        return self.quick(spec).nutation(settings.spins, self.sampling(settings), self.range(settings))

    def gyros(self, settings: Settings, spec: LoopSpec) -> Channels:
        """Return how the gyros couple the gimbals of a caging loop."""
        key = (spec.name, tuple(sorted(settings.spins.items())))
        return self._channels.get(key, lambda: self.quick(spec).channels(settings.spins))

    def model(self, settings: Settings) -> LinearModel:
        """Return the linear model of the whole platform at rest."""
        key = tuple(sorted(settings.spins.items()))
        return self._models.get(key, lambda: linearise(with_spins(self.read.platform, settings.spins)))

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

    def _corners(self, settings: Settings) -> list[tuple[str, Platform, FloatArray]]:
        key = (tuple(sorted(settings.spins.items())), *map(float, self.range(settings)))
        return self._corner.get(key, lambda: corners(self.job(settings)))
