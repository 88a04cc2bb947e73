"""Certificates: matrices that prove what a design claims, and their proof in interval arithmetic."""

from __future__ import annotations

from platform_ctrl.analysis.certificates.certificate import Certificate
from platform_ctrl.analysis.certificates.closed_loop import ClosedLoop

__all__ = [
    "Certificate",
    "ClosedLoop",
]
