"""What a campaign's runs follow from, as digests: two campaigns with the same ones have the same runs."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl import __version__

if TYPE_CHECKING:
    from platform_ctrl.campaign.planning import Plan

Identity = dict[str, Any]
# Of the campaign section: on the command line, or shown as numbers of their own.
_APART = ("runs", "seed", "sampling", "step")
_DIGITS = 16
# Libraries that draw and simulate.
_USED = ("numpy", "scipy", "numba")


def identity(plan: Plan) -> Identity:
    """Return everything that decides how a plan's runs come out, in plain types.

    Loops and requirements of the design have no part in it: the controllers are there already.
    """
    job = plan.job
    campaign = job.campaign
    varied = {} if campaign is None else {f.name: getattr(campaign, f.name) for f in dataclasses.fields(campaign)}
    out: Identity = {
        "plant": digest(job.platform),
        "sample period and delay": digest(job.sampling),
        "manoeuvres": digest(job.manoeuvres),
        "faults": digest(job.fault_events),
        "distributions": digest({name: item for name, item in varied.items() if name not in _APART}),
        "controllers": digest(plan.controllers),
        "seed": int(plan.seed),
        "sampling": str(plan.sampling),
        "step": float(plan.step),
    }
    if job.drives:
        out["drives"] = digest(job.drives)
    if plan.sampling == "latin-hypercube":
        out["runs"] = int(plan.runs)  # one more run moves all the others
    return out


def versions() -> dict[str, str]:
    """Return the versions that runs may depend on."""
    return {"platform_ctrl": __version__} | {name: metadata.version(name) for name in _USED}


def digest(item: object) -> str:
    """Return a digest of a value: dataclasses, arrays, state spaces, and what Python has itself."""
    found = hashlib.sha256()
    _feed(found, item)
    return found.hexdigest()[:_DIGITS]


def _feed(found: Any, item: Any) -> None:
    found.update(type(item).__name__.encode() + b":")
    if dataclasses.is_dataclass(item):
        for field in dataclasses.fields(item):
            found.update(field.name.encode() + b"=")
            _feed(found, getattr(item, field.name))
    elif isinstance(item, np.ndarray):
        found.update(f"{item.dtype.str}{item.shape}".encode() + np.ascontiguousarray(item).tobytes())
    elif isinstance(item, Mapping):
        for key in sorted(item):
            _feed(found, key)
            _feed(found, item[key])
    elif isinstance(item, tuple | list):
        found.update(f"{len(item)}".encode())
        for one in item:
            _feed(found, one)
    elif all(hasattr(item, name) for name in ("A", "B", "C", "D", "input_labels", "output_labels")):
        _feed(found, [np.asarray(getattr(item, name), dtype=np.float64) for name in "ABCD"])
        _feed(found, [float(item.dt), list(item.input_labels), list(item.output_labels)])
    else:
        found.update(repr(item).encode())
    found.update(b";")
