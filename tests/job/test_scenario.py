"""What moves a platform in a run: tables over time and vibration, against SciPy and against their own definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from platform_ctrl.simulation import TimeTable, Vibration

T = np.array([0.0, 0.2, 0.5, 1.5, 2.0])
VALUES = np.array([[0.0, 1.0, 0.0], [0.5, 1.0, -1.0], [0.7, 1.0, 3.0], [-1.0, 1.0, 0.1], [0.0, 1.0, 0.2]])


def table(smooth: bool) -> TimeTable:
    return TimeTable(t=T, values=VALUES, smooth=smooth)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_table_goes_through_its_points_and_stays_at_its_ends(smooth: bool) -> None:
    np.testing.assert_allclose(table(smooth).at(T), VALUES, atol=1e-15)
    np.testing.assert_allclose(table(smooth).at([-5.0, 7.0]), VALUES[[0, -1]], atol=1e-15)
    assert table(smooth).at(0.3).shape == (3,)
    assert table(smooth).at(np.zeros((2, 4))).shape == (2, 4, 3)


def test_straight_lines_are_those_of_numpy() -> None:
    t = np.linspace(-0.5, 2.5, 301)
    expected = np.stack([np.interp(t, T, column) for column in VALUES.T], axis=-1)
    np.testing.assert_allclose(table(False).at(t), expected, atol=1e-14)


def test_a_smooth_table_is_the_natural_cubic_spline() -> None:
    t = np.linspace(0.0, 2.0, 301)
    np.testing.assert_allclose(table(True).at(t), CubicSpline(T, VALUES, bc_type="natural")(t), atol=1e-13)
    # Natural ends: no curvature there.
    first, last = table(True).pieces[0], table(True).pieces[-1]
    np.testing.assert_allclose(first[:, 2], 0.0, atol=1e-13)
    np.testing.assert_allclose(2 * last[:, 2] + 6 * last[:, 3] * 0.5, 0.0, atol=1e-12)


def shake(frequencies: list[float], densities: list[float], lines: int) -> Vibration:
    return Vibration(
        kind="rate",
        axis=1,
        frequencies_hz=np.array(frequencies),
        densities=np.array(densities),
        lines=lines,
    )


@settings(max_examples=50, deadline=None)
@given(slope=st.floats(-3.0, 3.0), knee=st.floats(20.0, 200.0))
def test_a_spectrum_of_straight_lines_keeps_its_power(slope: float, knee: float) -> None:
    low, high, level = 10.0, 400.0, 1e-5
    vibration = shake([low, knee, high], [level * (low / knee) ** slope, level, level * (high / knee) ** -slope], 2000)

    def power(a: float, b: float, exponent: float) -> float:
        """Integral of level (f / knee)**exponent from a to b."""
        x = np.linspace(np.log(a / knee), np.log(b / knee), 20001)
        return float(level * knee * np.trapezoid(np.exp((exponent + 1.0) * x), x))

    _, amplitude = vibration.amplitudes
    assert 0.5 * (amplitude**2).sum() == pytest.approx(power(low, knee, slope) + power(knee, high, -slope), rel=1e-3)
