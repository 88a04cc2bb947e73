"""What a design may depend on: the job reduced to its own loop and plants."""

from __future__ import annotations

from typing import Any

from platform_ctrl.common.values import replaced
from platform_ctrl.job.job import CoupledLimits, DesignSpec, Job, LoopSpec

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
