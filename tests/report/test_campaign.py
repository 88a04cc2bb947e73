"""A campaign's page and its part in a report: what was counted is shown, and nothing is loaded from elsewhere."""

from __future__ import annotations

import dataclasses
import html
import re
from html.parser import HTMLParser
from typing import Any

import control
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.colors import to_hex

import platform_ctrl as pc
from platform_ctrl.campaign.planning import Plan, plan
from platform_ctrl.campaign.single_run import simulate_runs
from platform_ctrl.campaign.statistics import clopper_pearson, statistics
from platform_ctrl.campaign.store import Columns, typed
from platform_ctrl.campaign.summary import Summary, influences
from platform_ctrl.cli.campaign_command import show_campaign
from platform_ctrl.job.judging import tightest
from platform_ctrl.job.manoeuvre import Manoeuvre
from platform_ctrl.report import blocks, figures, job_page, style
from platform_ctrl.report import campaign_tables as tables
from platform_ctrl.report.blocks import html as as_html
from platform_ctrl.report.campaign_page import campaign_document
from platform_ctrl.report.captions import opening
from platform_ctrl.report.style import BEYOND, LIMIT, SERIES
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult
from report_jobs import caging, checked, classical, job, turn
from single_runs import simulated

AGAIN = "platform-ctrl simulate a.toml --run"
JOB = job(
    name="tolerances & <faults>",
    loop=[caging(classical("plain"), limits={"bandwidth_hz": 15, "disk_margin": 0.3, "torque_noise": 0.009})],
    manoeuvre=[
        turn(name=f"{rate} rad/s", rate=rate, limits={"angle": 0.01, "torque_share": 2.0}) for rate in (0.5, 1.0)
    ],
    campaign={
        "runs": 400,
        "seed": 3,
        "vary": [{"parameter": "sampling.delay", "distribution": "uniform", "low": 0.0004, "high": 0.0006}],
    },
)


@pytest.fixture(scope="module")
def result() -> JobResult:
    return checked(JOB)


@pytest.fixture(scope="module")
def made(result: JobResult) -> Plan:
    return plan(result.job, tuple(outcome.closed.controller for outcome in result.loops))


def summary_of(made: Plan, table: Columns) -> Summary:
    columns, limits = typed(table), {one.name: one.limits for one, _ in made.job.campaign_manoeuvres}
    found = influences(columns, limits, made.input_names)
    return Summary(plan=made, statistics=statistics(columns, limits), influences=found)


def counted(made: Plan, scale: float, odd: bool = False) -> Summary:
    """A campaign whose angles follow from the delay; an odd one has a run that diverged and one not simulated."""
    N, inputs = made.runs, made.inputs(0, made.runs)
    table = {
        "run": np.arange(N),
        **inputs,
        "angle": scale * 0.008 * inputs["sampling.delay"] / 0.0005,
        "torque_share": np.full(N, 0.5),
        "attitude": np.zeros(N),
        "ended": np.full(N, "completed", dtype=object),
    }
    if odd:
        table["ended"][11], table["ended"][12] = "diverged at t = 0.3 s", "not simulated: its worker died"
        table["angle"][11] = table["torque_share"][11] = np.inf
    table["angle_passed"], table["torque_share_passed"] = table["angle"] <= 0.01, table["torque_share"] <= 2.0
    table["attitude_passed"] = np.array([None] * N)
    return summary_of(made, table | {"passed": table["angle_passed"] & table["torque_share_passed"]})


@pytest.fixture(scope="module")
def summary(made: Plan) -> Summary:
    return counted(made, 1.1, odd=True)


@pytest.fixture(scope="module")
def page(summary: Summary) -> str:
    return as_html(campaign_document(summary, command="platform-ctrl campaign a.toml --runs 400", again=AGAIN))


@pytest.fixture(scope="module")
def with_campaign(result: JobResult, summary: Summary) -> blocks.PageContent:
    return job_page.prepared(result, campaign=summary, again=AGAIN)


