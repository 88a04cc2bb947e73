"""What has moved since a baseline.

What a failed regression test saves. Above, every figure's change over its tolerance: within the band it is accepted,
to the right of it worse. Below, the sensitivity of the loop that has changed, as it was accepted and now: a crossover
at 35 Hz instead of 40 Hz costs 12 % of the bandwidth.
"""

import platform_ctrl as pc
from platform_ctrl.report.figures.baseline_changes import moved_figure
from platform_ctrl.verification.baselines import accepted, compare

results = []
for crossover_hz in (40, 35):
    design = {"name": "classical", "method": "classical", "crossover_hz": crossover_hz}
    loop = {"name": "caging 9-10", "kind": "caging", "gimbals": ["9", "10"], "use": "classical", "design": [design]}
    job = pc.read_job(
        {
            "schema": 2,
            "name": "gyro 9-10",
            "plant": "three_gyro_platform",
            "operation": {"Omega": [0.0, 0.0, 0.0]},
            "sampling": {"rate_hz": 2000, "delay": 0.0005},
            "loop": [loop],
        }
    )
    results.append(pc.verification.check_job(job, pc.design.loops(job)))
before, now = results

figure = moved_figure(compare(now, accepted(before)), "gyro 9-10 against its baseline")
