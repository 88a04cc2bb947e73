"""Plans of campaigns: what is drawn, that a run is the same whoever asks, and that a path changes what it says."""

from __future__ import annotations

import dataclasses
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from design import test_uncertain_modes as uncertain_modes
from platform_ctrl import read_job
from platform_ctrl.campaign import plan
from platform_ctrl.campaign.planning import chosen, quantiles, unit_points
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.parameters import parameters, varied_scenario
from platform_ctrl.job.variation import Campaign, CampaignFault, CampaignManoeuvre, Vary
from platform_ctrl.simulation import Scenario

MODEL = Path(__file__).parents[2] / "models" / "three_gyro_platform.toml"
POINTS = pytest.mark.parametrize("sampling", ["sobol", "latin-hypercube", "random"])


def plant() -> dict[str, Any]:
    """Return the three-gyro platform with one of every force element and a rate sensor."""
    data = tomllib.loads(MODEL.read_text(encoding="utf-8"))
    data["root"]["specific_force"] = [0.0, 0.0, 9.81]
    data["gimbal"][0]["restitution"] = 0.3
    data["torquer"][0]["rate_limit"] = 100.0
    data["rate_sensor"] = [{"root_axis": 2, "noise_rms": 1e-5}]
    data["spring"] = [{"gimbal": "4", "stiffness": 0.1, "rest": 1e-3}, {"gimbal": "4", "stiffness": 0.2}]
    data["friction"] = [
        {
            "gimbal": "5",
            "viscous": 1e-4,
            "coulomb": [1e-3, 2e-3],
            "coulomb_rate": 0.01,
            "breakaway": [2e-3, 3e-3],
            "stribeck_rate": 0.05,
        },
        {"gimbal": "9", "coulomb": 1e-3},
    ]
    data["cage"] = [{"gimbal": "7", "stiffness": 50.0, "damping": 0.01, "clearance": 1e-3, "angle": 1e-4}]
    data["erection"] = [{"gimbal": "9", "senses": "10", "axis": [1, 0, 0], "gain": 0.01, "limit": 0.002}]
    data["unbalance"] = [{"body": "10", "moment": [1e-6, 2e-6, 0.0]}]
    return data


@cache
def job() -> Any:
    """Return a job with everything that can be varied."""
    loop = {
        "name": "9-10",
        "kind": "caging",
        "gimbals": ["9", "10"],
        "use": "hand",
        "design": [{"name": "hand", "method": "classical"}],
    }
    spectrum = {"axis": 2, "frequencies_hz": [10, 100, 500], "densities": [1e-6, 1e-5, 1e-7]}
    turn = {
        "name": "turn",
        "mode": "caged",
        "axis": 1,
        "rate": 1.0,
        "rise": 0.5,
        "hold": 0.5,
        "duration": 2.0,
        "Omega_table": {"t": [0, 1, 2], "Omega2": [0.0, 0.3, 0.0]},
        "initial": {"alpha4": 1e-3, "beta5_rate": 0.2},
        "faults": ["power", "bump"],
        "vibration": [{"kind": "rate", **spectrum}],
        "limits": {"angle": 0.003},
    }
    push = {
        "name": "push",
        "mode": "stabilised",
        "axis": 3,
        "torque": 0.1,
        "duration": 1.0,
        "torque_table": {"t": [0, 1], "M2": [0.0, 0.1]},
        "initial": {"Omega3": 0.01},
        "vibration": [{"kind": "force", **spectrum}],
    }
    faults = [
        {"name": "power", "kind": "rotor run-down", "part": "11", "at": 0.2, "time_constant": 3.0, "share": 0.1},
        {"name": "bump", "kind": "stop contact", "part": "9", "at": 0.5, "impulse": 1e-4},
        {"name": "deaf", "kind": "pick-off dropout", "part": "alpha9", "at": 0.0, "until": 1.0, "probability": 0.2},
        {"name": "drift", "kind": "pick-off drift", "part": "Omega2", "at": 0.0, "rate": 1e-3},
        {"name": "hum", "kind": "speed ripple", "part": "6", "at": 0.1, "amplitude": 0.01, "frequency_hz": 50.0},
    ]
    return read_job(
        {
            "schema": 2,
            "name": "everything",
            "plant": plant(),
            "operation": {"Omega": [1.0, 1.0, 1.0], "seed": 7},
            "sampling": {"rate_hz": 2000, "delay": 5e-4},
            "loop": [loop],
            "manoeuvre": [turn, push],
            "fault": faults,
        }
    )


