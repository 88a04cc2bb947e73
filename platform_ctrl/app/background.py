"""Tasks that take seconds, in another process: tuning, a design by its method, a simulated run."""

from __future__ import annotations

import dataclasses
import queue
import threading
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.common.processes import POLL, ProcessTimeout, Started, TaskProcess, next_result, send_early
from platform_ctrl.common.progress import Progress
from platform_ctrl.common.values import value
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job.job import DesignSpec, Job, LoopSpec

if TYPE_CHECKING:
    import control

    from platform_ctrl.analysis.plant_set import PlantSet
    from platform_ctrl.design.partition import Channels
    from platform_ctrl.simulation.closed_loop import Trajectory

IsCancelled = Callable[[], bool]

# Tasks at a time, each in a process of its own; others wait.
_SIMULTANEOUS = threading.BoundedSemaphore(2)


class TaskCancelled(PlatformCtrlError):
    """The task was cancelled."""


class TaskRunner:
    """Runs tasks one at a time in another process, which stays for the next task unless one is cancelled."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._results: queue.SimpleQueue[tuple[TaskProcess, Any]] = queue.SimpleQueue()
        self._running: list[TaskProcess] = []
        self._ended = False
        weakref.finalize(self, _end_all, self._running)

    @property
    def started(self) -> bool:
        """Whether the process was started already."""
        return bool(self._running)

    def run(self, task: Any, progress: Progress, cancelled: IsCancelled) -> Any:
        """Return what ``task.run(progress)`` returns there; a task that is cancelled ends the process."""

        def stopped() -> bool:
            return self._ended or cancelled()

        _acquire(self._lock, stopped)
        try:
            return self._result(task, progress, stopped)
        except _ProcessLost:
            raise DesignError("the process that ran the task died; try again") from None
        finally:
            self._lock.release()

    def end(self) -> None:
        """End the process; no task is accepted any more."""
        self._ended = True
        with self._lock:  # a task that is running notices at its next poll
            _end_all(self._running)

    def _result(self, task: Any, progress: Progress, stopped: IsCancelled) -> Any:
        if not self._running:
            self._results = queue.SimpleQueue()
            self._running.append(TaskProcess(_run_task, results=self._results))
        done = False
        try:
            self._running[0].send(task)
            while not stopped():
                try:
                    _, result = next_result(self._results, POLL)
                except ProcessTimeout:
                    continue
                if result is None:
                    raise _ProcessLost
                if isinstance(result, Started):
                    continue
                kind, content = result
                if kind == "progress":
                    progress(content)
                    continue
                done = True
                if kind == "failed":
                    raise content
                return content
            raise TaskCancelled("cancelled")
        finally:
            if not done:
                _end_all(self._running)


class _ProcessLost(Exception):
    """The process ended before its task."""


def run_alone(task: Any, progress: Progress, cancelled: IsCancelled) -> Any:
    """Return the result of a task in a process of its own, which ends with it."""
    _acquire(_SIMULTANEOUS, cancelled)
    runner = TaskRunner()
    try:
        return runner.run(task, progress, cancelled)
    finally:
        _SIMULTANEOUS.release()
        runner.end()


def _acquire(lock: Any, cancelled: IsCancelled) -> None:
    while not lock.acquire(timeout=POLL):
        if cancelled():
            raise TaskCancelled("cancelled")


def _end_all(processes: list[TaskProcess]) -> None:
    while processes:
        processes.pop().end()


def _run_task(task: Any) -> tuple[str, Any]:
    """Run a task in the other process, and return its result or its error."""
    try:
        return "done", task.run(lambda line: send_early(("progress", line)))
    except PlatformCtrlError as error:
        # The problem that is attached to it may not be picklable.
        return "failed", DesignError(str(error)) if isinstance(error, DesignError) else error


def _specs(job: Job, loop: str, design: str) -> tuple[LoopSpec, DesignSpec]:
    spec = next(one for one in job.loops if one.name == loop)
    return spec, next(one for one in spec.designs if one.name == design)


@value
class Tuning:
    """Tunes the `movable` options of a classical, PI or LQG design until the limits of its loop are met.

    `plants` and `directions` are those of the settings, `options` all that the design uses.
    """

    spec: LoopSpec
    design: DesignSpec
    plants: PlantSet
    directions: Channels
    options: dict[str, float]
    movable: tuple[str, ...]

    def run(self, progress: Progress) -> dict[str, float]:
        """Return the tuned options."""
        from platform_ctrl.app.controllers import direct_arrays
        from platform_ctrl.design.classical import caging, rate
        from platform_ctrl.design.loop import shaped
        from platform_ctrl.design.lqg import read_by_sensors
        from platform_ctrl.design.tuning import over_decades, rates, tune
        from platform_ctrl.job.requirements import loop_requirements

        plants, channel, design = self.plants, self.directions, self.design

        def controller(trial: dict[str, float]) -> StateArrays:
            if design.method == "lqg":
                K = read_by_sensors(trial, channel, plants)
            else:
                K = direct_arrays(design.method, trial, channel, plants.period)
            if design.command is None:
                return K
            return shaped(K, design.command, channel, np.eye(len(K.B.T)) if channel.sense is None else channel.sense)

        return tune(
            self.options,
            self.movable,
            controller,
            plants,
            loop_requirements(self.spec.limits),
            upper={"pi": rate.upper_bounds, "classical": caging.upper_bounds}.get(design.method, _unbounded)(
                plants.period
            ),
            starts=over_decades(
                self.options, [name for name in rates(design.method) if name in self.movable], plants.period
            ),
            progress=lambda _, limiting: progress(limiting),
        )


def _unbounded(period: float) -> dict[str, float]:
    return {}


# A search ends as soon as every requirement is this share of its limit or less.
_ENOUGH = 0.95


@value
class ServoTuning:
    """Tunes the `movable` options of a platform servo until the coupled limits are met, with `caging` closed."""

    job: Job
    loop: str
    design: str
    movable: tuple[str, ...]
    options: dict[str, float]
    caging: tuple[control.StateSpace, ...]

    def run(self, progress: Progress) -> dict[str, float]:
        """Return the tuned options: a simplex search over their logarithms, as `design.tuning.tune` does it."""
        from scipy.optimize import minimize

        worst = self.worst_ratio()
        best = np.inf
        start = np.log([self.options[name] for name in self.movable])

        def numbers(x: Any) -> dict[str, float]:
            factors = np.exp(np.asarray(x) - start)
            return self.options | {n: self.options[n] * float(f) for n, f in zip(self.movable, factors, strict=True)}

        def ratio(x: Any) -> float:
            nonlocal best
            found, limiting = worst(numbers(x))
            if found < best:
                best = found
                progress(limiting)
            return found

        def stop_when_met(intermediate_result: Any) -> None:
            if intermediate_result.fun <= _ENOUGH:
                raise StopIteration

        if ratio(start) <= _ENOUGH:
            return dict(self.options)
        options = {"maxfev": 60 * len(start), "adaptive": True, "xatol": 2e-3, "fatol": 2e-4}
        found = minimize(ratio, start, method="Nelder-Mead", callback=stop_when_met, options=options)
        return numbers(found.x)

    def worst_ratio(self) -> Callable[[dict[str, float]], tuple[float, str]]:
        """Return the function from options to the largest ratio of the coupled limits, and what limits it.

        The ratio is beyond 10 where the loop is unstable.
        """
        from platform_ctrl.app.free_plants import StabilisedLoop, corners, free_models, free_plants
        from platform_ctrl.app.stabilised import requirements
        from platform_ctrl.design.loop import LoopProblem, designed
        from platform_ctrl.design.tuning import limited_by
        from platform_ctrl.mechanics.linearisation import linearise
        from platform_ctrl.verification.coupled import sensed_rates

        spec, design = _specs(self.job, self.loop, self.design)
        model = linearise(self.job.platform)
        models = free_models(self.job, corners(self.job)[:1], sensed_rates(self.job, self.caging))
        plants = free_plants(models, self.job.sampling, False)
        margins: dict[str, dict[str, float]] = {}

        def cached(name: str, compute: Callable[[], dict[str, float]]) -> dict[str, float]:
            if name not in margins:
                margins[name] = compute()
            return margins[name]

        def worst(options: dict[str, float]) -> tuple[float, str]:
            try:
                trial = dataclasses.replace(design, options=options)
                servo = designed(LoopProblem(job=self.job, spec=spec, design=trial, model=model))
            except PlatformCtrlError as error:
                return 100.0, str(error)
            loop = StabilisedLoop(
                job=self.job,
                model=model,
                spec=spec,
                controllers=(*self.caging, servo.controller),
                plants=plants,
                shown=plants,
            )
            results = requirements(loop, cached)
            stable = results[0]
            if not stable.value > 0.0:
                return 10.0 + min(-stable.value, 1e6), f"unstable: it grows at {-stable.value:.3g} 1/s"
            ratios = [one.ratio for one in results]
            # Where one is infinite the others still tell which direction is better.
            worst_finite = max((x for x in ratios if x < float("inf")), default=0.0)
            return min(max(ratios), 10.0 + min(worst_finite, 1.0)), limited_by(results)

        return worst


@value
class Made:
    """A controller u = K y that a method has designed, with its completed options and what the method claims."""

    controller: StateArrays
    options: dict[str, float]
    claims: dict[str, float]


@value
class Designing:
    """Designs a loop by its method; `job` has the plant, sampling and options of the settings."""

    job: Job
    loop: str
    design: str

    def run(self, progress: Progress) -> Made:
        """Return the controller."""
        from platform_ctrl.design.jobs import loops

        spec, design = _specs(self.job, self.loop, self.design)
        alone = [dataclasses.replace(spec, designs=(design,), use=design.name)]
        if spec.around is not None:
            inner = next(one for one in self.job.loops if one.name == spec.around)
            alone.insert(0, dataclasses.replace(inner, designs=(inner.closed,)))
        outcomes = loops(dataclasses.replace(self.job, loops=tuple(alone)), progress)
        closed = next(one.closed for one in outcomes if one.spec.name == spec.name)
        controller = state_arrays(closed.own_controller, closed.name)
        return Made(controller=controller, options=dict(closed.options), claims=dict(closed.claims))


@value
class Simulating:
    """Simulates a manoeuvre on the non-linear plant, with a controller for every loop in the job's order."""

    job: Job
    manoeuvre: str
    controllers: tuple[control.StateSpace, ...]

    def run(self, progress: Progress) -> Trajectory:
        """Return the run."""
        from platform_ctrl.verification.simulated import simulate_manoeuvre

        manoeuvre = next(one for one in self.job.manoeuvres if one.name == self.manoeuvre)
        return simulate_manoeuvre(self.job, manoeuvre, self.controllers).trajectory
