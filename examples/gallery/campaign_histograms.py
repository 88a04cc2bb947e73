"""Histograms of a campaign.

Four hundred turns of the platform with gyro 9-10 caged, the rotor's momentum and the loop's delay drawn anew for each:
how the largest angle and the largest share of a torquer's limit are distributed, in red what lies beyond the limit.
"""

import tempfile

import platform_ctrl as pc
from platform_ctrl import campaign
from platform_ctrl.report import figures

TURN = {"mode": "caged", "axis": 1, "rate": 1.0, "hold": 0.05, "duration": 0.3}
LIMITS = {"angle": 0.0018, "torque_share": 0.7}
MOMENTUM = {"parameter": "rotor.11.angular_momentum", "distribution": "normal", "mean": 1.0, "deviation": 0.05}
DELAY = {"parameter": "sampling.delay", "distribution": "uniform", "low": 0.0003, "high": 0.0009}
NUMBERS = {"crossover_hz": 70, "integral_hz": 2, "damping_hz": 78, "damping2_hz": 92, "lead_hz": 7, "rolloff_hz": 900}
job = pc.read_job(
    {
        "schema": 2,
        "name": "gyro 9-10",
        "plant": "three_gyro_platform",
        "operation": {"Omega": [0.0, 0.0, 0.0]},
        "sampling": {"rate_hz": 2000, "delay": 0.0005},
        "loop": [
            {
                "name": "caging 9-10",
                "kind": "caging",
                "gimbals": ["9", "10"],
                "use": "classical",
                "design": [{"name": "classical", "method": "classical", **NUMBERS}],
            }
        ],
        "manoeuvre": [
            {"name": "quick turn", "rise": 0.1, "limits": LIMITS, **TURN},
            {"name": "jerky turn", "rise": 0.06, "limits": LIMITS, **TURN},
        ],
        "campaign": {"runs": 400, "seed": 3, "vary": [MOMENTUM | {"relative": True}, DELAY]},
    }
)
plan = campaign.plan(job, [pc.design.loops(job)[0].closed.controller])
table = campaign.run_campaign(plan, tempfile.mkdtemp(), workers=1).table

figure = figures.campaign_histograms(campaign.summarise(plan, table))
figure.savefig("campaign_histograms.png", dpi=150)
