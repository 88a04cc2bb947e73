"""Job files: TOML or dict -> Job."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from platform_ctrl.common.values import replaced
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.budget_checks import size_mistakes, with_logs
from platform_ctrl.job.campaign_checks import variation_mistakes
from platform_ctrl.job.checks import job_mistakes, locked_mistakes
from platform_ctrl.job.exercised import unexercised
from platform_ctrl.job.job import Job
from platform_ctrl.job.methods import METHODS, resolved
from platform_ctrl.plant.fields import PLANT, Expected, Unfit
from platform_ctrl.plant.locking import with_locked
from platform_ctrl.plant.mistakes import Mistake, listed, one_line, report
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.reading import judge_plant, open_plant
from platform_ctrl.plant.source import Document, open_file, open_mapping, path_of, read_text
from platform_ctrl.plant.tables import Key, made, overfull, read_table, shape

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
    keys={
        "schema": Key(_SCHEMA, "schema", needed=True),
        "plant": Key(PLANT, "plant", needed=True),
    }
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
    if crowd := list(overfull(JOB_FILE, document.data)):
        raise report(document.label, document.data, crowd)
    platform, plant_wrong = _plant(document, start or document.folder)
    read, wrong = read_table(JOB_FILE, document.data)
    mistakes = [*document.mistakes, *plant_wrong, *(_with_names(one, platform, document.data) for one in wrong)]
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
    mistakes = [*of_responses, *variation_mistakes(job)]
    if job.budget is not None:
        budget, of_logs = with_logs(job.budget, start or document.folder)
        mistakes += of_logs or size_mistakes(budget)
        job = replaced(job, {"budget": budget})
    if mistakes := mistakes or list(unexercised(job)):
        raise report(document.label, document.data, mistakes)
    return job


def _with_names(mistake: Mistake, platform: Platform | None, job: Mapping[str, Any]) -> Mistake:
    """Return a mistake in a list of names with the names that there are, found when it is reported."""
    if platform is None or not mistake.path:
        return mistake
    faults = job.get("fault", [])
    known = {
        "gimbals": platform.gimbal_names,
        "sensors": [one.name for one in platform.sensors],
        "torquers": [one.name for one in platform.torquers],
        "faults": [one["name"] for one in faults if isinstance(one, dict) and isinstance(one.get("name"), str)],
    }.get(str(mistake.path[-1]))

    def words() -> str:
        return f"{mistake.words}; {listed(known or ())}" if "a list of names" in mistake.words else mistake.words

    return Mistake(mistake.path, words) if known else mistake


def _plant(document: Document, folder: Path) -> tuple[Platform | None, list[Mistake]]:
    """Return the platform of a job, or None and what is wrong with it, by its place in the job."""
    plant = document.data.get("plant")
    kind: type[Platform] = type(plant) if isinstance(plant, Platform) else Platform
    if isinstance(plant, Platform):
        plant = document.data["plant"] = open_plant(plant, folder).data
    if isinstance(plant, dict):
        platform, mistakes = judge_plant(Document(document.label, plant, [], folder), kind)
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

    What has more than one line is such a text already, as in a job that was written with all its inputs.
    """
    mistakes: list[Mistake] = []
    loops = []
    for i, spec in enumerate(job.loops):
        designs = []
        for k, design in enumerate(spec.designs):
            given_text, judge = design.responses, METHODS[design.method].responses
            if given_text is not None and judge is not None:
                try:
                    inside = "\n" in given_text
                    label = "the text" if inside else one_line(str(folder / given_text))
                    text = given_text if inside else read_text(folder / given_text, "a CSV file")
                    resolved(judge)(job, spec, design, text, label)
                    design = replaced(design, {"responses": text})
                except (InputError, ArgumentError) as error:
                    mistakes.append(Mistake(("loop", i, "design", k, "responses"), f"responses: {error}"))
            designs.append(design)
        loops.append(replaced(spec, {"designs": tuple(designs)}))
    return replaced(job, {"loops": tuple(loops)}), mistakes
