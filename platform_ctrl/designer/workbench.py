"""The designer without a page: settings in, pictures out. One workbench serves all pages of a job."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.arguments import known_name, short, whole
from platform_ctrl.designer import background
from platform_ctrl.designer.caged import caged_parts
from platform_ctrl.designer.closing import Closing
from platform_ctrl.designer.controllers import MOVABLE, OPTIONAL
from platform_ctrl.designer.designs import Designs, never, silent
from platform_ctrl.designer.influence import caged_influence, moved_knob, stabilised_influence
from platform_ctrl.designer.knobs import KINDS, PARTS, moved, option_knobs, plant_knobs, with_options
from platform_ctrl.designer.parts import Drawn, Measured, Parts
from platform_ctrl.designer.pictures import Drawing, Influence, Overlay, Picture
from platform_ctrl.designer.pulling import crossover_pulled, pole_pulled
from platform_ctrl.designer.saving import Saved, controllers_beside, save
from platform_ctrl.designer.stabilised import stabilised_parts
from platform_ctrl.designer.tasks import Flying, ServoTuning, Tuning
from platform_ctrl.designer.values import Knob, Offer, Part, Settings
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.job import Job
from platform_ctrl.reading import read_job

if TYPE_CHECKING:
    from platform_ctrl.simulation import Trajectory

Progress = Callable[[str], None]
Cancelled = Callable[[], bool]


def nothing(drawing: Drawing) -> None:
    """Do nothing with a drawing: nobody waits for it."""


class Workbench:
    """Everything that a page needs of a job; all of it may be called from several threads.

    Parameters
    ----------
    job
        The job, or the path of its file.
    controllers
        Path of a ``result.json`` whose designs are shown as they are; default: the file that `saved` leaves beside a
        job, where there is one.

    Raises
    ------
    InputError
        The job or the controllers make no sense.

    References
    ----------
    See docs/designer.md.
    """

    def __init__(self, job: str | Path | Job, controllers: str | Path | None = None) -> None:
        self.path = None if isinstance(job, Job) else Path(job)
        self.read = job if isinstance(job, Job) else read_job(job)
        if controllers is None and self.path is not None and controllers_beside(self.path).exists():
            controllers = controllers_beside(self.path)
        self._closing = Closing(self.read, None if controllers is None else Path(controllers))
        self._start = self._closing.start
        self._designs = Designs(self._closing)
        self._flier = background.Resident()

    def close(self) -> None:
        """End the designs that are being made, and the process that flies; nobody asks any more.

        References
        ----------
        See docs/designer.md.
        """
        self._designs.end()
        self._flier.end()

    def on_designed(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have `listener` called, in a thread, whenever a design that pictures were waiting for is there or failed.

        Parameters
        ----------
        listener
            Called without arguments; drawing the picture again then shows the design.

        Returns
        -------
        callable
            Ends that: a page that is closed calls it.

        References
        ----------
        See docs/designer.md.
        """
        return self._designs.listen(listener)

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

        References
        ----------
        See docs/designer.md.
        """
        specs = self.read.loops
        return Offer(
            loops=tuple(spec.name for spec in specs),
            designs={spec.name: tuple(d.name for d in spec.designs) for spec in specs},
            methods={spec.name: {d.name: d.method for d in spec.designs} for spec in specs},
            channels={spec.name: self._closing.channels_of(spec) for spec in specs},
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

        Raises
        ------
        ArgumentError
            There is no such loop.

        References
        ----------
        See docs/designer.md.
        """
        return self._start if loop is None else self.chosen(self._start, loop=loop)

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

        Raises
        ------
        ArgumentError
            There is no such loop or design.

        References
        ----------
        See docs/designer.md.
        """
        name = settings.loop if loop is None else loop
        spec = self._closing.spec(name)
        design = design if design is not None else settings.closed[name]
        names = tuple(d.name for d in spec.designs)
        known_name("design", design, names)
        channels = self._closing.channels_of(spec)
        return settings.but(
            mode="caged" if spec.kind == "caging" else "stabilised",
            loop=name,
            design=design,
            closed={**settings.closed, name: design},
            channel=settings.channel if settings.channel in channels else channels[0],
            axis=settings.axis if name == settings.loop else self._closing.loading_axis(spec, settings.axis),
            plant=settings.plant if name == settings.loop else "nominal",
            overlays=tuple(o for o in settings.overlays if o in names and o != design),
        )

    def expect_plant(self, settings: Settings) -> None:
        """Judge the names that no list of a page holds: plant, channel, fixed knobs.

        Parameters
        ----------
        settings
            From outside.

        Raises
        ------
        ArgumentError
            The job has no such thing.

        References
        ----------
        See docs/designer.md.
        """
        spec, _ = self._closing.design(settings)
        labels = self.plants(settings)
        if settings.plant not in labels:
            raise ArgumentError(f"plant: given {short(settings.plant)}; expected the label of one of {len(labels)}")
        known_name("channel", settings.channel, self._closing.channels_of(spec))
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

        Raises
        ------
        ArgumentError
            There is no such loop.

        References
        ----------
        See docs/designer.md.
        """
        return self._closing.labels(settings)

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

        Raises
        ------
        ArgumentError
            The settings name what the job does not have.

        References
        ----------
        See docs/designer.md.
        """
        spec, design = self._closing.design(settings)
        options = self._closing.offered(settings, spec, design)
        parts = settings.parts_on(spec.name, design.name)
        # What only rotors that were set going or stopped ask for starts by rules of thumb, wherever it stands now.
        start = self._closing.offered(settings.but(options=self._start.options), spec, design)
        movable = MOVABLE.get(design.method, frozenset())
        own = option_knobs(design.method, options, start, settings.rate_hz, settings.fixed, movable)
        Omega = tuple(map(float, self.read.Omega))
        return (
            *(knob for knob in own if not knob.part or knob.part in parts),
            *plant_knobs(settings, self._start, (Omega[0], Omega[1], Omega[2]), self._closing.slowest(settings)),
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

        Raises
        ------
        ArgumentError
            The settings name what the job does not have.

        References
        ----------
        See docs/designer.md.
        """
        spec, design = self._closing.design(settings)
        on = settings.parts_on(spec.name, design.name)
        known = self._closing.offered(settings, spec, design)
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

        Raises
        ------
        ArgumentError
            The design has no such part.

        References
        ----------
        See docs/designer.md.
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

        Raises
        ------
        ArgumentError
            There is no such knob, or it cannot stand there.

        References
        ----------
        See docs/designer.md.
        """
        return moved(settings, {one.name: one for one in self.knobs(settings)}, knob, number)

    def picture(self, settings: Settings, drawn: Callable[[Drawing], None] = nothing) -> Picture:
        """Return what is drawn for the settings, and what is measured.

        Parameters
        ----------
        settings
            As the page is set.
        drawn
            Called with what is drawn as soon as that is there: measuring takes as long again.

        Returns
        -------
        Picture
            Requirements of a caging loop are as `check` measures them; those of all loops together are climbed on a
            grid and lie within about a thousandth.

        Raises
        ------
        PlatformCtrlError
            One line: what makes no sense, and what does.

        References
        ----------
        See docs/designer.md.
        """
        begun = time.perf_counter()
        whole("axis", settings.axis, 1, 3)
        try:
            with np.errstate(all="ignore"):
                (parts, measure), told = self._parts(settings)
                drawing = _fields(parts) | {"settings": settings, "plants": self.plants(settings)}
                drawn(Drawing(**drawing))
                measured = measure()
        except (np.linalg.LinAlgError, FloatingPointError, OverflowError):
            raise DesignError(
                f"{settings.loop}, {settings.design}: the loop's numbers leave floating point; expected less extreme "
                "settings"
            ) from None
        figures = _fields(measured) | {"notes": (*told, *measured.notes)}
        return Picture(**drawing, **figures, elapsed=time.perf_counter() - begun)

    def _parts(self, settings: Settings) -> tuple[Parts, tuple[str, ...]]:
        """Return the parts of a picture, and lines about its controllers."""
        spec, _ = self._closing.design(settings)
        if spec.kind == "caging":
            loop, told = self._designs.caged(settings)
            parts, measure = caged_parts(loop, settings)
        else:
            free, told = self._closing.stabilised(settings)
            parts, measure = stabilised_parts(free, settings, self._closing.kept(settings))
        if not settings.overlays:
            return (parts, measure), told
        overlays, more = self._designs.overlays(settings, spec, parts.bode.frequency)
        parts = dataclasses.replace(parts, bode=dataclasses.replace(parts.bode, overlays=overlays))
        return (parts, measure), (*told, *more)

    def overlay(self, settings: Settings, design: str) -> Overlay:
        """Return another design of the loop, to be drawn over the picture of the settings.

        Parameters
        ----------
        settings
            As the page is set.
        design
            Name of a design of the loop.

        Returns
        -------
        Overlay
            On the grid of the picture's bode diagram, with its limits measured.

        Raises
        ------
        DesignError
            It is not designed yet.

        References
        ----------
        See docs/designer.md.
        """
        spec, _ = self._closing.design(settings)
        known_name("design", design, tuple(d.name for d in spec.designs))
        frequency = self.picture(settings.but(overlays=())).bode.frequency
        return self._designs.overlay(settings, spec, design, frequency, measured=True)[0]

    def designed(self, settings: Settings, design: str | None = None) -> bool:
        """Return whether a design of the loop is there for just these settings; those that knobs build always are.

        Parameters
        ----------
        settings
            As the page is set.
        design
            Its name; None: the one that is worked on.

        Returns
        -------
        bool
            Whether `redesigned` has nothing to do.

        Raises
        ------
        ArgumentError
            There is no such design.

        References
        ----------
        See docs/designer.md.
        """
        return self._designs.there(settings, design)

    def redesigned(
        self,
        settings: Settings,
        design: str | None = None,
        progress: Progress = silent,
        cancelled: Cancelled = never,
    ) -> Settings:
        """Have a design made by its method, in a process of its own; later pictures show it.

        Parameters
        ----------
        settings
            As the page is set.
        design
            Its name; None: the one that is worked on.
        progress
            Called with a line now and then.
        cancelled
            Asked ten times a second; the process is ended as soon as it says yes.

        Returns
        -------
        Settings
            As they were.

        Raises
        ------
        Abandoned
            It was cancelled.
        DesignError
            The method found no controller.

        References
        ----------
        See docs/loop-design.md.
        """
        self._designs.make(settings, design, progress, cancelled)
        return settings

    def pulled_pole(self, settings: Settings, pole: complex, target: complex) -> Settings:
        """Return the settings in which a closed-loop pole lies at `target`, or as near as the free knobs bring it.

        Parameters
        ----------
        settings
            As they are.
        pole
            Where it is now, rad/s in the s-plane: the nearest one of the plant shown is meant.
        target
            Where it is wanted, rad/s.

        Returns
        -------
        Settings
            With other numbers of the design's knobs that are not fixed.

        Raises
        ------
        DesignError
            No knob is free, or none moves it.

        References
        ----------
        See docs/designer.md.
        """
        if not (np.isfinite(pole) and np.isfinite(target)):
            raise ArgumentError(f"pole: given {pole} to {target}; expected finite numbers, rad/s")
        with np.errstate(all="ignore"):
            reins, plant, _ = self._closing.reins(settings, self.knobs(settings))
            return with_options(settings, pole_pulled(reins, plant, complex(pole), complex(target)))

    def pulled_crossover(self, settings: Settings, frequency: float, now: float | None = None) -> Settings:
        """Return the settings in which the shown channel crosses over at `frequency`, or as near as can be.

        Parameters
        ----------
        settings
            As they are.
        frequency
            Where its gain is to be 1, rad/s.
        now
            The crossover that is pulled, rad/s; None: the highest.

        Returns
        -------
        Settings
            With other numbers of the design's knobs that are not fixed.

        Raises
        ------
        DesignError
            No knob is free, none moves it, or the loop does not cross over.

        References
        ----------
        See docs/designer.md.
        """
        if not np.isfinite(frequency):
            raise ArgumentError(f"frequency: given {frequency}; expected a finite number, rad/s")
        if now is None:
            found = self.picture(settings.but(band=False, overlays=())).bode.crossovers
            if not len(found):
                raise DesignError(f"{settings.channel}: its gain does not pass 1; expected a loop that crosses over")
            now = float(found[-1])
        with np.errstate(all="ignore"):
            reins, plant, channel = self._closing.reins(settings, self.knobs(settings))
            return with_options(settings, crossover_pulled(reins, plant, channel, now, float(frequency)))

    def tuned(self, settings: Settings, progress: Progress = silent, cancelled: Cancelled = never) -> Settings:
        """Return the settings with all knobs of the design that are not fixed tuned until its limits are met.

        Parameters
        ----------
        settings
            As they are: what is fixed stays.
        progress
            Called with a line now and then.
        cancelled
            Asked ten times a second; the process that tunes is ended as soon as it says yes.

        Returns
        -------
        Settings
            The best that were found.

        Raises
        ------
        Abandoned
            It was cancelled.
        DesignError
            No knob is free.

        References
        ----------
        See docs/classical.md.
        """
        spec, design = self._closing.design(settings)
        free = tuple(k.name for k in self.knobs(settings) if k.tunable and not k.fixed)
        if not free:
            raise DesignError(
                f"{spec.name}, {design.name}: no knob is free to be tuned; expected one that is not fixed"
            )
        options = self._closing.used(settings, spec, design)
        question: Tuning | ServoTuning
        if spec.kind == "caging":
            question = Tuning(job=self.job(settings), loop=spec.name, options=options, movable=free)
        else:
            others = tuple(one for one in self._closing.saved_controllers(settings) if one.loop != spec.name)
            question = ServoTuning(
                job=self.job(settings),
                loop=spec.name,
                design=design.name,
                movable=free,
                options=options,
                caging=tuple((o.controller, o.inputs, o.outputs, o.loop) for o in others),
            )
        found: dict[str, float] = background.worked_out(question, progress, cancelled)
        # Six digits: more would not be read, and no requirement hangs on them.
        return with_options(settings, {name: float(f"{found[name]:.6g}") for name in free})

    def influence(self, settings: Settings) -> Influence:
        """Return what each knob does to each requirement.

        Parameters
        ----------
        settings
            As the page is set.

        Returns
        -------
        Influence
            Of all knobs whose effect is seen at once; of a method that designs, those of the plant alone.

        Raises
        ------
        PlatformCtrlError
            One line: why there is no picture of these settings either.

        References
        ----------
        See docs/designer.md.
        """
        spec, _ = self._closing.design(settings)
        knobs = [knob for knob in self.knobs(settings) if not knob.background]

        def with_knob(knob: Knob) -> Settings:
            return self.moved(settings, knob.name, moved_knob(knob))

        with np.errstate(all="ignore"):
            if spec.kind == "caging":
                loop, _ = self._closing.caged(settings)
                return caged_influence(loop, knobs, lambda knob: self._closing.caged(with_knob(knob))[0])
            return stabilised_influence(self._closing, settings, knobs, with_knob)

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

        Raises
        ------
        ArgumentError
            The settings name what the job does not have.

        References
        ----------
        See docs/designer.md.
        """
        return self._closing.job(settings)

    def saved(self, settings: Settings, path: str | Path, overwrite: bool = False) -> Saved:
        """Write the settings as a job file, and its controllers beside it; comments of the job's own file stay.

        Parameters
        ----------
        settings
            As the page is set.
        path
            Of the new job file, ending in .toml.
        overwrite
            Whether what stands there may go.

        Returns
        -------
        Saved
            Both paths; ``platform-ctrl check`` finds the controllers by itself.

        Raises
        ------
        InputError
            A file stands there, or it cannot be written.
        DesignError
            A loop has no controller yet.

        References
        ----------
        See docs/designer.md.
        """
        controllers = self._closing.saved_controllers(settings, strict=True)
        closing = self._closing
        used = {
            spec.name: {d.name: closing.used(settings, spec, d) for d in spec.designs if closing.live(d)}
            for spec in self.read.loops
        }
        closed = {**settings.closed, settings.loop: settings.design}
        changed = {
            loop: {
                design: numbers
                for design, numbers in designs.items()
                if design == closed[loop] or closing.touched(settings, loop, design)
            }
            for loop, designs in used.items()
        }
        start = self._start
        notes = tuple(
            f"{spec.name}: {closed[spec.name]} is closed in place of {spec.use}, which is not designed"
            for spec in self.read.loops
            if start.closed[spec.name] != spec.use and closed[spec.name] == start.closed[spec.name]
        )
        written = save(
            self.path,
            Path(path),
            overwrite,
            settings.but(closed=closed),
            start,
            self.job(settings),
            changed,
            controllers,
        )
        return dataclasses.replace(written, notes=notes)

    @property
    def flown(self) -> bool:
        """Whether a manoeuvre has been flown already: the first takes longer, until its equations are compiled."""
        return self._flier.there

    def run(self, settings: Settings, manoeuvre: str, cancelled: Cancelled = never) -> Trajectory:
        """Return one of the job's manoeuvres, flown on the non-linear plant with the loops as they are set.

        It is flown in a process of its own, which stays for the next one until `close`.

        Parameters
        ----------
        settings
            As the page is set.
        manoeuvre
            Its name.
        cancelled
            Asked ten times a second; the process is ended as soon as it says yes.

        Returns
        -------
        Trajectory
            As `simulation.flight` returns it.

        Raises
        ------
        Abandoned
            It was cancelled.
        ArgumentError
            There is no such manoeuvre.
        DesignError
            A loop has no controller yet.

        References
        ----------
        See docs/simulation.md.
        """
        known_name("manoeuvre", manoeuvre, tuple(one.name for one in self.read.manoeuvres))
        saved = self._closing.saved_controllers(settings)
        question = Flying(
            job=self.job(settings),
            manoeuvre=manoeuvre,
            controllers=tuple((o.controller, o.inputs, o.outputs, f"{o.loop}, {o.design}") for o in saved),
        )
        flown: Trajectory = self._flier.worked_out(question, silent, cancelled)
        return flown


def _fields(parts: Drawn | Measured) -> dict[str, Any]:
    return {one.name: getattr(parts, one.name) for one in dataclasses.fields(parts)}
