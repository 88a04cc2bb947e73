"""The report opens with sentences made from its numbers, and shows a campaign as that campaign's own page does."""

from __future__ import annotations

import dataclasses
import html
import re
from typing import Any

import numpy as np
import pytest

from platform_ctrl.campaign.planning import Plan, plan
from platform_ctrl.campaign.summary import Summary, summarise
from platform_ctrl.report import blocks, campaign_tables, job_page
from platform_ctrl.report.blocks import html as as_html
from platform_ctrl.report.campaign_page import campaign_document
from platform_ctrl.report.captions import opening, tightest
from platform_ctrl.report.job_page import page_html
from platform_ctrl.verification.verdict import JobResult
from report_jobs import caging, checked, classical, job, turn

LIMITS = {"bandwidth_hz": 15, "disk_margin": 0.3, "torque_noise": 0.009}
JOB = job(
    name="one gyro & <two> gimbals",
    loop=[caging(classical("plain"), limits=LIMITS)],
    manoeuvre=[
        turn(name=f"{rate} rad/s", rate=rate, limits={"angle": 0.01, "torque_share": 2.0}) for rate in (0.5, 1.0)
    ],
    campaign={
        "runs": 400,
        "seed": 3,
        "vary": [{"parameter": "sampling.delay", "distribution": "uniform", "low": 0.0004, "high": 0.0006}],
    },
)


def checked_job(**changes: Any) -> JobResult:
    return checked({key: item for key, item in (JOB | changes).items() if item is not None})


@pytest.fixture(scope="module")
def result() -> JobResult:
    return checked_job()


@pytest.fixture(scope="module")
def planned(result: JobResult) -> Plan:
    return plan(result.job, tuple(outcome.closed.controller for outcome in result.loops))


def counted(planned: Plan, scale: float = 1.0) -> Summary:
    """What a campaign comes to whose figures follow from its delay."""
    N, inputs = planned.runs, planned.inputs(0, planned.runs)
    delay = inputs["sampling.delay"] / 0.0005
    table = {
        "run": np.arange(N),
        **inputs,
        "angle": scale * 0.008 * delay,
        "torque_share": scale * np.full(N, 0.5),
        "ended": np.full(N, "completed", dtype=object),
    }
    table["attitude"] = np.zeros(N)
    table["angle_passed"], table["torque_share_passed"] = table["angle"] <= 0.01, table["torque_share"] <= 2.0
    table["attitude_passed"] = np.array([None] * N)
    return summarise(planned, table | {"passed": table["angle_passed"] & table["torque_share_passed"]})


@pytest.fixture(scope="module")
def summary(planned: Plan) -> Summary:
    return counted(planned, 1.1)


@pytest.fixture(scope="module")
def prepared(result: JobResult) -> blocks.Document:
    return job_page.prepared(result)


@pytest.fixture(scope="module")
def with_campaign(result: JobResult, summary: Summary) -> blocks.Document:
    return job_page.prepared(result, campaign=summary, again="platform-ctrl simulate a.toml --run")


def text_of(page: str) -> str:
    return " ".join(html.unescape(re.sub(r"<style.*?</style>|<[^>]+>", " ", page, flags=re.DOTALL)).split())


# The opening


def test_the_decay_rate_of_a_stable_loop_is_never_the_tightest(result: JobResult) -> None:
    slow = [one for one in result.requirements if one.name.startswith("minimum decay rate")]
    assert slow
    assert tightest(slow) is None
    assert tightest([]) is None
    failed = dataclasses.replace(slow[0], passed=False, value=-1.0)
    assert tightest([failed, *result.requirements]) is failed


def test_a_campaign_adds_its_probability_with_bounds_and_main_input(result: JobResult, planned: Plan) -> None:
    summary = counted(planned, 1.1)
    found = summary.statistics.violation
    assert 0 < found.events < found.runs
    sentence = opening(result, summary)[-1].replace("\u00a0", " ")
    assert f"campaign of {found.runs} runs" in sentence
    assert campaign_tables.chance(found.estimate) in sentence
    assert campaign_tables.chances(found.low, found.high) in sentence
    assert "“sampling.delay”" in sentence
    none = opening(result, counted(planned, 0.5))[-1]
    assert none.startswith("None of the campaign's 400 runs violates a requirement: probability below")


# The campaign in the report


def plates(parts: tuple[Any, ...]) -> list[blocks.Plate]:
    found = []
    for block in parts:
        found += [block] if isinstance(block, blocks.Plate) else plates(getattr(block, "blocks", ()))
    return found


def tables_of(parts: tuple[Any, ...]) -> list[list[list[str]]]:
    found = []
    for block in parts:
        if isinstance(block, blocks.Table):
            found.append([[cell.text for cell in row.cells] for group in block.groups for row in group.rows])
        found += tables_of(getattr(block, "blocks", ())) + tables_of(getattr(block, "parts", ()))
    return found


def test_the_campaigns_section_has_the_figures_and_rows_of_the_campaigns_own_page(
    with_campaign: blocks.Document, summary: Summary
) -> None:
    names = [section.name for section in with_campaign.sections]
    assert names.index("runs") + 1 == names.index("campaign") == len(names) - 2
    own = campaign_document(summary, again="platform-ctrl simulate a.toml --run")
    section = with_campaign.sections[-2]
    all_blocks = tuple(block for one in own.sections for block in one.blocks)
    shown = plates(all_blocks)
    assert len(shown) == 3
    assert [(one.title, one.caption, one.svg) for one in plates(section.blocks)] == [
        (one.title, one.caption, one.svg) for one in shown
    ]
    assert tables_of(section.blocks) == tables_of(all_blocks)


def test_the_page_with_a_campaign_has_the_command_to_repeat_a_run(
    with_campaign: blocks.Document, summary: Summary
) -> None:
    page = page_html(with_campaign)
    worst = summary.statistics.worst[0].run
    assert f"<pre>platform-ctrl simulate a.toml --run {worst}</pre>" in page
    assert f"<pre>platform-ctrl simulate a.toml --run {worst}</pre>" in as_html(
        campaign_document(summary, again="platform-ctrl simulate a.toml --run")
    )
    words = text_of(page)
    assert "simulated with other" not in words
    assert "this report has none" not in words
    assert campaign_tables.verdict(summary)[1:] in words
    assert not re.search(r"https?:|\bsrc=|url\((?!#)|@import|href=\"(?!#)", page)


def test_a_campaign_that_violates_a_limit_stands_in_the_banner(
    result: JobResult, summary: Summary, with_campaign: blocks.Document
) -> None:
    assert result.passed
    assert not with_campaign.passed
    words = campaign_tables.campaign_words(summary)
    assert words in with_campaign.verdict
    assert words in text_of(page_html(with_campaign).split('id="requirements"')[0])
