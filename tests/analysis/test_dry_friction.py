"""The describing function of dry friction, and rates that agree with the damping they cause."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf

from platform_ctrl.analysis.dry_friction import FrictionGains, describing_function, friction_balance
from platform_ctrl.analysis.dry_torques import FedFriction
from platform_ctrl.analysis.friction_noise import friction_noise
from platform_ctrl.errors import NotFoundError
from platform_ctrl.plant.force_elements import Friction

BEARING = Friction(gimbal="pitch", coulomb=(0.02, 0.02), coulomb_rate=1e-3)


@pytest.mark.parametrize("rms", [3e-4, 1e-3, 1e-2])
def test_a_stribeck_curve_is_averaged_over_the_rates(rms: float) -> None:
    curve = Friction(
        gimbal="pitch", coulomb=(0.02, 0.03), coulomb_rate=1e-3, breakaway=(0.03, 0.05), stribeck_rate=4e-3
    )

    def mean_of(what: Callable[[float, float], float]) -> float:
        def weighted(v: float) -> float:
            return what(v, curve.dry(v)) * math.exp(-0.5 * (v / rms) ** 2) / (rms * math.sqrt(2.0 * math.pi))

        ends = [-9.0 * rms, 0.0, 9.0 * rms]
        return sum(quad(weighted, *pair, points=[0.5 * sum(pair)], epsabs=0.0, limit=200)[0] for pair in pairwise(ends))

    found = describing_function(curve, rms)
    viscous, mean = mean_of(lambda v, f: f * v) / rms**2, mean_of(lambda v, f: f)
    assert found.viscous == pytest.approx(viscous, rel=1e-10)
    assert found.mean == pytest.approx(mean, rel=1e-10)
    assert found.remainder**2 == pytest.approx(mean_of(lambda v, f: f * f) - mean**2 - (viscous * rms) ** 2, rel=1e-8)


def test_what_is_left_of_a_sign_is_a_noise_by_the_arcsine_law() -> None:
    sharp = Friction(gimbal="pitch", coulomb=(0.02, 0.02), coulomb_rate=1e-6)
    # A rate with the density exp(-ω²/2a²) has the correlation exp(-a²τ²/2).
    a = 5.0
    edges = np.linspace(0.0, 10.0 * a, 4000)
    cumulative = 0.1**2 * erf(edges / (a * math.sqrt(2.0)))
    remainder = friction_noise(sharp, 0.1, edges, cumulative, 0.05)
    assert remainder is not None
    noise = remainder.spectrum
    assert remainder.rms == pytest.approx(describing_function(sharp, 0.1).remainder, rel=1e-3)

    def below(omega: float) -> float:
        def part(tau: float) -> float:
            rho = math.exp(-0.5 * (a * tau) ** 2)
            return 2.0 / math.pi * 0.02**2 * (math.asin(rho) - rho) * math.sin(omega * tau) / tau

        return 2.0 / math.pi * quad(part, 1e-12, 8.0 / a, limit=400)[0]

    def between(low: float, high: float) -> float:
        omega = np.geomspace(low, high, 4001)
        return float(np.trapezoid(noise.at(omega), omega)) / (2.0 * math.pi)

    for omega in (3.0, 10.0, 30.0, 100.0):
        # Below the lowest frequency nothing counts.
        assert between(0.05, omega) == pytest.approx(below(omega) - below(0.05), rel=0.02)
    whole = between(0.05, float(noise.knots[-1]))
    assert whole == pytest.approx(describing_function(sharp, 0.1).remainder ** 2, rel=0.03)
    assert friction_noise(sharp, 0.0, edges, cumulative, 0.05) is None


def test_what_is_fed_forward_is_balanced_with_the_friction() -> None:
    # The rate of the bearing, and what a drive finds of it, of an inertia that white torque moves.
    drive = FedFriction(friction=0.015, friction_rate=1e-3)
    q, inertia = 1e-4, 0.5

    def rates(gains: FrictionGains) -> np.ndarray:
        v = math.sqrt(q / (2.0 * inertia * (gains.viscous[0] - 0.5 * gains.fed[0] + 1e-3)))
        return np.array([v, 0.9 * v])

    found = friction_balance([BEARING], rates, drives=[drive])
    assert found.measured == pytest.approx(0.9 * found.rate, rel=1e-12)
    assert found.viscous[0] == pytest.approx(describing_function(BEARING, float(found.rate[0])).viscous, rel=1e-7)
    # Of a limiter at the Gaussian rate w: F erf(r/(σ √2))/r.
    closed = 0.015 / 1e-3 * math.erf(1e-3 / (float(found.measured[0]) * math.sqrt(2.0)))
    assert found.fed[0] == pytest.approx(closed, rel=1e-7)
    assert "less the 0.015 N m that are fed forward" in found.statement[0]


@pytest.mark.parametrize("amplitude", [0.3, 1.0, 1.2, 5.0])
def test_a_limiter_has_its_describing_function(amplitude: float) -> None:
    drive = FedFriction(friction=0.4, friction_rate=1.0)

    def moment(x: float) -> float:
        return drive.dry(amplitude * math.sin(x)) * math.sin(x)

    bend = math.asin(min(1.0, 1.0 / amplitude))
    seen = quad(moment, 0.0, bend)[0] + quad(moment, bend, math.pi / 2.0)[0]
    assert drive.gain(amplitude) == pytest.approx(4.0 / math.pi * seen / amplitude, rel=1e-9)


def test_the_balance_is_a_fixed_point_of_the_linear_loop() -> None:
    # White torque on an inertia with damping b: the variance of the rate is q/(2 J b).
    q, inertia = 1e-4, 0.5

    def rate(gains: FrictionGains) -> np.ndarray:
        return np.sqrt(q / (2.0 * inertia * (gains.viscous + 1e-3)))

    found = friction_balance([BEARING], rate)
    assert found.rate == pytest.approx(rate(found.gains), rel=1e-7)
    assert found.viscous[0] == pytest.approx(describing_function(BEARING, float(found.rate[0])).viscous, rel=1e-7)
    # Sliding fast against coulomb_rate: 2 J b σ² = q with b = √(2/π) F/σ.
    assert found.rate[0] == pytest.approx(q / (2.0 * inertia * math.sqrt(2.0 / math.pi) * 0.02), rel=0.1)


def test_a_bearing_that_hardly_slides_is_named() -> None:
    slow = friction_balance([BEARING], lambda gains: np.full(1, 1e-3))
    assert slow.sticking[0] == pytest.approx(math.erf(1.0 / math.sqrt(2.0)))
    assert not slow.valid[0]
    assert "does not hold" in slow.statement[0]
    fast = friction_balance([BEARING], lambda gains: np.full(1, 0.1))
    assert fast.valid[0]
    assert "not in proportion to the rate" in fast.statement[0]


def test_rates_that_never_settle_are_refused() -> None:
    jumping = itertools.cycle([np.array([1e-3]), np.array([1.0])])
    with pytest.raises(NotFoundError, match="no rates found"):
        friction_balance([BEARING], lambda gains: next(jumping))


def test_friction_that_sticks_is_described_by_its_sign_and_judged_by_what_it_holds_back() -> None:
    sticks = Friction(gimbal="pitch", coulomb=(0.02, 0.02))
    for rms in (1e-6, 0.3):
        found = describing_function(sticks, rms)
        assert found.viscous == pytest.approx(math.sqrt(2.0 / math.pi) * 0.02 / rms)
        assert found.remainder == pytest.approx(0.02 * math.sqrt(1.0 - 2.0 / math.pi))
    # A body of J = 0.01 under white torque of 2 J b σ² = q, with a viscous friction that limits it.
    for q, valid in ((1.0, True), (1e-3, False)):
        balance = friction_balance([sticks], lambda gains, q=q: np.sqrt(q / (2.0 * 0.01 * (gains.viscous + 0.1))))
        assert bool(balance.valid[0]) is valid
        assert ("it sticks" in balance.statement[0]) is not valid


def test_a_bearing_at_rest_is_found_though_its_rate_is_round_off() -> None:
    # Beside a bearing that slides, what is left of the other's rate is noise of the computation.
    stuck, slides = (Friction(gimbal=name, coulomb=(0.02, 0.02)) for name in ("pan", "tilt"))
    noise = np.random.default_rng(1)

    def rates(gains: FrictionGains) -> np.ndarray:
        at_rest = 1e-3 / (1.0 + 100.0 * gains.viscous[0]) + 1e-13 * noise.random()
        return np.array([at_rest, np.sqrt(1.0 / (2.0 * 0.01 * (gains.viscous[1] + 0.1)))])

    found = friction_balance([stuck, slides], rates, tolerance=1e-4)
    assert found.valid.tolist() == [False, True]
    assert "it sticks, 100 %" in found.statement[0]


def test_a_bearing_that_turns_all_the_time_has_the_slope_of_its_friction_there_and_no_noise() -> None:
    bearing = Friction(gimbal="pitch", coulomb=(0.02, 0.02), breakaway=(0.03, 0.03), stribeck_rate=0.1)
    found = friction_balance([bearing], lambda gains: np.full(1, 1e-4), turning=[0.05])
    slope = -2.0 * 0.05 / 0.1**2 * 0.01 * math.exp(-0.25)  # of 0.02 + 0.01 exp(-(v/0.1)²)
    assert found.viscous[0] == pytest.approx(slope, rel=1e-5)
    assert found.remainder[0] < 1e-5 * 0.03
    assert found.valid[0]
    assert "it turns at 0.05 rad/s" in found.statement[0]
    # One that often turns back is described, and not trusted.
    often = friction_balance([bearing], lambda gains: np.full(1, 0.05), turning=[0.05])
    assert not often.valid[0]
    assert often.sticking[0] == pytest.approx(0.5 * math.erfc(1.0 / math.sqrt(2.0)))
    x = np.random.default_rng(1).normal(size=400_000)
    torque = np.array([bearing.dry(float(v)) for v in 0.05 + 0.05 * x])
    assert often.viscous[0] == pytest.approx(float(np.mean(torque * x)) / 0.05, rel=0.02)
    assert often.remainder[0] == pytest.approx(float(np.std(torque - often.viscous[0] * 0.05 * x)), rel=0.02)
