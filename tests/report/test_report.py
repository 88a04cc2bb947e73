"""The report: one file that needs nothing else, every requirement on it, figures that show what was computed."""

from __future__ import annotations

import dataclasses
import html
import re
import tomllib
from collections.abc import Iterable
from fractions import Fraction
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import narrow_loops
import platform_ctrl as pc
from camera_job import camera_plant
from legend_entries import without_a_curve
from passive_gimbal import passive_job
from plant_parts import Spring
from platform_ctrl.analysis.metrics import Sense
from platform_ctrl.cli.terminal import show_result
from platform_ctrl.design import loops
from platform_ctrl.design.loop import Design, measured
from platform_ctrl.job.quantities import compared, plain
from platform_ctrl.job.reading import job_data
from platform_ctrl.job.requirements import CheckResult, Requirement, requirement
from platform_ctrl.mechanics import modes
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.state_space import coupled_while_changing
from platform_ctrl.report import blocks, captions, comparison, curves, style, tables
from platform_ctrl.report.campaign_tables import chances
from platform_ctrl.report.figures.job import platform_compliance
from platform_ctrl.report.figures.panels import paint
from platform_ctrl.verification import check_job
from platform_ctrl.verification.proofs import Claim, Proofs, with_proofs
from platform_ctrl.verification.verdict import JobResult
from report_jobs import caging, checked, classical, job, page_html, turn

CAGING = caging(
    classical("slow & <plain>", 30),
    classical(),
    limits={"bandwidth_hz": 20, "disk_margin": 0.9, "damping": 0.05, "torque_noise": 0.008},
)
SERVO = {"name": "servo", "method": "platform-servo", "crossover_hz": 5, "position_hz": 2}
PUSH = {"name": "step", "mode": "stabilised", "axis": 1, "torque": 0.1, "duration": 0.8}
JOB = job(
    name="three gyros, a <b>bold</b> $name$",
    loop=[
        caging(
            classical(crossover_hz=30),
            name="caging 4-5-7",
            gimbals=["4", "5", "7"],
            limits={"bandwidth_hz": 20, "disk_margin": 0.4},
        ),
        CAGING,
        {"name": "stabilisation", "kind": "stabilisation", "use": "servo", "design": [SERVO]},
    ],
    coupled={"disk_margin": 0.2, "coupling_cost": 0.05},
    manoeuvre=[
        turn(name="caged turn", limits={"angle": 0.003, "torque_share": 1.0}),
        {**PUSH, "limits": {"attitude": 0.02, "angle": 0.0005}},
    ],
)


@pytest.fixture(scope="module")
def result() -> JobResult:
    return checked(JOB)


@pytest.fixture(scope="module")
def page(result: JobResult) -> str:
    """The page, every legend entry of whose figures looks like a curve that is drawn."""
    wrong: list[str] = []
    plain_svg = style.svg

    def judged(figure: Any, description: str) -> str:
        wrong.extend(without_a_curve(figure))
        return plain_svg(figure, description)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "svg", judged)
        made = page_html(result)
    assert wrong == []
    assert "not drawn" not in made
    return made


@pytest.fixture(scope="module")
def lone_loop() -> JobResult:
    """One loop, no servo, no manoeuvre, no uncertainty: the platform is carried, and the other gyros are left out."""
    return checked(job(name="one loop", loop=[CAGING], uncertainty={}))


@pytest.fixture(scope="module")
def lone_page(lone_loop: JobResult) -> str:
    return page_html(lone_loop)


@pytest.fixture(scope="module")
def compared_designs() -> JobResult:
    """Four designs of one loop, with goals and faults; the simple one is closed, and has claims."""
    limits = {"bandwidth_hz": 20, "disk_margin": 0.4, "sensitivity_peak": 3, "tracking": 0.5, "tracking_hz": 2}
    limits |= {"torque_limit": 5, "fastest_pole": 3e4, "disk_margin_worst_case": 0.2, "damping_faults": 0.001}
    loop = {
        **CAGING,
        "use": "simple",
        "limits": limits,
        "soft": {"bandwidth_hz": 25, "disk_margin": 1.9},
        "design": [
            classical("simple"),
            {"name": "H-infinity", "method": "hinf", "bandwidth_hz": 50},
            classical("quiet", 35, lead_hz=6),
            classical("slow", 30),
        ],
    }
    data = pc.read_job(job(loop=[loop], faults={"weak_torquer": 0.8}))
    [outcome] = loops(data)
    claims = {
        "gamma": 1.3,
        "gamma_optimal": 1.25,
        "bandwidth_bound_hz": 80.0,
        "largest Omega1 without saturation, rad/s": 1.31,
    }
    closed = dataclasses.replace(outcome.designs[0], claims=claims)
    return check_job(data, [dataclasses.replace(outcome, designs=(closed, *outcome.designs[1:]))])


