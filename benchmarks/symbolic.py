"""Time of the equations in symbols, printed as text, beside their limits: fresh processes, SymPy's import counted.

    python benchmarks/symbolic.py [--rounds 3]

The three-gyro platform, and a random tree of eight gimbals and four rotors with axes and inertias in no special place.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time

import numpy as np

from platform_ctrl.plant.gimbals import Gimbal, Rotor
from platform_ctrl.plant.platform import Platform

GIMBALS, ROTORS = 8, 4

# Name, limit in s (None: for comparison), what runs.
CASES: tuple[tuple[str, float | None, str], ...] = (
    ("three gyros", 5.0, "equations(read_platform('three_gyro_platform'))"),
    ("three gyros, exact terms", 5.0, "equations(read_platform('three_gyro_platform'), terms='exact')"),
    ("three gyros, sines and cosines", None, "equations(read_platform('three_gyro_platform'), order=None)"),
    ("8 gimbals, 4 rotors", 60.0, "equations(tree(8))"),
    ("8 gimbals, 4 rotors, exact terms", 60.0, "equations(tree(8), terms='exact')"),
    ("8 gimbals in a chain, exact terms", 60.0, "equations(tree(8, chain=True), terms='exact')"),
    ("20 gimbals, 4 rotors", None, "equations(tree(20))"),
)


def tree(gimbals: int, chain: bool = False, seed: int = 0) -> Platform:
    """Return a random tree; the order of the file is that of the tree."""
    rng = np.random.default_rng(seed)

    def unit() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        axis = rng.normal(size=3)
        return np.asarray(axis / np.linalg.norm(axis))

    def inertia(size: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        basis, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        points = rng.uniform(0.2, 1.0, 3) * size
        return np.asarray(basis @ np.diag(points.sum() - points) @ basis.T)

    names = ["base", *(f"g{k}" for k in range(gimbals))]
    parents = [names[k if chain else rng.integers(k + 1)] for k in range(gimbals)]
    return Platform(
        name=f"random tree of {gimbals} gimbals",
        root_name="base",
        root_inertia=inertia(3.0),
        gimbals=tuple(
            Gimbal(name=names[1 + k], parent=parents[k], axis=unit(), inertia=inertia(0.5), angle=f"q{k}")
            for k in range(gimbals)
        ),
        rotors=tuple(
            Rotor(
                name=f"r{k}",
                carrier=names[rng.integers(gimbals + 1)],
                axis=unit(),
                axial_inertia=0.3,
                transverse_inertia=0.2,
                angular_momentum=float(rng.normal() * 20.0),
            )
            for k in range(ROTORS)
        ),
    )


def seconds(expression: str) -> tuple[float, int]:
    """Return how long an expression takes in a fresh process, s, and how many characters it prints."""
    code = (
        "import sys, time; sys.path.insert(0, sys.argv[1]); start = time.perf_counter()\n"
        "from platform_ctrl import read_platform; from platform_ctrl.mechanics.symbolic import equations\n"
        "from symbolic import tree\n"
        f"text = {expression}; print(time.perf_counter() - start, len(text))"
    )
    folder = __file__.rpartition("/")[0] or "."
    done = subprocess.run([sys.executable, "-c", code, folder], check=True, capture_output=True, text=True).stdout
    taken, length = done.split()
    return float(taken), int(length)


def main() -> None:
    """Print the medians and the limits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3, help="fresh processes a case (default 3)")
    rounds = parser.parse_args().rounds
    print(
        f"{'case':<36} {'median':>8}  {'limit':>6}  {'characters':>10}   ({time.strftime('%Y-%m-%d')}, {rounds} rounds)"
    )
    for name, limit, expression in CASES:
        taken = [seconds(expression) for _ in range(rounds)]
        shown = "" if limit is None else f"{limit:g} s"
        print(f"{name:<36} {statistics.median(t for t, _ in taken):6.2f} s  {shown:>6}  {taken[0][1]:>10}", flush=True)


if __name__ == "__main__":
    main()
