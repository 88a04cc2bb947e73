"""Displacement, smear and jitter against least squares in time, and the contrast that they leave."""

from __future__ import annotations

import math

import numpy as np
import pytest

from platform_ctrl.analysis.budget_records import Density, RandomDisturbance, motion_transfer, window_shares
from platform_ctrl.analysis.hybrid_plant import HybridPlant
from platform_ctrl.analysis.jitter_budget import JitterBudget
from platform_ctrl.analysis.system import System

POINT, WEIGHT = np.polynomial.legendre.leggauss(60)


@pytest.mark.parametrize("a", [1e-3, 0.1, 0.7, 1.99, 2.01, 5.0, 40.0])
def test_shares_are_those_of_a_least_squares_line(a: float) -> None:
    # Both phases of the wave over a window from -1 to 1: the mean square over a uniform phase is half their sum.
    parts = np.zeros(3)
    for wave in (np.cos(a * POINT), np.sin(a * POINT)):
        mean, slope = 0.5 * WEIGHT @ wave, 1.5 * WEIGHT @ (POINT * wave)
        rest = wave - mean - slope * POINT
        parts += [mean**2, slope**2 / 3.0, 0.5 * WEIGHT @ rest**2]
    found = window_shares(np.array([a]), 2.0)
    assert found.displacement[0] == pytest.approx(parts[0], rel=1e-8)
    assert found.smear[0] == pytest.approx(parts[1], rel=1e-8)
    # The difference in time loses digits where the jitter is small; the series does not.
    assert found.jitter[0] == pytest.approx(parts[2], rel=1e-8, abs=1e-16)


def test_short_windows_keep_all_digits() -> None:
    a = np.array([1e-8, 1e-6, 1e-4])
    found = window_shares(a, 2.0)
    assert found.smear == pytest.approx(a**2 / 3.0 * (1.0 - a**2 / 5.0), rel=1e-14)
    assert found.jitter == pytest.approx(a**4 / 45.0 * (1.0 - 2.0 * a**2 / 21.0), rel=1e-13)


@pytest.mark.parametrize("exposure", [0.1, 1.0, 6.0])
def test_windows_of_a_stationary_process_are_those_of_its_correlation(exposure: float) -> None:
    # Density 4/(1 + ω²)²: correlation (1 + |τ|) exp(-|τ|)/2. No control at all: the motion is the disturbance.
    spectrum = Density(knots=np.array([0.0, 0.3, 1.0, 3.0, 30.0, 3000.0]), density=lambda w: 4.0 / (1.0 + w * w) ** 2)
    plant = HybridPlant(
        plant=System(-np.eye(1), np.array([[1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[0, 0], [0, 1.0]])),
        controls=1,
        measured=1,
        period=0.01,
    )
    idle = System(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.zeros((1, 1)), 0.01)
    source = RandomDisturbance(name="motion", inputs=(0,), spectra=(spectrum,))
    window = JitterBudget(plant, [source], (exposure,)).of(idle, 1e-10).windows[0]
    # Both halves of the square of instants, the kink of the correlation on the diagonal between them.
    t = 0.5 * exposure * (1.0 + POINT)
    weight = 0.5 * exposure * WEIGHT
    s = 0.5 * t[:, None] * (1.0 + POINT)
    area = 2.0 * weight[:, None] * 0.5 * t[:, None] * WEIGHT
    tau = t[:, None] - s
    R = 0.5 * (1.0 + tau) * np.exp(-tau)
    displacement = np.sum(area * R) / exposure**2
    half = 0.5 * exposure
    smear = 12.0 / exposure**4 * np.sum(area * R * (t[:, None] - half) * (s - half))
    assert window.displacement[0] ** 2 == pytest.approx(displacement, rel=1e-8)
    assert window.smear[0] ** 2 == pytest.approx(smear, rel=1e-8)
    assert window.jitter[0] ** 2 == pytest.approx(0.5 - displacement - smear, rel=1e-8, abs=1e-10)


def test_contrast_is_the_mean_over_the_motion() -> None:
    nu = np.array([0.0, 1e-6, 0.3, 1.0, 4.0])
    assert motion_transfer(nu, 0.1) == pytest.approx(np.exp(-2.0 * (math.pi * 0.1 * nu) ** 2), rel=1e-14)
    # Extents of Gaussian smear, drawn by quadrature.
    x, w = np.polynomial.hermite_e.hermegauss(80)
    drawn = [w @ np.sinc(one * math.sqrt(12.0) * 0.05 * x) / math.sqrt(2.0 * math.pi) for one in nu]
    assert motion_transfer(nu, 0.0, 0.05) == pytest.approx(drawn, rel=1e-12)
