"""What an engineer waits for who changes a number of a job and designs again.

    python benchmarks/daily_loop.py [--before CHECKOUT] [--rounds 3]

Runs `platform-ctrl design` on the shipped job in processes of their own: into an empty folder, again without a change,
after a change of one loop's limit, and from the save of that change to the report where `design --watch`
runs (wall time alone). With --before the same by the package of another checkout, by
turns in the same run. --cold runs each first without anything that is
compiled, in a copy of the package. CPU time is that of the command and of the processes that it started; medians.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[1]
JOB = ROOT / "examples" / "three_gyro_platform.toml"
# One limit of the second loop, met before and after.
LIMIT, CHANGED, AGAIN = (f"Omega_rejection = {limit}\n" for limit in ("0.003", "0.0031", "0.0032"))
_COMMAND = "import sys; from platform_ctrl.cli import main; sys.exit(main())"  # as the installed command does


def started(checkout: Path, folder: Path, job: Path, *options: str, **streams: Any) -> subprocess.Popen[str]:
    """Return a process that designs a job."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-P", "-c", _COMMAND, "design", str(job), "-o", str(folder / "out"), *options]
    return subprocess.Popen(command, env=environment, cwd=folder, text=True, stdout=subprocess.DEVNULL, **streams)


def run(checkout: Path, folder: Path, job: Path, *options: str) -> tuple[float, float]:
    """Return wall and CPU time of a design, s."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    if started(checkout, folder, job, "-q", *options).wait() != 0:
        raise SystemExit(f"{checkout}: design failed")
    wall, after = time.monotonic() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def watched(checkout: Path, folder: Path, job: Path, changed: str) -> tuple[float, float]:
    """Return the wall time from a save of the job to the next report, s."""
    with started(checkout, folder, job, "--watch", stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        _until_it_waits(process.stderr)
        start = time.monotonic()
        job.write_text(changed, encoding="utf-8")
        _until_it_waits(process.stderr)
        wall = time.monotonic() - start
        process.kill()
    return wall, math.nan


def _until_it_waits(lines: IO[str]) -> None:
    for line in lines:
        if line.startswith("waiting"):
            return
    raise SystemExit("design --watch has ended")


def measured(checkout: Path, folder: Path) -> dict[str, tuple[float, float]]:
    """Return wall and CPU time of each case, s."""
    shutil.rmtree(folder / "out", ignore_errors=True)
    changed = folder / "changed.toml"
    first, _, last = JOB.read_text(encoding="utf-8").rpartition(LIMIT)
    changed.write_text(first + CHANGED + last, encoding="utf-8")
    times = {
        "into an empty folder": run(checkout, folder, JOB),
        "again, nothing changed": run(checkout, folder, JOB),
        "one limit of a loop changed": run(checkout, folder, changed),
    }
    if (checkout / "platform_ctrl" / "cli" / "watching.py").exists():
        times["one limit changed, --watch"] = watched(checkout, folder, changed, first + AGAIN + last)
    return times


def cold(checkout: Path, folder: Path) -> tuple[float, float]:
    """Return wall and CPU time of the first design after an installation, s."""
    copy = folder / "installed"
    shutil.rmtree(copy, ignore_errors=True)
    ignored = shutil.ignore_patterns("__pycache__", ".git", ".venv", "tests", "docs")
    for name in ("platform_ctrl", "models"):
        shutil.copytree(checkout / name, copy / name, ignore=ignored)
    return run(copy, folder, JOB)


def main() -> None:
    """Print a table of medians; with two checkouts also the ratio of the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, help="another checkout of this package")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cold", action="store_true")
    given = parser.parse_args()
    checkouts = {"now": ROOT} | ({"before": given.before.resolve()} if given.before else {})
    times: dict[str, dict[str, list[tuple[float, float]]]] = {name: {} for name in checkouts}
    with tempfile.TemporaryDirectory() as folder:
        for name, checkout in checkouts.items():
            if given.cold:
                times[name]["cold"] = [cold(checkout, Path(folder))]
            else:
                run(checkout, Path(folder), JOB)  # what is compiled is there then
        for _ in range(given.rounds):
            for name, checkout in checkouts.items():
                for case, found in measured(checkout, Path(folder)).items():
                    times[name].setdefault(case, []).append(found)
    print(f"{'':30}{'wall':>9}{'CPU':>9}" + (f"{'before':>9}{'CPU':>9}{'ratio':>9}{'CPU':>9}" if given.before else ""))
    for case, rounds in times["now"].items():
        wall, cpu = _medians(rounds)
        line = f"{case:30}{wall:7.1f} s" + ("" if math.isnan(cpu) else f"{cpu:7.1f} s")
        if case in times.get("before", {}):
            old_wall, old_cpu = _medians(times["before"][case])
            line += f"{old_wall:7.1f} s{old_cpu:7.1f} s{wall / old_wall:9.2f}{cpu / old_cpu:9.2f}"
        print(line)


def _medians(rounds: list[tuple[float, float]]) -> tuple[float, float]:
    return statistics.median(wall for wall, _ in rounds), statistics.median(cpu for _, cpu in rounds)


if __name__ == "__main__":
    main()
