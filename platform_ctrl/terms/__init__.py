"""What the terms of the gimbal equations mean, how large each is, and what dropping it costs."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.arguments import positive, real_array
from platform_ctrl.description import Platform
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.mechanics.coupling import connected
from platform_ctrl.parameter_varying.polynomial import monomial_values
from platform_ctrl.signatures import check_arguments
from platform_ctrl.terms.labels import coordinate, product
from platform_ctrl.terms.labels import rates as rate_names
from platform_ctrl.terms.parts import Part, parts
from platform_ctrl.terms.poles import pole_change, poles
from platform_ctrl.terms.table import DROPPED_BY_THE_PAPER, MEANINGS, Kind, Term, TermTable

__all__ = ["Kind", "Term", "TermTable", "terms"]

# Poles slower than this part of the motion's frequency are standing still for it.
_SLOWEST = 0.01


@check_arguments
def terms(
    platform: Platform,
    Omega: ArrayLike,
    rates: ArrayLike,
    *,
    frequency: float = 2.0 * math.pi,
    angles: ArrayLike | None = None,
    accelerations: ArrayLike | None = None,
    Omega_dot: ArrayLike | None = None,
    q: ArrayLike | None = None,
    specific_force: ArrayLike | None = None,
) -> TermTable:
    """Rank every term of every gimbal's equation by its size at an operating point.

    The terms are those of (27) and those that the paper drops from it; together they are the exact equations to first
    order in the angles.

    Parameters
    ----------
    platform
        The platform.
    Omega : (3,)
        Rate of the platform, rad/s.
    rates : (n,)
        Amplitudes of the gimbals' rates, rad/s; those of dry friction's describing function too.
    frequency
        Of the motion, rad/s, > 0; default one cycle a second. What follows is derived from it unless given.
    angles, accelerations : (n,)
        Amplitudes; default rates / frequency, rad, and rates × frequency, rad/s².
    Omega_dot : (3,)
        Derivative of the rate; default Omega × frequency, rad/s².
    q : (n,)
        Angles about which the motion takes place, rad; default zero.
    specific_force : (3,)
        In root axes, m/s²; default the platform's own.

    Returns
    -------
    TermTable
        Ranked equation by equation.

    Raises
    ------
    ArgumentError
        Wrong shape, not finite, or `frequency` not above zero.

    Notes
    -----
    Poles are those of the gimbals whose equations share terms, also such that are zero at this Omega; Omega and Omega'
    are held. Dropped is one term of one equation, so that a gyroscopic action loses its counterpart. The change is
    relative to the pole's size, but at least to 1 % of `frequency`: slower poles stand still for this motion.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).

    See docs/terms.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> ranked = pc.terms(pc.read_platform("three_gyro_platform"), Omega=(1, 1, 1), rates=[0.01] * 5)
    >>> ranked.of("9")[0].label
    'L11 Ω1'
    """
    n = len(platform.gimbals)
    frequency = positive("frequency", frequency)
    rate = real_array("Omega", Omega, (3,))
    motion = np.abs(real_array("rates", rates, (n,)))
    amplitudes = {
        0: motion / frequency if angles is None else np.abs(real_array("angles", angles, (n,))),
        1: motion,
        2: motion * frequency if accelerations is None else np.abs(real_array("accelerations", accelerations, (n,))),
    }
    change = rate * frequency if Omega_dot is None else real_array("Omega_dot", Omega_dot, (3,))
    about = real_array("q", q, (n,), 0.0)
    f = platform.specific_force if specific_force is None else real_array("specific_force", specific_force, (3,))
    # A gimbal that stands still takes nothing out of dry friction: its describing function has no slope.
    still = np.where(motion > 0.0, motion, 1.0 / np.finfo(float).tiny)
    found = [entry for part in parts(platform, about, f, still) for entry in _entries(part, rate, change, amplitudes)]
    coupled = np.zeros((n, n), dtype=bool)
    for entry in found:
        if entry.part.derivative is not None:
            coupled[entry.place] = True
    costs = _costs(found, connected(coupled), _SLOWEST * frequency)
    return TermTable(
        platform=platform,
        Omega=rate,
        Omega_dot=change,
        angles=amplitudes[0],
        rates=motion,
        accelerations=amplitudes[2],
        terms=tuple(_ranked(platform, found, costs)),
    )


@value
class _Entry:
    """One term: where it stands, what stands before the coordinate, its amplitude."""

    part: Part
    place: tuple[int, ...]
    factor: float
    size: float


def _entries(
    part: Part, Omega: FloatArray, Omega_dot: FloatArray, amplitudes: dict[int, FloatArray]
) -> Iterator[_Entry]:
    rates_before = float(monomial_values((part.monomial,), Omega, Omega_dot)[0])
    for place in zip(*(k.tolist() for k in np.nonzero(part.occurs)), strict=True):
        factor = float(part.coefficients[place]) * rates_before
        amplitude = 1.0 if part.derivative is None else float(amplitudes[part.derivative][place[1]])
        yield _Entry(part=part, place=place, factor=factor, size=abs(factor) * amplitude)


def _costs(found: Sequence[_Entry], groups: Sequence[Sequence[int]], slowest: float) -> dict[int, tuple[float, int]]:
    """What dropping each term does to the poles of its subsystem, by the place of the term in `found`."""
    out = {}
    for group in groups:
        inside = [k for k, entry in enumerate(found) if entry.part.derivative is not None and entry.place[0] in group]
        matrices = np.zeros((3, len(group), len(group)))
        places, together = {}, defaultdict(list)
        for k in inside:
            row, column = found[k].place
            places[k] = (found[k].part.derivative, group.index(row), group.index(column))
            matrices[places[k]] += found[k].factor
            together[places[k]].append(k)
        before = poles(*matrices[::-1])
        for k in inside:
            if found[k].factor == 0.0:
                out[k] = (0.0, 0)
                continue
            without = matrices.copy()
            without[places[k]] = sum(found[j].factor for j in together[places[k]] if j != k)
            out[k] = pole_change(before, poles(*without[::-1]), slowest)
    return out


def _ranked(platform: Platform, found: Sequence[_Entry], costs: dict[int, tuple[float, int]]) -> Iterator[Term]:
    for row, gimbal in enumerate(platform.gimbal_names):
        # Sizes that differ by rounding alone keep their order on every machine.
        own = sorted(
            (k for k in range(len(found)) if found[k].place[0] == row), key=lambda k: -float(f"{found[k].size:.9e}")
        )
        sizes = [found[k].size for k in own]
        largest, total = max(sizes, default=0.0) or 1.0, sum(sizes) or 1.0
        for rank, k in enumerate(own, 1):
            part, place = found[k].part, found[k].place
            column = place[1] if len(place) > 1 else None
            kind = part.kind if column in (None, row) else part.off_diagonal or part.kind
            variable = ""
            if column is not None and part.derivative is not None:
                variable = coordinate(platform.angle_names[column], part.derivative)
            stiff = part.derivative == 0 and column == row and found[k].factor != 0.0
            change, lost = costs.get(k, (None, None))
            yield Term(
                gimbal=gimbal,
                label=product(part.quantity(place), rate_names(part.monomial), variable),
                kind=kind,
                meaning=MEANINGS[kind],
                coefficient=float(part.coefficients[place]),
                factor=found[k].factor,
                column=None if column is None else platform.gimbal_names[column],
                derivative=part.derivative,
                size=found[k].size,
                share=found[k].size / largest,
                torque_error=found[k].size / total,
                rank=rank,
                sense=None if not stiff else "stable" if found[k].factor > 0.0 else "unstable",
                kept=kind not in DROPPED_BY_THE_PAPER,
                pole_change=change,
                poles_lost=lost,
            )
