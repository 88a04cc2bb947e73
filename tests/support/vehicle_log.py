"""The recorded log that jobs of tests name: a rate that is the sum of sines, on a clock that jitters and has a gap.

`python tests/support/vehicle_log.py` writes it to tests/data/fuzz/vehicle.csv.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

FILE = Path(__file__).parents[1] / "data" / "fuzz" / "vehicle.csv"


def vehicle_log() -> str:
    """Return 6 s at 50 Hz without those from 4.0 to 4.3 s, gyros in deg/s, as CSV."""
    k = np.arange(300)
    time = 0.02 * k + 0.002 * np.sin(2.399963 * k)
    gyro_z = 1.5 * np.sin(2 * np.pi * 2.0 * time) + 0.4 * np.sin(2 * np.pi * 11.0 * time + 1.0) + 0.1
    kept = (time < 4.0) | (time > 4.3)
    return "time,gyro_z\n" + "".join(f"{t:.6f},{z:.5f}\n" for t, z in zip(time[kept], gyro_z[kept], strict=True))


if __name__ == "__main__":
    FILE.write_text(vehicle_log(), encoding="utf-8")
