"""Closed loops of settings: plants and controllers put together."""

from __future__ import annotations

import dataclasses
import operator
import threading
from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from platform_ctrl.analysis.feedback import with_error_alone
from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import StateSpace, System
from platform_ctrl.app.background import Background, DesignPending, Requests, TaskCancelled, made_design
from platform_ctrl.app.controllers import DesignOptions, built_directly, direct_arrays, existing_designs, loop_names
from platform_ctrl.app.curves import LoopCurves
from platform_ctrl.app.loops import CagedCurves, CagedLoop, StabilisedCurves
from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.plants import Bounded, JobPlants
from platform_ctrl.app.settings import Limits, Settings, of_loop, with_limits
from platform_ctrl.common.arguments import known_name
from platform_ctrl.design.loop import Design, with_resolvers
from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.method import LoopProblem, designed, shaped
from platform_ctrl.design.methods import METHODS
from platform_ctrl.design.plants import tracking_plants
from platform_ctrl.design.sight import beside
from platform_ctrl.design.tuning import of_sight
from platform_ctrl.errors import DesignError, InputError, PlatformCtrlError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.verification.coupled import CoupledCheck, coupled_check
from platform_ctrl.verification.coupled_plant import sensed_rates

# Designs that are kept for settings that a page may return to.
_ROOM = 64
# Seconds within which a newer request drops one for a design: a slider is still moving.
PAUSE = 0.6


Named = TypeVar("Named", LoopSpec, DesignSpec)


def _named(what: str, every: Sequence[Named], name: str) -> Named:
    return every[known_name(what, name, [one.name for one in every])]


