"""The designer without a page: settings in, pictures out. One backend serves all pages of a job.

What may be set is in `settable`, what is seen of it in `viewing`; here sliders are dragged and tuned, and all of it is
saved and flown.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.app import processes
from platform_ctrl.app.controllers import built_directly
from platform_ctrl.app.designs import never, silent
from platform_ctrl.app.drag_setup import free_parameters, limits_of
from platform_ctrl.app.dragging import NO_LIMITS, dragged_crossover, dragged_pole
from platform_ctrl.app.process_tasks import ServoTuning, Simulating, Tuning
from platform_ctrl.app.processes import IsCancelled, Progress
from platform_ctrl.app.saving import Saved, save
from platform_ctrl.app.settings import Settings
from platform_ctrl.app.sliders import with_options
from platform_ctrl.app.viewing import Viewing
from platform_ctrl.common.arguments import known_name
from platform_ctrl.errors import ArgumentError, DesignError, PlatformCtrlError
from platform_ctrl.job.job import Job

if TYPE_CHECKING:
    from platform_ctrl.simulation import Trajectory


# Digits of a slider's steps, and up to which a number is one that somebody typed, or that tuning found.
_DIGITS, _TYPED = 4, 6
# A crossover that is dragged stays this far, as a factor, inside the diagram.
_INSIDE = 1.1


def unheard(names: tuple[str, ...]) -> None:
    """Do nothing with the names of limits: nobody asks."""


class Backend(Viewing):
    """Everything that a page needs of a job; all of it may be called from several threads.

    Parameters
    ----------
    job
        The job, or the path of its file.
    controllers
        Path of a ``result.json`` whose designs are shown as they are; default: the file that `saved` leaves beside a
        job, where there is one.
    """

    def __init__(self, job: str | Path | Job, controllers: str | Path | None = None) -> None:
        super().__init__(job, controllers)
        self._simulator = processes.PersistentProcess()

    def close(self) -> None:
        """End the designs that are being made, and the process that flies; nobody asks any more."""
        self._designs.end()
        self._simulator.end()

    def drag_pole(
        self,
        settings: Settings,
        pole: complex,
        target: complex,
        *,
        free: bool = False,
        held: Callable[[tuple[str, ...]], None] = unheard,
    ) -> Settings:
        """Return the settings in which a closed-loop pole lies at `target`, or as near as it may be brought.

        Parameters
        ----------
        settings
            As they are.
        pole
            Where it is now, rad/s in the s-plane: the nearest one of the plant shown is meant.
        target
            Where it is wanted, rad/s.
        free
            Whether limits that are met may become missed. Otherwise the pole goes along them; limits that are missed
            already keep it from nothing.
        held
            Called with the names of the limits that keep it from going all the way, where there are any.

        Returns
        -------
        Settings
            With other numbers of the design's sliders that are not fixed.
        """
        if not (np.isfinite(pole) and np.isfinite(target)):
            raise ArgumentError(f"pole: given {pole} to {target}; expected finite numbers, rad/s")
        with np.errstate(all="ignore"):
            parameters, plant, _ = free_parameters(self._loops, settings, self.sliders(settings))
            limits = NO_LIMITS if free else limits_of(self._loops, settings, parameters)
            dragged = dragged_pole(parameters, plant, complex(pole), complex(target), limits)
        if dragged.limited_by:
            held(dragged.limited_by)
        return with_options(settings, dragged.numbers)

    def drag_crossover(
        self,
        settings: Settings,
        frequency: float,
        now: float | None = None,
        *,
        free: bool = False,
        held: Callable[[tuple[str, ...]], None] = unheard,
    ) -> Settings:
        """Return the settings in which the shown channel crosses over at `frequency`, or as near as can be.

        Parameters
        ----------
        settings
            As they are.
        frequency
            Where its gain is to be 1, rad/s.
        now
            The crossover that is dragged, rad/s; None: the highest.
        free, held
            As of `drag_pole`; it stops where a limit would be missed.

        Returns
        -------
        Settings
            With other numbers of the design's sliders that are not fixed.
        """
        if not np.isfinite(frequency):
            raise ArgumentError(f"frequency: given {frequency}; expected a finite number, rad/s")
        if now is None:
            bode = self.picture(settings.but(band=False, overlays=())).bode
            if not len(bode.crossovers):
                raise DesignError(f"{settings.channel}: its gain does not pass 1; expected a loop that crosses over")
            now = float(bode.crossovers[-1])
            # Left of the diagram it could not be taken hold of again.
            frequency = max(float(frequency), min(now, _INSIDE * float(bode.frequency[0])))
        with np.errstate(all="ignore"):
            parameters, plant, channel = free_parameters(self._loops, settings, self.sliders(settings))
            limits = NO_LIMITS if free else limits_of(self._loops, settings, parameters)
            dragged = dragged_crossover(parameters, plant, channel, now, float(frequency), limits)
        if dragged.limited_by:
            held(dragged.limited_by)
        return with_options(settings, dragged.numbers)

    def tuned(self, settings: Settings, progress: Progress = silent, cancelled: IsCancelled = never) -> Settings:
        """Return the settings with all sliders of the design that are not fixed tuned until its limits are met.

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
        """
        spec, design = self._loops.design(settings)
        free = tuple(k.name for k in self.sliders(settings) if k.tunable and not k.fixed)
        if not free:
            raise DesignError(
                f"{spec.name}, {design.name}: no slider is free to be tuned; expected one that is not fixed"
            )
        options = self._loops.options.used(settings, spec, design)
        question: Tuning | ServoTuning
        if spec.kind == "caging":
            question = Tuning(job=self.job(settings), loop=spec.name, options=options, movable=free)
        else:
            others = tuple(one for one in self._loops.saved_controllers(settings) if one.loop != spec.name)
            question = ServoTuning(
                job=self.job(settings),
                loop=spec.name,
                design=design.name,
                movable=free,
                options=options,
                caging=tuple((o.controller, o.inputs, o.outputs, o.loop) for o in others),
            )
        found: dict[str, float] = processes.run_in_process(question, progress, cancelled)
        # Six digits: more would not be read, and no requirement hangs on them.
        return with_options(settings, {name: float(f"{found[name]:.6g}") for name in free})

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
        """
        settings = self._shortened(settings)
        controllers = self._loops.saved_controllers(settings, strict=True)
        options = self._loops.options
        used = {
            spec.name: {d.name: options.used(settings, spec, d) for d in spec.designs if built_directly(d)}
            for spec in self.read.loops
        }
        closed = {**settings.closed, settings.loop: settings.design}
        changed = {
            loop: {
                design: numbers
                for design, numbers in designs.items()
                if design == closed[loop] or options.touched(settings, loop, design)
            }
            for loop, designs in used.items()
        }
        start = self._loops.start
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

    def _shortened(self, settings: Settings) -> Settings:
        """Return the settings with changed numbers that nobody typed cut to the fewest digits of the same verdict."""
        first = self._loops.start.options
        long = {
            (loop, design, name): x
            for loop, designs in settings.options.items()
            for design, numbers in designs.items()
            for name, x in numbers.items()
            if x != first[loop][design].get(name) and x != float(f"{x:.{_TYPED}g}")
        }
        if not long:
            return settings
        seen = list(dict.fromkeys([*(loop for loop, _, _ in long), settings.loop]))
        before = self._verdicts(settings, seen)
        for digits in range(_DIGITS, 17):
            options = {
                loop: {
                    design: {
                        name: float(f"{x:.{digits}g}") if (loop, design, name) in long else x
                        for name, x in numbers.items()
                    }
                    for design, numbers in designs.items()
                }
                for loop, designs in settings.options.items()
            }
            short = settings.but(options=options)
            if self._verdicts(short, seen) == before:
                return short
        return settings

    def _verdicts(self, settings: Settings, seen: Sequence[str]) -> list[object]:
        """Return which requirements of some loops are met; an error counts as a verdict."""
        out: list[object] = []
        for loop in seen:
            here = settings if loop == settings.loop else self.chosen(settings, loop=loop)
            try:
                picture = self.picture(here.but(overlays=(), band=True))
            except PlatformCtrlError as error:
                out.append(type(error))
            else:
                out.append([(one.subject, one.name, one.passed) for one in picture.requirements])
        return out

    @property
    def flown(self) -> bool:
        """Whether a manoeuvre has been flown already: the first takes longer, until its equations are compiled."""
        return self._simulator.there

    def run(self, settings: Settings, manoeuvre: str, cancelled: IsCancelled = never) -> Trajectory:
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
            As `simulation.simulate` returns it.
        """
        known_name("manoeuvre", manoeuvre, tuple(one.name for one in self.read.manoeuvres))
        saved = self._loops.saved_controllers(settings)
        question = Simulating(
            job=self.job(settings),
            manoeuvre=manoeuvre,
            controllers=tuple((o.controller, o.inputs, o.outputs, f"{o.loop}, {o.design}") for o in saved),
        )
        flown: Trajectory = self._simulator.run(question, silent, cancelled)
        return flown
