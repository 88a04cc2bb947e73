"""What a design may depend on, and designs taken from a store instead of being made again.

A design is made from a reduced job, which holds nothing else than what its key is the hash of: what is not in the key
cannot change the design. What is taken from the store is only what a search has found, the controller. The rest is
computed from the closed loops of the present job.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.common.processes import SecondProcess, Task
from platform_ctrl.common.reasons import began_with_interrupt
from platform_ctrl.common.store import Store, array_of, array_text, key_of
from platform_ctrl.common.values import replaced
from platform_ctrl.design.caging_claims import with_caging_claims
from platform_ctrl.design.loop import Designed, LoopDesign, LoopProblem, evaluated
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job.job import CoupledLimits, DesignSpec, Job, LoopSpec
from platform_ctrl.job.methods import known_method, resolved

# Relative difference up to which a measure computed again is the same.
_SAME = 1e-9
# What no design may depend on.
_REMOVED: dict[str, Any] = {
    "name": "",
    "plant": "",
    "coupled": CoupledLimits(),
    "manoeuvres": (),
    "fault_events": (),
    "campaign": None,
    "budget": None,
}
# Of a loop whose plants alone count.
_BARE: dict[str, Any] = {"designs": (), "use": "", "limits": {}, "soft": {}}
_TURNS: dict[str, Any] = _BARE | {"name": "", "kind": "rate", "sensors": (), "around": None, "rate_hz": None}


def plant_job(job: Job, *loops: LoopSpec) -> Job:
    """Return what the plants of loops may depend on: neither on their designs nor on their limits."""
    bare = (replaced(spec, _BARE) for spec in loops)
    return _with_loops(job, tuple(bare))


def design_job(job: Job, spec: LoopSpec, design: DesignSpec) -> Job:
    """Return what a design of a loop may depend on: its loop without the other designs comes last.

    ``use`` is empty unless the design is the one that is closed. The loop that a tracking loop commands comes first,
    with the design that is closed.
    """
    use = design.name if design.name == spec.use else ""
    around = (one for one in job.loops if one.name == spec.around)
    inner = (
        replaced(one, _BARE | {"designs": tuple(own for own in one.designs if own.name == one.use)}) for one in around
    )
    return _with_loops(job, (*inner, replaced(spec, {"designs": (design,), "use": use})))


def _with_loops(job: Job, loops: tuple[LoopSpec, ...]) -> Job:
    """Return a job with these loops; of the others with no more than what they turn: that is not passive."""
    own = {spec.name for spec in loops}
    others = (replaced(one, _TURNS) for one in job.loops if one.name not in own and (one.gimbals or one.torquers))
    return replaced(job, _REMOVED | {"loops": (*others, *loops)})


def design_key(job: Job, rise: float, inner: LoopDesign | None = None) -> str:
    """Return the hash of all that a design depends on: the reduced job, and the controller of the loop inside.

    `rise` is how fast Omega rises where saturation is looked for, s: it counts for the caging loop that is closed.
    """
    spec = job.loops[-1]
    K = None if inner is None else inner.controller
    commanded = None if K is None else (*state_arrays(K, "controller"), *K.input_labels)
    return key_of("design", job, rise if spec.kind == "caging" and spec.use else None, commanded)


def kept_or_designed(
    problems: Sequence[tuple[LoopProblem, LoopDesign | None]],
    rise: float,
    store: Store | None,
    beside: SecondProcess | None,
) -> list[LoopDesign | Exception]:
    """Return the designs of problems with reduced jobs, each with that of the loop inside, or why there is none.

    Those that are in the store are taken from there; of the others `beside` makes a part.
    """
    keys = ["" if store is None else _key(problem, rise, inner) for problem, inner in problems]
    names = [f"{problem.spec.name}: {problem.design.name}" for problem, _ in problems]
    tasks: list[Task] = [
        (_kept_or_made, (problem, rise, store, key)) for (problem, _), key in zip(problems, keys, strict=True)
    ]
    if beside is not None:
        searches = [k for k, (problem, _) in enumerate(problems) if known_method(problem.design.method).goals]
        found = beside.results(tasks, lambda k: problems[k][0].progress(names[k]), searches)
    else:
        found = []
        for (problem, _), name, (function, arguments) in zip(problems, names, tasks, strict=True):
            problem.progress(name)
            found.append(function(*arguments))
    for (problem, _), name, (_, taken) in zip(problems, names, found, strict=True):
        if store is not None and taken:
            store.taken.append((problem.spec.name, problem.design.name))
            problem.progress(f"{name}: unchanged, taken from {store.folder}")
    return [design for design, _ in found]


def _kept_or_made(
    problem: LoopProblem, rise: float, store: Store | None, key: str
) -> tuple[LoopDesign | Exception, bool]:
    """Return the design of a problem, or why there is none, and whether it was taken from the store."""
    taken = _taken(problem, store.find(key)) if store is not None and key else None
    if taken is not None:
        return taken, True
    try:
        return _made(problem, rise, store, key), False
    except Exception as error:
        if began_with_interrupt(error):
            raise
        return error, False


def _key(problem: LoopProblem, rise: float, inner: LoopDesign | None) -> str:
    """Return the key of a design; none where it is not kept.

    A loop without plants is not kept; of other methods than the package's the code is not in the key.
    """
    design = known_method(problem.design.method).design
    own = isinstance(design, str) and design.startswith(f"{__name__.partition('.')[0]}.")
    return design_key(problem.job, rise, inner) if own and problem.plant_set is not None else ""


def _made(problem: LoopProblem, rise: float, store: Store | None, key: str) -> LoopDesign:
    """Return the design of a problem; it is kept if it has a key and is stable."""
    spec = problem.spec
    try:
        found: Designed = resolved(known_method(problem.design.method).design)(problem)
        made = evaluated(problem, found, stable=False)
    except DesignError as error:
        name = f"{spec.name}, {problem.design.name}"
        if problem.plant_set is None or str(error).startswith(f"{spec.name}, "):
            raise
        raise type(error)(f"{name}: {error}", error.problem) from None
    if spec.kind == "caging":
        made = with_caging_claims(problem.job, made, closed=bool(spec.use), rise=rise)
    if store is not None and key and made.measures is not None and made.measures.decay.min() > 0.0:
        store.keep(key, _written(found, made))
    return made


def _written(found: Designed, made: LoopDesign) -> dict[str, Any]:
    """Return what a search has found, in the types of JSON."""
    return {
        "controller": [array_text(part) for part in found.controller[:4]] + [found.controller.dt],
        "options": found.options,
        "method's claims": found.claims,
        "signals": [found.inputs, found.outputs],
        "claims": made.claims,
    }


def _taken(problem: LoopProblem, kept: Any) -> LoopDesign | None:
    """Return a design that was kept, measured with the problem's plants; None if it is not what it was."""
    if kept is None:
        return None
    try:
        found = _read(kept)
        made = evaluated(problem, found)
        claims = {str(name): float(number) for name, number in kept["claims"].items()}
    except (PlatformCtrlError, ValueError, TypeError, KeyError, AttributeError):
        return None
    # Compared to the last digits, which depend on how numbers lie in memory.
    same = all(name in claims and math.isclose(claims[name], x, rel_tol=_SAME) for name, x in made.claims.items())
    return dataclasses.replace(made, claims=claims) if same else None


def _read(kept: Any) -> Designed:
    *matrices, dt = kept["controller"]
    A, B, C, D = (_array(one) for one in matrices)
    inputs, outputs = (tuple(map(str, names)) for names in kept["signals"])
    return Designed(
        controller=StateArrays(A, B, C, D, float(dt)),
        options={str(name): float(number) for name, number in kept["options"].items()},
        claims={str(name): float(number) for name, number in kept["method's claims"].items()},
        inputs=inputs,
        outputs=outputs,
    )


def _array(item: Any) -> Any:
    found = array_of(item)
    if found is None:
        raise ValueError("a matrix is missing")
    return found
