"""Structured caging loops: gradients against differences, pieces against measures, and what the search reaches."""

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest

from platform_ctrl import design
from platform_ctrl.analysis import loop as closed
from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.system import System
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.fixed_structure.descent import finer, pieces
from platform_ctrl.design.fixed_structure.loops import LoopGradients
from platform_ctrl.design.fixed_structure.maps import (
    CONTROLLER,
    S_OUTPUT,
    at_least,
    map_of,
    torque_per_Omega,
)
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.methods.classical import classical_controller, starting_values
from platform_ctrl.design.methods.structured import (
    balanced_truncation,
    classical_structure,
    free_structure,
    of_order,
    pid_structure,
    without_integrators,
)
from platform_ctrl.design.partition import channels
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import DesignError
from platform_ctrl.job.requirements import WORST_CASE, requirement
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import platform_source

EXAMPLE = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
LOOPS = ("caging 4-5-7", "caging 9-10")


@pytest.fixture(scope="module")
def job():
    return read_job(EXAMPLE)


@pytest.fixture(scope="module")
def cases(job):
    """Plants, directions and a hand-made controller of both loops."""
    model = linearise(job.platform)
    out = {}
    for spec in job.loops[:2]:
        plants = plants_of(job, spec)
        channel = channels(model, rows_of(model, spec.gimbals))
        options = starting_values({}, channel, plants.nutation, plants.period)
        out[spec.name] = plants, channel, classical_controller(options, channel, plants.period)
    return out


REQUIREMENTS = [
    requirement("bandwidth", 30.0),
    requirement("disk margin", 0.5),
    requirement("disk margin", 0.3, over=WORST_CASE),
    requirement("sensitivity peak", 2.0, over=WORST_CASE),
    requirement("complementary sensitivity peak", 2.0),
    requirement("damping", 0.1, over=WORST_CASE),
    requirement("stability", 0.05, over=WORST_CASE),
    requirement("fastest pole", 1e4),
    requirement("tracking", 0.2, frequency=60.0),
    requirement("Omega rejection", 0.004),
    requirement("torque rejection", 0.05),
    requirement("torque noise", 0.005),
    requirement("torque limit", 1.0),
    requirement("controller gain", 200.0),
]


def whole(block):
    A, B, C, D, _ = block
    return np.block([[A, B], [C, D]])


def parts(M, n):
    return System(M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:], 5e-4)


MAPS = {
    "S at the output": map_of(closed.S_OUTPUT),
    "S at the input": map_of(closed.S_INPUT),
    "(S - T)/2 at the output": map_of(closed.HALF_OUTPUT),
    "(S - T)/2 at the input": map_of(closed.HALF_INPUT),
    "T at the output": map_of(closed.T_OUTPUT),
    "T at the input": map_of(closed.T_INPUT),
    "angle per torque": map_of(closed.ANGLE_PER_TORQUE),
    "angle per Omega": map_of(closed.ANGLE_PER_OMEGA),
    "torque per noise": map_of(closed.Transfer("noise", "torque")),
    "torque per rate": map_of(closed.Transfer("Omega", "torque")),
    "controller": CONTROLLER,
    "torque per Omega": None,
}


def slopes(of, K, anyhow=False, seed=1, share=1e-6):
    """Changes along a random direction: by the gradients of `of(controller)`, and by differences."""
    n, M = len(K[0]), whole(K)
    step = np.random.default_rng(seed).standard_normal(M.shape) * np.abs(M) * share
    here, there, back = (of(parts(M + sign * step, n)) for sign in (0, 1, -1))
    # Poles come in any order, torquers in theirs.
    order, high, low = (
        np.lexsort((found.ratio, found.plant)) if anyhow else np.arange(len(found.ratio))
        for found in (here, there, back)
    )
    differences = 0.5 * (there.ratio[high] - back.ratio[low])
    return np.sum(here.gradient * step, axis=(1, 2))[order], differences


def worst(found):
    """The largest piece alone: its mixtures with the next are no values that differences could follow."""
    k = [int(np.argmax(found.ratio))]
    return dataclasses.replace(found, ratio=found.ratio[k], gradient=found.gradient[k], plant=found.plant[k])


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("which", MAPS)
def test_singular_values_have_the_slopes_of_differences(cases, name, which):
    plants, _, K = cases[name]
    plants = plants.only(range(3))
    of = MAPS[which] or torque_per_Omega(1, plants)
    for frequency in (90.0, 420.0, 3000.0):
        for k in range(3):
            ours, theirs = slopes(
                lambda block, w=frequency, k=k: worst(LoopGradients(plants, block).edge(of, w, np.array([k]))), K
            )
            np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6 * np.abs(theirs).max())


