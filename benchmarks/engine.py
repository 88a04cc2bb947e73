"""The engine's figures as ratios: ours beside MuJoCo, python-control with and without slycot, SciPy.

    python benchmarks/engine.py [--only SECTION ...] [--rounds 15] [--wall] [--plain]

Every figure is measured in one process: the sides give their answers, which have to agree, then take turns for a number
of rounds. Shown are median times and the median of the ratios within a round; above 1, ours is faster. Matrix libraries
run on one thread; with `--wall` on as many as they take, and every time is that of a clock on the wall. Needs what the
tests need (`pip install platform_ctrl[test]`); a library that is absent is left out.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

from side_by_side import DisagreementError, Outcome, Section, measured, quantity, versions

PARTS = ("engine_linear", "engine_norms", "engine_kernel", "engine_flights")
PACKAGES = ("numpy", "scipy", "numba", "control", "slycot", "mujoco")
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
HEADER = ("what", "ours", "beside", "theirs", "ratio", "target", "agree to")


def sections() -> dict[str, Section]:
    """Return the sections of the files beside this one, by name."""
    here = Path(__file__).parent
    found: dict[str, Section] = {}
    for part in PARTS:
        if (here / f"{part}.py").is_file():
            found |= importlib.import_module(part).SECTIONS
    return found


def rows(outcome: Outcome) -> list[tuple[str, ...]]:
    """Return an outcome as lines of the table, one for each side that ours was compared with."""
    comparison = outcome.comparison
    first = (comparison.name, quantity(outcome.ours, comparison.unit))
    out: list[tuple[str, ...]] = []
    judged_name = comparison.against or min(outcome.ratios, key=lambda name: outcome.ratios[name], default="")
    for name in comparison.theirs:
        start = ("", "") if out else first
        if name in outcome.failures:
            out.append((*start, name, outcome.failures[name][:40], "", "", ""))
            continue
        target = ""
        if comparison.target is not None and name == judged_name:
            target = f"{comparison.target:g}{'' if outcome.reached else ' not reached'}"
        theirs = quantity(outcome.theirs[name], comparison.unit)
        agreement = "" if out else outcome.agreement
        out.append((*start, name, theirs, f"{outcome.ratios[name]:.3g}", target, agreement))
    return out or [(*first, "", "", "", "", outcome.agreement)]


def show(title: str, lines: list[tuple[str, ...]], plain: bool) -> None:
    """Print a section's table."""
    if plain or not sys.stdout.isatty():
        widths = [max(len(line[k]) for line in (HEADER, *lines)) for k in range(len(HEADER))]
        print(f"\n{title}")
        for line in (HEADER, *lines):
            print("  ".join(word.ljust(width) for word, width in zip(line, widths, strict=True)).rstrip())
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for word in HEADER:
        table.add_column(word, justify="right" if word in ("ours", "theirs", "ratio") else "left")
    for line in lines:
        table.add_row(*line)
    Console().print(table)


def main() -> None:
    """Print the tables; exit code 1 if two sides disagree or a target is not reached."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", default=[], metavar="SECTION", help="its name or the start of it")
    parser.add_argument("--rounds", type=int, default=15, help="interleaved rounds a figure")
    parser.add_argument("--wall", action="store_true", help="time of the wall clock, matrix libraries with threads")
    parser.add_argument("--plain", action="store_true", help="tables without lines, as into a file")
    chosen = parser.parse_args()
    if chosen.rounds < 1:
        parser.error(f"--rounds: given {chosen.rounds}; expected at least 1")
    for name in () if chosen.wall else THREADS:
        os.environ[name] = "1"
    warnings.simplefilter("ignore")
    known = sections()
    wanted = [name for name in known if not chosen.only or any(name.startswith(start) for start in chosen.only)]
    if not wanted:
        parser.error(f"--only: given {chosen.only[0]!r}; expected one of {', '.join(known) or 'none at all'}")
    clock = "wall clock" if chosen.wall else "one thread"
    print(f"{time.strftime('%Y-%m-%d')}, {versions(PACKAGES)}; {clock}; medians of {chosen.rounds} rounds")
    wrong: list[str] = []
    for section in wanted:
        lines: list[tuple[str, ...]] = []
        notes: list[str] = []
        for comparison in known[section]():
            if chosen.wall:
                comparison = replace(comparison, clock="wall")
            try:
                outcome = measured(comparison, chosen.rounds)
            except DisagreementError as error:
                wrong.append(f"{section}, {comparison.name}: {error}")
                continue
            lines += rows(outcome)
            if outcome.note:
                notes.append(f"{comparison.name}: {outcome.note}")
            if outcome.reached is False:
                wrong.append(f"{section}, {comparison.name}: {outcome.judged:.3g} of {comparison.target:g}")
        show(section, lines, chosen.plain)
        for note in notes:
            print(f"  {note}")
    for line in wrong:
        print(f"short: {line}")
    if wrong:
        sys.exit(1)


if __name__ == "__main__":
    main()
