"""Loops closed as settings say: plants and controllers put together, and kept for as long as there is room."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays, state_space
from platform_ctrl.arguments import known_name
from platform_ctrl.check.coupled import sensed_rates
from platform_ctrl.description import Platform
from platform_ctrl.design.channels import Channels
from platform_ctrl.design.classical import starting_values
from platform_ctrl.design.plants import with_spins
from platform_ctrl.design.stabilisation import platform_servo
from platform_ctrl.designer.bounded import Bounded
from platform_ctrl.designer.caged import CagedLoop
from platform_ctrl.designer.controllers import (
    acting_options,
    acts,
    classical_arrays,
    default_numbers,
    full_options,
    parts_given,
    parts_used,
)
from platform_ctrl.designer.free_loop import StabilisedLoop
from platform_ctrl.designer.free_plants import FreePlants, SpinningModels, corners, free_models, free_plants
from platform_ctrl.designer.knobs import lowest_rate
from platform_ctrl.designer.pulling import Reins
from platform_ctrl.designer.quick_plants import QuickPlants
from platform_ctrl.designer.saving import SavedController
from platform_ctrl.designer.store import Store, given_designs
from platform_ctrl.designer.values import Knob, Settings
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.job import DesignSpec, Job, LoopSpec, Sampling
from platform_ctrl.linearisation import LinearModel, linearise

if TYPE_CHECKING:
    import control

# How readily a pull moves each group of knobs.
_WEIGHTS = {"gains": 1.0, "lead": 0.25, "notch": 0.05, "lag": 0.05}


class Closing:
    """The loops of a job, closed as settings say.

    Parameters
    ----------
    job
        As it was read.
    controllers
        A file with controllers that exist already, or None.
    """

    def __init__(self, job: Job, controllers: Path | None) -> None:
        self.read = job
        self.store = Store()
        self._specs = {spec.name: spec for spec in job.loops}
        self._quick: dict[str, QuickPlants] = {}
        self._lock = threading.Lock()
        self._models: Bounded[LinearModel] = Bounded(6)
        self._free: Bounded[FreePlants] = Bounded(6)
        self._free_models: Bounded[SpinningModels] = Bounded(4)
        self._channels: Bounded[Channels] = Bounded(12)
        self._corner: Bounded[list[tuple[str, Platform, FloatArray]]] = Bounded(4)
        self._margins: Bounded[dict[str, float]] = Bounded(16)
        self.start = self._first()
        for loop, design, method, made in [] if controllers is None else given_designs(controllers, job):
            spec = self._specs[loop]
            known = next((d for d in spec.designs if d.name == design), None)
            if known is None:
                continue
            if known.method == "classical" and method == "classical" and known.tune:
                mine = self.start.options[loop]
                options = {name: made.options.get(name, x) for name, x in mine[design].items()}
                self.start = self.start.but(options={**self.start.options, loop: {**mine, design: options}})
            elif not self.live(known):
                self.store.put(loop, design, self.key(self.start, spec, known), made)
        # What the job closes is closed here too wherever there is a controller for it.
        closed = {
            spec.name: spec.use if self._there(spec, spec.use) else self.start.closed[spec.name] for spec in job.loops
        }
        self.start = self.start.but(closed=closed, design=closed[self.start.loop])

    def _there(self, spec: LoopSpec, name: str) -> bool:
        design = next(d for d in spec.designs if d.name == name)
        return self.live(design) or self.store.has(spec.name, name, self.key(self.start, spec, design))

    @staticmethod
    def live(design: DesignSpec) -> bool:
        """Return whether a design is built from its knobs at once."""
        return design.method in ("classical", "platform-servo")

    def spec(self, name: str) -> LoopSpec:
        """Return a loop of the job.

        Raises
        ------
        ArgumentError
            There is none of that name.
        """
        known_name("loop", name, tuple(self._specs))
        return self._specs[name]

    def design(self, settings: Settings) -> tuple[LoopSpec, DesignSpec]:
        """Return the loop and the design that are worked on.

        Raises
        ------
        ArgumentError
            There are none of these names.
        """
        spec = self.spec(settings.loop)
        return spec, spec.designs[known_name("design", settings.design, tuple(d.name for d in spec.designs))]

    def channels_of(self, spec: LoopSpec) -> tuple[str, ...]:
        """Return the torquers of a loop."""
        if spec.kind == "caging":
            return tuple(self.read.platform.torquer_on(gimbal).name for gimbal in spec.gimbals)
        return tuple(t.name for t in self.read.platform.torquers if t.root_axis is not None)

    def labels(self, settings: Settings) -> tuple[str, ...]:
        """Return the labels of the plants that may be shown."""
        spec = self.spec(settings.loop)
        if spec.kind == "caging":
            return self.quick(spec).labels(self._range(settings))
        return tuple(label for label, _, _ in self._corners(settings, self.job(settings)))

    def quick(self, spec: LoopSpec) -> QuickPlants:
        """Return the plants of a caging loop."""
        with self._lock:
            if spec.name not in self._quick:
                self._quick[spec.name] = QuickPlants(self.read, spec.gimbals)
            return self._quick[spec.name]

    def loading_axis(self, spec: LoopSpec, axis: int) -> int:
        """Return the axis of Omega to look at: `axis` unless a rate about it does nothing to this loop."""
        return self.quick(spec).loading_axis(axis) if spec.kind == "caging" else axis

    def job(self, settings: Settings) -> Job:
        """Return the job that the settings stand for."""
        closed = {**settings.closed, settings.loop: settings.design}
        loops = tuple(
            dataclasses.replace(
                spec, use=closed[spec.name], designs=tuple(self._as_set(settings, spec, d) for d in spec.designs)
            )
            for spec in self.read.loops
        )
        return dataclasses.replace(
            self.read,
            platform=with_spins(self.read.platform, settings.spins),
            sampling=Sampling(period=1.0 / settings.rate_hz, delay=settings.delay),
            Omega=self._range(settings),
            loops=loops,
        )

    def _as_set(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> DesignSpec:
        if not self.live(design):
            return dataclasses.replace(design, options=dict(settings.options[spec.name][design.name]))
        if not self.touched(settings, spec.name, design.name):
            return design
        return dataclasses.replace(design, options=self.used(settings, spec, design), tune=False)

    def touched(self, settings: Settings, loop: str, design: str) -> bool:
        """Return whether a design's knobs or parts are not as the job has them, or what its defaults rest on."""
        start = self.start
        return (
            dict(settings.options[loop][design]) != dict(start.options[loop][design])
            or settings.parts_on(loop, design) != start.parts_on(loop, design)
            or settings.rate_hz != start.rate_hz
            or dict(settings.spins) != dict(start.spins)
        )

    def offered(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> dict[str, float]:
        """Return the options that a design is made of as the loop is now, those of parts that are off as well."""
        options = settings.options[spec.name][design.name]
        if design.method != "classical":
            return dict(options)
        return acting_options(
            options, self._gyros(settings, spec), lambda: self._nutation(settings, spec), 1.0 / settings.rate_hz
        )

    def slowest(self, settings: Settings) -> float:
        """Return the sample rate, Hz, from which on all loops can be built with their options as they are."""
        found = 0.0
        for spec in self.read.loops:
            for design in spec.designs:
                if self.live(design) or (spec.name, design.name) == (settings.loop, settings.design):
                    options = self.offered(settings, spec, design)
                    used = parts_used(options, settings.parts_on(spec.name, design.name))
                    found = max(found, lowest_rate(design.method, used))
        return found

    def used(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> dict[str, float]:
        """Return the options that a design uses, without those of parts that are off.

        Raises
        ------
        DesignError
            An option makes no sense.
        """
        offered = self.offered(settings, spec, design)
        if design.method != "classical":
            return offered
        channel, period = self._gyros(settings, spec), 1.0 / settings.rate_hz
        given = parts_used(offered, settings.parts_on(spec.name, design.name))
        try:
            complete = starting_values(given, channel, self._nutation(settings, spec), period)
        except DesignError as error:
            # It may be another loop than the one that is worked on.
            raise DesignError(f"{spec.name}, {error}") from None
        return {name: x for name, x in complete.items() if acts(name, channel)}

    def key(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> Hashable:
        """Return all that a design of a method depends on."""
        return (self.options_key(settings.options[spec.name][design.name]), self._plant_key(settings))

    @staticmethod
    def options_key(options: Mapping[str, float]) -> Hashable:
        """Return options as part of a key."""
        return tuple(sorted(options.items()))

    def caged(self, settings: Settings) -> tuple[CagedLoop, tuple[str, ...]]:
        """Return the caging loop that is worked on, and lines about its controller.

        Raises
        ------
        PlatformCtrlError
            It cannot be built.
        """
        spec, design = self.design(settings)
        quick, job = self.quick(spec), self.job(settings)
        plants = quick.plants(settings.spins, job.sampling, job.Omega)
        at = np.array(settings.Omega)
        if at.any():
            shown = quick.shown(settings.plant, at, settings.spins, job.sampling, job.Omega)
        else:
            shown = plants.only([plants.labels.index(settings.plant) if settings.plant in plants.labels else 0])
        K, note = self._caging(settings, spec, design)
        loop = CagedLoop(job=job, spec=spec, design=design.name, plants=plants, shown=shown, controller=K)
        return loop, (note,) if note else ()

    def stabilised(self, settings: Settings) -> tuple[StabilisedLoop, tuple[str, ...]]:
        """Return all loops closed around the free platform, and lines about their controllers.

        Raises
        ------
        PlatformCtrlError
            They cannot be built.
        """
        spec, _ = self.design(settings)
        job = self.job(settings)
        controllers, notes = self.all_controllers(settings)
        rates = tuple(sensed_rates(job, controllers))
        key = (self._plant_key(settings), rates, settings.band)
        every = self._corners(settings, job)
        base = (tuple(map(float, job.Omega)), rates, settings.band)

        def models() -> SpinningModels:
            start = corners(dataclasses.replace(self.read, Omega=job.Omega))
            return SpinningModels(job=self.read, cases=start if settings.band else start[:1], rates=rates)

        plants = self._free.get(
            key,
            lambda: free_plants(self._free_models.get(base, models).at(settings.spins), job.sampling, settings.band),
        )
        label, at = settings.plant, np.array(settings.Omega)
        if not at.any() and label in plants.labels:
            shown = plants.only(plants.labels.index(label))
            return self._whole(settings, job, spec, controllers, plants, shown), notes
        case = next((one for one in every if one[0] == label), every[0])
        turned = (case[0], case[1], case[2] + at)
        shown = self._free.get(
            ("shown", key, label, settings.Omega),
            lambda: free_plants(free_models(job, [turned], rates), job.sampling, False),
        )
        return self._whole(settings, job, spec, controllers, plants, shown), notes

    def _whole(
        self,
        settings: Settings,
        job: Job,
        spec: LoopSpec,
        controllers: Sequence[control.StateSpace],
        plants: FreePlants,
        shown: FreePlants,
    ) -> StabilisedLoop:
        return StabilisedLoop(
            job=job, model=self._model(settings), spec=spec, controllers=tuple(controllers), plants=plants, shown=shown
        )

    def kept(self, settings: Settings) -> Callable[[str, Callable[[], dict[str, float]]], dict[str, float]]:
        """Return what keeps figures of the caging loops while only the servo's knobs move."""
        others = tuple(
            (
                spec.name,
                settings.closed[spec.name],
                tuple(sorted(settings.options[spec.name][settings.closed[spec.name]].items())),
                settings.parts_on(spec.name, settings.closed[spec.name]),
            )
            for spec in self.read.loops
            if spec.kind == "caging"
        )

        def of(name: str, make: Callable[[], dict[str, float]]) -> dict[str, float]:
            return self._margins.get((name, others, self._plant_key(settings)), make)

        return of

    def all_controllers(
        self, settings: Settings, strict: bool = False
    ) -> tuple[list[control.StateSpace], tuple[str, ...]]:
        """Return the controller of every loop in the job's order, and lines about them."""
        saved = self.saved_controllers(settings, strict=strict)
        out = [state_space(one.controller, one.inputs, one.outputs, name=f"{one.loop}, {one.design}") for one in saved]
        return out, tuple(one.note for one in saved if one.note)

    def saved_controllers(self, settings: Settings, strict: bool = False) -> list[SavedController]:
        """Return the controller of every loop; with `strict` only those that are named in `closed` will do.

        Raises
        ------
        DesignError
            A loop has none.
        """
        closed = {**settings.closed, settings.loop: settings.design}
        return [self._saved(settings, spec, closed[spec.name], strict) for spec in self.read.loops]

    def _saved(self, settings: Settings, spec: LoopSpec, name: str, strict: bool) -> SavedController:
        design = spec.designs[known_name("design", name, tuple(d.name for d in spec.designs))]
        note = ""
        if spec.kind != "caging":
            made = self._servo(settings, spec, design)
            K, inputs, outputs = state_arrays(made, name), tuple(made.input_labels), tuple(made.output_labels)
            options = dict(settings.options[spec.name][name])
        else:
            try:
                K, note = self._caging(settings, spec, design)
            except DesignError:
                other = next((d for d in spec.designs if d.method == "classical"), None)
                if strict or other is None or self.live(design):
                    raise
                note = f"{spec.name}: {design.name} is not designed yet; {other.name} is closed in its place"
                design, (K, _) = other, self._caging(settings, spec, other)
            if strict and note:
                raise DesignError(f"{spec.name}, {note}")
            platform = self.read.platform
            inputs = tuple(platform.pickoff_on(gimbal).name for gimbal in spec.gimbals)
            outputs = tuple(platform.torquer_on(gimbal).name for gimbal in spec.gimbals)
            options = self.used(settings, spec, design)
        return SavedController(
            loop=spec.name,
            design=design.name,
            method=design.method,
            controller=K,
            inputs=inputs,
            outputs=outputs,
            options=options,
            note=note,
        )

    def _servo(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> control.StateSpace:
        sampling = Sampling(period=1.0 / settings.rate_hz, delay=settings.delay)
        mine = dataclasses.replace(design, options=dict(settings.options[spec.name][design.name]))
        job = dataclasses.replace(self.read, sampling=sampling)
        made = platform_servo(job, self._model(settings), spec, mine).controller
        K = state_arrays(made, design.name)
        return state_space(K, made.input_labels, made.output_labels, name=f"{spec.name}, {design.name}")

    def reins(self, settings: Settings, knobs: Sequence[Knob]) -> tuple[Reins, StateArrays, int]:
        """Return the free knobs of the design, the plant that is shown, and the channel.

        Raises
        ------
        PlatformCtrlError
            The loop cannot be built.
        """
        spec, design = self.design(settings)
        free = [knob for knob in knobs if knob.tunable and not knob.fixed]
        if spec.kind == "caging":
            loop, _ = self.caged(settings)
            P = loop.shown
            plant = StateArrays(P.A[0], P.B[0], P.C[0], P.D[0], P.period)
            torquers: Sequence[str] = P.torques
        else:
            whole, _ = self.stabilised(settings)
            _, at, torquers = whole.joined(whole.shown)
            here = whole.controllers[[one.name for one in self.read.loops].index(spec.name)].name
            A, B, C, D, dt = whole.shown.arrays
            plant = StateArrays(A[0], B[0][:, at], C[0], D[0][:, at], dt)

        def build(numbers: Mapping[str, float]) -> StateArrays:
            mine = {**settings.options[spec.name], design.name: {**settings.options[spec.name][design.name], **numbers}}
            new = settings.but(options={**settings.options, spec.name: mine})
            if spec.kind == "caging":
                return self._caging(new, spec, design)[0]
            servo = self._servo(new, spec, design)
            others = [servo if one.name == here else one for one in whole.controllers]
            return dataclasses.replace(whole, controllers=tuple(others)).joined(whole.shown)[0]

        reins = Reins(
            names=tuple(knob.name for knob in free),
            start=np.array([knob.value for knob in free]),
            low=np.array([min(knob.low, knob.value) / 20.0 for knob in free]),
            high=np.array([knob.high if knob.high < np.inf else 20.0 * knob.value for knob in free]),
            weights=np.array([_WEIGHTS.get(knob.group, 1.0) for knob in free]),
            build=build,
        )
        return reins, plant, list(torquers).index(settings.channel) if settings.channel in torquers else 0

    def _caging(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> tuple[StateArrays, str]:
        period = 1.0 / settings.rate_hz
        if design.method == "classical":
            return classical_arrays(self.used(settings, spec, design), self._gyros(settings, spec), period), ""
        found = self.store.found(spec.name, design.name, self.key(settings, spec, design), period)
        if found is None:
            raise DesignError(f"{spec.name}, {design.name}: is not designed yet; expected it to be designed first")
        return found

    def _nutation(self, settings: Settings, spec: LoopSpec) -> float:
        sampling = Sampling(period=1.0 / settings.rate_hz, delay=settings.delay)
        return self.quick(spec).nutation(settings.spins, sampling, self._range(settings))

    def _gyros(self, settings: Settings, spec: LoopSpec) -> Channels:
        """Return how the gyros couple the gimbals of a caging loop."""
        key = (spec.name, tuple(sorted(settings.spins.items())))
        return self._channels.get(key, lambda: self.quick(spec).channels(settings.spins))

    def _model(self, settings: Settings) -> LinearModel:
        key = tuple(sorted(settings.spins.items()))
        return self._models.get(key, lambda: linearise(with_spins(self.read.platform, settings.spins)))

    def _plant_key(self, settings: Settings) -> Hashable:
        return (
            settings.rate_hz,
            settings.delay,
            tuple(sorted(settings.spins.items())),
            tuple(map(float, self._range(settings))),
        )

    def _spin_key(self, settings: Settings) -> tuple[object, ...]:
        return (tuple(sorted(settings.spins.items())), *map(float, self._range(settings)))

    def _corners(self, settings: Settings, job: Job) -> list[tuple[str, Platform, FloatArray]]:
        return self._corner.get(self._spin_key(settings), lambda: corners(job))

    def _range(self, settings: Settings) -> FloatArray:
        """Return the largest platform rate about each axis: the job's, or what is shown where that is more."""
        return np.maximum(self.read.Omega, np.abs(settings.Omega))

    def _first(self) -> Settings:
        options: dict[str, dict[str, dict[str, float]]] = {}
        optional: dict[str, dict[str, tuple[str, ...]]] = {}
        closed: dict[str, str] = {}
        spins = {r.name: float(r.spin) for r in self.read.platform.rotors}
        sampling = self.read.sampling
        for spec in self.read.loops:
            options[spec.name], optional[spec.name] = {}, {}
            for design in spec.designs:
                options[spec.name][design.name] = self._options(spec, design, spins)
                optional[spec.name][design.name] = parts_given(design.options)
            live = [d.name for d in spec.designs if self.live(d)]
            closed[spec.name] = spec.use if spec.use in live or not live else live[0]
        first = self.read.loops[0]
        return Settings(
            axis=self.loading_axis(first, 1),
            mode="caged" if first.kind == "caging" else "stabilised",
            loop=first.name,
            design=closed[first.name],
            options=options,
            optional=optional,
            rate_hz=1.0 / sampling.period,
            delay=sampling.delay,
            spins=spins,
            Omega=(0.0, 0.0, 0.0),
            channel=self.channels_of(first)[0],
            closed=closed,
        )

    def _options(self, spec: LoopSpec, design: DesignSpec, spins: dict[str, float]) -> dict[str, float]:
        """Return all options of a design, complete, so that they stay while the plant is moved."""
        period = self.read.sampling.period
        if spec.kind != "caging":
            return dict(platform_servo(self.read, linearise(self.read.platform), spec, design).options)
        quick = self.quick(spec)
        channel = quick.channels(spins)
        nutation = quick.nutation(spins, self.read.sampling, np.asarray(self.read.Omega))
        if design.method == "classical":
            return full_options(design.options, channel, nutation, period)
        try:
            return default_numbers(design, channel, nutation, period)
        except PlatformCtrlError:
            # What is wrong with them is told when they are to be designed.
            return dict(design.options)
