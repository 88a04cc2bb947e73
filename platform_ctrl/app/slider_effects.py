"""How moved sliders change the requirements: the arrows of the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.tuning import SHARE, OptionEffects, deciding, largest_ratios, option_effects
from platform_ctrl.job.judging import CheckResult

Ratios = Callable[[Settings], FloatArray]


def moved_slider(slider: Slider) -> float:
    """Return the value of a slider that is 5 % larger; one at zero is moved by that share of its range."""
    return slider.value * (1.0 + SHARE) if slider.value else SHARE * (slider.high - slider.low) / 2.0


def slider_effects(
    loops: ClosedLoops, settings: Settings, sliders: Sequence[Slider], settings_with: Callable[[Slider], Settings]
) -> OptionEffects:
    """Return what `sliders` do to the limits of the loop, or on all loops, and to those of the budget as it is known.

    `settings_with` are the settings with one of them moved.
    """
    own = _of_caging_loop if loops.design(settings)[0].has_plants else _of_all_loops
    parts = [
        option_effects(
            [slider.name for slider in sliders],
            names,
            ratios(settings),
            [lambda slider=slider, ratios=ratios: ratios(settings_with(slider)) for slider in sliders],  # type: ignore[misc]
        )
        for names, ratios in (own(loops, settings), _of_results(loops.sight.quick_results, settings))
        if names
    ]
    return OptionEffects(
        options=tuple(slider.name for slider in sliders),
        requirements=tuple(name for one in parts for name in one.requirements),
        ratios=np.concatenate([np.zeros(0), *(one.ratios for one in parts)]),
        change=np.concatenate([np.zeros((0, len(sliders))), *(one.change for one in parts)]),
    )


def _of_caging_loop(loops: ClosedLoops, settings: Settings) -> tuple[list[str], Ratios]:
    loop, _ = loops.caged(settings)
    requests = [one for one in loop.spec.requests if one.hard]
    view = deciding(measure(loop.plants, loop.delivered, requests, exact=False), requests)

    def ratios(now: Settings) -> FloatArray:
        moved, _ = loops.caged(now)
        plants = moved.plants.only([k for k in view if k < len(moved.plants.labels)])
        return largest_ratios(measure(plants, moved.delivered, requests, exact=False), requests)

    return [one.name for one in requests], ratios


def _of_all_loops(loops: ClosedLoops, settings: Settings) -> tuple[list[str], Ratios]:
    return _of_results(lambda now: loops.coupled(now).results, settings)


def _of_results(results: Callable[[Settings], Sequence[CheckResult]], settings: Settings) -> tuple[list[str], Ratios]:
    return [one.name for one in results(settings)], lambda now: np.array([one.ratio for one in results(now)])
