"""What each knob does to each requirement, looked at on the nominal plant and the worst of the set."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.loop_figures import OF_CONTROLLER
from platform_ctrl.analysis.loop_measures import LoopMeasures, measure
from platform_ctrl.app.caged import CagedLoop
from platform_ctrl.app.closing import Closing
from platform_ctrl.app.free_measures import requirements
from platform_ctrl.app.pictures import Influence
from platform_ctrl.app.values import Knob, Settings
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import asked_of
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.requirements import CheckResult, LoopRequirement

# A knob is moved by this share of where it stands; one at zero by this share of its range.
SHARE = 0.05


def moved_knob(knob: Knob) -> float:
    """Return where a knob stands when it is 5 % larger."""
    return knob.value * (1.0 + SHARE) if knob.value else SHARE * (knob.high - knob.low) / 2.0


def caged_influence(loop: CagedLoop, knobs: Sequence[Knob], loop_with: Callable[[Knob], CagedLoop]) -> Influence:
    """Return what `knobs` do to the limits of a caging loop; `loop_with` is the loop with one of them moved."""
    asked = [one for one in asked_of(loop.spec) if one.hard]
    whole = measure(loop.plants, loop.controller, asked)
    view = deciding(whole, asked)
    names = tuple(one.name for one in asked)

    def ratios(now: CagedLoop) -> FloatArray:
        plants = now.plants.only([k for k in view if k < len(now.plants.labels)])
        return largest_ratios(measure(plants, now.controller, asked), asked)

    return _influence(knobs, names, ratios(loop), lambda knob: ratios(loop_with(knob)))


def stabilised_influence(
    closing: Closing, settings: Settings, knobs: Sequence[Knob], settings_with: Callable[[Knob], Settings]
) -> Influence:
    """Return what `knobs` do to the coupled limits, on the nominal plant."""

    def results(now: Settings) -> tuple[CheckResult, ...]:
        return requirements(closing.stabilised(now.but(band=False))[0], closing.kept(now))

    first = results(settings)
    return _influence(
        knobs,
        tuple(one.name for one in first),
        np.array([one.ratio for one in first]),
        lambda knob: np.array([one.ratio for one in results(settings_with(knob))]),
    )


def _influence(
    knobs: Sequence[Knob], requirements: tuple[str, ...], before: FloatArray, after: Callable[[Knob], FloatArray]
) -> Influence:
    """Return the changes of ratios; nan where a knob, moved, makes no loop at all."""
    change = np.full((len(before), len(knobs)), np.nan)
    for k, knob in enumerate(knobs):
        try:
            moved = after(knob)
        except PlatformCtrlError:
            continue
        with np.errstate(invalid="ignore"):
            change[:, k] = moved - before
    return Influence(knobs=tuple(knob.name for knob in knobs), requirements=requirements, ratios=before, change=change)


def deciding(measures: LoopMeasures, asked: Sequence[LoopRequirement]) -> list[int]:
    """Return the nominal plant and the two that are worst for each requirement."""
    out = {0}
    for one in asked:
        ratios = one.ratios(measures)
        if one.kind not in OF_CONTROLLER and one.over_spread and len(ratios):
            plants = np.flatnonzero(measures.of(one.over))
            out |= {int(plants[k]) for k in np.argsort(-ratios)[:2]}
    return sorted(out)


def largest_ratios(measures: LoopMeasures, asked: Sequence[LoopRequirement]) -> FloatArray:
    """Return the largest ratio of each requirement (k,)."""
    return np.array([float(one.ratios(measures).max(initial=0.0)) for one in asked])
