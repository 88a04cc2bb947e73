"""Gang of four of two controllers.

What the closed loop makes of disturbing torques and of noise of the pick-offs: the caging controller as designed, and
with half its gain. Less gain lets more disturbance through (P S) and asks for less torque (K S).
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

figure = figures.gang_of_four(plant, {"as designed": controller, "half the gain": 0.5 * controller}, S_limit=3.0).figure
figure.savefig("gang_of_four.png", dpi=150)
