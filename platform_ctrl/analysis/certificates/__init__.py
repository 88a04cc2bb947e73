"""Certificates: matrices that prove what a design claims, and their proof in interval arithmetic."""

from __future__ import annotations

from platform_ctrl.analysis.certificates.certificate import Certificate, Verification
from platform_ctrl.analysis.certificates.closed_loop import ClosedLoop
from platform_ctrl.analysis.certificates.makers import h2_certificate, norm_certificate, stability_certificate
from platform_ctrl.analysis.certificates.plant_set import (
    margin_certificates,
    plant_set_certificates,
    region_certificate,
)

__all__ = [
    "Certificate",
    "ClosedLoop",
    "Verification",
    "h2_certificate",
    "margin_certificates",
    "norm_certificate",
    "plant_set_certificates",
    "region_certificate",
    "stability_certificate",
]
