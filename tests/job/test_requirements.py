"""Requirements: ratios, every kind against an independent figure, limits and goals, closed loops that exist already."""

import dataclasses
from typing import get_args

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from platform_ctrl import design, read_job
from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.measuring import Peak
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import Group
from platform_ctrl.design.loop import given_design
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.requirements import (
    FAULTS,
    NOMINAL,
    WORST_CASE,
    Requirement,
    limit_keys,
    loop_goals,
    loop_requirements,
    requirement,
)
from platform_ctrl.job.variation import Faults

KINDS = tuple(METRICS)
# The plants here have no line of sight.
MEASURED = tuple(kind for kind in KINDS if kind != "attenuation" and not METRICS[kind].of_sight)
ALL = get_args(Group)
PERIOD = 5e-4
L, LIMIT = 0.15, 0.25


def asked(kind, limit=1.0, **more):
    """Return a requirement with what its kind needs."""
    if METRICS[kind].needs_frequency:
        more.setdefault("frequency", 100.0)
    return requirement(kind, limit, **more)


@pytest.fixture(scope="module")
def job():
    job = read_job("examples/three_gyro_platform.toml")
    uncertainty = dataclasses.replace(job.uncertainty, inertia=0.05, spin=0.05)
    return dataclasses.replace(
        job, uncertainty=uncertainty, faults=Faults(slow_rotor=0.9, weak_torquer=0.9), loops=job.loops[1:2]
    )


@pytest.fixture(scope="module")
def plants(job):
    return plants_of(job, job.loops[0])


@pytest.fixture(scope="module")
def controller(job):
    """The classical loop at half its bandwidth."""
    (spec,) = job.loops
    plain = dataclasses.replace(spec.designs[0], tune=False, options={"crossover_hz": 40.0, "rolloff_hz": 850.0})
    spec = dataclasses.replace(spec, designs=(plain,), use=plain.name)
    (outcome,) = design.loops(dataclasses.replace(job, loops=(spec,)))
    return outcome.closed.controller


# Ratios


@given(
    kind=st.sampled_from(KINDS),
    limit=st.floats(1e-300, 1e300),
    measured=st.floats(),
)
def test_a_ratio_of_at_most_one_means_met_for_every_kind(kind, limit, measured):
    one = asked(kind, limit)
    result = one.judge(measured, subject="loop", stage="decoupled", evidence="")
    assert result.passed is (one.ratio(measured) <= 1.0)
    if not np.isfinite(measured):
        assert not result.passed
        assert result.margin == -np.inf
    elif abs(measured / limit - 1.0) > 1e-12:
        assert result.passed is (measured < limit if one.sense == "at most" else measured > limit)
        assert result.passed is (result.margin > 0.0)


@pytest.mark.parametrize(
    ("sense", "measured", "limit", "margin"),
    [
        ("at least", 0.1496, 0.5, -0.7008),
        ("at least", 30.46, 25.0, 0.2184),
        ("at least", -0.5, 0.5, -2.0),
        ("at most", 0.75, 0.5, -0.5),
        ("at most", 0.4, 0.5, 0.2),
        ("at most", 0.5, 0.5, 0.0),
        ("at most", 0.0, 0.0, 0.0),
        ("at most", 1e-9, 0.0, -np.inf),
        ("at least", 1e-9, 0.0, np.inf),
        ("at most", 7.0, np.inf, np.inf),
        ("at least", 7.0, np.inf, -np.inf),
    ],
)
def test_the_margin_is_the_distance_to_the_limit_relative_to_the_limit(sense, measured, limit, margin):
    one = Requirement(name="damping", limit=limit, unit="", sense=sense)
    result = one.judge(measured, subject="loop", stage="decoupled", evidence="")
    assert result.margin == pytest.approx(margin, rel=1e-12)
    assert result.passed is (margin >= 0.0)


def test_every_kind_is_measured_over_every_group_and_as_a_norm(plants, controller):
    K = plants.joined(controller)
    every = [asked(kind, over=over) for kind in MEASURED for over in (NOMINAL, FAULTS)]
    rough, exact = (measure(plants, K, every, exact=exact) for exact in (False, True))
    for one in every:
        grid, norm = one.values(rough), one.values(exact)
        assert np.all(np.isfinite([grid, norm])), one.kind
        assert one.ratios(exact).shape == norm.shape
        if isinstance(one.metric.measure, Peak) and one.kind != "disk margin":
            # A grid sees no more than there is.
            assert np.all(grid <= norm * (1.0 + 1e-9)), one.kind
        np.testing.assert_allclose(grid.max(), norm.max(), rtol=0.1, err_msg=one.kind)


def test_what_was_not_measured_is_not_judged(plants, controller):
    measures = measure(plants, plants.joined(controller))
    with pytest.raises(ArgumentError, match="sensitivity peak: was not measured"):
        requirement("sensitivity peak", 2.0).values(measures)


# Kinds that tests/verification/test_exact_verdicts.py leaves out


def test_the_torque_that_a_slow_platform_rate_asks_for_is_L_Omega(plants, controller):
    """A caged gyro is a rate gyro: Q = L Omega, here 0.15 N m of 0.25 N m."""
    slow = requirement("torque limit", 1.0, frequency=1.0).check(plants, controller)
    assert slow.value == pytest.approx(L * 1.0 / LIMIT, rel=1e-3)


