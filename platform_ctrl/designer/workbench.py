"""The designer without a page: settings in, pictures out. One workbench serves all pages of a job."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.arguments import known_name, short
from platform_ctrl.design.channels import Channels
from platform_ctrl.designer.bounded import Bounded
from platform_ctrl.designer.caged import CagedLoop, caged_parts
from platform_ctrl.designer.controllers import MOVABLE, OPTIONAL, classical_arrays, full_options, parts_given
from platform_ctrl.designer.knobs import PARTS, moved, option_knobs, plant_knobs
from platform_ctrl.designer.quick_plants import QuickPlants, with_spins
from platform_ctrl.designer.values import Knob, Offer, Part, Picture, Settings
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.job import DesignSpec, Job, LoopSpec, Sampling
from platform_ctrl.reading import read_job


class Workbench:
    """Everything that a page needs of a job; all of it may be called from several threads.

    Parameters
    ----------
    job
        The job, or the path of its file.
    controllers
        Path of a ``result.json`` whose designs are shown as they are.

    Raises
    ------
    InputError
        The job makes no sense.
    """

    def __init__(self, job: str | Path | Job, controllers: str | Path | None = None) -> None:
        self.path = None if isinstance(job, Job) else Path(job)
        self.read = job if isinstance(job, Job) else read_job(job)
        self._specs = {spec.name: spec for spec in self.read.loops}
        self._quick = {
            spec.name: QuickPlants(self.read, spec.gimbals) for spec in self.read.loops if spec.kind == "caging"
        }
        self._pictures: Bounded[Picture] = Bounded(8)
        self._start = self._first()

    def offer(self) -> Offer:
        """Return what a page lets choose from."""
        specs = self.read.loops
        return Offer(
            loops=tuple(spec.name for spec in specs),
            designs={spec.name: tuple(d.name for d in spec.designs) for spec in specs},
            methods={spec.name: {d.name: d.method for d in spec.designs} for spec in specs},
            channels={spec.name: self._channels(spec) for spec in specs},
            manoeuvres=tuple(one.name for one in self.read.manoeuvres),
        )

    def start(self, loop: str | None = None) -> Settings:
        """Return the settings of the job as it stands, at one of its loops.

        Raises
        ------
        ArgumentError
            There is no such loop.
        """
        return self._start if loop is None else self.chosen(self._start, loop=loop)

    def chosen(self, settings: Settings, *, loop: str | None = None, design: str | None = None) -> Settings:
        """Return the settings at another loop, or another design of it.

        Raises
        ------
        ArgumentError
            There is no such loop or design.
        """
        name = settings.loop if loop is None else loop
        known_name("loop", name, tuple(self._specs))
        spec = self._specs[name]
        design = design if design is not None else settings.closed[name]
        known_name("design", design, tuple(d.name for d in spec.designs))
        channels = self._channels(spec)
        return settings.but(
            mode="caged" if spec.kind == "caging" else "stabilised",
            loop=name,
            design=design,
            closed={**settings.closed, name: design},
            channel=settings.channel if settings.channel in channels else channels[0],
            plant=settings.plant if name == settings.loop else "nominal",
            overlays=tuple(o for o in settings.overlays if o in {d.name for d in spec.designs} - {design}),
        )

    @property
    def title(self) -> str:
        """The job's name."""
        return self.read.name

    def expect_plant(self, settings: Settings) -> None:
        """Judge the names that no list of a page holds: plant, channel, fixed knobs.

        Raises
        ------
        ArgumentError
            The job has no such thing.
        """
        spec, _ = self._design(settings)
        labels = self.plants(settings)
        if settings.plant not in labels:
            raise ArgumentError(f"plant: given {short(settings.plant)}; expected the label of one of {len(labels)}")
        known_name("channel", settings.channel, self._channels(spec))
        for name in sorted(settings.fixed):
            known_name("fixed", name, tuple(knob.name for knob in self.knobs(settings)))

    def plants(self, settings: Settings) -> tuple[str, ...]:
        """Return the labels of the plants that may be shown."""
        spec, _ = self._design(settings)
        if spec.kind != "caging":
            return ("nominal",)
        return self._quick[spec.name].labels(self._range(settings))

    def knobs(self, settings: Settings) -> tuple[Knob, ...]:
        """Return all knobs of the settings, those of the design first.

        Raises
        ------
        ArgumentError
            The settings name what the job does not have.
        """
        spec, design = self._design(settings)
        options = settings.options[spec.name][design.name]
        parts = settings.optional.get(spec.name, {}).get(design.name, ())
        start = self._start.options[spec.name][design.name]
        own = option_knobs(
            design.method, options, start, settings.rate_hz, settings.fixed, MOVABLE.get(design.method, frozenset())
        )
        Omega = tuple(map(float, self.read.Omega))
        return (
            *(knob for knob in own if not knob.part or knob.part in parts),
            *plant_knobs(settings, self._start, (Omega[0], Omega[1], Omega[2])),
        )

    def parts(self, settings: Settings) -> tuple[Part, ...]:
        """Return the optional parts of the design that is worked on: lag and notches."""
        spec, design = self._design(settings)
        on = settings.optional.get(spec.name, {}).get(design.name, ())
        known = settings.options[spec.name][design.name]
        return tuple(
            Part(name=name, label=PARTS[name][0], on=name in on, tip=PARTS[name][1])
            for name in OPTIONAL.get(design.method, ())
            if f"{name}_hz" in known
        )

    def switched(self, settings: Settings, part: str, on: bool) -> Settings:
        """Return the settings with an optional part switched on or off.

        Raises
        ------
        ArgumentError
            The design has no such part.
        """
        spec, design = self._design(settings)
        known_name("part", part, tuple(one.name for one in self.parts(settings)))
        now = set(settings.optional.get(spec.name, {}).get(design.name, ())) - {part}
        new = tuple(sorted(now | {part} if on else now))
        mine = {**settings.optional.get(spec.name, {}), design.name: new}
        return settings.but(optional={**settings.optional, spec.name: mine})

    def moved(self, settings: Settings, knob: str, number: float) -> Settings:
        """Return the settings with a knob at another number.

        Raises
        ------
        ArgumentError
            There is no such knob, or it cannot stand there.
        """
        return moved(settings, {one.name: one for one in self.knobs(settings)}, knob, number)

    def picture(self, settings: Settings) -> Picture:
        """Return what is drawn for the settings.

        Raises
        ------
        PlatformCtrlError
            One line: what makes no sense, and what does.
        """
        begun = time.perf_counter()
        spec, design = self._design(settings)
        if spec.kind != "caging":
            raise DesignError(f"{spec.name}: cannot be shown")
        with np.errstate(all="ignore"):
            parts = caged_parts(self._loop(settings, spec, design), settings)
        return Picture(
            settings=settings,
            plants=self._quick[spec.name].labels(self._range(settings)),
            elapsed=time.perf_counter() - begun,
            **{one.name: getattr(parts, one.name) for one in dataclasses.fields(parts)},
        )

    def _loop(self, settings: Settings, spec: LoopSpec, design: DesignSpec) -> CagedLoop:
        quick, sampling = self._quick[spec.name], Sampling(period=1.0 / settings.rate_hz, delay=settings.delay)
        Omega = self._range(settings)
        plants = quick.plants(settings.spins, sampling, Omega)
        at = np.array(settings.Omega)
        if at.any():
            shown = quick.shown(settings.plant, at, settings.spins, sampling, Omega)
        else:
            shown = plants.only([plants.labels.index(settings.plant) if settings.plant in plants.labels else 0])
        channel = quick.channels(settings.spins)
        K = self._controller(settings, spec, design, channel, plants.nutation)
        job = dataclasses.replace(
            self.read, platform=with_spins(self.read.platform, settings.spins), sampling=sampling, Omega=Omega
        )
        return CagedLoop(job=job, spec=spec, design=design.name, plants=plants, shown=shown, controller=K)

    def _controller(
        self, settings: Settings, spec: LoopSpec, design: DesignSpec, channel: Channels, nutation: float
    ) -> StateArrays:
        options = settings.options[spec.name][design.name]
        parts = settings.optional.get(spec.name, {}).get(design.name, ())
        if design.method == "classical":
            return classical_arrays(options, parts, channel, nutation, 1.0 / settings.rate_hz)[0]
        raise DesignError(f"{spec.name}, {design.name}: is not designed yet")

    def _range(self, settings: Settings) -> FloatArray:
        """Return the largest platform rate about each axis: the job's, or what is shown where that is more."""
        return np.maximum(self.read.Omega, np.abs(settings.Omega))

    def _design(self, settings: Settings) -> tuple[LoopSpec, DesignSpec]:
        known_name("loop", settings.loop, tuple(self._specs))
        spec = self._specs[settings.loop]
        return spec, spec.designs[known_name("design", settings.design, tuple(d.name for d in spec.designs))]

    def _channels(self, spec: LoopSpec) -> tuple[str, ...]:
        if spec.kind == "caging":
            return tuple(self.read.platform.torquer_on(gimbal).name for gimbal in spec.gimbals)
        return tuple(t.name for t in self.read.platform.torquers if t.root_axis is not None)

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
            live = [d.name for d in spec.designs if d.method in ("classical", "platform-servo")]
            closed[spec.name] = spec.use if spec.use in live or not live else live[0]
        first = self.read.loops[0]
        return Settings(
            mode="caged" if first.kind == "caging" else "stabilised",
            loop=first.name,
            design=closed[first.name],
            options=options,
            optional=optional,
            rate_hz=1.0 / sampling.period,
            delay=sampling.delay,
            spins=spins,
            Omega=(0.0, 0.0, 0.0),
            channel=self._channels(first)[0],
            closed=closed,
        )

    def _options(self, spec: LoopSpec, design: DesignSpec, spins: dict[str, float]) -> dict[str, float]:
        if design.method == "classical":
            quick = self._quick[spec.name]
            nutation = quick.plants(spins, self.read.sampling, np.asarray(self.read.Omega)).nutation
            return full_options(design, quick.channels(spins), nutation, self.read.sampling.period)
        return dict(design.options)
