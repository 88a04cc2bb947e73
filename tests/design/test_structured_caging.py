"""Structured caging loops: gradients against differences, pieces against measures, and what the search reaches."""

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from design import test_sight as sight
from platform_ctrl import analysis, design
from platform_ctrl.analysis import transfers as closed
from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.sight import blur_of, contrast_of
from platform_ctrl.analysis.system import System
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.fixed_structure.descent import finer, pieces
from platform_ctrl.design.fixed_structure.loops import LoopGradients
from platform_ctrl.design.fixed_structure.maps import at_least
from platform_ctrl.design.fixed_structure.norm import AugmentedLoop, WorstNorm, augmented
from platform_ctrl.design.fixed_structure.sections import Sections
from platform_ctrl.design.fixed_structure.structures import Parametrised, Structure, Units
from platform_ctrl.design.loop_signals import channels
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.methods.classical import Classical
from platform_ctrl.design.partition import Partition
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import DesignError
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.job.requirements import WORST_CASE, requirement
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.plant.source import platform_source

EXAMPLE = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
LOOPS = ("caging 4-5-7", "caging 9-10")


def starting_values(given, channel, nutation, period):
    """All options of a classical design, those not given from rules of thumb."""
    return Classical().defaults(
        DesignSpec(name="classical", method="classical", options=given), channel, nutation, period
    )


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
        out[spec.name] = plants, channel, Classical().of_directions(options, channel, plants.period)
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
    "S at the output": closed.S_OUTPUT,
    "S at the input": closed.S_INPUT,
    "(S - T)/2 at the output": closed.OF_HALF[0],
    "(S - T)/2 at the input": closed.OF_HALF[1],
    "T at the output": closed.OF_T[0],
    "T at the input": closed.OF_T[1],
    "error per command": closed.FOLLOWING,
    "angle per torque": closed.ANGLE_PER_TORQUE,
    "angle per Omega": closed.ANGLE_PER_OMEGA,
    "torque per noise": closed.Transfer("noise", "torque"),
    "torque per rate": closed.Transfer("Omega", "torque"),
    "controller": None,
    "torque per Omega": closed.TORQUE_SHARE,
    "S at a further reading": closed.OF_S[2],
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


@pytest.mark.parametrize("kept", [3, 2])
@pytest.mark.parametrize("which", MAPS)
def test_singular_values_have_the_slopes_of_differences(cases, which, kept):
    plants, _, K = cases["caging 4-5-7"]
    plants = plants.only(range(3))
    if kept < 3:
        plants = dataclasses.replace(plants, commanded=np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.2]]))
    elif which == "S at a further reading":
        return
    of = MAPS[which]
    of = closed.CONTROLLER if of is None else closed.maps_of(of, plants)[-1]
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


def test_every_entry_of_a_controller_can_be_moved(alone):
    """Behind the PID, with a goal out of its reach."""
    limits = {"disk_margin": 0.5, "damping": 0.1, "torque_noise": 0.005}
    free, _ = alone("state-space", limits, {"bandwidth_hz": 90.0}, order=4, evaluations=80)
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
    found, _ = alone("pid", limits, {"bandwidth_hz": 60.0}, evaluations=80)
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


@pytest.mark.parametrize("structure", ["cross-axis", "state-space"])
def test_gimbals_without_a_gyro_are_caged_too(structure):
    plant = tomllib.loads(platform_source("three_gyro_platform"))
    plant["rotor"][2]["angular_momentum"] = 0.0
    job = small_job(plant, ["9", "10"], structure, bandwidth_hz=15.0, disk_margin=0.5, damping=0.1)
    (outcome,) = design.loops(job)
    assert outcome.closed.passed


@pytest.mark.parametrize("structure", ["cross-axis", "state-space"])
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
        ({"structure": "sections"}, '"sections" is for loops of rates: choose "pid"'),
        ({"reserve": 1.0}, "reserve must be less than 1, got 1"),
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


