"""The coupled check, the simulated runs, and the verdict."""

from __future__ import annotations

from platform_ctrl.verification.verdict import check_job

__all__ = ["check_job"]
