"""Bode plot with margins, one torquer at a time.

The loop of each torquer of the caged gyro 9-10 broken while the other stays closed. Where the gain is 1 the phase
margin is written, where the phase is −180° the gain margin; the legend names the disk margin, inside whose disk gain
and phase may change together. The nutation at 75 Hz has no damping of its own: the other loop gives it some.
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

figure = figures.bode(pc.analysis.loop_transfer(plant, controller)).figure
figure.savefig("bode.png", dpi=150)
