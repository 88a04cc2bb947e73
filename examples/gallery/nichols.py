"""Nichols chart with disk-margin regions.

Nichols plot of the caged gyro's loop, at each torquer with the other closed, and with the gain turned up by half. A
loop with a disk margin of 0.4 stays out of the inner region; the diamonds are where each curve comes closest.
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
gyro = pc.state_space(pc.linearise(job.platform), gimbals=("9", "10"))[["alpha9", "beta10"], ["Q9", "Q10"]]
plant = pc.analysis.sampled(gyro, PERIOD, DELAY, [torquer.lag for torquer in job.platform.torquers[-2:]])
loop = pc.analysis.loop_transfer(plant, controller)

figure = figures.nichols({"nominal": loop, "gain × 1.5": 1.5 * loop}, disk_margins=(0.4, 0.6)).figure
figure.savefig("nichols.png", dpi=150)
