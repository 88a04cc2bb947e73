"""What decides a verdict is exact: resonances that every grid misses, and no true value worse than the reported."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import differential_evolution

import narrow_loops
from cli.test_cli import undrawn  # noqa: F401
from linear_tree import Body, Tree, Truth
from platform_ctrl import design, linearise, read_job
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.loop_metrics import measure, measured
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import System
from platform_ctrl.cli import main
from platform_ctrl.design.fixed_structure.descent import Search
from platform_ctrl.design.fixed_structure.loops import LoopGradients
from platform_ctrl.design.fixed_structure.sections import Named
from platform_ctrl.design.fixed_structure.structures import Parametrised, Units
from platform_ctrl.design.tuning import Tuner, worst_ratio
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.requirements import WORST_CASE, of_readings, requirement
from platform_ctrl.verification.coupled import coupled_check

PERIOD = 5e-4
JOB = """
schema = 2
name = "gyro 9-10, no delay"
plant = "three_gyro_platform"
operation = { Omega = [0.0, 0.0, 0.0] }
uncertainty = { inertia = 0.1, spin = 0.1 }
sampling = { rate_hz = 2000, delay = 0.0 }

[[loop]]
name = "caging 9-10"
kind = "caging"
gimbals = ["9", "10"]
use = "classical"
limits = { sensitivity_peak_worst_case = 3.0 }
design = [{ name = "classical", method = "classical" }]
"""
# The plant with which the loop below all but oscillates.
WORST = "J9-10% J10+10% L11-10%"


def narrow_loop(depth: float = 0.20796, width: float = 0.0061867) -> System:
    """A PD in either axis and cross gain, behind a notch of 0.6 % width at 75 Hz."""
    return narrow_loops.controller(np.array([28.549, 285.48, 26.282, 305.64, 235.28, 75.46, depth, width]))


# The worst loops of `narrow_loops` that a search has found, of each kind: delay, s; numbers of the controller; what the
# grid of a search alone would have said.
FOUND = {
    "sensitivity peak": (0.0, [32.96, 429.6, 7.721, 241.6, 45.21, 230.1, 3.86, 0.00837], 2.133),
    "complementary sensitivity peak": (0.0, [49.39, 251.1, 36.52, 205.3, 67.92, 154.0, 6.913, 0.002673], 1.339),
    "disk margin": (0.0, [13.34, 392.2, 6.27, 414.1, 28.97, 258.7, 3.475, 0.01136], 0.654),
    "tracking": (5e-4, [34.36, 66.86, 92.87, 272.4, 103.7, 35.41, 8.638, 0.002239], 1.683),
    "bandwidth": (5e-4, [42.45, 217.6, 92.76, 172.0, 148.9, 2.159, 0.1247, 0.04224], 17.54),
}
# The same of what continuous disturbances do, between samples.
DISTURBED = {
    "Omega rejection": (5e-4, [30.28, 470.8, 56.41, 63.73, 117.4, 296.5, 4.608, 0.0356], 0.01144, 0.3296),
    "torque rejection": (5e-4, [7.387, 165.1, 21.36, 84.91, 100.8, 23.7, 11.67, 0.002921], 1.573, 62.16),
    "torque limit": (0.0, [55.18, 421.2, 95.7, 88.39, 148.6, 42.16, 8.649, 0.001393], 1.108, 31.61),
}
# By brute force over frequency, eigenvalues of many digits and Lyapunov equations: the worst figure and that of the
# nominal plant; the least decay rate, 1/s, and damping; the nominal torque noise, N m.
TRUE = {
    "sensitivity peak": (431.7706922, 13.2235872, 0.07080249666, 4.848065094e-05, 0.003933786193),
    "complementary sensitivity peak": (98.17672041, 98.17672041, 0.1047169563, 0.0001074804295, 0.002217816184),
    "disk margin": (0.002228982516, 0.1160611926, 0.07821143991, 4.765286743e-05, 0.003535726506),
    "tracking": (42.53504731, 8.915348422, 0.06930508553, 0.0003088323002, 0.000916785896),
    "bandwidth": (2.143911254, 2.14714553, 0.06701536829, 0.004957522748, 0.001824415902),
}
# Likewise of the coupled check: disk margins of both channels alone, and of both at once over the scaling.
COUPLED = {
    "sensitivity peak": (0.1021093485, 0.4149556575, 0.0887902),
    "complementary sensitivity peak": (0.01862487665, 0.03306573098, 0.0119344),
    "torque limit": (0.2915755855, 0.1913386345, 0.121128),
}
# Up to here two of them are asked for, rad/s.
EDGE = {"tracking": 300.0, "torque limit": 300.0}


@pytest.fixture(scope="module")
def plants() -> PlantSet:
    """The nominal plant and the corners of ±10 % in J and L, without delay."""
    return narrow_loops.plants(0.0).only(range(9))


@pytest.mark.usefixtures("undrawn")
def test_check_fails_a_loop_whose_sensitivity_peaks_between_all_grid_points(
    plants: PlantSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    K = narrow_loop()
    true = 60.5634109  # with the grid's points alone 2.3: as if it had room to spare
    entry = {name: getattr(K, name).tolist() for name in "ABCD"}
    entry |= {"name": "narrow", "dt": PERIOD, "delay": 0.0, "inputs": ["alpha9", "beta10"], "outputs": ["Q9", "Q10"]}
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    (tmp_path / "K.json").write_text(json.dumps({"schema": 1, "controllers": [entry]}), encoding="utf-8")
    arguments = ["check", str(tmp_path / "job.toml"), "--controllers", str(tmp_path / "K.json"), "-o", str(tmp_path)]
    assert main([*arguments, "--quiet"]) == 1
    assert "FAILED" in capsys.readouterr().out
    record = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    (missed,) = [one for one in record["requirements"] if not one["passed"]]
    assert missed["name"] == "sensitivity peak, worst case"
    assert missed["value"] == pytest.approx(true, rel=1e-8)
    assert missed["method"] == "exact"
    assert missed["evidence"].startswith(f"{WORST}; 9 plants")


def test_a_search_sees_the_resonance_that_its_grid_misses(plants: PlantSet) -> None:
    asked = requirement("sensitivity peak", 3.0, over=WORST_CASE)
    rough = measure(plants, narrow_loop(), [asked], exact=False)
    assert not rough.exact
    assert asked.values(rough).max() > 50.0
    assert asked.result(plants, rough).method == "sampled"


@pytest.mark.parametrize("kind", DISTURBED)
def test_what_a_grid_misses_of_continuous_disturbances_is_in_the_figure(kind: str) -> None:
    delay, numbers, grid, true = DISTURBED[kind]
    among, K = narrow_loops.plants(delay).only(range(9)), narrow_loops.controller(np.array(numbers))
    asked = requirement(kind, 1.0, over=WORST_CASE, frequency=EDGE.get(kind))  # type: ignore[arg-type]
    on_grid = measured(narrow_loops.OnGrid(among, K), asked) / asked.metric.scale
    assert on_grid.max() == pytest.approx(grid, rel=1e-3)
    result = asked.check(among, K)
    assert result.method == "refined"
    assert result.value == pytest.approx(true, rel=1e-3)
    assert "between samples" in result.evidence


@pytest.mark.parametrize("kind", FOUND)
def test_what_a_grid_misses_the_most_is_in_the_figure(kind: str) -> None:
    (delay, numbers, grid), (worst, nominal, decay, damping, noise) = FOUND[kind], TRUE[kind]
    among, K = narrow_loops.plants(delay).only(range(9)), narrow_loops.controller(np.array(numbers))
    asked = requirement(kind, 1.0, over=WORST_CASE, frequency=EDGE.get(kind))  # type: ignore[arg-type]
    on_grid = measured(narrow_loops.OnGrid(among, K), asked) / asked.metric.scale
    assert (on_grid.min() if asked.sense == "at least" else on_grid.max()) == pytest.approx(grid, rel=1e-3)
    result = asked.check(among, K)
    assert result.method == "exact"
    assert result.value == pytest.approx(worst, rel=1e-8)
    of_one = requirement(kind, 1.0, frequency=EDGE.get(kind))  # type: ignore[arg-type]
    assert of_one.check(among, K).value == pytest.approx(nominal, rel=1e-8)
    # Poles and noise next to the stability boundary keep their digits.
    assert requirement("stability", 1.0, over=WORST_CASE).check(among, K).value == pytest.approx(decay, rel=1e-7)
    assert requirement("damping", 1.0, over=WORST_CASE).check(among, K).value == pytest.approx(damping, rel=1e-7)
    assert requirement("torque noise", 1.0).check(among, K).value == pytest.approx(noise, rel=1e-7)


def test_a_resonance_of_the_controller_is_in_its_gain(plants: PlantSet) -> None:
    K = narrow_loops.controller(np.array([47.85, 405.2, 36.23, 71.4, 51.36, 100.4, 17.51, 0.04983]))
    assert requirement("controller gain", 1.0).check(plants, K).value == pytest.approx(2256.395105, rel=1e-8)
    low = requirement("controller gain", 1.0, frequency=700.0).check(plants, K)
    assert low.value == pytest.approx(1069.032662, rel=1e-8)


@pytest.mark.parametrize("kind", COUPLED)
def test_the_coupled_check_sees_what_a_grid_misses(kind: str, tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(f"{JOB}\n[coupled]\ndisk_margin = 0.1\n", encoding="utf-8")
    job = read_job(tmp_path / "job.toml")
    K = narrow_loops.controller(np.array((FOUND | DISTURBED)[kind][1]))
    found = coupled_check(job, linearise(job.platform), [K.to_control(("alpha9", "beta10"), ("Q9", "Q10"))])
    *alone, both = COUPLED[kind]
    np.testing.assert_allclose(found.coupled, alone, rtol=1e-7)
    (margin,) = [one for one in found.results if one.name == "simultaneous disk margin"]
    assert margin.method == "bound"
    assert both * (1.0 - 5e-4) <= margin.value <= both * (1.0 + 1e-4)


def test_the_tuner_goes_on_where_a_limit_is_missed_between_the_points_of_its_grid(
    plants: PlantSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without the poles' frequencies the search starts blind: its grid sees nothing wrong with the narrow loop.
    monkeypatch.setattr(Loop, "narrow", {})
    asked = [requirement("stability", 0.05, over=WORST_CASE), requirement("sensitivity peak", 3.0, over=WORST_CASE)]
    start = {"depth": 0.20796, "width": 0.0061867}

    def build(options: dict[str, float]) -> System:
        return narrow_loop(**options)

    assert worst_ratio(build(start), plants, asked) < 0.95
    tuner = Tuner(
        movable=list(start), build=build, plants=plants, requirements=asked, upper={"depth": 1.0, "width": 1.0}
    )
    K = narrow_loop(**tuner.run(start))
    # Where the limits cannot be met, what is told is not better than what is there.
    told: list[float] = []
    cramped = replace(tuner, movable=["width"], upper={"width": 0.00619}, evaluations=60)
    replace(cramped, progress=lambda ratio, _: told.append(ratio)).run(start)
    assert min(told) > 1.0
    monkeypatch.undo()
    assert asked[1].check(plants, K).passed


def test_the_structured_search_goes_on_where_a_limit_is_missed_between_the_points_of_its_grid(
    plants: PlantSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Loop, "narrow", {})
    monkeypatch.setattr(LoopGradients, "_hidden", lambda self, *_: self.none())
    asked = [requirement("stability", 0.05, over=WORST_CASE), requirement("sensitivity peak", 3.0, over=WORST_CASE)]
    start = {"depth": 0.3, "width": 0.003}
    named = Named(build=lambda options: narrow_loop(**options), values=start, largest={"depth": 1.0, "width": 1.0})
    family = Parametrised(named, 2, 2, Units(gain=np.ones((2, 2)), rate=1.0))
    told: list[float] = []
    found = Search(plants, asked, 0.02, lambda hard, soft: told.append(hard)).run(family, 200)
    assert told[0] < 0.9  # what it sees at first
    K = family.block(found.x)
    monkeypatch.undo()
    assert asked[1].check(plants, K).passed


# Searches over jobs, held against an oracle of its own; SEARCHES in the environment says how many evaluations.

BAND_HZ, FROM_HZ = 8.0, 0.1
KINDS = [
    kind
    for kind, metric in METRICS.items()
    if metric.of != "controller" and kind != "fastest pole" and not metric.of_sight  # tests/design/test_sight.py
]
COUNT = 26


def solid(size: float, product: float = 0.0) -> list[list[float]]:
    return [[size, 0.0, 0.0], [0.0, size, product], [0.0, product, size]]


def drawn(numbers: np.ndarray) -> Tree:
    """Numbers from 0 to 1 as a job: one axis or two, alone or with a passive body on a spring inside or outside."""
    x = iter(np.clip(numbers, 0.0, 1.0).tolist())

    def log(low: float, high: float) -> float:
        return low * (high / low) ** next(x)

    def signed(low: float, high: float, positive: float) -> float:
        if (at := next(x)) < 0.25:
            return 0.0
        if at < positive:
            return low * (high / low) ** ((at - 0.25) / (positive - 0.25))
        return -low * (high / low) ** ((at - positive) / (1.0 - positive))

    shape, J = int(5.999 * next(x)), 0.01
    viscous, stiffness, weight = log(1e-4, 0.03), signed(1e-3, 1.0, 0.75), signed(1e-5, 0.03, 0.6)
    light, w, damping = J * log(1e-6, 1.0), 2.0 * np.pi * log(0.05, 400.0), log(1e-5, 0.3)
    turned, product = 6.0 * next(x), J * (next(x) - 0.5)
    # What carries the camera is not much lighter than it: the oracle would lose its digits.
    own = light if shape in (1, 4) else max(light, 0.1 * J)

    def passive(parent: int, axis: tuple[float, float, float]) -> Body:
        return Body("flap", parent, axis, solid(own), own * w * w, 2.0 * damping * w * own)

    def pitch(parent: int, product: float = 0.0) -> Body:
        return Body("pitch", parent, (0, 1, 0), solid(J, product), stiffness, viscous, (0.0, 0.0, weight), True)

    yaw = Body("yaw", -1, (0, 0, 1), solid(2.0 * J), stiffness if turned > 3.0 else 0.0, viscous, driven=True)
    tilted = (0.0, float(np.cos(turned)), float(np.sin(turned)))
    bodies = (
        (pitch(-1),),
        (pitch(-1), passive(0, (0, 1, 0))),
        (passive(-1, (0, 1, 0)), pitch(0)),
        (yaw, pitch(0, product)),
        (yaw, pitch(0, product), passive(1, tilted)),
        (yaw, passive(0, (0, 1, 0)), pitch(1, product)),
    )[shape]
    return Tree(
        bodies,
        rate_hz=float(round(log(500.0, 4000.0))),
        delay=round(1.9 * next(x), 3),
        lag=round(0.8 * next(x), 3),
        bandwidth_hz=log(100.0, 500.0) if next(x) < 0.8 else 0.0,
        late=round(3.0 * next(x), 3),
        crossover_hz=log(2.0, 30.0),
        integral_hz=log(0.005, 4.0),
        double_hz=0.0 if (at := next(x)) < 0.6 else 0.02 * 50.0 ** ((at - 0.6) / 0.4),
        fed=next(x) > 0.6,
        pointing=next(x) > 0.6,
    )


def compared(one: Tree, kinds: list[str]) -> dict[str, tuple[float, float]]:
    """Return the true and the reported values of a job; none where its design is refused."""
    try:
        job = read_job(one.job({}))
        (outcome,) = design.loops(job)
    except PlatformCtrlError:
        return {}
    plants, K = outcome.closed.plants, outcome.closed.controller
    assert plants is not None
    truth = Truth(one, System.of(K, "K"), plants.noise)
    names = {kind: of_readings(METRICS[kind].name, "pointing" if one.pointing else "rate") for kind in kinds}
    true = truth.values(BAND_HZ, FROM_HZ, set(names.values()))
    loops = Loop(plants, plants.joined(K))
    out = {}
    for kind in kinds:
        more = {"frequency": 2.0 * np.pi * BAND_HZ} if METRICS[kind].needs_frequency else {}
        more = {"frequency": 2.0 * np.pi * BAND_HZ, "lowest": 2.0 * np.pi * FROM_HZ} if kind == "torque limit" else more
        found = np.atleast_1d(METRICS[kind].in_unit(measured(loops, requirement(kind, 1.0, **more), exact=True)))
        if names[kind] in true:
            reported = found.min() if METRICS[kind].sense == "at least" else found.max()
            out[kind] = (float(true[names[kind]]), float(reported))
    return out


def worse(kind: str, true: float, reported: float) -> float:
    """Return by which factor the true value is worse than the reported one, 1 where it is as good."""
    if METRICS[kind].decibels:
        return 1.0 if true == reported else float(10.0 ** ((reported - true) / 20.0))
    if max(abs(true), abs(reported)) < (1e-3 if kind != "stability" else 1e-6) or true == reported:
        return 1.0
    if kind == "stability" and min(true, reported) < 0.0:
        return 1.0 + max(reported - true, 0.0) / abs(true)
    better, less = (reported, true) if METRICS[kind].sense == "at least" else (true, reported)
    return better / less if less > 0.0 and np.isfinite(better) else (1.0 if better < less else np.inf)


# Bodies that hid what a loop does: a light one on a soft spring, a slow mode of what carries the camera.
LIGHT = Body("flap", 0, (0, 1, 0), solid(7e-8), 8.4e-8, 2.8e-9)
SLOW = Body("flap", -1, (0, 1, 0), solid(1e-3), 4e-6, 1e-8)
CASES = {
    "light body": Tree(
        (Body("pitch", -1, (0, 1, 0), solid(0.01), 0.005, 0.005, (0, 0, -0.02), True), LIGHT),
        583.0, 0.03, 0.1, 0.0, 1.3, 6.4, 0.03, pointing=True,
    ),
    "slow mode": Tree(
        (SLOW, Body("pitch", 0, (0, 1, 0), solid(0.01), 0.015, 0.016, driven=True)),
        1154.0, 1.2, 0.6, 230.0, 0.6, 3.7, 0.0355,
    ),
    "two channels": Tree(
        (
            Body("yaw", -1, (0, 0, 1), solid(0.0106), 0.00347, 0.00526, driven=True),
            Body("flap", 0, (0, 1, 0), solid(0.00516), 1.5, 0.0431),
            Body("pitch", 1, (0, 1, 0), solid(0.01, 0.000212), 0.00347, 0.00263, (0, 0, 1.64e-5), True),
        ),
        3226.0, 1.411, 0.465, 411.0, 1.235, 24.3, 0.00792, pointing=True,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_bodies_and_other_channels_hide_nothing(name: str) -> None:
    found = compared(CASES[name], KINDS)
    assert len(found) >= 15
    for kind, (true, reported) in found.items():
        assert worse(kind, true, reported) <= 1.01, (kind, true, reported)


def test_true_values_are_those_reported_on_jobs_of_every_kind() -> None:
    rng = np.random.default_rng(5)
    seen = 0
    for _ in range(4):
        one = drawn(rng.uniform(size=COUNT))
        for kind, (true, reported) in compared(one, KINDS).items():
            seen += 1
            assert worse(kind, true, reported) <= 1.01, (one, kind, true, reported)
            assert worse(kind, reported, true) <= 1.02, (one, kind, true, reported)
    assert seen > 40


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_search_for_the_worst_finds_no_true_value_that_is_worse(kind: str) -> None:
    wanted = int(os.environ.get("SEARCHES", "1000"))
    found: list[tuple[float, Tree, tuple[float, float]]] = []

    def score(numbers: np.ndarray) -> float:
        if len(found) >= wanted:
            return 0.0
        one = drawn(numbers)
        pair = compared(one, [kind]).get(kind)
        if pair is None:
            return 0.0
        ratio = worse(kind, *pair)
        found.append((ratio, one, pair))
        return -min(ratio, 1e3)

    rounds = 1 + 2 * wanted // (2 * COUNT)
    differential_evolution(score, [(0.0, 1.0)] * COUNT, popsize=2, maxiter=rounds, tol=0.0, seed=3, polish=False)
    worst = max(found, key=lambda item: item[0])
    assert worst[0] <= 1.01, worst
