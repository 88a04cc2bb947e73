"""Pole map with damping rays.

The poles of gyro 9-10 without a controller (crosses: undamped nutation at 75 Hz, and precession at rest) and of its
sampled caging loop, carried to the s-plane. The damping ratio of a pole is read off the rays, its frequency off the
arcs.
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
closed = pc.analysis.closed_loop(plant, controller)

figure = figures.pole_map({"gyro alone": gyro, "caged, sampled at 2 kHz": closed}).figure
figure.savefig("pole_map.png", dpi=150)