@pytest.fixture(scope="module")
def compared_page(compared_designs: JobResult) -> str:
    return page_html(compared_designs)


class Cells(HTMLParser):
    """Text of every table cell, row by row."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.inside = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
            self.inside = True

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.rows[-1][-1] += data


def visible_text(page: str) -> str:
    body = re.sub(r"<style.*?</style>|<pre.*?</pre>", " ", page, flags=re.DOTALL)
    return html.unescape(re.sub(r"<[^>]*>", " ", body))


# The page


def test_every_requirement_is_on_the_page_with_value_and_limit(result: JobResult, page: str) -> None:
    shown = {tuple(cell.strip() for cell in row[1:3]) for row in Cells(page).rows if len(row) == 7}
    rows = tables.requirement_rows(result)
    assert len(rows) == len(result.requirements) > 10
    for row in rows:
        assert (row.value, row.limit) in shown
        assert row.checked.name in page


def test_names_are_text_and_never_markup(page: str) -> None:
    assert "<b>bold" not in page
    assert "&lt;b&gt;bold&lt;/b&gt; $name$" in page
    assert "slow &amp; &lt;plain&gt;" in page
    assert "<plain>" not in page


def test_the_printed_job_reads_back_to_the_last_bit(result: JobResult, page: str) -> None:
    [printed] = re.findall(r"<pre[^>]*>(name = .*?|schema = .*?)</pre>", page, flags=re.DOTALL)
    again = pc.read_job(tomllib.loads(html.unescape(printed)))
    assert job_data(again) == job_data(result.job)
    before, after = pc.matrices(result.job.platform), pc.matrices(again.platform)
    assert np.array_equal(before.A_star, after.A_star)
    assert np.array_equal(before.L, after.L)


# Writing


# Degenerate results


def test_one_loop_without_servo_and_manoeuvres_has_a_page(lone_loop: JobResult, lone_page: str) -> None:
    assert lone_loop.coupled.stable
    assert "The coupled system is unstable" not in lone_page
    assert "Torque on the platform" not in lone_page
    assert 'id="runs"' not in lone_page
    assert not re.search(r"\b(nan|inf)\b", visible_text(lone_page), re.IGNORECASE)


def test_runs_that_diverged_are_drawn_as_far_as_they_went(result: JobResult) -> None:
    run = result.runs[0]
    lost = []
    for samples in (0, 1, 40):
        cut = {
            name: getattr(run.trajectory, name)[:samples].copy()
            for name in ("t", "q", "rate", "p", "reading", "command", "torque", "Omega", "attitude")
        }
        if samples > 1:
            cut["q"][-3:] = [[1e3] * 5, [np.inf] * 5, [np.nan] * 5]
            cut["command"][-1] = np.nan
        trajectory = dataclasses.replace(run.trajectory, ended=f"diverged at t = {samples} ms", **cut)
        lost.append(dataclasses.replace(run, trajectory=trajectory))
    text = page_html(dataclasses.replace(result, loops=(), runs=tuple(lost)))
    assert [f"diverged at t = {samples} ms" in visible_text(text) for samples in (0, 1, 40)] == [True] * 3
    assert not re.search(r"\b(nan|inf)\b", visible_text(text), re.IGNORECASE)


# Tables


def test_the_terminal_shows_the_same_rows(
    result: JobResult, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    show_result(result)
    lines = capsys.readouterr().out.splitlines()
    [folded] = [line for line in lines if line.startswith("also met, by 100 % or more: ")]
    for row in tables.requirement_rows(result):
        shown = any(
            all(words in line for words in (row.checked.name, row.value, row.limit, row.margin)) for line in lines
        )
        assert shown or row.checked.name in folded


# Goals


def test_goals_are_separate_from_requirements(compared_designs: JobResult, compared_page: str) -> None:
    goals = tables.goal_rows(compared_designs)
    assert {(row.checked.name, row.checked.passed) for row in goals} == {
        ("goal: bandwidth", True),
        ("goal: disk margin", False),
    }
    assert not any(not row.checked.hard for row in tables.requirement_rows(compared_designs))
    assert tables.verdict(compared_designs, None)[1] == f"all {len(compared_designs.requirements)} requirements met"
    part = re.findall(r'<tbody class="quiet">.*?</tbody>', compared_page, flags=re.DOTALL)[0]
    assert "not part of the verdict" in part
    assert [part.count(words) for words in ("✓ reached", "– not reached", "missed")] == [1, 1, 0]
    assert "1 of 2 goals reached" in visible_text(compared_page)


def designs_in(rows: Iterable[blocks.Row]) -> dict[str, tuple[blocks.Cell, ...]]:
    """Return the cells of the designs by the names of their rows."""
    return {row.cells[0].text: row.cells[2:] for row in rows}


# Proofs, plants, claims, the price


def proved_in_part(compared_designs: JobResult) -> JobResult:
    """The job with proofs of the closed design, of which the last is not proved."""
    closed = compared_designs.loops[0].closed
    claims = (
        Claim(plant="nominal", kind="stability", bound=12.0, bits=256),
        Claim(plant="<this>", kind="stability", bound=7.5, bits=256),
        Claim(plant="nominal", kind="disk margin", bound=0.5, bits=512),
        Claim(plant="<this>", kind="disk margin", bound=0.4, bits=0),
    )
    proofs = Proofs(claims=claims)
    judged = with_proofs(closed.results, proofs, closed.loop, closed.name)[-1]
    return dataclasses.replace(
        compared_designs,
        proofs={(closed.loop, closed.name): proofs},
        requirements=(*compared_designs.requirements, judged),
    )


def test_what_is_proved_and_what_is_not_is_mentioned(compared_designs: JobResult) -> None:
    result = proved_in_part(compared_designs)
    designs = result.loops[0].designs
    assert comparison.proof_rows(designs, {}) == []
    rows = designs_in(comparison.proof_rows(designs, result.proofs))
    assert rows["minimum decay rate"][0].text == "✓ ≥ 7.5 1/s with all 2 plants"
    assert (rows["disk margin"][0].text, rows["disk margin"][0].tone) == ("✗ ≥ 0.5 with 1 of 2 plants", "bad")
    assert "Not proved: simple: the loop with <this> has a disk margin above 0.4" in visible_text(page_html(result))
    shown = [(row.value, row.limit) for row in tables.requirement_rows(result)
             if row.checked.name == "certified properties"]  # fmt: skip
    assert shown == [("3 of 4", "all")]


# Tables again


def number_in(text: str) -> Fraction:
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
    mantissa, _, exponent = text.partition("·10")
    return Fraction(mantissa.translate(raised)) * Fraction(10) ** int(exponent.translate(raised) or 0)


def asked(measured: float, limit: float, unit: str, sense: Sense = "at least") -> CheckResult:
    one = Requirement(name="figure", limit=limit, unit=unit, sense=sense)
    return one.judge(measured, subject="loop", stage="decoupled", evidence="")


@given(
    st.floats(1e-9, 1e9), st.floats(1e-9, 1e9), st.sampled_from(["at least", "at most"]), st.sampled_from(["", "rad"])
)
def test_a_judged_value_is_never_printed_better_than_it_is(value: float, limit: float, sense: Sense, unit: str) -> None:
    one = asked(value, limit, unit, sense)
    words, _, shown_unit = compared(one)[0].partition(" ")
    shown = number_in(words)
    exact = Fraction(repr(value)) * {"mrad": 1000, "µrad": 1_000_000}.get(shown_unit, 1)
    assert shown <= exact if sense == "at least" else shown >= exact
    assert shown == pytest.approx(float(exact), rel=1e-3)


@given(st.floats(1e-9, 1.0), st.floats(0.0, 1.0))
def test_an_interval_of_probabilities_is_printed_no_narrower_than_it_is(high: float, share: float) -> None:
    low = share * high
    text = chances(low, high)
    # What is no power of ten is in per cent.
    shown = [number_in(word) / (1 if "·" in word else 100) for word in text.split() if word[0].isdigit()]
    assert text.startswith("above") or shown[-1] >= Fraction(repr(high))
    assert text.startswith("below") or shown[0] <= Fraction(repr(low))


# Figures of several designs


def test_limits_and_goals_are_drawn_where_they_belong(compared_designs: JobResult) -> None:
    loop = curves.shown_loop(compared_designs.loops[0])
    assert loop is not None
    with style.settings():
        left, middle, right = paint(curves.sensitivity(loop), 2.0).axes
        shares = paint(curves.disturbance(loop), 2.0).axes[-1]

    def levels(axes: Any, colour: str) -> set[float]:
        drawn = [line for line in axes.lines if line.get_color() == colour]
        return {round(float(y), 6) for line in drawn for y in np.atleast_1d(line.get_ydata())}

    assert levels(left, style.LIMIT) == {3.0, 0.5}
    assert [round(float(line.get_xdata()[0]), 6) for line in left.lines if line.get_color() == style.MUTED] == [25.0]
    assert levels(middle, style.LIMIT) == set()
    assert levels(right, style.LIMIT) == {2.5}
    assert levels(right, style.MUTED) == {round(1 / 1.9, 6)}
    assert levels(shares, style.LIMIT) == {5.0}


def test_captions_have_peaks_that_every_grid_misses() -> None:
    data = pc.read_job(job(loop=[CAGING], sampling={"rate_hz": 2000, "delay": 0.0}))
    [outcome] = loops(data)
    plants = outcome.closed.plants
    assert plants is not None
    # A narrow notch in the way of the nutation; the worst of several axes is more than that of any one.
    K = narrow_loops.controller(np.array([28.549, 285.48, 26.282, 305.64, 235.28, 75.46, 0.20796, 0.0061867]))
    named = K.to_control(plants.angles, plants.torques)
    design = Design(loop=outcome.spec.name, name=outcome.use, method="given", controller=named, plants=plants)
    narrow = measured(outcome.spec, design)
    outcome = dataclasses.replace(outcome, designs=(narrow,))
    loop = curves.shown_loop(outcome)
    assert loop is not None
    [one] = loop.designs
    true = requirement("Omega rejection", 1.0).check(plants, K).value
    assert one.peaks["Omega rejection"] == pytest.approx(true, rel=1e-12)
    assert one.peaks["Omega rejection"] > 1.01 * one.angle_per_rate.max()
    assert f"by more than {plain(1e3 * true, 3, 'up')} mrad" in captions.disturbance(outcome, loop)
    assert 1.0 / one.gains["disk margin"].max() == pytest.approx(narrow.measures.disk_margin[0], rel=1e-8)  # type: ignore[union-attr]


def test_a_gimbal_without_a_loop_that_is_coupled_is_on_the_page() -> None:
    result = checked(passive_job())
    assert result.subsystems == (("yoke", "camera"),)
    text = visible_text(page_html(result))
    assert "Loop transfer" in text
    assert "not drawn" not in text
    # One rigid-body mode, and the yoke's own.
    assert {mode.kind for mode in tables.modes_at(result, np.zeros(3))} == {"oscillation", "rigid body"}


def test_the_page_of_four_designs_is_whole(compared_designs: JobResult, compared_page: str) -> None:
    text = visible_text(compared_page)
    assert not re.search(r"\b(nan|inf)\b", text, re.IGNORECASE)
    assert "proved in interval arithmetic" not in text
    rows = {row[0]: row[1:] for row in Cells(compared_page).rows if len(row) == 6}
    assert rows["largest Omega1 without saturation"] == ["", "1.31 rad/s", "–", "–", "–"]
    assert rows["bandwidth bound"][1] == "80 Hz"
    for design in compared_designs.loops[0].designs:
        assert design.name in text


# Plant and modes


def test_nutation_is_that_of_the_closed_formula(result: JobResult) -> None:
    at_rest = tables.modes_at(result, np.zeros(3))
    nutation = {mode.gimbals: mode.frequency for mode in at_rest if mode.kind == "nutation"}
    assert nutation["9", "10"] == pytest.approx(0.15 / np.sqrt(5e-4 * 2e-4), rel=1e-9)
    assert nutation["4", "5", "7"] == pytest.approx(np.sqrt(2.0) * 0.15 / np.sqrt(8e-4 * 2e-4), rel=1e-9)


def camera(sign: float, rotors: list[dict[str, Any]] | None = None) -> LinearModel:
    """A two-axis camera gimbal, the pitch body's centre of mass off its axis by 3 g m, upwards or downwards."""
    return pc.linearise(
        pc.read_platform(
            {
                "schema": 1,
                "name": "camera",
                "source": "assumed",
                "root": {"name": "base", "inertia": [1, 1, 1], "specific_force": [0, 0, 9.81]},
                "gimbal": [
                    {"name": "yaw", "parent": "base", "axis": [0, 0, 1], "inertia": [0.05, 0.06, 0.07]},
                    {"name": "pitch", "parent": "yaw", "axis": [0, 1, 0], "inertia": [0.02, 0.03, 0.04]},
                ],
                "unbalance": [{"body": "pitch", "moment": [0, 0, 0.003 * sign]}],
                "rotor": rotors or [],
            }
        )
    )


