"""What a page may be set to: loops, designs, plants and sliders of a job, and what each choice makes of settings."""

from __future__ import annotations

from pathlib import Path

from platform_ctrl.app.closing import Closing
from platform_ctrl.app.controllers import MOVABLE, OPTIONAL
from platform_ctrl.app.knobs import KINDS, PARTS, moved, option_knobs, plant_knobs
from platform_ctrl.app.saving import controllers_beside
from platform_ctrl.app.values import Knob, Offer, Part, Settings
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import Job
from platform_ctrl.job.reading import read_job


class Settable:
    """The settings of a job, without pictures; see `Workbench`.

    Parameters
    ----------
    job, controllers
        As of `Workbench`.
    """

    def __init__(self, job: str | Path | Job, controllers: str | Path | None = None) -> None:
        self.path = None if isinstance(job, Job) else Path(job)
        self.read = job if isinstance(job, Job) else read_job(job)
        if controllers is None and self.path is not None and controllers_beside(self.path).exists():
            controllers = controllers_beside(self.path)
        self._closing = Closing(self.read, None if controllers is None else Path(controllers))

    @property
    def title(self) -> str:
        """The job's name."""
        return self.read.name

    def offer(self) -> Offer:
        """Return what a page lets choose from.

        Returns
        -------
        Offer
            Names of loops, designs, channels and manoeuvres.
        """
        specs = self.read.loops
        return Offer(
            loops=tuple(spec.name for spec in specs),
            designs={spec.name: tuple(d.name for d in spec.designs) for spec in specs},
            methods={spec.name: {d.name: d.method for d in spec.designs} for spec in specs},
            channels={spec.name: self._closing.plants.channels_of(spec) for spec in specs},
            manoeuvres=tuple(one.name for one in self.read.manoeuvres),
        )

    def start(self, loop: str | None = None) -> Settings:
        """Return the settings of the job as it stands, at one of its loops.

        Parameters
        ----------
        loop
            Its name; None: the first.

        Returns
        -------
        Settings
            With all options of all designs.
        """
        return self._closing.start if loop is None else self.chosen(self._closing.start, loop=loop)

    def chosen(self, settings: Settings, *, loop: str | None = None, design: str | None = None) -> Settings:
        """Return the settings at another loop, or another design of it.

        Parameters
        ----------
        settings
            As they are.
        loop, design
            Names; None: as they are.

        Returns
        -------
        Settings
            With mode, channel, plant and overlays that fit.
        """
        name = settings.loop if loop is None else loop
        spec = self._closing.spec(name)
        design = design if design is not None else settings.closed[name]
        names = tuple(d.name for d in spec.designs)
        known_name("design", design, names)
        channels = self._closing.plants.channels_of(spec)
        return settings.but(
            mode="caged" if spec.kind == "caging" else "stabilised",
            loop=name,
            design=design,
            closed={**settings.closed, name: design},
            channel=settings.channel if settings.channel in channels else channels[0],
            axis=settings.axis if name == settings.loop else self._closing.plants.loading_axis(spec, settings.axis),
            plant=settings.plant if name == settings.loop else "nominal",
            overlays=tuple(o for o in settings.overlays if o in names and o != design),
        )

    def expect_plant(self, settings: Settings) -> None:
        """Judge the names that no list of a page holds: plant, channel, fixed knobs.

        Parameters
        ----------
        settings
            From outside.
        """
        spec, _ = self._closing.design(settings)
        labels = self.plants(settings)
        if settings.plant not in labels:
            raise ArgumentError(f"plant: given {short(settings.plant)}; expected the label of one of {len(labels)}")
        known_name("channel", settings.channel, self._closing.plants.channels_of(spec))
        # Those of other loops and of parts that are off stay fixed.
        methods = sorted({one.method for loop in self.read.loops for one in loop.designs})
        options = (option for method in methods for option in KINDS[method])
        plant = (knob.name for knob in self.knobs(settings) if knob.group in ("sampling", "rotors", "Omega"))
        knobs = tuple(dict.fromkeys((*options, *plant)))
        for name in sorted(settings.fixed):
            known_name("fixed", name, knobs)

    def plants(self, settings: Settings) -> tuple[str, ...]:
        """Return the labels of the plants that may be shown.

        Parameters
        ----------
        settings
            They depend on the loop and on Omega.

        Returns
        -------
        tuple of str
            The nominal one first.
        """
        return self._closing.plants.labels(settings, self._closing.spec(settings.loop))

    def knobs(self, settings: Settings) -> tuple[Knob, ...]:
        """Return all knobs of the settings, those of the design first.

        Parameters
        ----------
        settings
            As the page is set.

        Returns
        -------
        tuple of Knob
            Optional parts that are off have none, nor has what moves nothing of this loop.
        """
        spec, design = self._closing.design(settings)
        options = self._closing.options.offered(settings, spec, design)
        parts = settings.parts_on(spec.name, design.name)
        # What only rotors that were set going or stopped ask for starts by rules of thumb, wherever it stands now.
        start = self._closing.options.offered(settings.but(options=self._closing.start.options), spec, design)
        movable = MOVABLE.get(design.method, frozenset())
        own = option_knobs(design.method, options, start, settings.rate_hz, settings.fixed, movable)
        Omega = tuple(map(float, self.read.Omega))
        return (
            *(knob for knob in own if not knob.part or knob.part in parts),
            *plant_knobs(
                settings, self._closing.start, (Omega[0], Omega[1], Omega[2]), self._closing.options.slowest(settings)
            ),
        )

    def parts(self, settings: Settings) -> tuple[Part, ...]:
        """Return the optional parts of the design that is worked on: lag and notches.

        Parameters
        ----------
        settings
            As the page is set.

        Returns
        -------
        tuple of Part
            Empty for a method that knows none.
        """
        spec, design = self._closing.design(settings)
        on = settings.parts_on(spec.name, design.name)
        known = self._closing.options.offered(settings, spec, design)
        return tuple(
            Part(name=name, label=PARTS[name][0], on=name in on, tip=PARTS[name][1])
            for name in OPTIONAL.get(design.method, ())
            if f"{name}_hz" in known
        )

    def switched(self, settings: Settings, part: str, on: bool) -> Settings:
        """Return the settings with an optional part switched on or off.

        Parameters
        ----------
        settings
            As they are.
        part
            Name of the part.
        on
            Whether it is to be there.

        Returns
        -------
        Settings
            The part's numbers are those that it had last.
        """
        spec, design = self._closing.design(settings)
        known_name("part", part, tuple(one.name for one in self.parts(settings)))
        now = set(settings.parts_on(spec.name, design.name)) - {part}
        mine = {**settings.optional.get(spec.name, {}), design.name: tuple(sorted(now | {part} if on else now))}
        return settings.but(optional={**settings.optional, spec.name: mine})

    def moved(self, settings: Settings, knob: str, number: float) -> Settings:
        """Return the settings with a knob at another number.

        Parameters
        ----------
        settings
            As they are.
        knob
            Its name.
        number
            Where it is to stand, in its unit; also beyond the ends of its slider.

        Returns
        -------
        Settings
            What makes no sense together with the others is told by `picture`.
        """
        new = moved(settings, {one.name: one for one in self.knobs(settings)}, knob, number)
        return self._closing.holding(settings, new)

    def job(self, settings: Settings) -> Job:
        """Return the job that the settings stand for.

        Parameters
        ----------
        settings
            As the page is set.

        Returns
        -------
        Job
            With their plant, sampling, range of Omega and options; the designs named in `closed` are closed.
        """
        return self._closing.job(settings)
