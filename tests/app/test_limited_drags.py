"""A drag of a pole or of the crossover makes no requirement missed that is met, unless it is free to."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from platform_ctrl.app.backend import Backend
from platform_ctrl.app.dragging import REACH, SLIDERS
from platform_ctrl.app.least_squares import constrained_least_squares
from platform_ctrl.app.pictures import Picture
from platform_ctrl.errors import DesignError
from platform_ctrl.job.reading import read_job

JOB = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
PAIR, THREE, SERVO = "caging 9-10", "caging 4-5-7", "stabilisation"


@pytest.fixture(scope="module")
def bench() -> Backend:
    return Backend(JOB)


@pytest.fixture(scope="module")
def judge() -> Backend:
    """Another backend: what it shows was not worked out while something was dragged."""
    return Backend(JOB)


def nearest(picture: Picture, place: complex) -> complex:
    present = picture.locus.present[np.isfinite(picture.locus.present)]
    return complex(present[int(np.argmin(np.abs(present - place)))])


def missed(picture: Picture) -> set[str]:
    return {one.name for one in picture.requirements if not one.passed}


def test_a_pole_goes_as_far_as_the_bandwidth_limit_allows(bench: Backend, judge: Backend) -> None:
    start, goal = bench.start(PAIR), -807.0 + 865.0j
    before = bench.picture(start)
    assert missed(before) == set()
    pole = nearest(before, -630.0 + 760.0j)
    free = judge.picture(judge.drag_pole(start, pole, goal, free=True))
    assert "bandwidth" in missed(free)
    limiting: list[tuple[str, ...]] = []
    dragged = bench.drag_pole(start, pole, goal, on_limited=limiting.append)
    after = judge.picture(dragged)
    assert missed(after) == set()
    assert "bandwidth" in limiting[-1]
    # It goes on along the limit: further than the first place where the way to the goal itself meets it.
    assert abs(nearest(after, pole) - goal) < abs(pole - goal) - 0.03 * abs(pole)


def test_a_pole_pulled_by_a_fifth_keeps_the_bandwidth_within_a_factor_of_two_also_without_any_limit() -> None:
    job = read_job(JOB)
    without = dataclasses.replace(job, loops=tuple(dataclasses.replace(one, limits={}) for one in job.loops))
    bench = Backend(without)
    start = bench.start(PAIR)
    before = bench.picture(start)
    pole = nearest(before, -630.0 + 760.0j)
    # With Shift the sliders go wherever the pole is asked to: next to no bandwidth is left.
    free = bench.picture(bench.drag_pole(start, pole, 1.2 * pole, free=True))
    assert free.margins.bandwidth < before.margins.bandwidth / 20.0
    for turn in (0.8, 1.2, np.exp(0.2j), np.exp(-0.2j)):
        limiting: list[tuple[str, ...]] = []
        dragged = bench.drag_pole(start, pole, turn * pole, on_limited=limiting.append)
        after = bench.picture(dragged)
        assert 0.5 < after.margins.bandwidth / before.margins.bandwidth < 2.0
        if limiting != [(SLIDERS,)]:
            continue
        # As near as the sliders get: each within twice the relative way of the pole.
        ways = [
            abs(np.log(x / start.options[PAIR][start.design][name]))
            for name, x in dragged.options[PAIR][dragged.design].items()
        ]
        assert max(ways) == pytest.approx(REACH * abs(turn - 1.0) / max(abs(turn), 1.0), abs=0.03)


def test_a_drag_that_returns_to_where_it_began_moves_sliders_no_further_than_it_went(bench: Backend) -> None:
    start = bench.start(PAIR)
    pole = nearest(bench.picture(start), -630.0 + 760.0j)
    origin = start, pole
    there = bench.drag_pole(start, pole, 0.95 * pole, origin=origin)
    back = bench.drag_pole(there, nearest(bench.picture(there), 0.95 * pole), pole, origin=origin)
    for name, x in start.options[PAIR][start.design].items():
        assert back.options[PAIR][start.design][name] == pytest.approx(x, rel=0.05)


def test_the_shaded_region_is_about_what_a_drag_reaches(bench: Backend) -> None:
    start = bench.start(PAIR)
    before = bench.picture(start)
    pole = nearest(before, -190.0 + 1240.0j)
    corners = bench.reachable_poles(start, pole)
    assert np.abs(corners - pole).max() > 0.02 * abs(pole)
    for corner in corners[::5]:
        way = corner - pole
        reached = nearest(bench.picture(bench.drag_pole(start, pole, pole + 3.0 * way)), corner)
        assert abs(reached - corner) < 0.9 * abs(way) + 0.02 * abs(pole)
    low, high = bench.reachable_crossovers(start, float(before.bode.crossovers[-1]))
    for end, factor in ((low, 0.5), (high, 2.0)):
        crossover = float(before.bode.crossovers[-1])
        after = bench.picture(bench.drag_crossover(start, factor * crossover)).bode.crossovers[-1]
        assert after == pytest.approx(end, rel=0.15)


@pytest.mark.parametrize("name", ["lead_hz", "notch_hz"])
def test_a_dragged_zero_or_notch_moves_alone_and_stops_at_the_limits(bench: Backend, judge: Backend, name: str) -> None:
    start = bench.start(PAIR)
    options = start.options[PAIR][start.design]
    near = bench.drag_slider(start, name, 1.01 * options[name])
    assert near.options[PAIR][start.design] == dict(options) | {name: pytest.approx(1.01 * options[name])}
    limiting: list[tuple[str, ...]] = []
    far = bench.drag_slider(start, name, 0.5 * options[name], on_limited=limiting.append)
    assert missed(judge.picture(far)) == set()
    assert limiting
    assert 0.5 < far.options[PAIR][start.design][name] / options[name] < 1.0
    free = bench.drag_slider(start, name, 0.5 * options[name], free=True)
    assert free.options[PAIR][start.design][name] == pytest.approx(0.5 * options[name])
    with pytest.raises(DesignError, match="fixed"):
        bench.drag_slider(start.but(fixed=frozenset({name})), name, options[name])


@given(
    loop=st.sampled_from([PAIR, THREE]),
    which=st.integers(0, 4),
    size=st.floats(0.7, 1.4),
    turn=st.floats(-0.5, 0.5),
)
@hypothesis.settings(max_examples=8, derandomize=True, deadline=None)
def test_no_drag_makes_a_requirement_missed_that_is_met(
    bench: Backend, judge: Backend, loop: str, which: int, size: float, turn: float
) -> None:
    start = bench.start(loop)
    before = bench.picture(start)
    poles = before.locus.present[before.locus.draggable]
    pole = complex(poles[which % len(poles)])
    target = size * pole * np.exp(1j * turn)
    limiting: list[tuple[str, ...]] = []
    after = judge.picture(bench.drag_pole(start, pole, target, on_limited=limiting.append))
    assert missed(after) <= missed(before)
    free = bench.drag_pole(start, pole, target, free=True)
    if missed(judge.picture(free)) <= missed(before) and not limiting:
        # Where nothing holds it the drag is the free one.
        assert abs(nearest(after, target) - target) == pytest.approx(
            abs(nearest(judge.picture(free), target) - target), abs=1e-6 * abs(target)
        )
    for name in {name for names in limiting for name in names} - {SLIDERS}:
        assert name in {one.name for one in before.requirements if one.passed}


def test_missed_limits_do_not_limit_a_drag(bench: Backend) -> None:
    settings = bench.moved(bench.start(PAIR), "crossover_hz", 20.0)
    before = bench.picture(settings)
    assert "bandwidth" in missed(before)
    pole = complex(before.locus.present[before.locus.draggable][0])
    limiting: list[tuple[str, ...]] = []
    bench.drag_pole(settings, pole, 1.02 * pole, on_limited=limiting.append)
    assert not any(name == "bandwidth" for names in limiting for name in names)


def test_the_crossover_stops_where_a_requirement_would_be_missed(bench: Backend, judge: Backend) -> None:
    start = bench.start(PAIR)
    crossover = float(bench.picture(start).bode.crossovers[-1])
    limiting: list[tuple[str, ...]] = []
    for factor in (0.5, 2.0):
        limiting.clear()
        after = judge.picture(bench.drag_crossover(start, factor * crossover, on_limited=limiting.append))
        assert missed(after) == set()
        assert limiting
        assert missed(judge.picture(bench.drag_crossover(start, factor * crossover, free=True)))
    near = bench.drag_crossover(start, 1.001 * crossover)
    assert judge.picture(near).bode.crossovers[-1] == pytest.approx(1.001 * crossover, rel=1e-4)


@pytest.mark.slow
def test_no_drag_of_the_servo_makes_a_coupled_requirement_missed(bench: Backend, judge: Backend) -> None:
    settings = bench.start(SERVO)
    before = bench.picture(settings)
    pole = nearest(before, -619.0 + 772.0j)
    limiting: list[tuple[str, ...]] = []
    for share in (0.03, 0.06, 0.09, 0.12):
        target = (1.0 + share) * nearest(before, -619.0 + 772.0j)
        settings = bench.drag_pole(settings, pole, target, on_limited=limiting.append)
        pole = nearest(bench.picture(settings), pole)
    assert limiting
    assert missed(judge.picture(settings)) <= missed(before)


@pytest.mark.parametrize("seed", range(6))
def test_constrained_least_squares_is_what_a_general_optimiser_finds(seed: int) -> None:
    draw = np.random.default_rng(seed)
    A, b, G, h = draw.normal(size=(6, 4)), draw.normal(size=6), draw.normal(size=(7, 4)), draw.uniform(0.0, 0.5, 7)
    x = constrained_least_squares(A, b, G, h)
    assert (G @ x <= h + 1e-9).all()
    other = minimize(
        lambda z: ((A @ z - b) ** 2).sum(),
        np.zeros(4),
        jac=lambda z: 2.0 * A.T @ (A @ z - b),
        constraints={"type": "ineq", "fun": lambda z: h - G @ z, "jac": lambda z: -G},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    np.testing.assert_allclose(x, other.x, atol=1e-6)
    # Without anything in the way it is plain least squares.
    np.testing.assert_allclose(
        constrained_least_squares(A, b, G, np.full(7, 1e3)), np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-9
    )
