"""Certificates: matrices that prove what a design claims, and their proof in interval arithmetic."""

from __future__ import annotations

from platform_ctrl.certificates.certificate import Certificate, Verification, proved
from platform_ctrl.certificates.closed_loop import ClosedLoop
from platform_ctrl.certificates.makers import h2_certificate, norm_certificate, stability_certificate

__all__ = [
    "Certificate",
    "ClosedLoop",
    "Verification",
    "h2_certificate",
    "norm_certificate",
    "proved",
    "stability_certificate",
]
