"""The job with its plant as the data of one job file: the exact inputs, which `read_job` reads back to the last bit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from platform_ctrl.common.files import plain_types
from platform_ctrl.common.values import replaced
from platform_ctrl.job.budget import Source
from platform_ctrl.job.job import MOTION, Job
from platform_ctrl.job.reading import SCHEMA as JOB_SCHEMA
from platform_ctrl.job.spectra import LogSpectrum
from platform_ctrl.plant.tables import written
from platform_ctrl.plant.writing import plant_data


def job_data(job: Job) -> dict[str, Any]:
    """Return the job as a dict of the job file's structure, with the plant as a table, without default values."""
    data = {"schema": JOB_SCHEMA} | written(job) | {"plant": plant_data(job.platform)}
    # The plant has no gimbal any more that is locked.
    data["operation"] = {key: item for key, item in data["operation"].items() if key != "locked"}
    for own, manoeuvre in zip(data.get("manoeuvre", ()), job.manoeuvres, strict=True):
        # The keys of a motion stand in the file together or not at all.
        keys = MOTION[manoeuvre.mode]
        moved = keys[0] in own
        for key in (*keys, "axis"):
            own.pop(key, None)
            own |= {key: getattr(manoeuvre, key)} if moved else {}
    if job.campaign is not None:
        data["campaign"] = {"seed": job.campaign.seed} | data["campaign"]  # else it would be the job's
    if job.budget is not None:
        data["budget"]["source"] = [written(_without_log(source)) for source in job.budget.sources]
    return data


def _without_log(source: Source) -> Source:
    """Return a source with a log as its spectrum, so that the job needs no other file; in SI where a column is not."""
    spectrum = source.spectrum
    if not isinstance(spectrum, LogSpectrum):
        return source
    table = spectrum.table
    if source.stated_unit is not None:
        table = replaced(table, {"densities": source.factor**2 * table.densities})
    return replaced(source, {"spectrum": table})


# Of a job's file, what controllers do not depend on: they are judged by it, or simulated with it; and texts.
_NOT_DESIGNED = ("schema", "name", "plant", "coupled", "manoeuvre", "fault", "campaign", "budget", "tolerance")


def job_hashes(job: Job) -> dict[str, str]:
    """Return SHA-256 hashes of the plant, of what else the controllers of a job are designed for, and of the whole job.

    They follow from what was read: neither comments nor the names of files count, nor the titles of job and plant.
    """
    data = job_data(job)
    plant = {key: item for key, item in data.pop("plant").items() if key not in ("name", "source")}
    design = {key: item for key, item in data.items() if key not in _NOT_DESIGNED}
    whole = {key: item for key, item in data.items() if key != "name"} | {"plant": plant}
    return {"plant": data_hash(plant), "design": data_hash(design), "job": data_hash(whole)}


def data_hash(data: Mapping[str, Any]) -> str:
    """Return the SHA-256 hash of plain data."""
    return hashlib.sha256(json.dumps(plain_types(data), sort_keys=True).encode()).hexdigest()
