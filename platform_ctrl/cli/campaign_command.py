"""``platform-ctrl campaign``: many runs of a job, goes on where it was stopped."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from platform_ctrl.cli import completion
from platform_ctrl.cli.job_arguments import (
    CAMPAIGN,
    Controllers,
    JobFile,
    Json,
    Quiet,
    controller_file,
    job_of,
    option,
    prepare_folder,
)

if TYPE_CHECKING:
    from platform_ctrl.campaign.engine import CampaignResult
    from platform_ctrl.job.job import Points

# Groups of options in the help.
WHAT, WHERE, RARE = "Runs", "Where they are simulated", "Rare events"


def campaign(
    job: JobFile,
    runs: Annotated[
        int | None, option("--runs", metavar="N", help="Number of runs. Default: as in the job.", panel=WHAT)
    ] = None,
    out: Annotated[
        Path,
        option(
            "--out",
            "-o",
            metavar="DIR",
            help="Folder for campaign.html, campaign.parquet and campaign.json; made if needed.",
            default=True,
            words=completion.campaign_folders,
        ),
    ] = CAMPAIGN,
    controllers: Controllers = None,
    workers: Annotated[
        int | None,
        option(
            "--workers",
            metavar="N",
            help="Processes. Default: as many as there are processors. The results do not depend on it.",
            panel=WHERE,
        ),
    ] = None,
    seed: Annotated[
        int | None, option("--seed", metavar="N", help="Random seed. Default: as in the job.", panel=WHAT)
    ] = None,
    sampling: Annotated[
        str | None,
        option(
            "--sampling",
            metavar="sobol|latin-hypercube|random",
            help="How the runs fill the space of what varies. Default: as in the job.",
            panel=WHAT,
        ),
    ] = None,
    device: Annotated[
        str, option("--device", metavar="cpu|cuda", help="What simulates the runs.", panel=WHERE, default=True)
    ] = "cpu",
    scheduler: Annotated[
        str | None,
        option(
            "--scheduler",
            metavar="ADDRESS",
            help="A Dask scheduler (tcp://host:8786), whose workers simulate the runs.",
            panel=WHERE,
        ),
    ] = None,
    restart: Annotated[
        bool, option("--restart", help="Discard the campaign in DIR and start again.", default=True)
    ] = False,
    rare: Annotated[
        str | None,
        option(
            "--rare",
            metavar="any|angle|attitude|torque_share",
            help="After the campaign, estimate the probability that this requirement (or any) is violated by "
            "importance splitting, for probabilities too small to count.",
            panel=RARE,
        ),
    ] = None,
    runs_per_level: Annotated[
        int,
        option(
            "--runs-per-level",
            metavar="N",
            help="Of --rare: a level takes a tenth of the probability.",
            panel=RARE,
            default=True,
        ),
    ] = 1000,
    rare_method: Annotated[
        str,
        option(
            "--rare-method",
            metavar="splitting|cross-entropy",
            help="cross-entropy: splitting, then weighted runs; surer where ten inputs or fewer vary.",
            panel=RARE,
            default=True,
        ),
    ] = "splitting",
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Simulate many runs of a job, with the variations in its [campaign].

    Uses existing controllers. Writes campaign.parquet, one row a run: inputs, values, verdicts, how it ended;
    campaign.json and the page campaign.html: the probability that a requirement is violated, its main causes, and the
    worst runs. After an interruption the same command continues; a larger --runs extends a completed campaign. A run
    that diverges or cannot be simulated has a row that says so.

    \b
    platform-ctrl campaign job.toml --runs 10000                with the controllers of out/result.json
    platform-ctrl campaign job.toml -o night --controllers mine.json  with others, into another folder
    platform-ctrl campaign job.toml --rare angle                a probability too small to count
    platform-ctrl campaign job.toml --scheduler tcp://big:8786  on other machines
    platform-ctrl simulate job.toml --run 4711                  one of its runs again, with a figure

    Exit code 1 if a run did not meet its limits, diverged or was not simulated.
    """  # noqa: D301
    from platform_ctrl.cli.campaign_output import PAGE, campaign_progress, expect_rare, rare_result, write_campaign
    from platform_ctrl.cli.terminal import progress

    with progress(quiet or as_json, f"reading {job}"):
        read = job_of(job)
        file = controller_file(controllers, None, job)
        from platform_ctrl.campaign.engine import run_campaign
        from platform_ctrl.campaign.planning import plan
        from platform_ctrl.verification.controllers import read_controllers

        made = plan(read, read_controllers(file, read), runs=runs, seed=seed, sampling=cast("Points | None", sampling))
        expect_rare(made, rare, runs_per_level, rare_method)
        prepare_folder(out, ("campaign.parquet", "campaign.json", PAGE))
    done: int | None = None

    def count(kept: int, failed: int) -> None:
        nonlocal done
        done = kept
        tick(kept, failed)

    try:
        with campaign_progress(quiet or as_json, made.runs) as (tick, say):
            result = run_campaign(
                made, out, workers=workers, scheduler=scheduler, device=device, restart=restart, progress=count, say=say
            )
    except KeyboardInterrupt:
        kept = "what was simulated is kept" if done is None else f"{done:,} of {made.runs:,} runs are kept"
        typer.echo(f"stopped: {kept} in {out}; the same command continues", err=True)
        raise
    given = {"--controllers": controllers, "-o": None if out == CAMPAIGN else out}
    files = [str(word) for option, path in given.items() if path is not None for word in (option, path)]
    numbers = {"--runs": runs, "--seed": seed, "--sampling": sampling, "--rare": rare}
    words = [str(word) for option, one in numbers.items() if one is not None for word in (option, one)]
    with progress(quiet or as_json, f"reading {result.table}") as say:
        found = rare_result(made, rare, runs_per_level, rare_method, workers=workers, device=device, say=say)
        say(f"drawing the page: {out / PAGE}")
        summary, record = write_campaign(
            made,
            result,
            found,
            command=["platform-ctrl", "campaign", str(job), *words, *files],
            again=["platform-ctrl", "simulate", str(job), *files, "--run"],
        )
    if as_json:
        from platform_ctrl.common.json_text import json_text

        typer.echo(json_text(record))
    else:
        from platform_ctrl.cli.campaign_output import show_campaign

        show_campaign(summary)
        _show_files(result, out / PAGE)
    return 0 if result.passed else 1


def _show_files(result: CampaignResult, page: Path) -> None:
    from platform_ctrl.report.page.campaign_tables import count_words

    counts: dict[str, Any] = result.counts
    typer.echo(f"{count_words(result.record['runs'])}: {', '.join(f'{n:,} {name}' for name, n in counts.items() if n)}")
    for reason, number in result.reasons.items():
        typer.echo(f"  {number:,} x {reason}")
    typer.echo(f"page: {page}, runs: {result.table}, values: {result.table.with_suffix('.json')}")
