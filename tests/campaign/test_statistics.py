"""What a campaign says: probabilities with exact bounds, quantiles, worst runs, and what drives them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from platform_ctrl.campaign.contrasts import contrasts
from platform_ctrl.campaign.probability import RESOLUTION, Distribution, clopper_pearson
from platform_ctrl.campaign.sensitivity import influences, sensitivities
from platform_ctrl.campaign.table import batches, input_names
from platform_ctrl.campaign.table_statistics import statistics
from platform_ctrl.errors import ArgumentError, InputError

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
    found = clopper_pearson(events, runs, 0.95)
    exact = stats.binomtest(events, runs).proportion_ci(0.95, method="exact")
    assert (found.low, found.high) == pytest.approx((exact.low, exact.high), rel=1e-9, abs=1e-15)
    assert found.estimate == events / runs


def test_a_true_probability_lies_within_the_bounds_at_least_as_often_as_they_say():
    p, N = 0.013, 200
    chance = stats.binom.pmf(np.arange(N + 1), N, p)
    inside = [(one := clopper_pearson(k, N, 0.9)).low <= p <= one.high for k in range(N + 1)]
    assert 0.9 <= chance[inside].sum() <= 1.0


def test_no_runs_say_nothing():
    one = clopper_pearson(0, 0)
    assert (one.low, one.high) == (0.0, 1.0)
    assert np.isnan(one.estimate)


@pytest.mark.parametrize(("events", "runs", "confidence"), [(3, 2, 0.95), (-1, 2, 0.95), (1, 2, 1.0), (1, 2, 0.0)])
def test_impossible_counts_are_refused(events, runs, confidence):
    with pytest.raises(ArgumentError, match="must be"):
        clopper_pearson(events, runs, confidence)


def test_quantiles_are_right_to_the_resolution_and_extremes_exact():
    figures = np.random.default_rng(3).lognormal(-6.0, 2.0, 50_000)
    spread = Distribution()
    spread.add(figures)
    for share in (0.01, 0.5, 0.9, 0.999):
        exact = np.quantile(figures, share, method="inverted_cdf")
        assert spread.quantile(share) == pytest.approx(exact, rel=0.51 * RESOLUTION)
    assert (spread.smallest, spread.largest, spread.runs) == (figures.min(), figures.max(), 50_000)
    edges = np.linspace(0.0, 0.05, 30)
    off = np.abs(spread.histogram(edges) - np.histogram(figures, edges)[0])
    assert off.max() <= 60


def test_a_distribution_in_pieces_is_the_whole_one():
    figures = np.append(np.random.default_rng(4).exponential(0.01, 999), [0.0, np.inf])
    whole, pieces = Distribution(), Distribution()
    whole.add(figures)
    for part in (figures[700:], figures[:0], figures[:700]):
        pieces.add(part)
    np.testing.assert_array_equal(whole.counts, pieces.counts)
    assert (whole.smallest, whole.largest) == (pieces.smallest, pieces.largest) == (0.0, np.inf)


def test_every_requirement_is_counted_as_the_table_judges_it():
    table = table_of_runs()
    found = statistics(table, LIMITS)
    turn = table["manoeuvre"] == "turn"
    for figure, rows in (("angle", turn | True), ("torque_share", turn), ("attitude", ~turn)):
        answers = table[f"{figure}_passed"][rows]
        one = found.of(figure)
        assert (one.violation.events, one.violation.runs) == (sum(x is False or x == 0 for x in answers), rows.sum())
        # Over all manoeuvres in units of each one's own limit.
        limit = np.array([LIMITS[name].get(figure, np.nan) for name in table["manoeuvre"]])
        exact = np.quantile((table[figure] / limit)[rows], 0.5, method="inverted_cdf")
        assert one.quantiles[0.5] == pytest.approx(exact, rel=RESOLUTION)
        assert one.limit == 1.0
    push = found.of("angle", "push")
    exact = np.quantile(table["angle"][~turn], 0.9, method="inverted_cdf")
    assert (push.limit, push.quantiles[0.9]) == (0.002, pytest.approx(exact, rel=RESOLUTION))
    assert found.violation.events == (~table["passed"]).sum()
    assert found.passed is False


def test_a_run_that_diverged_violates_what_is_asked_and_is_the_worst():
    found = statistics(table_of_runs(), LIMITS)
    assert (found.diverged, found.endings["diverged"]) == (1, 1)
    assert found.worst[0].run == 7
    assert found.worst[0].ended.startswith("diverged")
    assert np.isinf(found.of("angle").largest)


def test_runs_that_were_not_simulated_count_neither_way_and_are_told():
    table = table_of_runs(200)
    table["ended"][[3, 4]] = "not simulated: a torquer has no limit"
    found = statistics(table, LIMITS)
    assert (found.runs, found.simulated, found.not_simulated) == (200, 198, 2)
    assert found.violation.runs == 198
    assert found.endings["not simulated: a torquer has no limit"] == 2


def test_tables_of_earlier_versions_say_not_flown_for_runs_that_were_not_simulated(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    table = table_of_runs(200)
    table["ended"][[3, 4]] = "not flown: a torquer has no limit"
    parquet.write_table(pyarrow.table(table), tmp_path / "old.parquet")
    found = statistics(tmp_path / "old.parquet", LIMITS)
    assert (found.simulated, found.not_simulated) == (198, 2)
    assert found.endings["not simulated: a torquer has no limit"] == 2


def test_the_worst_runs_are_those_with_the_largest_ratios():
    table = table_of_runs()
    limit = np.array([LIMITS[name]["angle"] for name in table["manoeuvre"]])
    expected = np.lexsort((table["run"], -(table["angle"] / limit)))[:10]
    found = statistics(table, LIMITS)
    assert [one.run for one in found.of("angle").worst] == expected.tolist()
    assert all(one.ratio >= other.ratio for one, other in zip(found.worst, found.worst[1:], strict=False))
    worst = found.of("angle", "turn").worst[1]
    assert worst.value == table["angle"][worst.run]
    assert (worst.manoeuvre, worst.limit) == ("turn", 0.003)


def test_the_order_of_the_rows_does_not_matter():
    table = table_of_runs(3000)
    mixed = np.random.default_rng(2).permutation(3000)
    one, other = statistics(table, LIMITS), statistics({k: v[mixed] for k, v in table.items()}, LIMITS)
    for a, b in zip(one.requirements, other.requirements, strict=True):
        assert (a.requirement, a.manoeuvre, a.quantiles, a.violation.events) == (
            b.requirement,
            b.manoeuvre,
            b.quantiles,
            b.violation.events,
        )
        assert [w.run for w in a.worst] == [w.run for w in b.worst]


def test_parquet_files_say_the_same_as_columns(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    table = table_of_runs(2500)
    whole = pyarrow.table(table)
    parquet.write_table(whole.slice(0, 1000), tmp_path / "a.parquet")
    parquet.write_table(whole.slice(1000), tmp_path / "b.parquet")
    paths = [tmp_path / "a.parquet", tmp_path / "b.parquet"]
    one, other = statistics(table, LIMITS), statistics(paths, LIMITS)
    assert [(a.requirement, a.manoeuvre, a.violation.events, a.quantiles) for a in one.requirements] == [
        (a.requirement, a.manoeuvre, a.violation.events, a.quantiles) for a in other.requirements
    ]
    assert [w.run for w in one.worst] == [w.run for w in other.worst]
    assert input_names(paths) == ("manoeuvre", "rotor.11.spin", "root.inertia", "dead torquer")
    first, second = sensitivities(table, LIMITS), sensitivities(paths, LIMITS)
    assert [one.influences[0].index for one in first] == [one.influences[0].index for one in second]


def test_a_table_that_cannot_be_read_is_told_in_one_line(tmp_path):
    pytest.importorskip("pyarrow")
    broken = tmp_path / "broken.parquet"
    broken.write_bytes(b"no parquet at all")
    with pytest.raises(InputError, match="cannot be read"):
        list(batches(broken, ("run",)))
    with pytest.raises(ArgumentError, match="no column 'angel'"):
        list(batches({"run": [1]}, ("angel",)))
    with pytest.raises(ArgumentError, match="one length"):
        list(batches({"run": [1], "angle": [1.0, 2.0]}, ("run", "angle")))


def ishigami(N, seed):
    x = np.random.default_rng(seed).uniform(-np.pi, np.pi, (N, 4))
    return x, np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_the_indices_of_ishigami_s_function_are_found_from_given_runs():
    x, y = ishigami(20_000, 5)
    found = {one.parameter: one for one in influences({f"x{k + 1}": x[:, k] for k in range(4)}, y)}
    exact = {"x1": 0.3139, "x2": 0.4424, "x3": 0.0, "x4": 0.0}
    for name, index in exact.items():
        assert found[name].index == pytest.approx(index, abs=0.012), name
        assert found[name].low - 0.003 <= index <= found[name].high + 0.003, name
    assert found["x2"].driver
    assert abs(found["x2"].rank_correlation) < 0.03
    assert not found["x4"].driver


def test_the_indices_of_a_linear_function_are_its_squared_weights():
    weights = np.array([0.8, 0.5, 0.3, 0.0])
    for points in (stats.qmc.Sobol(4, seed=6).random(4096), np.random.default_rng(6).random((4096, 4))):
        z = stats.norm.ppf(np.clip(points, 1e-9, 1 - 1e-9))
        found = {one.parameter: one for one in influences({f"z{k}": z[:, k] for k in range(4)}, z @ weights)}
        for k, weight in enumerate(weights):
            assert found[f"z{k}"].index == pytest.approx(weight**2 / (weights**2).sum(), abs=0.03)
        assert [found[f"z{k}"].driver for k in range(4)] == [True, True, True, False]


def test_words_and_faults_are_inputs_like_numbers():
    rng = np.random.default_rng(7)
    manoeuvre, fault = rng.choice(["a", "b", "c"], 5000), rng.random(5000) < 0.2
    level = np.array([0.0, 1.0, 3.0])[np.unique(manoeuvre, return_inverse=True)[1]]
    y = level + 2.0 * fault + rng.normal(size=5000)
    found = {one.parameter: one for one in influences({"m": manoeuvre, "f": fault}, y)}
    shares = np.array([level.var(), 4.0 * 0.16, 1.0])
    assert found["m"].index == pytest.approx(shares[0] / shares.sum(), abs=0.03)
    assert found["f"].index == pytest.approx(shares[1] / shares.sum(), abs=0.03)
    assert np.isnan(found["m"].rank_correlation)
    assert found["f"].rank_correlation > 0.2


@pytest.mark.slow
def test_noise_is_not_called_a_driver():
    rng = np.random.default_rng(8)
    wrongly = 0
    for _ in range(200):
        x = {f"x{k}": rng.random(300) for k in range(8)} | {"m": rng.choice(["a", "b", "c"], 300)}
        # Heavy tails: a few runs carry most of the variance.
        wrongly += any(one.driver for one in influences(x, rng.standard_cauchy(300)))
    assert wrongly <= 7  # 1 % expected; 8 or more of 200 has a chance below 0.1 %


def test_an_input_that_never_changes_is_left_out():
    x = np.random.default_rng(9).random(100)
    assert [one.parameter for one in influences({"x": x, "constant": np.ones(100)}, x)] == ["x"]
    with pytest.raises(ArgumentError, match="shape"):
        influences({"x": x}, x[:50])
    with pytest.raises(ArgumentError, match="finite"):
        influences({"x": x}, np.where(x > 0.5, np.inf, x))


def test_what_drives_the_campaign_s_requirements_is_found():
    found = {(one.requirement, one.manoeuvre): one for one in sensitivities(table_of_runs(), LIMITS)}
    angle = found["angle", "turn"]
    assert angle.influences[0].parameter == "rotor.11.spin"
    assert angle.influences[0].rank_correlation < -0.7
    assert [one.parameter for one in found["torque_share", None].influences if one.driver] == ["dead torquer"]
    overall = {one.parameter: one for one in found["passed", None].influences}
    assert overall["rotor.11.spin"].driver
    assert overall["manoeuvre"].driver
    assert not overall["root.inertia"].driver
    # A run that diverged has no finite figure: ranks stand for it, and say so.
    assert found["angle", None].ranked
    assert ("attitude", "turn") not in found


def test_two_violations_are_not_explained():
    table = table_of_runs(60)
    table["passed"] = np.arange(60) > 1
    assert all(one.requirement != "passed" for one in sensitivities(table, LIMITS))


def test_nine_violations_that_share_a_rare_fault_are_explained_and_the_fault_alone_is_called_their_driver():
    rng = np.random.default_rng(10)
    fault = rng.random(1500) < 0.03
    inputs = {f"x{k}": rng.random(1500) for k in range(8)} | {"m": rng.choice(["a", "b", "c"], 1500), "fault": fault}
    violated = np.zeros(1500)
    violated[np.flatnonzero(fault)[:9]] = 1.0
    found = influences(inputs, violated)
    assert [one.parameter for one in found if one.driver] == ["fault"]


def test_chance_violations_have_no_driver():
    rng = np.random.default_rng(11)
    wrongly = 0
    for _ in range(60):
        inputs = {f"x{k}": rng.random(400) for k in range(5)} | {"fault": rng.random(400) < 0.05}
        violated = np.zeros(400)
        violated[rng.choice(400, 7, replace=False)] = 1.0
        wrongly += any(one.driver for one in influences(inputs, violated))
    assert wrongly <= 4  # 1 % expected; 5 or more of 60 has a chance below 0.1 %


def test_a_few_runs_far_out_do_not_hide_what_drives_the_others():
    table = table_of_runs(2000)
    table["angle"][7] = 0.0015
    wild = np.flatnonzero(table["dead torquer"])[:8]
    table["angle"][wild] *= 150.0
    one = next(
        one for one in sensitivities(judged(table), LIMITS) if (one.requirement, one.manoeuvre) == ("angle", None)
    )
    assert one.ranked
    drivers = [single.parameter for single in one.influences if single.driver]
    assert drivers[:2] == ["rotor.11.spin", "manoeuvre"] or drivers[:2] == ["manoeuvre", "rotor.11.spin"]


def test_what_sends_a_few_runs_beyond_the_limit_is_told_beside_what_drives_the_others():
    table = table_of_runs(2000)
    table["angle"] = 0.001 / table["rotor.11.spin"]
    table["angle"][np.flatnonzero(table["dead torquer"])[:12]] = 0.5
    one = next(
        one for one in sensitivities(judged(table), LIMITS) if (one.requirement, one.manoeuvre) == ("angle", None)
    )
    assert one.ranked
    assert [single.parameter for single in one.violations if single.driver] == ["dead torquer"]
    assert "rotor.11.spin" in [single.parameter for single in one.influences if single.driver]


def test_a_figure_that_is_the_same_in_every_run_has_no_drivers():
    table = table_of_runs(400)
    table["angle"] = np.full(400, 1e-4)
    found = sensitivities(judged(table), {name: {"angle": 0.003} for name in LIMITS})
    assert "angle" not in {one.requirement for one in found}
    [single] = influences({"x": np.random.default_rng(3).random(50)}, np.ones(50))
    assert (single.index, single.rank_correlation, single.driver) == (0.0, 0.0, False)


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


def found_of(found, parameter, level=True, manoeuvre=None, figure="passed"):
    key = (figure, manoeuvre, parameter, level)
    [one] = [one for one in found if (one.requirement, one.manoeuvre, one.parameter, one.level) == key]
    return one


def test_a_rare_fault_of_all_violations_is_seen_in_counts_where_no_variance_shows_it():
    table = rare_fault()
    limits = {"turn": {"angle": 0.003}, "push": {"angle": 0.003}, "step": {"angle": 0.003}}
    found = contrasts(table, limits)
    one = found_of(found, "fault.weak")
    assert (one.present.events, one.present.runs, one.absent.events, one.absent.runs) == (4, 10, 0, 490)
    assert one.in_every_violation
    assert one.driver
    # All four violating runs among the ten with the fault, by counting the ways; six values are compared.
    ways = math.comb(10, 4) / math.comb(500, 4)
    assert one.p_value == pytest.approx(7 * ways, rel=1e-9)
    assert found[0].requirement == "angle"
    inside = found_of(found, "fault.weak", manoeuvre="turn")
    assert (inside.present.events, inside.present.runs) == (4, 4)
    assert inside.absent.high == pytest.approx(1.0 - 0.025 ** (1.0 / inside.absent.runs), rel=1e-9)
    # Numbers that are drawn have no values to compare; a choice between two has.
    assert {one.parameter for one in found} == {"manoeuvre", "gain", "fault.weak", "fault.noise"}
    assert {one.level for one in found if one.parameter == "gain"} == {0.5, 1.0}
    assert not found_of(found, "fault.noise").driver


def test_what_is_counted_with_and_without_is_what_the_table_holds():
    table = table_of_runs() | {"choice": np.random.default_rng(5).choice([1.0, 2.0, 3.0], 4000)}
    table["ended"][9] = "not simulated: its worker died"
    whole, some = contrasts(table, LIMITS), np.array([not str(one).startswith("not") for one in table["ended"]])
    assert {one.manoeuvre for one in whole} == {None, "turn", "push"}
    for one in whole:
        answers = table["passed"] if one.requirement == "passed" else table[f"{one.requirement}_passed"]
        asked = some & np.array([answer is not None for answer in answers])
        asked &= True if one.manoeuvre is None else table["manoeuvre"] == one.manoeuvre
        violated = asked & np.array([answer is not None and not answer for answer in answers])
        here = table[one.parameter] == one.level
        for side, rows in ((one.present, here), (one.absent, ~here)):
            assert (side.events, side.runs) == ((violated & rows).sum(), (asked & rows).sum())
            exact = stats.binomtest(side.events, side.runs).proportion_ci(0.95, method="exact")
            assert (side.low, side.high) == pytest.approx((exact.low, exact.high), rel=1e-6, abs=1e-15)
        assert (
            one.p_value
            >= stats.fisher_exact(
                [
                    [one.present.events, one.present.runs - one.present.events],
                    [one.absent.events, one.absent.runs - one.absent.events],
                ]
            )[1]
        )


@pytest.mark.slow
def test_values_without_influence_are_seldom_called_causes():
    wrongly = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        table = rare_fault(300)
        table["passed"] = table["angle_passed"] = rng.random(300) > 0.05
        wrongly += any(
            one.driver for one in contrasts(table, {}) if one.manoeuvre is None and one.requirement == "passed"
        )
    assert wrongly <= 4  # at most 1 % expected; 5 or more of 100 has a chance below 0.4 %


def test_runs_that_were_not_simulated_are_on_neither_side():
    table = rare_fault(40)
    table["ended"][:] = "not simulated: its worker died"
    assert contrasts(table, {}) == ()