@pytest.mark.parametrize("name", LOOPS)
def test_poles_and_noise_have_the_slopes_of_differences(cases, name):
    plants, _, K = cases[name]
    plants = plants.only(range(3))
    everywhere = np.arange(3)
    for of, anyhow in (
        (lambda block: LoopGradients(plants, block).damping(0.0, 0.1, everywhere), True),
        (lambda block: LoopGradients(plants, block).fastest(0.0, 1e4, everywhere), True),
        (lambda block: LoopGradients(plants, block).noise(0.005, everywhere), False),
    ):
        ours, theirs = slopes(of, K, anyhow)
        assert len(ours) >= 3
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5 * np.abs(theirs).max())


def test_the_level_of_the_bandwidth_moves_with_the_wanted_frequency(cases):
    plants, _, K = cases["caging 9-10"]
    loops = LoopGradients(plants, K)
    _, slope = loops.level(200.0, np.inf)
    above, below = (loops.level(200.0 * np.exp(sign * 1e-4), np.inf)[0] for sign in (1, -1))
    # S is rising there: the edge is all there is, one piece at the output and one at the input before their mixtures.
    assert slope[0] == pytest.approx((above.ratio[0] - below.ratio[0]) / 2e-4, rel=1e-4)
    assert np.all(slope >= 0.0)


@pytest.mark.parametrize("name", LOOPS)
def test_pieces_are_the_ratios_that_are_certified(cases, name):
    plants, _, K = cases[name]
    plants = plants.only(range(4))
    loops = LoopGradients(finer(plants), K)
    measures = measure(plants, K, REQUIREMENTS)
    for required in REQUIREMENTS:
        found = pieces(loops, required, 0.5)
        if required.kind == "bandwidth":
            # Not the ratio: S at most 1/sqrt(2) up to the wanted frequency. It is 1 at the bandwidth.
            at_bandwidth = dataclasses.replace(required, limit=measures.bandwidth / (2 * np.pi))
            assert pieces(loops, at_bandwidth, 0.5).ratio.max() == pytest.approx(1.0, abs=1e-6)
        elif required.kind == "stability":
            assert np.all(found.ratio < 1.0)
        elif required.kind == "damping":
            ratio = at_least(measures.damping, required.limit)[0].max()
            assert found.ratio.max() == pytest.approx(ratio, rel=1e-8)
        else:
            assert found.ratio.max() == pytest.approx(required.ratios(measures).max(), rel=2e-4), required.kind


def test_where_two_singular_values_meet_their_mixtures_span_what_the_largest_can_do(cases):
    """Along any direction the largest singular value rises at least as fast as each of its pieces, and as the best."""
    plants, _, K = cases["caging 9-10"]
    n, M = len(K[0]), whole(K)
    # Beyond the loop's reach S is nearly the unit matrix.
    at, nominal = 0.8 * np.pi / plants.period, np.zeros(1, dtype=np.intp)
    found = LoopGradients(plants, K).edge(S_OUTPUT, at, nominal)
    assert len(found.ratio) == 12
    assert found.ratio.max() == found.ratio[0]
    rng = np.random.default_rng(4)
    for _ in range(10):
        step = rng.standard_normal(M.shape) * np.abs(M) * 0.05
        expected = found.ratio + np.sum(found.gradient * step, axis=(1, 2))
        reached = LoopGradients(plants, parts(M + step, n)).edge(S_OUTPUT, at, nominal).ratio[0]
        change = np.abs(reached - found.ratio[0])
        assert reached == pytest.approx(expected.max(), abs=0.35 * change + 1e-3)


