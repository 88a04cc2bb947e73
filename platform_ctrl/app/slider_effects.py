"""How moved sliders change the requirements: the arrows of the table, and the limits that a drag keeps."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.app.caged import CagedLoop, loop_metrics
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.dragging import FreeParameters, Limits, Ratios
from platform_ctrl.app.settings import Settings, Slider, with_options
from platform_ctrl.app.stabilised import requirements
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
    """Return what `sliders` do to the coupled limits, on the nominal plant."""

    def results(now: Settings) -> tuple[CheckResult, ...]:
        return requirements(loops.stabilised(now.but(band=False))[0], loops.cached_margins(now))

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
        # The range of Omega moves no spectrum of the budget.
        found = first if slider.group == "Omega" else loops.sight.quick_results(settings_with(slider), keep=False)
        return np.array([one.ratio for one in found])

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


# By how much less than its limit a ratio has to be that is climbed on a grid.
_GRID = 2e-3
# How readily a drag moves each group of sliders.
_WEIGHTS = {"gains": 1.0, "lead": 0.25, "notch": 0.05, "lag": 0.05}


def limits_of(loops: ClosedLoops, settings: Settings, parameters: FreeParameters) -> Limits:
    """Return the hard limits that are met with these settings, as the page measures them: a drag must keep them."""
    spec, _ = loops.design(settings)
    own = _loop_limits(loops, settings, parameters) if spec.has_plants else _coupled_limits(loops, settings)
    budget = loops.sight.quick_results(settings)
    met = [k for k, one in enumerate(budget) if one.passed]
    if not met:
        return own

    def exact(numbers: Mapping[str, float]) -> FloatArray:
        found = loops.sight.quick_results(with_options(settings, numbers))
        return np.concatenate([own.exact(numbers), [found[k].ratio for k in met]])

    def without(ratios: Ratios) -> Ratios:
        # The budget stops a drag, but is too slow to be searched along.
        return lambda numbers: np.concatenate([ratios(numbers), np.zeros(len(met))])

    return dataclasses.replace(
        own,
        names=(*own.names, *(budget[k].name for k in met)),
        bound=np.concatenate([own.bound, np.ones(len(met))]),
        exact=exact,
        rough=without(own.rough),
        near=without(own.near),
        local=without(own.local),
    )


def _loop_limits(loops: ClosedLoops, settings: Settings, parameters: FreeParameters) -> Limits:
    spec, _ = loops.design(settings)
    loop, _ = loops.caged(settings)

    def exact(K: StateArrays) -> LoopMetrics:
        now = dataclasses.replace(loop, controller=K)
        return loops.cached_metrics(settings, now)(lambda: loop_metrics(now))

    whole = exact(loop.controller)
    hard = [one for one in requirements_of(spec) if one.hard]
    met = [one for one, ratio in zip(hard, largest_ratios(whole, hard), strict=True) if ratio <= 1.0]
    first = largest_ratios(whole, met)

    def on_a_grid(plants: PlantSet) -> Ratios:
        def ratios(numbers: Mapping[str, float]) -> FloatArray:
            K = loop.with_commands(parameters.build(numbers))
            return largest_ratios(measure(plants, K, met, exact=False), met)

        return ratios

    def corrected(ratios: Ratios) -> Ratios:
        @cache
        def factor() -> FloatArray:
            # Nearby a grid is wrong by about the same factor as here.
            here = ratios({})
            return np.asarray(np.where(here > 0.0, first / np.maximum(here, np.finfo(float).tiny), 1.0))

        return lambda numbers: factor() * ratios(numbers)

    return Limits(
        names=tuple(one.name for one in met),
        bound=np.ones(len(met)),
        exact=lambda numbers: largest_ratios(exact(parameters.build(numbers)), met),
        rough=on_a_grid(loop.plants),
        near=corrected(on_a_grid(loop.plants)),
        local=corrected(on_a_grid(loop.plants.only(deciding(whole, met)))),
    )


def _coupled_limits(loops: ClosedLoops, settings: Settings) -> Limits:
    """Return the coupled limits that are met; the page climbs their peaks on a grid, to about a thousandth."""
    spec, design = loops.design(settings)
    # All limits are those of the nominal plant.
    whole, _ = loops.stabilised(settings.but(band=False))
    kept = loops.cached_margins(settings)

    def results(numbers: Mapping[str, float]) -> tuple[CheckResult, ...]:
        servo = loops.servo(with_options(settings, numbers), spec, design)
        others = [servo if one.name == servo.name else one for one in whole.controllers]
        now = dataclasses.replace(whole, controllers=tuple(others))
        return loops.cached_results(settings, now.joined(whole.plants)[0], lambda: requirements(now, kept))

    first = results({})
    met = [k for k, one in enumerate(first) if one.passed]

    def ratios(numbers: Mapping[str, float]) -> FloatArray:
        found = results(numbers)
        return np.array([found[k].ratio for k in met])

    return Limits(
        names=tuple(first[k].name for k in met),
        bound=np.maximum(1.0 - _GRID, ratios({})),
        exact=ratios,
        rough=ratios,
        near=ratios,
        local=ratios,
        steps=1,
    )


def free_parameters(
    loops: ClosedLoops, settings: Settings, sliders: Sequence[Slider], origin: Settings
) -> tuple[FreeParameters, StateArrays, int]:
    """Return the free sliders of the design, the plant that is shown, and the channel; a drag began at `origin`."""
    spec, design = loops.design(settings)
    free = [slider for slider in sliders if slider.tunable and not slider.fixed]
    if spec.has_plants:
        loop, _ = loops.caged(settings)
        P = loop.shown
        plant = P.arrays.at(0)
        torquers: Sequence[str] = P.torques
    else:
        whole, _ = loops.stabilised(settings)
        _, at, torquers = whole.joined(whole.shown)
        here = whole.controllers[[one.name for one in loops.in_order()].index(spec.name)].name
        plant = whole.shown.arrays.at(0).part(slice(None), at)

    def build(numbers: Mapping[str, float]) -> StateArrays:
        new = with_options(settings, numbers)
        if spec.has_plants:
            return loops.caging(new, spec, design)[0]
        servo = loops.servo(new, spec, design)
        others = [servo if one.name == here else one for one in whole.controllers]
        return dataclasses.replace(whole, controllers=tuple(others)).joined(whole.shown)[0]

    before = origin.options[spec.name][design.name]
    parameters = FreeParameters(
        names=tuple(slider.name for slider in free),
        start=np.array([slider.value for slider in free]),
        low=np.array([min(slider.low, slider.value) / 20.0 for slider in free]),
        high=np.array([slider.high if slider.high < np.inf else 20.0 * slider.value for slider in free]),
        weights=np.array([_WEIGHTS.get(slider.group, 1.0) for slider in free]),
        build=build,
        origin=np.array([before.get(slider.name, slider.value) for slider in free]),
    )
    return parameters, plant, list(torquers).index(settings.channel) if settings.channel in torquers else 0
