"""Job files: what they say of manoeuvres over time, faults and campaigns, and that every mistake is one line."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from job.test_reading_job import PUSH, TURN, job, refused_alike
from plant.test_reading_plant import JUNK, Change, both, drop, mutate, outcome, put, refusal
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.faults import FAULT_KINDS, FaultKind, register_fault
from platform_ctrl.job.job import manoeuvre_scenario
from platform_ctrl.job.reading import read_job
from platform_ctrl.job.scenario import HalfCosine
from platform_ctrl.job.writing import job_data
from platform_ctrl.simulation.kernel.arrays import ACTIONS

ROOT = Path(__file__).parents[2]

STILL = '[[manoeuvre]] 3 "still"'
SHAKE = f"{TURN}: [[manoeuvre.vibration]] 1"
FAULT = '[[fault]] 1 "power"'
VARY = '[[campaign.vary]] 1 "rotor.11.spin"'


def flown_job() -> dict[str, Any]:
    """Return a valid job with everything that a simulated run can have."""
    data = job()
    turn, push = data["manoeuvre"]
    turn |= {
        "Omega_table": {"t": [0.0, 0.5, 2], "Omega2": [0, 0.4, 0], "smooth": True},
        "initial": {"alpha4": 1e-3, "beta10_rate": -0.5},
        "faults": ["power"],
        "vibration": [{"kind": "rate", "axis": 2, "frequencies_hz": [10, 500], "densities": [1e-6, 1e-8], "lines": 8}],
    }
    push |= {
        "torque_table": {"t": [0, 1], "M1": [0.0, 0.1], "M3": [0.1, 0]},
        "initial": {"Omega3": 0.01},
        "vibration": [{"kind": "force", "axis": 3, "frequencies_hz": [10, 500], "densities": [1.0, 0.1]}],
    }
    data["manoeuvre"].append({"name": "still", "mode": "caged", "duration": 1.0, "initial": {"alpha9": 1e-3}})
    data["fault"] = [
        {"name": "power", "kind": "rotor run-down", "part": "11", "at": 0.2, "time_constant": 3.0, "share": 0.1},
        {"name": "deaf", "kind": "pick-off dropout", "part": "alpha9", "at": 0, "until": 1.0, "probability": 0.2},
    ]
    data["campaign"] = {
        "runs": 64,
        "sampling": "latin-hypercube",
        "step": 2e-4,
        "manoeuvre": [{"name": "push", "weight": 2}, {"name": "turn"}],
        "vary": [
            {
                "parameter": "rotor.11.spin",
                "distribution": "truncated-normal",
                "deviation": 0.1,
                "low": 0.8,
                "high": 1.2,
                "relative": True,
            },
            {"parameter": "initial.alpha9", "distribution": "uniform", "low": -1e-3, "high": 1e-3},
            {"parameter": "manoeuvre.rate", "distribution": "choice", "values": [0.5, 1.0], "weights": [1, 3]},
        ],
        "fault": [{"fault": "deaf", "probability": 0.25}],
    }
    return data


def vary(**keys: object) -> Change:
    return put(dict(keys), "campaign", "vary", 0)


def as_fault(**keys: object) -> Change:
    return put({"name": "power", "at": 0.1, **keys}, "fault", 0)


MISTAKES: dict[str, tuple[Change, list[str]]] = {
    # manoeuvres
    "nothing happens": (drop("manoeuvre", 2, "initial"), [STILL, 'the key "rate" is missing', "or Omega_table"]),
    "no axis": (drop("manoeuvre", 0, "axis"), [TURN, 'the key "axis" is missing', "rate, rise, hold and axis"]),
    "table of the other mode": (
        put({"t": [0, 1], "Omega1": [0, 1]}, "manoeuvre", 1, "Omega_table"),
        [
            PUSH,
            "Omega_table = a table",
            'Omega_table = a table is for a caged manoeuvre; leave it out with mode = "stabilised"',
        ],
    ),
    "times that stand still": (
        put([0, 1, 1], "manoeuvre", 0, "Omega_table", "t"),
        [
            f"{TURN}: [manoeuvre.Omega_table]",
            "t must be two or more times that increase, s, got [0, 1, 1]",
            "two or more times that increase",
        ],
    ),
    "one time": (
        put({"t": [0], "M1": [1]}, "manoeuvre", 1, "torque_table"),
        [
            f"{PUSH}: [manoeuvre.torque_table]",
            "t must be two or more times that increase, s, got [0] (has 1 element)",
            "has 1 element",
        ],
    ),
    "a value too many": (
        put([0, 1, 2, 3], "manoeuvre", 0, "Omega_table", "Omega2"),
        ["Omega2 must have as many elements as t, 3, got 4", "Omega2 must have as many elements as t, 3, got 4"],
    ),
    "a table of times alone": (
        drop("manoeuvre", 0, "Omega_table", "Omega2"),
        [
            'the key "Omega1" is missing',
            'the key "Omega1" is missing; the table needs Omega1, Omega2 or Omega3 beside the times',
        ],
    ),
    "a torque in a table of rates": (
        put([0, 0, 0], "manoeuvre", 0, "Omega_table", "M1"),
        ["[manoeuvre.Omega_table]", 'unknown key "M1"'],
    ),
    "initial signal unknown": (
        put(1, "manoeuvre", 0, "initial", "alpha40"),
        [f"{TURN}: [manoeuvre.initial]", 'unknown key "alpha40"', 'did you mean "alpha4"?'],
    ),
    "initial angle beyond its stop": (
        put(0.02, "manoeuvre", 0, "initial", "alpha4"),
        [
            "alpha4 must be between the stops of the gimbal, -0.00872665 to 0.00872665 rad, got 0.02",
            "-0.00872665 to 0.00872665 rad",
        ],
    ),
    "initial rate of a caged platform": (
        put(0.1, "manoeuvre", 0, "initial", "Omega1"),
        [
            "Omega1 = 0.1 has no effect: the rate of a caged platform is prescribed; use Omega_table,",
            "Omega1 = 0.1 has no effect: the rate of a caged platform is prescribed; use Omega_table,",
        ],
    ),
    "initial text": (put("1", "manoeuvre", 0, "initial", "alpha4"), ['alpha4 must be a number, got "1"', "a number"]),
    "fault of no table": (
        put(["powr"], "manoeuvre", 0, "faults"),
        [TURN, '"powr" is no [[fault]] of the job', 'did you mean "power"?'],
    ),
    "fault twice": (put(["power", "power"], "manoeuvre", 0, "faults"), ['"power" is listed twice']),
    "vibration of a rate that is not prescribed": (
        put("rate", "manoeuvre", 1, "vibration", 0, "kind"),
        [
            PUSH,
            'kind must be "force" with mode = "stabilised", got "rate": only a caged platform has a p',
            'kind must be "force" with mode = "stabilised", got "rate": only a caged platform has a p',
        ],
    ),
    "vibration at no frequency": (
        put([0, 500], "manoeuvre", 0, "vibration", 0, "frequencies_hz"),
        [
            SHAKE,
            "frequencies_hz must be two or more frequencies > 0 that increase, Hz, got [0, 500]",
            "frequencies > 0 that increase",
        ],
    ),
    "vibration without density": (
        put([1e-6, 0], "manoeuvre", 0, "vibration", 0, "densities"),
        [SHAKE, "densities must be", "got [1e-06, 0]", "a density > 0"],
    ),
    "a density too few": (
        put([1e-6], "manoeuvre", 0, "vibration", 0, "densities"),
        [
            SHAKE,
            "densities must have as many elements as frequencies_hz, 2, got 1",
            "densities must have as many elements as frequencies_hz, 2, got 1",
        ],
    ),
    "no lines": (put(0, "manoeuvre", 0, "vibration", 0, "lines"), [SHAKE, "lines must be", "got 0", "from 1 to 4096"]),
    # faults
    "fault named twice": (
        both(put("power", "fault", 1, "name"), drop("campaign", "fault")),
        ['[[fault]] 2 "power"', "[[fault]] 1 already"],
    ),
    "kind unknown": (
        put("rotor stop", "fault", 0, "kind"),
        [
            FAULT,
            'kind must be "rotor run-down" or "rotor run-up" or "speed ripple" or "torquer dead" or "',
            '"rotor run-down"',
        ],
    ),
    "rotor unknown": (
        put("111", "fault", 0, "part"),
        [
            FAULT,
            'part must be the name of a rotor, got "111"; did you mean "11"?',
            "the name of a rotor",
            'did you mean "11"?',
        ],
    ),
    "no part": (drop("fault", 0, "part"), [FAULT, 'the key "part" is missing', "the name of a rotor"]),
    "no time constant": (drop("fault", 0, "time_constant"), [FAULT, 'the key "time_constant" is missing']),
    "a number of another kind": (
        put(0.5, "fault", 0, "amplitude"),
        [
            FAULT,
            'amplitude = 0.5 has no effect with kind = "rotor run-down", which takes time_constant, s',
            "time_constant, share",
        ],
    ),
    "an end of what has none": (
        put(3, "fault", 0, "until"),
        [FAULT, 'until = 3 has no effect with kind = "rotor run-down", which takes time_constant, share'],
    ),
    "an end before the beginning": (
        as_fault(kind="torquer dead", part="Q9", until=0.1),
        [FAULT, "until must be after at = 0.1, got 0.1"],
    ),
    "torquer unknown": (
        as_fault(kind="torquer dead", part="9"),
        [FAULT, 'part must be the name of a torquer, got "9"; did you mean "Q9"?', "the name of a torquer"],
    ),
    "sensor unknown": (
        as_fault(kind="pick-off dead", part="alpha99"),
        [FAULT, "a pick-off or rate sensor, by its signal", 'did you mean "alpha9"?'],
    ),
    "an overrun of a part": (
        as_fault(kind="controller overrun", part="Q9"),
        [
            FAULT,
            'part = "Q9" has no effect: kind = "controller overrun" is of all controllers; leave the ',
            "leave the key out",
        ],
    ),
    "no impulse": (
        as_fault(kind="stop contact", part="9", impulse=0),
        [FAULT, "impulse must be a number other than 0, got 0", "other than 0"],
    ),
    "fault before the start": (put(-1, "fault", 0, "at"), [FAULT, "at must be", "got -1", "a number >= 0"]),
    # campaign
    "no runs": (put(0, "campaign", "runs"), ["[campaign]", "runs must be", "got 0", "a whole number from 1"]),
    "sampling unknown": (
        put("grid", "campaign", "sampling"),
        ["[campaign]", 'sampling must be "sobol" or "latin-hypercube" or "random", got "grid"', '"sobol"'],
    ),
    "step zero": (put(0, "campaign", "step"), ["[campaign]", "step must be a number > 0, got 0", "> 0"]),
    "key unknown": (put(1, "campaign", "run"), ["[campaign]", 'unknown key "run"', 'did you mean "runs"?']),
    "manoeuvre unknown": (
        put("psuh", "campaign", "manoeuvre", 0, "name"),
        [
            '[[campaign.manoeuvre]] 1 "psuh"',
            'name must be the name of a [[manoeuvre]] of the job, got "psuh"; did you mean "push"?',
            'did you mean "push"?',
        ],
    ),
    "manoeuvre twice": (
        put("push", "campaign", "manoeuvre", 1, "name"),
        ['name: "push" is in [[campaign.manoeuvre]] 1 already; leave one of them out'],
    ),
    "no weight": (put(0, "campaign", "manoeuvre", 0, "weight"), ["weight must be a number > 0, got 0", "> 0"]),
    "campaign fault unknown": (
        put("daef", "campaign", "fault", 0, "fault"),
        [
            '[[campaign.fault]] 1 "daef"',
            'fault must be the name of a [[fault]] of the job, got "daef"; did you mean "deaf"?',
            'did you mean "deaf"?',
        ],
    ),
    "probability 2": (put(2, "campaign", "fault", 0, "probability"), ["probability must be", "got 2", "from 0 to 1"]),
    "no manoeuvres at all": (
        both(drop("manoeuvre"), drop("campaign", "manoeuvre"), drop("campaign", "vary")),
        ["[campaign] has no manoeuvre to simulate; add a [[manoeuvre]] to the job"],
    ),
    "distribution unknown": (
        put("gaussian", "campaign", "vary", 0, "distribution"),
        [VARY, 'distribution must be "uniform" or "normal" or "truncated-normal" or "log-uniform" or "lo', '"normal"'],
    ),
    "number missing": (
        drop("campaign", "vary", 0, "low"),
        [VARY, 'the key "low" is missing', "mean, deviation, low, high"],
    ),
    "mean missing where it is no factor": (
        vary(parameter="root.specific_force1", distribution="normal", deviation=1.0),
        ['the key "mean" is missing', 'distribution = "normal" needs mean, deviation'],
    ),
    "number of another distribution": (
        put(3, "campaign", "vary", 0, "median"),
        [VARY, 'median = 3 has no effect with distribution = "truncated-normal", which takes mean, devia'],
    ),
    "low above high": (put(1.3, "campaign", "vary", 0, "low"), [VARY, "high must be above low = 1.3, got 1.2"]),
    "nothing left of a normal distribution": (
        put(3.0, "campaign", "vary", 0, "mean"),
        [VARY, "mean must be at most 8 deviations outside low and high, got 3.0, 18 deviations outside", "at most 8"],
    ),
    "logarithm of nothing": (
        vary(parameter="sampling.delay", distribution="log-uniform", low=0, high=1e-3),
        ["low must be a number > 0, which has a logarithm, got 0"],
    ),
    "peak outside": (
        vary(parameter="sampling.delay", distribution="triangular", low=0, high=1e-3, peak=2e-3),
        ["peak must be from low, 0, to high, 0.001, got 0.002", "peak must be from low, 0, to high, 0.001, got 0.002"],
    ),
    "a choice of nothing": (
        both(put([], "campaign", "vary", 2, "values"), drop("campaign", "vary", 2, "weights")),
        ['[[campaign.vary]] 3 "manoeuvre.rate"', "values must be one or more numbers, got [] (has 0 elements)"],
    ),
    "a weight too few": (
        put([1], "campaign", "vary", 2, "weights"),
        [
            "weights must have as many elements as values, 2, got 1",
            "weights must have as many elements as values, 2, got 1",
        ],
    ),
    "weights of nothing": (
        put([0, 0], "campaign", "vary", 2, "weights"),
        ["weights must be numbers >= 0, not all of them 0, got [0, 0]", "not all of them 0"],
    ),
    "parameter unknown": (
        put("rotor.11.spinn", "campaign", "vary", 0, "parameter"),
        ['parameter = "rotor.11.spinn": does not exist', 'did you mean "rotor.11.spin"?'],
    ),
    "parameter of an unknown kind": (
        put("motor.11.spin", "campaign", "vary", 0, "parameter"),
        ["does not exist", 'known: "root", "gimbal", "rotor", "torquer"'],
    ),
    "parameter that no manoeuvre has": (
        put([{"name": "push"}], "campaign", "manoeuvre"),
        ['[[campaign.vary]] 3 "manoeuvre.rate"', "does not exist"],
    ),
    "parameter twice": (
        put("rotor.11.spin", "campaign", "vary", 1, "parameter"),
        ["is varied already, in [[campaign.vary]] 1"],
    ),
    "an inertia as a number": (
        vary(parameter="gimbal.4.inertia", distribution="uniform", low=0.9, high=1.1),
        ['relative must be true: "gimbal.4.inertia" is a matrix that is scaled as a whole'],
    ),
    "a factor of zero": (
        vary(parameter="root.specific_force1", distribution="uniform", low=0.9, high=1.1, relative=True),
        ['relative must be false, with the number itself: "root.specific_force1" is 0 as it stands'],
    ),
    "a factor of nothing": (
        vary(parameter="torquer.Q4.rate_limit", distribution="uniform", low=0.9, high=1.1, relative=True),
        ['relative must be false, with the number itself: "torquer.Q4.rate_limit" has no value as '],
    ),
    "a limit that may be negative": (
        vary(parameter="torquer.Q4.limit", distribution="normal", deviation=0.01, relative=True),
        ['"torquer.Q4.limit" would be drawn between -inf and inf', "allowed is a number > 0", '"truncated-normal"'],
    ),
    "a limit that may be zero": (
        vary(parameter="torquer.Q4.limit", distribution="choice", values=[0, 1]),
        ['"torquer.Q4.limit" would be drawn between 0 and 1', "allowed is a number > 0"],
    ),
    "an angle that may lie beyond a stop": (
        put(0.01, "campaign", "vary", 1, "high"),
        ['"initial.alpha9" would be drawn between -0.001 and 0.01', "allowed is an angle between the stops"],
    ),
    "a rotor that no body has": (
        vary(parameter="rotor.6.transverse_inertia", distribution="uniform", low=0.8, high=1.2, relative=True),
        ['"rotor.6.transverse_inertia" would be drawn down to 5.6e-05', "up to 0.00012"],
    ),
    "spin and L": (
        put(
            {"parameter": "rotor.11.angular_momentum", "distribution": "uniform", "low": 0.1, "high": 0.2},
            *("campaign", "vary", 1),
        ),
        ['"rotor.11.angular_momentum": "rotor.11.spin" is varied already'],
    ),
    "a fault that may end before it begins": (
        vary(parameter="fault.deaf.at", distribution="uniform", low=0, high=1.5),
        ['"fault.deaf.at" would be drawn up to 1.5 s', "ends from 1 s on"],
    ),
}


@pytest.mark.parametrize(("change", "fragments"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_is_one_line_that_names_its_place(change: Change, fragments: list[str], tmp_path: Path) -> None:
    data = flown_job()
    change(data)
    refused_alike(data, fragments, tmp_path)


def test_a_gimbal_without_stops_meets_none() -> None:
    data = flown_job() | {"plant": job_data(read_job(job()))["plant"], "campaign": {}}
    del data["plant"]["gimbal"][3]["stops"]
    data["fault"] = [{"name": "power", "kind": "stop contact", "part": "9", "at": 0.1, "impulse": 1e-4}]
    assert 'part must be a gimbal with stops, got "9"; known: "4", "5", "7", "10"' in refusal(read_job, data)
    data["fault"][0]["part"] = "10"
    assert read_job(data).fault_events[0].impulse == 1e-4


def test_a_manoeuvre_is_read_with_its_tables_and_its_beginning() -> None:
    turn, push, still = read_job(flown_job()).manoeuvres
    assert turn.Omega_table is not None
    assert push.torque_table is not None
    np.testing.assert_array_equal(turn.Omega_table.values, [[0, 0, 0], [0, 0.4, 0], [0, 0, 0]])
    np.testing.assert_array_equal(push.torque_table.values, [[0, 0, 0.1], [0.1, 0, 0]])
    assert (turn.Omega_table.smooth, push.torque_table.smooth) == (True, False)
    assert turn.initial == {"alpha4": 1e-3, "beta10_rate": -0.5}
    assert turn.faults == ("power",)
    (shake,) = turn.vibrations
    assert (shake.kind, shake.axis, shake.lines, push.vibrations[0].lines) == ("rate", 2, 8, 64)
    assert (still.rate, still.axis, still.Omega_table, still.vibrations) == (0.0, 1, None, ())


def test_a_manoeuvre_is_flown_as_the_job_says() -> None:
    read = read_job(flown_job())
    turn, push, still = (manoeuvre_scenario(read, manoeuvre) for manoeuvre in read.manoeuvres)
    assert (turn.mode, turn.duration, turn.delay, turn.seed, turn.run) == ("caged", 2.0, 0.0005, 7, 0)
    assert isinstance(turn.profile, HalfCosine)
    assert (turn.profile.axis, turn.profile.rate, turn.profile.rise, turn.profile.hold) == (1, -1.0, 0.5, 1.0)
    assert [fault.name for fault in turn.faults] == ["power"]
    np.testing.assert_array_equal(turn.q, [1e-3, 0, 0, 0, 0])
    np.testing.assert_array_equal(turn.rate, [0, 0, 0, 0, -0.5])
    np.testing.assert_array_equal(push.torque, [0, 0, 0.1])
    np.testing.assert_array_equal(push.Omega, [0, 0, 0.01])
    assert push.profile is None
    assert still.profile is None
    assert not still.torque.any()
    assert not turn.torque.any()
    assert (turn.limits, still.limits) == ({"angle": 0.003}, {})


def test_a_campaign_is_read() -> None:
    campaign = read_job(flown_job()).campaign
    assert campaign is not None
    assert (campaign.runs, campaign.seed, campaign.sampling, campaign.step) == (64, 7, "latin-hypercube", 2e-4)
    assert [(one.name, one.weight) for one in campaign.manoeuvres] == [("push", 2.0), ("turn", 1.0)]
    spin, alpha9, rate = campaign.vary
    assert spin.numbers == {"mean": 1.0, "deviation": 0.1, "low": 0.8, "high": 1.2}
    assert (spin.relative, alpha9.relative, alpha9.support) == (True, False, (-1e-3, 1e-3))
    assert (rate.values, rate.weights, rate.support) == ((0.5, 1.0), (1.0, 3.0), (0.5, 1.0))
    assert [(one.fault, one.probability) for one in campaign.faults] == [("deaf", 0.25)]


def test_a_job_without_a_campaign_has_none() -> None:
    read = read_job(job())
    assert read.campaign is None
    assert read.fault_events == ()
    assert [(manoeuvre.name, weight) for manoeuvre, weight in read.campaign_manoeuvres] == [
        ("turn", 1.0),
        ("push", 1.0),
    ]


def test_an_empty_campaign_flies_all_manoeuvres_alike() -> None:
    read = read_job(flown_job() | {"campaign": {}})
    assert read.campaign is not None
    assert (read.campaign.runs, read.campaign.sampling, read.campaign.seed) == (1000, "sobol", 7)
    assert [(manoeuvre.name, weight) for manoeuvre, weight in read.campaign_manoeuvres] == [
        ("turn", 1.0),
        ("push", 1.0),
        ("still", 1.0),
    ]


@pytest.mark.parametrize("kind", FAULT_KINDS.values(), ids=FAULT_KINDS)
def test_every_kind_of_fault_is_an_action_of_the_kernel_and_a_row_of_the_documentation(kind: FaultKind) -> None:
    part = {"pick-off": "sensor", "gimbal": "gimbal with stops", None: "none"}.get(kind.part, kind.part)
    cells = (f'"{kind.name}"', part, ", ".join(kind.needed), ", ".join(kind.optional), kind.effect)
    row = "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"
    assert row in (ROOT / "docs" / "job-file.md").read_text(encoding="utf-8").splitlines()
    assert kind.action in ACTIONS


def test_a_kind_of_fault_is_registered_once_and_has_numbers_of_faults() -> None:
    with pytest.raises(ArgumentError, match="fault kind 'torquer dead' exists already"):
        register_fault(FAULT_KINDS["torquer dead"])
    with pytest.raises(ArgumentError, match=r"fault kind 'tired': number must be .* got 'mood'"):
        register_fault(FaultKind(name="tired", effect="", part=None, needed=("mood",), action="no torque"))


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_every_kind_of_fault_is_read_with_what_it_needs(kind: Any) -> None:
    keys = FAULT_KINDS[kind]
    part = {None: {}, "rotor": {"part": "8"}, "torquer": {"part": "M1"}, "pick-off": {"part": "alpha4"}}.get(
        keys.part, {"part": "4"}
    )
    numbers = {key: 0.5 for key in (*keys.needed, *keys.optional)}
    (fault,) = read_job(
        flown_job()
        | {"manoeuvre": [], "campaign": {}, "fault": []}
        | {"manoeuvre": job()["manoeuvre"], "fault": [{"name": "it", "kind": kind, "at": 0.25, **part, **numbers}]}
    ).fault_events
    assert (fault.kind, fault.at, fault.part) == (kind, 0.25, part.get("part"))
    assert {key: getattr(fault, key) for key in numbers} == numbers
    (bare,) = read_job(
        flown_job()
        | {"campaign": {}, "manoeuvre": job()["manoeuvre"]}
        | {"fault": [{"name": "it", "kind": kind, "at": 0.25, **part, **dict.fromkeys(keys.needed, 0.5)}]}
    ).fault_events
    assert (bare.until, bare.probability) == (math.inf, 0.5 if "probability" in keys.needed else 1.0)


def test_a_job_with_everything_is_written_and_read_back_whole() -> None:
    read = read_job(flown_job())
    assert job_data(read_job(job_data(read))) == job_data(read)


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(junk=st.lists(JUNK, min_size=1, max_size=4), chance=st.randoms(use_true_random=False))
def test_whatever_is_changed_a_job_is_read_or_refused_in_one_line(junk: list[Any], chance: random.Random) -> None:
    data = flown_job()
    for item in junk:
        mutate(data, chance, item)
    read = outcome(read_job, data)
    if isinstance(read, str):
        assert read.isprintable()
    else:
        assert all(
            name in [fault.name for fault in read.fault_events] for one in read.manoeuvres for name in one.faults
        )
