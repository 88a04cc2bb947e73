"""What ``import platform_ctrl`` costs beside ``import numpy``: fresh processes, interleaved rounds, medians.

Run as ``python benchmarks/import_time.py [--rounds N]``. The house rule is a ratio of at most 1.3.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys

MODULES = ("numpy", "platform_ctrl")


def import_seconds(module: str) -> float:
    """Return the seconds that ``import module`` takes in a fresh process, the interpreter's own start left out."""
    code = f"import time; start = time.perf_counter(); import {module}; print(time.perf_counter() - start)"
    return float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Print both medians and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=15, help="fresh processes per module (default 15)")
    rounds = parser.parse_args().rounds

    for module in MODULES:  # byte code and file cache
        import_seconds(module)
    seconds: dict[str, list[float]] = {module: [] for module in MODULES}
    for _ in range(rounds):
        for module in MODULES:
            seconds[module].append(import_seconds(module))

    median = {module: statistics.median(seconds[module]) for module in MODULES}
    for module in MODULES:
        spread = f"{min(seconds[module]) * 1e3:.2f} to {max(seconds[module]) * 1e3:.2f}"
        print(f"import {module:<14} median {median[module] * 1e3:8.2f} ms  ({spread}, {rounds} rounds)")
    print(f"ratio {median['platform_ctrl'] / median['numpy']:.3f}  (limit 1.3)")


if __name__ == "__main__":
    main()
