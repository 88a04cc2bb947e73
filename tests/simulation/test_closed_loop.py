"""The sampled closed loop: timing, limits, lag, stops, noise, and what it refuses."""

from __future__ import annotations

import itertools

import control
import numpy as np
import pytest

from plant_parts import PickOff, Torquer
from platform_ctrl import Platform
from platform_ctrl.errors import ArgumentError
from single_runs import simulated
from small_trees import tree

J, L, C = 2e-3, 0.15, 1.2e-4
PERIOD = 1e-3


def one_gimbal(inertia=J, root_inertia=1.0, stops=None, noise=0.0, quantisation=0.0, **torquer) -> Platform:
    """A gimbal without a rotor: with the root held, a double integrator."""
    return tree(
        root_inertia,
        [("g", "case", 3, inertia, "alpha", {"stops": stops})],
        base="case",
        torquers=(Torquer(name="Qg", gimbal="g", **torquer), Torquer(name="M1", root_axis=1)),
        pickoffs=(PickOff(name="alpha", gimbal="g", noise_rms=noise, quantisation=quantisation),),
    )


def controller(D=None, inputs="alpha", outputs="Qg", A=(), B=(), C=(), dt=PERIOD) -> control.StateSpace:
    order = len(A)
    D = np.atleast_2d(D)
    return control.ss(
        np.reshape(A, (order, order)),
        np.reshape(B, (order, D.shape[1])),
        np.reshape(C, (D.shape[0], order)),
        D,
        dt,
        inputs=inputs,
        outputs=outputs,
        name="K",
    )


def run(platform, controllers=(), *, mode="caged", period=PERIOD, delay=PERIOD, duration=0.1, **more):
    return simulated(platform, controllers, period=period, delay=delay, duration=duration, mode=mode, **more)


def held(t0, t1, changes, torque):
    """What a double integrator gains between two instants while torques switch at given instants."""
    grid = [t0, *[t for t in changes if t0 < t < t1], t1]
    return [(b - a, torque(0.5 * (a + b)) / J) for a, b in itertools.pairwise(grid)]


@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0, 1.37, 2.0, 2.75])
def test_commands_take_effect_exactly_after_the_delay(delay):
    gain = -0.4 * J / PERIOD  # unstable or not, the recursion holds
    out = run(one_gimbal(), [controller(gain)], delay=delay * PERIOD, duration=0.02, q=[0.01], rate=[0.3])

    samples = 21
    instants = [(k + delay) * PERIOD for k in range(samples)]
    commands: list[float] = []

    def torque(t):
        active = [c for c, instant in zip(commands, instants, strict=False) if instant <= t]
        return active[-1] if active else 0.0

    angle, rate, expected = 0.01, 0.3, []
    for k in range(samples):
        expected.append((angle, rate))
        commands.append(gain * angle)
        for length, acceleration in held(k * PERIOD, (k + 1) * PERIOD, instants, torque):
            angle += length * rate + 0.5 * length**2 * acceleration
            rate += length * acceleration
    assert out.completed
    assert out.t == pytest.approx(PERIOD * np.arange(samples))
    assert np.column_stack([out.q, out.rate]) == pytest.approx(np.array(expected), rel=1e-11, abs=1e-13)
    assert out.p == pytest.approx(J * out.rate)
    assert out.command[:, 0] == pytest.approx(np.array(commands), rel=1e-11)


def test_controllers_are_evaluated_in_their_order_and_see_this_steps_outputs():
    pid = controller([[3.0], [2.0]], outputs=["Qg", "integrand"], A=[[0.3]], B=[[1.0]], C=[[0.5], [1.0]])
    integral = controller(0.25, inputs="integrand", outputs="M1", A=[[1.0]], B=[[PERIOD]], C=[[7.0]])
    out = run(one_gimbal(root_inertia=1e3, noise=1e-3), [pid, integral], mode="stabilised", q=[0.01], seed=3)
    x = z = 0.0
    for reading, command in zip(out.reading[:, 0], out.command, strict=True):
        integrand = x + 2.0 * reading
        assert command == pytest.approx([0.5 * x + 3.0 * reading, 7.0 * z + 0.25 * integrand], rel=1e-9, abs=1e-15)
        x, z = 0.3 * x + reading, z + PERIOD * integrand


def test_a_run_that_diverges_ends_early_and_says_when():
    out = run(one_gimbal(), [controller(50.0)], q=[1e-3], duration=5.0)
    assert not out.completed
    assert out.ended == f"diverged at t = {len(out.t) * PERIOD:.6g} s"
    assert 0 < len(out.t) < 5000
    assert all(np.isfinite(getattr(out, name)).all() for name in ("q", "rate", "p", "command", "torque", "attitude"))


def test_an_unstable_controller_ends_the_run_before_its_numbers_overflow():
    # Two states that one output does not tell apart: its limit holds one of them.
    growing = controller(0.0, A=np.diag([1e30, 1e29]), B=[[1.0], [1.0]], C=[[1.0, 1.0]])
    out = run(one_gimbal(limit=1e-9), [growing], q=[1e-3])
    assert out.ended.startswith("diverged at t = ")
    assert np.isfinite(out.command).all()


@pytest.mark.parametrize(
    ("bad", "complaint"),
    [
        ([controller(1.0, dt=0.0015)], "dt must be the sample period 0.001 s or a whole number of them, got 0.0015"),
        ([controller(1.0, dt=0)], "dt must be the sample period 0.001 s or a whole number of them, got 0"),
        ([controller(1.0, dt=True)], "without a sample period"),
        ([controller(np.nan)], "not finite"),
        ([controller(1.0, inputs="beta")], "input 'beta' is neither a pick-off nor"),
        ([controller(1.0, inputs="Qg", outputs="later"), controller(1.0)], "input 'Qg' is neither"),
        ([controller(1.0, outputs="Qh")], "output 'Qh' is neither a torquer nor"),
        ([controller(1.0), controller(1.0)], "output 'Qg' exists already"),
    ],
)
def test_controllers_that_do_not_fit_are_refused(bad, complaint):
    with pytest.raises(ArgumentError, match=complaint):
        run(one_gimbal(), bad)


def test_where_omega_is_prescribed_controllers_that_act_on_the_root_are_left_out():
    caging, stabilisation = controller(-1.0), controller(1.0, outputs="M1")
    with_both = run(one_gimbal(), [caging, stabilisation], q=[0.01])
    assert np.array_equal(with_both.q, run(one_gimbal(), [caging], q=[0.01]).q)
    assert not with_both.command[:, 1].any()