STRUCTURES: dict[str, Structure] = {
    "static": design.Static(),
    "static, diagonal": design.Static(pattern="diagonal"),
    "second order": design.StateSpaceOrder(states=2),
    "PID": design.PID(),
    "PID, cross-axis": design.PID(P="cross", I="cross", D="diagonal", filter_order=1),
    "PID, filtered derivative": design.PID(filtered="derivative"),
    "PI without filter": design.PID(D="none", filter_order=0),
    "PI and an observer": design.Series(
        blocks=(
            design.PID(D="none", P="diagonal", I="diagonal", filter_order=0, fixed={"kp11": 1.0}),
            design.StateSpaceOrder(states=1),
        )
    ),
}


def random_plant(rng: np.random.Generator, n: int = 5) -> Partition:
    def draw(*shape: int) -> np.ndarray[Any, Any]:
        return rng.standard_normal(shape)

    return Partition(
        A=draw(n, n) - 3.0 * np.eye(n), B1=draw(n, 2), B2=draw(n, 2), C1=draw(3, n), C2=draw(2, n),
        D11=0.1 * draw(3, 2), D12=0.1 * draw(3, 2), D21=0.1 * draw(2, 2), D22=0.1 * draw(2, 2),
    )  # fmt: skip


@pytest.mark.parametrize("name", STRUCTURES)
def test_the_slopes_of_a_structure_are_its_differences(name: str) -> None:
    rng = np.random.default_rng(4)
    whole = Parametrised(STRUCTURES[name], 2, 2, Units(gain=np.array([[1.0, 2.0], [0.5, 3.0]]), rate=2.0))
    x = whole.start + 0.3 * rng.standard_normal(whole.start.size)
    J, step = whole.jacobian(x), 1e-6
    assert J.shape == (*whole.matrix(x).shape, x.size)
    for k in range(x.size):
        e = step * np.eye(x.size)[k]
        slope = (whole.matrix(x + e) - whole.matrix(x - e)) / (2 * step)
        np.testing.assert_allclose(J[..., k], slope, rtol=1e-6, atol=1e-6 * (1.0 + np.abs(J).max()))


def test_a_pid_has_the_transfer_function_that_it_says() -> None:
    gains = {"kp11": 2.0, "ki11": 3.0, "kd11": 0.5, "filter1": 40.0, "damping1": 0.6}
    s = 1j * np.array([0.1, 1.0, 10.0, 100.0])
    F = 40.0**2 / (s**2 + 2 * 0.6 * 40.0 * s + 40.0**2)
    for structure, expected in (
        (design.PID(), (2.0 + 3.0 / s + 0.5 * s) * F),
        (design.PID(filtered="derivative"), 2.0 + 3.0 / s + 0.5 * s * F),
    ):
        units = Units(gain=np.ones((1, 1)), rate=1.0)
        names = [one.name for one in structure.parameters(1, 1, units)]
        A, B, C, D, _ = structure.block(np.array([gains[name] for name in names]), 1, 1)
        found = [(C @ np.linalg.solve(one * np.eye(len(A)) - A, B) + D)[0, 0] for one in s]
        np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_peaks_and_their_slopes_are_those_of_the_closed_loop() -> None:
    rng = np.random.default_rng(1)
    plant = augmented(random_plant(rng), 1)
    whole = Parametrised(design.StateSpaceOrder(states=1), 2, 2, Units(gain=np.ones((2, 2)), rate=1.0))
    x = whole.start + 0.1 * rng.standard_normal(whole.start.size)
    found = WorstNorm([plant], whole)(x)
    loop = AugmentedLoop(plant, whole.matrix(x))
    norm = analysis.hinf_norm(control.ss(loop.A, loop.B, loop.C, loop.D))[0]
    assert found.stable
    assert found.values.max() == pytest.approx(norm, rel=1e-8)
    top = int(np.argmax(found.values))
    for k in range(x.size):
        e = 1e-4 * np.eye(x.size)[k]
        up, down = (WorstNorm([plant], whole)(x + d).values.max() for d in (e, -e))
        assert found.gradients[top, k] == pytest.approx((up - down) / 2e-4, rel=1e-4, abs=1e-6)


