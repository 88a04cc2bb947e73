"""What each slider does to each requirement, looked at on the nominal plant and the worst of the set."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.app.caged import CagedLoop
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.free_measures import requirements
from platform_ctrl.app.pictures import Influence
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import requirements_of
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import LoopRequirement

# A slider is moved by this share of where it stands; one at zero by this share of its range.
SHARE = 0.05


def moved_slider(slider: Slider) -> float:
    """Return where a slider stands when it is 5 % larger."""
    return slider.value * (1.0 + SHARE) if slider.value else SHARE * (slider.high - slider.low) / 2.0


def caged_influence(loop: CagedLoop, sliders: Sequence[Slider], loop_with: Callable[[Slider], CagedLoop]) -> Influence:
    """Return what `sliders` do to the limits of a caging loop; `loop_with` is the loop with one of them moved."""
    asked = [one for one in requirements_of(loop.spec) if one.hard]
    whole = measure(loop.plants, loop.controller, asked, exact=False)
    view = deciding(whole, asked)
    names = tuple(one.name for one in asked)

    def ratios(now: CagedLoop) -> FloatArray:
        plants = now.plants.only([k for k in view if k < len(now.plants.labels)])
        return largest_ratios(measure(plants, now.controller, asked, exact=False), asked)

    return _influence(sliders, names, ratios(loop), lambda slider: ratios(loop_with(slider)))


def stabilised_influence(
    loops: ClosedLoops, settings: Settings, sliders: Sequence[Slider], settings_with: Callable[[Slider], Settings]
) -> Influence:
    """Return what `sliders` do to the coupled limits, on the nominal plant."""

    def results(now: Settings) -> tuple[CheckResult, ...]:
        return requirements(loops.stabilised(now.but(band=False))[0], loops.kept(now))

    first = results(settings)
    return _influence(
        sliders,
        tuple(one.name for one in first),
        np.array([one.ratio for one in first]),
        lambda slider: np.array([one.ratio for one in results(settings_with(slider))]),
    )


def _influence(
    sliders: Sequence[Slider], requirements: tuple[str, ...], before: FloatArray, after: Callable[[Slider], FloatArray]
) -> Influence:
    """Return the changes of ratios; nan where a slider, moved, makes no loop at all."""
    change = np.full((len(before), len(sliders)), np.nan)
    for k, slider in enumerate(sliders):
        try:
            moved = after(slider)
        except PlatformCtrlError:
            continue
        with np.errstate(invalid="ignore"):
            change[:, k] = moved - before
    return Influence(
        sliders=tuple(slider.name for slider in sliders), requirements=requirements, ratios=before, change=change
    )


def deciding(measures: LoopMetrics, asked: Sequence[LoopRequirement]) -> list[int]:
    """Return the nominal plant and the two that are worst for each requirement."""
    out = {0}
    for one in asked:
        ratios = one.ratios(measures)
        if one.metric.of != "controller" and one.beyond_nominal and len(ratios):
            plants = np.flatnonzero(measures.of(one.over))
            out |= {int(plants[k]) for k in np.argsort(-ratios)[:2]}
    return sorted(out)


def largest_ratios(measures: LoopMetrics, asked: Sequence[LoopRequirement]) -> FloatArray:
    """Return the largest ratio of each requirement (k,)."""
    return np.array([float(one.ratios(measures).max(initial=0.0)) for one in asked])