def test_torquers_without_a_limit_are_never_at_it(plants, controller):
    free = dataclasses.replace(plants, torque_limit=np.array([np.inf, np.inf]))
    assert requirement("torque limit", 1.0).check(free, controller).value == 0.0
    one = dataclasses.replace(plants, torque_limit=np.array([np.inf, LIMIT]))
    both = requirement("torque limit", 1.0).check(plants, controller).value
    assert 0.5 * both < requirement("torque limit", 1.0).check(one, controller).value <= both


def test_an_unstable_loop_meets_no_requirement_but_those_of_the_controller(plants, controller):
    wrong = control.StateSpace(
        controller.A,
        controller.B,
        -controller.C,
        -controller.D,
        PERIOD,
        inputs=controller.input_labels,
        outputs=controller.output_labels,
        remove_useless_states=False,
    )
    lenient = {"at least": 1e-6, "at most": 1e12}
    for kind in MEASURED:
        one = asked(kind, lenient[asked(kind).sense])
        if kind not in ("fastest pole", "fastest controller pole", "controller gain"):
            assert not one.check(plants, wrong).passed, kind
        assert one.check(plants, controller).passed, kind


def test_poles_count_in_the_w_plane(plants):
    """z = 0 (a delay) counts 2/T, a pole next to z = -1 far more; integrators nothing."""
    limit = 2.0 / PERIOD
    for z, factor in ((0.0, 1.0), (-0.5, 3.0), (0.5, 1.0 / 3.0), (1.0, 0.0)):
        K = control.ss(
            z * np.eye(2), np.eye(2), np.eye(2), 0 * np.eye(2), PERIOD, inputs=plants.angles, outputs=plants.torques
        )
        one = requirement("fastest controller pole", limit)
        assert one.check(plants, K).ratio == pytest.approx(factor)


# Over a set


def test_the_worst_plant_is_named_and_a_larger_set_is_never_easier(plants, controller):
    for kind in ("disk margin", "damping", "sensitivity peak", "bandwidth", "torque noise", "fastest pole"):
        ratios = [
            requirement(kind, 1.0, over=over).check(plants, controller).ratio for over in (NOMINAL, WORST_CASE, ALL)
        ]
        assert ratios[0] <= ratios[1] * (1.0 + 1e-9)
        assert ratios[1] <= ratios[2] * (1.0 + 1e-9)
    found = requirement("disk margin", 0.1, over=("faults",)).check(plants, controller)
    label = found.evidence.split(";")[0]
    assert plants.groups[plants.labels.index(label)] == "faults"
    alone = plants.only([plants.labels.index(label)])
    alone = dataclasses.replace(alone, groups=("nominal",))
    assert requirement("disk margin", 0.1).check(alone, controller).value == pytest.approx(found.value, rel=1e-9)


# Limits and goals of a job


def test_every_limit_of_a_job_becomes_one_requirement():
    edges = {"tracking_hz": 10.0, "torque_limit_hz": 20.0, "attenuation_hz": 5.0}
    edges |= {f"{key.removesuffix('_hz')}_from_hz": 1.0 for key in edges}
    names = [key for key in limit_keys() if key not in edges]
    always = {one.name for one in loop_requirements({})}
    assert always == {"minimum decay rate", "minimum decay rate, worst case"}
    for name in names:
        limits = {name: 0.7} | edges
        new = [one for one in loop_requirements(limits) if one.name not in always | {"minimum decay rate with a fault"}]
        assert [one.limit for one in new] == [0.7], name
        scope = limit_keys()[name][1]
        assert new[0].over == {"worst_case": WORST_CASE, "faults": FAULTS}.get(scope, NOMINAL)
    everything = dict.fromkeys(names, 1.0) | edges
    whole = [*loop_requirements(everything), *loop_goals(everything)]
    assert len({one.name for one in whole}) == len(names) + 3 + len(names)


def test_plants_with_a_fault_have_to_be_stable_only_where_something_is_asked_of_them():
    assert not any("faults" in one.over for one in loop_requirements({"disk_margin_worst_case": 0.3}))
    found = loop_requirements({"damping_faults": 0.01})
    assert [one.name for one in found if "faults" in one.over] == [
        "minimum decay rate with a fault",
        "damping with a fault",
    ]


def test_goals_are_soft_and_no_verdict_rests_on_them(job, plants, controller):
    (spec,) = job.loops
    spec = dataclasses.replace(spec, limits={"damping": 0.01}, soft={"bandwidth_hz": 500.0, "damping": 0.01})
    assert all(one.hard for one in spec.requirements)
    assert not any(one.hard for one in spec.goals)
    made = given_design(spec, "by hand", controller, plants)
    assert made.passed
    assert {one.name: one.passed for one in made.goals} == {"goal: bandwidth": False, "goal: damping": True}
    assert not any(one.hard for one in made.goals)
    assert all(one.hard for one in made.results)


def test_a_stopped_rotor_that_nothing_is_asked_of_fails_no_loop(job, controller):
    """Without the gyro's stiffness the cross-axis loop is unstable: seen where it is asked for, and nowhere else."""
    stopped = plants_of(dataclasses.replace(job, faults=Faults(slow_rotor=0.0)), job.loops[0])
    (spec,) = job.loops
    lenient = {"damping": 0.01}
    assert given_design(dataclasses.replace(spec, limits=lenient), "K", controller, stopped).passed
    strict = dataclasses.replace(spec, limits=lenient | {"disk_margin_faults": 1e-3})
    missed = {one.name for one in given_design(strict, "K", controller, stopped).results if not one.passed}
    assert missed == {"minimum decay rate with a fault", "disk margin with a fault"}
