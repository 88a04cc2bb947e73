"""Many scenarios at once: each is what it is alone, to the last bit."""

from __future__ import annotations

import dataclasses
import itertools
import re

import control
import numpy as np
import pytest

from platform_ctrl import simulation
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.simulation.batch import BatchResult
from signal_and_gimbal import PERIOD, RMS, fault, gain, plant, scenario

LOOP = [
    control.ss([[0.9]], [[0.1]], [[0.2]], [[0.5]], PERIOD, inputs=["signal"], outputs=["wanted"]),
    control.ss([], [], [], [[1.0, -0.3]], PERIOD, inputs=["wanted", "alpha"], outputs=["Qg"]),
]


def mixed() -> list[Scenario]:
    """Scenarios of different plants, faults, delays, durations and modes; all have noise."""
    stops = {"stops": (-0.05, 0.06), "noise": RMS, "limit": 0.4}
    plants = [
        plant(noise=RMS, limit=0.6),
        plant(noise=2.0 * RMS, limit=0.5, lag=2e-3),
        plant(noise=RMS, limit=0.4, rate_limit=9.0, quantisation=1e-3),
        plant(restitution=0.5, **stops),
        plant(restitution=1.0, lag=1e-3, **stops),
        plant(**stops),
    ]
    faults: list[tuple[Fault, ...]] = [
        (),
        (fault("torquer dead"),),
        (fault("torquer stuck", at=0.0213), fault("pick-off dropout", part="alpha", probability=0.3)),
        (fault("torquer weak", share=0.3), fault("controller overrun", part=None, probability=0.4)),
        (fault("pick-off drift", part="signal", rate=3.0),),
        (fault("pick-off stuck", part="signal_rate"), fault("pick-off dead", part="signal")),
        (fault("stop contact", part="g", until=np.inf, impulse=-2e-3),),
    ]
    return [
        scenario(
            one,
            level=0.3,
            slope=0.2 * k,
            mode="stabilised" if k % 5 == 4 else "caged",
            duration=0.1 if k % 3 else 0.08,
            delay=(0.0, 0.3, 1.7)[k % 4 % 3] * PERIOD,
            faults=failing,
            run=k,
            seed=k // 20,
        )
        for k, (one, failing) in enumerate(itertools.product(plants, faults))
    ]


def rows(figures: BatchResult) -> np.ndarray:
    names = ("angle", "attitude", "torque_share", "saturated", "stop_contacts")
    counts = np.column_stack([figures.samples, figures.requested])
    return np.concatenate([*(getattr(figures, name) for name in names), counts], axis=1)


def fly(scenarios: list[Scenario], threads: int = 1) -> np.ndarray:
    return rows(simulation.simulate_batch(scenarios, LOOP, period=PERIOD, threads=threads))


def test_a_run_is_the_same_to_the_bit_alone_and_among_others_in_any_order_on_any_threads() -> None:
    scenarios = mixed()
    alone = np.concatenate([fly([one]) for one in scenarios])
    assert len(np.unique(alone, axis=0)) == len(alone)  # they do differ
    np.testing.assert_array_equal(fly(scenarios), alone)
    order = np.random.default_rng(0).permutation(len(scenarios))
    np.testing.assert_array_equal(fly([scenarios[k] for k in order], threads=3), alone[order])
    same = [dataclasses.replace(scenarios[k % 3], run=k) for k in range(19)]
    np.testing.assert_array_equal(fly(same, threads=2), np.concatenate([fly([one]) for one in same]))


def test_figures_are_those_of_the_recorded_run() -> None:
    scenarios = mixed()
    for one, row in zip(scenarios, fly(scenarios), strict=True):
        out = simulation.simulate(one, LOOP, period=PERIOD)
        np.testing.assert_array_equal(row[:2], np.abs(out.q).max(axis=0))
        np.testing.assert_allclose(row[2:5], np.abs(out.attitude_angles).max(axis=0), rtol=1e-14, atol=1e-18)
        limit = one.platform.torquers[0].limit
        assert row[5] == np.abs(out.command / limit).max()
        assert row[6] == out.saturated[0] == np.sum(np.abs(out.command) >= limit)
        np.testing.assert_array_equal(row[7:9], out.stop_contacts)
        assert row[9] == row[10] == len(out.t)


@pytest.mark.parametrize("place", [0, 3, 7])
def test_a_run_that_diverges_is_told_and_leaves_those_beside_it_alone(place: int) -> None:
    sound = mixed()[7:14]
    sound = [dataclasses.replace(one, mode="caged", delay=0.0, duration=0.1) for one in sound]
    light = dataclasses.replace(sound[0].platform.gimbals[1], inertia=1e-9 * np.eye(3))
    gimbals = (sound[0].platform.gimbals[0], light)
    lost = dataclasses.replace(sound[0], platform=dataclasses.replace(sound[0].platform, gimbals=gimbals))
    together = simulation.simulate_batch([*sound[:place], lost, *sound[place:]], LOOP, period=PERIOD)
    assert together.completed.tolist() == [k != place for k in range(8)]
    recorded = simulation.simulate(lost, LOOP, period=PERIOD)
    assert together.ended[place] == recorded.ended
    assert together.ended[place].startswith("diverged at t = 0.00")
    np.testing.assert_array_equal(rows(together)[place], fly([lost])[0])
    np.testing.assert_array_equal(np.delete(rows(together), place, axis=0), fly(sound))


# What is refused.


def test_no_scenarios_have_no_figures() -> None:
    none = simulation.simulate_batch([], [], period=PERIOD)
    assert (none.angle.shape, none.attitude.shape, none.samples.shape, none.ended) == ((0, 0), (0, 3), (0,), ())


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"duration": 1e6}, "duration: 1e+06 s are 1e+09 periods, more than the 1e+08 that a run may have"),
        ({"duration": 1e300}, "duration: 1e+300 s are"),
        ({"delay": 1.01}, "delay: 1.01 s are 1.01e+03 periods, more than the 1e+03 that a run may have"),
        ({"duration": np.inf}, "duration must be a finite number >= 0, got inf"),
        ({"duration": -1.0}, "duration must be a finite number >= 0, got -1.0"),
    ],
)
def test_absurd_sizes_are_refused(changed: dict[str, float], message: str) -> None:
    one = scenario(plant(), **changed)
    with pytest.raises(ArgumentError, match=f"^{re.escape(message)}"):
        simulation.simulate_batch([one], [gain()], period=PERIOD)
    with pytest.raises(ArgumentError, match=f"^{re.escape(message)}"):
        simulation.simulate(one, [gain()], period=PERIOD)


def test_plants_of_different_parts_are_refused_together() -> None:
    other = plant()
    moved = dataclasses.replace(other, torquers=(dataclasses.replace(other.torquers[0], gimbal="s"),))
    fewer = dataclasses.replace(other, rate_sensors=())
    for different in (moved, fewer):
        with pytest.raises(ArgumentError, match=r"^scenarios: their plants differ in gimbals, torquers or sensors"):
            simulation.simulate_batch([scenario(other), scenario(different)], [gain()], period=PERIOD)
