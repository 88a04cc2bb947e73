"""The one slider whose move helps the tightest requirement most, with what it gains and what it costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.app.pictures import Influence
from platform_ctrl.app.settings import Settings, Slider
from platform_ctrl.app.slider_effects import SHARE
from platform_ctrl.common.values import value
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.judging import CheckResult

# Relative moves of a slider that are considered, and how many sliders are tried after the estimate.
_MOVES, _TRIED = (-0.2, -0.1, -0.05, -0.025, 0.025, 0.05, 0.1, 0.2), 4
# Least reduction of the largest ratio that is worth a step, and least loss of margin that is called a cost.
_GAIN, _COST = 2e-3, 1e-3


@value
class MarginChange:
    """The margin of a requirement before and after a step."""

    requirement: str
    before: float
    after: float


@value
class NextStep:
    """A slider moved from `before` to `after`: `settings` are those after it.

    `gain` is of the requirement that is tightest before; `cost` of the one that loses most margin, or None.
    """

    slider: Slider
    after: float
    settings: Settings
    gain: MarginChange
    cost: MarginChange | None


def candidates(influence: Influence, sliders: Sequence[Slider]) -> list[tuple[Slider, float]]:
    """Return the sliders that may move with their new values, those first that are expected to help most.

    All ratios are taken to be linear in the slider.
    """
    column = {name: k for k, name in enumerate(influence.sliders)}
    found = []
    for slider in sliders:
        if slider.name not in column or not slider.tunable or slider.fixed or not slider.value:
            continue
        slope = influence.change[:, column[slider.name]] / SHARE
        if not np.all(np.isfinite(slope)):
            continue
        for move in _MOVES:
            after = float(f"{slider.value * (1.0 + move):.4g}")
            if slider.low <= after <= slider.high:
                found.append((float((influence.ratios + slope * move).max()), slider, after))
    found.sort(key=lambda one: one[0])
    out: dict[str, tuple[Slider, float]] = {}
    for _, slider, after in found:
        out.setdefault(slider.name, (slider, after))
    return list(out.values())[:_TRIED]


def next_step(
    before: tuple[CheckResult, ...],
    tried: Sequence[tuple[Slider, float]],
    settings_with: Callable[[Slider, float], Settings],
    results: Callable[[Settings], tuple[CheckResult, ...]],
) -> NextStep | None:
    """Return the best of the steps that are `tried`, measured; None where none helps the tightest requirement."""
    if not before:
        return None
    tightest = max(range(len(before)), key=lambda k: before[k].ratio)
    best, step = before[tightest].ratio * (1.0 - _GAIN), None
    for slider, after in tried:
        try:
            settings = settings_with(slider, after)
            found = results(settings)
        except PlatformCtrlError:
            continue
        worst = max(one.ratio for one in found)
        if worst >= best:
            continue
        best = worst
        pairs = list(zip(before, found, strict=True))
        losses = [min(a.margin, 1.0) - min(b.margin, 1.0) for a, b in pairs]
        dearest = int(np.argmax(losses))
        step = NextStep(
            slider=slider,
            after=after,
            settings=settings,
            gain=_change(*pairs[tightest]),
            cost=_change(*pairs[dearest]) if losses[dearest] > _COST else None,
        )
    return step


def _change(before: CheckResult, after: CheckResult) -> MarginChange:
    return MarginChange(requirement=before.name, before=before.margin, after=after.margin)
