"""When a fault acts."""

from __future__ import annotations

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import Mask, Number, inlined, load
from platform_ctrl.simulation.kernel.flight import BEGIN, UNTIL


@inlined
def acts(mem: FloatArray, lane: int, fault: int, t: Number) -> Mask:
    """Return whether the fault at a slot has begun at t and the part is not sound again."""
    return (load(mem, fault + BEGIN, lane) <= t) & (load(mem, fault + UNTIL, lane) > t)
