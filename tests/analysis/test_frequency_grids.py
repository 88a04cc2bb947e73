"""The grids of frequencies: no resonance is missed, no response is evaluated on an undamped pole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl.analysis.frequency_grids import following_grid, tuning_grid


@settings(max_examples=40, deadline=None)
@given(st.floats(3e-3, 0.6), st.floats(20.0, 2000.0))
def test_the_grid_shows_the_peak_of_every_resonance(damping: float, frequency: float) -> None:
    s = frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
    w = following_grid(np.array([s, s.conjugate()]), 1.0, 1e4)
    gain = np.abs(frequency**2 / ((frequency**2 - w**2) + 2j * damping * frequency * w))
    assert gain.max() == pytest.approx(1.0 / (2.0 * damping * np.sqrt(1.0 - damping**2)), rel=0.02)


def test_no_response_is_evaluated_on_an_undamped_pole() -> None:
    w = following_grid(np.array([100j, -100j, 0.0]), 1.0, 1e4)
    assert np.abs(w - 100.0).min() > 0.01
    assert np.all(np.diff(w) > 0.0)


@pytest.mark.parametrize("period", [1e-6, 5e-4, 2e-3, 1.0])
def test_the_grid_covers_two_decades_up_to_the_nyquist_frequency_at_any_rate(period):
    grid = tuning_grid(474.0, period)
    assert np.all(np.diff(grid) > 0.0)
    assert grid[-1] == pytest.approx(0.999 * np.pi / period)
    assert grid[0] <= 0.0101 * grid[-1]
