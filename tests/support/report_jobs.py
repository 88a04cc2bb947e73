"""Jobs about one gyro of the three-gyro platform that are designed and checked in a moment, to be reported."""

from __future__ import annotations

from typing import Any

import platform_ctrl as pc
from platform_ctrl.design import loops
from platform_ctrl.report.blocks import PageContent, html
from platform_ctrl.report.job_page import prepared
from platform_ctrl.verification import check_job
from platform_ctrl.verification.verdict import JobResult


def classical(name: str = "classical", crossover_hz: float = 40.0, **options: Any) -> dict[str, Any]:
    """A design of the loop."""
    return {"name": name, "method": "classical", "crossover_hz": crossover_hz, "integral_hz": 2, **options}


def caging(*designs: dict[str, Any], **settings: Any) -> dict[str, Any]:
    """The loop of gyro 9-10; the last design is closed."""
    loop = {"name": "caging 9-10", "kind": "caging", "gimbals": ["9", "10"], "use": designs[-1]["name"]}
    return loop | {"design": list(designs), **settings}


def turn(**settings: Any) -> dict[str, Any]:
    """A short turn of the platform about axis 1."""
    turn = {"name": "turn", "mode": "caged", "axis": 1, "rate": 1.0, "rise": 0.05, "hold": 0.05, "duration": 0.2}
    return turn | settings


def job(**settings: Any) -> dict[str, Any]:
    """A job, with uncertain inertias and a rate about axis 3."""
    return {
        "schema": 2,
        "name": "gyro 9-10",
        "plant": "three_gyro_platform",
        "operation": {"Omega": [0.0, 0.0, 0.5], "seed": 7},
        "uncertainty": {"inertia": 0.1},
        "sampling": {"rate_hz": 2000, "delay": 0.0005},
        **settings,
    }


def page_html(result: JobResult | PageContent) -> str:
    """The page of a report."""
    return html(prepared(result)).replace("\u00a0", " ")


def checked(data: dict[str, Any]) -> JobResult:
    """The job designed and checked."""
    read = pc.read_job(data)
    return check_job(read, loops(read))
