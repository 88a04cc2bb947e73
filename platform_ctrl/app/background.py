"""Work beside the pages: what is requested, of which the newest wins, and a process for tasks that take seconds."""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import signal
import threading
import weakref
from collections.abc import Callable, Hashable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any

from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.common.progress import Progress
from platform_ctrl.common.values import replaced
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


Work = Callable[[threading.Event], None]


@dataclasses.dataclass(eq=False)
class _Request:
    """Work of a key; it is `over` once a newer request has taken its place, or nobody wants it any more."""

    key: Hashable
    work: Work
    content: Hashable
    urgent: bool
    over: threading.Event = dataclasses.field(default_factory=threading.Event)


class Requests:
    """What is requested, done one after the other in a thread that ends when nothing waits.

    The newest request of a key wins: one that waits is dropped, one that is being done is told that it is over. What is
    `urgent` goes first, and interrupts other work, which is done again afterwards.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.Lock()
        # With the one that is being done.
        self._all: list[_Request] = []
        self._now: _Request | None = None
        self._ended = False

    def add(self, key: Hashable, work: Work, *, content: Hashable = None, urgent: bool = False) -> threading.Event:
        """Have `work` done, which is called with the event that it is over, and return that event.

        A request with the same `content` as the newest one of its key changes nothing.
        """
        new = _Request(key=key, work=work, content=content, urgent=urgent)
        with self._lock:
            for one in self._all:
                if content is not None and (one.key, one.content) == (key, content) and not one.over.is_set():
                    return one.over
            self._drop(key)
            if self._ended:
                new.over.set()
                return new.over
            now = self._now
            if now is not None and urgent and not (now.urgent or now.over.is_set()):
                now.over.set()
                self._all.append(dataclasses.replace(now, over=threading.Event()))
            self._all.append(new)
            if now is None:
                self._now = new
                threading.Thread(target=self._run, name=self._name, args=(new,), daemon=True).start()
        return new.over

    def cancel(self, key: Hashable) -> None:
        """Drop the request of a key, or tell it that it is over."""
        with self._lock:
            self._drop(key)

    def end(self) -> None:
        """Cancel everything; nothing more is taken."""
        with self._lock:
            self._ended = True
            for one in list(self._all):
                self._drop(one.key)

    def _drop(self, key: Hashable) -> None:
        for one in self._all:
            if one.key == key:
                one.over.set()
        self._all = [one for one in self._all if one is self._now or not one.over.is_set()]

    def _run(self, request: _Request | None) -> None:
        while request is not None:
            with contextlib.suppress(TaskCancelled):
                request.work(request.over)
            with self._lock:
                self._all.remove(request)
                # The first that is urgent, else the first.
                self._now = request = min(self._all, key=lambda one: not one.urgent, default=None)


class Background:
    """A process that works on one task at a time, and stays for the next one unless one is cancelled."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: list[tuple[BaseProcess, Connection]] = []
        self._ended = False
        weakref.finalize(self, _end_all, self._running)

    def run(self, task: Any, progress: Progress = lambda line: None, cancelled: IsCancelled = lambda: False) -> Any:
        """Return what ``task(progress)`` returns there; `TaskCancelled` where it was cancelled."""
        with self._lock:
            return self._result(task, progress, lambda: self._ended or cancelled())

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
                pipe.send(("done", task(lambda line: pipe.send(("progress", line)))))
            except PlatformCtrlError as error:
                # The problem that is attached to it may not be picklable.
                pipe.send(("failed", DesignError(str(error)) if isinstance(error, DesignError) else error))


class DesignPending(DesignError):
    """Nothing can be shown before a design is available."""


def tuned_options(
    problem: LoopProblem, options: dict[str, float], movable: tuple[str, ...], progress: Progress
) -> dict[str, float]:
    """Return the `movable` options of a classical, PI or LQG design, tuned until the limits of its loop are met.

    `options` are all that the design uses.
    """
    from platform_ctrl.design.method import TunedMethod, tuned
    from platform_ctrl.design.methods import METHODS
    from platform_ctrl.design.tuning import over_decades

    problem = dataclasses.replace(problem, progress=progress)
    method = METHODS[problem.design.method]
    assert isinstance(method, TunedMethod), "the app tunes what is built from its options"
    channel, seen, period = problem.channel, problem.plants.regular(), problem.plants.period
    together = [name for name in method.rates if name in movable]
    return tuned(
        problem,
        options,
        movable,
        lambda trial: method.controller(trial, channel, seen),
        upper=method.upper_bounds(period),
        starts=over_decades(options, together, period),
    )


def made_design(job: Job, loop: str, name: str, progress: Progress) -> Design:
    """Return a design of a loop by its method, u = K y; `job` has the plant, sampling and options of the settings."""
    from platform_ctrl.design.jobs import loops
    from platform_ctrl.design.tuning import of_sight

    spec = job.loop(loop)
    design = next(one for one in spec.designs if one.name == name)
    # With the loops on which it depends.
    needed = {spec.around, *(one.name for one in job.loops if of_sight(spec.requests))}
    alone = [
        dataclasses.replace(spec, designs=(design,), use=name)
        if one.name == loop
        else dataclasses.replace(one, designs=(one.closed,))
        for one in job.loops
        if one.name in (*needed, loop)
    ]
    outcomes = loops(dataclasses.replace(job, loops=tuple(alone)), progress)
    closed = next(one.closed for one in outcomes if one.spec.name == loop)
    bare = {"plants": None, "measures": None, "results": (), "goals": (), "sections": (), "directions": None}
    return replaced(closed, {"controller": closed.own_controller, **bare})


def simulated(job: Job, manoeuvre: str, controllers: tuple[StateSpace, ...], progress: Progress) -> Trajectory:
    """Return a manoeuvre on the non-linear plant, with a controller for every loop in the job's order."""
    from platform_ctrl.verification.simulated import simulate_manoeuvre

    made = next(one for one in job.manoeuvres if one.name == manoeuvre)
    return simulate_manoeuvre(job, made, controllers).trajectory
