"""Fixed structure beside published norms and the full order: what simplicity costs, and how long it takes.

    python benchmarks/structured.py [--problems AC3,HE4] [--starts 16] [--evaluations 40000]

Static output feedback on problems of COMPleib (tests/data/compleib*.json: numbers, their source and what `best` and
`hifoo` are). Ratios below one are better than the value they are compared with.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import control
import numpy as np

from platform_ctrl.design.fixed_structure.structures import Static
from platform_ctrl.design.fixed_structure.synthesis import structured
from platform_ctrl.errors import PlatformCtrlError

HERE = Path(__file__).parent
PROBLEMS = [HERE.parent / "tests" / "data" / name for name in ("compleib.json", "compleib-hard.json")]
# What a norm may exceed `best` and `hifoo` by.
EXCESS = 1e-3


def compleib(problem: dict[str, Any]) -> control.StateSpace:
    """Return a problem of the file as a plant with inputs [w, u] and outputs [z, y]."""
    A, B1, B2, C1, C2, D11, D12, D21 = (
        np.array(problem[name], dtype=np.float64) for name in ("A", "B1", "B", "C1", "C", "D11", "D12", "D21")
    )
    none = np.zeros((len(C2), B2.shape[1]))
    return control.StateSpace(
        A, np.hstack([B1, B2]), np.vstack([C1, C2]), np.block([[D11, D12], [D21, none]]), remove_useless_states=False
    )


def all_problems() -> dict[str, Any]:
    """Return the problems of both files."""
    return {name: one for path in PROBLEMS for name, one in json.loads(path.read_text())["problems"].items()}


def static_rows(names: list[str], starts: int, evaluations: int) -> bool:
    """Print static output feedback beside the values of the file; return whether all are within the allowed excess."""
    problems = all_problems()
    print(f"{'static gains':<10}{'best':>12}{'hifoo':>10}{'ours':>13}{'over best':>11}{'over hifoo':>11}", end="")
    print(f"{'full order':>12}{'price':>8}{'s':>7}")
    met = True
    for name in names or list(problems):
        problem = problems[name]
        P = compleib(problem)
        nmeas, ncon = len(problem["C"]), len(problem["B"][0])
        began = time.perf_counter()
        try:
            r = structured(P, nmeas, ncon, structure=Static(), starts=starts, evaluations=evaluations)
        except PlatformCtrlError as error:
            print(f"{name:<10}{error}")
            met = False
            continue
        taken = time.perf_counter() - began
        best, hifoo = problem["best"] or float("nan"), problem.get("hifoo", float("nan"))
        print(f"{name:<10}{best:>12.8g}{hifoo:>10.6g}{r.gamma:>13.8g}{r.gamma / best - 1:>11.1e}", end="")
        print(f"{r.gamma / hifoo - 1:>11.1e}{r.gamma_optimal:>12.6g}{r.price:>8.3f}{taken:>7.1f}", flush=True)
        met = met and not r.gamma > (1.0 + EXCESS) * min(best, hifoo if hifoo == hifoo else best)
    return met


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--problems", default="", help="names of COMPleib problems, with commas; default all in the file"
    )
    parser.add_argument("--starts", type=int, default=16, help="starts of a problem")
    parser.add_argument("--evaluations", type=int, default=40000, help="of all starts of a problem")
    chosen = parser.parse_args()
    met = static_rows([name for name in chosen.problems.split(",") if name], chosen.starts, chosen.evaluations)
    print(f"\n{'every' if met else 'not every'} target met")


if __name__ == "__main__":
    main()
