"""Disk margins: published examples, slycot's bound at every frequency, perturbations that put a pole on the axis."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from platform_ctrl import analysis, linearise, read_platform, state_space
from random_loops import stable_loop


def spinning_satellite() -> tuple[control.StateSpace, control.StateSpace]:
    """Return plant and controller of the spinning satellite (Zhou, Doyle and Glover 1996, sec. 9.6)."""
    plant = control.ss([[0.0, 10.0], [-10.0, 0.0]], np.eye(2), [[1.0, 10.0], [-10.0, 1.0]], 0)
    return plant, control.ss([], [], [], [[1.0, -2.0], [0.0, 1.0]])


def half_difference(L: control.StateSpace, w: np.ndarray | list[float]) -> np.ndarray:
    """Return (S - T)/2 at frequencies, (N, m, m)."""
    eye = np.eye(L.ninputs)
    out: np.ndarray = np.linalg.inv(eye + np.moveaxis(analysis.frequency_response(L, w), -1, 0)) - 0.5 * eye
    return out


def test_the_spinning_satellite_has_its_published_margins() -> None:
    plant, controller = spinning_satellite()
    L_output, L_input = plant * controller, controller * plant
    pytest.importorskip("slycot")
    for L in (L_output, L_input):
        for skew in (0.0, 1.0, -1.0):
            ours = analysis.disk_margin(L, skew)
            theirs, *_ = control.disk_margins(L, ours.frequencies[1:], skew, returnall=True)
            np.testing.assert_allclose(ours.lower_response[1:], theirs, rtol=1e-5)
            np.testing.assert_allclose(ours.upper_response[1:], theirs, rtol=1e-5)
            assert ours.alpha <= theirs.min() * (1.0 + 1e-6)
    # The figure in python-control's example of the simultaneous margin, at either place.
    assert analysis.disk_margin(L_output).alpha == pytest.approx(0.3754, abs=1e-3)
    assert analysis.disk_margin(L_input).alpha == pytest.approx(0.3754, abs=1e-3)


def test_the_siso_example_of_the_disk_margin_paper() -> None:
    # L = 25/(s^3 + 10 s^2 + 10 s + 10): alpha = 0.46, gain factors [0.63, 1.59], phase 25.8 degrees.
    found = analysis.disk_margin(control.ss(control.tf([25.0], [1.0, 10.0, 10.0, 10.0])))
    low, high, phase = found.gain_phase
    assert found.alpha == pytest.approx(0.46, abs=5e-3)
    assert (low, high) == pytest.approx((0.63, 1.59), abs=6e-3)
    assert math.degrees(phase) == pytest.approx(25.8, abs=0.15)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize(("m", "seed"), [(2, 20), (3, 21), (5, 22)])
def test_the_bounds_enclose_slycots_at_every_frequency(m: int, seed: int, dt: float) -> None:
    slycot = pytest.importorskip("slycot")
    L = stable_loop(seed, m, 9, dt)
    found = analysis.disk_margin(L)
    S = half_difference(L, found.frequencies)
    mu = [slycot.ab13md(one, np.ones(m, int), 2 * np.ones(m, int))[0] for one in S]
    ratio = found.lower_response * mu
    assert np.all((ratio > 0.9) & (ratio < 1.0 + 3e-5))
    assert np.all(found.upper_response * mu > 1.0 - 1e-9)
    # At the peak they agree.
    reference = slycot.ab13md(half_difference(L, [found.frequency])[0], np.ones(m, int), 2 * np.ones(m, int))[0]
    assert found.alpha * reference == pytest.approx(1.0, rel=2e-5)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("skew", [0.0, -0.8])
@pytest.mark.parametrize(("m", "seed"), [(1, 50), (2, 50), (4, 50)])
def test_the_perturbation_puts_a_pole_on_the_stability_boundary(m: int, seed: int, skew: float, dt: float) -> None:
    L = stable_loop(seed, m, 6, dt)
    found = analysis.disk_margin(L, skew)
    z = np.exp(1j * found.frequency * dt) if dt else 1j * found.frequency
    feedback = np.linalg.solve(np.eye(m) + found.perturbation[:, None] * L.D, found.perturbation[:, None] * L.C)
    assert np.abs(np.linalg.eigvals(L.A - L.B @ feedback) - z).min() < 1e-9
    # Its size is that of the upper bound, and it is real where the frequency is an end of the axis.
    delta = (found.perturbation - 1.0) / (0.5 * (1.0 - skew) + 0.5 * (1.0 + skew) * found.perturbation)
    assert np.abs(delta).max() == pytest.approx(found.upper, rel=1e-9)
    real = not found.perturbation.imag.any()
    assert real == (found.frequency == 0.0)
    # A little less of it leaves the loop stable.
    weaker = delta * 0.999
    f = (1.0 + 0.5 * (1.0 - skew) * weaker) / (1.0 - 0.5 * (1.0 + skew) * weaker)
    if real:
        A = L.A - (L.B * f.real) @ L.C
        poles = np.linalg.eigvals(A)
        assert np.abs(poles).max() < 1.0 if L.dt else poles.real.max() < 0.0


def test_an_unstable_loop_says_why_it_has_no_margin() -> None:
    found = analysis.disk_margin(control.ss([[1.0]], [[1.0]], [[0.5]], 0))
    assert (found.alpha, found.upper) == (0.0, 0.0)
    assert "pole at s = 0.5" in found.reason
    assert analysis.disk_margin(control.ss([[-1.0]], [[1.0]], [[0.5]], 0)).reason == ""


def test_a_margin_narrower_than_any_grid_is_found() -> None:
    zeta, w1 = 1e-7, 10.0
    A = np.array([[0.0, w1, 0.0], [-w1, -2.0 * zeta * w1, 0.0], [0.0, 0.0, -1.0]])
    B, C = np.array([[0.0, 0.0], [1.0, 0.1], [0.0, 1.0]]), np.array([[0.0, -1e-6, 0.0], [0.0, 1e-7, 1.0]])
    L = control.ss(A, B, C, 0)
    found = analysis.disk_margin(L)
    assert found.alpha < 0.7
    assert found.alpha < 0.5 / np.linalg.norm(half_difference(L, np.geomspace(1e-2, 1e3, 400)), 2, axis=(1, 2)).max()
    # Of one channel alone.
    near = half_difference(L, w1 * (1.0 + np.linspace(-20.0, 20.0, 2001) * 1e-6))
    assert found.alpha <= (1.0 + 1e-4) / np.abs(np.diagonal(near, axis1=1, axis2=2)).max()
    assert found.proved


def test_a_siso_margin_has_its_closed_form() -> None:
    # L = k/s: (S - T)/2 = (s - k)/(s + k)/2, all-pass: alpha = 2 at every frequency.
    found = analysis.disk_margin(control.ss([[0.0]], [[1.0]], [[3.0]], 0))
    assert (found.alpha, found.upper, found.unstructured) == pytest.approx((2.0, 2.0, 2.0))


def test_loop_margins_are_siso_margins_with_the_other_channels_closed() -> None:
    plant = control.ss(
        [[0.0, 0.0], [0.0, 0.0]], [[1.0, 0.4], [-0.3, 2.0]], np.eye(2), 0, inputs=["Q9", "Q10"], outputs=["a", "b"]
    )
    lag = control.ss(-10.0 * np.eye(2), 10.0 * np.eye(2), [[-2.0, 1.0], [-1.0, -4.0]], 0)
    for at, names in (("input", ("y[0]", "y[1]")), ("output", ("u[0]", "u[1]"))):
        found = analysis.loop_margins(plant, lag, at=at)
        L = analysis.loop_transfer(plant, lag, at=at)
        assert found.channels == names
        for i, other in ((0, 1), (1, 0)):
            # Close the other channel around L, then measure the one that is left.
            A = L.A - L.B[:, [other]] @ L.C[[other]]
            single = control.ss(A, L.B[:, [i]], L.C[[i]], 0)
            assert found.alpha[i] == pytest.approx(float(analysis.disk_margin(single)), rel=1e-7)
            assert found.alpha[i] >= float(analysis.disk_margin(L)) * (1.0 - 1e-6)


def test_a_loop_that_no_gain_destabilises_says_so() -> None:
    # L = 0 needs an infinite gain, at infinite frequency where it is smallest; L = I has S - T = 0.
    small = analysis.disk_margin(control.ss(np.diag([-1.0, -1e9]), np.eye(2), np.eye(2), 0))
    assert small.alpha == pytest.approx(2.0)
    unit = analysis.disk_margin(control.ss([], [], [], np.eye(2)))
    assert unit.alpha == unit.upper == math.inf
    assert np.isinf(small.perturbation).any()
    assert np.isinf(unit.perturbation).all()


def test_a_closed_loop_that_is_stable_by_rounding_alone_has_no_margin() -> None:
    """A gyro in gimbals with a controller that feeds the sum of both angles: the difference is held by nothing."""
    model = linearise(read_platform("gimballed_gyro"))
    plant = state_space(model)[["alpha", "beta"], ["Qouter", "Qinner"]]
    margin = analysis.disk_margin(analysis.loop_transfer(plant, control.ss([], [], [], -np.ones((2, 2)))))
    assert 0.0 <= margin.alpha <= margin.upper < 1e-5
    assert margin.lower_response.shape == margin.frequencies.shape
