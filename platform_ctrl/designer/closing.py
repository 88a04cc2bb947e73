"""Loops closed as settings say: plants and controllers put together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from platform_ctrl.analysis.arrays import StateArrays, state_arrays, state_space
from platform_ctrl.arguments import known_name
from platform_ctrl.check.coupled import sensed_rates
from platform_ctrl.design.stabilisation import platform_servo
from platform_ctrl.designer.bounded import Bounded
from platform_ctrl.designer.caged import CagedLoop
from platform_ctrl.designer.controllers import classical_arrays
from platform_ctrl.designer.design_options import DesignOptions, live
from platform_ctrl.designer.free_loop import StabilisedLoop
from platform_ctrl.designer.job_plants import JobPlants
from platform_ctrl.designer.saving import SavedController
from platform_ctrl.designer.store import Store, given_designs
from platform_ctrl.designer.tasks import Made
from platform_ctrl.designer.values import Settings
from platform_ctrl.errors import DesignError
from platform_ctrl.job import DesignSpec, Job, LoopSpec

if TYPE_CHECKING:
    import control


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
        self.plants = JobPlants(job)
        self.options = DesignOptions(self.plants)
        self.store = Store()
        self._specs = {spec.name: spec for spec in job.loops}
        self._margins: Bounded[dict[str, float]] = Bounded(16)
        self._take([] if controllers is None else given_designs(controllers, job))

    @property
    def start(self) -> Settings:
        """The settings of the job as it stands, with the controllers that exist already."""
        return self.options.start

    def _take(self, given: Iterable[tuple[str, str, str, Made]]) -> None:
        """Start from designs that exist already."""
        start = self.start
        for loop, design, method, made in given:
            spec = self._specs[loop]
            known = next((d for d in spec.designs if d.name == design), None)
            if known is None:
                continue
            if known.method == "classical" and method == "classical" and known.tune:
                mine = start.options[loop]
                options = {name: made.options.get(name, x) for name, x in mine[design].items()}
                start = start.but(options={**start.options, loop: {**mine, design: options}})
            elif not live(known):
                self.store.put(loop, design, self.key(start, spec, known), made)
        # What the job closes is closed here too wherever there is a controller for it.
        closed = {
            spec.name: spec.use if self.there(start, spec, spec.use) else start.closed[spec.name]
            for spec in self.read.loops
        }
        self.options.start = start.but(closed=closed, design=closed[start.loop])

    def there(self, settings: Settings, spec: LoopSpec, name: str) -> bool:
        """Return whether a design of a loop is there for just these settings."""
        design = spec.designs[known_name("design", name, tuple(d.name for d in spec.designs))]
        return live(design) or self.store.has(spec.name, name, self.key(settings, spec, design))

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

    def job(self, settings: Settings) -> Job:
        """Return the job that the settings stand for."""
        closed = {**settings.closed, settings.loop: settings.design}
        loops = tuple(
            dataclasses.replace(
                spec, use=closed[spec.name], designs=tuple(self._as_set(settings, spec, d) for d in spec.designs)
            )
            for spec in self.read.loops
        )
        return dataclasses.replace(self.plants.job(settings), loops=loops)

    def _as_set(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> DesignSpec:
        if not live(design):
            return dataclasses.replace(design, options=dict(settings.options[spec.name][design.name]))
        if not self.options.touched(settings, spec.name, design.name):
            return design
        return dataclasses.replace(design, options=self.options.used(settings, spec, design), tune=False)

    def key(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> Hashable:
        """Return all that a design of a method depends on."""
        return (self.options_key(settings.options[spec.name][design.name]), self.plants.key(settings))

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
        job = self.job(settings)
        plants, shown = self.plants.caged(settings, spec)
        K, note = self.caging(settings, spec, design)
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
        plants, shown = self.plants.free(settings, sensed_rates(job, controllers))
        loop = StabilisedLoop(
            job=job,
            model=self.plants.model(settings),
            spec=spec,
            controllers=tuple(controllers),
            plants=plants,
            shown=shown,
        )
        return loop, notes

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
            return self._margins.get((name, others, self.plants.key(settings)), make)

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
            made = self.servo(settings, spec, design)
            K, inputs, outputs = state_arrays(made, name), tuple(made.input_labels), tuple(made.output_labels)
            options = dict(settings.options[spec.name][name])
        else:
            try:
                K, note = self.caging(settings, spec, design)
            except DesignError:
                other = next((d for d in spec.designs if d.method == "classical"), None)
                if strict or other is None or live(design):
                    raise
                note = f"{spec.name}: {design.name} is not designed yet; {other.name} is closed in its place"
                design, (K, _) = other, self.caging(settings, spec, other)
            if strict and note:
                raise DesignError(f"{spec.name}, {note}")
            platform = self.read.platform
            inputs = tuple(platform.pickoff_on(gimbal).name for gimbal in spec.gimbals)
            outputs = tuple(platform.torquer_on(gimbal).name for gimbal in spec.gimbals)
            options = self.options.used(settings, spec, design)
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

    def servo(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> control.StateSpace:
        """Return the controller of a servo on the platform.

        Raises
        ------
        DesignError
            An option makes no sense, or the gyros do not see all rates.
        """
        mine = dataclasses.replace(design, options=dict(settings.options[spec.name][design.name]))
        job = dataclasses.replace(self.read, sampling=self.plants.sampling(settings))
        made = platform_servo(job, self.plants.model(settings), spec, mine).controller
        K = state_arrays(made, design.name)
        return state_space(K, made.input_labels, made.output_labels, name=f"{spec.name}, {design.name}")

    def caging(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> tuple[StateArrays, str]:
        """Return the controller of a caging loop, and a line about it or an empty text.

        Raises
        ------
        DesignError
            An option makes no sense, or the design is not made yet.
        """
        period = 1.0 / settings.rate_hz
        if design.method == "classical":
            return classical_arrays(
                self.options.used(settings, spec, design), self.plants.gyros(settings, spec), period
            ), ""
        found = self.store.found(spec.name, design.name, self.key(settings, spec, design), period)
        if found is None:
            raise DesignError(f"{spec.name}, {design.name}: is not designed yet; expected it to be designed first")
        return found
