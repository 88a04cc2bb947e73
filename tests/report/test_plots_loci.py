"""Root loci over gain and rotor speed show the poles of the loop."""

from __future__ import annotations

import dataclasses
import math

import control
import numpy as np
import pytest

import platform_ctrl as pc
import report_jobs
from legend_entries import without_a_curve
from platform_ctrl.report import figures

PERIOD, DELAY = 0.0005, 0.0005
NUMBERS = {"crossover_hz": 70, "integral_hz": 2, "damping_hz": 78, "damping2_hz": 92, "lead_hz": 7, "rolloff_hz": 900}
ANGLES, TORQUES = ["alpha9", "beta10"], ["Q9", "Q10"]


def ss(A, B, C, D=0.0, dt=0):
    return control.ss(A, B, C, D, dt)


MINUS = ss(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-1.0]])
THIRD = control.ss(control.tf([1.0], [1.0, 6.0, 5.0, 0.0]))  # 1/(s (s + 1) (s + 5)): stable below a gain of 30


@pytest.fixture(scope="module")
def job():
    design = {"name": "classical", "method": "classical", **NUMBERS}
    return pc.read_job(report_jobs.job(operation={"Omega": [0.0, 0.0, 0.0]}, loop=[report_jobs.caging(design)]))


@pytest.fixture(scope="module")
def controller(job):
    return pc.design.loops(job)[0].closed.controller


def gyro(platform):
    return pc.state_space(pc.linearise(platform), gimbals=("9", "10"))[ANGLES, TORQUES]


@pytest.fixture(scope="module")
def plant(job):
    lag = [torquer.lag for torquer in job.platform.torquers if torquer.gimbal in ("9", "10")]
    return pc.analysis.sampled(gyro(job.platform), PERIOD, DELAY, lag)


@pytest.fixture(scope="module")
def over_gain(plant, controller):
    return figures.root_locus(plant, controller)


@pytest.fixture(scope="module")
def over_spin(job, controller):
    return figures.root_locus_over_spin(job.platform, ("9", "10"), controller, delay=DELAY)


def nearest(found, expected):
    """Largest distance from an expected pole to the nearest found one."""
    return np.abs(np.asarray(expected)[:, None] - np.asarray(found)[None, :]).min(axis=1).max()


def texts(axes):
    return [text.get_text() for text in axes.texts]


def markers(axes, marker, colour=None):
    """Points of the lines that are drawn with a marker."""
    lines = [x for x in axes.lines if x.get_marker() == marker and colour in (None, x.get_color())]
    return np.concatenate([np.zeros(0), *(np.asarray(x.get_xdata()) + 1j * np.asarray(x.get_ydata()) for x in lines)])


def test_at_gain_1_the_locus_passes_through_the_poles_of_the_closed_loop(over_gain, plant, controller):
    locus = over_gain.locus
    at = int(np.flatnonzero(locus.values == 1.0)[0])
    closed = pc.analysis.closed_loop(plant, controller).poles()
    assert nearest(locus.branches[at], closed) < 1e-9
    rings = markers(over_gain.axes[0, 0], "o", "#d55e00")
    s = np.log(closed.astype(complex)) / PERIOD
    assert nearest(s, rings) < 1e-6 * np.abs(s).max()


def test_at_gain_0_the_locus_begins_at_the_poles_of_plant_and_controller(over_gain, plant, controller):
    z = np.concatenate([plant.poles(), controller.poles()])
    # Multiple poles: their computed places differ by the square root of rounding.
    assert nearest(over_gain.locus.branches[0], z) < 1e-6
    assert nearest(z, over_gain.locus.branches[0]) < 1e-6


def test_the_edge_of_stability_is_where_the_spectral_radius_crosses_1(over_gain, plant, controller):
    [edge] = over_gain.locus.edges

    def radius(gain):
        closed = pc.analysis.closed_loop(plant, gain * controller)
        return float(np.abs(closed.poles()).max())

    low, high = 1.0, 2.5
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    assert edge == pytest.approx(low, rel=1e-6)
    assert over_gain.locus.stable_ranges == [(0.0, pytest.approx(edge))]
    assert without_a_curve(over_gain.figure) == []
    axes = over_gain.axes[0, 0]
    assert axes.get_title(loc="left") == "gain 0 to 2.5: stable below 2.18"
    assert "gain 2.18" in texts(axes)
    [diamond] = markers(axes, "D", "#b3261e")
    assert diamond.real == pytest.approx(0.0, abs=1e-6)


def test_the_edge_is_routh_s_for_three_poles():
    locus = figures.root_locus(THIRD, MINUS, gains=[0.0, 100.0]).locus
    assert locus.edges == pytest.approx([30.0], rel=1e-6)
    # s³ + 6 s² + 5 s + 30 = (s² + 5)(s + 6)
    at = int(np.argmin(np.abs(locus.values - 30.0)))
    assert np.abs(locus.branches[at].imag).max() == pytest.approx(math.sqrt(5.0), rel=1e-6)


def test_over_spin_stability_ends_where_the_poles_say(over_spin, job, controller):
    [edge] = over_spin.locus.edges
    assert 0.6 < edge < 0.8
    lag = [torquer.lag for torquer in job.platform.torquers if torquer.gimbal in ("9", "10")]
    for share, stable in ((edge * 1.001, True), (edge * 0.999, False)):
        rotors = tuple(
            dataclasses.replace(one, angular_momentum=share * one.angular_momentum) if one.name == "11" else one
            for one in job.platform.rotors
        )
        plant = pc.analysis.sampled(gyro(dataclasses.replace(job.platform, rotors=rotors)), PERIOD, DELAY, lag)
        closed = pc.analysis.closed_loop(plant, controller)
        assert bool(pc.analysis.damping(closed).ratio.min() > 0.0) is stable
