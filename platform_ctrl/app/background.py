"""Tasks that take seconds, in another process: tuning, a design by its method, a simulated run."""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import signal
import threading
import time
import weakref
from collections.abc import Callable, Hashable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.common.progress import Progress
from platform_ctrl.common.values import replaced, value
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job.job import Job

if TYPE_CHECKING:
    from platform_ctrl.design.loop import Design
    from platform_ctrl.design.method import LoopProblem
    from platform_ctrl.simulation.closed_loop import Trajectory

IsCancelled = Callable[[], bool]

# Seconds between looks whether a task was cancelled.
_POLL = 0.1


class TaskCancelled(PlatformCtrlError):
    """The task was cancelled."""


T = TypeVar("T")


class LatestTasks(Generic[T]):
    """Tasks that a thread works off; a newer task takes the place of one of the same key that still waits.

    The thread ends when nothing waits; `working` says whether a task is being done or waits.
    """

    def __init__(self, work: Callable[[list[T]], None]) -> None:
        self._work = work
        self._lock = threading.Lock()
        self._waiting: dict[str, T] = {}
        self.working = False
        self._closed = False

    def add(self, key: str, task: T) -> None:
        """Have a task done; the one of the same key that waits is dropped."""
        with self._lock:
            if self._closed:
                return
            self._waiting.pop(key, None)
            self._waiting[key] = task
            if self.working:
                return
            self.working = True
        threading.Thread(target=self._run, name="page", daemon=True).start()

    def close(self) -> None:
        """Drop what waits; nothing more is taken."""
        with self._lock:
            self._closed = True
            self._waiting.clear()

    def _run(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self.working = False
                    return
                tasks = list(self._waiting.values())
                self._waiting.clear()
            self._work(tasks)


class Background:
    """A process that works on one task at a time, and stays for the next one unless one is cancelled."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: list[tuple[BaseProcess, Connection]] = []
        self._urgent: set[object] = set()
        self._ended = False
        weakref.finalize(self, _end_all, self._running)

    def run(
        self,
        task: Any,
        progress: Progress = lambda line: None,
        cancelled: IsCancelled = lambda: False,
        gives_way: bool = False,
    ) -> Any:
        """Return what ``task.run(progress)`` returns there; `TaskCancelled` where it was cancelled.

        A task that `gives_way` is cancelled as well when another one waits that does not.
        """
        waiting = object()
        if not gives_way:
            self._urgent.add(waiting)
        try:
            while not self._lock.acquire(timeout=_POLL):
                if self._ended or cancelled():
                    raise TaskCancelled("cancelled")
        finally:
            self._urgent.discard(waiting)
        try:
            return self._result(
                task, progress, lambda: self._ended or cancelled() or (gives_way and bool(self._urgent))
            )
        finally:
            self._lock.release()

    def end(self) -> None:
        """End the process; no task is accepted any more."""
        self._ended = True
        with self._lock:  # a task that is running notices at its next poll
            _end_all(self._running)

    def _result(self, task: Any, progress: Progress, stopped: IsCancelled) -> Any:
        if not self._running and not stopped():
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs,), daemon=True)
            process.start()
            theirs.close()
            self._running.append((process, ours))
        done = False
        try:
            if not stopped():
                self._running[0][1].send(task)
            while not stopped():
                if not self._running[0][1].poll(_POLL):
                    continue
                kind, content = self._running[0][1].recv()
                if kind == "progress":
                    progress(content)
                    continue
                done = True
                if kind == "failed":
                    raise content
                return content
            raise TaskCancelled("cancelled")
        except (EOFError, OSError):
            raise DesignError("the process that ran the task died; try again") from None
        finally:
            if not done:
                _end_all(self._running)


def _end_all(running: list[tuple[BaseProcess, Connection]]) -> None:
    while running:
        process, pipe = running.pop()
        pipe.close()
        process.kill()
        process.join()


def _work(pipe: Connection) -> None:
    """Run tasks in the other process until its pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt at the terminal is meant for the server alone
    with contextlib.suppress(EOFError, OSError):
        while True:
            task = pipe.recv()
            try:
                pipe.send(("done", task.run(lambda line: pipe.send(("progress", line)))))
            except PlatformCtrlError as error:
                # The problem that is attached to it may not be picklable.
                pipe.send(("failed", DesignError(str(error)) if isinstance(error, DesignError) else error))


Make = Callable[[Callable[[], bool]], None]
Name = tuple[str, str]  # loop and design

# A request followed by another within this time is not started, s: a slider is still moving.
_PAUSE = 0.6


class DesignQueue:
    """Designs that are requested: of each the newest request is made, one after the other."""

    def __init__(self, pause: float = _PAUSE) -> None:
        self._pause = pause
        self._lock = threading.Lock()
        self._requested: dict[Name, Hashable] = {}
        self._failed: dict[Hashable, str] = {}
        self._listeners: dict[Callable[[], None], None] = {}
        self._tasks: LatestTasks[tuple[Name, Hashable, Make]] = LatestTasks(self._work)

    def request(self, loop: str, design: str, key: Hashable, make: Make) -> str:
        """Request a design and return a line about it; the same request again changes nothing.

        `make` is called in a thread with a function that says whether it was cancelled. A design that failed with
        this key is not made again: its error is raised.
        """
        name = (loop, design)
        # Pages with different settings do not have failures tried again in turns.
        if (name, key) in self._failed:
            raise DesignError(self._failed[name, key])
        with self._lock:
            if self._requested.get(name) != key:
                self._requested[name] = key
                self._tasks.add(str(name), (name, key, make))
        return f"{design}: is being designed; it is shown as soon as it is available"

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` in a thread after each design; return the function that stops it."""
        self._listeners[listener] = None
        return lambda: self._listeners.pop(listener, None)

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
        except Exception as error:
            line = str(error) if isinstance(error, PlatformCtrlError) else f"{name[1]}: could not be designed: {error}"
        with self._lock:
            if not cancelled():
                del self._requested[name]
                if line:
                    self._failed[name, key] = line
            elif line:
                # Listeners are called after the request that took its place: two pages would replace each other's
                # requests in turns otherwise.
                return
        for listener in list(self._listeners):
            listener()


class DesignPending(DesignError):
    """Nothing can be shown before a design is available."""


@value
class Tuning:
    """Tunes the `movable` options of a classical, PI or LQG design until the limits of its loop are met.

    `options` are all that the design uses.
    """

    problem: LoopProblem
    options: dict[str, float]
    movable: tuple[str, ...]

    def run(self, progress: Progress) -> dict[str, float]:
        """Return the tuned options."""
        from platform_ctrl.design.method import TunedMethod, tuned
        from platform_ctrl.design.methods import METHODS
        from platform_ctrl.design.tuning import over_decades

        problem = dataclasses.replace(self.problem, progress=progress)
        method = METHODS[problem.design.method]
        assert isinstance(method, TunedMethod), "the app tunes what is built from its options"
        channel, seen, period = problem.channel, method.seen(problem.plants), problem.plants.period
        together = [name for name in method.rates if name in self.movable]
        return tuned(
            problem,
            self.options,
            self.movable,
            lambda trial: method.controller(trial, channel, seen),
            upper=method.upper_bounds(period),
            starts=over_decades(self.options, together, period),
        )


@value
class Designing:
    """Designs a loop by its method; `job` has the plant, sampling and options of the settings."""

    job: Job
    loop: str
    design: str

    def run(self, progress: Progress) -> Design:
        """Return the controller u = K y, with its completed options and what the method claims."""
        from platform_ctrl.design.jobs import loops

        spec = self.job.loop(self.loop)
        design = next(one for one in spec.designs if one.name == self.design)
        alone = [dataclasses.replace(spec, designs=(design,), use=design.name)]
        if spec.around is not None:
            inner = self.job.loop(spec.around)
            alone.insert(0, dataclasses.replace(inner, designs=(inner.closed,)))
        outcomes = loops(dataclasses.replace(self.job, loops=tuple(alone)), progress)
        closed = next(one.closed for one in outcomes if one.spec.name == spec.name)
        bare = {"plants": None, "measures": None, "results": (), "goals": (), "sections": (), "directions": None}
        return replaced(closed, {"controller": closed.own_controller, **bare})


@value
class Simulating:
    """Simulates a manoeuvre on the non-linear plant, with a controller for every loop in the job's order."""

    job: Job
    manoeuvre: str
    controllers: tuple[StateSpace, ...]

    def run(self, progress: Progress) -> Trajectory:
        """Return the run."""
        from platform_ctrl.verification.simulated import simulate_manoeuvre

        manoeuvre = next(one for one in self.job.manoeuvres if one.name == self.manoeuvre)
        return simulate_manoeuvre(self.job, manoeuvre, self.controllers).trajectory
