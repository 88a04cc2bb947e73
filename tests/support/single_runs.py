"""A run of a plant as one call, for tests that need no scenario of their own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control

from platform_ctrl import Platform
from platform_ctrl.simulation import Scenario, simulate


def simulated(
    platform: Platform,
    controllers: Sequence[control.StateSpace],
    *,
    period: float,
    step: float = 1e-4,
    noise: bool = True,
    **scenario: Any,
) -> Any:
    """The run of a scenario with this plant; the other arguments are those of `Scenario`."""
    return simulate(Scenario(platform=platform, **scenario), controllers, period=period, step=step, noise=noise)