def planned(*vary: Vary, **keys: Any) -> Any:
    campaign = Campaign(vary=vary, **{"runs": 256, "seed": 3, **keys})
    return plan(dataclasses.replace(job(), campaign=campaign), [])


def uniform(parameter: str, low: float = 0.9, high: float = 1.1, relative: bool = True) -> Vary:
    return Vary(parameter=parameter, distribution="uniform", numbers={"low": low, "high": high}, relative=relative)


DISTRIBUTIONS = {
    "uniform": (Vary(parameter="x", distribution="uniform", numbers={"low": -1.0, "high": 3.0}), stats.uniform(-1, 4)),
    "normal": (Vary(parameter="x", distribution="normal", numbers={"mean": 2.0, "deviation": 0.5}), stats.norm(2, 0.5)),
    "truncated-normal": (
        Vary(
            parameter="x",
            distribution="truncated-normal",
            numbers={"mean": 1.0, "deviation": 0.5, "low": 0.5, "high": 3.0},
        ),
        stats.truncnorm(-1.0, 4.0, 1.0, 0.5),
    ),
    "log-uniform": (
        Vary(parameter="x", distribution="log-uniform", numbers={"low": 1e-3, "high": 10.0}),
        stats.loguniform(1e-3, 10.0),
    ),
    "log-normal": (
        Vary(parameter="x", distribution="log-normal", numbers={"median": 3.0, "deviation": 0.2}),
        stats.lognorm(0.2, scale=3.0),
    ),
    "triangular": (
        Vary(parameter="x", distribution="triangular", numbers={"low": 1.0, "peak": 1.5, "high": 3.0}),
        stats.triang(0.25, 1.0, 2.0),
    ),
}


@POINTS
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_what_is_drawn_has_the_distribution_that_was_asked(name: str, sampling: Any) -> None:
    vary, asked = DISTRIBUTIONS[name]
    drawn = quantiles(vary, unit_points(sampling, 1, 4096, 3, 0, 4096)[:, 1])
    assert stats.kstest(drawn, asked.cdf).pvalue > 0.01
    low, high = vary.support
    assert low <= drawn.min()
    assert drawn.max() <= high


def test_a_choice_comes_as_often_as_its_weights_say() -> None:
    vary = Vary(parameter="x", distribution="choice", values=(5.0, 7.0, 9.0), weights=(1.0, 0.0, 3.0))
    drawn = quantiles(vary, unit_points("sobol", 1, 1024, 1, 0, 1024)[:, 0])
    assert [int((drawn == x).sum()) for x in (5.0, 7.0, 9.0)] == [256, 0, 768]
    np.testing.assert_array_equal(chosen((1.0, 0.0), np.array([0.5**54, 1.0 - 0.5**53])), [0, 0])
    assert vary.support == (5.0, 9.0)


@pytest.mark.parametrize("runs", [256, 100, 7])
def test_a_latin_hypercube_has_one_run_in_every_slice_of_every_number(runs: int) -> None:
    points = unit_points("latin-hypercube", 5, runs, 4, 0, runs)
    for column in points.T:
        np.testing.assert_array_equal(np.sort(np.floor(runs * column)), np.arange(runs))


def test_sobol_points_have_one_run_in_every_elementary_interval() -> None:
    points = unit_points("sobol", 5, 1 << 20, 2, 0, 256)
    for bits in range(9):
        cells = np.floor(points * (2**bits, 2 ** (8 - bits)))
        assert len(np.unique(cells, axis=0)) == 256
    # The next 256 points fill the intervals again.
    again = unit_points("sobol", 5, 1 << 20, 2, 256, 512)
    assert len(np.unique(np.floor(again * 16), axis=0)) == 256
    assert points.min() > 0.0


@pytest.mark.parametrize("dimensions", [1, 4, 5, 9])
def test_random_points_are_independent_of_one_another(dimensions: int) -> None:
    points = unit_points("random", 5, 1 << 20, dimensions, 1000, 5096)
    assert len(np.unique(points)) == points.size
    assert stats.kstest(points.ravel(), "uniform").pvalue > 0.01
    neighbours = np.corrcoef(points[1:].T, points[:-1].T)
    assert np.abs(neighbours - np.eye(2 * dimensions)).max() < 0.06


