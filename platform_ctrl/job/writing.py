"""The job with its plant as one TOML text: the exact inputs, which `read_job` reads back to the last bit."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from platform_ctrl.job.budget import Budget
from platform_ctrl.job.faults import FAULT_KINDS, Fault
from platform_ctrl.job.job import Campaign, Job, Manoeuvre
from platform_ctrl.job.reading import SCHEMA as JOB_SCHEMA
from platform_ctrl.job.spectra import LogSpectrum, Spectrum
from platform_ctrl.plant.force_elements import Friction
from platform_ctrl.plant.platform import OMEGA_NAMES, ROOT_TORQUE_NAMES, Platform, Rotor
from platform_ctrl.plant.sensors import ERRORS, Sensor
from platform_ctrl.plant.tables import shape


def job_data(job: Job) -> dict[str, Any]:
    """Return the job as a dict of the job file's structure, with the plant as a table."""
    data: dict[str, Any] = {
        "schema": JOB_SCHEMA,
        "name": job.name,
        "operation": {
            "Omega": job.Omega.tolist(),
            "Omega_grid": job.Omega_grid,
            "seed": job.seed,
            **({"angles": {name: list(values) for name, values in job.angles.items()}} if job.angles else {}),
        },
        "uncertainty": {
            "inertia": job.uncertainty.inertia,
            "spin": job.uncertainty.spin,
            "samples": job.uncertainty.samples,
        },
        "faults": _given(dataclasses.asdict(job.faults)),
        "sampling": {"rate_hz": 1.0 / job.sampling.period, "delay": job.sampling.delay},
        "coupled": _given({"disk_margin": job.coupled.disk_margin, "coupling_cost": job.coupled.coupling_cost}),
        "loop": [],
        "plant": plant_data(job.platform),
    }
    for spec in job.loops:
        soft = dict(spec.soft)
        data["loop"].append(
            {
                "name": spec.name,
                "kind": spec.kind,
                **{key: list(getattr(spec, key)) for key in ("gimbals", "sensors", "torquers") if getattr(spec, key)},
                **_given({"around": spec.around, "rate_hz": spec.rate_hz}),
                "use": spec.use,
                "limits": dict(spec.limits),
                **({"soft": soft} if soft else {}),
                "design": [
                    {
                        "name": d.name,
                        "method": d.method,
                        "tune": d.tune,
                        **_given({"structure": d.structure, "responses": d.responses}),
                        **({} if d.command is None else {"command": _said(d.command)}),
                        **({"sensors": list(d.sensors)} if d.sensors else {}),
                        **({} if d.feedforward is None else {"feedforward": _fields(d.feedforward)}),
                        **d.options,
                    }
                    for d in spec.designs
                ],
            }
        )
    if job.drives:
        data["drive"] = [_said(one) for one in job.drives]
    data["manoeuvre"] = [_manoeuvre_data(manoeuvre) for manoeuvre in job.manoeuvres]
    if job.fault_events:
        data["fault"] = [_fault_data(fault) for fault in job.fault_events]
    if job.campaign is not None:
        data["campaign"] = _campaign_data(job.campaign)
    if job.budget is not None:
        data["budget"] = _budget_data(job.budget)
    return data


def _manoeuvre_data(manoeuvre: Manoeuvre) -> dict[str, Any]:
    own: dict[str, Any] = {"name": manoeuvre.name, "mode": manoeuvre.mode, "axis": manoeuvre.axis}
    own["duration"] = manoeuvre.duration
    if manoeuvre.rate:
        own |= {"rate": manoeuvre.rate, "rise": manoeuvre.rise, "hold": manoeuvre.hold}
    if manoeuvre.torque:
        own["torque"] = manoeuvre.torque
    if manoeuvre.faults:
        own["faults"] = list(manoeuvre.faults)
    for key, table, columns in (
        ("Omega_table", manoeuvre.Omega_table, OMEGA_NAMES),
        ("torque_table", manoeuvre.torque_table, ROOT_TORQUE_NAMES),
    ):
        if table is not None:
            values = dict(zip(columns, table.values.T.tolist(), strict=True))
            own[key] = {"t": table.t.tolist(), **values, "smooth": table.smooth}
    if manoeuvre.initial:
        own["initial"] = dict(manoeuvre.initial)
    if manoeuvre.vibrations:
        own["vibration"] = [_fields(one) for one in manoeuvre.vibrations]
    if manoeuvre.sines:
        own["sine"] = [_fields(one) for one in manoeuvre.sines]
    if manoeuvre.commands:
        own["command"] = [_said(one) for one in manoeuvre.commands]
    if manoeuvre.start != "rest":
        own["start"] = manoeuvre.start
    own |= {key: getattr(manoeuvre, key) for key in ("settle", "fade") if getattr(manoeuvre, key)}
    return own | {"limits": dict(manoeuvre.limits)}


