"""The equations as a record that JSON can hold; its expressions are strings that SymPy reads."""

from __future__ import annotations

from typing import Any

from platform_ctrl.symbolic.notation import CODE, Notation
from platform_ctrl.symbolic.result import Equations
from platform_ctrl.symbolic.sections import sides

SCHEMA = 1
_VECTORS = ("q", "rates", "accelerations", "Omega", "Omega_dot", "velocity", "forces", "L")
_MATRICES = ("B0", "B_A", "A_R", "A", "BtA_RB", "A_star", "G_A", "G_R", "G_root")


def record_of(equations: Equations) -> dict[str, Any]:
    """Return the record."""
    write = Notation(equations.symbols, CODE)
    torques = list(equations.forces)[3:]

    def rows(key: str) -> list[dict[str, Any]]:
        out = []
        for gimbal, terms, torque in zip(equations.platform.gimbal_names, equations.rows[key], torques, strict=True):
            left, right = sides(terms, torque, write)
            listed = [{"coefficient": write(c), "variable": write(v)} for c, v in terms]
            out.append({"gimbal": gimbal, "left": left, "right": right, "terms": listed})
        return out

    return {
        "schema": SCHEMA,
        "platform": equations.platform.name,
        "order": equations.order,
        "terms": equations.terms,
        "symbols": [
            {"name": s.name, "text": s.text, "latex": s.latex, "meaning": s.meaning, "unit": s.unit, "value": s.value}
            for s in equations.symbols
        ],
        "vectors": {key: [write(x) for x in getattr(equations, key)] for key in _VECTORS},
        "matrices": {
            key: [[write(matrix[i, j]) for j in range(matrix.cols)] for i in range(matrix.rows)]
            for key, matrix in ((key, getattr(equations, key)) for key in _MATRICES)
        },
        "equations": {key: rows(key) for key in equations.rows},
        "groups": [list(group) for group in equations.groups],
        "notes": list(equations.notes),
    }
