"""``platform-ctrl check``: existing controllers compared with the requirements of a job."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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
    option,
    plant_file,
    prepare_folder,
    writable,
)
from platform_ctrl.cli.job_outcome import ReportOptions, write_report
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.verification import JobResult
    from platform_ctrl.verification.baselines.comparison import Change, Comparison
    from platform_ctrl.verification.baselines.record import Baseline


@dataclass(frozen=True)
class Outcome:
    """The result of a comparison: text for the terminal, plain data for JSON."""

    comparison: Comparison | None = None
    words: str = ""
    record: dict[str, Any] | None = None

    @property
    def passed(self) -> bool:
        """Whether nothing is worse than it was accepted."""
        return self.comparison is None or self.comparison.passed


@dataclass(frozen=True)
class BaselineOptions:
    """A baseline's file, and whether it is to be updated."""

    file: Path | None
    update: bool
    baseline: Baseline | None = None

    @classmethod
    def given(cls, file: Path | None, update: bool) -> BaselineOptions:
        """Check the options before the work."""
        if file is None:
            if update:
                raise InputError("--update-baseline: needs --baseline FILE, the file to write")
            return cls(None, False)
        from platform_ctrl.verification.baselines import read_baseline

        if update:
            writable("--baseline", file)
        elif not os.path.exists(file):
            raise InputError(f"{file}: there is no such file; --update-baseline writes it")
        return cls(file, update, read_baseline(file) if file.exists() else None)

    def outcome(self, result: JobResult) -> Outcome:
        """Compare and plot changes beside the file, or update the file."""
        if self.file is None:
            return Outcome()
        from platform_ctrl.verification.baselines import compare, update_baseline
        from platform_ctrl.verification.baselines.file import plot_beside, remove_plot

        plot = plot_beside(self.file)
        if self.update or self.baseline is None:
            made = update_baseline(result, self.file)
            remove_plot(plot)
            before = made.comparison.changes if made.comparison is not None else ()
            record = _record(self.file, before, passed=True, updated=made.written)
            return Outcome(None, f"baseline: {made.summary}", record)
        comparison = compare(result, self.baseline)
        from platform_ctrl.report.failures import failure_text, moved_text

        if comparison.passed:
            remove_plot(plot)
            record = _record(self.file, comparison.changes, passed=True, updated=False)
            return Outcome(comparison, f"baseline {moved_text(comparison, str(self.file))}", record)
        accept = "the same command with --update-baseline"
        words, drawn = failure_text(comparison, result.job.name, self.file, plot, accept)
        shown = None if drawn is None else str(drawn)
        record = _record(self.file, comparison.changes, passed=False, updated=False, plot=shown)
        return Outcome(comparison, f"baseline {words}", record)


def _record(
    file: Path, changes: tuple[Change, ...], *, passed: bool, updated: bool, plot: str | None = None
) -> dict[str, Any]:
    names = ("subject", "name", "unit", "sense", "before", "now", "allowed", "limit", "state")
    entries = [{name: getattr(change, name) for name in names} for change in changes]
    found = {"file": str(file), "passed": passed, "updated": updated, "plot": plot, "figures": entries}
    return {"baseline": found}


CHECKED = Path("check")


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
            help="Accepted values: the exit code is also 1 if a value is worse by more than its tolerance. Changes "
            "are printed, and plotted beside FILE.",
        ),
    ] = None,
    update_baseline: Annotated[
        bool, option("--update-baseline", help="Accept the present values: write them to the baseline.", default=True)
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
        from platform_ctrl.verification import check_job
        from platform_ctrl.verification.controllers import outcomes_from, read_controllers
        from platform_ctrl.verification.records import unconfirmed

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
        result = check_job(read, outcomes_from(read, closed, others), say)
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
