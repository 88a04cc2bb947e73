"""Designs that their methods make, beside those that knobs build: which are there, and which are being made."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from platform_ctrl.arguments import known_name
from platform_ctrl.designer import background
from platform_ctrl.designer.caged import CagedLoop, caged_overlay
from platform_ctrl.designer.closing import Closing
from platform_ctrl.designer.design_options import live
from platform_ctrl.designer.drafting import Drafting
from platform_ctrl.designer.pictures import Overlay
from platform_ctrl.designer.stabilised import stabilised_overlay
from platform_ctrl.designer.tasks import Designing
from platform_ctrl.designer.values import Settings
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.job import DesignSpec, LoopSpec


def never() -> bool:
    """Say no: nobody cancels."""
    return False


def silent(line: str) -> None:
    """Hear a line and tell nobody."""
    del line


class Awaited(DesignError):
    """Nothing can be shown before a design is there that is being made."""


class Designs:
    """The designs of a job's caging loops; safe in several threads.

    Parameters
    ----------
    closing
        The loops.
    """

    def __init__(self, closing: Closing) -> None:
        self._closing = closing
        self._drafting = Drafting()

    def end(self) -> None:
        """Give up what is being made."""
        self._drafting.end()

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have `listener` called in a thread after each design that pictures wait for, and return what ends that."""
        return self._drafting.listen(listener)

    def there(self, settings: Settings, design: str | None = None) -> bool:
        """Return whether a design, or the one that is worked on, is there for just these settings."""
        spec = self._closing.spec(settings.loop)
        return self._closing.there(settings, spec, settings.design if design is None else design)

    def make(
        self,
        settings: Settings,
        design: str | None,
        progress: background.Progress = silent,
        cancelled: background.Cancelled = never,
    ) -> Settings:
        """Have a design made in a process of its own, unless it is there, and return the settings that show it.

        Raises
        ------
        Abandoned
            It was cancelled.
        DesignError
            The method found no controller.
        """
        closing = self._closing
        spec, own = closing.design(settings if design is None else settings.but(design=design))
        if not self.there(settings, own.name):
            question = Designing(job=closing.job(settings), loop=spec.name, design=own.name)
            made = background.worked_out(question, progress, cancelled)
            closing.store.put(spec.name, own.name, closing.conditions(settings, spec, own), made)
        return closing.following(settings, spec, own)

    def caged(self, settings: Settings, again: bool = True) -> tuple[CagedLoop, tuple[str, ...]]:
        """Return the loop with its controller; one that a method has to make is asked for, and anew with `again`."""
        closing = self._closing
        spec, design = closing.design(settings)
        if live(design):
            return closing.caged(settings)
        conditions, seen = closing.wanted(settings, spec, design), closing.seen(settings, spec, design)
        if seen == conditions:
            return closing.caged(settings)

        def wanted() -> str:
            def make(unwanted: background.Cancelled) -> None:
                self.make(closing.at(settings, spec, design, conditions), None, cancelled=unwanted)

            return self._drafting.want(spec.name, design.name, conditions, make)

        if seen is None:
            line = f"{spec.name}, {wanted()}"
            raise Awaited(line) if self._drafting.wants(spec.name, design.name) else DesignError(line)
        loop, told = closing.caged(settings)
        return (loop, (wanted(),)) if again else (loop, told)

    def overlays(
        self, settings: Settings, spec: LoopSpec, frequency: FloatArray
    ) -> tuple[tuple[Overlay, ...], tuple[str, ...]]:
        """Return what lies over a picture, and lines about what does not, or is not quite up to date."""
        out, notes = [], []
        for name in dict.fromkeys(settings.overlays):
            if name == settings.design or name not in {d.name for d in spec.designs}:
                continue
            try:
                found, note = self.overlay(settings, spec, name, frequency)
            except PlatformCtrlError as error:
                notes.append(str(error))
                continue
            out.append(found)
            notes += [note] if note else []
        return tuple(out), tuple(notes)

    def overlay(
        self, settings: Settings, spec: LoopSpec, name: str, frequency: FloatArray, measured: bool = False
    ) -> tuple[Overlay, str]:
        """Return one design of the loop as an overlay at `frequency` (F,), rad/s, and a line about it.

        What all other loops are set to stays. Its limits are empty unless they are to be `measured`.

        Raises
        ------
        DesignError
            It is not designed yet.
        """
        other: DesignSpec = spec.designs[known_name("design", name, tuple(d.name for d in spec.designs))]
        own = settings.but(design=name)
        with np.errstate(all="ignore"):
            if spec.kind != "caging":
                # Lines about the other loops are those of the picture below it.
                free, _ = self._closing.stabilised(own)
                kept = self._closing.kept(own) if measured else None
                return stabilised_overlay(free, own, other.method, frequency, kept), ""
            loop, told = self.caged(own, again=False)
            return caged_overlay(loop, own, other.method, frequency, measured), " ".join(told)
