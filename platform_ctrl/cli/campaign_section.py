"""A campaign that was flown already, for the report of the job: judged before the work, counted after it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    import control

    from platform_ctrl.campaign.store import Record
    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.job import Job


def expect_campaign(job: Job, folder: Path) -> Record:
    """Return the record of a campaign of `job` that is done.

    Raises
    ------
    InputError
        There is none in the folder, it is not done, or it is another job's.
    """
    from platform_ctrl.campaign.store import RECORD, TABLE, read_record

    record = read_record(folder)
    if record is None:
        raise InputError(
            f"--campaign {folder}: there is no {RECORD}; expected the folder that platform-ctrl campaign writes"
        )
    if record.get("job") != job.name:
        raise InputError(f"--campaign {folder}: is of the job {record.get('job')!r}; expected one of {job.name!r}")
    if not record.get("complete") or not (folder / TABLE).is_file():
        raise InputError(f"--campaign {folder}: is not done; the command that began it goes on: platform-ctrl campaign")
    return record


def counted(job: Job, controllers: Sequence[control.StateSpace], folder: Path) -> Summary:
    """Return what the campaign in a folder came to.

    Raises
    ------
    InputError
        It was flown with another plant, other controllers, or anything else that decides how its runs come out.
    """
    from platform_ctrl.campaign.plan import plan
    from platform_ctrl.campaign.rerun import settings_of, strangers
    from platform_ctrl.campaign.store import TABLE
    from platform_ctrl.campaign.summary import summarised

    record = expect_campaign(job, folder)
    made = plan(job, controllers, **settings_of(record))
    odd = strangers(record, made)
    if odd:
        raise InputError(
            f"--campaign {folder}: was flown with {'; '.join(odd)}; fly it again with platform-ctrl campaign, or leave "
            "it out"
        )
    return summarised(made, folder / TABLE)


def run_again(job: Path, controllers: Path, folder: Path) -> str:
    """Return the command that flies a run of the campaign again, without the run's number."""
    command = ["platform-ctrl", "simulate", job, "--controllers", controllers, "-o", folder, "--run"]
    return shlex.join(map(str, command))
