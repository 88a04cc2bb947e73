"""Root locus over the rotors' speed.

The poles of a caged gyro while its rotor runs at 20 to 180 % of its speed and the controller stays as it is. The loop
was tuned at 100 %: below 71 % it is unstable, and a much faster rotor leaves it hardly any damping.
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

figure = figures.root_locus_over_spin(job.platform, ("9", "10"), controller, delay=DELAY).figure
figure.savefig("root_locus_over_spin.png", dpi=150)
