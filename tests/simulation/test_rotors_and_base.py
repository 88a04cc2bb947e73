"""What moves a plant besides its torquers: rotors that do not keep their speed, and the base that turns and shakes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import platform_ctrl as pc
from plant_parts import Unbalance
from platform_ctrl import Platform, simulation
from platform_ctrl.simulation import Fault, HalfCosine, Scenario, TimeTable, Vibration
from small_trees import tree

# Momenta change evenly during a step: what comes out is within the square of the step.
PERIOD = 1e-3
END = 0.1

GYRO = tree(
    [[0.010, 0.001, 0.0], [0.001, 0.012, 0.0], [0.0, 0.0, 0.011]],
    [("outer", "case", 3, [4e-4, 5e-4, 3e-4]), ("inner", "outer", 1, [2e-4, 3e-4, 3e-4])],
    [("R", "inner", [0, 0.6, 0.8], 1.2e-4, 0.7e-4, 1.2e-4 * 300.0)],
    base="case",
)
PENDULUM = tree(
    1.0, [("g", "base", 2, [1e-3, 2e-3, 1e-3])], unbalances=(Unbalance(body="g", moment=np.array([1e-3, 0.0, 0.0])),)
)
BLOCK = tree([2.0, 3.0, 4.0])

START = {"q": np.array([0.3, -0.2]), "rate": np.array([0.5, -1.0])}
RATE = np.array([0.2, -0.3, 0.4])

# How much of L is there, and how fast that changes.
Course = tuple[Callable[[float], float], Callable[[float], float]]
AT, TAU, SHARE = 0.02, 0.03, 0.4


def falling(t: float) -> float:
    return math.exp(-(t - AT) / TAU)


COURSES: dict[str, tuple[Fault, Course]] = {
    "run-down": (
        Fault(name="f", kind="rotor run-down", part="R", at=AT, time_constant=TAU, share=SHARE),
        (
            lambda t: 1.0 if t < AT else SHARE + (1.0 - SHARE) * falling(t),
            lambda t: 0.0 if t < AT else -(1.0 - SHARE) / TAU * falling(t),
        ),
    ),
    "run-up": (
        Fault(name="f", kind="rotor run-up", part="R", at=AT, time_constant=TAU, share=SHARE),
        (
            lambda t: SHARE if t < AT else 1.0 - (1.0 - SHARE) * falling(t),
            lambda t: 0.0 if t < AT else (1.0 - SHARE) / TAU * falling(t),
        ),
    ),
    "ripple": (
        Fault(name="f", kind="speed ripple", part="R", at=AT, until=0.08, amplitude=0.2, frequency_hz=50.0),
        (
            lambda t: 1.0 + 0.2 * math.sin(100.0 * math.pi * (t - AT)) * (AT <= t < 0.08),
            lambda t: 20.0 * math.pi * math.cos(100.0 * math.pi * (t - AT)) * (AT <= t < 0.08),
        ),
    ),
}


def with_momentum(platform: Platform, factor: float, control: str) -> Platform:
    rotors = tuple(
        dataclasses.replace(r, control=control, angular_momentum=r.angular_momentum * factor) for r in platform.rotors
    )
    return dataclasses.replace(platform, rotors=rotors)


def in_pieces(slope: Callable[[float, np.ndarray], np.ndarray], y: np.ndarray) -> np.ndarray:
    """Integrate from corner to corner of the courses."""
    for begin, end in ((0.0, AT), (AT, 0.08), (0.08, END)):
        # An instant inside: at the corners themselves a course belongs to the other side.
        inside = lambda t, y, begin=begin, end=end: slope(min(max(t, begin + 1e-12), end - 1e-12), y)  # noqa: E731
        y = solve_ivp(inside, (begin, end), y, method="DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
    return y


@pytest.mark.parametrize(("kind", "control"), [("ripple", "regulated"), ("run-up", "free")])
def test_a_rotor_that_changes_speed_turns_a_free_platform_by_its_reaction(kind: str, control: str) -> None:
    fault, (share, slope_of_share) = COURSES[kind]
    platform = with_momentum(GYRO, 1.0, control)
    L = platform.rotors[0].angular_momentum

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:2], y[2:]
        now = with_momentum(GYRO, share(t), control)
        reaction = -pc.matrices(now, q, v).B[0] * L * slope_of_share(t)
        return np.concatenate([v[3:], pc.forward_dynamics(now, q, v, reaction)])

    expected = in_pieces(slope, np.concatenate([START["q"], RATE, START["rate"]]))
    scenario = Scenario(
        platform=platform, mode="stabilised", duration=END, delay=0.0, faults=(fault,), Omega=RATE, **START
    )
    out = simulation.simulate(scenario, [], period=PERIOD, step=2.5e-5)
    np.testing.assert_allclose(out.q[-1], expected[:2], rtol=0, atol=2e-6)
    np.testing.assert_allclose(np.concatenate([out.Omega[-1], out.rate[-1]]), expected[2:], rtol=0, atol=2e-5)


def test_a_rotor_that_changes_speed_turns_gimbals_on_a_base_that_is_turned() -> None:
    fault, (share, slope_of_share) = COURSES["run-down"]
    table = TimeTable(
        t=np.array([0.0, 0.05, END]), values=np.array([[0, 0, 0], [1.0, -2.0, 0.5], [0.3, 0.1, 2.0]]), smooth=True
    )
    ahead = 1e-6

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        q, rate = y[:2], y[2:]
        Omega, turned = table.at(t), (table.at(t + ahead) - table.at(t - ahead)) / (2.0 * ahead)
        v = np.concatenate([Omega, rate])
        now = with_momentum(GYRO, share(t), "regulated")
        held = pc.inverse_dynamics(now, q, v, np.concatenate([turned, [0.0, 0.0]]))[3:]
        m = pc.matrices(now, q, v)
        reaction = m.B[0, 3:] * GYRO.rotors[0].angular_momentum * slope_of_share(t)
        return np.concatenate([rate, np.linalg.solve(m.A_star[3:, 3:], -held - reaction)])

    expected = in_pieces(slope, np.concatenate([START["q"], START["rate"]]))
    scenario = Scenario(
        platform=GYRO, mode="caged", duration=END, delay=0.0, Omega_table=table, faults=(fault,), **START
    )
    out = simulation.simulate(scenario, [], period=PERIOD, step=2.5e-5)
    np.testing.assert_allclose(out.q[-1], expected[:2], rtol=0, atol=2e-6)
    np.testing.assert_allclose(out.rate[-1], expected[2:], rtol=0, atol=5e-5)


def test_a_servo_rotor_that_runs_down_follows_its_falling_set_point() -> None:
    # About e_y, which neither joint turns: the carriers do not feel the motor.
    rotor = dataclasses.replace(GYRO.rotors[0], control="servo", speed_gain=0.01, axis=np.array([0.0, 1.0, 0.0]))
    platform = dataclasses.replace(GYRO, rotors=(rotor,))
    fault = Fault(name="f", kind="rotor run-down", part="R", at=0.0, time_constant=0.2, share=0.5)
    out = simulation.simulate(
        Scenario(platform=platform, mode="caged", duration=0.5, delay=0.0, faults=(fault,)), [], period=PERIOD
    )
    lag = rotor.axial_inertia / rotor.speed_gain
    falling, catching_up = np.exp(-out.t / 0.2), np.exp(-out.t / lag)
    expected = 150.0 + 150.0 * (falling - lag / 0.2 * catching_up) / (1.0 - lag / 0.2)
    np.testing.assert_allclose(out.rotor_spin[:, 0], expected, rtol=5e-7)


def test_the_base_turns_as_the_table_says_and_stays_at_its_ends() -> None:
    t = np.array([0.01, 0.03, 0.07, 0.08])
    values = np.random.default_rng(1).normal(size=(4, 3))
    for smooth in (False, True):
        for scale in (1.0, -0.5):
            table = TimeTable(t=t, values=values, smooth=smooth, scale=scale)
            profile = HalfCosine(axis=2, rate=0.3, rise=0.02, hold=0.01)
            scenario = Scenario(
                platform=GYRO, mode="caged", duration=END, delay=0.0, Omega_table=table, profile=profile
            )
            out = simulation.simulate(scenario, [], period=PERIOD)
            risen = np.clip(np.minimum(out.t, 0.05 - out.t) / 0.02, 0.0, 1.0)
            expected = table.at(out.t)
            expected[:, 1] += 0.3 * (0.5 - 0.5 * np.cos(np.pi * risen))
            np.testing.assert_allclose(out.Omega, expected, rtol=0, atol=2e-14)


def test_a_torque_table_turns_a_body_by_its_integral() -> None:
    table = TimeTable(t=np.array([0.0, 0.04, 0.1]), values=np.array([[0, 0, 0], [2.0, 0, 0], [-1.0, 0, 0]]))
    scenario = Scenario(
        platform=BLOCK, mode="stabilised", duration=END, delay=0.0, torque=np.array([0.5, 0, 0]), torque_table=table
    )
    out = simulation.simulate(scenario, [], period=PERIOD)
    # Trapezia, over the inertia of 2 kg m².
    assert out.Omega[-1, 0] == pytest.approx((0.04 + 0.03 + 0.05) / 2.0, abs=1e-12)
    assert out.Omega[40, 0] == pytest.approx((0.04 + 0.02) / 2.0, abs=1e-12)
    np.testing.assert_allclose(out.Omega[:, 1:], 0.0, atol=1e-15)


SHAKE = Vibration(
    kind="rate", axis=2, frequencies_hz=np.array([10.0, 40.0, 200.0]), densities=np.array([1e-4, 1e-3, 1e-5]), lines=24
)


def shaken(seed: int = 3, run: int = 5, **changes: object) -> Scenario:
    vibration = dataclasses.replace(SHAKE, **changes)
    return Scenario(
        platform=PENDULUM, mode="caged", duration=0.5, delay=0.0, vibrations=(vibration,), seed=seed, run=run
    )


def test_vibration_has_the_lines_of_its_density_and_only_these() -> None:
    out = simulation.simulate(shaken(), [], period=PERIOD)
    omega, amplitude = SHAKE.amplitudes
    waves = np.concatenate([np.cos(np.outer(out.t, omega)), np.sin(np.outer(out.t, omega))], axis=1)
    found, residual, *_ = np.linalg.lstsq(waves, out.Omega[:, 1], rcond=None)
    assert residual.sum() < 1e-20
    np.testing.assert_allclose(np.hypot(*found.reshape(2, -1)), amplitude, rtol=1e-7)
    phases = np.arctan2(*found.reshape(2, -1))
    assert np.ptp(phases) > 3.0
    # The mean square is the integral of the density.
    f = np.geomspace(10.0, 200.0, 20001)
    density = np.exp(np.interp(np.log(f), np.log(SHAKE.frequencies_hz), np.log(SHAKE.densities)))
    assert 0.5 * np.sum(amplitude**2) == pytest.approx(np.trapezoid(density, f), rel=0.03)
