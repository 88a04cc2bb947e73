"""A campaign's page: everything that it came to, in one file that needs nothing else."""

from __future__ import annotations

import os
from pathlib import Path

from platform_ctrl.campaign.summary import Summary
from platform_ctrl.common.files import write_whole
from platform_ctrl.report.page import campaign_tables as tables
from platform_ctrl.report.page.block_tables import html, record_part
from platform_ctrl.report.page.blocks import Document, Facts, Listing, Paragraph, Part, Section
from platform_ctrl.report.page.campaign_sections import RERUN_COMMAND, campaign_sections, digests, drawn_part
from platform_ctrl.report.record import versions


def write_campaign_page(
    summary: Summary, path: str | os.PathLike[str], *, command: str | None = None, again: str | None = None
) -> Path:
    """Write the page to `path`, whole or not at all.

    Parameters
    ----------
    summary
        From `platform_ctrl.campaign.summary.summarise`.
    path
        The file; one that exists is replaced.
    command
        The command line that made it.
    again
        The command line that flies one run again, without the run's number at its end.
    """
    return write_whole(path, campaign_page(summary, command=command, again=again))


def campaign_page(summary: Summary, *, command: str | None = None, again: str | None = None) -> str:
    """Return the page as HTML: self-contained, for light and dark screens and for paper."""
    return html(campaign_document(summary, command=command, again=again))


def campaign_document(summary: Summary, *, command: str | None = None, again: str | None = None) -> Document:
    """Return what the page says."""
    from platform_ctrl.report import style

    job = summary.plan.job
    with style.settings():
        sections = campaign_sections(summary, again or RERUN_COMMAND)
    last = (
        Paragraph(text="This page was made by"),
        Listing(text=command or "platform-ctrl campaign job.toml"),
        drawn_part(summary),
        Part(title="Versions and digests", blocks=(Facts(rows=(*versions().items(), *digests(summary))),)),
        record_part(job),
    )
    flown = tables.count_words(summary.plan.runs).replace(" ", " simulated ")
    return Document(
        kicker=f"platform_ctrl: campaign of {flown}",
        title=job.name,
        source=". ".join(filter(None, [job.platform.name, job.platform.source])),
        passed=summary.statistics.passed,
        verdict=tables.verdict(summary),
        sections=(*sections, Section(name="again", title="Inputs and versions", blocks=last)),
    )
