"""Dry friction in a linear budget: the random-input describing function of a Gaussian relative rate.

A friction torque f(v) of a Gaussian rate v with the rms σ is replaced by b v + r, with b = E[f(v) v]/σ² and a remainder
r that is not correlated with v (Booton; Gelb and Vander Velde, Multiple-Input Describing Functions, 1968, ch. 7). For
f = F sign(v), b = √(2/π) F/σ and the remainder has 60 % of F: it is no small quantity, and acts like a torque from
outside (`friction_noise`). How much it is, and for how much of the time the bearing hardly slides, is part of every
result.

What a drive feeds forward against friction, g(w) of the rate w that it finds, is replaced in the same way by c w and a
remainder: v and w are Gaussian together, so that both remainders are uncorrelated with all rates of the loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.frequency_grids import KRONROD, between, nodes
from platform_ctrl.common.arguments import positive, real_array, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import NotFoundError
from platform_ctrl.plant.force_elements import Friction

# Beyond so many σ a Gaussian rate is not found.
_FAR = 9.0
# The describing function counts as valid where the rate is within ±coulomb_rate for no more of the time.
_MOST_STICKING = 0.1


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
DryTorque = Friction | FedFriction


class Describing(NamedTuple):
    """What stands for dry friction: its mean, N m, its viscous equivalent, N m s, and the rms of the rest, N m."""

    mean: float
    viscous: float
    remainder: float


def describing_function(friction: DryTorque, rms: float) -> Describing:
    """Return what stands for the dry part of a friction at a Gaussian relative rate, of `rms` rad/s, without mean.

    Smoothing by tanh and the Stribeck curve are taken into account by quadrature, right to about 1e-12; at rms 0 it is
    the slope at rest.
    """
    rms = positive("describing function: rms", rms, zero=True)
    near = friction.coulomb_rate
    if rms <= 1e-7 * near:
        slope = 0.5 * sum(friction.breakaway) / near
        return Describing(0.0, slope, 0.0)
    scales = np.array([near, rms, min(friction.stribeck_rate, _FAR * rms)])
    edges = np.outer(scales, [0.25, 0.5, 1.0, 2.0, 3.0, 4.5, 6.5, 12.0, 20.0]).ravel()
    v, half = nodes(between(edges, 0.0, _FAR * rms))
    weight = (KRONROD * half[:, None]).ravel()
    v = v.ravel()
    density = weight * np.exp(-0.5 * (v / rms) ** 2) / (rms * math.sqrt(2.0 * math.pi))
    ahead = np.array([friction.dry(float(one)) for one in v])
    back = np.array([friction.dry(float(-one)) for one in v])
    mean = float(density @ (ahead + back))
    viscous = float(density @ ((ahead - back) * v)) / rms**2
    square = float(density @ (ahead**2 + back**2))
    return Describing(mean, viscous, math.sqrt(max(0.0, square - mean**2 - (viscous * rms) ** 2)))


@value
class FrictionBalance:
    """Rates and equivalent dampings that belong together, and whether they can be trusted; J bearings.

    Attributes
    ----------
    frictions : J of `Friction`
        Of the bearings.
    drives : J of `FedFriction`
        What is fed forward against each of them, or None.
    rate : (J,)
        rms of the relative rate, rad/s.
    measured : (J,)
        rms of the rate that the drive finds, as it acts on the bearing, rad/s; 0 without drive.
    viscous : (J,)
        Equivalent damping of the dry part, N m s.
    fed : (J,)
        Equivalent gain of what is fed forward, from the rate that the drive finds to its torque, N m s; 0 without
        drive.
    remainder : (J,)
        rms of the torque that is not in proportion to these rates, what is fed forward taken off the friction, N m.
    """

    frictions: tuple[Friction, ...]
    drives: tuple[FedFriction | None, ...]
    rate: FloatArray
    measured: FloatArray
    viscous: FloatArray
    fed: FloatArray
    remainder: FloatArray

    @property
    def sticking(self) -> FloatArray:
        """Probability that a rate is within ±coulomb_rate (J,), dimensionless: there the bearing hardly slides."""
        from scipy.special import erf

        near = np.array([one.coulomb_rate for one in self.frictions])
        return np.asarray(erf(near / (np.maximum(self.rate, 1e-300) * math.sqrt(2.0))))

    @property
    def valid(self) -> FloatArray:
        """1 where `sticking` is at most 0.1, else 0 (J,), dimensionless."""
        return (self.sticking <= _MOST_STICKING).astype(np.float64)

    @property
    def statement(self) -> tuple[str, ...]:
        """One sentence for each bearing."""
        rows = zip(self.frictions, self.drives, self.rate, self.sticking, self.remainder, strict=True)
        return tuple(_statement(one, drive, float(v), float(p), float(r)) for one, drive, v, p, r in rows)


def friction_balance(
    frictions: Sequence[Friction],
    rate_rms: Callable[[FloatArray], FloatArray],
    start: FloatArray | None = None,
    tolerance: float = 1e-8,
    iterations: int = 200,
    drives: Sequence[FedFriction | None] = (),
) -> FrictionBalance:
    """Return the equivalent damping of J dry frictions at which the linear loop moves as assumed.

    `rate_rms` gives, from the equivalent damping of the dry parts (J,), N m s, and the equivalent gains of the D drives
    that there are, the rms of the relative rates (J,) and of the rates that these drives find (D,), rad/s, of the
    linear loop with them; the viscous parts are the caller's. `start` (J + D,) are first guesses of the rates, by
    default ten times coulomb_rate; `drives` is what is fed forward against each friction, or None.

    The remainder is that of the friction alone: how much of it a drive takes off depends on the spectra of the rates,
    see `friction_noise`. Raises `NotFoundError` where the rates still change by more than `tolerance`, relative, after
    so many `iterations`.
    """
    drives = tuple(drives) or (None,) * len(frictions)
    driven = [k for k, one in enumerate(drives) if one is not None]
    torques: list[DryTorque] = [*frictions, *(one for one in drives if one is not None)]
    near = np.array([one.coulomb_rate for one in torques])
    rate = real_array("friction balance: start", start, (len(near),)) if start is not None else 10.0 * near
    least = 1e-12 * near
    before: tuple[FloatArray, FloatArray] | None = None
    for _ in range(iterations):
        found = [describing_function(one, float(at)) for one, at in zip(torques, rate, strict=True)]
        gains = np.array([one.viscous for one in found])
        new = np.asarray(rate_rms(gains), dtype=np.float64)
        if np.all(np.abs(new - rate) <= tolerance * np.maximum(new, 1e-9 * near)):
            break
        # Secants of each bearing in logarithms: rates are positive, and dampings go as their inverse.
        x, y = np.log(np.maximum(rate, least)), np.log(np.maximum(new, least))
        slope = np.zeros(len(near))
        if before is not None:
            moved = x - before[0]
            np.divide(y - before[1], moved, out=slope, where=np.abs(moved) > 1e-12)
        before = (x, y)
        rate = np.exp(x + (y - x) / (1.0 - np.clip(slope, -20.0, 0.9)))
    else:
        raise NotFoundError(
            f"friction balance: no rates found in {iterations} loops, the last were {short(rate.tolist())}; "
            "start from other rates, or simulate"
        )
    J = len(frictions)
    measured, fed = np.zeros(J), np.zeros(J)
    measured[driven], fed[driven] = new[J:], gains[J:]
    return FrictionBalance(
        frictions=tuple(frictions),
        drives=drives,
        rate=new[:J],
        measured=measured,
        viscous=gains[:J],
        fed=fed,
        remainder=np.array([one.remainder for one in found[:J]]),
    )


def _statement(friction: Friction, drive: FedFriction | None, rate: float, sticking: float, remainder: float) -> str:
    where = f"friction of gimbal {friction.gimbal}: "
    less = "" if drive is None else f", less the {drive.friction:.3g} N m that are fed forward,"
    left = f"{remainder:.3g} N m rms of its torque{less} are not in proportion to the rate"
    if sticking <= _MOST_STICKING:
        return f"{where}it slides at {rate:.3g} rad/s rms, {100 * sticking:.2g} % of the time nearly at rest; {left}"
    return (
        f"{where}the linear budget does not hold: the rate is below {friction.coulomb_rate:.3g} rad/s for "
        f"{100 * sticking:.2g} % of the time (rms {rate:.3g} rad/s); simulate; {left}"
    )
