"""Closed loops of settings: plants and controllers put together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.feedback import with_error_alone
from platform_ctrl.analysis.loop_metrics import LoopMetrics
from platform_ctrl.analysis.plant_set import COMMAND, PlantSet
from platform_ctrl.app.background import Made
from platform_ctrl.app.budget import LineOfSight
from platform_ctrl.app.caged import CachedMetrics, CagedLoop
from platform_ctrl.app.controllers import DesignOptions, at_rate, built_directly, direct_arrays
from platform_ctrl.app.existing_designs import existing_designs, loop_names
from platform_ctrl.app.free_plants import StabilisedLoop
from platform_ctrl.app.plants import Bounded, JobPlants
from platform_ctrl.app.saving import ClosedController
from platform_ctrl.app.settings import Conditions, Settings
from platform_ctrl.app.stabilised import CachedMargins
from platform_ctrl.common.arguments import known_name
from platform_ctrl.design.loop import LoopProblem, designed, shaped
from platform_ctrl.design.partition import Channels
from platform_ctrl.errors import DesignError, InputError
from platform_ctrl.job.job import DesignSpec, Job, LoopSpec
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.methods import METHODS
from platform_ctrl.verification.coupled import CoupledCheck, coupled_check, sensed_rates

if TYPE_CHECKING:
    import control

# Designs that are kept for settings that a page may return to.
_ROOM = 64


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
        self._around = {spec.around for spec in job.loops}
        self.plants = JobPlants(job)
        self._tracked: Bounded[tuple[PlantSet, PlantSet]] = Bounded(6)
        self._directions: Bounded[Channels] = Bounded(12)
        self.options = DesignOptions(self.plants)
        # Controllers by loop, design and conditions: made here, and read from a file, which no method could make again.
        self._made: Bounded[Made] = Bounded(_ROOM)
        self._given: dict[tuple[str, str, Conditions], Made] = {}
        self._specs = {spec.name: spec for spec in job.loops}
        self._margins: Bounded[dict[str, float]] = Bounded(16)
        self._measures: Bounded[LoopMetrics] = Bounded(8)
        self._results: Bounded[tuple[CheckResult, ...]] = Bounded(8)
        self._coupled: Bounded[CoupledCheck] = Bounded(4)
        self.sight = LineOfSight(self)
        self._take([] if controllers is None else existing_designs(controllers, job))

    @property
    def start(self) -> Settings:
        """The settings of the job file, with the controllers that exist already."""
        return self.options.start

    def _take(self, given: Iterable[tuple[str, str, str, Made]]) -> None:
        """Start from designs that exist already."""
        start = self.start
        for loop, design, method, made in given:
            spec = self._specs[loop]
            known = next((d for d in spec.designs if d.name == design), None)
            if known is None:
                continue
            if method == known.method and METHODS[method].tunes and known.tune:
                mine = start.options[loop]
                options = {name: made.options.get(name, x) for name, x in mine[design].items()}
                start = start.but(options={**start.options, loop: {**mine, design: options}})
            if not built_directly(known):
                conditions = self.conditions(start, spec, known)
                self._given[loop, design, conditions] = made
                start = with_conditions(start, loop, design, conditions)
        # Loops are closed as in the job wherever the controller is available.
        closed = {
            spec.name: spec.use if self.is_available(start, spec, spec.use) else start.closed[spec.name]
            for spec in self.read.loops
        }
        self.options.start = start.but(closed=closed, design=closed[start.loop])

    def keep(self, loop: str, design: str, conditions: Conditions, made: Made) -> None:
        """Keep a design for these conditions until newer ones replace it."""
        self._made.put((loop, design, conditions), made)

    def found(self, loop: str, design: str, conditions: Conditions | None) -> Made | None:
        """Return the design for these conditions, or None."""
        if conditions is None:
            return None
        return self._given.get((loop, design, conditions)) or self._made.found((loop, design, conditions))

    def is_available(self, settings: Settings, spec: LoopSpec, name: str) -> bool:
        """Return whether a design of a loop is available for these settings."""
        design = self._named_design(spec, name)
        return (
            built_directly(design) or self.found(spec.name, name, self.conditions(settings, spec, design)) is not None
        )

    def spec(self, name: str) -> LoopSpec:
        """Return a loop of the job."""
        known_name("loop", name, tuple(self._specs))
        return self._specs[name]

    def design(self, settings: Settings) -> tuple[LoopSpec, DesignSpec]:
        """Return the loop and the design that are selected."""
        spec = self.spec(settings.loop)
        return spec, self._named_design(spec, settings.design)

    @staticmethod
    def _named_design(spec: LoopSpec, name: str) -> DesignSpec:
        return spec.designs[known_name("design", name, [d.name for d in spec.designs])]

    def job(self, settings: Settings) -> Job:
        """Return the job with these settings."""
        closed = self.closed(settings)
        loops = tuple(
            dataclasses.replace(
                spec, use=closed[spec.name], designs=tuple(self._as_set(settings, spec, d) for d in spec.designs)
            )
            for spec in self.read.loops
        )
        return dataclasses.replace(self.plants.job(settings), loops=loops)

    def _as_set(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> DesignSpec:
        if not self.options.touched(settings, spec.name, design.name):
            return design
        if not built_directly(design):
            return dataclasses.replace(design, options=dict(settings.options[spec.name][design.name]))
        return dataclasses.replace(design, options=self.options.used(settings, spec, design), tune=False)

    def conditions(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> Conditions:
        """Return all that a design of a method depends on, at these settings."""
        options = settings.options[spec.name][design.name]
        return Conditions(tuple(sorted(options.items())), *self.plants.key(settings))

    def target_conditions(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> Conditions:
        """Return the conditions for which the controller of a design is to be made.

        It stays what it was while the plant is moved, and is designed anew when its own options are.
        """
        now = self.conditions(settings, spec, design)
        before = settings.designed_for.get(spec.name, {}).get(design.name)
        return before if before is not None and before.options == now.options else now

    def available_conditions(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> Conditions | None:
        """Return the conditions of the available controller: the target one, until then the one before it."""
        before = settings.designed_for.get(spec.name, {}).get(design.name)
        found = (self.target_conditions(settings, spec, design), before)
        return next((one for one in found if self.found(spec.name, design.name, one) is not None), None)

    def with_shown_designs_noted(self, old: Settings, new: Settings) -> Settings:
        """Return the new settings with the conditions of the designs that the page shows."""
        shown = [(old.loop, old.design), *((old.loop, name) for name in old.overlays)]
        if old.mode == "stabilised":
            shown += [(loop, name) for loop, name in old.closed.items() if loop != old.loop]
        for loop, name in shown:
            spec = self.spec(loop)
            design = self._named_design(spec, name)
            if built_directly(design):
                continue
            first = self.start.designed_for.get(loop, {}).get(name)
            if self.conditions(new, spec, design) == self.conditions(self.start, spec, design):
                # Back at the start: the conditions of the start.
                new = with_conditions(new, loop, name, first)
                continue
            conditions = self.target_conditions(old, spec, design)
            known = self.found(loop, name, conditions) is not None
            if known and self.target_conditions(new, spec, design) != conditions:
                new = with_conditions(new, loop, name, conditions)
        return new

    @staticmethod
    def at(settings: Settings, spec: LoopSpec, design: DesignSpec, conditions: Conditions) -> Settings:
        """Return the settings at which a design has some conditions."""
        mine = {**settings.options[spec.name], design.name: dict(conditions.options)}
        first, second, third = conditions.Omega
        return settings.but(
            design=design.name,
            options={**settings.options, spec.name: mine},
            rate_hz=conditions.rate_hz,
            delay=conditions.delay,
            spins=dict(conditions.spins),
            Omega=(first, second, third),
        )

    def caged(self, settings: Settings) -> tuple[CagedLoop, tuple[str, ...]]:
        """Return the selected loop with plants of its own, and lines about its controller."""
        spec, design = self.design(settings)
        plants, shown = self.plants_of(settings, spec, design)
        K, note = self.caging(settings, spec, design)
        notes = [] if spec.around is None else [self._closed_design(settings, self.plants.inside(spec))[2]]
        loop = CagedLoop(
            job=self.job(settings),
            spec=spec,
            design=design.name,
            plants=plants,
            shown=shown,
            controller=K,
            shaped=None if design.command is None else lambda K: self._with_commands(settings, spec, design, K),
        )
        return loop, tuple(line for line in (note, *notes) if line)

    def plants_of(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> tuple[PlantSet, PlantSet]:
        """Return the plants of a design of a loop, and the one that is shown alone."""
        if spec.around is None:
            return self.plants.caged(settings, spec, design)
        inner, closed, K = self._inside(settings, spec)
        key = (spec.name, settings.plant, settings.Omega, *self._inside_key(settings, inner, closed, K))
        read = spec.read_by(design)
        return self._tracked.get((key, read.sensors), lambda: self.plants.around(settings, read, inner, closed, K))

    def directions(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> Channels:
        """Return the directions in which methods see a loop as a design reads it."""
        read = spec.read_by(design)
        if spec.around is None:
            return self.plants.gyros(settings.spins, read, self.plants.period(settings, spec))
        inner, closed, K = self._inside(settings, spec)
        key = (spec.name, read.sensors, *self._inside_key(settings, inner, closed, K))
        return self._directions.get(key, lambda: self.plants.directions_around(settings, read, inner, closed, K))

    def _inside(self, settings: Settings, spec: LoopSpec) -> tuple[LoopSpec, DesignSpec, StateArrays]:
        """Return the rate loop that a tracking loop commands, the design that is closed there, and its controller."""
        inner = self.plants.inside(spec)
        design, K, _ = self._closed_design(settings, inner)
        return inner, design, self._with_commands(settings, inner, design, K)

    def _inside_key(
        self, settings: Settings, inner: LoopSpec, design: DesignSpec, K: StateArrays
    ) -> tuple[Hashable, ...]:
        return self.plants.key(settings), inner.name, design.name, _content(K)

    def plants_key(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> Hashable:
        """Return all that the plants of a design of a loop depend on."""
        inner = None if spec.around is None else self.closed_key(settings, self.plants.inside(spec))
        return self.plants.key(settings), spec.name, design.name, inner

    def stabilised(self, settings: Settings) -> tuple[StabilisedLoop, tuple[str, ...]]:
        """Return all loops closed around the free platform, and lines about their controllers."""
        spec, _ = self.design(settings)
        job = self.job(settings)
        closed = self.controllers(settings)
        controllers = tuple(one.system for one in closed)
        plants, shown = self.plants.free(settings, sensed_rates(job, controllers))
        loop = StabilisedLoop(
            job=job,
            model=self.plants.model(settings.spins),
            spec=spec,
            controllers=controllers,
            plants=plants,
            shown=shown,
        )
        return loop, tuple(one.note for one in closed if one.note)

    def cached_margins(self, settings: Settings) -> CachedMargins:
        """Return the cache of the disk margins of the caging loops, for while only the servo's sliders move."""
        others = tuple(self.closed_key(settings, spec) for spec in self.read.loops if spec.has_plants)

        def of(name: str, make: Callable[[], dict[str, float]]) -> dict[str, float]:
            return self._margins.get((name, others, self.plants.key(settings)), make)

        return of

    def closed(self, settings: Settings) -> dict[str, str]:
        """Return the name of the design that is closed in each loop, the shown one in its own."""
        return {**settings.closed, settings.loop: settings.design}

    def closed_key(self, settings: Settings, spec: LoopSpec) -> Hashable:
        """Return all that the closed design of a loop depends on besides the plants."""
        name = self.closed(settings)[spec.name]
        design = self._named_design(spec, name)
        seen = None if built_directly(design) else self.available_conditions(settings, spec, design)
        options = tuple(sorted(settings.options[spec.name][name].items()))
        return spec.name, name, seen, options, settings.parts_on(spec.name, name)

    def whole_key(self, settings: Settings) -> Hashable:
        """Return all that the whole depends on: the plants and every closed design."""
        return self.plants.key(settings), tuple(self.closed_key(settings, spec) for spec in self.read.loops)

    def coupled(self, settings: Settings) -> CoupledCheck:
        """Return the check of all loops together, as `check` does it."""

        def make() -> CoupledCheck:
            controllers = [one.system for one in self.controllers(settings)]
            return coupled_check(self.job(settings), self.plants.model(settings.spins), controllers)

        return self._coupled.get(self.whole_key(settings), make)

    def cached_metrics(self, settings: Settings, loop: CagedLoop) -> CachedMetrics:
        """Return the cache of a caging loop's metrics: the result of a drag is drawn next."""
        design = self._named_design(loop.spec, loop.design)
        key = (self.plants_key(settings, loop.spec, design), _content(loop.delivered))
        return lambda make: self._measures.get(key, make)

    def cached_results(
        self, settings: Settings, K: StateArrays, make: Callable[[], tuple[CheckResult, ...]]
    ) -> tuple[CheckResult, ...]:
        """Return the coupled results with one controller for all loops, from the cache or by `make`."""
        return self._results.get((self.plants.key(settings), _content(K)), make)

    def controllers(self, settings: Settings, strict: bool = False) -> list[ClosedController]:
        """Return the controller of every loop; with `strict` only those that are named in `closed` will do."""
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
    ) -> tuple[DesignSpec, StateArrays, str]:
        """Return the design that is closed in a loop, its controller of the readings, and a line about it.

        Until it is designed it is another one, unless `strict`.
        """
        design, note = self._named_design(spec, self.closed(settings)[spec.name]), ""
        try:
            K, note = self.caging(settings, spec, design)
        except DesignError:
            other = next((d for d in spec.designs if built_directly(d)), None)
            if strict or other is None or built_directly(design):
                raise
            note = f"{spec.name}: {design.name} is not designed yet; {other.name} is closed instead"
            design, (K, _) = other, self.caging(settings, spec, other)
        if strict and note:
            raise DesignError(f"{spec.name}, {note}")
        return design, K, note

    def _closed(self, settings: Settings, spec: LoopSpec, strict: bool) -> ClosedController:
        if not spec.has_plants:
            design, note = self._named_design(spec, self.closed(settings)[spec.name]), ""
            system = self.servo(settings, spec, design)
            options = dict(settings.options[spec.name][design.name])
        else:
            design, K, note = self._closed_design(settings, spec, strict)
            inputs, outputs = loop_names(self.job(settings), spec, design)
            K = self._with_commands(settings, spec, design, K)
            inputs = [*inputs, *(f"{name}{COMMAND}" for name in inputs)][: K.B.shape[1]]
            fed = self.plants.feedforward(settings, spec, design)
            if fed is not None:
                K, inputs = fed.joined_to(K), [*inputs, *fed.sensors]
            system = named_system(K, inputs, outputs, name=f"{spec.name}, {design.name}")
            options = self.options.used(settings, spec, design)
        return ClosedController(
            loop=spec.name, design=design.name, method=design.method, system=system, options=options, note=note
        )

    def _with_commands(self, settings: Settings, spec: LoopSpec, design: DesignSpec, K: StateArrays) -> StateArrays:
        """Return a controller with the commands that its design shapes, or that a loop or a manoeuvre gives."""
        if design.command is not None:
            channel = self.directions(settings, spec, design)
            sense = np.eye(K.B.shape[1]) if channel.sense is None else channel.sense
            return shaped(K._replace(dt=self.plants.period(settings, spec)), design.command, channel, sense)
        taken = spec.name in self._around or bool(self.read.commanded & set(spec.read_by(design).sensors))
        return with_error_alone(K) if taken else K

    def servo(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> control.StateSpace:
        """Return the controller of a servo on the platform."""
        mine = dataclasses.replace(design, options=dict(settings.options[spec.name][design.name]))
        job = dataclasses.replace(self.read, sampling=self.plants.sampling(settings))
        made = designed(
            LoopProblem(job=job, spec=spec, design=mine, model=self.plants.model(settings.spins))
        ).controller
        K = state_arrays(made, design.name)
        return named_system(K, made.input_labels, made.output_labels, name=f"{spec.name}, {design.name}")

    def caging(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> tuple[StateArrays, str]:
        """Return the controller of a caging loop, and a line about it or an empty text."""
        period = self.plants.period(settings, spec)
        if built_directly(design):
            channel = self.directions(settings, spec, design)
            options = self.options.used(settings, spec, design)
            return direct_arrays(design.method, options, channel, period), ""
        seen = self.available_conditions(settings, spec, design)
        made = self.found(spec.name, design.name, seen)
        if made is None:
            raise DesignError(f"{spec.name}, {design.name}: is not designed yet; wait until it is")
        K, note = at_rate(made.controller, period, design.name), ""
        if seen != self.conditions(settings, spec, design):
            carried = "" if K is made.controller else " and carried over to this sample rate by Tustin's rule"
            note = f"{design.name}: was made for other settings{carried}; moving one of its numbers designs it anew"
        return K, note


def _content(K: StateArrays) -> tuple[object, ...]:
    """Return the numbers of a controller as part of a key."""
    return (K.A.shape, *(item.tobytes() for item in K[:4]))


def with_conditions(settings: Settings, loop: str, design: str, conditions: Conditions | None) -> Settings:
    """Return the settings with other conditions of a design, or with none."""
    own = {name: one for name, one in settings.designed_for.get(loop, {}).items() if name != design}
    own |= {} if conditions is None else {design: conditions}
    others = {name: designs for name, designs in settings.designed_for.items() if name != loop}
    return settings.but(designed_for={**others, **({loop: own} if own else {})})
