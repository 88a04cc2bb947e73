"""What a page may be set to: loops, designs, plants and sliders of a job, and what each choice makes of settings."""

from __future__ import annotations

from pathlib import Path

from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.saving import controllers_beside
from platform_ctrl.app.settings import Choices, Part, Settings, Slider
from platform_ctrl.app.sliders import moved, option_sliders, plant_sliders
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import Job
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.reading import read_job


class Settable:
    """The settings of a job, without pictures; see `Backend`.

    Parameters
    ----------
    job, controllers
        As of `Backend`.
    """

    def __init__(self, job: str | Path | Job, controllers: str | Path | None = None) -> None:
        self.path = None if isinstance(job, Job) else Path(job)
        self.read = job if isinstance(job, Job) else read_job(job)
        if controllers is None and self.path is not None and controllers_beside(self.path).exists():
            controllers = controllers_beside(self.path)
        self._loops = ClosedLoops(self.read, None if controllers is None else Path(controllers))

    @property
    def title(self) -> str:
        """The job's name."""
        return self.read.name

    def choices(self) -> Choices:
        """Return what a page lets choose from.

        Returns
        -------
        Choices
            Names of loops, designs, channels and manoeuvres.
        """
        specs = self.read.loops
        return Choices(
            loops=tuple(spec.name for spec in specs),
            designs={spec.name: tuple(d.name for d in spec.designs) for spec in specs},
            methods={spec.name: {d.name: d.method for d in spec.designs} for spec in specs},
            channels={spec.name: self._loops.plants.channels_of(spec) for spec in specs},
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
        return self._loops.start if loop is None else self.chosen(self._loops.start, loop=loop)

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
        spec = self._loops.spec(name)
        design = design if design is not None else settings.closed[name]
        names = tuple(d.name for d in spec.designs)
        known_name("design", design, names)
        channels = self._loops.plants.channels_of(spec)
        return settings.but(
            mode="caged" if spec.kind == "caging" else "stabilised",
            loop=name,
            design=design,
            closed={**settings.closed, name: design},
            channel=settings.channel if settings.channel in channels else channels[0],
            axis=settings.axis if name == settings.loop else self._loops.plants.loading_axis(spec, settings.axis),
            plant=settings.plant if name == settings.loop else "nominal",
            overlays=tuple(o for o in settings.overlays if o in names and o != design),
        )

    def expect_plant(self, settings: Settings) -> None:
        """Judge the names that no list of a page holds: plant, channel, fixed sliders.

        Parameters
        ----------
        settings
            From outside.
        """
        spec, _ = self._loops.design(settings)
        labels = self.plants(settings)
        if settings.plant not in labels:
            raise ArgumentError(f"plant: given {short(settings.plant)}; expected the label of one of {len(labels)}")
        known_name("channel", settings.channel, self._loops.plants.channels_of(spec))
        # Those of other loops and of parts that are off stay fixed.
        methods = sorted({one.method for loop in self.read.loops for one in loop.designs})
        options = (option for method in methods for option in METHODS[method].options)
        plant = (slider.name for slider in self.sliders(settings) if slider.group in ("sampling", "rotors", "Omega"))
        sliders = tuple(dict.fromkeys((*options, *plant)))
        for name in sorted(settings.fixed):
            known_name("fixed", name, sliders)

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
        return self._loops.plants.labels(settings, self._loops.spec(settings.loop))

    def sliders(self, settings: Settings) -> tuple[Slider, ...]:
        """Return all sliders of the settings, those of the design first.

        Parameters
        ----------
        settings
            As the page is set.

        Returns
        -------
        tuple of Slider
            Optional parts that are off have none, nor has what moves nothing of this loop.
        """
        spec, design = self._loops.design(settings)
        options = self._loops.options.offered(settings, spec, design)
        parts = settings.parts_on(spec.name, design.name)
        # What only rotors that were set going or stopped ask for starts by rules of thumb, wherever it stands now.
        start = self._loops.options.offered(settings.but(options=self._loops.start.options), spec, design)
        own = option_sliders(design.method, options, start, settings.rate_hz, settings.fixed)
        Omega = tuple(map(float, self.read.Omega))
        return (
            *(slider for slider in own if not slider.part or slider.part in parts),
            *plant_sliders(
                settings, self._loops.start, (Omega[0], Omega[1], Omega[2]), self._loops.options.slowest(settings)
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
        spec, design = self._loops.design(settings)
        on = settings.parts_on(spec.name, design.name)
        known = self._loops.options.offered(settings, spec, design)
        return tuple(
            Part(name=name, label=label, on=name in on, tip=tip)
            for name, (label, tip) in METHODS[design.method].parts.items()
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
        spec, design = self._loops.design(settings)
        known_name("part", part, tuple(one.name for one in self.parts(settings)))
        now = set(settings.parts_on(spec.name, design.name)) - {part}
        mine = {**settings.optional.get(spec.name, {}), design.name: tuple(sorted(now | {part} if on else now))}
        return settings.but(optional={**settings.optional, spec.name: mine})

    def moved(self, settings: Settings, slider: str, number: float) -> Settings:
        """Return the settings with a slider at another number.

        Parameters
        ----------
        settings
            As they are.
        slider
            Its name.
        number
            Where it is to stand, in its unit; also beyond the ends of its slider.

        Returns
        -------
        Settings
            What makes no sense together with the others is told by `picture`.
        """
        new = moved(settings, {one.name: one for one in self.sliders(settings)}, slider, number)
        return self._loops.holding(settings, new)

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
        return self._loops.job(settings)
