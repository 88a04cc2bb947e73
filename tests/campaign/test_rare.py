"""Rare events: importance splitting finds tails that are known, says how sure it is, and tells when it is not."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

import platform_ctrl as pc
from platform_ctrl.campaign.planning import plan
from platform_ctrl.campaign.rare_events import nearest_mixture, rare_event
from platform_ctrl.campaign.rare_runs import limit_ratios, rare_probability
from platform_ctrl.campaign.single_run import simulate_runs
from platform_ctrl.cli import main
from platform_ctrl.errors import ArgumentError, SimulationError

TURN = {"mode": "caged", "rate": 0.1, "rise": 0.01, "hold": 0.0, "duration": 0.02}
JOB = {
    "schema": 2,
    "name": "short turns",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [1.0, 1.0, 1.0], "seed": 1976},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "9-10",
            "kind": "caging",
            "gimbals": ["9", "10"],
            "use": "classical",
            "design": [{"name": "classical", "method": "classical", "crossover_hz": 30}],
        }
    ],
    "manoeuvre": [
        {"name": "about 3", "axis": 3, **TURN, "limits": {"angle": 0.0014}},
        {"name": "about 1", "axis": 1, **TURN, "limits": {"torque_share": 1.0}},
    ],
    "campaign": {
        "runs": 24,
        "seed": 3,
        "vary": [{"parameter": "manoeuvre.rate", "distribution": "normal", "deviation": 0.1, "relative": True}],
    },
}
METHODS = ("splitting", "cross-entropy")


def plane(beta, d):
    """A linear limit state at distance beta: the probability is Phi(-beta), whatever d."""
    return lambda u, run: stats.norm.ppf(u).sum(axis=1) / np.sqrt(d) / beta


def noise_of(run):
    """One standard normal number that depends on the run's number alone."""
    return np.array([np.random.default_rng(int(number)).standard_normal() for number in run])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("beta", "d"), [(4.5, 2), (4.5, 20), (6.0, 5)])
def test_the_tail_of_a_plane_is_found(beta, d, method):
    exact = stats.norm.sf(beta)
    found = rare_event(plane(beta, d), d, samples=1000, repetitions=8, method=method, seed=1)
    assert found.low <= exact <= found.high
    assert found.high < 3.0 * found.low
    assert found.probability == pytest.approx(exact, rel=0.5)
    # Counting would take 1/(variation² p) runs to be as sure: millions.
    assert found.evaluations < 0.01 / (found.variation**2 * exact)


@pytest.mark.parametrize("method", METHODS)
def test_both_of_two_branches_are_found(method):
    found = rare_event(lambda u, run: np.abs(stats.norm.ppf(u[:, 0])) / 4.5, 3, samples=1000, method=method, seed=2)
    exact = 2.0 * stats.norm.sf(4.5)
    assert found.low <= exact <= found.high
    assert found.probability == pytest.approx(exact, rel=0.4)


def test_inputs_that_act_together_are_found():
    # A sum of dependent normal numbers: variance by the correlation matrix.
    correlation = 0.6 * np.ones((4, 4)) + 0.4 * np.eye(4)
    root = np.linalg.cholesky(correlation)
    weight = np.array([1.0, 2.0, 3.0, 4.0])
    limit = 4.75 * np.sqrt(weight @ correlation @ weight)
    found = rare_event(lambda u, run: stats.norm.ppf(u) @ root.T @ weight / limit, 4, samples=1000, seed=3)
    assert found.low <= stats.norm.sf(4.75) <= found.high
    # Which inputs have to move, and how far: along the gradient, by beta.
    gradient = root.T @ weight
    along = found.shift @ gradient / np.linalg.norm(gradient)
    assert along == pytest.approx(4.75 + 1.0 / 4.75, abs=0.15)
    np.testing.assert_allclose(found.shift, along * gradient / np.linalg.norm(gradient), atol=0.4)


def test_figures_that_are_not_normal_are_no_different():
    # The smallest of three uniform numbers below c: 1 - (1 - c)^3.
    c = 1e-6
    found = rare_event(lambda u, run: c / np.maximum(u.min(axis=1), 1e-300), 3, samples=1000, seed=4)
    assert found.low <= 1.0 - (1.0 - c) ** 3 <= found.high


