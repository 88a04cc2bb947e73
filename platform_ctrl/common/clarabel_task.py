"""What the solver's process runs; in `common`, whose import loads no other package: the process starts fast."""

from __future__ import annotations

from typing import Any

import clarabel
from scipy.sparse import csc_matrix


def clarabel_solution(request: dict[str, Any]) -> dict[str, Any]:
    """Minimise ½ x'Px + q'x subject to b − A x in the product of `cones`; P is upper triangular."""
    try:
        return _solution(request)
    except BaseException as error:  # a panic of the solver is no Exception
        return {"status": "NumericalError", "error": f"{type(error).__name__}: {error}"}


def _solution(request: dict[str, Any]) -> dict[str, Any]:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name, setting in request["settings"].items():
        setattr(settings, name, setting)
    cones = [getattr(clarabel, kind)(*arguments) for kind, arguments in request["cones"]]
    P, A = (csc_matrix(parts, shape=shape) for parts, shape in (request["P"], request["A"]))
    solution = clarabel.DefaultSolver(P, request["q"], A, request["b"], cones, settings).solve()
    return {
        "status": str(solution.status),
        "x": list(solution.x),
        "z": list(solution.z),
        "obj_val": solution.obj_val,
        "iterations": solution.iterations,
        "solve_time": solution.solve_time,
    }
