"""What a campaign says: probabilities with exact bounds, quantiles, worst runs, and what drives them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from platform_ctrl.campaign.statistics import clopper_pearson, statistics
from platform_ctrl.campaign.store import typed
from platform_ctrl.campaign.summary import influences

INPUTS = ("manoeuvre", "rotor.11.spin", "root.inertia", "dead torquer")
LIMITS = {"turn": {"angle": 0.003, "torque_share": 1.0}, "push": {"angle": 0.002, "attitude": 0.01}}


def table_of_runs(N=4000, seed=1):
    """A campaign by formula: the angle follows the spin, the torque a fault; the mass does nothing."""
    rng = np.random.default_rng(seed)
    manoeuvre = rng.choice(["turn", "push"], N)
    spin, mass, dead = rng.normal(1.0, 0.05, N), rng.uniform(0.9, 1.1, N), rng.random(N) < 0.1
    table = {
        "run": np.arange(N),
        "manoeuvre": manoeuvre,
        "rotor.11.spin": spin,
        "root.inertia": mass,
        "dead torquer": dead,
        "angle": 0.0015 / spin**4 * np.exp(0.1 * rng.normal(size=N)),
        "attitude": np.where(manoeuvre == "turn", 1.5, 0.004 * np.exp(0.2 * rng.normal(size=N))),
        "torque_share": 0.5 + 0.3 * dead + 0.1 * rng.random(N),
        "ended": np.full(N, "completed", dtype=object),
    }
    table["angle"][7], table["ended"][7] = np.inf, "diverged at t = 0.2 s"
    table["attitude"][7] = table["torque_share"][7] = np.inf
    return judged(table)


def judged(table):
    everything = np.ones(len(table["run"]), dtype=bool)
    for figure in ("angle", "attitude", "torque_share"):
        limit = np.array([LIMITS[name].get(figure, np.nan) for name in table["manoeuvre"]])
        met = table[figure] <= limit
        table[f"{figure}_passed"] = np.array(
            [None if np.isnan(x) else bool(y) for x, y in zip(limit, met, strict=True)]
        )
        everything &= met | np.isnan(limit)
    table["passed"] = everything
    return table


@pytest.mark.parametrize(("events", "runs"), [(0, 10), (0, 10_000), (3, 50), (50, 50), (311, 10_000)])
def test_bounds_are_those_that_scipy_calls_exact(events, runs):
    found = clopper_pearson(events, runs)
    exact = stats.binomtest(events, runs).proportion_ci(0.95, method="exact")
    assert (found.low, found.high) == pytest.approx((exact.low, exact.high), rel=1e-9, abs=1e-15)
    assert found.estimate == events / runs


def test_every_requirement_is_counted_as_the_table_judges_it():
    table = table_of_runs()
    found = statistics(typed(table), LIMITS)
    turn = table["manoeuvre"] == "turn"
    for figure, rows in (("angle", turn | True), ("torque_share", turn), ("attitude", ~turn)):
        answers = table[f"{figure}_passed"][rows]
        one = found.of(figure)
        assert (one.violation.events, one.violation.runs) == (sum(x is False or x == 0 for x in answers), rows.sum())
        # Over all manoeuvres in units of each one's own limit.
        limit = np.array([LIMITS[name].get(figure, np.nan) for name in table["manoeuvre"]])
        exact = np.quantile((table[figure] / limit)[rows], 0.5, method="inverted_cdf")
        assert one.quantiles[0.5] == exact
        assert one.limit == 1.0
    push = found.of("angle", "push")
    exact = np.quantile(table["angle"][~turn], 0.9, method="inverted_cdf")
    assert (push.limit, push.quantiles[0.9]) == (0.002, exact)
    assert found.violation.events == (~table["passed"]).sum()
    assert found.passed is False


def test_a_run_that_diverged_violates_what_is_asked_and_is_the_worst():
    found = statistics(typed(table_of_runs()), LIMITS)
    assert (found.diverged, found.endings["diverged"]) == (1, 1)
    assert found.worst[0].run == 7
    assert found.worst[0].ended.startswith("diverged")
    assert np.isinf(found.of("angle").largest)


def test_runs_that_were_not_simulated_count_neither_way_and_are_told():
    table = table_of_runs(200)
    table["ended"][[3, 4]] = "not simulated: a torquer has no limit"
    found = statistics(typed(table), LIMITS)
    assert (found.runs, found.simulated, found.not_simulated) == (200, 198, 2)
    assert found.violation.runs == 198
    assert found.endings["not simulated: a torquer has no limit"] == 2


def test_the_worst_runs_are_those_with_the_largest_ratios():
    table = table_of_runs()
    limit = np.array([LIMITS[name]["angle"] for name in table["manoeuvre"]])
    expected = np.lexsort((table["run"], -(table["angle"] / limit)))[:10]
    found = statistics(typed(table), LIMITS)
    assert [one.run for one in found.of("angle").worst] == expected.tolist()
    assert all(one.ratio >= other.ratio for one, other in zip(found.worst, found.worst[1:], strict=False))
    worst = found.of("angle", "turn").worst[1]
    assert worst.value == table["angle"][worst.run]
    assert (worst.manoeuvre, worst.limit) == ("turn", 0.003)


def test_what_drives_the_campaign_s_requirements_is_found():
    found = {
        (one.requirement, one.manoeuvre, one.parameter): one
        for one in influences(typed(table_of_runs()), LIMITS, INPUTS)
    }
    spin = found["angle", "push", "rotor.11.spin"]
    assert spin.driver
    assert spin.correlation < -0.7
    assert spin.cause
    assert spin.level.startswith("below 0.97")
    assert {one.parameter for one in found.values() if one.requirement == "torque_share" and one.driver} == {
        "dead torquer"
    }
    assert found["passed", None, "manoeuvre"].level == "push"
    assert found["passed", None, "manoeuvre"].cause
    mass = found["passed", None, "root.inertia"]
    assert not mass.driver
    assert not mass.cause
    assert math.isnan(found["passed", None, "manoeuvre"].correlation)
    assert ("attitude", "turn", "rotor.11.spin") not in found


def test_correlations_and_p_values_are_those_of_scipy():
    table = table_of_runs()
    push = table["manoeuvre"] == "push"
    one = next(
        one
        for one in influences(typed(table), LIMITS, inputs=["rotor.11.spin"])
        if (one.requirement, one.manoeuvre) == ("angle", "push")
    )
    exact = stats.spearmanr(table["rotor.11.spin"][push], table["angle"][push])
    assert one.correlation == pytest.approx(exact.statistic, rel=1e-9)
    low = table["rotor.11.spin"][push] < np.quantile(table["rotor.11.spin"][push], 1.0 / 3.0)
    violated = table["angle"][push] > 0.002
    counts = [[(violated & side).sum(), (~violated & side).sum()] for side in (low, ~low)]
    assert [one.present.events, one.absent.events] == [counts[0][0], counts[1][0]]
    # Four tests: three thirds and a correlation, whose p-value is smaller.
    assert one.p_value == pytest.approx(3 * stats.fisher_exact(counts)[1], rel=1e-9, abs=0.0)


# With and without


def rare_fault(N=500):
    """As the shipped job: a fault in one run of fifty, which violates one manoeuvre of three and nothing else does."""
    run = np.arange(N)
    table = {
        "run": run,
        "manoeuvre": np.array(["turn", "push", "step"])[run % 3],
        "rotor.11.spin": np.random.default_rng(2).normal(1.0, 0.03, N),
        "gain": np.array([0.5, 1.0])[run % 2],
        "fault.weak": run % 50 == 0,
        "fault.noise": run % 7 == 0,
        "ended": np.full(N, "completed", dtype=object),
    }
    table["passed"] = ~(table["fault.weak"] & (table["manoeuvre"] == "turn"))
    table["angle"] = np.where(table["passed"], 0.001, 0.004)
    table["angle_passed"] = table["passed"]
    return table


def found_of(found, parameter, manoeuvre=None, figure="passed"):
    key = (figure, manoeuvre, parameter)
    [one] = [one for one in found if (one.requirement, one.manoeuvre, one.parameter) == key]
    return one


def test_a_rare_fault_of_all_violations_is_seen_in_counts_where_no_rank_shows_it():
    table = rare_fault()
    limits = {"turn": {"angle": 0.003}, "push": {"angle": 0.003}, "step": {"angle": 0.003}}
    found = influences(typed(table), limits, inputs=["manoeuvre", "gain", "fault.weak", "fault.noise"])
    one = found_of(found, "fault.weak")
    assert (one.present.events, one.present.runs, one.absent.events, one.absent.runs) == (4, 10, 0, 490)
    assert one.in_every_violation
    assert one.cause
    assert found[0].requirement == "angle"
    inside = found_of(found, "fault.weak", manoeuvre="turn")
    assert (inside.present.events, inside.present.runs) == (4, 4)
    assert inside.absent.high == pytest.approx(1.0 - 0.025 ** (1.0 / inside.absent.runs), rel=1e-9)
    assert found_of(found, "gain").level in (0.5, 1.0)
    assert not found_of(found, "fault.noise").cause
    # All four violating runs among the ten with the fault, by counting the ways, as one of several tests.
    ways = math.comb(10, 4) / math.comb(500, 4)
    assert ways < one.p_value <= 10 * ways
