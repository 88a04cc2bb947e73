"""A simulated run over time.

Gyro 9-10 caged by its torquers while the platform turns about axis 1 with up to 1 rad/s: the exact non-linear plant
with the sampled controller, noise and quantisation. What lies beyond a limit is shaded; gimbal 9 holds L Ω = 0.15 N m.
"""

import platform_ctrl as pc
from platform_ctrl.report import figures

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
    }
)
controller = pc.design.loops(job)[0].closed.controller
turn = pc.simulation.HalfCosine(axis=1, rate=1.0, rise=0.2, hold=0.2)
scenario = pc.simulation.Scenario(platform=job.platform, mode="caged", duration=0.8, delay=0.0005, profile=turn)
run = pc.simulation.simulate(scenario, [controller], period=0.0005)

figure = figures.time_run(run, job.platform, limits={"angle": 0.003, "torque_share": 0.8})
figure.savefig("time_run.png", dpi=150)
