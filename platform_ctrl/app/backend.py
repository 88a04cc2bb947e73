"""All that pages show and do, without a page: from settings to pictures, tuned settings, saved jobs and runs."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.app.background import IsCancelled, simulated, tuned_options
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.controllers import built_directly, part_of
from platform_ctrl.app.job_parts import BudgetState, JobParts, SightBudgets, loop_stamp, run_stamp
from platform_ctrl.app.loops import LATER
from platform_ctrl.app.pictures import Drawing, Picture
from platform_ctrl.app.saving import JobSource, Saved, controllers_beside, is_unchanged, write_job
from platform_ctrl.app.settings import (
    LARGEST,
    Part,
    Settings,
    Slider,
    limits_of_rows,
    main_sliders,
    moved,
    option_sliders,
    with_options,
)
from platform_ctrl.common.arguments import known_name, short, whole
from platform_ctrl.common.progress import Local, Progress
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.method import LoopProblem
from platform_ctrl.design.methods import METHODS, read_job
from platform_ctrl.design.tuning import SHARE, OptionEffects, deciding, largest_ratios, option_effects
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import out_of_reach
from platform_ctrl.verification.controllers import differing_origin
from platform_ctrl.verification.simulated import run_of

if TYPE_CHECKING:
    from platform_ctrl.simulation.closed_loop import Trajectory


class Backend:
    """All that pages need of a job, shared by them; every method may be called from several threads.

    Its `loops` have the plants and controllers of settings, `sight` the budget, `job_parts` the verdicts.

    Parameters
    ----------
    job
        The job, or the path of its file.
    controllers
        Path of a ``result.json`` whose designs are shown as they are; default: the file that `save` leaves beside a
        job, if it exists.
    """

    def __init__(self, job: str | Path | Job, controllers: str | Path | None = None) -> None:
        self.path = None if isinstance(job, Job) else Path(job)
        self.folder = Path() if self.path is None else self.path.parent
        self.read = job if isinstance(job, Job) else read_job(job)
        self._source = None if self.path is None else JobSource(self.path, self.read)
        if controllers is None and self.path is not None:
            beside = controllers_beside(self.path)
            # Controllers of another plant or job are not used.
            controllers = beside if beside.exists() and not differing_origin(beside, self.read) else None
        self.loops = ClosedLoops(self.read, None if controllers is None else Path(controllers))
        self.read, self.requests = self.loops.read, self.loops.requests
        # Whether a manoeuvre has been simulated: the first takes longer, until its equations are compiled.
        self.has_simulated = False
        self.sight = SightBudgets(self.loops)
        self.job_parts = JobParts(self.loops, self.sight)
        # The names of the limits of results, by the results' subject and name.
        self.limit_names = limits_of_rows(self.read)

    def close(self) -> None:
        """End the process that designs, tunes and simulates."""
        self.requests.end()
        self.loops.background.end()

    # Settings and what they may be.

    def choices(self, settings: Settings) -> dict[str, tuple[Any, ...]]:
        """Return what may be chosen from each list of the page."""
        spec = self.loops.spec(settings.loop)
        return {
            "loop": tuple(one.name for one in self.read.loops),
            "design": tuple(one.name for one in spec.designs),
            "channel": self.loops.plants.read.channels_of(spec),
            "plant": self.loops.plants.labels(spec),
            "axis": (1, 2, 3),
            "band": (True, False),
        }

    def start(self, loop: str | None = None) -> Settings:
        """Return the settings of the job file, at one of its loops; None: the first that sliders shape at once."""
        start = self.loops.options.start
        if loop is None:
            # `closed` has a design that is built directly wherever a loop has any and its own is not made yet.
            each = (start.but(loop=name, design=design) for name, design in start.closed.items())
            loop = next((one.loop for one in each if built_directly(self.loops.design(one)[1])), start.loop)
        return start if loop == start.loop else self.chosen(start, loop=loop)

    def chosen(self, settings: Settings, *, loop: str | None = None, design: str | None = None) -> Settings:
        """Return the settings at another loop, or another design of it."""
        name = settings.loop if loop is None else loop
        spec = self.loops.spec(name)
        design = design if design is not None else settings.closed[name]
        names = tuple(d.name for d in spec.designs)
        known_name("design", design, names)
        channels = self.loops.plants.read.channels_of(spec)
        return settings.but(
            loop=name,
            design=design,
            closed={**settings.closed, name: design},
            channel=settings.channel if settings.channel in channels else channels[0],
            axis=settings.axis if name == settings.loop else self.loops.plants.loading_axis(spec, settings.axis),
            plant=settings.plant if name == settings.loop else "nominal",
            overlays=tuple(o for o in settings.overlays if o in names and o != design),
        )

    def sliders(self, settings: Settings) -> tuple[Slider, ...]:
        """Return all sliders of the settings: speed and robustness, then those of the design."""
        spec, design = self.loops.design(settings)
        options = self.loops.options.offered(settings, spec, design)
        parts = settings.parts_on(spec.name, design.name)
        start = self.loops.options.start.options[spec.name][design.name]
        own = option_sliders(design.method, options, start, 1.0 / self.read.period_of(spec), settings.fixed)
        shown = [slider for slider in own if not slider.part or slider.part in parts]
        return (*main_sliders(design.method, shown), *shown)

    def parts(self, settings: Settings) -> tuple[Part, ...]:
        """Return the optional parts of the selected design: lag and notches."""
        spec, design = self.loops.design(settings)
        on = settings.parts_on(spec.name, design.name)
        known = self.loops.options.offered(settings, spec, design)
        return tuple(
            Part(name=name, label=label, on=name in on, tip=tip)
            for name, (label, tip) in METHODS[design.method].parts.items()
            if any(part_of(option) == name for option in known)
        )

    def with_choice(self, settings: Settings, name: str, value: Any) -> Settings:
        """Return the settings with something else chosen from a list of the page."""
        choices = self.choices(settings)
        known_name("choice", name, tuple(choices))
        if value not in choices[name] or type(value) is not type(choices[name][0]):
            raise ArgumentError(f"{name} must be one of {', '.join(map(str, choices[name]))}, got {short(value)}")
        if name in ("loop", "design"):
            return self.chosen(settings, **{name: value})
        return settings.but(**{name: value})

    def with_limit(self, settings: Settings, key: str, number: Any) -> Settings:
        """Return the settings with another limit, in the units of the job file."""
        known_name("limit", key, tuple(settings.limits))
        if isinstance(number, bool) or not isinstance(number, int | float) or not 0.0 < number <= LARGEST:
            raise ArgumentError(f"{key} must be a positive finite number, got {short(number)}")
        table, _, name = key.rpartition(".")
        for _, words in out_of_reach({name: number}):
            raise ArgumentError(f"{table}: {words}")
        return settings.but(limits={**settings.limits, key: float(number)})

    def with_fixed(self, settings: Settings, slider: str, fixed: bool) -> Settings:
        """Return the settings with a slider that tuning does not move, or does."""
        known_name("slider", slider, [one.name for one in self.sliders(settings) if not one.along])
        return settings.but(fixed=settings.fixed | {slider} if fixed else settings.fixed - {slider})

    def reset(self, settings: Settings, slider: str) -> Settings:
        """Return the settings with a slider at its value in the job file."""
        starts = {one.name: one.start for one in self.sliders(settings)}
        known_name("slider", slider, list(starts))
        return self.moved(settings, slider, starts[slider])

    def with_part(self, settings: Settings, part: str, on: bool) -> Settings:
        """Return the settings with an optional part switched on or off."""
        spec, design = self.loops.design(settings)
        known_name("part", part, tuple(one.name for one in self.parts(settings)))
        now = set(settings.parts_on(spec.name, design.name)) - {part}
        mine = {**settings.optional.get(spec.name, {}), design.name: tuple(sorted(now | {part} if on else now))}
        return settings.but(optional={**settings.optional, spec.name: mine})

    def with_overlay(self, settings: Settings, design: str, on: bool) -> Settings:
        """Return the settings with another design of the loop drawn over the selected one, or not."""
        others = [one.name for one in self.loops.spec(settings.loop).designs if one.name != settings.design]
        known_name("overlay", design, others)
        now = {*settings.overlays, design} if on else {*settings.overlays} - {design}
        return settings.but(overlays=tuple(one for one in others if one in now))

    def moved(self, settings: Settings, slider: str, number: float) -> Settings:
        """Return the settings with a slider at another number."""
        sliders = {one.name: one for one in self.sliders(settings)}
        return moved(settings, sliders, slider, number, 1.0 / self.read.sampling.period)

    # Pictures and designs.

    def picture(self, settings: Settings, on_drawn: Callable[[Drawing], None] | None = None) -> Picture:
        """Return the curves and the results for the settings.

        `on_drawn` is called with what is drawn before it is measured, which takes as long again. Requirements are
        those of `check`.
        """
        begun = time.perf_counter()
        whole("axis", settings.axis, 1, 3)
        spec, _ = self.loops.design(settings)
        try:
            with np.errstate(all="ignore"):
                curves, notes = self.loops.curves(settings)
                drawing = curves.drawing()
                if settings.overlays:
                    overlays, more = self.loops.overlays(settings, spec)
                    drawing, notes = dataclasses.replace(drawing, overlays=overlays), (*notes, *more)
                if on_drawn is not None:
                    on_drawn(drawing)
                measured = curves.measured(drawing.bode)
        except (np.linalg.LinAlgError, FloatingPointError, OverflowError):
            raise DesignError(
                f"{settings.loop}, {settings.design}: the loop cannot be computed in floating point; choose less "
                "extreme values"
            ) from None
        if spec.has_plants and LATER not in [one.reason for one in measured.requirements]:
            self.job_parts.keep(loop_stamp(self.loops, settings, spec), measured.requirements)
        own = {one.name: getattr(drawing, one.name) for one in dataclasses.fields(drawing)}
        measured = dataclasses.replace(measured, notes=(*notes, *measured.notes))
        return Picture(**own, measured=measured, elapsed=time.perf_counter() - begun)

    def budget(self, settings: Settings) -> BudgetState | None:
        """Return the line of sight's budget, None for a job without one; what is not known takes some milliseconds.

        It is as `platform-ctrl budget` computes it once the part "budget" of `job_parts` is measured.
        """
        return None if self.read.budget is None else self.sight.now(settings)

    def influence(self, settings: Settings, before_each: Callable[[], None] = lambda: None) -> OptionEffects:
        """Return the effect of each slider on each requirement, those of the budget behind the loop's.

        `before_each` is called before each slider; what it raises ends the computation.
        """
        sliders = [slider for slider in self.sliders(settings) if not slider.background]
        names = [slider.name for slider in sliders]
        loops = self.loops
        caged = loops.spec(settings.loop).has_plants
        own = (
            _of_caging_loop(loops, settings) if caged else _of_results(lambda now: loops.coupled(now).results, settings)
        )

        def with_slider(slider: Slider, ratios: Ratios) -> FloatArray:
            before_each()
            # A slider at zero is moved by a share of its range.
            step = SHARE * (slider.value or (slider.high - slider.low) / 2.0)
            return ratios(self.moved(settings, slider.name, slider.value + step))

        # No slider moves a value that the linear budget cannot judge.
        judged = {one.name for one in self.sight.quick_results(settings) if one.valid}

        def of_sight(now: Settings) -> list[CheckResult]:
            return [one for one in self.sight.quick_results(now) if one.name in judged]

        with np.errstate(all="ignore"):
            parts = [
                option_effects(names, limits, ratios(settings), [partial(with_slider, one, ratios) for one in sliders])
                for limits, ratios in (own, _of_results(of_sight, settings))
                if limits
            ]
        return OptionEffects(
            options=tuple(names),
            requirements=tuple(name for one in parts for name in one.requirements),
            ratios=np.concatenate([np.zeros(0), *(one.ratios for one in parts)]),
            change=np.concatenate([np.zeros((0, len(names))), *(one.change for one in parts)]),
        )

    # Sliders moved by tuning.

    def tune(
        self, settings: Settings, progress: Progress = lambda line: None, cancelled: IsCancelled = lambda: False
    ) -> Settings:
        """Return the settings with all sliders of the design that are not fixed tuned until its limits are met."""
        spec, design = self.loops.design(settings)
        free = tuple(k.name for k in self.sliders(settings) if k.tunable and not k.fixed)
        if not spec.has_plants:
            raise DesignError(f"{spec.name}, {design.name}: a servo on the platform is not tuned; move its sliders")
        if not free:
            raise DesignError(f"{spec.name}, {design.name}: no slider is free to be tuned; free at least one")
        plants, directions = self.loops.plants_of(settings, spec, design)
        problem = LoopProblem(
            job=self.loops.job(settings),
            spec=spec,
            design=design,
            model=self.loops.plants.model,
            plant_set=self.loops.beside_others(settings, spec, plants),
            directions=directions,
            progress=Local(progress),
        )
        task = partial(tuned_options, problem, self.loops.options.used(settings, spec, design), free)
        found: dict[str, float] = self.loops.background.run(task, progress, cancelled)
        # Six digits: more change no requirement.
        return with_options(settings, {name: float(f"{found[name]:.6g}") for name in free})

    # Saving and simulating.

    def save(self, settings: Settings, path: str | Path, overwrite: bool = False) -> Saved:
        """Write the settings as a job file, and its controllers beside it; comments of the job's own file stay."""
        settings = _rounded(settings, self.loops.options.start)
        options, start = self.loops.options, self.loops.options.start
        closed = self.loops.closed(settings)
        try:
            controllers = [made for made, _ in self.loops.closed_designs(settings, strict=True)]
        except DesignError:
            if not is_unchanged(settings.but(closed=closed), start):
                raise
            controllers = None
        wanted: dict[str, dict[str, dict[str, float]]] = {}
        for spec in self.read.loops:
            for design in spec.designs:
                direct = built_directly(design) and design.name == closed[spec.name]
                if direct or options.touched(settings, spec.name, design.name):
                    wanted.setdefault(spec.name, {})[design.name] = options.used(settings, spec, design)
        return write_job(self._source, Path(path), overwrite, settings.but(closed=closed), start, wanted, controllers)

    def simulate(self, settings: Settings, manoeuvre: str, cancelled: IsCancelled = lambda: False) -> Trajectory:
        """Return one of the job's manoeuvres, simulated on the non-linear plant with the loops as they are set."""
        known_name("manoeuvre", manoeuvre, tuple(one.name for one in self.read.manoeuvres))
        job = self.loops.job(settings)
        task = partial(simulated, job, manoeuvre, tuple(self.loops.controllers(settings)))
        trajectory: Trajectory = self.loops.background.run(task, cancelled=cancelled)
        self.has_simulated = True
        made = next(one for one in job.manoeuvres if one.name == manoeuvre)
        results = run_of(job, made, trajectory).results
        self.job_parts.keep(run_stamp(self.loops, settings, manoeuvre), results)
        return trajectory


