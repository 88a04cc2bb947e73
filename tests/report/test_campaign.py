"""A campaign's page and terminal tables: what was counted stands there, and nothing is loaded from elsewhere."""

from __future__ import annotations

import html
import re
from html.parser import HTMLParser

import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl.campaign.planning import plan
from platform_ctrl.campaign.single_run import simulate_runs
from platform_ctrl.campaign.statistics import clopper_pearson
from platform_ctrl.campaign.summary import summarise
from platform_ctrl.cli.campaign_command import show_campaign
from platform_ctrl.report import campaign_tables as tables
from platform_ctrl.report import style
from platform_ctrl.report.blocks import html as as_html
from platform_ctrl.report.campaign_page import campaign_document
from platform_ctrl.report.figures import campaign as campaign_figures
from report_jobs import caging, job, turn

TURN = {"rise": 0.5, "hold": 1.0, "duration": 2.5}
PUSH = {"name": "push", "mode": "stabilised", "axis": 1, "torque": 0.1, "duration": 1.5, "limits": {"attitude": 0.01}}
MOMENTUM = {"parameter": "rotor.11.angular_momentum", "distribution": "normal", "mean": 1.0, "deviation": 0.05}
DELAY = {"parameter": "sampling.delay", "distribution": "uniform", "low": 0.0004, "high": 0.0006}
JOB = job(
    name="tolerances & <faults>",
    operation={"Omega": [1.0, 1.0, 1.0], "seed": 1976},
    uncertainty={},
    loop=[caging({"name": "classical", "method": "classical", "crossover_hz": 30}, name="9-10")],
    manoeuvre=[
        turn(name="turn about 1", **TURN, limits={"angle": 0.003, "torque_share": 1.0}),
        turn(name="turn about 2", axis=2, **TURN, limits={"angle": 0.003}),
        PUSH,
    ],
    fault=[{"name": "weak Q9", "kind": "torquer weak", "part": "Q9", "at": 0.2, "share": 0.5}],
    campaign={
        "runs": 1500,
        "seed": 3,
        "vary": [{**MOMENTUM, "relative": True}, DELAY],
        "fault": [{"fault": "weak Q9", "probability": 0.1}],
    },
)


def planned(**changes):
    return plan(pc.read_job(JOB | changes), ())


def by_formula(made, scale=1.0, odd=True):
    """The table of a campaign whose figures follow from a formula."""
    N, inputs = made.runs, made.inputs(0, made.runs)
    rng = np.random.default_rng(4)
    limits = {one.name: one.limits for one, _ in made.job.campaign_manoeuvres}
    momentum, weak = inputs["rotor.11.angular_momentum"], inputs["fault.weak Q9"]
    table = {
        "run": np.arange(N),
        **inputs,
        "angle": scale * 0.0018 / momentum**3 * (1 + 0.5 * weak) * np.exp(0.1 * rng.normal(size=N)),
        "attitude": scale * 0.006 * np.exp(0.1 * rng.normal(size=N)),
        "torque_share": scale * 0.6 * momentum * np.exp(0.05 * rng.normal(size=N)),
        "ended": np.full(N, "completed", dtype=object),
    }
    if odd:
        table["ended"][11], table["ended"][12] = "diverged at t = 0.3 s", "not simulated: its worker died"
        for name in ("angle", "attitude", "torque_share"):
            table[name][11] = np.inf
    passed = np.ones(N, dtype=bool)
    for name in ("angle", "attitude", "torque_share"):
        limit = np.array([limits[one].get(name, np.nan) for one in inputs["manoeuvre"]])
        met = table[name] <= limit
        table[f"{name}_passed"] = np.array([None if np.isnan(x) else bool(y) for x, y in zip(limit, met, strict=True)])
        passed &= met | np.isnan(limit)
    return table | {"passed": passed}


@pytest.fixture(scope="module")
def made():
    return planned()


@pytest.fixture(scope="module")
def summary(made):
    return summarise(made, by_formula(made))


@pytest.fixture(scope="module")
def page(summary):
    return as_html(
        campaign_document(
            summary,
            command="platform-ctrl campaign job.toml --runs 1500",
            again="platform-ctrl simulate job.toml --run",
        )
    )


class Links(HTMLParser):
    """What a page would load, and whether its tags are closed."""

    def __init__(self):
        super().__init__()
        self.loaded, self.open, self.ids, self.targets = [], [], [], []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.loaded += [given[key] for key in ("src", "href") if key in given and not given[key].startswith("#")]
        self.targets += [given["href"][1:] for key in ("href",) if given.get(key, "").startswith("#") and tag == "a"]
        self.ids += [given["id"]] if "id" in given else []
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_the_page_needs_nothing_else_and_is_whole(page):
    links = Links()
    links.feed(page)
    assert links.open == []
    assert links.loaded == []
    assert all(links.ids.count(target) == 1 for target in links.targets)
    assert len(links.targets) == 7
    assert not re.search(r"url\((?!#)|@import|https?://(?!www\.w3\.org)", page)
    assert "tolerances &amp; &lt;faults&gt;" in page


