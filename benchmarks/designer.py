"""How long the designer's pictures take, slider by slider, beside the limit of 100 ms; --soak: whether memory grows.

python benchmarks/designer.py                    the loops of examples/three_gyro_platform.toml
python benchmarks/designer.py JOB.toml --soak    an hour's slider moves, one after another, and the memory they leave
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import statistics
import sys
import time
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from platform_ctrl.app.backend import Backend  # noqa: E402  # threads are pinned before it is loaded
from platform_ctrl.app.settings import Settings, Slider  # noqa: E402
from platform_ctrl.errors import PlatformCtrlError  # noqa: E402

LIMIT = 0.100
REPEATS = 9
JOB = Path(__file__).parent.parent / "examples" / "three_gyro_platform.toml"
# Slider moves of an hour: about one a second.
MOVES = 4000


def moved(bench: Backend, settings: Settings, slider: Slider, share: float) -> Settings:
    """Return the settings with a slider about `share` away from where it stands."""
    at = slider.value * (1.0 + share) if slider.value else share * (slider.high - slider.low)
    return bench.moved(settings, slider.name, at)


def timed(bench: Backend, settings: Settings, slider: Slider) -> tuple[float, float, float]:
    """Return the median and the largest wall time of a picture after a move, and the median processor time, s."""
    wall, busy = [], []
    bench.picture(moved(bench, settings, slider, 0.005))
    for k in range(REPEATS):
        now = moved(bench, settings, slider, 0.01 + 0.003 * k)
        begun = time.process_time()
        wall.append(bench.picture(now).elapsed)
        busy.append(time.process_time() - begun)
    return statistics.median(wall), max(wall), statistics.median(busy)


def times(bench: Backend) -> bool:
    """Print the times of every kind of move and return whether all medians keep the limit."""
    kept = True
    for loop in (one.name for one in bench.read.loops):
        settings = bench.start(loop)
        first = bench.picture(settings)
        plants = len(bench.choices(settings)["plant"])
        print(f"{loop}: {plants} plants, band on; first picture {1e3 * first.elapsed:.0f} ms")
        print(f"  {'move':24} {'median':>9} {'largest':>9} {'processor':>10} {'limit':>9}")
        rows = [(slider.name, slider) for slider in bench.sliders(settings) if not slider.background]
        for name, slider in rows:
            median, largest, busy = timed(bench, settings, slider)
            kept &= median <= LIMIT
            print(
                f"  {name:24} {1e3 * median:6.0f} ms {1e3 * largest:6.0f} ms {1e3 * busy:7.0f} ms {1e3 * LIMIT:6.0f} ms"
                f"{'' if median <= LIMIT else '  beyond'}"
            )
        acts(bench, settings)
    return kept


def acts(bench: Backend, settings: Settings) -> None:
    """Print the time of what follows a gesture instead of a slider."""
    bench.picture(settings)
    begun = time.perf_counter()
    bench.influence(settings)
    print(f"  {'influence':24} {1e3 * (time.perf_counter() - begun):6.0f} ms")


def resident() -> float:
    """Return the memory of this process, MB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def soak(bench: Backend, moves: int) -> bool:
    """Move sliders at random and return whether the memory stays: within 5 % after a tenth of the moves."""
    draw = random.Random(7)
    loops = [one.name for one in bench.read.loops]
    states = {loop: bench.start(loop) for loop in loops}
    refused, first = 0, 0.0
    for k in range(moves):
        loop = draw.choice(loops)
        settings = states[loop]
        slider = draw.choice([one for one in bench.sliders(settings) if not one.background])
        try:
            now = moved(bench, settings, slider, draw.uniform(-0.1, 0.1))
            now = now.but(band=draw.random() < 0.5)
            bench.picture(now)
        except PlatformCtrlError:
            refused += 1
            continue
        # Back to the start now and then: a random walk ends in loops that are of no use.
        states[loop] = bench.start(loop) if k % 50 == 0 else now
        if k == moves // 10:
            gc.collect()
            first = resident()
        if k % max(1, moves // 10) == 0:
            print(f"  {k:6} moves, {resident():7.1f} MB, {refused} refused")
    gc.collect()
    last = resident()
    print(f"after {moves // 10} moves {first:.1f} MB, after {moves} moves {last:.1f} MB: {last / first - 1.0:+.1%}")
    return last <= 1.05 * first


def main() -> int:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", nargs="?", type=Path, default=JOB)
    parser.add_argument("--soak", action="store_true", help="move sliders and watch the memory")
    parser.add_argument("--moves", type=int, default=MOVES)
    asked = parser.parse_args()
    bench = Backend(asked.job)
    return 0 if (soak(bench, asked.moves) if asked.soak else times(bench)) else 1


if __name__ == "__main__":
    sys.exit(main())
