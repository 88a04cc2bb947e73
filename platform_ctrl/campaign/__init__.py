"""Campaigns: many runs of a job with everything that may vary, and what they say together.

`contrasts`, `plan`, `rerun` and `statistics` are functions as well as the modules that hold them: here they are the
functions.
"""

from __future__ import annotations

from platform_ctrl.campaign.contrasts import Contrast, contrasts
from platform_ctrl.campaign.engine import Campaigned, run_campaign
from platform_ctrl.campaign.plan import Plan, plan
from platform_ctrl.campaign.probability import Distribution, Probability, clopper_pearson
from platform_ctrl.campaign.rare_events import rare_event
from platform_ctrl.campaign.rare_result import RarePoint, RareResult, Repetition
from platform_ctrl.campaign.rare_runs import rare_probability
from platform_ctrl.campaign.rerun import Rerun, rerun
from platform_ctrl.campaign.sensitivity import Influence, Sensitivity, influences, sensitivities
from platform_ctrl.campaign.statistics import CampaignStatistics, RequirementStatistics, RunFigure, statistics
from platform_ctrl.campaign.summary import Summary, summarised, summary_record

__all__ = [
    "CampaignStatistics",
    "Campaigned",
    "Contrast",
    "Distribution",
    "Influence",
    "Plan",
    "Probability",
    "RarePoint",
    "RareResult",
    "Repetition",
    "RequirementStatistics",
    "Rerun",
    "RunFigure",
    "Sensitivity",
    "Summary",
    "clopper_pearson",
    "contrasts",
    "influences",
    "plan",
    "rare_event",
    "rare_probability",
    "rerun",
    "run_campaign",
    "sensitivities",
    "statistics",
    "summarised",
    "summary_record",
]