def test_modes_of_a_plant_without_rotors_are_those_of_a_pendulum_and_of_a_rigid_body() -> None:
    hanging, standing = camera(-1.0), camera(1.0)
    [still] = modes.modes(hanging, ("yaw",))
    assert (still.kind, still.poles, still.frequency, still.growth) == ("rigid body", 2, 0.0, 0.0)
    [swing] = modes.modes(hanging, ("pitch",))
    assert (swing.kind, swing.poles, swing.growth) == ("pendulum", 2, 0.0)
    assert swing.frequency == pytest.approx(np.sqrt(9.81 * 0.003 / 0.03))
    # On a platform that turns, its rate alone holds yaw: no pendulum.
    turning = pc.linearise(standing.platform, Omega=(0.1, 0.1, 0.1))
    assert [mode.kind for mode in modes.modes(turning, ("yaw", "pitch"))] == ["divergence", "oscillation"]
    [fall] = modes.modes(standing, ("pitch",))
    assert (fall.kind, fall.poles, fall.frequency) == ("divergence", 2, 0.0)
    assert fall.growth == pytest.approx(np.sqrt(9.81 * 0.003 / 0.03))


def test_a_gyro_on_springs_has_nutation_and_precession() -> None:
    gyro = pc.read_platform("gimballed_gyro")
    springs = tuple(Spring(gimbal=one.name, stiffness=0.05) for one in gyro.gimbals)
    model = pc.linearise(dataclasses.replace(gyro, springs=springs, frictions=()))
    found = modes.modes(model, model.gimbal_names)
    assert [mode.kind for mode in found] == ["nutation", "precession"]
    # Their product is sqrt(det K / det M), whatever the momentum.
    product = np.sqrt(np.linalg.det(model.stiffness) / np.linalg.det(model.M))
    assert found[0].frequency * found[1].frequency == pytest.approx(product, rel=1e-9)


