"""Dry friction in a linear budget: the random-input describing function of a Gaussian relative rate.

A friction torque f(v) of a Gaussian rate v with the rms σ is replaced by b v + r, with b = E[f(v) v]/σ² and a remainder
r that is not correlated with v (Booton; Gelb and Vander Velde, Multiple-Input Describing Functions, 1968, ch. 7). For
f = F sign(v), b = √(2/π) F/σ and the remainder has 60 % of F: it is no small quantity, and acts like a torque from
outside (`friction_noise`). How much it is, and how long the bearing hardly slides, is part of every result.

What a drive feeds forward against friction, g(w) of the rate w that it finds, is replaced in the same way by c w and a
remainder: v and w are Gaussian together, so that both remainders are uncorrelated with all rates of the loop.

Bristles (LuGre), ż = v − σ0 |v| z/F, have a state: they are replaced by ż = κ v − λ z with the gains of h = σ0 |v| z/F
at Gaussian v and z, λ = E[∂h/∂z] and 1 − κ = E[∂h/∂v] (Atalik and Utku, Earthquake Eng. Struct. Dyn. 4, 1976). For
small motion that is the spring σ0, and, with F raised to 4/π F as the correlation r of v and z goes to 1, for fast
sliding b v of the sign. The powers of r for that and for the remainder are fitted to the equation of the bristle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.budget_integrals import KRONROD, between, nodes
from platform_ctrl.analysis.dry_torques import DryTorque, FedFriction, about_mean
from platform_ctrl.common.arguments import positive, real_array, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import NotFoundError
from platform_ctrl.plant.force_elements import Friction

# Beyond so many σ a Gaussian rate is not found.
_FAR = 9.0
# The describing function counts as valid where the rate is within ±coulomb_rate for no more of the time.
_MOST_STICKING = 0.1
# Bristles hold in proportion to motion: they may take more of its mean square.
_MOST_BENDING = 0.75
# Of a friction without a slope at rest a rate, rad/s, that is as good as none.
_LEAST_RATE = 1e-12
# Of bristles, by the squared correlation r² of rate and deflection: the power of r² by which the friction of their
# gains is raised, and that of 1 − r² which the remainder lacks.
_RAISED, _LACKING = 4, 1.5
# Share of its friction below which an elasto-plastic bristle hardly slides.
_ELASTIC = 0.9
# Bristles of LuGre, and elasto-plastic ones, are springs up to this share of breakaway: where a loop is much softer
# than they are they drift by slipping above it, which no linear model shows.
_RESTING = (0.05, 0.2)
# Rounds of the balance of friction at most: a handful is the rule. After some of them secants have not helped.
_ITERATIONS, _SECANTS = 200, 20


class Describing(NamedTuple):
    """The replacement of dry friction: its mean, N m, its viscous equivalent, N m s, and the rms of the rest, N m."""

    mean: float
    viscous: float
    remainder: float


def describing_function(friction: DryTorque, rms: float) -> Describing:
    """Return the replacement of the dry part of a friction at a Gaussian relative rate, of `rms` rad/s, without mean.

    Smoothing by tanh and the Stribeck curve are taken into account by quadrature, right to about 1e-12; at rms 0 it is
    the slope at rest, of a friction that is not smooth that at a rate which is hardly any.
    """
    near = friction.coulomb_rate
    rms = max(positive("describing function: rms", rms, zero=True), 0.0 if near else _LEAST_RATE)
    if rms <= 1e-7 * near:
        return Describing(0.0, 0.5 * sum(friction.breakaway) / near, 0.0)
    x, weight = gaussian([near / rms, friction.stribeck_rate / rms])
    values = torques(friction, rms, x)
    mean, viscous, square = (float(weight @ one) for one in (values, values * x / rms, values**2))
    return Describing(mean, viscous, math.sqrt(max(0.0, square - mean**2 - (viscous * rms) ** 2)))


class FrictionGains(NamedTuple):
    """What replaces the dry friction of J bearings in a linear loop; each (J,).

    Attributes
    ----------
    viscous
        Damping, N m s; 0 of bristles.
    fed
        Gain of what is fed forward, from the rate that a drive finds to its torque, N m s; 0 without drive.
    share, slip
        Of bristles, ż = share v − slip z, slip in 1/s; 0 of other friction.
    """

    viscous: FloatArray
    fed: FloatArray
    share: FloatArray
    slip: FloatArray


class BristleGains(NamedTuple):
    """The replacement of bristles, ż = share v − slip z, slip in 1/s, and their remainder over that of the sign."""

    share: float
    slip: float
    remainder: float


def bristle_gains(friction: Friction, rms: float, reach: float, deflection: float) -> BristleGains:
    """Return the replacement of bristles, for rms of the rate, rad/s, and deflection, rad; `reach`: E[v z]/rms, rad."""
    x, weight = gaussian([friction.stribeck_rate / rms])
    values, slides = torques(friction, rms, x), 1.0
    per = friction.bristle_stiffness * x / values
    if friction.elastoplastic:
        # The part of E[z²] beyond the elastic deflections, which all slide as r goes to 1.
        y = _ELASTIC * float(weight @ np.abs(values)) / (friction.bristle_stiffness * deflection)
        slides = math.erfc(y / math.sqrt(2.0)) + y * math.sqrt(2.0 / math.pi) * math.exp(-0.5 * y * y)
    slip, lost = rms * float(weight @ per), min(reach * float(weight @ (per * (x * x - 1.0))), 0.9)
    low, high = 0.0, 1.0
    while high - low > 1e-12:
        square = 0.5 * (low + high)
        part = (slides + (1.0 - slides) * square) / (1.0 + (4.0 / math.pi - 1.0) * square**_RAISED)
        found = part * slip * reach / ((1.0 - part * lost) * rms)
        low, high = (square, high) if found > square else (low, square)
    return BristleGains(1.0 - part * lost, part * slip, 1.0 - (1.0 - square) ** _LACKING)


def gaussian(scales: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Return points of a unit Gaussian and their weights, in panels that end where torques turn about, at `scales`."""
    edges = np.outer(
        [*(min(one, _FAR) for one in scales if one > 0.0), 1.0], [0.25, 0.5, 1.0, 2.0, 3.0, 4.5, 6.5, 12.0, 20.0]
    ).ravel()
    ahead, half = nodes(between(edges, 0.0, _FAR))
    x = np.concatenate([ahead.ravel(), -ahead.ravel()])
    weight = np.tile((KRONROD * half[:, None]).ravel(), 2)
    return x, weight * np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)


