"""The CAREX and DAREX collections of Riccati equations: residuals and refusals beside SciPy's and slycot's.

    python benchmarks/riccati.py [--large]

39 examples with their default parameters (tests/support/riccati_examples.py); `--large` adds the one of 421 states,
half a minute. The residual is relative to the largest term of the equation in the units of the example, computed in 40
digits up to 30 states, else in the platform's long doubles; "error" is relative to the published solution, where there
is one; times are of one call, ms. What is refused has its reason below the table. Slycot: sb02od, which needs no
inverse of R, and sb02mt with sb02md.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import importlib.util
import os
import platform
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import mpmath
import numpy as np
from scipy.linalg import solve_continuous_are, solve_discrete_are

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design import lqr
from platform_ctrl.errors import PlatformCtrlError

SUPPORT = Path(__file__).parent.parent / "tests" / "support"
LARGE = 20  # of the continuous examples


def examples(large: bool) -> list[Any]:
    """Return all examples, but the largest on request alone."""
    sys.path.insert(0, str(SUPPORT))
    collections = importlib.import_module("riccati_examples")
    continuous = [collections.carex(k) for k in range(1, 21) if large or k != LARGE]
    return [*continuous, *(collections.darex(k) for k in range(1, 20))]


def ours(example: Any) -> FloatArray:
    """Solve by `design.lqr`, with all that it judges."""
    n, m = example.B.shape
    plant = control.StateSpace(
        example.A, example.B, np.eye(n), np.zeros((n, m)), float(example.discrete), remove_useless_states=False
    )
    return lqr(plant, example.Q, example.R, example.N).X


def scipys(example: Any) -> FloatArray:
    """Solve by SciPy."""
    solve = solve_discrete_are if example.discrete else solve_continuous_are
    return np.asarray(solve(example.A, example.B, example.Q, example.R, s=example.N), dtype=np.float64)


def slycots(example: Any) -> FloatArray:
    """Solve by slycot's sb02od."""
    slycot = importlib.import_module("slycot")
    n, m = example.B.shape
    cross = example.N if np.any(example.N) else None
    kind = "D" if example.discrete else "C"
    return np.asarray(slycot.sb02od(n, m, example.A, example.B, example.Q, example.R, kind, L=cross)[0])


def slycots_schur(example: Any) -> FloatArray:
    """Solve by slycot's sb02mt and sb02md."""
    slycot = importlib.import_module("slycot")
    n, m = example.B.shape
    B, N = example.B.copy(), example.N.copy()
    if np.any(N):
        A, _, Q, _, _, _, G = slycot.sb02mt(
            n, m, B, example.R.copy(), A=example.A.copy(), Q=example.Q.copy(), L=N, jobl="N"
        )[:7]
    else:
        A, Q, G = example.A, example.Q, slycot.sb02mt(n, m, B, example.R.copy())[-1]
    return np.asarray(slycot.sb02md(n, A.copy(), G, Q.copy(), "D" if example.discrete else "C")[0])


def residual(example: Any, X: FloatArray) -> float:
    """Return the residual over the largest of the equation's terms."""
    many = len(X) > 30
    convert: Callable[[FloatArray], Any] = (
        (lambda item: item.astype(np.longdouble)) if many else (lambda item: mpmath.matrix(item.tolist()))
    )
    with mpmath.workdps(40):
        A, B, Q, R, N, P = (convert(item) for item in (*example[1:6], X))
        times: Callable[[Any, Any], Any] = (lambda a, b: a @ b) if many else (lambda a, b: a * b)
        PA, PB = times(P, A), times(P, B)
        if example.discrete:
            terms, cross, weight = [times(A.T, PA), -P, Q], times(A.T, PB) + N, R + times(B.T, PB)
        else:
            terms, cross, weight = [times(A.T, P), PA, Q], PB + N, R
        right = np.linalg.solve(weight.astype(np.float64), cross.T.astype(np.float64)) if many else None
        right = times(mpmath.inverse(weight), cross.T) if right is None else right.astype(np.longdouble)
        terms.append(-times(cross, right))
        total = terms[0] + terms[1] + terms[2] + terms[3]
        norms = [float(np.linalg.norm(np.array(item.tolist(), dtype=np.float64))) for item in (total, *terms)]
    return norms[0] / max(norms[1:])


def cell(example: Any, solve: Callable[[Any], FloatArray], reasons: list[str]) -> str:
    """Return residual, error and time of one solution, or that it was refused."""
    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            X = solve(example)
    except PlatformCtrlError as error:
        reasons.append(f"{example.name}: {error}")
        return "refused"
    except Exception as error:  # of LAPACK and SLICOT, in whatever words
        return type(error).__name__[:12]
    spent = 1e3 * (time.perf_counter() - start)
    X = 0.5 * (X + X.T)
    if not np.all(np.isfinite(X)):
        return "not finite"
    off = "" if example.X is None else f"{np.linalg.norm(X - example.X) / np.linalg.norm(example.X):.0e}"
    return f"{residual(example, X):.1e} {off:>5} {spent:6.0f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--large", action="store_true", help="CAREX 20 too: 421 states")
    arguments = parser.parse_args()
    sides: dict[str, Callable[[Any], FloatArray]] = {"platform_ctrl": ours, "SciPy": scipys}
    if importlib.util.find_spec("slycot") is not None:
        sides |= {"slycot sb02od": slycots, "slycot sb02md": slycots_schur}
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("numpy", "scipy"))
    print(f"{platform.machine()}, Python {platform.python_version()}, {versions}")
    print(f"{'example':<10}{'n':>4}{'m':>4}  " + "  ".join(f"{name:<22}" for name in sides))
    print(f"{'':<20}" + "  ".join(f"{'residual error   ms':<22}" for _ in sides))
    reasons: list[str] = []
    for example in examples(arguments.large):
        cells = [f"{cell(example, solve, reasons):<22}" for solve in sides.values()]
        print(f"{example.name:<10}{example.B.shape[0]:>4}{example.B.shape[1]:>4}  " + "  ".join(cells), flush=True)
    print("\n".join(["", *reasons]))


if __name__ == "__main__":
    main()
