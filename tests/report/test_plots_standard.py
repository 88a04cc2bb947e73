"""Bode and Nyquist plots and singular values: python-control's plots of the responses on our grid."""

from __future__ import annotations

import control
import numpy as np
import pytest
from matplotlib import pyplot

import platform_ctrl as pc
from platform_ctrl import analysis
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report import figures

s = control.tf("s")


@pytest.fixture(autouse=True)
def closed_afterwards():
    yield
    pyplot.close("all")


@pytest.mark.parametrize("damping", [1e-2, 1e-5, 1e-8])
def test_a_resonance_has_its_whole_shape_however_sharp(damping):
    plot = figures.bode(control.ss(1.0 / (s**2 + 2.0 * damping * s + 1.0)))
    _, gain = plot.lines[0, 0][0].get_data()
    assert isinstance(plot, control.ControlPlot)
    assert gain.max() == pytest.approx(0.5 / damping, rel=1e-4)
    assert np.count_nonzero(gain > 0.5 * gain.max()) >= 7


def test_entries_are_called_as_their_signals_and_several_systems_as_their_labels():
    gyro = pc.state_space(pc.linearise(pc.read_platform("three_gyro_platform")), gimbals=("9", "10"))
    own = gyro[["alpha9", "beta10"], ["Q9", "Q10"]]
    plot = figures.bode({"nominal": own, "twice": 2.0 * own}, Hz=True)
    assert plot.axes.shape == (4, 2)
    words = " ".join(text.get_text() for axes in plot.axes.flat for text in [axes.title, axes.yaxis.label])
    assert "Q9" in words


def test_singular_values_are_those_of_the_response():
    system = control.ss(-np.diag([1.0, 2.0]), np.eye(2), [[1.0, 0.2], [0.1, 1.0]], 0)
    plot = figures.singular_values(system)
    w = plot.lines.flat[0][0].get_data()[0]
    expected = np.linalg.svd(np.moveaxis(analysis.frequency_response(system, w), -1, 0), compute_uv=False)
    found = np.array([line.get_data()[1] for line in plot.lines.flat[0]])
    np.testing.assert_allclose(np.sort(found, axis=0)[::-1].T, expected, rtol=1e-9)


def test_a_nyquist_curve_is_the_loop_transfer_with_the_other_channel_closed():
    A = np.array([[-1.0, 0.5], [0.2, -3.0]])
    loop = control.ss(A, [[3.0, 1.0], [-0.8, 2.0]], np.eye(2), 0, inputs=["Q1", "Q2"], outputs=["Q1", "Q2"])
    frequency = np.geomspace(0.1, 100.0, 60)
    plot = figures.nyquist(analysis.sampled(loop, 1e-3, 1e-3), frequency)
    L = analysis.frequency_response(analysis.sampled(loop, 1e-3, 1e-3), frequency)
    S = np.linalg.inv(np.eye(2) + np.moveaxis(L, -1, 0))
    points = np.concatenate([line.get_xydata() for line in plot.axes.flat[0].lines if len(line.get_xdata()) >= 60])
    for k in range(2):
        own = (1.0 / S[:, k, k] - 1.0)[[5, 30]]
        assert all(np.min(np.hypot(*(points - [one.real, one.imag]).T)) < 1e-9 for one in own)


@pytest.mark.parametrize("draw", [figures.bode, figures.nyquist, figures.singular_values, figures.nichols])
def test_wrong_input_is_one_line(draw):
    for wrong in (
        [],
        "loop",
        control.ss([[-1.0]], [[1.0, 0.0]], [[1.0]], 0) if draw in (figures.nyquist, figures.nichols) else 3,
    ):
        with pytest.raises(ArgumentError) as error:
            draw(wrong)
        assert "\n" not in str(error.value)
