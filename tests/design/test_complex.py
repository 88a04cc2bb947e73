"""Complex coordinates of a symmetric gyro: the same loop as the real one, at positive and at negative frequencies."""

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl import analysis
from platform_ctrl.analysis.poles import continuous_poles, is_stable
from platform_ctrl.design.cases import changed
from platform_ctrl.design.classical.complex_coordinates import complex_plant, complex_response
from platform_ctrl.design.classical.complex_shaping import complex_loop, two_sided_nyquist
from platform_ctrl.errors import ArgumentError, NotStabilisableError

PERIOD, DELAY, LAG = 5e-4, 3e-4, 2e-4
L, J = 0.15, 5e-4
LOOP = {"crossover_hz": 30.0, "integral_hz": 2.0, "damping_hz": 45.0, "lead_hz": 7.0, "rolloff_hz": 900.0}
PAIR = ("9", "10")


@pytest.fixture(scope="module")
def model():
    """The gyro 9-10 with the inertia of its inner gimbal raised to that of the outer one."""
    return pc.linearise(changed(pc.read_platform("three_gyro_platform"), {"10": 1.5}, {}))


@pytest.fixture(scope="module")
def gyro(model):
    return pc.state_space(model, gimbals=PAIR)[["alpha9", "beta10"], ["Q9", "Q10"]]


@pytest.fixture(scope="module")
def sampled_plant(model):
    return complex_plant(model, PAIR, period=PERIOD, delay=DELAY)


@pytest.fixture(scope="module")
def loop(sampled_plant):
    return complex_loop(sampled_plant, **LOOP)


W = np.concatenate([-np.geomspace(6000.0, 1.0, 40), np.geomspace(1.0, 6000.0, 40)])


def test_the_plant_is_one_over_J_s_squared_less_i_L_s(model):
    plant = complex_plant(model, PAIR, delay=1e-3)
    s = 1j * W
    expected = np.exp(-1e-3 * s) / ((J * s**2 - 1j * L * s) * (LAG * s + 1.0))
    np.testing.assert_allclose(complex_response(plant, W), expected, rtol=1e-9)
    assert plant.A.shape == (3, 3)
    assert (plant.inertia, plant.momentum) == (pytest.approx(J), pytest.approx(L))


def test_singular_values_of_the_real_plant_are_the_two_sides_of_the_complex_one(gyro, sampled_plant):
    w = np.geomspace(1.0, 6000.0, 50)
    real = np.moveaxis(analysis.frequency_response(analysis.sampled(gyro, PERIOD, DELAY, [LAG, LAG]), w), -1, 0)
    sides = np.abs([complex_response(sampled_plant, w), complex_response(sampled_plant, -w)])
    np.testing.assert_allclose(np.sort(sides.T, axis=1)[:, ::-1], np.linalg.svd(real, compute_uv=False), rtol=1e-9)


def test_only_one_side_has_nutation(sampled_plant):
    """A motion with the rotor's sense resonates, one against it does not."""
    near = np.array([0.999 * L / J])
    assert np.abs(complex_response(sampled_plant, near)) > 100.0 * np.abs(complex_response(sampled_plant, -near))


def test_the_real_system_is_the_sampled_gyro(gyro, sampled_plant):
    expected = analysis.sampled(gyro, PERIOD, DELAY, [LAG, LAG])
    w = np.geomspace(1.0, 6000.0, 30)
    ours = analysis.frequency_response(sampled_plant.real_system(), w)
    np.testing.assert_allclose(ours, analysis.frequency_response(expected, w), rtol=1e-8, atol=1e-12)


def test_the_real_controller_is_kr_and_ki_crosswise(loop):
    w = np.geomspace(1.0, 6000.0, 30)
    positive, negative = (complex_response(loop.controller, sign * w) for sign in (1.0, -1.0))
    # The real coefficients' part and the imaginary coefficients' part of K(jω).
    k_r, k_i = 0.5 * (positive + np.conj(negative)), (positive - np.conj(negative)) / 2j
    real = analysis.frequency_response(loop.real_controller, w)
    np.testing.assert_allclose(real, np.array([[k_r, -k_i], [k_i, k_r]]), rtol=1e-9)


def test_the_disk_margin_is_that_of_the_real_loop(gyro, loop):
    plant = analysis.sampled(gyro, PERIOD, DELAY, [LAG, LAG])
    for at in ("input", "output"):
        margin = analysis.disk_margin(analysis.loop_transfer(plant, loop.real_controller, at))
        assert loop.nyquist.disk_margin == pytest.approx(margin.unstructured, rel=1e-6)
        # One complex number in both channels is a perturbation of both: they agree.
        assert margin.alpha >= margin.unstructured * (1.0 - 1e-6)


def test_closed_loop_poles_are_those_of_the_real_loop(gyro, loop):
    plant = analysis.sampled(gyro, PERIOD, DELAY, [LAG, LAG])
    assert is_stable(analysis.closed_loop(plant, loop.real_controller))
    assert loop.nyquist.closed_unstable == 0


@pytest.mark.parametrize("period", [None, PERIOD])
def test_encirclements_count_the_unstable_poles(model, period):
    """Too little gain, too much, and the wrong sense: against the eigenvalues of the real loop."""
    plant = complex_plant(model, PAIR, period=period)
    base = complex_loop(plant, **LOOP).controller
    seen = set()
    for factor in (1.0, -1.0, 0.05, 30.0, 1j, -1j, 0.5 * np.exp(2j)):
        controller = turned(base, factor)
        count = two_sided_nyquist(plant, controller)
        closed = analysis.closed_loop(plant.real_system(), controller.real_system())
        s = continuous_poles(closed.poles(), closed.dt)
        assert 2 * count.closed_unstable == np.sum(s.real > 0.0)
        assert count.closed_unstable == count.open_unstable - count.encirclements
        seen.add(count.closed_unstable)
    assert len(seen) >= 3


