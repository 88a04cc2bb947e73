"""The grids of frequencies: no resonance is missed, no response is evaluated on an undamped pole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl.analysis.poles import following_grid


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
