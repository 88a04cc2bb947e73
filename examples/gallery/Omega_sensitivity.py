"""Sensitivity to the platform's rate.

How far the angles of gyro 9-10 move when the platform turns: without control they integrate the rate, the caging
controller holds them. Above the dashed line the gyro would leave its range.
"""

import platform_ctrl as pc
from platform_ctrl.report import figures

PERIOD, DELAY = 0.0005, 0.0005  # s
NUMBERS = {"crossover_hz": 70, "integral_hz": 2, "damping_hz": 78, "damping2_hz": 92, "lead_hz": 7, "rolloff_hz": 900}
job = pc.read_job(
    {
        "schema": 2,
        "name": "gyro 9-10",
        "plant": "three_gyro_platform",
        "operation": {"Omega": [0.0, 0.0, 0.0]},
        "sampling": {"rate_hz": 1.0 / PERIOD, "delay": DELAY},
        "loop": [
            {
                "name": "caging 9-10",
                "kind": "caging",
                "gimbals": ["9", "10"],
                "use": "classical",
                "design": [{"name": "classical", "method": "classical", **NUMBERS}],
            }
        ],
    }
)
controller = pc.design.loops(job)[0].closed.controller
gyro = pc.state_space(pc.linearise(job.platform), gimbals=("9", "10"))
lag = [torquer.lag for torquer in job.platform.torquers[-2:]] + [0.0, 0.0, 0.0]
plant = pc.analysis.sampled(gyro, PERIOD, DELAY, lag)

figure = figures.Omega_sensitivity(plant, {"caged": controller}, limit=0.01).figure
figure.savefig("Omega_sensitivity.png", dpi=150)
