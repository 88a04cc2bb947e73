"""The job with its plant as one TOML text: the exact inputs, which `read_job` reads back to the last bit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from platform_ctrl.common.json_text import plain_types
from platform_ctrl.common.values import replaced
from platform_ctrl.job.budget import Source
from platform_ctrl.job.job import Job
from platform_ctrl.job.reading import SCHEMA as JOB_SCHEMA
from platform_ctrl.job.run_checks import MOTION
from platform_ctrl.job.spectra import LogSpectrum
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.tables import written

# Keys of a plant's parts that a file has beside another one alone: the table, that key, these.
_BESIDE = (
    ("gimbal", "stops", ("restitution",)),
    ("friction", "stribeck_rate", ("breakaway",)),
    ("rotor", "speed_gain", ("speed_integral", "torque_limit")),
)


def job_data(job: Job) -> dict[str, Any]:
    """Return the job as a dict of the job file's structure, with the plant as a table, without default values."""
    data = {"schema": JOB_SCHEMA} | written(job) | {"plant": plant_data(job.platform)}
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
    """Return a source with a log as its spectrum, so that the job needs no other file."""
    spectrum = source.spectrum
    return replaced(source, {"spectrum": spectrum.table}) if isinstance(spectrum, LogSpectrum) else source


def plant_data(platform: Platform) -> dict[str, Any]:
    """Return the plant as a dict of the plant file's structure, without default values."""
    data = {"schema": 1} | written(platform)
    for table, beside, keys in _BESIDE:
        for own in data.get(table, ()):
            for key in keys if beside not in own else ():
                own.pop(key, None)
    return data


# Of a job's file, what controllers do not depend on: they are judged by it, or simulated with it; and texts.
_NOT_DESIGNED = ("schema", "name", "plant", "coupled", "manoeuvre", "fault", "campaign", "budget")


def job_hashes(job: Job) -> dict[str, str]:
    """Return SHA-256 hashes of the plant, of what else the controllers of a job are designed for, and of the whole job.

    They follow from what was read: neither comments nor the names of files count, nor the titles of job and plant.
    """
    data = job_data(job)
    plant = {key: item for key, item in data.pop("plant").items() if key not in ("name", "source")}
    design = {key: item for key, item in data.items() if key not in _NOT_DESIGNED}
    whole = {key: item for key, item in data.items() if key != "name"} | {"plant": plant}
    return {"plant": _hash(plant), "design": _hash(design), "job": _hash(whole)}


def _hash(data: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain_types(data), sort_keys=True).encode()).hexdigest()


def toml(data: Mapping[str, Any], header: str = "") -> str:
    """Return `data` as TOML: plain values first, then tables, then arrays of tables, every number exact."""
    lines, tables = [], []
    for key, item in data.items():
        path = f"{header}.{key}" if header else key
        if isinstance(item, Mapping):
            tables.append(f"\n[{path}]\n{toml(item, path)}" if item else "")
        elif isinstance(item, Sequence) and item and isinstance(item[0], Mapping):
            tables += [f"\n[[{path}]]\n{toml(one, path)}" for one in item]
        elif not (isinstance(item, Sequence) and not isinstance(item, str) and not item):
            lines.append(f"{key} = {_literal(item)}\n")
    return "".join(lines + tables)


def _literal(item: Any) -> str:
    if isinstance(item, bool):
        return "true" if item else "false"
    if isinstance(item, str):
        # JSON's escapes are TOML's.
        return json.dumps(item, ensure_ascii=False)
    if isinstance(item, Sequence):
        return f"[{', '.join(_literal(one) for one in item)}]"
    return repr(item.item() if isinstance(item, np.generic) else item)
