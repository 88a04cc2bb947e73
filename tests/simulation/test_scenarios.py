"""Runs of a whole platform: with others that have little in common, and small ones beside the linear sampled loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache

import control
import numpy as np
import pytest
from scipy.linalg import expm

import platform_ctrl as pc
from platform_ctrl import simulation
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.scenario import HalfCosine, Scenario, TimeTable, Vibration
from platform_ctrl.plant.platform import Platform
from platform_ctrl.simulation.batch import BatchResult

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
    torquers = tuple(dataclasses.replace(t, limit=(1e-3, None)[k % 2], lag=2e-4 * (k % 3 > 0)) for t in plant.torquers)
    return dataclasses.replace(plant, gimbals=gimbals, rotors=rotors, torquers=torquers)


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


def together(runs: Sequence[Scenario], threads: int = 1, controllers: Sequence[control.StateSpace] = ()) -> BatchResult:
    return simulation.simulate_batch(runs, controllers or [caging(model())], period=PERIOD, step=STEP, threads=threads)


def rows(figures: BatchResult) -> np.ndarray:
    names = ("angle", "attitude", "torque_share", "saturated", "stop_contacts", "samples", "requested")
    return np.column_stack([getattr(figures, name) for name in names])


def test_a_run_is_the_same_to_the_bit_alone_and_among_others_of_any_kind() -> None:
    runs = motley()
    among = rows(together(runs))
    np.testing.assert_array_equal(among, np.concatenate([rows(together([run])) for run in runs]))
    assert len(np.unique(among, axis=0)) == len(runs)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_neither_order_nor_threads_nor_number_of_runs_change_a_run(threads: int) -> None:
    runs = motley()
    expected = rows(together(runs))
    order = np.random.default_rng(threads).permutation(len(runs))[: 30 - 3 * threads]
    np.testing.assert_array_equal(rows(together([runs[k] for k in order], threads)), expected[order])


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


def linear_loop(
    platform: Platform, root: str, controllers: Sequence[control.StateSpace], run: Scenario
) -> tuple[np.ndarray, np.ndarray]:
    """Angles (and Omega) and torques at the samples from matrix exponentials of the linear plant, delay and lag."""
    plant = pc.state_space(pc.linearise(platform), root=root)  # type: ignore[arg-type]
    torquers = [t for t in platform.torquers if t.name in plant.input_labels]
    names = [t.name for t in torquers]
    A, C = np.asarray(plant.A), np.asarray(plant.C)
    B = np.asarray(plant.B)[:, [plant.input_labels.index(name) for name in names]]
    lag = np.array([t.lag for t in torquers])
    nx, nu = len(A), len(names)
    whole = np.block(
        [
            [A, B, np.zeros((nx, nu))],
            [np.zeros((nu, nx)), -np.diag(1.0 / lag), np.diag(1.0 / lag)],
            [np.zeros((nu, nx + 2 * nu))],
        ]
    )
    periods = int(run.delay / PERIOD + 1e-9)
    first = run.delay - periods * PERIOD
    before, after = expm(whole * first), expm(whole * (PERIOD - first))
    # The plant's states at the start from what it puts out and how fast that changes.
    start = np.linalg.lstsq(
        np.vstack([C, (C @ A)[: len(run.q)]]),
        np.concatenate([run.q, run.Omega[: len(C) - len(run.q)], run.rate]),
        rcond=None,
    )[0]
    x, commands = np.concatenate([start, np.zeros(2 * nu)]), []
    states = [np.zeros(K.nstates) for K in controllers]
    angles, torques = [], []
    for k in range(1 + round(run.duration / PERIOD)):
        y = dict(zip(plant.output_labels, C @ x[:nx], strict=True))
        command = dict.fromkeys(names, 0.0)
        for i, K in enumerate(controllers):
            inputs = np.array([y[name] for name in K.input_labels])
            command |= dict(zip(K.output_labels, K.C @ states[i] + K.D @ inputs, strict=True))
            states[i] = K.A @ states[i] + K.B @ inputs
        commands.append([command[name] for name in names])
        angles.append(C @ x[:nx])
        torques.append(x[nx : nx + nu].copy())
        for advance, source in ((before, k - periods - 1), (after, k - periods)):
            x[nx + nu :] = commands[source] if source >= 0 else 0.0
            x = advance @ x
    return np.array(angles), np.array(torques)


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 2.3])
@pytest.mark.parametrize("mode", ["caged", "stabilised"])
def test_small_signals_move_as_in_the_linear_sampled_loop(mode: str, delay: float) -> None:
    platform = dataclasses.replace(
        model(), pickoffs=tuple(dataclasses.replace(p, noise_rms=0.0) for p in model().pickoffs)
    )
    rng, size = np.random.default_rng(3), 1e-8
    run = Scenario(
        platform=platform,
        mode=mode,  # type: ignore[arg-type]
        duration=0.1,
        delay=delay * PERIOD,
        q=size * rng.normal(size=5),
        rate=100.0 * size * rng.normal(size=5),
        Omega=size * rng.normal(size=3) * (mode == "stabilised"),
    )
    controllers = [caging(platform)]
    out = simulation.simulate(run, controllers, period=PERIOD, step=STEP / 2)
    free = mode == "stabilised"
    angles, torques = linear_loop(platform, "free" if free else "prescribed", controllers, run)
    ours = np.hstack([out.q, out.Omega]) if free else out.q
    for k in range(ours.shape[1]):
        np.testing.assert_allclose(ours[:, k], angles[:, k], rtol=0, atol=1e-6 * np.abs(angles[:, k]).max())
    used = [name for name in out.torquer_names if name in caging(platform).output_labels]
    for name in used:
        k, scale = out.torquer_names.index(name), np.abs(torques).max()
        np.testing.assert_allclose(out.torque[:, k], torques[:, used.index(name)], rtol=0, atol=1e-6 * scale)
