"""How moved sliders change the requirements: the arrows of the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.app.caged import CagedLoop
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import requirements_of
from platform_ctrl.design.tuning import SHARE, OptionEffects, deciding, largest_ratios, option_effects
from platform_ctrl.job.judging import CheckResult


def moved_slider(slider: Slider) -> float:
    """Return the value of a slider that is 5 % larger; one at zero is moved by that share of its range."""
    return slider.value * (1.0 + SHARE) if slider.value else SHARE * (slider.high - slider.low) / 2.0


def caged_influence(
    loop: CagedLoop, sliders: Sequence[Slider], loop_with: Callable[[Slider], CagedLoop]
) -> OptionEffects:
    """Return what `sliders` do to the limits of a caging loop; `loop_with` is the loop with one of them moved."""
    requests = [one for one in requirements_of(loop.spec) if one.hard]
    whole = measure(loop.plants, loop.delivered, requests, exact=False)
    view = deciding(whole, requests)
    names = tuple(one.name for one in requests)

    def ratios(now: CagedLoop) -> FloatArray:
        plants = now.plants.only([k for k in view if k < len(now.plants.labels)])
        return largest_ratios(measure(plants, now.delivered, requests, exact=False), requests)

    return option_effects(
        [slider.name for slider in sliders],
        names,
        ratios(loop),
        [lambda slider=slider: ratios(loop_with(slider)) for slider in sliders],  # type: ignore[misc]
    )


def stabilised_influence(
    loops: ClosedLoops, settings: Settings, sliders: Sequence[Slider], settings_with: Callable[[Slider], Settings]
) -> OptionEffects:
    """Return what `sliders` do to the coupled limits."""

    def results(now: Settings) -> tuple[CheckResult, ...]:
        return loops.coupled(now).results

    first = results(settings)

    def moved(slider: Slider) -> FloatArray:
        return np.array([one.ratio for one in results(settings_with(slider))])

    return option_effects(
        [slider.name for slider in sliders],
        [one.name for one in first],
        np.array([one.ratio for one in first]),
        [lambda slider=slider: moved(slider) for slider in sliders],  # type: ignore[misc]
    )


def with_budget(
    effects: OptionEffects,
    loops: ClosedLoops,
    settings: Settings,
    sliders: Sequence[Slider],
    settings_with: Callable[[Slider], Settings],
) -> OptionEffects:
    """Return the effects with those on the limits of the job's budget, as far as it is known, behind them."""
    first = loops.sight.quick_results(settings)
    if not first:
        return effects

    def ratios(slider: Slider) -> FloatArray:
        return np.array([one.ratio for one in loops.sight.quick_results(settings_with(slider))])

    more = option_effects(
        effects.options,
        [one.name for one in first],
        np.array([one.ratio for one in first]),
        [lambda slider=slider: ratios(slider) for slider in sliders],  # type: ignore[misc]
    )
    return OptionEffects(
        options=effects.options,
        requirements=(*effects.requirements, *more.requirements),
        ratios=np.concatenate([effects.ratios, more.ratios]),
        change=np.concatenate([effects.change, more.change]),
    )