class ClosedLoops:
    """The loops of a job, closed as settings say."""

    def __init__(self, job: Job, controllers: Path | None) -> None:
        slow = [spec.name for spec in job.loops if job.every(spec) > 1]
        if slow and not all(spec.has_plants for spec in job.loops):
            raise InputError(
                f"loop {slow[0]!r}: beside a stabilisation loop the page cannot show a loop with a rate_hz of its own; "
                "use platform-ctrl design, whose report does, or leave the key out for the page"
            )
        self.read = job
        self._commanded = {spec.around for spec in job.loops}
        self.plants = JobPlants(job)
        self.options = DesignOptions(self.plants)
        # By loop, design and options: made here, and read from a file, which no method could make again.
        self._made: Bounded[Design] = Bounded(_ROOM)
        self._given: dict[Hashable, Design] = {}
        self._limited: Bounded[Job] = Bounded(4)
        self._measures: Bounded[LoopMetrics] = Bounded(8)
        self._around: Bounded[tuple[PlantSet, Channels]] = Bounded(6)
        self._coupled: Bounded[CoupledCheck] = Bounded(16)
        self._overlays: Bounded[tuple[Drawing, tuple[str, ...]]] = Bounded(16)
        # Designs and what pages wait for, which goes first; how designs failed, and who is told of each.
        self.requests, self.background = Requests("background"), Background()
        self._failed: Bounded[str] = Bounded(_ROOM)
        self._listeners: dict[Callable[[], None], None] = {}
        self._take([] if controllers is None else existing_designs(controllers, job))

    def _take(self, given: Iterable[Design]) -> None:
        """Start from designs that exist already."""
        start = self.options.start
        for made in given:
            loop, design = made.loop, made.name
            known = next((d for d in self.read.loop(loop).designs if d.name == design), None)
            if known is None:
                continue
            if made.method == known.method and METHODS[made.method].tunes and known.tune:
                mine = start.options[loop]
                options = {name: made.options.get(name, x) for name, x in mine[design].items()}
                start = start.but(options={**start.options, loop: {**mine, design: options}})
            if not built_directly(known):
                self._given[self.design_key(start, loop, design)] = made
        # Loops are closed as in the job wherever the controller is available.
        closed = {
            spec.name: spec.use if self.is_available(start, spec, spec.use) else start.closed[spec.name]
            for spec in self.read.loops
        }
        self.options.start = start.but(closed=closed, design=closed[start.loop])

    @staticmethod
    def design_key(settings: Settings, loop: str, design: str) -> Hashable:
        """Return all that a design of a method depends on."""
        options, limits = settings.options[loop][design], of_loop(settings.limits, loop)
        return loop, design, tuple(sorted(options.items())), tuple(sorted(limits.items()))

    def found(self, settings: Settings, loop: str, design: str) -> Design | None:
        """Return the design that a method has made for these settings, or None."""
        key = self.design_key(settings, loop, design)
        return self._given.get(key) or self._made.found(key)

    def is_available(self, settings: Settings, spec: LoopSpec, name: str) -> bool:
        """Return whether a design of a loop is available for these settings."""
        return built_directly(_named("design", spec.designs, name)) or self.found(settings, spec.name, name) is not None

    def spec(self, name: str) -> LoopSpec:
        """Return a loop of the job."""
        return _named("loop", self.read.loops, name)

    def design(self, settings: Settings) -> tuple[LoopSpec, DesignSpec]:
        """Return the loop and the design that are selected."""
        spec = _named("loop", self._with_limits(settings.limits).loops, settings.loop)
        return spec, _named("design", spec.designs, settings.design)

    def _with_limits(self, limits: Limits) -> Job:
        return self._limited.get(tuple(sorted(limits.items())), lambda: with_limits(self.read, limits))

    def job(self, settings: Settings) -> Job:
        """Return the job with these settings."""
        limited = self._with_limits(settings.limits)
        return dataclasses.replace(limited, loops=tuple(self._loop_as_set(settings, spec) for spec in limited.loops))

    def _loop_as_set(self, settings: Settings, spec: LoopSpec) -> LoopSpec:
        use, designs = self.closed(settings)[spec.name], tuple(self._as_set(settings, spec, d) for d in spec.designs)
        # A loop that is made anew reads all of its requirements again.
        same = use == spec.use and all(map(operator.is_, designs, spec.designs))
        return spec if same else dataclasses.replace(spec, use=use, designs=designs)

    def _as_set(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> DesignSpec:
        if not self.options.touched(settings, spec.name, design.name):
            return design
        options = self.options.used(settings, spec, design)
        return dataclasses.replace(design, options=options, tune=design.tune and not built_directly(design))

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` in a thread after each design that was requested; return the function that ends that."""
        self._listeners[listener] = None
        return lambda: self._listeners.pop(listener, None)

    def curves(self, settings: Settings, over: bool = False) -> tuple[LoopCurves, tuple[str, ...]]:
        """Return the curves of the loop that is shown, drawn `over` others perhaps, and lines about its controllers."""
        if not self.spec(settings.loop).has_plants:
            return self.stabilised(settings)
        loop, notes = self._requested(settings)
        return CagedCurves(loop, settings, None if over else partial(self.metrics, settings, loop)), notes

    def _requested(self, settings: Settings) -> tuple[CagedLoop, tuple[str, ...]]:
        """Return the result of `caged`; a design that a method has to make is requested, and is pending then.

        A design that failed with these numbers is not made again: its error is raised.
        """
        spec, design = self.design(settings)
        if self.is_available(settings, spec, design.name):
            return self.caged(settings)
        key = self.design_key(settings, spec.name, design.name)
        failed = self._failed.found(key)
        if failed is not None:
            raise DesignError(failed)
        name = spec.name, design.name
        self.requests.add(name, partial(self._make, self.job(settings), *name, key), content=key)
        raise DesignPending(f"{spec.name}, {design.name}: is being designed; it is shown as soon as it is available")

    def _make(self, job: Job, loop: str, design: str, key: Hashable, over: threading.Event) -> None:
        """Make a design in another process, unless a slider still moves."""
        if over.wait(PAUSE) or self._made.found(key) is not None:
            return
        try:
            task = partial(made_design, job, loop, design)
            self._made.put(key, self.background.run(task, cancelled=over.is_set))
        except TaskCancelled:
            return
        except Exception as error:
            known = isinstance(error, PlatformCtrlError)
            self._failed.put(key, str(error) if known else f"{design}: could not be designed: {error}")
        for listener in list(self._listeners):
            listener()

    def overlays(self, settings: Settings, spec: LoopSpec) -> tuple[tuple[Drawing, ...], tuple[str, ...]]:
        """Return the drawings over a picture, and lines about those that are missing or not up to date."""
        out: list[Drawing] = []
        notes: list[str] = []
        for name in settings.overlays:
            own = settings.but(design=name, band=False, overlays=())

            def drawn(own: Settings = own) -> tuple[Drawing, tuple[str, ...]]:
                with np.errstate(all="ignore"):
                    curves, lines = self.curves(own, over=True)
                    # The picture below one of the free platform has the lines about the other loops.
                    return curves.drawing(), lines if spec.has_plants else ()

            depends = self.shown_key(own, spec)
            try:
                drawing, lines = self._overlays.get((own.plant, own.channel, own.axis, depends), drawn)
                out.append(drawing)
                notes += lines
            except PlatformCtrlError as error:
                notes.append(str(error))
        return tuple(out), tuple(notes)

    def caged(self, settings: Settings) -> tuple[CagedLoop, tuple[str, ...]]:
        """Return the selected loop with plants of its own, and lines about its controller."""
        spec, design = self.design(settings)
        plants, _ = self.plants_of(settings, spec, design)
        plants = self.beside_others(settings, spec, plants)
        at = plants.labels.index(settings.plant) if settings.plant in plants.labels else 0
        note = "" if spec.around is None else self._closed_design(settings, self.plants.inside(spec))[2]
        loop = CagedLoop(
            job=self.job(settings),
            spec=spec,
            design=design.name,
            plants=plants,
            shown=plants.only([at]),
            controller=self.caging(settings, spec, design),
            shaped=None if design.command is None else lambda K: self._with_commands(settings, spec, design, K),
        )
        return loop, (note,) if note else ()

    def plants_of(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> tuple[PlantSet, Channels]:
        """Return the plants of a design of a loop, and the directions in which methods see them.

        Of a tracking loop they are those around the rate loop that it commands.
        """
        if spec.around is None:
            return self.plants.of(spec, design), self.plants.gyros(spec, design)
        inner = self.plants.inside(spec)
        design, K, _ = self._closed_design(settings, inner)
        K = self._with_commands(settings, inner, design, K)
        made = partial(tracking_plants, self.read, spec, inner, self.plants.of(inner, design), K)
        return self._around.get((spec.name, inner.name, design.name, self.closed_key(settings, inner)), made)

    def plants_key(self, settings: Settings, spec: LoopSpec) -> Hashable:
        """Return a key of everything that the plants of a loop depend on: of a tracking loop the inner loop.

        Of a loop with limits of the line of sight, the others.
        """
        if self._beside(spec):
            return tuple(self.closed_key(settings, one) for one in self.read.loops if one.name != spec.name)
        return None if spec.around is None else self.closed_key(settings, self.plants.inside(spec))

    def beside_others(self, settings: Settings, spec: LoopSpec, plants: PlantSet) -> PlantSet:
        """Return plants of a loop with the others closed, where its values depend on them."""
        if not self._beside(spec):
            return plants
        others = [self._closed(settings, one, False)[0] for one in self.read.loops if one.name != spec.name]
        return beside(plants, {one.loop: one.controller for one in others})

    def _beside(self, spec: LoopSpec) -> bool:
        """Whether the values of a loop depend on the other loops: they have limits of the line of sight."""
        return len(self.read.loops) > 1 and of_sight(spec.requests)

    def stabilised(self, settings: Settings) -> tuple[StabilisedCurves, tuple[str, ...]]:
        """Return the curves of all loops closed around the free platform, and lines about their controllers."""
        job, model = self.job(settings), self.plants.model
        closed = self.closed_designs(settings)
        controllers = with_resolvers(job, [made.controller for made, _ in closed], job.trims[0])
        plants, shown = self.plants.free(settings.plant, sensed_rates(job, controllers), settings.band)
        check = partial(self.coupled, settings)
        curves = StabilisedCurves(job, settings, model, controllers, plants, shown, check)
        return curves, tuple(note for _, note in closed if note)

    def closed(self, settings: Settings) -> dict[str, str]:
        """Return the name of the design that is closed in each loop, the shown one in its own."""
        return {**settings.closed, settings.loop: settings.design}

    def closed_key(self, settings: Settings, spec: LoopSpec) -> Hashable:
        """Return all that the closed design of a loop depends on besides the plants."""
        name = self.closed(settings)[spec.name]
        there = self.is_available(settings, spec, name)
        return self.design_key(settings, spec.name, name), there, settings.parts_on(spec.name, name)

    def shown_key(self, settings: Settings, spec: LoopSpec) -> Hashable:
        """Return all that the curves of a loop depend on."""
        if not spec.has_plants:
            return self.whole_key(settings)
        return self.plants_key(settings, spec), self.closed_key(settings, spec)

    def whole_key(self, settings: Settings) -> Hashable:
        """Return all that the whole depends on: every closed design, and the limits."""
        limits = tuple(sorted(settings.limits.items()))
        return limits, *(self.closed_key(settings, spec) for spec in self.read.loops)

    def coupled(self, settings: Settings) -> CoupledCheck:
        """Return the check of all loops together, as `check` does it."""
        return self._coupled.get(
            self.whole_key(settings),
            lambda: coupled_check(self.job(settings), self.plants.model, self.controllers(settings)),
        )

    def metrics(
        self, settings: Settings, loop: CagedLoop, whole: Loop | None = None, quick: bool = False
    ) -> LoopMetrics:
        """Return the metrics of a caging loop, `quick` without those of the line of sight unless they are known."""
        limits, K = tuple(sorted(of_loop(settings.limits, loop.spec.name).items())), loop.delivered
        plants, arrays = self.plants_key(settings, loop.spec), (item.tobytes() for item in K[:4])
        key = (loop.spec.name, loop.design, limits, plants, K.A.shape, *arrays)
        sight = not quick or self._measures.found((*key, True)) is not None
        requests = [one for one in loop.spec.requests if sight or not METRICS[one.kind].of_sight]
        # Peaks are norms unless the loop has too many states for that.
        made = partial(measure, loop.plants, K, requests, exact=loop.exact, loops=whole)
        return self._measures.get((*key, sight), made)

    def controllers(self, settings: Settings) -> list[StateSpace]:
        """Return the controller u = K y of every loop."""
        return [made.controller for made, _ in self.closed_designs(settings)]

    def closed_designs(self, settings: Settings, strict: bool = False) -> list[tuple[Design, str]]:
        """Return the design that closes each loop, and a line about it; with `strict` only those named in `closed`."""
        return [self._closed(settings, spec, strict) for spec in self.in_order()]

    def in_order(self) -> list[LoopSpec]:
        """Return the loops in the order in which controllers are computed: a tracking loop before the one inside."""
        out = [spec for spec in self.read.loops if spec.around is None]
        for spec in self.read.loops:
            if spec.around is not None:
                out.insert(out.index(self.plants.inside(spec)), spec)
        return out

    def _closed_design(
        self, settings: Settings, spec: LoopSpec, strict: bool = False
    ) -> tuple[DesignSpec, System, str]:
        """Return the design that is closed in a loop, its controller of the readings, and a line about it.

        Until it is designed it is another one, unless `strict`.
        """
        design, note = _named("design", spec.designs, self.closed(settings)[spec.name]), ""
        try:
            K = self.caging(settings, spec, design)
        except DesignError:
            other = next((d for d in spec.designs if built_directly(d)), None)
            if strict or other is None or built_directly(design):
                raise
            note = f"{spec.name}: {design.name} is not designed yet; {other.name} is closed instead"
            design, K = other, self.caging(settings, spec, other)
        return design, K, note

    def _closed(self, settings: Settings, spec: LoopSpec, strict: bool) -> tuple[Design, str]:
        if not spec.has_plants:
            design = _named("design", spec.designs, self.closed(settings)[spec.name])
            mine = dataclasses.replace(design, options=dict(settings.options[spec.name][design.name]))
            made = designed(LoopProblem(job=self.read, spec=spec, design=mine, model=self.plants.model))
            return dataclasses.replace(made, options=dict(mine.options)), ""
        design, K, note = self._closed_design(settings, spec, strict)
        inputs, outputs = loop_names(self.job(settings), spec, design)
        K = self._with_commands(settings, spec, design, K)
        inputs = [*inputs, *(f"{name}{COMMAND}" for name in inputs)][: K.B.shape[1]]
        fed = None if spec.around is not None else self.plants.of(spec, design).feedforward
        if fed is not None:
            K, inputs = fed.joined_to(K), [*inputs, *fed.sensors]
        system = K.to_control(inputs, outputs, name=f"{spec.name}, {design.name}")
        options = self.options.used(settings, spec, design)
        made = Design(loop=spec.name, name=design.name, method=design.method, controller=system, options=options)
        return made, note

    def _with_commands(self, settings: Settings, spec: LoopSpec, design: DesignSpec, K: System) -> System:
        """Return a controller with the commands that its design shapes, or that a loop or a manoeuvre gives."""
        commanded = None if spec.around is not None else self.plants.of(spec, design).commanded
        if design.command is not None:
            _, channel = self.plants_of(settings, spec, design)
            sense = np.eye(K.B.shape[1]) if channel.sense is None else channel.sense
            return shaped(K._replace(dt=self.read.period_of(spec)), design.command, channel, sense, commanded)
        readings = self.read.readings_of(spec.read_by(design))
        taken = spec.name in self._commanded or not self.read.commanded.isdisjoint(readings)
        return with_error_alone(K, commanded) if taken else K

    def caging(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> System:
        """Return the controller of a caging loop."""
        if built_directly(design):
            _, channel = self.plants_of(settings, spec, design)
            options = self.options.used(settings, spec, design)
            return direct_arrays(design.method, options, channel, self.read.period_of(spec))
        made = self.found(settings, spec.name, design.name)
        if made is None:
            raise DesignError(f"{spec.name}, {design.name}: is not designed yet; wait until it is")
        return System.of(made.controller, made.name)