def flat(item: Any, path: str = "") -> dict[str, Any]:
    """Return every number, text and truth in a value by where it stands."""
    if dataclasses.is_dataclass(item):
        own = [flat(getattr(item, field.name), f"{path}.{field.name}") for field in dataclasses.fields(item)]
    elif isinstance(item, dict):
        own = [flat(entry, f"{path}.{key}") for key, entry in item.items()]
    elif isinstance(item, tuple):
        own = [flat(entry, f"{path}[{k}]") for k, entry in enumerate(item)]
    elif isinstance(item, np.ndarray):
        own = [flat(entry, f"{path}[{k}]") for k, entry in enumerate(item.tolist())]
    elif isinstance(item, list):
        own = [flat(entry, f"{path}[{k}]") for k, entry in enumerate(item)]
    else:
        return {path: item}
    return {key: entry for part in own for key, entry in part.items()}


def changed(before: Scenario, after: Scenario) -> dict[str, Any]:
    """Return what is new or different, by where it stands."""
    old, new = flat(before), flat(after)
    assert set(old) <= set(new)
    return {key: entry for key, entry in new.items() if key not in old or entry != old[key]}


def varied(path: str, number: float, relative: bool, manoeuvre: int = 0) -> tuple[Scenario, Scenario]:
    """Return a manoeuvre with all faults as it stands, and with one number drawn."""
    nominal = planned().nominal
    faults = job().fault_events
    base = dataclasses.replace(nominal[manoeuvre], faults=faults)
    return base, varied_scenario(
        base, [(parameters(nominal, faults)[path], number, relative)], faults=base.faults, seed=7, run=0
    )


P = ".platform"
EXPECTED: dict[str, tuple[int, list[str]]] = {
    # path: (manoeuvre, what a factor of 1.25 multiplies)
    "rotor.11.spin": (0, [f"{P}.rotors[2].angular_momentum"]),
    "rotor.6.axial_inertia": (0, [f"{P}.rotors[0].axial_inertia", f"{P}.rotors[0].angular_momentum"]),
    "gimbal.5.inertia": (0, [f"{P}.gimbals[1].inertia[{k}][{k}]" for k in range(3)]),
    "root.inertia": (0, [f"{P}.root_inertia[{i}][{j}]" for i in range(3) for j in range(3)]),
    "root.specific_force3": (0, [f"{P}.specific_force[2]"]),
    "torquer.Q9.limit": (0, [f"{P}.torquers[3].limit"]),
    "torquer.Q4.rate_limit": (0, [f"{P}.torquers[0].rate_limit"]),
    "pickoff.alpha4.noise_rms": (0, [f"{P}.pickoffs[0].noise_rms"]),
    "rate_sensor.Omega2.noise_rms": (0, [f"{P}.rate_sensors[0].noise_rms"]),
    "spring.4#2.stiffness": (0, [f"{P}.springs[1].stiffness"]),
    "friction.5.breakaway": (0, [f"{P}.frictions[0].breakaway[{k}]" for k in (0, 1)]),
    # Without a Stribeck curve the breakaway torque is the dry friction itself.
    "friction.9.coulomb": (0, [f"{P}.frictions[1].{key}[{k}]" for key in ("coulomb", "breakaway") for k in (0, 1)]),
    "cage.7.clearance": (0, [f"{P}.cages[0].clearance"]),
    "erection.9.gain": (0, [f"{P}.erections[0].gain"]),
    "unbalance.10.moment2": (0, [f"{P}.unbalances[0].moment[1]"]),
    "sampling.delay": (0, [".delay"]),
    "initial.beta5_rate": (0, [".rate[1]"]),
    "initial.Omega3": (1, [".Omega[2]"]),
    "manoeuvre.rate": (0, [".profile.rate"]),
    "manoeuvre.Omega_scale": (0, [".Omega_table.scale"]),
    "manoeuvre.torque_scale": (1, [".torque_table.scale"]),
    "fault.power.time_constant": (0, [".faults[0].time_constant"]),
    "fault.deaf.probability": (0, [".faults[2].probability"]),
}


