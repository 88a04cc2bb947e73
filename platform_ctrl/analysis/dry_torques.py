"""Torques by the sign of a rate: dry friction about a mean rate, and what a drive feeds forward against it."""

from __future__ import annotations

import math

from platform_ctrl.common.values import value
from platform_ctrl.plant.force_elements import Friction


@value
class TurningFriction:
    """Dry friction of a bearing that turns at a mean rate, about that rate: what differs from its mean torque.

    Attributes
    ----------
    friction
        Of the bearing.
    turning
        Mean rate, rad/s, not 0.
    """

    friction: Friction
    turning: float

    @property
    def coulomb_rate(self) -> float:
        """As of `Friction`, rad/s: where the bearing may come to rest."""
        return abs(self.turning)

    @property
    def stribeck_rate(self) -> float:
        """As of `Friction`, rad/s."""
        return self.friction.stribeck_rate

    @property
    def breakaway(self) -> tuple[float, float]:
        """Torque that the slope at the mean rate has grown to at the rate where the bearing may rest, N m."""
        step = 1e-6 * self.turning
        slope = (self.dry(step) - self.dry(-step)) / (2.0 * step)
        return slope * self.coulomb_rate, slope * self.coulomb_rate

    def dry(self, rate: float) -> float:
        """Return the torque against motion, N m, at a rate beside the mean one, rad/s."""
        return self.friction.dry(self.turning + rate) - self.friction.dry(self.turning)


@value
class FedFriction:
    """What a drive feeds forward against a bearing's friction: friction sat(w / friction_rate) of the rate w it finds.

    Attributes
    ----------
    friction
        N m, > 0.
    friction_rate
        Rate from which on all of it acts, rad/s, > 0.
    """

    friction: float
    friction_rate: float

    @property
    def coulomb_rate(self) -> float:
        """As of `Friction`, rad/s."""
        return self.friction_rate

    @property
    def stribeck_rate(self) -> float:
        """As of `Friction`: it does not fall, rad/s."""
        return math.inf

    @property
    def breakaway(self) -> tuple[float, float]:
        """As of `Friction`, N m."""
        return self.friction, self.friction

    def dry(self, rate: float) -> float:
        """Return the torque, N m, at a rate that the drive finds, rad/s."""
        return self.friction * min(max(rate / self.friction_rate, -1.0), 1.0)

    def gain(self, amplitude: float) -> float:
        """Return the describing function of a sinusoidal rate.

        Parameters
        ----------
        amplitude
            Of the rate that the drive finds, rad/s, > 0.

        Returns
        -------
        float
            N m s: 2 F/(π r) (asin k + k √(1 − k²)) with k = r/amplitude < 1 of the friction_rate r, else F/r.

        References
        ----------
        A. Gelb and W. E. Vander Velde, Multiple-Input Describing Functions, 1968, ch. 2.
        """
        slope = self.friction / self.friction_rate
        k = self.friction_rate / amplitude
        return slope if k >= 1.0 else 2.0 / math.pi * slope * (math.asin(k) + k * math.sqrt(1.0 - k * k))


# A torque that depends on the sign of a rate, smooth about zero.
DryTorque = Friction | TurningFriction | FedFriction


def about_mean(friction: Friction, turning: float) -> Friction | TurningFriction:
    """Return a friction about a mean rate, rad/s: itself where that is 0."""
    return TurningFriction(friction=friction, turning=turning) if turning else friction
