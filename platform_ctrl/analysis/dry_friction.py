"""Dry friction in a linear budget: the random-input describing function of a Gaussian relative rate.

A friction torque f(v) of a Gaussian rate v with the rms σ is replaced by b v + r, with b = E[f(v) v]/σ² and a remainder
r that is not correlated with v (Booton; Gelb and Vander Velde, Multiple-Input Describing Functions, 1968, ch. 7). For
f = F sign(v), b = √(2/π) F/σ and the remainder has 60 % of F: it is no small quantity, and acts like a torque from
outside (`friction_noise`). How much it is, and for how much of the time the bearing hardly slides, is part of every
result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.panels import KRONROD, between, nodes
from platform_ctrl.common.arguments import positive, real_array
from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import NotFoundError
from platform_ctrl.plant.force_elements import Friction

# Beyond so many σ a Gaussian rate is not found.
_FAR = 9.0
# The describing function counts as valid where the rate is within ±coulomb_rate for no more of the time.
_MOST_STICKING = 0.1


class Describing(NamedTuple):
    """What stands for dry friction: its mean, N m, its viscous equivalent, N m s, and the rms of the rest, N m."""

    mean: float
    viscous: float
    remainder: float


def describing_function(friction: Friction, rms: float) -> Describing:
    """Return what stands for the dry part of a friction at a Gaussian relative rate without mean.

    Parameters
    ----------
    friction
        Its viscous part is linear and not included.
    rms
        Of the rate, rad/s, >= 0; at 0 the slope at rest.

    Returns
    -------
    Describing
        Smoothing by tanh and the Stribeck curve taken into account by quadrature, right to about 1e-12.
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
    rate : (J,)
        rms of the relative rate, rad/s.
    viscous : (J,)
        Equivalent damping of the dry part, N m s.
    remainder : (J,)
        rms of the friction torque that is not in proportion to the rate, N m.
    sticking : (J,)
        Probability that the rate is within ±coulomb_rate: there the bearing hardly slides.
    valid : (J,)
        1 where `sticking` is at most 0.1, else 0; dimensionless.
    iterations
        Loops that were evaluated.
    statement
        One sentence for each bearing.
    """

    rate: FloatArray
    viscous: FloatArray
    remainder: FloatArray
    sticking: FloatArray
    valid: FloatArray
    iterations: int
    statement: tuple[str, ...]


def friction_balance(
    frictions: Sequence[Friction],
    rate_rms: Callable[[FloatArray], FloatArray],
    start: FloatArray | None = None,
    tolerance: float = 1e-8,
    iterations: int = 200,
) -> FrictionBalance:
    """Return the equivalent damping of dry friction at which the linear loop moves as assumed.

    Parameters
    ----------
    frictions
        Of J bearings.
    rate_rms
        From the equivalent damping of the dry parts (J,), N m s, to the rms of the relative rates (J,), rad/s, that the
        linear loop with that damping has; the viscous parts are the caller's.
    start : (J,), optional
        First guess of the rates, rad/s; default ten times coulomb_rate.
    tolerance
        Relative change of the rates at which the iteration ends.
    iterations
        Loops at most.

    Returns
    -------
    FrictionBalance
        Converged.

    Raises
    ------
    NotFoundError
        The iteration did not converge.
    """
    from scipy.special import erf

    near = np.array([one.coulomb_rate for one in frictions])
    rate = real_array("friction balance: start", start, (len(near),)) if start is not None else 10.0 * near
    least = 1e-12 * near
    before: tuple[FloatArray, FloatArray] | None = None
    for count in range(1, iterations + 1):  # noqa: B007 - reported after the loop
        found = [describing_function(one, float(at)) for one, at in zip(frictions, rate, strict=True)]
        viscous = np.array([one.viscous for one in found])
        new = np.asarray(rate_rms(viscous), dtype=np.float64)
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
    sticking = erf(near / (np.maximum(new, 1e-300) * math.sqrt(2.0)))
    valid = sticking <= _MOST_STICKING
    remainder = np.array([one.remainder for one in found])
    return FrictionBalance(
        rate=new,
        viscous=viscous,
        remainder=remainder,
        sticking=sticking,
        valid=valid.astype(np.float64),
        iterations=count,
        statement=tuple(
            _statement(one, float(v), float(p), float(r))
            for one, v, p, r in zip(frictions, new, sticking, remainder, strict=True)
        ),
    )


def _statement(friction: Friction, rate: float, sticking: float, remainder: float) -> str:
    where = f"friction of gimbal {friction.gimbal}: "
    left = f"{remainder:.3g} N m rms of its torque are not in proportion to the rate"
    if sticking <= _MOST_STICKING:
        return f"{where}it slides at {rate:.3g} rad/s rms, {100 * sticking:.2g} % of the time nearly at rest; {left}"
    return (
        f"{where}the linear budget does not hold: the rate is below {friction.coulomb_rate:.3g} rad/s for "
        f"{100 * sticking:.2g} % of the time (rms {rate:.3g} rad/s); simulate; {left}"
    )