@pytest.mark.parametrize("path", EXPECTED)
def test_a_factor_multiplies_what_its_path_says_and_nothing_else(path: str) -> None:
    manoeuvre, places = EXPECTED[path]
    before, after = varied(path, 1.25, True, manoeuvre)
    old, new = flat(before), changed(before, after)
    assert set(new) == set(places)
    for place in places:
        assert new[place] == pytest.approx(1.25 * old[place], rel=1e-15)


@pytest.mark.parametrize(
    ("path", "number", "places"),
    [
        ("rotor.11.spin", 1000.0, {f"{P}.rotors[2].angular_momentum": 0.12}),
        ("torquer.Q5.rate_limit", 50.0, {f"{P}.torquers[1].rate_limit": 50.0}),
        ("friction.5.coulomb", 5e-4, {f"{P}.frictions[0].coulomb[{k}]": 5e-4 for k in (0, 1)}),
        ("initial.beta10", -2e-3, {".q[4]": -2e-3}),
        ("sampling.delay", 7e-4, {".delay": 7e-4}),
        ("pickoff.alpha4.quantisation", 1e-6, {f"{P}.pickoffs[0].quantisation": 1e-6}),
        ("pickoff.alpha4.bias", 1e-3, {f"{P}.pickoffs[0].bias": 1e-3}),
        ("rate_sensor.Omega2.scale_error", 1e-3, {f"{P}.rate_sensors[0].scale_error": 1e-3}),
    ],
)
def test_a_number_takes_the_place_of_what_its_path_says_and_of_nothing_else(
    path: str, number: float, places: dict[str, float]
) -> None:
    new = changed(*varied(path, number, False))
    assert set(new) == set(places)
    assert all(new[place] == pytest.approx(expected, rel=1e-15) for place, expected in places.items())


def test_a_vibrations_scale_multiplies_its_amplitudes() -> None:
    before, after = varied("vibration.scale", 3.0, False)
    np.testing.assert_allclose(after.vibrations[0].amplitudes[1], 3.0 * before.vibrations[0].amplitudes[1], rtol=1e-14)


def test_the_gain_of_a_torquer_is_a_torquer_that_is_weak() -> None:
    _, after = varied("torquer.Q9.gain", 0.8, False)
    assert (after.faults[0].kind, after.faults[0].part, after.faults[0].share) == ("torquer weak", "Q9", 0.8)


def test_a_body_without_unbalance_gets_one() -> None:
    _, after = varied("unbalance.platform.moment2", 1e-4, False)
    assert [one.body for one in after.platform.unbalances] == ["10", "platform"]
    np.testing.assert_array_equal(after.platform.unbalances[1].moment, [0.0, 1e-4, 0.0])


MIXED = (
    uniform("rotor.11.spin"),
    uniform("gimbal.9.inertia"),
    uniform("initial.alpha9", -1e-3, 1e-3, relative=False),
    uniform("fault.deaf.at", 0.0, 0.5, relative=False),
)


def mixed(**keys: Any) -> Any:
    return planned(
        *MIXED,
        manoeuvres=(CampaignManoeuvre(name="push"), CampaignManoeuvre(name="turn", weight=3.0)),
        faults=(CampaignFault(fault="deaf", probability=0.25), CampaignFault(fault="power", probability=0.5)),
        **keys,
    )


def test_a_run_is_simulated_with_its_inputs() -> None:
    campaign = mixed()
    inputs = campaign.inputs(0, 64)
    for run, scenario in enumerate(campaign.scenarios(0, 64)):
        push = inputs["manoeuvre"][run] == "push"
        assert scenario.mode == ("stabilised" if push else "caged")
        assert scenario.platform.rotors[2].angular_momentum == pytest.approx(0.15 * inputs["rotor.11.spin"][run])
        np.testing.assert_allclose(
            scenario.platform.gimbals[3].inertia, job().platform.gimbals[3].inertia * inputs["gimbal.9.inertia"][run]
        )
        assert scenario.q[3] == inputs["initial.alpha9"][run]
        faults = {fault.name: fault for fault in scenario.faults}
        assert ("deaf" in faults) == inputs["fault.deaf"][run]
        # A fault that the manoeuvre names happens whether or not it is drawn, and once.
        assert ("power" in faults) == (not push or inputs["fault.power"][run])
        assert len(faults) == len(scenario.faults)
        if "deaf" in faults:
            assert faults["deaf"].at == inputs["fault.deaf.at"][run]
        assert scenario.limits == ({} if push else {"angle": 0.003})


