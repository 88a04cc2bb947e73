"""What the terms of the gimbal equations mean, how large each is, and what dropping it costs."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import positive, real_array
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.coupling import connected, force_rounding, inertia_rounding
from platform_ctrl.mechanics.forces import ForceElements
from platform_ctrl.mechanics.kinematics import kinematics, topology
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.polynomials import (
    MatrixPolynomial,
    acceleration_part,
    clean,
    inertia_part,
    monomial_values,
    rotor_part,
    without_elements,
)
from platform_ctrl.mechanics.term_table import (
    DROPPED_BY_THE_PAPER,
    MEANINGS,
    Kind,
    Term,
    TermTable,
    combination,
    coordinate,
    product,
    symbol,
)
from platform_ctrl.mechanics.term_table import rates as rate_names
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

# Name of the quantity before an entry of the equations, from its place.
Quantity = Callable[[tuple[int, ...]], str]


class Part(NamedTuple):
    """Terms of one kind that share a monomial of Omega and a derivative of the angles."""

    kind: Kind  # what terms on the gimbal's own angle are, and if `off_diagonal` is None the others too
    derivative: int | None  # of the angles, 0, 1 or 2; None for forcing terms
    monomial: str  # of Omega and Omega'
    coefficients: FloatArray  # (n, n) or (n,): entries of the equations
    quantity: Quantity  # name of an entry
    off_diagonal: Kind | None = None  # what terms on other gimbals' angles are
    # (n, n) or (n,) bool, optional: where there is a term, also one that is zero because rotors cancel; default the
    # entries that are not zero
    places: FloatArray | None = None


def parts(platform: Platform, q: FloatArray, specific_force: FloatArray, amplitude: FloatArray) -> Iterator[Part]:
    """Yield the parts that make up the equations of all gimbals about the angles q (n,)."""
    yield from _mass(platform, q)
    yield from _rotors(platform, q)
    yield from _inertias(platform, q)
    yield from _elements(platform, q, specific_force, amplitude)


def _mass(platform: Platform, q: FloatArray) -> Iterator[Part]:
    model, rounding = linearise(without_elements(platform), q=q), inertia_rounding(topology(platform))
    M = clean(model.M, rounding)
    names = platform.gimbal_names

    def inertia(place: tuple[int, ...]) -> str:
        i, j = place
        return symbol("J", names[i] if i == j else f"{names[i]},{names[j]}")

    own: Kind = "nutation" if platform.rotors else "inertia"
    yield Part(own, 2, "1", M, inertia, off_diagonal="coupling inertia")
    for a, name in enumerate(OMEGA_NAMES):
        column = clean(model.M_Omega[:, a], np.diag(rounding))

        yield Part("acceleration disturbance", None, f"{name}'", column, _own_inertia(M, column, names))


def _rotors(platform: Platform, q: FloatArray) -> Iterator[Part]:
    """L and C enter linearly: each rotor alone, with one in place of its own number, gives its direction cosines."""
    rotors, count = platform.rotors, len(platform.rotors)
    if not count:
        return
    unit = []
    turning = []
    for r in range(count):
        one = [dataclasses.replace(rotor, angular_momentum=float(k == r)) for k, rotor in enumerate(rotors)]
        unit.append(rotor_part(dataclasses.replace(platform, rotors=tuple(one)), q))
        one = [dataclasses.replace(rotor, axial_inertia=float(k == r)) for k, rotor in enumerate(rotors)]
        turning.append(acceleration_part(dataclasses.replace(platform, rotors=tuple(one)), q, "paper"))
    L = np.array([rotor.angular_momentum for rotor in rotors])
    C = np.array([rotor.axial_inertia for rotor in rotors])
    momenta = [symbol("p" if rotor.control == "free" else "L", rotor.name) for rotor in rotors]
    yield _sum_of("gyroscopic action", 1, "1", L, momenta, [part.G for part in unit])
    for name in OMEGA_NAMES:
        yield _sum_of("gyroscopic restraint", 0, name, L, momenta, [part.K for part in unit])
        yield _sum_of("gyroscopic disturbance", None, name, L, momenta, [part.Q0 for part in unit])
        yield _sum_of("rotor acceleration", 0, f"{name}'", C, [symbol("C", rotor.name) for rotor in rotors], turning)


def _inertias(platform: Platform, q: FloatArray) -> Iterator[Part]:
    inertia = inertia_part(platform, q)
    M, names = linearise(without_elements(platform), q=q).M, platform.gimbal_names
    kinds: tuple[tuple[Kind, int | None, MatrixPolynomial], ...] = (
        ("Coriolis", 1, inertia.G),
        ("centrifugal", 0, inertia.K),
        ("centrifugal disturbance", None, inertia.Q0),
        ("inertia acceleration", 0, _without_axial(platform, q)),
    )
    for kind, derivative, polynomial in kinds:
        for monomial in polynomial.monomials:
            own = _own_inertia(M, polynomial[monomial], names if kind == "inertia acceleration" else ())
            yield Part(kind, derivative, monomial, polynomial[monomial], own)


def _own_inertia(M: FloatArray, coefficients: FloatArray, names: tuple[str, ...]) -> Quantity:
    """Return what calls an entry ±J of the row's gimbal where it is just that, otherwise J without a number."""

    def named(place: tuple[int, ...]) -> str:
        entry, own = coefficients[place], M[place[0], place[0]]
        if names and np.isclose(abs(entry), own, rtol=1e-12, atol=0.0):
            return ("−" if entry < 0.0 else "") + symbol("J", names[place[0]])
        return "J"

    return named