def test_noise_is_one_more_input():
    def figure(u, run):
        return (np.sqrt(0.6) * stats.norm.ppf(u[:, 0]) + np.sqrt(0.4) * noise_of(run)) / 4.0

    for method in METHODS:
        found = rare_event(figure, 1, samples=600, repetitions=4, method=method, seed=5)
        assert found.low <= stats.norm.sf(4.0) <= found.high
        # What is told can be simulated again: the point, and the number of its noise.
        for point in found.violations:
            again = figure(point.u[None, :], np.array([point.run]))[0]
            assert again == pytest.approx(point.ratio, rel=1e-6)
            assert again > 1.0


def test_where_noise_decides_the_interval_is_wide_and_it_is_told():
    def figure(share):
        def out(u, run):
            return (np.sqrt(1.0 - share) * stats.norm.ppf(u[:, 0]) + np.sqrt(share) * noise_of(run)) / 4.0

        return out

    little, much = (rare_event(figure(share), 1, samples=300, repetitions=6, seed=3) for share in (0.02, 0.9))
    assert not little.noise_decides
    assert much.noise_decides
    assert much.high / max(much.low, 1e-300) > 20.0 * little.high / little.low
    for found in (little, much):
        assert found.low <= stats.norm.sf(4.0) <= found.high


def test_noise_alone_can_be_rare():
    found = rare_event(lambda u, run: noise_of(run) / 2.5, 0, samples=600, repetitions=4, seed=6)
    assert found.low <= stats.norm.sf(2.5) <= found.high


def test_the_interval_covers_the_truth_as_often_as_it_says():
    exact = stats.norm.sf(4.0)
    results = [rare_event(plane(4.0, 6), 6, samples=200, repetitions=4, seed=seed) for seed in range(60)]
    covered = sum(one.low <= exact <= one.high for one in results)
    assert covered >= 52  # 57 expected of 60; fewer than 52 has a chance below 1 %
    scatter = np.std([one.probability for one in results]) / exact
    assert np.median([one.variation for one in results]) == pytest.approx(scatter, rel=0.4)


def test_frequent_events_are_counted_with_exact_bounds():
    found = rare_event(plane(1.0, 2), 2, samples=500, repetitions=4, seed=7)
    assert found.evaluations == 2000
    events = round(found.probability * 2000)
    exact = stats.binomtest(events, 2000).proportion_ci(0.95, method="exact")
    assert (found.low, found.high) == pytest.approx((exact.low, exact.high))


def test_the_same_seed_gives_the_same_result_and_another_another():
    one, same, other = (rare_event(plane(3.5, 2), 2, samples=200, repetitions=3, seed=seed) for seed in (8, 8, 9))
    assert one.probability == same.probability != other.probability
    np.testing.assert_array_equal(one.violations[0].u, same.violations[0].u)


def test_a_limit_that_cannot_be_reached_has_probability_zero_with_an_upper_bound():
    for bounded in (lambda u, run: 0.9 * u[:, 0], lambda u, run: np.full(len(u), 0.5)):
        found = rare_event(bounded, 1, samples=200, repetitions=3, seed=10)
        assert (found.probability, found.low, found.reached) == (0.0, 0.0, 0)
        assert 0.0 < found.high < 0.05
        assert found.violations == ()


def test_plateaus_and_runs_that_diverge_do_not_stop_it():
    # Figures of four steps only, the highest of which diverges.
    def figure(u, run):
        x = stats.norm.ppf(u[:, 0])
        return np.select([x > 4.2, x > 3.0, x > 1.5], [np.inf, 0.8, 0.6], 0.2)

    found = rare_event(figure, 1, samples=1000, repetitions=8, seed=11)
    assert found.low <= stats.norm.sf(4.2) <= found.high
    assert np.isinf(found.violations[0].ratio)


def test_many_runs_are_asked_for_at_once_and_fresh_noise_has_its_own_number():
    sizes, seen = [], set()

    def figure(u, run):
        sizes.append(len(u))
        seen.update(run.tolist())
        assert u.shape == (len(run), 3)
        assert ((u > 0.0) & (u < 1.0)).all()
        return stats.norm.ppf(u).sum(axis=1) / np.sqrt(3) / 4.5

    rare_event(figure, 3, samples=800, repetitions=2, seed=12, first_run=5000)
    assert min(sizes) >= 80
    assert min(seen) == 5000
    # About half of the moves have fresh noise.
    assert 0.4 * sum(sizes) < len(seen) < 0.8 * sum(sizes)


