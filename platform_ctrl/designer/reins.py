"""What a pull moves: the free knobs of a design, and the plant that is shown with all other loops closed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.designer.closing import Closing
from platform_ctrl.designer.pulling import Reins
from platform_ctrl.designer.values import Knob, Settings

# How readily a pull moves each group of knobs.
_WEIGHTS = {"gains": 1.0, "lead": 0.25, "notch": 0.05, "lag": 0.05}


def reins_of(closing: Closing, settings: Settings, knobs: Sequence[Knob]) -> tuple[Reins, StateArrays, int]:
    """Return the free knobs of the design, the plant that is shown, and the channel.

    Raises
    ------
    PlatformCtrlError
        The loop cannot be built.
    """
    spec, design = closing.design(settings)
    free = [knob for knob in knobs if knob.tunable and not knob.fixed]
    if spec.kind == "caging":
        loop, _ = closing.caged(settings)
        P = loop.shown
        plant = StateArrays(P.A[0], P.B[0], P.C[0], P.D[0], P.period)
        torquers: Sequence[str] = P.torques
    else:
        whole, _ = closing.stabilised(settings)
        _, at, torquers = whole.joined(whole.shown)
        here = whole.controllers[[one.name for one in closing.read.loops].index(spec.name)].name
        A, B, C, D, dt = whole.shown.arrays
        plant = StateArrays(A[0], B[0][:, at], C[0], D[0][:, at], dt)

    def build(numbers: Mapping[str, float]) -> StateArrays:
        mine = {**settings.options[spec.name], design.name: {**settings.options[spec.name][design.name], **numbers}}
        new = settings.but(options={**settings.options, spec.name: mine})
        if spec.kind == "caging":
            return closing.caging(new, spec, design)[0]
        servo = closing.servo(new, spec, design)
        others = [servo if one.name == here else one for one in whole.controllers]
        return dataclasses.replace(whole, controllers=tuple(others)).joined(whole.shown)[0]

    reins = Reins(
        names=tuple(knob.name for knob in free),
        start=np.array([knob.value for knob in free]),
        low=np.array([min(knob.low, knob.value) / 20.0 for knob in free]),
        high=np.array([knob.high if knob.high < np.inf else 20.0 * knob.value for knob in free]),
        weights=np.array([_WEIGHTS.get(knob.group, 1.0) for knob in free]),
        build=build,
    )
    return reins, plant, list(torquers).index(settings.channel) if settings.channel in torquers else 0
