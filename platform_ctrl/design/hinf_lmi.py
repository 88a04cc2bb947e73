"""H-infinity synthesis by linear matrix inequalities: one plant, on the route that serves whole polytopes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from platform_ctrl.design.lmi.quadratic import quadratic_hinf
from platform_ctrl.design.partition import Partition, Realisation

if TYPE_CHECKING:
    from control import StateSpace


def hinf_lmi(
    plant: Partition, backoff: float, time_limit: float, P: StateSpace
) -> tuple[Realisation, float, dict[str, float]]:
    """Controller in the units of `plant`, the least gamma, and how well the inequalities hold (scaled).

    Raises
    ------
    InfeasibleError, UnscalableError, TimeLimitError, IllPosedError
        The solver failed, or what it returned does not satisfy the inequalities; `P` is attached.
    """
    found = quadratic_hinf([plant], backoff, time_limit, P)
    return found.controllers[0], found.least, found.residual
