"""Precession theory (15): whether it may be used, what cures it, how far it is from the full equations."""

from __future__ import annotations

from platform_ctrl.mechanics.precession.part import PrecessionPart
from platform_ctrl.mechanics.precession.result import Precession, precession

__all__ = ["Precession", "PrecessionPart", "precession"]
