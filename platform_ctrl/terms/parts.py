"""Every term of the exact equations, told apart: rotor by rotor, inertias, element by element."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from platform_ctrl.description import OMEGA_NAMES, Platform
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.linearisation import linearise
from platform_ctrl.mechanics.coupling import force_rounding, inertia_rounding
from platform_ctrl.mechanics.forces import element_forces, force_slopes
from platform_ctrl.parameter_varying.coefficients import (
    acceleration_part,
    bare,
    clean,
    inertia_part,
    rotor_part,
)
from platform_ctrl.parameter_varying.polynomial import MatrixPolynomial
from platform_ctrl.terms.labels import combination, symbol
from platform_ctrl.terms.table import Kind

# Name of the quantity before an entry of the equations, from its place.
Quantity = Callable[[tuple[int, ...]], str]


@value
class Part:
    """Terms of one kind that share a monomial of Omega and a derivative of the angles.

    Attributes
    ----------
    kind
        What terms on the gimbal's own angle are, and if `off_diagonal` is None the others too.
    off_diagonal
        What terms on other gimbals' angles are.
    derivative
        Of the angles, 0, 1 or 2; None for forcing terms.
    monomial
        Of Omega and Omega'.
    coefficients : (n, n) or (n,)
        Entries of the equations.
    occurs : (n, n) or (n,) bool
        Where a term stands, also one that is zero because rotors cancel.
    quantity
        Name of an entry.
    """

    kind: Kind
    derivative: int | None
    monomial: str
    coefficients: FloatArray
    occurs: FloatArray
    quantity: Quantity
    off_diagonal: Kind | None = None


def parts(platform: Platform, q: FloatArray, specific_force: FloatArray, amplitude: FloatArray) -> Iterator[Part]:
    """Yield the parts that make up the equations of all gimbals about the angles q (n,)."""
    yield from _mass(platform, q)
    yield from _rotors(platform, q)
    yield from _inertias(platform, q)
    yield from _elements(platform, q, specific_force, amplitude)


def _mass(platform: Platform, q: FloatArray) -> Iterator[Part]:
    model, rounding = linearise(bare(platform), q=q), inertia_rounding(platform)
    M = clean(model.M, rounding)
    names = platform.gimbal_names

    def inertia(place: tuple[int, ...]) -> str:
        i, j = place
        return symbol("J", names[i] if i == j else f"{names[i]},{names[j]}")

    yield _part("nutation", 2, "1", M, inertia, off_diagonal="coupling inertia")
    for a, name in enumerate(OMEGA_NAMES):
        column = clean(model.M_Omega[:, a], np.diag(rounding))

        yield _part("acceleration disturbance", None, f"{name}'", column, _own_inertia(M, column, names))


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
    M, names = linearise(bare(platform), q=q).M, platform.gimbal_names
    kinds: tuple[tuple[Kind, int | None, MatrixPolynomial], ...] = (
        ("Coriolis", 1, inertia.G),
        ("centrifugal", 0, inertia.K),
        ("centrifugal disturbance", None, inertia.Q0),
        ("inertia acceleration", 0, _without_axial(platform, q)),
    )
    for kind, derivative, polynomial in kinds:
        for monomial in polynomial.monomials:
            own = _own_inertia(M, polynomial[monomial], names if kind == "inertia acceleration" else ())
            yield _part(kind, derivative, monomial, polynomial[monomial], own)


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
    for kind, field, where, letter in families:
        for element in getattr(platform, field):
            only: dict[str, Any] = {field: (element,)}
            alone = dataclasses.replace(bare(platform), **only)

            def name(place: tuple[int, ...], given: str = symbol(letter, getattr(element, where))) -> str:
                return given

            slopes = force_slopes(alone, q, specific_force, amplitude)
            force = element_forces(alone, q, specific_force=specific_force)[3:]
            rounding = force_rounding(alone, float(np.linalg.norm(specific_force)))
            yield _part(kind, 0, "1", clean(-slopes.angle[3:], rounding), name)
            yield _part(kind, 1, "1", -slopes.rate, name)
            yield _part(kind, None, "1", clean(-force, rounding.max(axis=1, initial=0.0)), name)


def _part(
    kind: Kind,
    derivative: int | None,
    monomial: str,
    coefficients: FloatArray,
    quantity: Quantity,
    off_diagonal: Kind | None = None,
) -> Part:
    occurs = coefficients != 0.0
    return Part(
        kind=kind,
        derivative=derivative,
        monomial=monomial,
        coefficients=coefficients,
        occurs=occurs,
        quantity=quantity,
        off_diagonal=off_diagonal,
    )


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
    return Part(
        kind=kind,
        derivative=derivative,
        monomial=monomial,
        coefficients=coefficients,
        occurs=np.any(cosines != 0.0, axis=0),
        quantity=lambda place: combination(names, np.array([cosine[place] for cosine in cosines])),
    )