def _without_axial(platform: Platform, q: FloatArray) -> MatrixPolynomial:
    rotors = tuple(dataclasses.replace(rotor, axial_inertia=0.0) for rotor in platform.rotors)
    return acceleration_part(dataclasses.replace(platform, rotors=rotors), q, "exact")


def _elements(platform: Platform, q: FloatArray, specific_force: FloatArray, amplitude: FloatArray) -> Iterator[Part]:
    families: tuple[tuple[Kind, str, str, str], ...] = (
        ("spring", "springs", "gimbal", "k"),
        ("friction", "frictions", "gimbal", "d"),
        ("cage", "cages", "gimbal", "cage"),
        ("unbalance", "unbalances", "body", "(m r f)"),
        ("erection", "erections", "gimbal", "e"),
    )
    at = kinematics(platform, q)
    for kind, field, where, letter in families:
        for element in getattr(platform, field):
            only: dict[str, Any] = {field: (element,)}
            alone = dataclasses.replace(without_elements(platform), **only)

            def name(place: tuple[int, ...], given: str = symbol(letter, getattr(element, where))) -> str:
                return given

            acting = ForceElements(alone, at, specific_force)
            slopes, force = acting.slopes(q, amplitude), acting.forces(q, np.zeros(len(q)))[3:]
            rounding = force_rounding(alone, at.tree, float(np.linalg.norm(specific_force)))
            yield Part(kind, 0, "1", clean(-slopes.angle[3:], rounding), name)
            yield Part(kind, 1, "1", -slopes.rate, name)
            yield Part(kind, None, "1", clean(-force, rounding.max(axis=1, initial=0.0)), name)


def _sum_of(
    kind: Kind,
    derivative: int | None,
    monomial: str,
    sizes: FloatArray,
    names: list[str],
    units: list[MatrixPolynomial],
) -> Part:
    cosines = np.array([unit[monomial] for unit in units])
    coefficients = np.tensordot(sizes, cosines, axes=1)

    def named(place: tuple[int, ...]) -> str:
        return combination(names, np.array([cosine[place] for cosine in cosines]))

    return Part(kind, derivative, monomial, coefficients, named, places=np.any(cosines != 0.0, axis=0))


# Against matrices that are scaled to ones.
_ZERO = 1e-12


def poles(M: FloatArray, G: FloatArray, K: FloatArray) -> FloatArray:
    """Return the finite s for which s² M + s G + K is singular, complex; none where it is singular for every s.

    Dropping an inertia leaves constraints, whose infinite poles are defective and come out of a solver as merely
    large. So they are taken out first, by rank.
    """
    k = len(M)
    diagonal = np.abs(np.diag(M))
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, diagonal.max(initial=0.0) or 1.0))
    M, G, K = (scale[:, None] * matrix * scale for matrix in (M, G, K))
    fast = max(np.abs(G).max(initial=0.0), np.sqrt(np.abs(K).max(initial=0.0))) or 1.0
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-K / fast**2, -G / fast]])
    E = np.block([[np.eye(k), np.zeros((k, k))], [np.zeros((k, k)), M]])
    while len(E):
        left, sizes, _ = np.linalg.svd(E)
        rank = int(np.sum(sizes > _ZERO * max(1.0, sizes[0])))
        if rank == len(E):
            return np.asarray(fast * np.linalg.eigvals(np.linalg.solve(E, A)))
        A, E = left.T @ A, left.T @ E
        # The rows without E say A_low x = 0: what is left of x moves in their null space.
        length = np.linalg.norm(A[rank:], axis=1)
        if length.min() < _ZERO:
            break
        _, independent, right = np.linalg.svd(A[rank:] / length[:, None])
        if independent[-1] < _ZERO:
            break
        free = right[len(A) - rank :].T
        A, E = A[:rank] @ free, E[:rank] @ free
    return np.zeros(0, dtype=np.complex128)


def pole_change(before: FloatArray, after: FloatArray, slowest: float) -> tuple[float, int]:
    """Return the largest relative change of the poles that remain, and how many are lost.

    Poles are matched so that the relative changes add up to the least. Relative to a pole's size, or to `slowest`,
    rad/s, where it is less: poles at the origin have no size.
    """
    from scipy.optimize import linear_sum_assignment

    lost = len(before) - len(after)
    if not len(after) or not len(before):
        return 0.0, max(lost, 0)
    size = np.maximum(np.abs(before), slowest)[:, None]
    change = np.abs(before[:, None] - after[None, :]) / size
    rows, columns = linear_sum_assignment(change)
    return float(change[rows, columns].max()), max(lost, 0)


# Poles slower than this part of the motion's frequency are standing still for it.
_SLOWEST = 0.01


@check_arguments
def terms(  # noqa: PLR0913 - options by keyword
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
    # A gimbal at rest has no rate amplitude, and its friction no describing function.
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
    """One term: its place, its coefficient, its amplitude."""

    part: Part
    place: tuple[int, ...]
    factor: float
    size: float


def _entries(
    part: Part, Omega: FloatArray, Omega_dot: FloatArray, amplitudes: dict[int, FloatArray]
) -> Iterator[_Entry]:
    rates_before = float(monomial_values((part.monomial,), Omega, Omega_dot)[0])
    places = part.coefficients if part.places is None else part.places
    for place in zip(*(k.tolist() for k in np.nonzero(places)), strict=True):
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
