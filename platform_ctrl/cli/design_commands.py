"""``platform-ctrl design`` and ``platform-ctrl check``: controllers compared with the requirements of a job."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from platform_ctrl.cli.error_lines import failed, not_drawn, noted
from platform_ctrl.cli.job_arguments import (
    DESIGNED,
    REPORT,
    RESULT,
    CampaignFolder,
    Controllers,
    JobFile,
    Json,
    Prove,
    Quiet,
    controller_file,
    job_of,
    option,
    prepare_folder,
)
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    import control

    from platform_ctrl.campaign.store import Record
    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.job.job import Job
    from platform_ctrl.verification import JobResult


CHECKED = Path("check")


def design(
    job: JobFile,
    out: Annotated[
        Path,
        option("--out", "-o", metavar="DIR", help=f"Folder for {RESULT} and {REPORT}; made if needed.", default=True),
    ] = DESIGNED,
    watch: Annotated[
        bool,
        option("--watch", help="Go on: design again whenever JOB or a file that it names is saved.", default=True),
    ] = False,
    campaign: CampaignFolder = None,
    prove: Prove = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Design every loop of a job and check the whole.

    Each loop is designed by every method in the job; the designs that it uses are closed together on the coupled model
    and simulated on the non-linear plant. Writes result.json, and then report.html.

    \b
    platform-ctrl design job.toml
        report: out/report.html
    platform-ctrl design job.toml -o run7
        run7/report.html
    platform-ctrl design job.toml --watch
        again after each change, until Ctrl-C
    platform-ctrl design job.toml --campaign campaign
        with a section about a campaign
    platform-ctrl design job.toml --json | jq .requirements
        the verdicts, to compute with

    Exit code 1 if a requirement is not met, or if a method finds no controller (named on standard error).
    """  # noqa: D301
    report = Report(out, campaign)

    def once() -> int:
        return _designed(job, report, prove=prove, as_json=as_json, quiet=quiet)

    if watch:
        from platform_ctrl.cli.watching import whenever_saved

        whenever_saved(job, once, quiet=quiet or as_json)
    return once()


def _designed(job: Path, report: Report, *, prove: bool, as_json: bool, quiet: bool) -> int:
    """Design a job once; return the exit code."""
    from platform_ctrl.cli.terminal import progress

    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        report.expect_possible(read)
        report.prepare()
        expect_proofs_possible(prove)
        from platform_ctrl.design.jobs import attempted_loops
        from platform_ctrl.simulation.compilation import start_compilation
        from platform_ctrl.verification import check_job

        if read.manoeuvres:
            start_compilation()
        outcomes = attempted_loops(read, say)
        failures = [one.failure for one in outcomes if one.failure is not None]
        if not any(one.designs for one in outcomes):
            for one in (one for outcome in outcomes for one in outcome.failed if one is not failures[0]):
                noted(f"failed: {one.loop}, {one.name}: {one.sentence}")
            raise failures[0].error
        result = check_job(read, outcomes, say, prove=prove)
        record = report.keep(result)
        show = report.draw(result, record, ["design", str(job), "-o", str(report.folder)], say, as_json)
    code = show()
    for one in failures:
        code = failed(f"{one.loop}, {one.name}: {one.sentence}", 1)
    return code


def expect_proofs_possible(prove: bool) -> None:
    """Raise an `InputError` before the work where proofs are asked for and their library is missing."""
    if prove:
        from platform_ctrl.verification.proofs import flint

        flint()


