"""The platform's numbers as symbols: composite inertias, axial inertias and momenta of the rotors, force elements.

Every parameter has a position; a linear form in the parameters is a vector over these positions.
"""

from __future__ import annotations

from itertools import chain
from typing import NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.mechanics.kinematics import Topology
from platform_ctrl.mechanics.symbolic.elements import ElementSymbols, Term, element_terms
from platform_ctrl.mechanics.symbolic.expressions import ONE, Algebra, Series, add, apply, product, pruned
from platform_ctrl.mechanics.symbolic.names import Kind, NamedSymbol, Names
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform


def composites(tree: Topology) -> FloatArray:
    """Return S_k at zero angles, (1 + n, 3, 3), without C; body 0 is the whole."""
    out: FloatArray = tree.inertias.copy()
    for k in reversed(tree.order):
        out[1 + tree.parents[k]] += out[1 + k]
    return out


def directions(tree: Topology, algebra: Algebra) -> Series:
    """Return B (3), coefficients (m, 3 + n)."""
    n, m = len(tree.parents), len(tree.carriers)
    rotations = [algebra.rotation(k, tree.axes[k]) for k in range(n)]
    out: Series = {}
    for rotor, carrier in enumerate(tree.carriers):
        spin: Series = {ONE: tree.spin_axes[rotor]}
        k = int(carrier) - 1
        while k >= 0:
            _place(out, apply(spin, lambda s, a=tree.axes[k]: np.asarray(s @ a)), (m, 3 + n), (rotor, 3 + k))  # type: ignore[misc]
            spin = product(algebra, rotations[k], spin, np.matmul)
            k = int(tree.parents[k])
        _place(out, spin, (m, 3 + n), (rotor, slice(0, 3)))
    return out


def mass(tree: Topology, algebra: Algebra, forms: FloatArray) -> Series:
    """Return A, coefficients (symbols, 3 + n, 3 + n); `forms` (1 + n, symbols, 3, 3) are the S_k as linear forms."""
    n, symbols = len(tree.parents), forms.shape[1]
    rotations = [algebra.rotation(k, tree.axes[k]) for k in range(n)]
    carried: list[Series] = [{ONE: form} for form in forms]
    for k in reversed(tree.order):
        half = product(algebra, rotations[k], carried[1 + k], np.matmul)
        turned = product(algebra, half, rotations[k], lambda x, r: np.asarray(x @ r.T))
        add(turned, {ONE: forms[1 + k]}, -1.0)
        above = 1 + int(tree.parents[k])
        add(carried[above], turned)
        carried[above] = pruned(carried[above])
    shape = (symbols, 3 + n, 3 + n)
    out: Series = {}
    _place(out, carried[0], shape, (slice(None), slice(0, 3), slice(0, 3)))
    for k in range(n):
        momentum = apply(carried[1 + k], lambda x, a=tree.axes[k]: np.asarray(x @ a))  # type: ignore[misc]
        i = k
        while i >= 0:
            along = apply(momentum, lambda x, a=tree.axes[i]: np.asarray(x @ a))  # type: ignore[misc]
            _place(out, along, shape, (slice(None), 3 + i, 3 + k))
            if i != k:
                _place(out, along, shape, (slice(None), 3 + k, 3 + i))
            momentum = product(algebra, momentum, rotations[i], lambda x, r: np.asarray(x @ r.T))
            i = int(tree.parents[i])
        _place(out, momentum, shape, (slice(None), slice(0, 3), 3 + k))
        _place(out, momentum, shape, (slice(None), 3 + k, slice(0, 3)))
    return pruned(out)


def axial(tree: Topology, algebra: Algebra, B: Series, forms: FloatArray) -> Series:
    """Return BᵀA_R B, coefficients (symbols, 3 + n, 3 + n), with A_R as linear forms `forms` (m, symbols)."""
    n = len(tree.parents)
    out: Series = {}
    for rotor in np.flatnonzero(forms.any(axis=1)):
        row = apply(B, lambda b, r=rotor: b[r])  # type: ignore[misc]
        add(out, product(algebra, row, row, lambda x, y, c=forms[rotor]: np.einsum("s,i,j->sij", c, x, y)))  # type: ignore[misc]
    return pruned(out) or {ONE: np.zeros((forms.shape[1], 3 + n, 3 + n))}


def spin_momenta(B: Series, forms: FloatArray) -> Series:
    """Return BᵀL, coefficients (symbols, 3 + n), with L as linear forms `forms` (m, symbols)."""
    return apply(B, lambda b: np.asarray(forms.T @ b))


def _place(into: Series, terms: Series, shape: tuple[int, ...], where: tuple[int | slice, ...]) -> None:
    for monomial, coefficient in terms.items():
        if monomial not in into:
            into[monomial] = np.zeros(shape)
        into[monomial][where] = coefficient


# An inertia this small against the largest of its body is zero.
_ZERO = 1e-15
_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


Symbols = tuple[NamedSymbol, ...]


class Motion(NamedTuple):
    """Symbols of what changes with time: Omega, Omega' and M by root axis, the others by gimbal."""

    Omega: Symbols
    Omega_dot: Symbols
    angles: Symbols
    rates: Symbols
    accelerations: Symbols
    torques: Symbols
    root_torques: Symbols


@value
class Parameters:
    """Symbols with values, and what they make of the platform."""

    symbols: tuple[NamedSymbol, ...]  # in the order of their positions
    # (1 + n, symbols, 3, 3): what turns with each body at zero angles, as linear forms; body 0 is the whole
    S: FloatArray
    # C, L: (m, symbols): axial inertias (regulated rotors alone) and angular momenta
    C: FloatArray
    L: FloatArray
    # is_momentum, is_element: (symbols,) bool: of rotors; of force elements
    is_momentum: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    is_element: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    element_terms: tuple[Term, ...]  # what the force elements add to the gimbal rows
    notes: tuple[str, ...]  # what had to be left out of the equations