def test_a_peak_far_narrower_than_the_distance_of_poles_is_found() -> None:
    """A resonance with a damping of 1e-7, beside a slow pole that leads at low frequency."""
    A = np.array([[-1.0, 0, 0], [0, -2e-6, 10.0], [0, -10.0, -2e-6]])
    B, C = np.array([[0.5], [0.0], [1e-5]]), np.array([[1.0, 1.0, 0.0]])
    none = np.zeros((1, 1))
    plant = Partition(A=A, B1=B, B2=0 * B, C1=C, C2=0 * C, D11=none, D12=none, D21=none, D22=none)
    loop = AugmentedLoop(plant, none)
    frequency = loop.peaks(np.zeros(0))
    assert loop.gains(frequency).max() == pytest.approx(analysis.hinf_norm(control.ss(A, B, C, none))[0], rel=1e-8)


def test_forms_in_the_controller_are_the_budget_and_their_slopes_those_of_differences():
    limits = dict.fromkeys(sight.KEYS, 1.0) | {"contrast": 0.01}
    found = design.loops(sight.job(limits=limits))[0].closed
    K = System.of(found.controller, "pi")
    forms, other = found.plants.sight_budget.forms(K), K._replace(C=1.2 * K.C, D=1.2 * K.D)
    exact, elsewhere = found.plants.sight_budget.exact(K), found.plants.sight_budget.exact(other)
    for key in sight.KEYS:
        assert max(form.at(K) for form in forms[key]) == pytest.approx(exact[key], rel=1e-6)
        # Dry friction is that with K.
        assert max(form.at(other) for form in forms[key]) == pytest.approx(elsewhere[key], rel=2e-2)
    # Of a Gaussian motion, with all of the windows' motion in one variance.
    blurred = max(form.at(K) for form in forms["contrast"])
    assert contrast_of(blurred) == pytest.approx(exact["contrast"], abs=2e-3)
    assert contrast_of(blurred) <= exact["contrast"]
    assert blur_of(contrast_of(blurred)) == pytest.approx(blurred)
    n, M = len(K.A), np.block([[K.A, K.B], [K.C, K.D]])
    step = np.random.default_rng(3).standard_normal(M.shape) * np.abs(M) * 1e-6

    def at(M):
        return LoopGradients(found.plants, System(M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:], K.dt))

    for key in (*sight.KEYS, "contrast"):
        here, high, low = (at(M + sign * step).sight(forms[key], 1e-5) for sign in (0.0, 1.0, -1.0))
        slopes = np.sum(here.gradient * step, axis=(1, 2))
        np.testing.assert_allclose(slopes, 0.5 * (high.ratio - low.ratio), rtol=1e-4, atol=1e-12)


def test_sections_have_the_transfer_function_that_they_say():
    structure, units = Sections(rates=[10.0, 30.0]), Units(gain=np.ones((2, 2)), rate=1.0)
    given = {"c2_1": 0.5, "e2_1": -2.0, "damping2_1": 0.3, "c2_2": 1.5, "filter2_2": 40.0}
    p = np.array([given.get(one.name, one.start) for one in structure.parameters(2, 2, units)])
    s = 1j * np.array([1.0, 10.0, 35.0])
    A, B, C, D, _ = structure.block(p, 2, 2)
    found = np.array([C @ np.linalg.solve(one * np.eye(len(A)) - A, B) + D for one in s])
    expected = 1.0 + (0.5 - 2.0 * s / 10.0) * 100.0 / (s**2 + 0.6 * 10.0 * s + 100.0)
    expected += 1.5 * 1600.0 / (s**2 + 40.0 * s + 1600.0)
    np.testing.assert_allclose(found[:, 1, 1], expected, rtol=1e-12)
    # Sections without gains do nothing.
    np.testing.assert_allclose(found[:, 0], np.tile([1.0, 0.0], (3, 1)), atol=1e-15)