def check(
    job: JobFile,
    controllers: Controllers = None,
    out: Annotated[
        Path | None,
        option(
            "--out",
            "-o",
            metavar="DIR",
            help=f"Folder for {RESULT} and {REPORT}, default: {CHECKED}. If it is named here and holds a {RESULT}, the "
            "controllers come from there by default.",
        ),
    ] = None,
    baseline: Annotated[
        Path | None,
        option(
            "--baseline",
            metavar="FILE",
            help=f"An accepted {RESULT}: the exit code is also 1 if a value is worse by more than 1 %, or than the "
            "tolerance of the job. What became worse is printed.",
        ),
    ] = None,
    campaign: CampaignFolder = None,
    prove: Prove = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Check existing controllers.

    Gives the verdicts of design without designing. Every value is computed again from the matrices; claims of the file
    that are not confirmed are reported on standard error. Use it for controllers that were made elsewhere, or after the
    plant, the uncertainty or a limit has changed: then they have to be named.

    \b
    platform-ctrl check job.toml
        the controllers of out/result.json
    platform-ctrl check job.toml --controllers out/result.json
        the same after a change of plant or job
    platform-ctrl check job.toml --controllers mine.json -o mine
        others, reported elsewhere
    platform-ctrl check job.toml --baseline accepted.json
        in CI: no value is worse than accepted
    platform-ctrl check job.toml --quiet && deploy
        go on only if all is met
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    folder = out or CHECKED
    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        file, used = controller_file(controllers, out, job, read, quiet or as_json)
        report = Report(folder, campaign)
        report.expect_possible(read)
        from platform_ctrl.verification import check_job
        from platform_ctrl.verification.comparison import compare
        from platform_ctrl.verification.controllers import outcomes_from, read_controllers
        from platform_ctrl.verification.result_file import read_record, unconfirmed

        accepted = None if baseline is None else read_record(baseline)  # before the work
        closed = read_controllers(file, read)
        others = read_controllers(file, read, "alternatives")
        if campaign is not None:
            campaign_summary(read, closed, campaign)  # before the work on what would be refused
        report.prepare()
        expect_proofs_possible(prove)
        outcomes = outcomes_from(read, closed, others)
        result = check_job(read, outcomes, say, prove=prove)
        notes = unconfirmed(file, result)
        record = report.keep(result, file)
        compared = None if accepted is None else compare(record, accepted, read.tolerance)
        more: dict[str, Any] = {}
        if compared is not None:
            changes = [asdict(one) for one in compared.changes]
            more = {"baseline": {"file": str(baseline), "passed": compared.passed, "changes": changes}}
        command = ["check", str(job), "--controllers", str(file), "-o", str(folder)]
        show = report.draw(result, record, command, say, as_json, more)
    noted(used)
    for note in notes:
        typer.echo(f"{file}: not confirmed: {note}", err=True)
    code = show()
    if compared is None:
        return code
    from platform_ctrl.report.failures import changes_text

    typer.echo(f"baseline {changes_text(compared, str(baseline))}", err=as_json)
    return code or (0 if compared.passed else 1)


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
    if not record.get("complete") or not (folder / TABLE).exists():
        raise InputError(f"--campaign {folder}: is not complete; the same platform-ctrl campaign continues it")
    return record


def campaign_summary(job: Job, controllers: Sequence[control.StateSpace], folder: Path) -> Summary:
    """Return the statistics of the campaign in a folder."""
    from platform_ctrl.campaign.single_run import recorded_plan
    from platform_ctrl.campaign.store import TABLE

    made, changed = recorded_plan(job, controllers, expect_campaign(job, folder))
    if changed:
        raise InputError(
            f"--campaign {folder}: was simulated with {'; '.join(changed)}; repeat it with platform-ctrl campaign, or "
            "leave the option out"
        )
    from platform_ctrl.campaign.summary import summarise

    return summarise(made, folder / TABLE)


Shown = Callable[[], int]


@dataclass(frozen=True)
class Report:
    """The result's file and the report in a folder, with a section about the campaign in another."""

    folder: Path
    campaign: Path | None

    def expect_possible(self, job: Job) -> None:
        """Check the options before the work."""
        if self.campaign is not None:
            expect_campaign(job, self.campaign)

    def prepare(self) -> None:
        """Make sure before the work that all files can be written."""
        prepare_folder(self.folder, (RESULT, REPORT))

    def keep(self, result: JobResult, checked: Path | None = None) -> Record:
        """Write the result's file, before anything is drawn, and return its content.

        The controllers of a file that was checked keep its sections.
        """
        from platform_ctrl.verification.result_file import result_record, with_sections, write_record

        record = result_record(result)
        return write_record(record if checked is None else with_sections(record, checked), self.folder / RESULT)

    def draw(
        self,
        result: JobResult,
        record: Record,
        command: list[str],
        say: Callable[[str], None],
        as_json: bool,
        more: Mapping[str, object] | None = None,
    ) -> Shown:
        """Write the report; return a function that prints the result and returns the exit code, that of the verdict.

        `command` are the words of the command line without the program's name, the job second; `more` is printed as
        JSON beside the content of the result's file. What cannot be drawn is left out, and said. A campaign of other
        controllers is left out too, and is an error at the end.
        """
        from platform_ctrl.verification.result_file import write_record

        words = ["platform-ctrl", *command]
        about: dict[str, Any] = {}
        campaign: Summary | None = None
        refused: InputError | None = None
        if self.campaign is not None:
            words += ["--campaign", str(self.campaign)]
            say(f"reading the campaign: {self.campaign}")
            try:
                about = self._campaign_section(result, record, self.campaign, command[1])
                campaign = about["campaign"]
                counted = campaign.statistics.violation
                passed = {"passed": campaign.passed, "runs": counted.runs, "violating": counted.events}
                record |= {"passed": record["passed"] and campaign.passed, "campaign": passed}
                record = write_record(record, self.folder / RESULT)
            except InputError as error:
                refused = InputError(f"{error}; the report in {self.folder} was written without it")
        reports, missing = self._drawn(result, say, command=shlex.join(words), **about)

        def show() -> int:
            self._show(result, campaign, {**record, **(more or {})} if as_json else None, reports)
            for line in missing:
                noted(line)
            if not (as_json or result.passed):
                typer.echo(f"next:   {shlex.join(['platform-ctrl', 'serve', command[1]])} proposes what to change")
            if refused is not None:
                raise refused
            return 0 if result.passed and (campaign is None or campaign.passed) else 1

        return show

    def _drawn(self, result: JobResult, say: Callable[[str], None], **about: Any) -> tuple[list[Path], list[str]]:
        """Write the report; return its path if it is there, and a line for what is missing, and why."""
        path = self.folder / REPORT
        lines: list[str] = []

        def page(path: Path) -> None:
            from platform_ctrl.report import write_page
            from platform_ctrl.report.page.blocks import missing
            from platform_ctrl.report.page.job_page import prepared

            content = prepared(result, **about)
            lines.extend(f"{path}: {words}" for words in missing(content))
            write_page(content, path)

        say(f"drawing the report: {path}")
        line = not_drawn(path, page)
        return ([], [*lines, line]) if line else ([path], lines)

    def _campaign_section(
        self, result: JobResult, record: Mapping[str, Any], campaign: Path, job: str
    ) -> dict[str, Any]:
        from platform_ctrl.verification.controllers import read_controllers

        # As a campaign reads them, from the record: the same numbers in the same order.
        summary = campaign_summary(result.job, read_controllers(record, result.job), campaign)
        again = ["simulate", job, "--controllers", str(self.folder / RESULT), "-o", str(campaign), "--run"]
        return {"campaign": summary, "again": shlex.join(["platform-ctrl", *again])}

    def _show(
        self, result: JobResult, campaign: Summary | None, record: Mapping[str, object] | None, reports: Sequence[Path]
    ) -> None:
        from platform_ctrl.cli.terminal import show_result
        from platform_ctrl.common.json_text import json_text

        if record is not None:
            typer.echo(json_text(record))
            return
        show_result(result, campaign)
        for path in reports:
            typer.echo(f"report: {path}")
        typer.echo(f"values: {self.folder / RESULT}")
