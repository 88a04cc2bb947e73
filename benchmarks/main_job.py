"""Time of the main job as its user waits for it, against its budget: the first time, and with the kernel compiled.

    python benchmarks/main_job.py [--rounds 3]

The first run compiles the simulation kernel into an empty cache; the others find it there.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

JOB = Path(__file__).parent.parent / "examples" / "three_gyro_platform.toml"
FIRST, AFTER = 90.0, 30.0  # s, on two cores


def seconds(folder: Path) -> float:
    """Return how long one run of the command takes, s."""
    command = [sys.executable, "-m", "platform_ctrl", "design", str(JOB), "-o", str(folder / "out"), "--quiet"]
    began = time.perf_counter()
    subprocess.run(
        command, check=True, stdout=subprocess.DEVNULL, env=os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")}
    )
    return time.perf_counter() - began


def main() -> None:
    """Print the times and their share of the budget."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3, help="runs after the first")
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first = seconds(folder)
        after = statistics.median(seconds(folder) for _ in range(rounds))
    for label, time_taken, budget in (("first run", first, FIRST), (f"median of {rounds} after it", after, AFTER)):
        print(f"{label:<20} {time_taken:6.1f} s   {time_taken / budget:5.2f} of {budget:g} s")


if __name__ == "__main__":
    main()
