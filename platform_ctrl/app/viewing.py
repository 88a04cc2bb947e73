"""Settings in, pictures out: what is drawn and measured of them, and the designs that this waits for."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.app.caged import caged_parts
from platform_ctrl.app.designs import Designs, never, silent
from platform_ctrl.app.influence import caged_influence, moved_slider, stabilised_influence
from platform_ctrl.app.parts import Measured, Parts
from platform_ctrl.app.pictures import Drawing, Drawn, Influence, Overlay, Picture
from platform_ctrl.app.processes import IsCancelled, Progress
from platform_ctrl.app.settable import Settable
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.app.stabilised import stabilised_parts
from platform_ctrl.common.arguments import known_name, whole
from platform_ctrl.errors import DesignError
from platform_ctrl.job.job import Job


def nothing(drawing: Drawing) -> None:
    """Do nothing with a drawing: nobody waits for it."""


class Viewing(Settable):
    """The pictures of a job's settings; see `Backend`.

    Parameters
    ----------
    job, controllers
        As of `Backend`.
    """

    def __init__(self, job: str | Path | Job, controllers: str | Path | None = None) -> None:
        super().__init__(job, controllers)
        self._designs = Designs(self._loops)

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
        """
        return self._designs.listen(listener)

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
            Requirements are as `check` measures them; the simultaneous margin of all loops together is looked for at
            some frequencies and lies within about a thousandth.
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
        spec, _ = self._loops.design(settings)
        if spec.kind == "caging":
            loop, told = self._designs.caged(settings)
            parts, measure = caged_parts(loop, settings, self._loops.measured(settings, loop))
        else:
            free, told = self._loops.stabilised(settings)
            parts, measure = stabilised_parts(free, settings, self._loops.kept(settings))
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
        """
        spec, _ = self._loops.design(settings)
        known_name("design", design, tuple(d.name for d in spec.designs))
        frequency = self.picture(settings.but(overlays=())).bode.frequency
        return self._designs.overlay(settings, spec, design, frequency, measured=True)[0]

    def designed(self, settings: Settings, design: str | None = None) -> bool:
        """Return whether a design of the loop is there for just these settings; those that sliders build always are.

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
        """
        return self._designs.there(settings, design)

    def redesigned(
        self,
        settings: Settings,
        design: str | None = None,
        progress: Progress = silent,
        cancelled: IsCancelled = never,
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
            They show this design.
        """
        return self._designs.make(settings, design, progress, cancelled)

    def influence(self, settings: Settings) -> Influence:
        """Return what each slider does to each requirement.

        Parameters
        ----------
        settings
            As the page is set.

        Returns
        -------
        Influence
            Of all sliders whose effect is seen at once; of a method that designs, those of the plant alone.
        """
        spec, _ = self._loops.design(settings)
        sliders = [slider for slider in self.sliders(settings) if not slider.background]

        def with_slider(slider: Slider) -> Settings:
            return self.moved(settings, slider.name, moved_slider(slider))

        with np.errstate(all="ignore"):
            if spec.kind == "caging":
                loop, _ = self._loops.caged(settings)
                return caged_influence(loop, sliders, lambda slider: self._loops.caged(with_slider(slider))[0])
            return stabilised_influence(self._loops, settings, sliders, with_slider)


def _fields(parts: Drawn | Measured) -> dict[str, Any]:
    return {one.name: getattr(parts, one.name) for one in dataclasses.fields(parts)}