def _rounded(settings: Settings, start: Settings) -> Settings:
    """Return the settings with six digits of all options that are not those of the job: more change no requirement."""

    def number(given: float | None, x: float) -> float:
        return x if x == given else float(f"{x:.6g}")

    first = start.options
    return settings.but(
        options={
            loop: {
                design: {name: number(first[loop][design].get(name), x) for name, x in numbers.items()}
                for design, numbers in designs.items()
            }
            for loop, designs in settings.options.items()
        }
    )


Ratios = Callable[[Settings], FloatArray]


def _of_caging_loop(loops: ClosedLoops, settings: Settings) -> tuple[list[str], Ratios]:
    loop, _ = loops.caged(settings)
    requests = [one for one in loop.spec.requests if one.hard and not METRICS[one.kind].of_sight]
    view = deciding(measure(loop.plants, loop.delivered, requests, exact=False), requests)

    def ratios(now: Settings) -> FloatArray:
        moved, _ = loops.caged(now)
        plants = moved.plants.only([k for k in view if k < len(moved.plants.labels)])
        return largest_ratios(measure(plants, moved.delivered, requests, exact=False), requests)

    return [one.name for one in requests], ratios


def _of_results(results: Callable[[Settings], Sequence[CheckResult]], settings: Settings) -> tuple[list[str], Ratios]:
    return [one.name for one in results(settings)], lambda now: np.array([one.ratio for one in results(now)])
