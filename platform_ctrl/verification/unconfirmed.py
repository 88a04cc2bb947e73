"""What a file says of its controllers, held against what was measured and proved anew.

No verdict rests on it: a file may be older than the plant. But what no longer holds, or never did, is told.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.verification.controllers import opened
from platform_ctrl.verification.verdict import JobResult, Proofs

# Figures and plants of the same job, on another machine, agree to this.
_AGREE = 1e-6
# Lines for one design: with a changed matrix hardly any claim holds.
_LINES = 4


def unconfirmed(source: str | os.PathLike[str] | Mapping[str, Any], result: JobResult) -> tuple[str, ...]:
    """Return a line for every claim of a ``result.json`` that `result`, made from its controllers, does not bear out.

    Held against each other are the figures under ``claims`` that belong to the closed loop (``disk_margin``,
    ``damping``), the nominal plant, every bound of a certificate, and every X: with the plant and the controller at
    hand it has to prove its claim. What only the method knows, as ``gamma``, is not.
    """
    data = source if isinstance(source, Mapping) else opened(source)[1]
    designs = [design for outcome in result.loops for design in outcome.designs]
    out: list[str] = []
    for key in ("controllers", "alternatives"):
        for entry in data.get(key) or []:
            design = next((one for one in designs if _is_of(entry, one)), None)
            if design is not None:
                found = list(_of_design(entry, design, result.proofs[design.loop, design.name]))
                more = len(found) - _LINES
                out += found[:_LINES]
                out += [f"{design.loop}, {design.name}: and {more} more of its claims"] if more > 0 else []
    coupled = data.get("coupled")
    if isinstance(coupled, Mapping):
        out += _of_certificates("all loops closed", coupled.get("certificates"), result.proofs["", ""])
    return tuple(out)


def _is_of(entry: Mapping[str, Any], design: LoopDesign) -> bool:
    K = design.controller
    pairs = [(_matrix(entry.get(name)), np.asarray(getattr(K, name))) for name in "ABCD"]
    same = all(item is not None and (np.array_equal(item, M) or item.size == M.size == 0) for item, M in pairs)
    return same and entry.get("outputs") == list(K.output_labels)


def _of_design(entry: Mapping[str, Any], design: LoopDesign, proofs: Proofs) -> Iterator[str]:
    where = f"{design.loop}, {design.name}"
    claims = entry.get("claims")
    if design.measures is not None and isinstance(claims, Mapping):
        found = {"disk_margin": design.measures.disk_margin[0], "damping": design.measures.damping[0]}
        for name, figure in found.items():
            written = claims.get(name, figure)
            if not _agree(written, float(figure)):
                yield f"{where}: {name} is written as {_shown(written)}; it is {figure:.6g}"
    yield from _of_certificates(where, entry.get("certificates"), proofs)


def _of_certificates(where: str, written: object, proofs: Proofs) -> Iterator[str]:
    if not isinstance(written, Mapping) or not isinstance(written.get("list"), list) or not proofs.certificates:
        return
    plant = written.get("plant")
    loop = proofs.certificates[0].loops[0]
    if isinstance(plant, Mapping) and not all(_near(plant.get(name), getattr(loop, name)) for name in "ABCD"):
        yield f"{where}: the certificates are written for another plant than the job's"
        return
    for entry in written["list"]:
        if not isinstance(entry, Mapping):
            yield f"{where}: a certificate must be a table, got {_shown(entry)}"
            continue
        label, claim, bound = entry.get("label"), entry.get("claim"), entry.get("bound")
        made = next((c for c in proofs.certificates if (c.loops[0].label, c.claim) == (label, claim)), None)
        what = f"{where}: certificate of {_shown(claim)}, {_shown(label)}"
        if made is None:
            yield f"{what}: no such claim is proved"
        elif isinstance(bound, bool) or not isinstance(bound, int | float) or not math.isfinite(bound):
            yield f"{what}: its bound is written as {_shown(bound)}"
        elif "X" in entry:
            reason = _refuted(entry, made, float(bound))
            if reason:
                yield f"{what}: not proved by the X that is written: {reason}"
        elif bound > made.bound * (1 + _AGREE) if claim == "stability" else bound < made.bound * (1 - _AGREE):
            yield f"{what}: its bound is written as {bound:.9g}; proved is {made.bound:.9g}"


def _refuted(entry: Mapping[str, Any], made: Certificate, bound: float) -> str:
    X, T = _matrix(entry["X"]), _matrix(entry["coordinates"]) if "coordinates" in entry else None
    if X is None or (T is None and "coordinates" in entry):
        return "it is no matrix of numbers"
    found = Certificate(claim=made.claim, bound=bound, loops=made.loops, X=X, coordinates=T).verify()
    return "" if found.proved else found.reason


def _matrix(rows: object) -> FloatArray | None:
    try:
        out = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return np.atleast_2d(out) if isinstance(rows, Sequence) else None


def _near(rows: object, M: FloatArray) -> bool:
    given = _matrix(rows)
    if given is None or given.size != M.size:
        return False
    size = float(np.abs(M).max(initial=0.0))
    return bool(np.all(np.abs(given.ravel() - M.ravel()) <= 1e-3 * _AGREE * size))


def _agree(written: object, figure: float) -> bool:
    if written is None:
        return not math.isfinite(figure)
    if isinstance(written, bool) or not isinstance(written, int | float):
        return False
    return math.isclose(written, figure, rel_tol=_AGREE, abs_tol=1e-12)


def _shown(item: object) -> str:
    from platform_ctrl.plant.mistakes import given

    return given(item)
