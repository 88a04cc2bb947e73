"""Designs that their methods make: which are available, and which are being made."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Hashable
from functools import partial

import numpy as np

from platform_ctrl.app.background import Background, Designing, IsCancelled, LatestTasks, TaskCancelled
from platform_ctrl.app.caged import CagedCurves, CagedLoop
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.pictures import Overlay
from platform_ctrl.app.plants import Bounded
from platform_ctrl.app.settings import Settings
from platform_ctrl.app.stabilised import StabilisedCurves
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job.job import DesignSpec, LoopSpec

Make = Callable[[Callable[[], bool]], None]
Name = tuple[str, str]  # loop and design

# A request followed by another within this time is not started, s: a slider is still moving.
_PAUSE = 0.6
# Failures that are kept, so that pages with different settings do not have them tried again in turns.
_FAILURES = 64


class DesignQueue:
    """Designs that are requested: of each the newest request is made, one after the other."""

    def __init__(self, pause: float = _PAUSE) -> None:
        self._pause = pause
        self._lock = threading.Lock()
        self._requested: dict[Name, Hashable] = {}
        self._failed: Bounded[str] = Bounded(_FAILURES)
        self._listeners: list[Callable[[], None]] = []
        self._tasks: LatestTasks[tuple[Name, Hashable, Make]] = LatestTasks(self._work)

    def request(self, loop: str, design: str, key: Hashable, make: Make) -> str:
        """Request a design and return a line about it; the same request again changes nothing.

        `make` is called in a thread with a function that says whether it was cancelled. A design that failed with
        this key is not made again: its error is raised.
        """
        name = (loop, design)
        failed = self._failed.found((name, key))
        if failed is not None:
            raise DesignError(failed)
        with self._lock:
            if self._requested.get(name) != key:
                self._requested[name] = key
                self._tasks.add(str(name), (name, key, make))
        return f"{design}: is being designed; it is shown as soon as it is available"

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` in a thread after each design; return the function that stops it."""
        self._listeners.append(listener)

        def end() -> None:
            with contextlib.suppress(ValueError):
                self._listeners.remove(listener)

        return end

    def end(self) -> None:
        """Cancel all requests."""
        self._tasks.close()
        self._requested.clear()

    def _work(self, tasks: list[tuple[Name, Hashable, Make]]) -> None:
        for name, key, make in tasks:
            if self._requested.get(name) == key:
                time.sleep(self._pause)
            if self._requested.get(name) == key:
                self._make(name, key, make)

    def _make(self, name: Name, key: Hashable, make: Make) -> None:
        def cancelled() -> bool:
            return self._requested.get(name) != key

        line = ""
        try:
            make(cancelled)
        except TaskCancelled:
            if not cancelled():  # it gave way
                self._tasks.add(str(name), (name, key, make))
                return
            line = "cancelled"
        except PlatformCtrlError as error:
            line = str(error)
        except Exception as error:
            line = f"{name[1]}: could not be designed: {error}"
        with self._lock:
            if not cancelled():
                del self._requested[name]
                if line:
                    self._failed.put((name, key), line)
            elif line:
                # Listeners are called after the request that took its place: two pages would replace each other's
                # requests in turns otherwise.
                return
        for listener in list(self._listeners):
            listener()


class DesignPending(DesignError):
    """Nothing can be shown before a design is available."""


class Designs:
    """The designs of a job's caging loops; safe in several threads."""

    def __init__(self, loops: ClosedLoops, background: Background) -> None:
        self._loops, self._background = loops, background
        self.queue = DesignQueue()

    def make(self, settings: Settings, spec: LoopSpec, design: DesignSpec, cancelled: IsCancelled) -> None:
        """Make a design in another process, unless it is available; what a page waits for goes first."""
        loops = self._loops
        if loops.found(settings, spec.name, design.name) is None:
            task = Designing(job=loops.job(settings), loop=spec.name, design=design.name)
            key = loops.design_key(settings, spec.name, design.name)
            loops.keep(key, self._background.run(task, cancelled=cancelled, gives_way=True))

    def caged(self, settings: Settings) -> tuple[CagedLoop, tuple[str, ...]]:
        """Return the loop with its controller; one that a method has to make is requested, and is pending then."""
        loops = self._loops
        spec, design = loops.design(settings)
        if not loops.is_available(settings, spec, design.name):
            key = loops.design_key(settings, spec.name, design.name)
            line = self.queue.request(spec.name, design.name, key, partial(self.make, settings, spec, design))
            raise DesignPending(f"{spec.name}, {line}")  # the error of a method has the loop's name
        return loops.caged(settings)

    def overlays(
        self, settings: Settings, spec: LoopSpec, frequency: FloatArray
    ) -> tuple[tuple[Overlay, ...], tuple[str, ...]]:
        """Return the overlays of a picture, and lines about those that are missing or not up to date."""
        out, notes = [], []
        for name in dict.fromkeys(settings.overlays):
            if name == settings.design or name not in {d.name for d in spec.designs}:
                continue
            try:
                found, note = self._overlay(settings, spec, name, frequency)
            except PlatformCtrlError as error:
                notes.append(str(error))
                continue
            out.append(found)
            notes += [note] if note else []
        return tuple(out), tuple(notes)

    def _overlay(self, settings: Settings, spec: LoopSpec, name: str, frequency: FloatArray) -> tuple[Overlay, str]:
        """Return one design of the loop as an overlay, and a line about it; all other loops stay as they are."""
        own = settings.but(design=name)
        with np.errstate(all="ignore"):
            if not spec.has_plants:
                # The picture below it has the lines about the other loops.
                free, _ = self._loops.stabilised(own)
                return StabilisedCurves(free, own).overlay(name, frequency), ""
            loop, notes = self.caged(own)
            return CagedCurves(loop, own).overlay(name, frequency), " ".join(notes)