@pytest.mark.parametrize("name", ["three_gyro_platform", "suspended_platform", "vscmg_pyramid"])
def test_every_pole_of_a_shipped_plant_belongs_to_one_mode(name: str) -> None:
    model = pc.linearise(pc.read_platform(name), Omega=(0.1, 0.2, -0.3))
    found = [mode for group in pc.subsystems(model) for mode in modes.modes(model, group)]
    assert sum(mode.poles for mode in found) == 2 * len(model.gimbal_names)
    if not any(rotor.angular_momentum for rotor in model.platform.rotors):
        assert not {mode.kind for mode in found} & {"nutation", "precession"}


# Responses


def test_the_platform_yields_to_a_torque_as_in_the_simulation(result: JobResult) -> None:
    _, closed = platform_compliance(result, np.array([1e-2]))
    n = len(result.job.platform.gimbals)
    run = result.runs[1]
    final = run.trajectory.attitude_angles[-200:].mean(axis=0)
    assert run.manoeuvre.torque * closed[0, n, 0] == pytest.approx(final[0], rel=0.02)


@given(hnp.arrays(np.float64, st.integers(1, 3000), elements=st.floats(-1e6, 1e6)), st.integers(2, 60))
@settings(max_examples=40, deadline=None)
def test_thinning_a_trace_loses_no_extreme(y: np.ndarray, buckets: int) -> None:
    t = np.arange(len(y), dtype=np.float64)
    thin_t, thin_y = style.envelope(t, y, buckets)
    assert (thin_y.min(), thin_y.max()) == (y.min(), y.max())
    assert (thin_t[0], thin_t[-1]) == (t[0], t[-1])
    assert np.all(np.diff(thin_t) > 0.0)
    assert np.array_equal(y[thin_t.astype(int)], thin_y)
    assert len(thin_t) <= 3 * buckets


def test_yaw_and_pitch_of_a_balanced_gimbal_act_on_one_another_only_while_the_platform_rate_changes():
    """M_Omega_q: azimuth feels the derivative of the roll rate times the elevation angle."""
    model = pc.linearise(pc.read_platform(camera_plant()))
    assert pc.subsystems(model) == (("az",), ("el",))
    assert coupled_while_changing(model) == (("az", "el"),)
    assert coupled_while_changing(pc.linearise(pc.read_platform("three_gyro_platform"))) == ()
