"""What the commands design and check write: the result's file and the report."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from platform_ctrl.cli.job_arguments import PDF, REPORT, RESULT
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    import control

    from platform_ctrl.campaign.store import Record
    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.job.job import Job
    from platform_ctrl.verification import JobResult


def expect_campaign(job: Job, folder: Path) -> Record:
    """Return the record of a campaign of `job` that is done."""
    from platform_ctrl.campaign.store import RECORD, TABLE, read_record

    record = read_record(folder)
    if record is None:
        raise InputError(
            f"--campaign {folder}: there is no {RECORD}; name the folder that platform-ctrl campaign writes"
        )
    if record.get("job") != job.name:
        raise InputError(f"--campaign {folder}: belongs to the job {record.get('job')!r}, not to {job.name!r}")
    if not record.get("complete") or not (folder / TABLE).is_file():
        raise InputError(f"--campaign {folder}: is not complete; the same platform-ctrl campaign continues it")
    return record


def campaign_summary(job: Job, controllers: Sequence[control.StateSpace], folder: Path) -> Summary:
    """Return the statistics of the campaign in a folder."""
    from platform_ctrl.campaign.planning import plan
    from platform_ctrl.campaign.single_run import changed_settings, settings_of
    from platform_ctrl.campaign.store import TABLE

    record = expect_campaign(job, folder)
    made = plan(job, controllers, **settings_of(record))
    odd = changed_settings(record, made)
    if odd:
        raise InputError(
            f"--campaign {folder}: was simulated with {'; '.join(odd)}; repeat it with platform-ctrl campaign, or "
            "leave the option out"
        )
    from platform_ctrl.campaign.summary import summarise

    return summarise(made, folder / TABLE)


def rerun_command(job: Path, controllers: Path, folder: Path) -> str:
    """Return the command that simulates a run of the campaign again, without the run's number."""
    command = ["platform-ctrl", "simulate", job, "--controllers", controllers, "-o", folder, "--run"]
    return shlex.join(map(str, command))


Shown = Callable[[], int]


@dataclass(frozen=True)
class ReportOptions:
    """Options of a report: a PDF, and a section about the campaign in a folder."""

    pdf: bool = False
    campaign: Path | None = None

    @classmethod
    def given(cls, job: Job, pdf: bool, campaign: Path | None) -> ReportOptions:
        """Check the options before the work."""
        if pdf:
            from platform_ctrl.report.pdf import typesetter

            typesetter()
        if campaign is not None:
            expect_campaign(job, campaign)
        return cls(pdf, campaign)

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files that are written."""
        return (RESULT, REPORT, PDF) if self.pdf else (RESULT, REPORT)

    @property
    def words(self) -> list[str]:
        """The options again."""
        campaign = [] if self.campaign is None else ["--campaign", str(self.campaign)]
        return (["--pdf"] if self.pdf else []) + campaign


def write_report(
    result: JobResult,
    folder: Path,
    as_json: bool,
    say: Callable[[str], None],
    command: list[str],
    more: Mapping[str, object] | None = None,
    *,
    extras: ReportOptions,
) -> Shown:
    """Write all files or none; return a function that prints the result and returns the exit code.

    `command` are the words of the command line without the program's name, the job second; `more` is printed as
    JSON beside the content of the result's file. A campaign of other controllers is left out, and is an error at
    the end.
    """
    from platform_ctrl.cli.atomic_output import written_together
    from platform_ctrl.cli.terminal import show_result
    from platform_ctrl.common.json_text import json_text
    from platform_ctrl.report import prepared, write_page, write_pdf
    from platform_ctrl.verification.records import result_record, write_record

    record = result_record(result)
    about: dict[str, Any] = {"command": shlex.join(["platform-ctrl", *command, *extras.words])}
    refused: InputError | None = None
    if extras.campaign is not None:
        say(f"reading the campaign: {extras.campaign}")
        try:
            about |= _campaign(result, record, extras.campaign, Path(command[1]), folder / RESULT)
        except InputError as error:
            refused = InputError(f"{error}; the report in {folder} was written without it")
    say(f"drawing the report: {folder / REPORT}")
    with written_together(folder) as unfinished:
        write_record(record, unfinished / RESULT)
        content = prepared(result, **about)
        write_page(content, unfinished / REPORT)
        if extras.pdf:
            say(f"setting the report: {folder / PDF}")
            write_pdf(content, unfinished / PDF)

    def show() -> int:
        if as_json:
            typer.echo(json_text({**record, **(more or {})}))
        else:
            show_result(result)
            files = ", ".join(str(folder / name) for name in (REPORT, PDF) if name in extras.files)
            typer.echo(f"report: {files}, values: {folder / RESULT}")
        if refused is not None:
            raise refused
        if not extras.pdf and (folder / PDF).exists():
            typer.echo(f"{folder / PDF}: is of an earlier run; --pdf writes a new one", err=True)
        return 0 if result.passed else 1

    return show


def _campaign(
    result: JobResult, record: Mapping[str, Any], campaign: Path, job: Path, controllers: Path
) -> dict[str, Any]:
    from platform_ctrl.verification.controllers import read_controllers

    # As a campaign reads them, from the record: the same numbers in the same order.
    summary = campaign_summary(result.job, read_controllers(record, result.job), campaign)
    return {"campaign": summary, "again": rerun_command(job, controllers, campaign)}
