"""Responses, norms and margins of transfer functions and of data, against polynomials and python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest

from platform_ctrl import analysis
from platform_ctrl.errors import ArgumentError

s = control.tf("s")
RESONANCE = control.tf([4.0], [1.0, 0.2, 4.0])
# A gyro about its two gimbals: all four entries share the pole at zero and the nutation.
GYRO = control.tf([[[1.0], [-5.0]], [[5.0], [1.0]]], [[[1, 0, 25], [1, 0, 25, 0]], [[1, 0, 25, 0], [1, 0, 25]]])


@pytest.mark.parametrize("squeeze", [None, True, False])
@pytest.mark.parametrize(("p", "m"), [(1, 1), (1, 2), (2, 1), (2, 2)])
def test_inputs_and_shapes_are_those_of_forced_response(p: int, m: int, squeeze: bool | None) -> None:
    rng = np.random.default_rng(p + 2 * m)
    system = control.ss(
        rng.normal(size=(4, 4)) - 3.0 * np.eye(4), rng.normal(size=(4, m)), rng.normal(size=(p, 4)), np.ones((p, m))
    )
    t = np.linspace(0.0, 3.0, 31)
    u = rng.normal(size=(m, 31)) if m > 1 else rng.normal(size=31)
    expected = control.forced_response(system, t, u, squeeze=squeeze).outputs
    found = analysis.time_response(system, t, u, squeeze=squeeze)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_transfer_function_responds_as_its_polynomials() -> None:
    w = np.array([0.0, 0.3, 2.0, 7.0])
    np.testing.assert_allclose(analysis.frequency_response(RESONANCE, w)[0, 0], RESONANCE(1j * w), rtol=1e-14)
    np.testing.assert_allclose(analysis.frequency_response(s, w)[0, 0], 1j * w)  # improper: it has a response
    sampled = control.sample_system(RESONANCE, 0.1)
    np.testing.assert_allclose(analysis.frequency_response(sampled, w)[0, 0], sampled(np.exp(0.1j * w)), rtol=1e-12)
    assert np.isinf(analysis.frequency_response(1 / s, [0.0])[0, 0, 0])
    t = np.linspace(0.0, 5.0, 200)
    u = np.sin(t)
    expected = control.forced_response(RESONANCE, t, u).outputs
    np.testing.assert_allclose(analysis.time_response(RESONANCE, t, u), expected, atol=1e-10)


def test_norms_and_poles_of_a_transfer_function() -> None:
    ratio = 0.05
    norm, frequency = analysis.hinf_norm(RESONANCE)
    assert norm == pytest.approx(1 / (2 * ratio * np.sqrt(1 - ratio**2)), rel=1e-9)
    assert frequency == pytest.approx(2 * np.sqrt(1 - 2 * ratio**2), rel=1e-6)
    assert analysis.h2_norm(1 / (s + 1)) == pytest.approx(np.sqrt(0.5))
    assert analysis.h2_norm(control.tf([1.0], [1.0, -0.5], 1)) == pytest.approx(np.sqrt(1 / 0.75))
    assert analysis.damping(RESONANCE).ratio == pytest.approx([ratio, ratio])
    assert analysis.damping(1 / s).ratio == [0.0]


def test_poles_that_entries_share_are_there_as_often_as_the_system_has_them() -> None:
    # Entries built one by one have ten states, the gyro has two angles and two momenta.
    np.testing.assert_allclose(np.sort(analysis.damping(GYRO).poles.imag), [-5.0, 0.0, 0.0, 5.0], atol=1e-7)
    small = control.tf([[[1.0], [1e-6]], [[1e6], [1.0]]], [[[1, 0], [1, 0]], [[1, 0], [1, 0]]])
    assert len(analysis.damping(small).poles) == 1
    w = np.array([0.1, 1.0, 4.9, 30.0])
    states = analysis.loop_transfer(GYRO, control.ss([], [], [], -np.eye(2)))
    truth = analysis.frequency_response(GYRO, w)
    np.testing.assert_allclose(analysis.frequency_response(states, w), truth, rtol=1e-9)


def test_data_have_no_values_between_their_frequencies() -> None:
    w = np.array([0.5, 1.0, 2.0])
    data = control.frd(RESONANCE, w)
    with pytest.raises(ArgumentError, match=r"of data take the values that you need from `data\.frdata`"):
        analysis.frequency_response(data, w)
    for function in (analysis.hinf_norm, analysis.h2_norm, analysis.damping):
        with pytest.raises(ArgumentError, match=r"data say nothing between their frequencies; give a control\.St"):
            function(data)
    with pytest.raises(ArgumentError, match="data say nothing"):
        analysis.time_response(data, [0, 1], [0, 1])


@pytest.mark.parametrize("ask", [analysis.hinf_norm, analysis.h2_norm, analysis.disk_margin])
def test_improper_and_undated_transfer_functions_are_refused(ask) -> None:
    with pytest.raises(ArgumentError, match="improper, an entry has more zeros than poles"):
        ask(s)
    with pytest.raises(ArgumentError, match="dt=True"):
        ask(control.tf([1.0], [1.0, 0.5], True))


def test_states_whose_response_is_another_are_refused() -> None:
    # Modes at 1 and 1000 rad/s: python-control's states miss a small entry by more than rounding.
    slow, fast = [1.0, 2e-3, 1.0], [1.0, 2.0, 1e6]
    system = control.tf([[[1.0], [1e-4]], [[1e-4], [1.0]]], [[slow, fast], [fast, slow]])
    with pytest.raises(ArgumentError, match=r"has no realisation of its states to 1e-07 .*; make a control\.StateSp"):
        analysis.hinf_norm(system)
