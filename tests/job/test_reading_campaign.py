"""Job files: what they say of manoeuvres over time, faults and campaigns, and that every mistake is one line."""

from __future__ import annotations

import random
import tomllib
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from job.test_reading_job import job
from plant.test_reading_plant import JUNK, mutate, outcome, refusal
from platform_ctrl import read_job, read_platform
from platform_ctrl.simulation import HalfCosine


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


def test_a_gimbal_without_stops_meets_none() -> None:
    data = flown_job() | {"plant": tomllib.loads(read_platform("three_gyro_platform").to_toml()), "campaign": {}}
    del data["plant"]["gimbal"][3]["stops"]
    data["fault"] = [{"name": "power", "kind": "stop contact", "part": "9", "at": 0.1, "impulse": 1e-4}]
    assert 'part must be a gimbal with stops, got "9"; known: "4", "5", "7", "10"' in refusal(read_job, data)
    data["fault"][0]["part"] = "10"
    assert read_job(data).fault_events[0].impulse == 1e-4


def test_a_manoeuvre_is_flown_as_the_job_says() -> None:
    read = read_job(flown_job())
    turn, push, still = (read.scenario(manoeuvre) for manoeuvre in read.manoeuvres)
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


def test_an_empty_campaign_flies_all_manoeuvres_alike() -> None:
    read = read_job(flown_job() | {"campaign": {}})
    assert read.campaign is not None
    assert (read.campaign.runs, read.campaign.sampling, read.campaign.seed) == (1000, "sobol", 7)
    assert [(manoeuvre.name, weight) for manoeuvre, weight in read.campaign_manoeuvres] == [
        ("turn", 1.0),
        ("push", 1.0),
        ("still", 1.0),
    ]


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
