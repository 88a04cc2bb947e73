"""Linear models with readings as outputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from platform_ctrl import Platform, linearise, state_space
from platform_ctrl.mechanics.outputs import observed


def sensed(platform: Platform, names: Sequence[str], q: Any = None, Omega: Any = (0, 0, 0), **options: Any) -> Any:
    """Return the linear model, a `control.StateSpace`, whose outputs are these signals; options of `state_space`."""
    return observed(state_space(linearise(platform, q=q, Omega=Omega), **options), platform, names, q, Omega)
