"""Campaigns: many runs of a job with everything that may vary, and what they say together."""

from __future__ import annotations

from platform_ctrl.campaign.engine import CampaignResult, run_campaign
from platform_ctrl.campaign.planning import Plan, plan
from platform_ctrl.campaign.probability import clopper_pearson
from platform_ctrl.campaign.rare_events import rare_event
from platform_ctrl.campaign.rare_result import RareResult
from platform_ctrl.campaign.rare_runs import rare_probability
from platform_ctrl.campaign.rerunning import Rerun, rerun
from platform_ctrl.campaign.summary import Summary, summarise
from platform_ctrl.campaign.table_statistics import CampaignStatistics, statistics

__all__ = [
    "CampaignResult",
    "CampaignStatistics",
    "Plan",
    "RareResult",
    "Rerun",
    "Summary",
    "clopper_pearson",
    "plan",
    "rare_event",
    "rare_probability",
    "rerun",
    "run_campaign",
    "statistics",
    "summarise",
]