def test_verdict_and_probabilities_come_first(page, summary):
    found = summary.statistics
    words = html.unescape(page)
    assert f"{found.violation.events:,} of {found.violation.runs:,} runs violate a requirement" in words
    assert words.index("violate a requirement") < words.index("Probability that a run") < words.index("<table")
    for one in found.requirements:
        assert f"{one.violation.events:,} of {one.violation.runs:,}" in words
        assert tables.chances(one.violation.low, one.violation.high) in words
    assert "1 run diverged, counted as violating every requirement" in words
    assert "1 run could not be simulated and are not counted" in words


def test_worst_runs_are_those_of_the_table_and_have_a_command_to_repeat_them(page, summary):
    assert summary.statistics.worst[0].run == 11
    assert "platform-ctrl simulate job.toml --run 11" in page
    for one, words in tables.worst_rows(summary, summary.statistics.worst, tables.all_drivers(summary)):
        assert f'<th scope="row" class="number">{one.run}</th>' in page
        assert (
            f"rotor.11.angular_momentum {summary.inputs_of(one.run)['rotor.11.angular_momentum']:.3g}"[:27] in words[4]
        )


def test_a_campaign_without_violations_passes_and_bounds_what_it_did_not_see(made, capsys):
    summary = summarise(made, by_formula(made, scale=0.3, odd=False))
    bound = clopper_pearson(0, 1500).high
    assert summary.passed
    shown = html.unescape(as_html(campaign_document(summary)))
    assert "None of 1,500 runs violates a requirement" in shown
    assert f"below {tables.chance(bound)} with 95 % confidence" in shown
    assert "none beyond" in shown
    show_campaign(summary)
    printed = capsys.readouterr().out
    assert "PASSED: none of 1,500 runs violates a requirement" in printed


def test_the_worst_run_is_simulated_again_and_drawn_where_it_is_the_one_of_the_table(made):
    table = simulate_runs(made, range(4))
    summary = summarise(made, table)
    worst = summary.statistics.worst[0]
    name = f"run {worst.run}, {worst.manoeuvre}"
    [section] = [one for one in campaign_document(summary).sections if one.name == "trace"]
    [drawn] = section.blocks
    assert drawn.title == name
    assert "gimbal angles" in re.sub(r"<[^>]+>", " ", drawn.svg)
    other = table | {worst.requirement: table[worst.requirement] * np.where(table["run"] == worst.run, 1.01, 1.0)}
    [section] = [one for one in campaign_document(summarise(made, other)).sections if one.name == "trace"]
    assert section.blocks[0].text.startswith(f"{name.capitalize()} is not drawn")


def test_histograms_count_every_run_once_and_colour_those_beyond(summary):
    found = summary.statistics
    with style.settings():
        drawn = campaign_figures.histogram_figure(found, "angle")
    for axes, name in zip(drawn.axes, ("turn about 1", "turn about 2"), strict=False):
        one = found.of("angle", name)
        everything, beyond = axes.patches[:2]
        diverged = np.isinf(one.values).sum()
        assert everything.get_data().values.sum() == one.violation.runs - diverged
        assert beyond.get_data().values.sum() == pytest.approx(one.violation.events - diverged, abs=1)
        limit = 3.0  # mrad: an edge of a bin
        assert np.abs(everything.get_data().edges - limit).min() < 1e-9


def test_of_one_violating_run_no_cause_is_asserted(capsys, monkeypatch):
    """Not even where it alone has a fault, which by chance happens in one run of thousands."""
    monkeypatch.setenv("COLUMNS", "200")
    one = planned(campaign=JOB["campaign"] | {"fault": [{"fault": "weak Q9", "probability": 0.0005}]})
    table = by_formula(one, scale=0.3, odd=False)
    table["fault.weak Q9"] = np.arange(len(table["run"])) == 7
    table["angle"] = np.where(table["fault.weak Q9"], 0.5, 0.001 * table["rotor.11.angular_momentum"])
    table["angle_passed"] = table["passed"] = ~table["fault.weak Q9"]
    summary = summarise(one, table)
    assert summary.statistics.violation.events == 1
    assert any(one.in_every_violation and one.p_value < 0.01 for one in summary.influences)
    assert tables.causes(summary) == []
    show_campaign(summary)
    told = capsys.readouterr().out
    assert "no cause can be told" in told
    page = html.unescape(re.sub(r"<[^>]+>", " ", as_html(campaign_document(summary))))
    for words in ("every violating run", "What violating runs have in common"):
        assert words not in told + page