class Links(HTMLParser):
    """What a page would load, and whether its tags are closed."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.open: list[str] = []
        self.ids: list[str] = []
        self.targets: list[str] = []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        given = dict(attrs)
        self.loaded += [given[key] for key in ("src", "href") if key in given and not given[key].startswith("#")]
        self.targets += [given["href"][1:]] if tag == "a" and given.get("href", "").startswith("#") else []
        self.ids += [given["id"]] if "id" in given else []
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Any) -> None:
        self.handle_starttag(tag, attrs)
        self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def text_of(page: str) -> str:
    return " ".join(html.unescape(re.sub(r"<style.*?</style>|<[^>]+>", " ", page, flags=re.DOTALL)).split())


def test_the_pages_need_nothing_else_and_are_whole(page: str, with_campaign: blocks.PageContent) -> None:
    for text in (page, as_html(with_campaign)):
        links = Links()
        links.feed(text)
        assert links.open == links.loaded == []
        assert links.targets
        assert all(links.ids.count(target) == 1 for target in links.targets)
        assert not re.search(r"url\((?!#)|@import|https?://(?!www\.w3\.org)", text)
        assert "tolerances &amp; &lt;faults&gt;" in text


def test_verdict_and_probabilities_come_first(page: str, summary: Summary) -> None:
    found = summary.statistics
    words = html.unescape(page).replace("\u00a0", " ")
    assert f"{found.violation.events:,} of {found.violation.runs:,} runs violate a requirement" in words
    assert words.index("violate a requirement") < words.index("Probability that a run") < words.index("<table")
    for one in found.requirements:
        assert f"{one.violation.events:,} of {one.violation.runs:,}" in words
        assert tables.chances(one.violation.low, one.violation.high) in words
    assert "1 run diverged, counted as violating every requirement" in words
    assert "1 run could not be simulated and is not counted" in words


def test_worst_runs_are_those_of_the_table_and_have_a_command_to_repeat_them(page: str, summary: Summary) -> None:
    assert summary.statistics.worst[0].run == 11
    assert f"<pre>{AGAIN} 11</pre>" in page
    for one, words in tables.worst_rows(summary, summary.statistics.worst, tables.all_drivers(summary)):
        assert f'<th scope="row" class="number">{one.run}</th>' in page
        assert words[4].startswith("sampling.delay ")


def test_a_campaign_without_violations_passes_and_bounds_what_it_did_not_see(
    made: Plan, result: JobResult, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = counted(made, 0.5)
    assert summary.passed
    shown = html.unescape(as_html(campaign_document(summary))).replace("\u00a0", " ")
    assert "None of 400 runs violates a requirement" in shown
    assert f"below {tables.chance(clopper_pearson(0, 400).high)} with 95 % confidence" in shown
    assert "none beyond" in shown
    show_campaign(summary)
    assert "PASSED: none of 400 runs violates a requirement" in capsys.readouterr().out
    assert opening(result, summary)[-1].startswith(
        "None of the campaign's 400 runs violates a requirement: probability"
    )


def test_the_worst_run_is_simulated_again_and_drawn_where_it_is_the_one_of_the_table(made: Plan) -> None:
    table = simulate_runs(made, range(4))
    summary = summary_of(made, table)
    worst = summary.statistics.worst[0]
    name = f"run {worst.run}, {worst.manoeuvre}"
    [section] = [one for one in campaign_document(summary).sections if one.name == "trace"]
    [drawn] = section.blocks
    assert isinstance(drawn, blocks.Plate)
    assert drawn.title == name
    assert "gimbal angles" in re.sub(r"<[^>]+>", " ", drawn.svg)
    other = table | {worst.requirement: table[worst.requirement] * np.where(table["run"] == worst.run, 1.01, 1.0)}
    [section] = [one for one in campaign_document(summary_of(made, other)).sections if one.name == "trace"]
    assert section.blocks[0].text.startswith(f"{name.capitalize()} is not drawn")  # type: ignore[union-attr]


def test_the_decay_rate_of_a_stable_loop_is_never_the_tightest(result: JobResult) -> None:
    slow = [one for one in result.requirements if one.name.startswith("minimum decay rate")]
    assert slow
    assert tightest(slow) is None
    assert tightest([]) is None
    failed = dataclasses.replace(slow[0], passed=False, value=-1.0)
    assert tightest([failed, *result.requirements]) is failed


def test_a_campaign_adds_its_probability_with_bounds_and_main_input(result: JobResult, summary: Summary) -> None:
    found = summary.statistics.violation
    assert 0 < found.events < found.runs
    sentence = opening(result, summary)[-1].replace("\u00a0", " ")
    assert f"campaign of {found.runs} runs" in sentence
    assert tables.chance(found.estimate) in sentence
    assert tables.chances(found.low, found.high) in sentence
    assert "“sampling.delay”" in sentence


def plates(parts: tuple[Any, ...]) -> list[tuple[str, str, str]]:
    found = []
    for block in parts:
        own = isinstance(block, blocks.Plate)
        found += [(block.title, block.caption, block.svg)] if own else plates(getattr(block, "blocks", ()))
    return found


def test_the_campaigns_section_shows_what_the_campaigns_own_page_does(
    result: JobResult, with_campaign: blocks.PageContent, summary: Summary
) -> None:
    names = [section.name for section in with_campaign.sections]
    assert names.index("runs") + 1 == names.index("campaign") == len(names) - 2
    own = campaign_document(summary, again=AGAIN)
    shown = plates(tuple(block for one in own.sections for block in one.blocks))
    assert len(shown) == 2
    assert plates(with_campaign.sections[-2].blocks) == shown
    assert f"<pre>{AGAIN} {summary.statistics.worst[0].run}</pre>" in as_html(with_campaign)
    words = text_of(as_html(with_campaign))
    assert "simulated with other" not in words
    assert "this report has none" not in words
    # What violates a limit in a campaign is part of the banner.
    assert result.passed
    assert not with_campaign.passed
    assert tables.campaign_words(summary) in with_campaign.verdict
    assert tables.campaign_words(summary) in text_of(as_html(with_campaign).split('id="requirements"')[0])


# Pictures of runs and campaigns for scripts


@pytest.fixture(scope="module")
def gyro():
    return pc.read_platform("gimballed_gyro")


@pytest.fixture(scope="module")
def flown(gyro):
    turn = pc.simulation.HalfCosine(axis=1, rate=0.01, rise=0.01, hold=0.0)
    return simulated(gyro, [], period=0.001, delay=0.0, duration=0.05, mode="caged", profile=turn, noise=False)


def shaded(axes):
    """The edges of the shaded regions that are not at infinity."""
    edges = []
    for patch in axes.patches:
        if to_hex(patch.get_facecolor()) == BEYOND:
            bottom, top = patch.get_y(), patch.get_y() + patch.get_height()
            edges.append(min((bottom, top), key=abs))
    return sorted(edges)


def test_a_run_is_shaded_beyond_the_limits_of_its_manoeuvre(flown, gyro):
    limit = 1.5 * float(np.abs(flown.q).max())
    manoeuvre = Manoeuvre(name="turn", mode="caged", duration=0.05, limits={"angle": limit})
    figure = figures.time_run(Run(manoeuvre=manoeuvre, trajectory=flown, results=()), gyro)
    scale = {"mrad": 1e3, "µrad": 1e6}[figure.axes[0].get_ylabel()]
    assert shaded(figure.axes[0]) == pytest.approx([-scale * limit, scale * limit])
    assert figure.axes[0].get_xlim() == (0.0, 0.05)


def columns_of_runs(runs=200):
    rng = np.random.default_rng(3)
    angle = 1e-3 * (1.0 + 0.2 * rng.standard_normal(runs))
    return {
        "run": np.arange(runs),
        "manoeuvre": np.array(["turn"] * runs, dtype=object),
        "angle": angle,
        "attitude": np.zeros(runs),
        "torque_share": np.full(runs, 0.5),
        "angle_passed": angle <= 1.2e-3,
        "passed": angle <= 1.2e-3,
        "ended": np.array(["completed"] * runs, dtype=object),
    }


ANGLE_LIMIT = {"turn": {"angle": 1.2e-3}}


def test_histograms_count_every_run_and_colour_those_beyond_the_limit():
    columns = columns_of_runs()
    beyond = int(np.count_nonzero(columns["angle"] > 1.2e-3))
    figure = figures.campaign_histograms(statistics(typed(columns), ANGLE_LIMIT))
    [axes] = [axes for axes in figure.axes if axes.get_visible()]
    stairs = {to_hex(patch.get_facecolor()): patch.get_data() for patch in axes.patches if hasattr(patch, "get_data")}
    assert stairs[SERIES[0]].values.sum() == 200
    assert abs(stairs[LIMIT].values.sum() - beyond) <= 1
    assert f"{beyond} beyond" in [text.get_text() for axes in figure.axes for text in axes.texts]
    [start] = [patch.get_x() for patch in axes.patches if to_hex(patch.get_facecolor()) == BEYOND]
    assert start == pytest.approx(1.2)


def test_pyplot_knows_the_plots_of_scripts_and_those_of_pages_not(gyro):
    loop = figures.nichols(control.tf([1.0], [1.0, 1.0])).figure
    assert [pyplot.figure(number) for number in pyplot.get_fignums()] == [loop]
    bode = figures.bode(control.tf([1.0], [1.0, 1.0])).figure
    assert bode is not loop
    with style.settings():
        figures.campbell(gyro)
    assert len(pyplot.get_fignums()) == 2
