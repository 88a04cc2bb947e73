"""The loops of a job: every design of every loop, made by its method and certified.

Designs are made side by side in processes: one that fails, or whose process is killed, says so. Those of an earlier
command in the same folder are taken over where nothing that they depend on has changed. Only controllers with their
options and claims are kept, the newest of each design of the job; what is said about their loops is computed again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import pickle
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, as_completed
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl import __version__
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import System
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.processes import processes as pool
from platform_ctrl.common.progress import Local, Progress, shown
from platform_ctrl.common.values import replaced
from platform_ctrl.design.feedforward import design_plants
from platform_ctrl.design.loop import Design, FailedDesign, LoopOutcome, commanded, with_commands, with_largest_rates
from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.method import METHODS, LoopProblem, evaluated, instability
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.plants import plants_of, tracking_plants
from platform_ctrl.design.sight import beside
from platform_ctrl.design.tuning import of_sight
from platform_ctrl.errors import DesignError, InputError, began_with_interrupt
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.job.reading import data_hash
from platform_ctrl.mechanics.linearisation import LinearModel, linearise

# Of designs that are kept, and what they are computed with.
FILE = "designs.json"
_PACKAGES = ("numpy", "scipy", "cvxpy", "clarabel", "control")

Kept = dict[str, Any]

Made = Design | Exception

# A process that is forked has all that is loaded and known here; elsewhere it would have to load it for seconds.
_FORKS = sys.platform == "linux"
_given: Sequence[LoopProblem] = ()


def loops(
    job: Job | str | os.PathLike[str] | Mapping[str, object], progress: Progress | bool | None = None
) -> tuple[LoopOutcome, ...]:
    """Design every loop of `job` by each of its methods.

    Parameters
    ----------
    job
        The job, or what `read_job` reads: a path or a dict.
    progress
        Called with a line before and during each design; True shows the lines, in a notebook or on a terminal.

    Returns
    -------
    tuple of LoopOutcome
        In the job's order, but a tracking loop before the rate loop that it commands. A design that is not the one that
        its loop uses may fail: `failed` says why.

    Raises
    ------
    InputError
        The job makes no sense, or a loop's gimbals cut through a subsystem.
    DesignError
        A method found no controller for the design that a loop uses, or its closed loop is unstable.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).
    """
    found = attempted_loops(job, progress)
    for outcome in found:
        if outcome.failure is not None:
            raise outcome.failure.error
    return found


def attempted_loops(
    job: Job | str | os.PathLike[str] | Mapping[str, object],
    progress: Progress | bool | None = None,
    processes: int = 1,
    folder: Path | None = None,
) -> tuple[LoopOutcome, ...]:
    """Return the outcomes of `loops` even if designs that loops use have failed; then a loop may have no design at all.

    Designs are made side by side in up to so many processes. Those that are kept in `folder` and have not changed are
    taken over; the folder then keeps these.
    """
    job = job if isinstance(job, Job) else read_job(job)
    model = linearise(job.platform)
    # All plants before the first design: an error in the third loop is raised before the work on the first.
    plants_of_all = {spec.name: plants_of_designs(job, spec) for spec in job.loops}
    sighted = [spec for spec in job.loops if len(job.loops) > 1 and of_sight(spec.requests)]
    # The first of them is made with the others as they are without their limits of the line of sight.
    specs = {spec.name: _without_sight(spec) if spec in sighted else spec for spec in job.loops}
    made, maker = dict[str, LoopOutcome](), _Maker(folder, processes)
    with shown(progress) as say:
        # A tracking loop has the rate loop that it commands in its plants.
        for tracking in (False, True):
            problems: dict[str, list[LoopProblem]] = {}
            for name, spec in specs.items():
                inner = made[str(spec.around)] if tracking and spec.kind == "tracking" else None
                if inner is not None and (lost := inner.failure) is not None:
                    words = f"the design {lost.name!r} of the loop {lost.loop!r}, which it commands, has failed"
                    made[name] = _lost(spec, words)
                elif (spec.kind == "tracking") is tracking and spec.name not in [one.name for one in sighted[:1]]:
                    around = None if inner is None else inner.closed
                    problems[name] = problems_of(job, spec, model, plants_of_all[name], around, say)
            found = iter(maker.made([one for own in problems.values() for one in own], say))
            for name, own in problems.items():
                made[name] = _outcome(specs[name], [(problem.design, next(found)) for problem in own])

        def beside_others(spec: LoopSpec) -> list[LoopProblem]:
            controllers = {name: one.closed.controller for name, one in made.items() if name != spec.name}
            own = [one and beside(one, controllers) for one in plants_of_all[spec.name]]
            return problems_of(job, spec, model, own, None, say)

        if sighted:
            _limit_sight(sighted, made, beside_others, lambda problems: maker.made(problems, say))
    if folder is not None:
        keep(folder, maker.newest.items())
    return in_order(job, [made[spec.name] for spec in job.loops])


def _limit_sight(
    sighted: Sequence[LoopSpec],
    made: dict[str, LoopOutcome],
    problems_beside: Callable[[LoopSpec], list[LoopProblem]],
    make: Callable[[Sequence[LoopProblem]], list[Made]],
) -> None:
    """Make loops with limits of the line of sight, each beside the others as they are by then.

    They take the places of those in `made` without these limits. Those that do not keep their limits beside the last
    ones are made again.
    """
    for spec in sighted:
        others = [one.failure for name, one in made.items() if name != spec.name]
        if (lost := next((one for one in others if one is not None), None)) is not None:
            words = f"the design {lost.name!r} of the loop {lost.loop!r}, which moves the line of sight too, has failed"
            made[spec.name] = _lost(spec, words)
        else:
            made[spec.name] = _outcome(spec, list(zip(spec.designs, make(problems_beside(spec)), strict=True)))
    if not all(one.designs for one in made.values()):
        return

    def measure_again() -> None:
        for spec in sighted:
            before: dict[str, Made] = {one.name: one for one in made[spec.name].designs}
            before |= {one.name: one.error for one in made[spec.name].failed if one.name not in before}
            made[spec.name] = _outcome(
                spec, [(one.design, _beside(one, before[one.design.name])) for one in problems_beside(spec)]
            )

    measure_again()
    late = [spec for spec in sighted if len(sighted) > 1 and not made[spec.name].closed.passed]
    for spec in late:
        again = _outcome(spec, list(zip(spec.designs, make(problems_beside(spec)), strict=True)))
        made[spec.name] = again if again.designs else made[spec.name]
    if late:
        measure_again()


def _beside(problem: LoopProblem, made: Made) -> Made:
    """Return what was made of a problem, measured with its plants."""
    if not isinstance(made, Design):
        return made
    return _made(dataclasses.replace(problem, known=dataclasses.replace(made, plants=problem.plant_set)))


class _Maker:
    """What makes designs, or takes over those that a folder has; `newest` are those of the latter with their keys."""

    def __init__(self, folder: Path | None, processes: int) -> None:
        self._kept = None if folder is None else kept_in(folder)
        self._code, self._processes = "" if folder is None else code_hash(), processes
        self.newest: dict[str, Design] = {}

    def made(self, problems: Sequence[LoopProblem], say: Progress) -> list[Made]:
        """Return the design of each problem, or why there is none."""
        every = list(problems)
        keys = [None if self._kept is None else key_of(one, self._code) for one in every]
        for k, key in enumerate(keys):
            kept = None if self._kept is None or key is None else self._kept.get(key)
            if kept is not None and (known := taken_over(every[k], kept)) is not None:
                say(f"{known.loop}: {known.name}, unchanged")
                every[k] = dataclasses.replace(every[k], known=known)
        out = _made_of(every, self._processes, say)
        self.newest |= {key: one for key, one in zip(keys, out, strict=True) if key and isinstance(one, Design)}
        return out


def _without_sight(spec: LoopSpec) -> LoopSpec:
    """Return a loop without limits and goals of the line of sight."""
    keys = {metric.key for metric in METRICS.values() if metric.of_sight}
    limits, soft = ({key: x for key, x in of.items() if key not in keys} for of in (spec.limits, spec.soft))
    return dataclasses.replace(spec, limits=limits, soft=soft)


def _lost(spec: LoopSpec, words: str) -> LoopOutcome:
    """Return the outcome of a loop of which no design can be made."""
    return _outcome(spec, [(one, DesignError(f"{spec.name}, {one.name}: {words}")) for one in spec.designs])


def _outcome(spec: LoopSpec, found: Sequence[tuple[DesignSpec, Made]]) -> LoopOutcome:
    """Return the outcome of a loop from the results of its designs."""
    designs = tuple(one for _, one in found if isinstance(one, Design))
    errors = [(design, instability(one, design.tune) if isinstance(one, Design) else one) for design, one in found]
    failed = tuple(
        FailedDesign(loop=spec.name, name=design.name, method=design.method, error=error)
        for design, error in errors
        if error is not None
    )
    names = [one.name for one in designs]
    use = spec.use if spec.use in names or not names else names[0]
    return LoopOutcome(spec=spec, designs=designs, use=use, failed=failed)


def problems_of(
    job: Job,
    spec: LoopSpec,
    model: LinearModel,
    plants: Sequence[PlantSet | None],
    inner: Design | None,
    progress: Progress = lambda line: None,
) -> list[LoopProblem]:
    """Return the problems of a loop's designs.

    `inner` is the design of the loop that a tracking loop commands.
    """
    directions: Channels | None = None
    if inner is not None:
        around = job.loop(str(spec.around))
        assert inner.plants is not None, "a rate loop has plants"
        K = with_commands(inner.plants, inner.controller)
        outside, directions = tracking_plants(job, spec, around, inner.plants, K)
        plants = [outside] * len(plants)
    more: dict[str, Any] = {"model": model, "directions": directions, "progress": Local(progress)}
    return [
        LoopProblem(job=job, spec=spec, design=design, plant_set=own, **more)
        for design, own in zip(spec.designs, plants, strict=True)
    ]


def _made_of(problems: Sequence[LoopProblem], workers: int, progress: Progress) -> list[Made]:
    """Return the design of each problem, or why there is none."""
    if not (_FORKS and workers > 1 and len(problems) > 1):
        return [_made(problem) for problem in problems]
    found = _in_processes(problems, workers, progress)
    for k, problem in enumerate(problems):
        # All that was under way is lost with a process: each by itself shows which one it was.
        if found[k] is None:
            found[k] = _in_processes([problem], 1, progress)[0]
    killed = "the process that designed it was killed, perhaps because memory ran out"
    killed += "; try fewer plants (uncertainty, angles) or a design of lower order"
    return [
        DesignError(f"{problem.spec.name}, {problem.design.name}: {killed}") if one is None else one
        for problem, one in zip(problems, found, strict=True)
    ]


def _in_processes(problems: Sequence[LoopProblem], workers: int, progress: Progress) -> list[Made | None]:
    """Return the designs; None of those that were under way when a process was killed."""
    # What several designs need is loaded once, before the processes are forked.
    used = {name for one in problems if one.known is None for name in METHODS[one.design.method].libraries}
    for name in sorted({"control", *used}):
        import_module(name)
    out: list[Made | None] = [None] * len(problems)
    with pool(min(workers, len(problems)), "fork", _begin, problems) as executor:
        progress(f"{len(problems)} designs side by side; {problems[0].spec.name}: {problems[0].design.name}")
        under_way = {executor.submit(_made_in_process, k): k for k in range(len(problems))}
        for count, future in enumerate(as_completed(under_way)):
            left = [problems[k] for one, k in under_way.items() if not one.done()]
            if left:
                progress(f"{count + 1} of {len(problems)} designs; {left[0].spec.name}: {left[0].design.name}")
            try:
                made = future.result()
            except BrokenExecutor:
                continue
            k = under_way[future]
            out[k] = dataclasses.replace(made, plants=problems[k].plant_set) if isinstance(made, Design) else made
    return out


def _begin(problems: Sequence[LoopProblem]) -> None:
    global _given
    _given = problems


def _made_in_process(k: int) -> Made:
    # A thread of the parent may have held the lock of a progress display when this process was forked.
    made = _made(dataclasses.replace(_given[k], progress=lambda line: None))
    # The parent process has the plants: they are not sent.
    return dataclasses.replace(made, plants=None) if isinstance(made, Design) else made


def _made(problem: LoopProblem) -> Made:
    spec, design = problem.spec, problem.design
    problem.progress(f"{spec.name}: {design.name}")
    try:
        made = evaluated(problem)
        return with_largest_rates(made) if spec.kind == "caging" and spec.use == design.name else made
    except Exception as error:
        if began_with_interrupt(error):
            raise
        if not isinstance(error, DesignError) or problem.plant_set is None or str(error).startswith(f"{spec.name}, "):
            return error
        return type(error)(f"{spec.name}, {design.name}: {error}", error.problem)


def plants_of_designs(job: Job, spec: LoopSpec) -> list[PlantSet | None]:
    """Return the plants of every design of a loop: those of designs that read the same are made once."""
    bare: dict[tuple[str, ...], PlantSet | None] = {}
    out = []
    for design in spec.designs:
        read = spec.read_by(design)
        if read.sensors not in bare:
            bare[read.sensors] = plants_of(job, read)
        own = bare[read.sensors]
        out.append(None if own is None else design_plants(job, spec, design, own))
    return out


def in_order(job: Job, outcomes: Sequence[LoopOutcome]) -> tuple[LoopOutcome, ...]:
    """Return loops in the order in which their controllers are computed: a tracking loop before the one it commands.

    Loops that such a loop or a manoeuvre commands take commands then.
    """
    around = {one.spec.around for one in outcomes}
    out = []
    for one in outcomes:
        designs = tuple(
            commanded(design)
            if design.plants is not None and (one.spec.name in around or job.commanded & set(design.plants.angles))
            else design
            for design in one.designs
        )
        out.append(dataclasses.replace(one, designs=designs))
    for tracking in [one for one in out if one.spec.kind == "tracking"]:
        out.remove(tracking)
        k = next(i for i, one in enumerate(out) if one.spec.name == tracking.spec.around)
        out.insert(k, tracking)
    return tuple(out)


def kept_in(folder: Path) -> Mapping[str, Kept]:
    """Return what is kept in a folder by `key_of`; nothing where there is no such file, or it is damaged."""
    try:
        found = json.loads((folder / FILE).read_text(encoding="utf-8"))
        whole = found["hash"] == data_hash({"designs": found["designs"]})
        return {str(key): one for key, one in found["designs"].items()} if whole else {}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return {}


def keep(folder: Path, designs: Iterable[tuple[str, Design]]) -> None:
    """Write designs, each with its key, to a folder in place of those that it holds; without them if that fails."""
    kept = {"designs": {key: _kept(design) for key, design in designs}}
    with contextlib.suppress(InputError):
        write_whole(folder / FILE, json.dumps(kept | {"hash": data_hash(kept)}))


def key_of(problem: LoopProblem, code: str) -> str | None:
    """Return a hash of all that a design depends on, `code` that makes it among it; None where it is made at once."""
    if problem.plant_set is None:
        return None
    # Whether it is the design that is closed decides on some of its claims.
    spec = dataclasses.replace(problem.spec, designs=(problem.design,), use=problem.design.name)
    closed, sampling = problem.spec.use == problem.design.name, problem.job.sampling
    plants = replaced(problem.plant_set, {"disturbed": None})
    parts = (code, spec, closed, sampling, problem.model, problem.directions, plants)
    return hashlib.sha256(pickle.dumps(parts)).hexdigest()


def taken_over(problem: LoopProblem, kept: Kept) -> Design | None:
    """Return a design that is kept, not measured yet; None where what is kept is no whole design."""
    name = f"{problem.spec.name}, {problem.design.name}"
    try:
        inputs, outputs = kept["inputs"], kept["outputs"]
        whole = np.array(kept["matrices"], dtype=np.float64)
        K = System.split(whole, len(whole) - len(outputs), kept["dt"]).to_control(inputs, outputs, name=name)
        options, claims = dict(kept["options"]), dict(kept["claims"])
    except (LookupError, TypeError, ValueError):
        return None
    return problem.of(K, options, claims)


def _kept(design: Design) -> Kept:
    K = design.controller
    return {
        "matrices": np.block([[K.A, K.B], [K.C, K.D]]).tolist(),
        "dt": float(K.dt),
        "inputs": list(K.input_labels),
        "outputs": list(K.output_labels),
        "options": dict(design.options),
        "claims": dict(design.claims),
    }


def code_hash() -> str:
    """Return a hash of the package's own code and the versions of what it computes with."""
    found = hashlib.sha256(repr([__version__, *(metadata.version(name) for name in _PACKAGES)]).encode())
    root = Path(__file__).parents[1]
    for layer in ("design", "job", "analysis", "mechanics", "plant", "common"):
        for file in sorted((root / layer).rglob("*.py")):
            found.update(file.read_bytes())
    return found.hexdigest()
