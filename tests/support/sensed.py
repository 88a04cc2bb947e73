"""Linear models with readings as outputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control

from platform_ctrl import Platform, linearise, state_space
from platform_ctrl.mechanics.outputs import observed


def sensed(platform: Platform, names: Sequence[str], **options: Any) -> control.StateSpace:
    """Return the linear model at rest whose outputs are these sensors or signals; options of `state_space`."""
    return observed(state_space(linearise(platform), **options), platform, names)