@pytest.mark.parametrize("name", LOOPS)
def test_families_are_differentiated_and_start_where_they_should(cases, name):
    plants, channel, K = cases[name]
    T, nutation = plants.period, plants.nutation
    pid = pid_structure(K, channel, T, nutation, 12.0, 0.4 * 2 * np.pi / T)
    inner = of_order(without_integrators(K, channel, 12.0, T), 5, nutation * T)
    free = free_structure(inner, channel, T, nutation, 12.0)
    classical = classical_structure(starting_values({}, channel, nutation, T), channel, T)
    rng = np.random.default_rng(2)
    for family in (pid, free, classical):
        x = family.start
        step = 1e-6 * rng.standard_normal(len(x))
        change = 0.5 * (whole(family.block(x + step)) - whole(family.block(x - step)))
        expected = family.jacobian(x) @ step
        np.testing.assert_allclose(change, expected, atol=1e-7 * np.abs(expected).max())


def test_a_controller_is_taken_from_its_integrators_and_put_behind_them_again(cases):
    plants, channel, K = cases["caging 9-10"]
    rate = 2 * np.pi * 0.024 * plants.nutation / (2 * np.pi)
    inner = without_integrators(K, channel, rate, plants.period)
    assert np.abs(np.linalg.eigvals(inner[0])).max() < 1.0
    again = free_structure(inner, channel, plants.period, plants.nutation, rate)
    theirs, ours = (LoopGradients(plants.only([0]), block).K for block in (K, again.block(again.start)))
    np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-7 * np.abs(theirs).max())


def test_truncation_keeps_what_matters():
    rng = np.random.default_rng(3)
    A = np.diag([0.9, 0.5, -0.3, 0.2])
    B, C, D = rng.standard_normal((4, 2)), rng.standard_normal((2, 4)), np.zeros((2, 2))
    C[:, 3] *= 1e-9
    less = balanced_truncation(System(A, B, C, D, 0.1), 3)
    assert len(less.A) == 3
    for z in np.exp(1j * np.array([0.1, 1.0, 3.0])):
        full, small = (c @ np.linalg.solve(z * np.eye(len(a)) - a, b) + d for a, b, c, d in ((A, B, C, D), less[:4]))
        np.testing.assert_allclose(small, full, atol=1e-7)


@pytest.fixture(scope="module")
def alone(job):
    """The loop 9-10 with a structure, for limits and goals."""

    def designed(structure, limits=None, soft=None, **options):
        spec = job.loops[1]
        required = next(d for d in spec.designs if d.method == "structured")
        required = dataclasses.replace(required, structure=structure, options=required.options | options)
        spec = dataclasses.replace(
            spec,
            designs=(required,),
            use=required.name,
            limits=spec.limits if limits is None else limits,
            soft=spec.soft if soft is None else soft,
        )
        said = []
        (outcome,) = design.loops(dataclasses.replace(job, loops=(spec,), manoeuvres=()), said.append)
        return outcome.closed, said

    return designed


def hertz(found):
    return found.measures.bandwidth / (2 * np.pi)


@pytest.mark.slow
def test_five_numbers_do_as_well_as_any_search_and_sixteen_far_better(alone):
    few, _ = alone("cross-axis")
    many, said = alone("pid")
    assert few.passed
    assert many.passed
    assert (few.claims["parameters"], many.claims["parameters"]) == (5, 16)
    assert hertz(few) > 48.4
    assert hertz(many) > 60.0
    assert set(few.options) >= {"crossover_hz", "damping_hz", "lead_hz", "rolloff_hz"}
    assert any("limits at 99%, goals at" in line for line in said)


