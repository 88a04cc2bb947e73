"""Designs of an earlier command in the same folder, taken over where nothing that they depend on has changed.

Only controllers with their options and claims are kept, the newest of each design of the job; what is said about their
loops is computed again.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import pickle
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl import __version__
from platform_ctrl.analysis.system import System
from platform_ctrl.common.files import write_whole
from platform_ctrl.design.loop import Design
from platform_ctrl.design.method import LoopProblem
from platform_ctrl.errors import InputError
from platform_ctrl.job.reading import data_hash

FILE = "designs.json"
_PACKAGES = ("numpy", "scipy", "cvxpy", "clarabel", "control")

Kept = dict[str, Any]


def kept_in(folder: Path | None) -> Mapping[str, Kept]:
    """Return what is kept in a folder by `key_of`; nothing where there is no such file, or it is damaged."""
    if folder is None:
        return {}
    try:
        found = json.loads((folder / FILE).read_text(encoding="utf-8"))
        return {str(key): one for key, one in found["designs"].items()} if found["hash"] == _hash(found) else {}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return {}


def keep(folder: Path, designs: Iterable[tuple[str, Design]]) -> None:
    """Write designs, each with its key, to a folder in place of those that it holds; without them if that fails."""
    kept = {key: _kept(design) for key, design in designs}
    try:
        write_whole(folder / FILE, json.dumps({"designs": kept, "hash": _hash({"designs": kept})}))
    except InputError:
        return


def key_of(problem: LoopProblem, code: str) -> str | None:
    """Return a hash of all that a design depends on, `code` that makes it among it; None where it is made at once."""
    if problem.plant_set is None:
        return None
    # Whether it is the design that is closed decides on some of its claims.
    spec = dataclasses.replace(problem.spec, designs=(problem.design,), use=problem.design.name)
    closed, sampling = problem.spec.use == problem.design.name, problem.job.sampling
    parts = (code, spec, closed, sampling, problem.model, problem.directions, problem.plant_set)
    return hashlib.sha256(pickle.dumps(parts)).hexdigest()


def taken_over(problem: LoopProblem, kept: Kept) -> Design | None:
    """Return a design that is kept, not measured yet; None where what is kept is no whole design."""
    name = f"{problem.spec.name}, {problem.design.name}"
    try:
        A, B, C, D = (np.array(kept[name], dtype=np.float64).reshape(kept["shapes"][name]) for name in "ABCD")
        K = System(A, B, C, D, kept["dt"]).to_control(kept["inputs"], kept["outputs"], name=name)
        options, claims = dict(kept["options"]), dict(kept["claims"])
    except (LookupError, TypeError, ValueError):
        return None
    return Design(
        loop=problem.spec.name,
        name=problem.design.name,
        method=problem.design.method,
        controller=K,
        options=options,
        claims=claims,
        plants=problem.plant_set,
        directions=problem.channel,
    )


def _kept(design: Design) -> Kept:
    K = design.controller
    matrices = {name: np.asarray(getattr(K, name)) for name in "ABCD"}
    return {
        **{name: matrix.ravel().tolist() for name, matrix in matrices.items()},
        "shapes": {name: list(matrix.shape) for name, matrix in matrices.items()},
        "dt": float(K.dt),
        "inputs": list(K.input_labels),
        "outputs": list(K.output_labels),
        "options": dict(design.options),
        "claims": dict(design.claims),
    }


def _hash(found: Mapping[str, Any]) -> str:
    return data_hash({"designs": found["designs"]})


def code_hash() -> str:
    """Return a hash of the package's own code and the versions of what it computes with."""
    found = hashlib.sha256(repr([__version__, *(metadata.version(name) for name in _PACKAGES)]).encode())
    root = Path(__file__).parents[1]
    for layer in ("design", "job", "analysis", "mechanics", "plant", "common"):
        for file in sorted((root / layer).rglob("*.py")):
            found.update(file.read_bytes())
    return found.hexdigest()
