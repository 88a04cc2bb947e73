"""``platform-ctrl design`` and ``platform-ctrl check``: controllers compared with the requirements of a job."""

from __future__ import annotations

import hashlib
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.cli import job_arguments as arguments
from platform_ctrl.cli.exits import failed, not_drawn, noted, print_json, reported
from platform_ctrl.errors import InputError, PlatformCtrlError, began_with_interrupt

if TYPE_CHECKING:
    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.job.job import Job
    from platform_ctrl.verification.comparison import Comparison
    from platform_ctrl.verification.verdict import JobResult


CHECKED = Path("check")


Out = Annotated[Path, arguments.folder_option(f"Folder for {arguments.RESULT} and {arguments.REPORT}; made if needed.")]
Watch = Annotated[
    bool, typer.Option("--watch", help="Go on: design again whenever JOB or a file that it names is saved.")
]


def design(
    job: arguments.JobFile,
    out: Out = arguments.DESIGNED,
    watch: Watch = False,
    prove: arguments.Prove = False,
    as_json: arguments.Json = False,
    quiet: arguments.Quiet = False,
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
    platform-ctrl design job.toml --json | jq .requirements
        the verdicts, to compute with

    Exit code 1 if a requirement is not met, or if a method finds no controller (named on standard error).
    """  # noqa: D301

    def once() -> int:
        return _designed(job, out, prove=prove, as_json=as_json, quiet=quiet)

    if watch:
        whenever_saved(job, once, quiet=quiet or as_json)
    return once()


def _designed(job: Path, folder: Path, *, prove: bool, as_json: bool, quiet: bool) -> int:
    """Design a job once; return the exit code."""
    from platform_ctrl.cli.terminal import progress

    with progress(quiet or as_json, f"reading {job}") as say:
        read = arguments.job_of(job)
        arguments.prepare_folder(folder, (arguments.RESULT, arguments.REPORT))
        _expect_proofs_possible(prove)
        from platform_ctrl.common.processes import processors
        from platform_ctrl.design.jobs import attempted_loops
        from platform_ctrl.simulation.batch import start_compilation
        from platform_ctrl.verification import check_job
        from platform_ctrl.verification.result_file import result_record, write_record

        if read.manoeuvres:
            start_compilation()
        outcomes = attempted_loops(read, say, processors(), folder)
        failures = [one.failure for one in outcomes if one.failure is not None]
        if not any(one.designs for one in outcomes):
            for one in (one for outcome in outcomes for one in outcome.failed if one is not failures[0]):
                noted(f"failed: {one.loop}, {one.name}: {one.sentence}")
            raise failures[0].error
        result = check_job(read, outcomes, say, prove=prove)
        record = write_record(result_record(result), folder / arguments.RESULT)  # before anything is drawn
        drawn = _drawn(result, folder, ["design", str(job), "-o", str(folder)], say, file=str(job))
    code = _show(result, record, folder, drawn, as_json, job)
    for one in failures:
        code = failed(f"{one.loop}, {one.name}: {one.sentence}", 1)
    return code


# Between two looks at the files, s; large files are looked at for a tenth of the time.
_PAUSE, _SHARE = 0.1, 0.1


def whenever_saved(job: Path, run: Callable[[], int], *, quiet: bool) -> NoReturn:
    """Run, and again whenever the job or a file that it names has changed, until Ctrl-C.

    A message about wrong input does not end it.
    """
    while True:
        files = arguments.files_read(job)
        seen = _state(files)
        try:
            run()
        except PlatformCtrlError as error:
            if began_with_interrupt(error):
                raise
            reported(error)
        sys.stdout.flush()
        if not quiet:
            noted(f"waiting until {job} or a file that it names is saved; Ctrl-C ends")
        while seen == (now := _after_a_pause(files)):
            pass
        while now != (now := _after_a_pause(files)):  # it is still being written
            pass


def _after_a_pause(files: list[Path]) -> list[bytes]:
    begun = time.monotonic()
    out = _state(files)
    time.sleep(max(_PAUSE, (time.monotonic() - begun) * (1.0 / _SHARE - 1.0)))
    return out


def _state(files: list[Path]) -> list[bytes]:
    """Return hashes of what files hold, which times and sizes do not show; of a file that is not there an empty one."""
    out = []
    for file in files:
        try:
            out.append(hashlib.sha256(file.read_bytes()).digest() if file.is_file() else b"")
        except (OSError, ValueError):  # it cannot be read, or no file can be called so
            out.append(b"")
    return out


def _expect_proofs_possible(prove: bool) -> None:
    """Raise an `InputError` before the work where proofs are asked for and their library is missing."""
    if prove:
        from platform_ctrl.verification.proofs import flint

        flint()


CheckOut = Annotated[
    Path | None,
    arguments.folder_option(
        f"Folder for {arguments.RESULT} and {arguments.REPORT}, default: {CHECKED}. If it is named here and holds a "
        f"{arguments.RESULT}, the controllers come from there by default."
    ),
]
Baseline = Annotated[
    Path | None,
    typer.Option(
        "--baseline",
        metavar="FILE",
        help=f"An accepted {arguments.RESULT}: the exit code is also 1 if a value is worse by more than 1 %, or than "
        "the tolerance of the job. What became worse is printed.",
    ),
]


def check(
    job: arguments.JobFile,
    controllers: arguments.Controllers = None,
    out: CheckOut = None,
    baseline: Baseline = None,
    campaign: arguments.CampaignFolder = None,
    prove: arguments.Prove = False,
    as_json: arguments.Json = False,
    quiet: arguments.Quiet = False,
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
        read = arguments.job_of(job)
        file, used = arguments.controller_file(controllers, out, job, read, quiet or as_json)
        from platform_ctrl.verification import check_job
        from platform_ctrl.verification.comparison import compare
        from platform_ctrl.verification.controllers import outcomes_from, read_controllers
        from platform_ctrl.verification.result_file import (
            read_record,
            result_record,
            unconfirmed,
            with_sections,
            write_record,
        )

        # All that may be refused is read before the work.
        accepted = None if baseline is None else read_record(baseline)
        closed = read_controllers(file, read)
        others = read_controllers(file, read, "alternatives")
        summary = None if campaign is None else campaign_summary(read, closed, campaign)
        arguments.prepare_folder(folder, (arguments.RESULT, arguments.REPORT))
        _expect_proofs_possible(prove)
        result = check_job(read, outcomes_from(read, closed, others), say, prove=prove)
        notes = unconfirmed(file, result)
        record = with_sections(result_record(result), file)
        command = ["check", str(job), "--controllers", str(file), "-o", str(folder)]
        again = ["platform-ctrl", "simulate", str(job), "--controllers", str(folder / arguments.RESULT)]
        if summary is not None:
            command += ["--campaign", str(campaign)]
            again += ["-o", str(campaign), "--run"]
            counted = summary.statistics.violation
            passed = {"passed": summary.passed, "runs": counted.runs, "violating": counted.events}
            record |= {"passed": record["passed"] and summary.passed, "campaign": passed}
        record = write_record(record, folder / arguments.RESULT)
        compared = None if accepted is None else compare(record, accepted, read.tolerance)
        drawn = _drawn(result, folder, command, say, file=str(job), campaign=summary, again=shlex.join(again))
    noted(used)
    for note in notes:
        noted(f"{file}: not confirmed: {note}")
    if compared is not None:
        changes = [asdict(one) for one in compared.changes]
        record |= {"baseline": {"file": str(baseline), "passed": compared.passed, "changes": changes}}
    code = _show(result, record, folder, drawn, as_json, job, summary)
    return code if compared is None else _show_changes(compared, f"baseline {baseline}", as_json) or code


def _show_changes(compared: Comparison, name: str, as_json: bool) -> int:
    """Print what has changed since an accepted result; return the exit code."""
    from platform_ctrl.cli.terminal import changed, changes_text, screen, show_table, show_words

    if as_json:
        for line in changes_text(compared, name).splitlines():
            noted(line)
    else:
        head, rows, notes = changed(compared, name)
        show_words(screen(), head, indent="    ")
        if len(rows) > 1:
            show_table(screen(), rows[0], rows[1:])
        for line in notes:
            show_words(screen(), line, indent="    ")
    return 0 if compared.passed else 1


def campaign_summary(job: Job, controllers: Sequence[StateSpace], folder: Path) -> Summary:
    """Return the statistics of the campaign of `job` in a folder, which has to be done."""
    from platform_ctrl.campaign.single_run import recorded_plan
    from platform_ctrl.campaign.store import RECORD, TABLE, read_campaign_record
    from platform_ctrl.campaign.summary import summarise

    record, where = read_campaign_record(folder), f"--campaign {folder}"
    if record is None:
        raise InputError(f"{where}: there is no {RECORD}; name the folder that platform-ctrl campaign writes")
    if record.get("job") != job.name:
        raise InputError(f"{where}: belongs to the job {record.get('job')!r}, not to {job.name!r}")
    if not record.get("complete") or not (folder / TABLE).exists():
        raise InputError(f"{where}: is not complete; the same platform-ctrl campaign continues it")
    made, changed = recorded_plan(job, controllers, record)
    if changed:
        words = f"{where}: was simulated with {'; '.join(changed)}"
        raise InputError(f"{words}; repeat it with platform-ctrl campaign, or leave the option out")
    return summarise(made, folder / TABLE)


def _drawn(
    result: JobResult, folder: Path, command: Sequence[str], say: Callable[[str], None], **about: Any
) -> tuple[bool, list[str]]:
    """Write the report; return whether it is there, and a line for everything that is missing, and why.

    `command` are the words of the command line without the program's name.
    """
    path = folder / arguments.REPORT
    lines: list[str] = []

    def page(path: Path) -> None:
        from platform_ctrl.report import write_page
        from platform_ctrl.report.blocks import missing
        from platform_ctrl.report.job_page import prepared

        content = prepared(result, command=shlex.join(["platform-ctrl", *command]), **about)
        lines.extend(f"{path}: {words}" for words in missing(content))
        write_page(content, path)

    say(f"drawing the report: {path}")
    line = not_drawn(path, page)
    return not line, [*lines, line]


def _show(
    result: JobResult,
    record: Mapping[str, object],
    folder: Path,
    drawn: tuple[bool, list[str]],
    as_json: bool,
    job: Path,
    campaign: Summary | None = None,
) -> int:
    """Print the result; return the exit code, that of the verdict."""
    from platform_ctrl.cli.terminal import show_result

    there, missing = drawn
    if as_json:
        print_json(record)
    else:
        show_result(result, campaign)
        if there:
            typer.echo(f"report: {folder / arguments.REPORT}")
        typer.echo(f"values: {folder / arguments.RESULT}")
    for line in missing:
        noted(line)
    if not (as_json or result.passed):
        typer.echo(f"next:   {shlex.join(['platform-ctrl', 'serve', str(job)])} proposes what to change")
    return 0 if record["passed"] else 1