def _fault_data(fault: Fault) -> dict[str, Any]:
    keys = FAULT_KINDS[fault.kind].keys
    own = {key: getattr(fault, key) for key in ("name", "kind", "part", "at", *keys)}
    return {key: item for key, item in own.items() if item is not None and item != math.inf}


def _campaign_data(campaign: Campaign) -> dict[str, Any]:
    return {
        "runs": campaign.runs,
        "seed": campaign.seed,
        "sampling": campaign.sampling,
        "step": campaign.step,
        "manoeuvre": [{"name": one.name, "weight": one.weight} for one in campaign.manoeuvres],
        "vary": [
            {
                "parameter": one.parameter,
                "distribution": one.distribution,
                **one.numbers,
                **({"values": list(one.values)} if one.values else {}),
                **({"weights": list(one.weights)} if one.weights else {}),
                "relative": one.relative,
            }
            for one in campaign.vary
        ],
        "fault": [{"fault": one.fault, "probability": one.probability} for one in campaign.faults],
    }


def _budget_data(budget: Budget) -> dict[str, Any]:
    own = _fields(budget, "limits", "sources", "correlations")
    return {
        **{key: item for key, item in own.items() if item not in ((), None)},
        "limits": _fields(budget.limits),
        "source": [_fields(one, "spectrum") | _fields(_written(one.spectrum)) for one in budget.sources],
        "correlation": [_fields(one) for one in budget.correlations],
    }


def _written(spectrum: Spectrum) -> Spectrum:
    """Return what a source is written as: a log as its spectrum, so that the job needs no other file."""
    return spectrum.table if isinstance(spectrum, LogSpectrum) else spectrum


def plant_data(platform: Platform) -> dict[str, Any]:
    """Return the plant as a dict of the plant file's structure."""
    return {
        "schema": 1,
        "name": platform.name,
        "source": platform.source,
        "root": {
            "name": platform.root_name,
            "inertia": platform.root_inertia.tolist(),
            **({"specific_force": platform.specific_force.tolist()} if platform.specific_force.any() else {}),
        },
        "gimbal": [
            {
                "name": g.name,
                "parent": g.parent,
                "axis": g.axis.tolist(),
                "inertia": g.inertia.tolist(),
                "angle": g.angle,
                **({} if g.stops is None else {"stops": list(g.stops), "restitution": g.restitution}),
            }
            for g in platform.gimbals
        ],
        "rotor": [
            {
                "name": r.name,
                "carrier": r.carrier,
                "axis": r.axis.tolist(),
                "axial_inertia": r.axial_inertia,
                "transverse_inertia": r.transverse_inertia,
                "angular_momentum": r.angular_momentum,
                "control": r.control,
                **(_speed_loop(r) if r.control == "servo" else {}),
            }
            for r in platform.rotors
        ],
        **{
            table: [_part(one) for one in getattr(platform, key.field)]
            for table, key in shape(type(platform)).keys.items()
            if key.array is not None and table not in ("gimbal", "rotor")
            if getattr(platform, key.field) or table not in ("angle_sensor", "attitude_sensor")
        },
        **({} if platform.line_of_sight is None else {"line_of_sight": _part(platform.line_of_sight)}),
    }


def _speed_loop(rotor: Rotor) -> dict[str, Any]:
    own = {"speed_gain": rotor.speed_gain, "speed_integral": rotor.speed_integral, "torque_limit": rotor.torque_limit}
    return _given(own)


def _part(part: Any) -> dict[str, Any]:
    """Return the table of a part: fields that are no keys, such as the names of sensors, follow from the others."""
    apart = {field.name for field in dataclasses.fields(part)} - shape(type(part)).keys.keys()
    if not getattr(part, "added", True):
        apart.add("added")
    if isinstance(part, Sensor):
        # What says nothing is left out, so that a record stays short.
        apart |= {key for key in ("bias", "scale_error", "delay") if not getattr(part, key)}
        apart |= {"frame"} if getattr(part, "body", "") is None else set()
        # What it reads comes first, then how well.
        return dict(sorted(_fields(part, *apart).items(), key=lambda item: item[0] in ERRORS))
    if isinstance(part, Friction) and not math.isfinite(part.stribeck_rate):
        apart |= {"breakaway", "stribeck_rate"}
    return _fields(part, *apart)


def _said(part: Any) -> dict[str, Any]:
    """Return the fields of a part without those that have their default values."""
    return {one.name: x for one in dataclasses.fields(part) if (x := getattr(part, one.name)) != one.default}


def _fields(part: Any, *apart: str) -> dict[str, Any]:
    own = {field.name: getattr(part, field.name) for field in dataclasses.fields(part) if field.name not in apart}
    return _given({key: item.tolist() if isinstance(item, np.ndarray) else item for key, item in own.items()})


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


def _given(data: dict[str, Any]) -> dict[str, Any]:
    return {key: item for key, item in data.items() if item is not None}