def test_the_same_job_gives_the_same_controller(alone):
    first, second = (alone("pid", evaluations=60)[0].controller for _ in range(2))
    for ours, theirs in zip(
        (first.A, first.B, first.C, first.D), (second.A, second.B, second.C, second.D), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_every_entry_of_a_controller_can_be_moved(alone):
    """Behind the PID, with a goal out of its reach."""
    limits = {"disk_margin": 0.5, "damping": 0.1, "torque_noise": 0.005}
    free, _ = alone("state-space", limits, {"bandwidth_hz": 90.0}, order=4, evaluations=150)
    assert free.passed
    assert free.claims["order"] >= 6
    # Integral action is kept, and S still falls below the bandwidth.
    assert free.measures.decay[0] >= 0.5 * 2 * np.pi * 2.0


def test_without_goals_the_limits_are_met_with_the_reserve(alone):
    limits = {"bandwidth_hz": 45.0, "disk_margin": 0.5, "disk_margin_worst_case": 0.3, "torque_noise": 0.005}
    found, said = alone("pid", limits, {}, reserve=0.05)
    assert found.passed
    assert "goal_ratio" not in found.claims
    assert found.claims["limit_ratio"] <= 0.961
    assert max(r.ratio for r in found.results) < 0.97
    assert not any("goals" in line for line in said)


def test_a_bandwidth_is_not_bought_with_a_flat_sensitivity(alone):
    limits = {"disk_margin": 0.5, "damping": 0.1, "torque_noise": 0.005}
    found, _ = alone("pid", limits, {"bandwidth_hz": 60.0}, evaluations=150)
    tenth = requirement("tracking", 0.16, frequency=0.1 * found.measures.bandwidth)
    assert tenth.check(found.plants, found.controller).passed


def test_what_can_not_be_met_is_said_and_not_hidden(alone):
    impossible = {"bandwidth_hz": 400.0, "disk_margin": 0.9, "torque_noise": 1e-5}
    found, _ = alone("pid", impossible, {}, evaluations=60)
    assert not found.passed
    assert found.claims["limit_ratio"] > 1.0


def small_job(plant, gimbals, structure, **limits):
    loop = {"name": "small", "kind": "caging", "gimbals": gimbals, "use": "one", "limits": limits}
    loop["design"] = [{"name": "one", "method": "structured", "structure": structure, "evaluations": 80}]
    return read_job(
        {
            "schema": 2,
            "name": "small",
            "plant": plant,
            "operation": {"Omega": [0.1, 0.1, 0.1]},
            "sampling": {"rate_hz": 2000, "delay": 0.0003},
            "loop": [loop],
        }
    )


@pytest.mark.parametrize("structure", ["cross-axis", "pid", "state-space"])
def test_gimbals_without_a_gyro_are_caged_too(structure):
    plant = tomllib.loads(platform_source("three_gyro_platform"))
    plant["rotor"][2]["angular_momentum"] = 0.0
    job = small_job(plant, ["9", "10"], structure, bandwidth_hz=15.0, disk_margin=0.5, damping=0.1)
    (outcome,) = design.loops(job)
    assert outcome.closed.passed


@pytest.mark.parametrize("structure", ["cross-axis", "pid", "state-space"])
def test_a_single_gimbal_is_caged_too(structure):
    plant = {
        "schema": 1,
        "name": "one axis",
        "root": {"name": "base", "inertia": [1, 1, 1]},
        "gimbal": [{"name": "frame", "parent": "base", "axis": [1, 0, 0], "inertia": [1e-3, 1e-3, 1e-3]}],
        "torquer": [{"gimbal": "frame", "limit": 1.0}],
        "pickoff": [{"gimbal": "frame"}],
    }
    (outcome,) = design.loops(small_job(plant, ["frame"], structure, bandwidth_hz=20.0, disk_margin=0.6, damping=0.2))
    assert outcome.closed.passed
    assert outcome.closed.controller.ninputs == 1


@pytest.mark.slow
@pytest.mark.parametrize("change", [{"uncertainty": 0.3}, {"rate_hz": 1000}])
def test_a_start_that_is_not_stable_is_brought_there_first(change):
    """The classical rules of thumb fail with some plants of a wide spread, and with all of them at a low rate."""
    data = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    data["uncertainty"] = dict.fromkeys(("inertia", "spin"), change.get("uncertainty", 0.1))
    rate = change.get("rate_hz", 2000)
    data["sampling"] = {"rate_hz": rate, "delay": 1 / rate}
    loop = next(loop for loop in data["loop"] if loop["name"] == "caging 9-10")
    loop |= {
        "use": "one",
        "limits": {
            "disk_margin": 0.5,
            "disk_margin_worst_case": 0.3,
            "damping_worst_case": 0.05,
            "torque_noise": 0.005,
        },
        "soft": {"bandwidth_hz": 25},
        "design": [{"name": "one", "method": "structured", "integral_hz": 2}],
    }
    small = {key: data[key] for key in ("schema", "name", "plant", "operation", "uncertainty", "sampling")}
    said = []
    (outcome,) = design.loops(read_job(small | {"loop": [loop]}), said.append)
    assert said[1] == "caging 9-10: one, not stable with all plants yet"
    assert outcome.closed.passed
    assert hertz(outcome.closed) > 20.0


def gyro_job(limits, soft=None, faults=None, rate_hz=5000, **design_options):
    loop = {"name": "gyro", "kind": "caging", "gimbals": ["outer", "inner"], "use": "one", "limits": limits}
    loop |= {"soft": soft or {}, "design": [{"name": "one", "method": "structured", **design_options}]}
    job = {
        "schema": 2,
        "name": "gyro",
        "plant": "gimballed_gyro",
        "operation": {"Omega": [0.1, 0.1, 0.1]},
        "sampling": {"rate_hz": rate_hz, "delay": 1 / rate_hz},
        "loop": [loop],
    }
    return read_job(job | ({"faults": faults} if faults else {}))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"structure": "pid", "order": 3}, "option 'order' has no meaning"),
        ({"structure": "cross-axis", "starts": 2}, "option 'starts' has no meaning"),
        ({"structure": "state-space", "order": 1.5}, "order must be a whole number, got 1.5"),
        ({"reserve": 1.0}, "reserve must be less than 1, got 1"),
        ({"integral_hz": 2500}, "integral_hz must be below half the sample rate, got 2500"),
    ],
)
def test_options_without_sense_are_refused(options, said):
    with pytest.raises(DesignError, match=said):
        design.loops(gyro_job({"disk_margin": 0.5}, **options))