def motion_symbols(platform: Platform, names: Names) -> Motion:
    """Return the symbols of angles, rates and torques: they take their names first."""
    root, gimbals, axes = platform.root_name, platform.gimbals, range(1, 4)

    def turning(dots: int, kind: Kind, what: str, unit: str) -> Symbols:
        about = (f"{what} of {root} about its axis {a}" for a in axes)
        return tuple(names.motion(name, dots, kind, one, unit) for name, one in zip(OMEGA_NAMES, about, strict=True))

    def moving(dots: int, kind: Kind, unit: str) -> Symbols:
        return tuple(names.motion(g.angle, dots, kind, f"{kind} of gimbal {g.name}", unit) for g in gimbals)

    def torque(head: str, label: str, what: str) -> NamedSymbol:
        return names.parameter(head, label, "", "torque", what, "N m", None)

    # In this order they take their names.
    return Motion(
        Omega=turning(0, "rate of the root", "rate", "rad/s"),
        Omega_dot=turning(1, "acceleration of the root", "angular acceleration", "rad/s²"),
        angles=moving(0, "angle", "rad"),
        rates=moving(1, "rate", "rad/s"),
        accelerations=moving(2, "acceleration", "rad/s²"),
        torques=tuple(torque("Q", g.name, f"torque of the torquers on gimbal {g.name}") for g in gimbals),
        root_torques=tuple(torque("M", str(a), f"torque on {root} about its axis {a}") for a in axes),
    )


def parameters(platform: Platform, tree: Topology, names: Names) -> Parameters:
    """Return the symbols of everything that has a number."""
    m = len(tree.carriers)
    symbols: list[NamedSymbol] = []
    inertias: list[tuple[int, int, int]] = []
    for body, S in enumerate(composites(tree)):
        for symbol, i, j in _inertia_symbols(platform, names, body, S):
            symbols.append(symbol)
            inertias.append((body, i, j))
    regulated = [r for r, rotor in enumerate(platform.rotors) if rotor.control != "free"]
    C_at = len(symbols)
    for rotor in (platform.rotors[r] for r in regulated):
        meaning = f"axial inertia of rotor {rotor.name}"
        symbols.append(names.parameter("C", rotor.name, "", "axial inertia", meaning, "kg m²", rotor.axial_inertia))
    L_at = len(symbols)
    for rotor in platform.rotors:
        head, where = ("p", "about its axis") if rotor.control == "free" else ("L", "in its carrier")
        meaning = f"angular momentum of rotor {rotor.name} {where}"
        symbols.append(names.parameter(head, rotor.name, "", "momentum", meaning, "N m s", rotor.angular_momentum))
    elements = ElementSymbols(names, symbols)
    terms, notes = element_terms(platform, tree, elements)
    size = len(symbols)
    S_forms = np.zeros((1 + len(platform.gimbals), size, 3, 3))
    for position, (body, i, j) in enumerate(inertias):
        S_forms[body, position, i, j] = S_forms[body, position, j, i] = 1.0
    C, L = np.zeros((m, size)), np.eye(m, size, k=L_at)
    C[regulated, C_at + np.arange(len(regulated))] = 1.0
    return Parameters(
        symbols=tuple(symbols),
        S=S_forms,
        C=C,
        L=L,
        is_momentum=np.array([s.kind == "momentum" for s in symbols], dtype=bool),
        is_element=np.array([s.kind == "element" for s in symbols], dtype=bool),
        element_terms=terms,
        notes=notes,
    )


def _inertia_symbols(platform: Platform, names: Names, body: int, S: FloatArray) -> list[tuple[NamedSymbol, int, int]]:
    """Return the symbols of one body's composite inertia with their places, the one about the gimbal's axis first."""
    label = "" if body == 0 else platform.gimbals[body - 1].name
    of = "the whole platform" if body == 0 else f"all that turns with gimbal {label}"
    own = None if body == 0 else coordinate_axis(platform.gimbals[body - 1].axis)
    out = []
    entries = sorted(_ENTRIES, key=lambda entry: entry != (own, own))
    for i, j in entries:
        if abs(S[i, j]) <= _ZERO * np.abs(S).max():
            continue
        part = f"{i + 1}" if i == j else f"{i + 1}{j + 1}"
        about = f"inertia about axis {part}" if i == j else f"product of inertia, entry {i + 1}, {j + 1},"
        if i == j == own:
            about, shown = f"{about}, its own,", (label, "")
        else:
            shown = (part, "") if body == 0 else (label, part)
        symbol = names.parameter("J", *shown, "inertia", f"{about} of {of}", "kg m²", float(S[i, j]))
        out.append((symbol, i, j))
    return out


def coordinate_axis(axis: FloatArray) -> int | None:
    """Return the index of the coordinate axis that `axis` lies along, in either sense, or None."""
    along = np.flatnonzero(axis)
    return int(along[0]) if len(along) == 1 else None


def symbol_table(
    motion: Motion, used: tuple[NamedSymbol, ...], forces: tuple[NamedSymbol, ...]
) -> tuple[NamedSymbol, ...]:
    """Return the symbols in the order in which terms are written: parameters, then what changes with time."""
    moving = (motion.Omega, motion.Omega_dot, motion.accelerations, motion.rates, motion.angles)
    return tuple(chain(used, forces, *moving, motion.torques, motion.root_torques))
