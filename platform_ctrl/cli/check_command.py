"""``platform-ctrl check``: existing controllers compared with the requirements of a job."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from platform_ctrl.cli.baseline_options import BaselineOptions, writable
from platform_ctrl.cli.job_arguments import (
    REPORT,
    RESULT,
    CampaignFolder,
    Controllers,
    JobFile,
    Json,
    Junit,
    Pdf,
    Quiet,
    controller_file,
    job_of,
    plant_file,
    prepare_folder,
)
from platform_ctrl.cli.job_outcome import ReportOptions, write_report

CHECKED = Path("check")


def check(
    job: JobFile,
    controllers: Controllers = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help=f"Folder for {RESULT} and {REPORT}, default: {CHECKED}. If it is named here and holds a {RESULT}, the "
            "controllers come from there by default.",
            show_default=False,
        ),
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(
            "--baseline",
            metavar="FILE",
            help="Accepted values: the exit code is also 1 if a value is worse by more than its tolerance. Changes "
            "are printed, and plotted beside FILE.",
            show_default=False,
        ),
    ] = None,
    update_baseline: Annotated[
        bool, typer.Option("--update-baseline", help="Accept the present values: write them to the baseline.")
    ] = False,
    junit: Junit = None,
    pdf: Pdf = False,
    campaign: CampaignFolder = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Check existing controllers.

    Gives the verdicts of design without designing. Every value is computed again from the matrices; claims of the file
    that are not confirmed are reported on standard error. Use it after the plant, the
    uncertainty or a limit has changed, or for controllers that were made elsewhere.

    \b
    platform-ctrl check job.toml                                          the controllers of out/result.json
    platform-ctrl check job.toml --controllers mine.json -o mine          others, reported elsewhere
    platform-ctrl check job.toml --baseline gyros.json --update-baseline  accept the present values
    platform-ctrl check job.toml --baseline gyros.json --junit check.xml  in CI: none is worse than accepted
    platform-ctrl check job.toml --quiet && deploy                        go on only if all is met
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    folder = out or CHECKED
    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        file = controller_file(controllers, out, job)
        comparison = BaselineOptions.given(baseline, update_baseline)
        extras = ReportOptions.given(read, pdf, campaign)
        from platform_ctrl.verification import checked
        from platform_ctrl.verification.given import outcomes_from, read_controllers
        from platform_ctrl.verification.recorded import unconfirmed

        closed = read_controllers(file, read)
        others = read_controllers(file, read, "alternatives")
        if campaign is not None:
            from platform_ctrl.cli.job_outcome import campaign_summary

            campaign_summary(read, closed, campaign)  # before the work on what would be refused
        prepare_folder(folder, extras.files)
        if junit is not None:
            inputs = [job, *plant_file(job, read), file, baseline]
            writable("--junit", junit, [*inputs, *(folder / name for name in extras.files)])
        say(f"controllers: {file}")
        result = checked(read, outcomes_from(read, closed, others), say)
        notes = unconfirmed(file, result)
        command = ["check", str(job), "--controllers", str(file), "-o", str(folder)]
        compared: dict[str, Any] = {}
        show = write_report(result, folder, as_json, say, command, compared, extras=extras)
        outcome = comparison.outcome(result)  # last: nothing is accepted of which there is no report
        compared |= outcome.record or {}
        if junit is not None:
            from platform_ctrl.report.failures import write_junit

            write_junit(result, junit, comparison=outcome.comparison, baseline=str(baseline))
    for note in notes:
        typer.echo(f"{file}: not confirmed: {note}", err=True)
    code = show()
    if outcome.words:
        typer.echo(outcome.words, err=as_json)
    return code or (0 if outcome.passed else 1)
