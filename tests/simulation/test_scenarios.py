"""Many runs at once, which have little in common: each is what it is alone, to the last bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

import control
import numpy as np
import pytest

import platform_ctrl as pc
from plant_parts import Cage, Erection, Friction, Spring, Unbalance
from platform_ctrl import Platform, simulation
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation import Fault, HalfCosine, Scenario, Sine, TimeTable, Vibration

PERIOD, STEP = 5e-4, 1e-4


@cache
def model(name: str = "three_gyro_platform") -> Platform:
    return pc.read_platform(name)


def caging(platform: Platform, size: float = 1.0) -> control.StateSpace:
    """A controller with states from every angle to every torque of the gimbals, of small gains."""
    angles, torques = platform.angle_names, [t.name for t in platform.torquers if t.gimbal is not None]
    n, rng = len(angles), np.random.default_rng(5)
    A = 0.8 * np.eye(n) + 0.02 * rng.standard_normal((n, n))
    B, C = 0.1 * rng.standard_normal((n, n)), 0.5 * size * rng.standard_normal((n, n))
    D = -size * np.eye(n)
    return control.ss(A, B, C, D, PERIOD, inputs=list(angles), outputs=torques, name="K")


def fault(kind: str, part: str | None, at: float = 0.003, **numbers: float) -> Fault:
    return Fault(name=kind, kind=kind, part=part, at=at, **numbers)  # type: ignore[arg-type]


TABLE = TimeTable(t=np.array([0.0, 0.004, 0.01]), values=0.1 * np.eye(3), smooth=True)
SHAKE = {"axis": 2, "frequencies_hz": np.array([5.0, 300.0]), "densities": np.array([1e-3, 1e-4]), "lines": 12}


def varied(k: int) -> Platform:
    """A three-gyro platform of its own: inertias, momenta, limits; stops in every other one, lags in most."""
    plant, rng = model(), np.random.default_rng(k)
    gimbals = tuple(
        dataclasses.replace(
            g, inertia=g.inertia * rng.uniform(0.9, 1.1), stops=(-0.004, 0.004) if k % 2 else None, restitution=0.3
        )
        for g in plant.gimbals
    )
    rotors = tuple(
        dataclasses.replace(r, angular_momentum=r.angular_momentum * rng.uniform(0.9, 1.1)) for r in plant.rotors
    )
    torquers = tuple(
        dataclasses.replace(
            t, limit=(1e-3, None)[k % 2], lag=2e-4 * (k % 3 > 0), rate_limit=5.0 if k % 5 == 2 else None
        )
        for t in plant.torquers
    )
    pickoffs = tuple(dataclasses.replace(p, quantisation=1e-6 * (k % 4)) for p in plant.pickoffs)
    first, last = gimbals[0].name, gimbals[-1].name
    return dataclasses.replace(
        plant,
        gimbals=gimbals,
        rotors=rotors,
        torquers=torquers,
        pickoffs=pickoffs,
        springs=(Spring(gimbal=last, stiffness=0.01 * rng.uniform(), rest=0.02),),
        frictions=(Friction(gimbal=last, viscous=1e-5 * rng.uniform(), coulomb=(1e-5, 2e-5), coulomb_rate=0.1),),
        cages=(Cage(gimbal=first, stiffness=0.3, damping=1e-4 * rng.uniform(), clearance=0.001),),
        unbalances=(Unbalance(body=last, moment=1e-6 * rng.normal(size=3)),),
        erections=(Erection(gimbal=first, senses=last, axis=np.array([0.6, 0.8, 0.0]), gain=1e-3 * rng.uniform()),),
        specific_force=rng.normal(size=3),
    )


@cache
def motley() -> tuple[Scenario, ...]:
    """Scenarios that have little in common, faults of every kind among them."""
    faults = (
        fault("rotor run-down", "6", time_constant=0.01),
        fault("rotor run-up", "11", time_constant=0.01, share=0.5),
        fault("speed ripple", "8", amplitude=0.01, frequency_hz=100.0),
        fault("torquer dead", "Q4"),
        fault("torquer stuck", "Q5"),
        fault("torquer weak", "Q9", share=0.3),
        fault("pick-off dead", "alpha4"),
        fault("pick-off stuck", "beta5"),
        fault("pick-off drift", "alpha9", rate=0.1),
        fault("pick-off dropout", "beta10", probability=0.5),
        fault("controller overrun", None, probability=0.5),
        fault("stop contact", "4", impulse=1e-4),
    )
    out = []
    for k in range(30):
        rng, caged = np.random.default_rng(100 + k), k % 4 > 0
        moved: dict[str, object] = {"Omega": rng.normal(size=3) * 0.01, "torque": rng.normal(size=3) * 0.01}
        if caged:
            moved = {"profile": HalfCosine(axis=1 + k % 3, rate=0.2, rise=0.003, hold=0.001)}
        if k % 5 == 1:
            moved["Omega_table" if caged else "torque_table"] = dataclasses.replace(TABLE, scale=1.0 + k)
        if k % 7 == 2:
            moved["sines"] = (Sine(kind="force", axis=1, frequency_hz=20.0 + k, amplitude=0.3),)
            moved["vibrations"] = (Vibration(kind="rate" if caged else "force", **SHAKE),)  # type: ignore[arg-type]
        out.append(
            Scenario(
                platform=varied(k),
                mode="caged" if caged else "stabilised",
                duration=(0.01, 0.02)[k % 6 == 0],
                delay=(0.0, 0.3, 1.0, 2.7)[k % 8 // 2] * PERIOD,
                faults=tuple(one for j, one in enumerate(faults) if (j + k) % 4 == 0),
                q=rng.normal(size=5) * 1e-3,
                rate=rng.normal(size=5) * 0.1,
                seed=k % 3,
                run=k,
                **moved,  # type: ignore[arg-type]
            )
        )
    return tuple(out)


def together(runs: Sequence[Scenario], threads: int = 1) -> Any:
    return simulation.simulate_batch(runs, [caging(model())], period=PERIOD, step=STEP, threads=threads)


def rows(figures: Any) -> np.ndarray:
    names = ("angle", "attitude", "torque_share", "saturated", "stop_contacts", "samples", "requested")
    return np.column_stack([getattr(figures, name) for name in names])


def test_a_run_is_the_same_to_the_bit_alone_and_among_others_in_any_order_on_any_threads() -> None:
    runs = motley()
    alone = np.concatenate([rows(together([run])) for run in runs])
    assert len(np.unique(alone, axis=0)) == len(runs)
    np.testing.assert_array_equal(rows(together(runs)), alone)
    for threads in (2, 3):
        order = np.random.default_rng(threads).permutation(len(runs))[: 30 - 3 * threads]
        np.testing.assert_array_equal(rows(together([runs[k] for k in order], threads)), alone[order])


def test_figures_are_those_of_the_recorded_run() -> None:
    for one, row in zip(motley(), rows(together(motley())), strict=True):
        out = simulation.simulate(one, [caging(model())], period=PERIOD, step=STEP)
        limits = np.array([np.inf if t.limit is None else t.limit for t in one.platform.torquers])
        np.testing.assert_array_equal(row[:5], np.abs(out.q).max(axis=0))
        np.testing.assert_allclose(row[5:8], np.abs(out.attitude_angles).max(axis=0), rtol=1e-14, atol=1e-18)
        share = np.abs(out.command / limits).max(axis=0)
        over = np.sum(np.abs(out.command) >= limits, axis=0)
        n = len(limits)
        np.testing.assert_array_equal(row[8 : 8 + n], share)
        np.testing.assert_array_equal(row[8 + n : 8 + 2 * n], over)
        np.testing.assert_array_equal(out.saturated, over)
        np.testing.assert_array_equal(row[8 + 2 * n : 13 + 2 * n], out.stop_contacts)
        assert row[-2] == row[-1] == len(out.t)


def test_a_run_that_diverges_is_told_and_leaves_those_beside_it_alone() -> None:
    sound = [dataclasses.replace(one, mode="caged", delay=0.0, duration=0.02) for one in motley()[1:4]]
    falling = tuple(Spring(gimbal=name, stiffness=-1e4) for name in model().gimbal_names)
    lost = dataclasses.replace(sound[0], platform=dataclasses.replace(varied(2), springs=falling))
    expected = rows(together(sound))
    for place in (0, 2, 3):
        result = together([*sound[:place], lost, *sound[place:]])
        recorded = simulation.simulate(lost, [caging(model())], period=PERIOD, step=STEP)
        assert result.ended[place] == recorded.ended
        assert recorded.ended.startswith("diverged at t = 0.0")
        np.testing.assert_array_equal(np.delete(rows(result), place, axis=0), expected)


def test_plants_of_different_parts_are_refused_together() -> None:
    one = motley()[0]
    moved = dataclasses.replace(model().torquers[0], gimbal="5")
    for other in ({"torquers": (moved, *model().torquers[1:])}, {"pickoffs": model().pickoffs[1:]}):
        different = dataclasses.replace(one, platform=dataclasses.replace(one.platform, **other))
        with pytest.raises(ArgumentError, match=r"^scenarios: their plants differ in gimbals, torquers or sensors"):
            simulation.simulate_batch([one, different], [], period=PERIOD)


def other_wiring() -> list[Scenario]:
    """Plants of the same gimbals, torquers and sensors; rotors and erections sit elsewhere, or are not there."""
    horizon = model("gyro_horizon")
    outer, inner = horizon.erections
    [rotor] = horizon.rotors
    fails = (fault("rotor run-down", "rotor", time_constant=0.01),)
    servo = {"control": "servo", "speed_gain": 1e-3, "speed_integral": 1e-3}
    plants: list[tuple[dict[str, object], tuple[Fault, ...]]] = [
        ({}, fails),
        ({"erections": (inner, outer)}, fails),
        ({"erections": (outer,)}, fails),
        ({"erections": (inner,)}, fails),
        ({"rotors": (dataclasses.replace(rotor, carrier="outer"),)}, fails),
        ({"rotors": (dataclasses.replace(rotor, control="free"),)}, fails),
        ({"rotors": (dataclasses.replace(rotor, **servo),)}, fails),  # type: ignore[arg-type]
        ({"rotors": (dataclasses.replace(rotor, carrier="outer", **servo),)}, fails),  # type: ignore[arg-type]
        ({"rotors": (dataclasses.replace(rotor, name="another"),)}, ()),
        ({"rotors": ()}, ()),
    ]
    return [
        Scenario(
            platform=dataclasses.replace(horizon, **changes),  # type: ignore[arg-type]
            mode=mode,
            duration=0.02,
            delay=0.0,
            faults=faults,
            q=np.array([0.02, -0.03]),
            rate=np.array([0.1, 0.2]),
        )
        for changes, faults in plants
        for mode in ("caged", "stabilised")
    ]


def test_plants_whose_rotors_and_erections_sit_elsewhere_do_not_get_mixed_up() -> None:
    runs = other_wiring()
    among = rows(simulation.simulate_batch(runs, [], period=PERIOD, step=STEP))
    alone = np.concatenate([rows(simulation.simulate_batch([run], [], period=PERIOD, step=STEP)) for run in runs])
    np.testing.assert_array_equal(among, alone)
