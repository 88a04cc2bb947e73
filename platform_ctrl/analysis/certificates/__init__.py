"""Certificates: matrices that prove what a design claims, and their proof in interval arithmetic."""

from __future__ import annotations

from platform_ctrl.analysis.certificates.certificate import Certificate, Verification, proved
from platform_ctrl.analysis.certificates.closed_loop import ClosedLoop, closed, static_gain
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
    "closed",
    "h2_certificate",
    "margin_certificates",
    "norm_certificate",
    "plant_set_certificates",
    "proved",
    "region_certificate",
    "stability_certificate",
    "static_gain",
]
