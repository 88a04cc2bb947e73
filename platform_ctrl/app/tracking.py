"""Tracking loops on the page: designed once, for the job as it was read, and held while sliders move the others."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Sequence

from platform_ctrl.analysis.arrays import named_system, state_arrays
from platform_ctrl.app.controllers import at_rate
from platform_ctrl.app.saving import ClosedController
from platform_ctrl.design.jobs import loops
from platform_ctrl.design.loop import LoopDesign, remeasured
from platform_ctrl.design.plants import plants_of, tracking_plants
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.judging import CheckResult


def without_tracking(job: Job) -> Job:
    """Return the job without its tracking loops."""
    return dataclasses.replace(job, loops=tuple(spec for spec in job.loops if spec.kind != "tracking"))


class TrackingLoops:
    """The tracking loops of a job; safe in several threads."""

    def __init__(self, job: Job) -> None:
        self.specs = tuple(spec for spec in job.loops if spec.kind == "tracking")
        self._job, self._lock = job, threading.Lock()
        self._made: dict[str, LoopDesign] = {}

    @property
    def around(self) -> set[str]:
        """Names of the rate loops that they command."""
        return {str(spec.around) for spec in self.specs}

    def with_them(self, closed: Sequence[ClosedController], period: float) -> list[ClosedController]:
        """Return controllers in the order in which they are computed: a tracking loop before the one it commands."""
        out = list(closed)
        for spec in self.specs:
            made = self._designed(spec)
            K = at_rate(state_arrays(made.controller, made.name), period, made.name)
            own = ClosedController(
                loop=spec.name,
                design=made.name,
                method=made.method,
                system=named_system(
                    K, made.controller.input_labels, made.controller.output_labels, name=f"{spec.name}, {made.name}"
                ),
                options=made.options,
                note="",
            )
            out.insert(next(k for k, one in enumerate(out) if one.loop == spec.around), own)
        return out

    def results(self, job: Job, spec: LoopSpec, closed: Sequence[ClosedController]) -> tuple[CheckResult, ...]:
        """Return the results of a tracking loop around the rate loop among `closed`."""
        by_name = {one.loop: one.system for one in closed}
        inner = next(one for one in job.loops if one.name == spec.around)
        inside = plants_of(job, inner)
        assert inside is not None, "a rate loop has plants"
        plants, _ = tracking_plants(job, spec, inner, inside, state_arrays(by_name[inner.name], inner.name))
        return remeasured(spec, self._designed(spec).name, by_name[spec.name], plants).results

    def _designed(self, spec: LoopSpec) -> LoopDesign:
        with self._lock:
            if not self._made:
                needed = {one.name for one in self.specs} | self.around
                alone = [
                    dataclasses.replace(one, designs=tuple(d for d in one.designs if d.name == one.use))
                    for one in self._job.loops
                    if one.name in needed
                ]
                found = loops(dataclasses.replace(self._job, loops=tuple(alone)))
                self._made = {one.spec.name: one.closed for one in found}
        return self._made[spec.name]