def test_runs_that_could_not_be_simulated_are_an_error_not_a_zero():
    with pytest.raises(SimulationError, match="could not be simulated"):
        rare_event(lambda u, run: np.where(u[:, 0] > 0.9, np.nan, 0.1), 1, samples=200)
    with pytest.raises(ArgumentError, match="at least"):
        rare_event(plane(3.0, 1), 1, samples=10)
    with pytest.raises(ArgumentError, match="must be 'splitting' or 'cross-entropy'"):
        rare_event(plane(3.0, 1), 1, method="guess")
    with pytest.raises(ArgumentError, match="one for each point"):
        rare_event(lambda u, run: np.zeros(3), 1)


def test_the_mixture_finds_two_clouds_and_its_weights_add_up_to_one():
    rng = np.random.default_rng(13)
    z = np.concatenate([rng.normal((4.0, 0.0), 0.3, (500, 2)), rng.normal((-3.0, 1.0), 0.3, (500, 2))])
    mixture = nearest_mixture(z)
    found = mixture.means[np.argsort(mixture.means[:, 0])]
    np.testing.assert_allclose(found, [(-3.0, 1.0), (4.0, 0.0)], atol=0.1)
    drawn = mixture.draw(200_000, rng)
    assert mixture.weights(drawn).mean() == pytest.approx(1.0, abs=0.02)
    assert mixture.weights(drawn).max() <= 10.0 + 1e-9


@pytest.fixture(scope="module")
def planned():
    job = pc.read_job(JOB)
    return plan(job, [outcome.closed.controller for outcome in pc.design.loops(job)])


def test_the_runs_of_a_rare_event_are_those_of_the_campaign(planned):
    columns = simulate_runs(planned, range(24))
    turned = columns["manoeuvre"] == "about 3"
    expected = np.where(turned, columns["angle"] / 0.0014, columns["torque_share"])
    scenarios = planned.scenarios(0, 24)
    np.testing.assert_allclose(limit_ratios(planned, scenarios), expected, rtol=1e-9)
    # Where the angle is not asked it is not violated.
    alone = limit_ratios(planned, scenarios, "angle")
    np.testing.assert_allclose(alone, np.where(turned, expected, 0.0), rtol=1e-9)


def test_a_rare_event_of_a_campaign_tells_which_inputs_to_fly_again(planned):
    found = rare_probability(planned, "angle", samples=60, repetitions=2)
    assert found.requirement == "angle"
    assert found.evaluations >= 120
    for point in found.violations[:3]:
        assert point.run >= planned.runs
        inputs = planned.inputs_at(point.u[None, :])
        assert inputs["manoeuvre"][0] == "about 3"
        again = limit_ratios(planned, planned.scenarios_with(inputs, [point.run]), "angle")[0]
        assert again == pytest.approx(point.ratio, rel=1e-9)
    with pytest.raises(ArgumentError, match="must be one of 'angle', 'torque_share'"):
        rare_probability(planned, "attitude")


def test_the_command_writes_statistics_page_and_rare_event(planned, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    from platform_ctrl.plant.writing import toml

    (tmp_path / "job.toml").write_text(toml(JOB), encoding="utf-8")
    K = planned.controllers[0]
    controller = {"name": "9-10", "method": "given", "dt": float(K.dt), "delay": 0.0005, "claims": {}}
    controller |= {name: np.asarray(getattr(K, name)).tolist() for name in "ABCD"}
    controller |= {"inputs": list(K.input_labels), "outputs": list(K.output_labels)}
    (tmp_path / "mine.json").write_text(json.dumps({"schema": 1, "controllers": [controller]}), encoding="utf-8")
    command = ["campaign", "job.toml", "--controllers", "mine.json", "--workers", "1", "-q"]
    assert main([*command, "--rare", "attitude"]) == 2
    assert "choose one of any, angle, torque_share" in capsys.readouterr().err
    code = main([*command, "--rare", "any", "--runs-per-level", "50"])
    record = json.loads((tmp_path / "campaign" / "campaign.json").read_text(encoding="utf-8"))
    found = record["statistics"]
    assert code == (0 if found["passed"] else 1)
    assert found["violation"]["runs"] == found["runs"] == 24
    assert record["rare"][0]["requirement"] == "any"
    page = (tmp_path / "campaign" / "campaign.html").read_text(encoding="utf-8")
    assert "platform-ctrl simulate job.toml --controllers mine.json --run" in page
    assert "platform-ctrl campaign job.toml --rare any --controllers mine.json" in page
    printed = capsys.readouterr().out
    assert "rare event: any requirement" in printed
    assert "page:   campaign/campaign.html" in printed
