"""Job files: TOML or dict -> Job."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.errors import InputError
from platform_ctrl.job.checks import job_mistakes, variation_mistakes
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.job import (
    Campaign,
    CampaignFault,
    CampaignManoeuvre,
    CoupledLimits,
    DesignSpec,
    Faults,
    Job,
    LoopLimits,
    LoopSpec,
    Manoeuvre,
    Sampling,
    Spread,
)
from platform_ctrl.job.scenario import TimeTable, Vibration
from platform_ctrl.job.tables import (
    CampaignTable,
    FaultTable,
    JobFile,
    LoopTable,
    ManoeuvreTable,
    OmegaTable,
    TorqueTable,
    VaryTable,
    VibrationTable,
)
from platform_ctrl.job.variation import CENTRES, DISTRIBUTION_NUMBERS, Vary
from platform_ctrl.plant.fields import overfull, structure
from platform_ctrl.plant.mistakes import Mistake, report
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.reading import judge_plant, open_plant
from platform_ctrl.plant.source import Document, open_file, open_mapping, path_of

__all__ = ["read_job"]


def manoeuvre(table: ManoeuvreTable) -> Manoeuvre:
    """Return a manoeuvre; what moves nothing is zero."""
    return Manoeuvre(
        name=table.name,
        mode=table.mode,
        axis=table.axis or 1,
        duration=table.duration,
        rate=table.rate or 0.0,
        rise=table.rise or 0.0,
        hold=table.hold or 0.0,
        torque=table.torque or 0.0,
        Omega_table=None if table.Omega_table is None else _time_table(table.Omega_table),
        torque_table=None if table.torque_table is None else _time_table(table.torque_table),
        vibrations=tuple(_vibration(one) for one in table.vibration),
        faults=table.faults,
        initial=dict(table.initial.model_extra or {}),
        limits=table.limits.model_dump(exclude_none=True),
    )


def _time_table(table: OmegaTable | TorqueTable) -> TimeTable:
    columns = (
        (table.Omega1, table.Omega2, table.Omega3) if isinstance(table, OmegaTable) else (table.M1, table.M2, table.M3)
    )
    still = (0.0,) * len(table.t)
    values = np.array([still if column is None else column for column in columns]).T
    return TimeTable(t=np.array(table.t), values=values, smooth=table.smooth)


def _vibration(table: VibrationTable) -> Vibration:
    return Vibration(
        kind=table.kind,
        axis=table.axis,
        frequencies_hz=np.array(table.frequencies_hz),
        densities=np.array(table.densities),
        lines=table.lines,
    )


def fault(table: FaultTable) -> Fault:
    """Return a fault; numbers that its kind does not need keep their defaults."""
    given = table.model_dump(exclude_none=True)
    return Fault(**({"until": math.inf} | given))


def campaign(table: CampaignTable, seed: int) -> Campaign:
    """Return the campaign; `seed` is the job's own."""
    return Campaign(
        runs=table.runs,
        seed=seed if table.seed is None else table.seed,
        sampling=table.sampling,
        step=table.step,
        manoeuvres=tuple(CampaignManoeuvre(name=one.name, weight=one.weight) for one in table.manoeuvre),
        vary=tuple(_vary(one) for one in table.vary),
        faults=tuple(CampaignFault(fault=one.fault, probability=one.probability) for one in table.fault),
    )


def _vary(table: VaryTable) -> Vary:
    numbers = {}
    for key in DISTRIBUTION_NUMBERS[table.distribution]:
        number = getattr(table, key)
        # What is needed was looked for; a centre that is left out is that of factors.
        numbers[key] = 1.0 if number is None and key in CENTRES else number
    return Vary(
        parameter=table.parameter,
        distribution=table.distribution,
        numbers=numbers,
        values=table.values or (),
        weights=table.weights or (),
        relative=table.relative,
    )


def read_job(
    source: str | os.PathLike[str] | Mapping[str, Any], *, folder: str | os.PathLike[str] | None = None
) -> Job:
    """Read a job and the plant that it names.

    Parameters
    ----------
    source
        The path of a TOML file, or a dict of the same structure.
    folder
        Where a relative path of the plant starts: by default the folder of the job file, for a dict the
        current one. The plant may also be a shipped name, or a table with the plant itself.

    Returns
    -------
    Job
        In SI units, with the platform read.

    Raises
    ------
    InputError
        One line: which file, table and key, what was given, what is expected.
    """
    start = None if folder is None else path_of(folder, "a folder")
    if isinstance(source, Mapping):
        document = open_mapping(source, "job given as a dict", start or Path())
    else:
        document = open_file(path_of(source, "the path of a job file or a dict"))
    if crowd := list(overfull(JobFile, document.data)):
        raise report(document.label, document.data, crowd)
    platform, plant_wrong = _plant(document, start or document.folder)
    file, wrong = structure(JobFile, document.data)
    mistakes = [*document.mistakes, *plant_wrong, *job_mistakes(document.data, platform), *wrong]
    if mistakes or file is None or platform is None:
        raise report(document.label, document.data, mistakes)
    job = _job(file, platform)
    if mistakes := list(variation_mistakes(job)):
        raise report(document.label, document.data, mistakes)
    return job


def _plant(document: Document, folder: Path) -> tuple[Platform | None, list[Mistake]]:
    """Return the platform of a job, or None and what is wrong with it, by its place in the job."""
    plant = document.data.get("plant")
    if isinstance(plant, dict):
        platform, mistakes = judge_plant(Document(document.label, plant, [], folder))
        return platform, [Mistake(("plant", *mistake.path), mistake.text) for mistake in mistakes]
    if not isinstance(plant, str) or not plant.strip():
        return None, []
    try:
        of_plant = open_plant(plant, folder)
        platform, mistakes = judge_plant(of_plant)
        if platform is None:
            raise report(of_plant.label, of_plant.data, mistakes)
    except InputError as error:
        return None, [Mistake(("plant",), f"plant: {error}")]
    return platform, []


def _job(file: JobFile, platform: Platform) -> Job:
    return Job(
        name=file.name,
        plant=file.plant if isinstance(file.plant, str) else platform.name,
        platform=platform,
        Omega=file.operation.Omega,
        Omega_grid=file.operation.Omega_grid,
        spread=Spread(**file.spread.model_dump()),
        faults=Faults(**file.faults.model_dump()),
        sampling=Sampling(period=1.0 / file.sampling.rate_hz, delay=file.sampling.delay),
        loops=tuple(_loop(table) for table in file.loop),
        coupled=CoupledLimits(**file.coupled.model_dump()),
        manoeuvres=tuple(manoeuvre(table) for table in file.manoeuvre),
        seed=file.operation.seed,
        fault_events=tuple(fault(table) for table in file.fault),
        campaign=None if file.campaign is None else campaign(file.campaign, file.operation.seed),
    )


def _loop(table: LoopTable) -> LoopSpec:
    return LoopSpec(
        name=table.name,
        kind=table.kind,
        gimbals=table.gimbals,
        designs=tuple(
            DesignSpec(
                name=design.name,
                method=design.method,
                options=dict(design.model_extra or {}),
                tune=design.tune,
                structure=design.structure,
            )
            for design in table.design
        ),
        use=table.use,
        limits=LoopLimits(**table.limits.model_dump()),
        soft=LoopLimits(**table.soft.model_dump()),
    )
