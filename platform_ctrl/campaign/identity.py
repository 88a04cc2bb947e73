"""What a campaign's runs follow from, as hashes: two campaigns with the same ones have the same runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl import __version__
from platform_ctrl.job.writing import data_hash, job_data, job_hashes

if TYPE_CHECKING:
    import control

    from platform_ctrl.campaign.planning import Plan
    from platform_ctrl.job.job import Job

Identity = dict[str, Any]
# Of a job's file, what its runs follow from beside the plant; loops and requirements of the design have no part in it.
_RUN_TABLES = ("sampling", "manoeuvre", "fault", "drive", "campaign")
# Of the campaign section: on the command line, or shown as numbers of their own.
_APART = ("runs", "seed", "sampling", "step")
# Libraries that draw and simulate.
_USED = ("numpy", "scipy", "numba")


def identity(plan: Plan) -> Identity:
    """Return everything that decides how a plan's runs come out, in plain types."""
    out: Identity = {
        **source_hashes(plan.job, plan.controllers),
        "seed": int(plan.seed),
        "sampling": str(plan.sampling),
        "step": float(plan.step),
    }
    if plan.sampling == "latin-hypercube":
        out["runs"] = int(plan.runs)  # one more run moves all the others
    return out | versions()


def source_hashes(job: Job, controllers: Sequence[control.StateSpace]) -> dict[str, str]:
    """Return hashes of the plant, of what else of a job its runs follow from, and of the controllers."""
    tables = {key: item for key, item in job_data(job).items() if key in _RUN_TABLES}
    tables["campaign"] = {key: item for key, item in tables.get("campaign", {}).items() if key not in _APART}
    matrices = [[np.asarray(getattr(one, key), dtype=np.float64) for key in "ABCD"] for one in controllers]
    names = [[float(one.dt), list(one.input_labels), list(one.output_labels)] for one in controllers]
    return {
        "plant": job_hashes(job)["plant"],
        "job": data_hash(tables),
        "controllers": data_hash({"matrices": matrices, "names": names}),
    }


def versions() -> dict[str, str]:
    """Return the versions that runs may depend on."""
    return {"platform_ctrl": __version__} | {name: metadata.version(name) for name in _USED}


def differences(there: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return in words what two campaigns' runs follow from and is not the same."""
    out = []
    for name in dict.fromkeys((*there, *now)):
        before, after = there.get(name), now.get(name)
        if before == after:
            continue
        if name in ("plant", "job"):
            out.append(f"another {name}")
        elif name == "controllers":
            out.append("other controllers")
        elif name != "runs":
            out.append(f"{name} {before} instead of {after}")
        elif before and after:
            words = "a Latin hypercube is made for one number of runs; sobol and random go on"
            out.append(f"{before} runs instead of {after} ({words})")
    return out