def turned(system, factor):
    from dataclasses import replace

    return replace(system, C=factor * system.C, D=factor * system.D)


def test_dead_time_of_a_continuous_loop_is_exact(model):
    """Stable with a short one, not with one a fifth of a turn of the lead's phase long; L turns by exp(−jωτ)."""
    short, long = (complex_plant(model, PAIR, delay=delay) for delay in (2e-4, 3e-3))
    controller = complex_loop(short, **LOOP).controller
    slow = two_sided_nyquist(long, controller)
    assert slow.closed_unstable > 0
    assert slow.disk_margin == 0.0
    fast = two_sided_nyquist(short, controller, W)
    np.testing.assert_allclose(
        two_sided_nyquist(long, controller, W).loop_transfer, fast.loop_transfer * np.exp(-2.8e-3j * W), rtol=1e-9
    )
    with pytest.raises(ArgumentError, match="without dead time"):
        long.real_system()


def test_margins_lie_where_the_gain_is_one(loop, sampled_plant):
    crossings = loop.nyquist.crossings
    L_there = -complex_response(sampled_plant, crossings) * complex_response(loop.controller, crossings)
    np.testing.assert_allclose(np.abs(L_there), 1.0, rtol=1e-9)
    np.testing.assert_allclose(np.angle(-L_there), loop.nyquist.phase_margins, atol=1e-9)
    assert np.any(crossings < 0.0)
    assert np.any(crossings > 0.0)
    guaranteed = 2.0 * np.arctan(0.5 * loop.nyquist.disk_margin)
    assert np.abs(loop.nyquist.phase_margins).min() >= guaranteed


def test_a_one_sided_notch_leaves_the_other_side_alone(sampled_plant, loop):
    """At +f the cross gain falls to the notch's depth, at −f it stays; the direct lead is taken out first."""
    f = 60.0
    notched = complex_loop(sampled_plant, **LOOP, notch_hz=f, notch_depth=0.5, notch_width=0.1).controller
    lead = complex_loop(sampled_plant, **LOOP | {"crossover_hz": 1e-9}).controller
    for w, share, tolerance in ((f, 0.5, 1e-6), (-f, 1.0, 0.05)):
        at = np.array([2.0 * np.pi * w])
        cross = [complex_response(one, at) - complex_response(lead, at) for one in (notched, loop.controller)]
        assert abs(cross[0] / cross[1])[0] == pytest.approx(share, rel=tolerance)


def test_unequal_axes_are_named_and_can_be_balanced():
    model = pc.linearise(pc.read_platform("three_gyro_platform"))
    with pytest.raises(ArgumentError, match=r"alpha9 from p_alpha9, p_beta10: 2000, 0; beta10 .*: 0, 5000"):
        complex_plant(model, PAIR)
    plant = complex_plant(model, PAIR, period=PERIOD, delay=DELAY, balance=True)
    assert plant.inertia == pytest.approx(np.sqrt(5e-4 * 2e-4))
    assert plant.momentum == pytest.approx(L)
    gyro = pc.state_space(model, gimbals=PAIR)[["alpha9", "beta10"], ["Q9", "Q10"]]
    true = analysis.sampled(gyro, PERIOD, DELAY, [LAG, LAG])
    w = np.geomspace(1.0, 6000.0, 20)
    ours = analysis.frequency_response(plant.real_system(), w)
    np.testing.assert_allclose(ours, analysis.frequency_response(true, w), rtol=1e-8, atol=1e-12)
    loop = complex_loop(plant, **LOOP)
    assert is_stable(analysis.closed_loop(true, loop.real_controller))
    # Units do not touch the margin of channels that move by themselves; the complex one is at most that.
    own = analysis.disk_margin(analysis.loop_transfer(true, loop.real_controller))
    assert loop.nyquist.disk_margin <= own.alpha * (1.0 + 1e-6)


def test_the_order_of_the_gimbals_turns_the_sense(model):
    assert complex_plant(model, PAIR[::-1]).momentum == pytest.approx(-L)


def test_wrong_arguments_raise_errors(model, sampled_plant, loop):
    with pytest.raises(ArgumentError, match="must be the two of one gyro, got 3"):
        complex_plant(model, ("4", "5", "7"))
    with pytest.raises(ArgumentError, match=r"damping_hz must .*got -1"):
        complex_loop(sampled_plant, **LOOP | {"damping_hz": -1.0})
    with pytest.raises(ArgumentError, match=r"notch_hz must be .* got 1000\.0"):
        complex_loop(sampled_plant, **LOOP, notch_hz=1000.0)
    with pytest.raises(ArgumentError, match="has no inertia"):
        complex_loop(loop.controller, **LOOP)
    with pytest.raises(NotStabilisableError, match="1 unstable poles"):
        complex_loop(sampled_plant, **LOOP | {"damping_hz": 1.0})
    with pytest.raises(ArgumentError, match="must have dt"):
        two_sided_nyquist(complex_plant(model, PAIR), loop.controller)
    with pytest.raises(ArgumentError, match="must be a rising vector"):
        two_sided_nyquist(sampled_plant, loop.controller, W[::-1])
    with pytest.raises(ArgumentError, match="frequency must be real numbers, all finite, got one that is not"):
        complex_response(sampled_plant, [np.nan])


def test_python_control_agrees_on_the_closed_real_loop(gyro, loop):
    plant = analysis.sampled(gyro, PERIOD, DELAY, [LAG, LAG])
    poles = control.feedback(plant, loop.real_controller, sign=1).poles()
    assert np.abs(poles).max() < 1.0
