"""Frequency plots for scripts: what is drawn is what is true of the systems."""

from __future__ import annotations

import control
import numpy as np
import pytest

from legend_entries import without_a_curve
from platform_ctrl import analysis
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report import figures

s = control.tf("s")
LOOP = control.ss(3.0 / (s * (s + 1.0) * (0.2 * s + 1.0)))
COUPLED = control.ss(
    [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.5, -4.0]],
    [[3.0, 1.0], [-0.8, 2.0], [0.3, 0.2]],
    [[1.0, 0.2, 0.4], [-0.3, 1.0, 0.1]],
    np.zeros((2, 2)),
    inputs=["Q1", "Q2"],
    outputs=["Q1", "Q2"],
)


def drawn_loop(line):
    """Return the complex values of a curve of a Nichols plot."""
    phase, level = line.get_data()
    return 10.0 ** (level / 20.0) * np.exp(1j * np.radians(phase))


def channel(loop, w, k):
    S = np.linalg.inv(np.eye(2) + np.moveaxis(analysis.frequency_response(loop, w), -1, 0))
    return 1.0 / S[:, k, k] - 1.0


@pytest.mark.parametrize("damping", [1e-2, 1e-4, 1e-6])
def test_a_resonance_has_its_whole_shape_however_sharp(damping):
    plot = figures.bode(control.ss(1.0 / (s**2 + 2.0 * damping * s + 1.0)))
    _, gain = plot.lines[0, 0][0].get_data()
    assert isinstance(plot, control.ControlPlot)
    assert gain.max() == pytest.approx(0.5 / damping, rel=1e-4)
    assert np.count_nonzero(gain > 0.5 * gain.max()) >= 7


def test_a_nyquist_curve_is_the_loop_transfer_with_the_other_channel_closed():
    A, B = [[-1.0, 0.5], [0.2, -3.0]], [[3.0, 1.0], [-0.8, 2.0]]
    damped = control.ss(A, B, np.eye(2), 0, inputs=["Q1", "Q2"], outputs=["Q1", "Q2"])
    loop, w = analysis.sampled(damped, 1e-3, 1e-3), np.geomspace(0.1, 100.0, 60)
    plot = figures.nyquist(loop, w)
    points = np.concatenate([line.get_xydata() for line in plot.axes.flat[0].lines if len(line.get_xdata()) >= 60])
    for k in range(2):
        own = channel(loop, w, k)[[5, 30]]
        assert all(np.min(np.hypot(*(points - [one.real, one.imag]).T)) < 1e-9 for one in own)


@pytest.mark.parametrize("data", [False, True])
def test_a_nichols_plot_has_every_channel_and_its_disk_margin(data):
    controller = control.ss([], [], [], -np.eye(2), inputs=["Q1", "Q2"], outputs=["Q1", "Q2"])
    w = np.geomspace(0.01, 100.0, 2000)
    loop = control.frd(analysis.frequency_response(COUPLED, w), w, name="L") if data else COUPLED
    plot = figures.nichols({"L": loop}, frequency=w)
    expected = analysis.loop_margins(COUPLED, controller)
    for k, (line, text) in enumerate(zip(plot.lines[0, 0], plot.legend.get_texts(), strict=False)):
        np.testing.assert_allclose(drawn_loop(line), channel(COUPLED, w, k), rtol=1e-6)
        margin = float(text.get_text().partition("disk margin ")[2].split()[0])
        assert margin <= expected.alpha[k] + 1e-9
        assert margin == pytest.approx(expected.alpha[k], rel=0.05)


@pytest.mark.parametrize("alpha", [0.4, 1.2])
def test_nichols_regions_end_where_the_balanced_sensitivity_is_1_over_alpha(alpha):
    plot = figures.nichols(1.0 / (s * (s + 1.0)), disk_margins=alpha)
    [region] = [patch for patch in plot.axes[0, 0].patches if len(patch.get_xy()) > 100]
    phase, level = region.get_xy()[:-1].T
    L = 10.0 ** (level / 20.0) * np.exp(1j * np.radians(phase))
    # (S - T)/2 = S - 1/2.
    assert np.abs(1.0 / (1.0 + L) - 0.5) == pytest.approx(1.0 / alpha, rel=1e-6)


def test_a_loop_that_is_not_stable_has_no_margin():
    [text, *_] = figures.nichols(20.0 * LOOP).legend.get_texts()
    assert text.get_text() == "L: closed loop not stable"


def test_every_legend_entry_looks_like_a_curve_that_is_drawn():
    assert without_a_curve(figures.nichols({"fast": LOOP, "slow": 0.4 * LOOP}).figure) == []


def test_a_notch_has_its_depth_and_no_response_turns_far_from_point_to_point():
    notch = (s**2 + 2e-4 * s + 1.0) / (s**2 + s + 1.0)
    magnitude, phase = (line.get_ydata() for line in (one[0] for one in figures.bode(control.ss(notch)).lines[:, 0]))
    assert magnitude.min() == pytest.approx(2e-4, rel=0.01)
    assert np.abs(np.diff(np.unwrap(phase, period=360.0))).max() < 2.1


@pytest.mark.parametrize("dt", [0, 0.01])
def test_singular_values_are_those_of_the_response(dt):
    system = control.ss([[-0.1, 0.2], [0.0, -0.3]], [[1.0, 0.0], [1.0, 1.0]], [[1.0, 0.0], [0.5, 1.0]], 0, dt)
    w = np.array([0.1, 1.0, 10.0])
    drawn = [line.get_ydata() for line in figures.singular_values(system, w).lines.ravel()[0]]
    response = np.moveaxis(np.asarray(system(np.exp(1j * w * dt) if dt else 1j * w)), -1, 0)
    assert np.allclose(drawn, np.linalg.svd(response, compute_uv=False).T)


@pytest.mark.parametrize("draw", [figures.bode, figures.nyquist, figures.singular_values, figures.nichols])
def test_wrong_input_is_one_line(draw):
    wide = control.ss([[-1.0]], [[1.0, 0.0]], [[1.0]], 0)
    for wrong in ([], "loop", wide if draw in (figures.nyquist, figures.nichols) else 3):
        with pytest.raises(ArgumentError) as error:
            draw(wrong)
        assert "\n" not in str(error.value)