def test_plants_of_which_nothing_is_asked_do_not_hold_the_loop_back():
    """A stopped rotor counts where a limit speaks of faults; elsewhere it need not even be stable."""
    limits, faults = {"bandwidth_hz": 60, "disk_margin": 0.5}, {"slow_rotor": 0.0}
    without, among = (design.loops(gyro_job(limits, faults=f))[0].closed for f in (None, faults))
    assert without.passed
    assert among.passed
    np.testing.assert_array_equal(without.controller.A, among.controller.A)


def test_a_resonance_between_two_points_of_the_grid_is_seen(cases):
    """Nearly no gain: the nutation rings on, in a peak far narrower than the grid."""
    plants, _, K = cases["caging 9-10"]
    plants = plants.only([0])
    weak = System(K.A, K.B, 2e-7 * K.C, 2e-7 * K.D, K.dt)
    margin = requirement("disk margin", 0.5)
    measured = measure(plants, weak, [margin]).disk_margin[0]
    assert measured < 0.01
    seen = pieces(LoopGradients(finer(plants), weak), margin, 0.5)
    assert seen.ratio.max() == pytest.approx(0.5 / measured, rel=0.01)


def test_the_claimed_ratios_are_those_of_the_report():
    limits = {"bandwidth_hz": 300, "disk_margin": 0.6, "damping": 0.3}
    found = design.loops(gyro_job(limits, {"torque_noise": 1e-4}, rate_hz=2000, evaluations=100))[0].closed
    assert not found.passed
    assert found.claims["limit_ratio"] == max(result.ratio for result in found.results)
    assert found.claims["goal_ratio"] == max(goal.ratio for goal in found.goals)
    # What can not be met is not bought with a loop that hardly decays.
    assert all(result.passed for result in found.results if "decay" in result.name)


def test_a_bandwidth_out_of_reach_is_traded_by_its_ratio():
    """Not by how far S exceeds its level up to the wanted frequency, which hardly changes with the bandwidth."""
    limits = {"bandwidth_hz": 250, "disk_margin": 0.5, "damping": 0.1}
    found = design.loops(gyro_job(limits, evaluations=150))[0].closed
    assert not found.passed
    assert found.claims["limit_ratio"] < 1.7


def test_goals_of_which_nothing_is_to_be_seen_are_no_obstacle(job):
    plant = tomllib.loads(platform_source("gimballed_gyro"))
    for torquer in plant["torquer"]:
        del torquer["limit"]
    small = gyro_job({"disk_margin": 0.5}, {"torque_limit": 0.5})
    small = dataclasses.replace(small, platform=read_platform(plant))
    assert design.loops(small)[0].closed.passed


def test_the_filter_of_a_pid_does_not_ring(alone):
    found, _ = alone("pid", soft={"bandwidth_hz": 200.0}, evaluations=150)
    z = np.linalg.eigvals(found.controller.A)
    w = 2 / found.plants.period * (z - 1) / (z + 1)
    fast = w[np.abs(w) > 1000.0]
    assert len(fast) == 4
    assert np.all(-fast.real / np.abs(fast) >= 0.4 - 1e-9)