@POINTS
@settings(max_examples=6, deadline=None)
@given(ends=st.tuples(st.integers(0, 64), st.integers(0, 64)))
def test_a_run_is_the_same_whatever_the_range(sampling: Any, ends: tuple[int, int]) -> None:
    first, last = sorted(ends)
    whole, part = mixed(runs=64, sampling=sampling), mixed(runs=64, sampling=sampling)
    everything = _all_runs(sampling)
    for name, column in part.inputs(first, last).items():
        np.testing.assert_array_equal(column, whole.inputs(0, 64)[name][first:last])
    for run, scenario in zip(range(first, last), part.scenarios(first, last), strict=True):
        assert flat(scenario) == everything[run]
    if last < 64:
        assert flat(part.scenario(last)) == everything[last]


@cache
def _all_runs(sampling: Any) -> list[dict[str, Any]]:
    return [flat(scenario) for scenario in mixed(runs=64, sampling=sampling).scenarios(0, 64)]


def test_noise_is_keyed_by_the_campaigns_seed_and_the_runs_number() -> None:
    runs = mixed(seed=3).scenarios(0, 16)
    assert [scenario.run for scenario in runs] == list(range(16))
    assert len({scenario.seed for scenario in runs}) == 1
    seeds = {mixed(seed=seed).noise_seed for seed in range(100)}
    assert len(seeds) == 100
    assert all(0 <= seed < 2**63 for seed in seeds)
    # Inputs and noise do not come from one stream.
    assert runs[0].seed != 3


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda: plan(job(), [], runs=0), "runs must be a whole number from 1 to 1073741824, got 0"),
        (lambda: plan(job(), [], sampling="grid"), "or 'random', got 'grid'"),  # type: ignore[arg-type]
        (lambda: plan(dataclasses.replace(job(), manoeuvres=()), []), "has no [[manoeuvre]]"),
        (lambda: mixed().scenario(256), "run must be a whole number from 0 to 255, got 256"),
        (lambda: mixed().inputs(5, 300), "end of the runs must be a whole number from 5 to 256, got 300"),
        (lambda: planned(uniform("rotor.12.spin")), 'parameter = "rotor.12.spin": does not exist'),
        (
            lambda: planned(manoeuvres=(CampaignManoeuvre(name="x"),)),
            "manoeuvre of the campaign must be one of 'turn', 'push', got 'x'",
        ),
        (
            lambda: planned(uniform("torquer.Q4.limit", -0.1, 0.1, relative=False)),
            '"torquer.Q4.limit" would be drawn between -0.1 and 0.1; allowed is a number > 0',
        ),
        (lambda: planned(uniform("friction.5.coulomb", 0.5, 3.0)), "breakaway must be at least coulomb"),
        (lambda: planned(uniform("rotor.6.axial_inertia", 0.5, 1.3)), "must be at least half of axial_inertia"),
    ],
)
def test_what_makes_no_plan_is_refused_in_one_line(ask: Any, words: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        ask()
    assert words in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(("key", "size"), [("frequency", uncertain_modes.OMEGA), ("damping", uncertain_modes.ZETA)])
def test_a_campaign_varies_a_mode(key: str, size: float) -> None:
    once = {"name": "turn", "mode": "caged", "duration": 0.1, "initial": {"q_rate": 0.1}}
    one = uncertain_modes.job({"mode_frequency": 0.1}, manoeuvre=[once])
    scenario = one.scenario(one.manoeuvres[0])
    known = parameters([scenario], ())
    varied = varied_scenario(scenario, [(known[f"mode.arm.{key}"], 1.1, True)], faults=(), seed=0, run=0)
    assert getattr(varied.platform.modes[0], key) == pytest.approx(1.1 * size)
    varied = varied_scenario(scenario, [(known["mode.arm.participation"], 1.1, True)], faults=(), seed=0, run=0)
    assert dict(varied.platform.modes[0].participation) == pytest.approx({"Q": 1.65, "gyro": -1.32})
