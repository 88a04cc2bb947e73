"""Campaigns: many runs of a job with everything that may vary, and what they say together."""

from __future__ import annotations

from platform_ctrl.campaign.engine import run_campaign
from platform_ctrl.campaign.planning import plan
from platform_ctrl.campaign.single_run import rerun
from platform_ctrl.campaign.summary import summarise

__all__ = ["plan", "rerun", "run_campaign", "summarise"]
