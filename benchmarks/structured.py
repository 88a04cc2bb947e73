"""Fixed structure beside published norms and beside the full order: what simplicity costs, and how long it takes.

    python benchmarks/structured.py [--problems AC3,HE4] [--starts 16] [--evaluations 40000] [--no-static] [--no-pid]

Static output feedback on problems of COMPleib (tests/data/compleib*.json: numbers, their source and what `best` and
`hifoo` are), and PID controllers on the weighted plants of the main job, where the full-order bound is that of the
Riccati route. Ratios below one are better than the value they are compared with.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import control
import numpy as np

from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.fixed_structure.sections import PID
from platform_ctrl.design.fixed_structure.structures import Static
from platform_ctrl.design.fixed_structure.synthesis import structured
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.methods.hinf import WeightedPlant, hinf_options, signal_names, weighted_plant
from platform_ctrl.design.partition import channels
from platform_ctrl.design.plants import loop_plants
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.mechanics.linearisation import linearise

HERE = Path(__file__).parent
JOB = HERE.parent / "examples" / "three_gyro_platform.toml"
PROBLEMS = [HERE.parent / "tests" / "data" / name for name in ("compleib.json", "compleib-hard.json")]
# What a norm may exceed `best` and `hifoo` by, and the share of the full-order norm that a PID may cost.
EXCESS = 1e-3
TARGETS = {("caging 4-5-7", "full PID"): 1.03, ("caging 9-10", "full PID"): 1.05, ("caging 9-10", "cross PI"): 1.20}


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


def job_plants() -> list[tuple[str, control.StateSpace, WeightedPlant, float]]:
    """Return the weighted w-plane plants of the caging loops of the main job, and the period, s."""
    job = read_job(str(JOB))
    model = linearise(job.platform)
    out = []
    for spec in job.loops[:2]:
        plants = loop_plants(job, spec.gimbals)
        channel = channels(model, rows_of(model, spec.gimbals))
        given = next(design for design in spec.designs if design.method == "hinf")
        weighted = weighted_plant(hinf_options(given.options, channel, plants.nutation, plants.period), channel, plants)
        out.append((spec.name, weighted.arrays.to_control(*signal_names(weighted.size)), weighted, plants.period))
    return out


def pid_rows(starts: int, evaluations: int) -> bool:
    """Print PID controllers beside the full order; return whether every target is met."""
    print(
        f"\n{'PID, job':<14}{'structure':<10}{'numbers':>8}{'full order':>12}"
        f"{'ours':>10}{'ratio':>8}{'asked':>7}{'s':>6}"
    )
    met = True
    for name, P, weighted, period in job_plants():
        # The measurement is W_e times the angle's error: the integrator of W_e is that of the PID. A zero at 2/period
        # is a sampled filter that does not wait a sample.
        kept: dict[str, Any] = {"filter_zero": True, "seen_through": (weighted.weight_gain, weighted.weight_rate)}
        early = {f"zero{k + 1}": 2.0 / period for k in range(weighted.size)}
        kinds = {"full PID": PID(fixed=early, **kept)}
        if weighted.size == 2:
            # Cross-axis PI, direct-axis PD, one filter for both: ten numbers.
            tied = (("filter1", "filter2"), ("damping1", "damping2"))
            kinds["cross PI"] = PID(P="full", I="cross", D="diagonal", fixed=early, tied=tied, **kept)
        for kind, structure in kinds.items():
            began = time.perf_counter()
            size = weighted.size
            r = structured(P, size, size, structure=structure, starts=starts, evaluations=evaluations)
            taken = time.perf_counter() - began
            asked = TARGETS[name, kind]
            free = len(r.parameters) - len(structure.fixed) - sum(len(group) - 1 for group in structure.tied)
            print(f"{name:<14}{kind:<10}{free:>8}{r.gamma_optimal:>12.6g}{r.gamma:>10.6g}", end="")
            print(f"{r.price:>8.4f}{asked:>7.2f}{taken:>6.1f}", flush=True)
            met = met and r.price <= asked
    return met


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--problems", default="", help="names of COMPleib problems, with commas; default all in the file"
    )
    parser.add_argument("--starts", type=int, default=16, help="starts of a static problem")
    parser.add_argument("--pid-starts", type=int, default=4)
    parser.add_argument("--evaluations", type=int, default=40000, help="of all starts of a problem")
    parser.add_argument("--no-static", action="store_true")
    parser.add_argument("--no-pid", action="store_true")
    chosen = parser.parse_args()
    met = []
    if not chosen.no_static:
        names = [name for name in chosen.problems.split(",") if name]
        met.append(("static", static_rows(names, chosen.starts, chosen.evaluations)))
    if not chosen.no_pid:
        met.append(("PID", pid_rows(chosen.pid_starts, chosen.evaluations)))
    print("\n" + ", ".join(f"{name}: {'every' if good else 'not every'} target met" for name, good in met))


if __name__ == "__main__":
    main()
