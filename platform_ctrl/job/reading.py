"""Job files: TOML or dict -> Job; and back, as data with all inputs, which `read_job` reads to the last bit."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from platform_ctrl.common.files import plain_types
from platform_ctrl.common.values import replaced
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.budget import Source, value_mistakes, with_files
from platform_ctrl.job.checks import job_mistakes, locked_mistakes
from platform_ctrl.job.exercised import unexercised
from platform_ctrl.job.job import Job
from platform_ctrl.job.manoeuvre import MOTION
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.spectra import LogSpectrum
from platform_ctrl.job.variation import campaign_misfits
from platform_ctrl.plant.fields import PLANT, Expected, Unfit
from platform_ctrl.plant.locking import with_locked
from platform_ctrl.plant.mistakes import Mistake, one_line, report
from platform_ctrl.plant.platform import Platform, plant_data
from platform_ctrl.plant.reading import judge_plant, open_plant
from platform_ctrl.plant.source import InputData, open_file, open_mapping, path_of, read_text
from platform_ctrl.plant.tables import Key, made, read_table, shape, written

SCHEMA = 2
_OLDER = "write schema = 2, [uncertainty] in place of [spread], and in limits _worst_case in place of _spread"


def _schema(item: object) -> int:
    if isinstance(item, bool) or item != SCHEMA:
        raise Unfit(_OLDER if item == 1 and not isinstance(item, bool) else "")
    return SCHEMA


_SCHEMA = Expected(f"{SCHEMA}, the format that this version reads", _schema)
# The whole file.
JOB_FILE = dataclasses.replace(
    shape(Job),
    keys={"schema": Key(_SCHEMA, "schema", needed=True), "plant": Key(PLANT, "plant", needed=True)}
    | {**shape(Job).keys},
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
        current one. The plant may also be a shipped name, or a table with the plant itself; in a dict, a `Platform`.

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
    runs = document.data.get("manoeuvre")
    for table in runs if isinstance(runs, list) else ():
        if isinstance(table, dict) and isinstance(table.get("torque"), list):  # else a step on the root
            table["gimbal_torque"] = table.pop("torque")
    platform, plant_wrong = _plant(document, start or document.folder)
    read, wrong = read_table(JOB_FILE, document.data)
    mistakes = [*document.mistakes, *plant_wrong, *wrong]
    if mistakes or platform is None:
        raise report(document.label, document.data, mistakes)
    del read["schema"]
    if not isinstance(read["plant"], str):
        read["plant"] = platform.name
    read = made(read)
    locked = read.get("locked", ())
    if mistakes := locked_mistakes(locked, read["loops"], platform):
        raise report(document.label, document.data, mistakes)
    job = Job(**read, platform=with_locked(platform, locked))
    if mistakes := job_mistakes(job):
        raise report(document.label, document.data, mistakes)
    if job.campaign is not None and "seed" not in document.data["campaign"]:
        job = replaced(job, {"campaign": replaced(job.campaign, {"seed": job.seed})})
    job, of_responses = _with_responses(job, start or document.folder)
    job, of_torques = _with_torques(job, start or document.folder)
    mistakes = [*of_responses, *of_torques, *_variation(job)]
    if job.budget is not None:
        budget, of_files = with_files(job.budget, start or document.folder)
        mistakes += of_files or value_mistakes(budget)
        job = replaced(job, {"budget": budget})
    if mistakes := mistakes or list(unexercised(job)):
        raise report(document.label, document.data, mistakes)
    return job


def _variation(job: Job) -> Iterator[Mistake]:
    """Yield what a campaign varies although the job has no such number, or would not accept what may be drawn."""
    if job.campaign is not None:
        scenarios = [job.scenario(manoeuvre) for manoeuvre, _ in job.campaign_manoeuvres]
        for k, key, line in campaign_misfits(job.campaign.vary, scenarios, job.fault_events):
            yield Mistake(("campaign", "vary", k, key), one_line(line))


def _plant(document: InputData, folder: Path) -> tuple[Platform | None, list[Mistake]]:
    """Return the platform of a job, or None and what is wrong with it, by its place in the job."""
    plant = document.data.get("plant")
    if isinstance(plant, Platform):
        plant = document.data["plant"] = open_plant(plant, folder).data
    if isinstance(plant, dict):
        platform, mistakes = judge_plant(InputData(document.label, plant, [], folder))
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


def _with_responses(job: Job, folder: Path) -> tuple[Job, list[Mistake]]:
    """Return a job with the texts of its files of measured responses, and what is wrong with them.

    An entry of more than one line is such a text already, as in a job that was written with all its inputs.
    """
    mistakes: list[Mistake] = []
    loops = []
    for i, spec in enumerate(job.loops):
        designs = []
        for k, design in enumerate(spec.designs):
            given_text = design.responses
            if given_text is not None:
                try:
                    inside = "\n" in given_text
                    label = "the text" if inside else one_line(str(folder / given_text))
                    text = given_text if inside else read_text(folder / given_text, "a CSV file")
                    read = spec.read_by(design)
                    signals = (job.channels_of(read), job.readings_of(read), job.period_of(spec))
                    METHODS[design.method].expect_responses(text, label, *signals)
                    design = replaced(design, {"responses": text})
                except (InputError, ArgumentError) as error:
                    mistakes.append(Mistake(("loop", i, "design", k, "responses"), f"responses: {error}"))
            designs.append(design)
        loops.append(replaced(spec, {"designs": tuple(designs)}))
    return replaced(job, {"loops": tuple(loops)}), mistakes


def _with_torques(job: Job, folder: Path) -> tuple[Job, list[Mistake]]:
    """Return a job with the numbers of its files of torques on gimbals, and what is wrong with these."""
    mistakes: list[Mistake] = []
    runs = []
    for k, run in enumerate(job.manoeuvres):
        torques = list(run.gimbal_torques)
        for i, one in enumerate(torques):
            try:
                torques[i] = one.read(folder)
            except (InputError, ArgumentError) as error:
                key = "psd" if one.log is None else "log"
                mistakes.append(Mistake(("manoeuvre", k, "gimbal_torque", i, key), f"{key}: {error}"))
        runs.append(replaced(run, {"gimbal_torques": tuple(torques)}) if torques else run)
    return replaced(job, {"manoeuvres": tuple(runs)}), mistakes


def job_data(job: Job) -> dict[str, Any]:
    """Return the job as a dict of the job file's structure, with the plant as a table, without default values."""
    data = {"schema": SCHEMA} | written(job) | {"plant": plant_data(job.platform)}
    # The plant has no gimbal any more that is locked.
    data["operation"] = {key: item for key, item in data["operation"].items() if key != "locked"}
    for own, manoeuvre in zip(data.get("manoeuvre", ()), job.manoeuvres, strict=True):
        # The keys of a motion are written together or not at all.
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

    Comments, names of files and the titles of job and plant do not count.
    """
    data = job_data(job)
    plant = {key: item for key, item in data.pop("plant").items() if key not in ("name", "source")}
    design = {key: item for key, item in data.items() if key not in _NOT_DESIGNED}
    whole = {key: item for key, item in data.items() if key != "name"} | {"plant": plant}
    return {"plant": data_hash(plant), "design": data_hash(design), "job": data_hash(whole)}


def data_hash(data: Mapping[str, Any]) -> str:
    """Return the SHA-256 hash of plain data."""
    return hashlib.sha256(json.dumps(plain_types(data), sort_keys=True).encode()).hexdigest()