def torques(torque: DryTorque, rms: float, x: FloatArray) -> FloatArray:
    """Return a torque, N m, at the rates `rms` x."""
    return np.array([torque.dry(float(rms * one)) for one in x])


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
        Equivalent damping of the dry part, N m s; of bristles that of what is in phase with the rate.
    fed : (J,)
        Equivalent gain of what is fed forward, from the rate that the drive finds to its torque, N m s; 0 without
        drive.
    remainder : (J,)
        rms of the torque that is not in proportion to these rates, what is fed forward taken off the friction, N m.
    undamped : (J,)
        rms of the relative rate without dry friction, rad/s; infinite where it was not needed.
    turning : (J,)
        Mean rates about which the bearings move, rad/s.
    bristles : (4, J)
        Share and slip, 1/s, of bristles, their remainder over that of the sign, and the rms of their deflection over
        that at which they break away; 0, 0, 1 and 0 of other friction.
    """

    frictions: tuple[Friction, ...]
    drives: tuple[FedFriction | None, ...]
    rate: FloatArray
    measured: FloatArray
    viscous: FloatArray
    fed: FloatArray
    remainder: FloatArray
    undamped: FloatArray
    turning: FloatArray
    bristles: FloatArray

    @property
    def gains(self) -> FrictionGains:
        """What replaces the friction in a linear loop."""
        share, slip, *_ = self.bristles
        return FrictionGains(np.where(slip > 0.0, 0.0, self.viscous), self.fed, share, slip)

    @property
    def sticking(self) -> FloatArray:
        """How far from sliding all the time the bearings are (J,), dimensionless.

        Of smooth friction the probability that the rate is within ±coulomb_rate, where the bearing hardly slides; else
        the share of the variance of the rate that friction takes away: it sticks instead of moving so much. Of a
        bearing that turns the probability that it turns back. Of bristles with a drive also what their remainder lacks.
        """
        from scipy.special import erf, erfc

        near = np.array([one.coulomb_rate for one in self.frictions])
        creeping = np.asarray(erf(near / (np.maximum(self.rate, 1e-300) * math.sqrt(2.0))))
        taken = 1.0 - np.minimum(self.rate / np.maximum(self.undamped, 1e-300), 1.0) ** 2
        taken = np.maximum(taken, np.where(self._elastic, 0.0, 1.0 - self.bristles[2]))
        back = 0.5 * np.asarray(erfc(np.abs(self.turning) / (np.maximum(self.rate, 1e-300) * math.sqrt(2.0))))
        return np.where(self.turning != 0.0, back, np.where(near > 0.0, creeping, taken))

    @property
    def resting(self) -> FloatArray:
        """1 where bristles without a drive are deflected so little that they are springs, else 0 (J,)."""
        most = np.array([_RESTING[one.elastoplastic] for one in self.frictions])
        return np.where(self._elastic & (self.bristles[3] <= most), 1.0, 0.0)

    @property
    def _elastic(self) -> NDArray[np.bool_]:
        """Whether bearings have bristles and no drive (J,)."""
        alone = np.array([one is None for one in self.drives], dtype=np.bool_)
        return np.asarray(alone & (self.bristles[1] > 0.0))

    @property
    def valid(self) -> FloatArray:
        """1 where `sticking` is at most 0.1, of bristles 0.75, or they are `resting`, else 0 (J,), dimensionless."""
        within = self.sticking <= np.where(self._elastic, _MOST_BENDING, _MOST_STICKING)
        return np.maximum(within.astype(np.float64), self.resting)

    @property
    def statement(self) -> tuple[str, ...]:
        """A sentence for each bearing."""
        sticking, valid, resting = self.sticking, self.valid, self.resting
        return tuple(
            self._said(k, float(sticking[k]), valid[k] > 0.0, resting[k] > 0.0) for k in range(len(self.frictions))
        )

    def _said(self, k: int, sticking: float, valid: bool, resting: bool) -> str:
        friction, drive, rate, turning = self.frictions[k], self.drives[k], self.rate[k], self.turning[k]
        where, rest = f"friction of gimbal {friction.gimbal}: ", f"{self.remainder[k]:.3g} N m rms of its torque"
        if resting:
            return (
                f"{where}it rests on its bristles, deflected by {100 * self.bristles[3, k]:.2g} % rms of what they "
                f"slide at; {rest} are not in proportion to that"
            )
        less = "" if drive is None else f", less the {drive.friction:.3g} N m that are fed forward,"
        left = f"{rest}{less} are not in proportion to the rate"
        if turning:
            back = f"turns at {turning:.3g} rad/s, with {rate:.3g} rad/s rms beside that"
            if valid:
                return f"{where}it {back}; {left}"
            return f"{where}the linear budget does not hold: it {back}, and often turns back; simulate; {left}"
        if valid:
            still = "of the time nearly at rest" if friction.coulomb_rate else "of its motion held back by friction"
            return f"{where}it slides at {rate:.3g} rad/s rms, {100 * sticking:.2g} % {still}; {left}"
        if friction.coulomb_rate:
            slow = f"the rate is below {friction.coulomb_rate:.3g} rad/s for {100 * sticking:.2g} % of the time"
        else:
            slow = f"it sticks, {100 * sticking:.3g} % of the motion is held back by friction"
        return f"{where}the linear budget does not hold: {slow} (rms {rate:.3g} rad/s); simulate; {left}"


def friction_balance(
    frictions: Sequence[Friction],
    rate_rms: Callable[[FrictionGains], FloatArray],
    start: FloatArray | None = None,
    tolerance: float = 1e-8,
    drives: Sequence[FedFriction | None] = (),
    turning: ArrayLike | None = None,
) -> FrictionBalance:
    """Return the equivalent damping of J dry frictions at which the linear loop moves as assumed.

    `rate_rms` gives the rms of the relative rates (J,), rad/s, of the rates that the D drives find that there are
    (D,), rad/s, and of the deflections of the B bearings that do not turn and have bristles (B,), rad, one behind the
    other, of the linear loop with gains in the place of dry friction; the viscous parts are the caller's. `start`
    (J + D,) are first guesses of the rates, by default ten times coulomb_rate, or without one those of a loop without
    dry friction; `drives` is what is fed forward against each friction, or None; `turning` (J,) the mean rates of the
    bearings, rad/s.

    The remainder is that of the friction alone: how much of it a drive takes off depends on the spectra of the rates,
    see `friction_noise`. Raises `NotFoundError` where the rates still change by more than `tolerance`, relative, after
    200 iterations.
    """
    drives = tuple(drives) or (None,) * len(frictions)
    driven = [k for k, one in enumerate(drives) if one is not None]
    means = real_array("friction balance: turning", turning, (len(frictions),), 0.0)
    torques: list[DryTorque] = [about_mean(one, float(mean)) for one, mean in zip(frictions, means, strict=True)]
    torques += [one for one in drives if one is not None]
    elastic = [k for k, one in enumerate(torques) if isinstance(one, Friction) and one.bristle_stiffness]
    J, plain = len(frictions), len(torques)
    # Bristles that slip hold nothing.
    none = FrictionGains(np.zeros(J), np.zeros(J), np.zeros(J), np.isin(np.arange(J), elastic).astype(np.float64))
    near, undamped = _near(torques, lambda: rate_rms(none))
    rate = real_array("friction balance: start", start, (plain,)) if start is not None else 10.0 * near
    if start is None:
        rate[:J][means != 0.0] *= 1e-3
    # Of bristles E[v z] over the rms of v is searched beside the rates, from that of fast sliding on.
    slid = [math.sqrt(2.0 / math.pi) * max(frictions[k].breakaway) / frictions[k].bristle_stiffness for k in elastic]
    near, rate, deflection = np.append(near, slid), np.append(rate, slid), np.array(slid)
    before: tuple[FloatArray, FloatArray] | None = None
    for round_ in range(_ITERATIONS):
        found = [describing_function(one, float(at)) for one, at in zip(torques, rate[:plain], strict=True)]
        gains = FrictionGains(*np.zeros((4, J)))
        gains.viscous[:] = [one.viscous for one in found[:J]]
        gains.fed[driven] = [one.viscous for one in found[J:]]
        gains.viscous[elastic] = 0.0
        each = zip(elastic, rate[plain:], deflection, strict=True)
        laws = [bristle_gains(frictions[k], max(float(rate[k]), _LEAST_RATE), float(p), float(z)) for k, p, z in each]
        of_bristles = np.array(laws).reshape(-1, 3).T
        gains.share[elastic], gains.slip[elastic] = of_bristles[:2]
        new = np.array(rate_rms(gains), dtype=np.float64)
        deflected = np.maximum(new[plain:], 1e-12 * deflection)
        deflection = deflected**0.4 * deflection**0.6
        # E[z ż] = 0.
        new[plain:] = of_bristles[1] / of_bristles[0] * deflected**2 / np.maximum(new[elastic], _LEAST_RATE)
        if _settled(rate, new, near, tolerance):
            break
        x, y = (np.log(np.maximum(one, 1e-20 * near)) for one in (rate, new))
        rate, before = np.exp(_stepped(x, y, before, round_ < _SECANTS)), (x, y)
    else:
        words = f"no rates found in {_ITERATIONS} loops, the last were {short([float(f'{one:.3g}') for one in rate])}"
        raise NotFoundError(f"friction balance: {words}; start from other rates, or simulate")
    bristles = np.array([[0.0], [0.0], [1.0], [0.0]]) * np.ones(J)
    bristles[:, elastic] = *of_bristles, math.sqrt(2.0 / math.pi) * deflected / slid
    viscous, measured = np.array(gains.viscous), np.zeros(J)
    viscous[elastic] = [frictions[k].bristle_stiffness for k in elastic] * rate[plain:] / rate[elastic]
    measured[driven] = new[J:plain]
    return FrictionBalance(
        frictions=tuple(frictions),
        drives=drives,
        rate=new[:J],
        measured=measured,
        viscous=viscous,
        fed=gains.fed,
        remainder=bristles[2] * [one.remainder for one in found[:J]],
        undamped=undamped[:J],
        turning=means,
        bristles=bristles,
    )


def _settled(assumed: FloatArray, found: FloatArray, near: FloatArray, tolerance: float) -> bool:
    """Return whether the rates that are found are those that were assumed, by a relative tolerance."""
    # Slower than this a bearing is at rest: its damping no longer grows, and what is found of its rate is round-off.
    still = np.maximum(1e-9 * near, _LEAST_RATE)
    assumed, found = np.maximum(assumed, still), np.maximum(found, still)
    return bool(np.all(np.abs(found - assumed) <= tolerance * found))


def _stepped(x: FloatArray, y: FloatArray, before: tuple[FloatArray, FloatArray] | None, secants: bool) -> FloatArray:
    """Return the next logarithms of rates after x, which make y, by secants of each or half-way; `before`: the last."""
    # Rates are positive, and dampings go as their inverse.
    slope = np.full(len(x), 0.0 if secants else -1.0)
    if before is not None and secants:
        moved = x - before[0]
        np.divide(y - before[1], moved, out=slope, where=np.abs(moved) > 1e-12)
    return np.asarray(x + (y - x) / (1.0 - np.clip(slope, -20.0, 0.9)))


def _near(torques: Sequence[DryTorque], without: Callable[[], FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return small rates of torques, and those `without` dry friction where any torque has none of its own, rad/s."""
    near = np.array([one.coulomb_rate for one in torques])
    if near.all():
        return near, np.full(len(near), math.inf)
    undamped = np.asarray(without(), dtype=np.float64)[: len(near)]
    return np.where(near > 0.0, near, np.maximum(0.1 * undamped, 10.0 * _LEAST_RATE)), undamped
