"""What springs, friction, cages, unbalance and erection add to the gimbal rows, linear about zero angles."""

from __future__ import annotations

import math
from collections import Counter
from typing import Literal, NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.mechanics.coupling import connected
from platform_ctrl.mechanics.kinematics import Topology
from platform_ctrl.mechanics.symbolic.expressions import ONE, Monomial, Series, Taylor, product, without_residue
from platform_ctrl.mechanics.symbolic.names import NamedSymbol, Names
from platform_ctrl.plant.platform import Platform

Variable = Literal["acceleration", "rate", "angle", "constant"]


class Term(NamedTuple):
    """A term of a gimbal row's left side: coefficient × parameter × factors × variable."""

    row: int
    variable: Variable
    of: int
    factors: tuple[str, ...]
    position: int
    coefficient: float


class ElementSymbols:
    """Makes the symbols of force elements; their positions follow on those of `symbols`."""

    def __init__(self, names: Names, symbols: list[NamedSymbol]) -> None:
        self._names, self._symbols = names, symbols
        self._made: Counter[tuple[str, str]] = Counter()

    def add(self, head: str, label: str, part: str, meaning: str, unit: str, number: float) -> tuple[int, str]:
        """Return the position and the name of a new parameter; a second one of the same head and label is numbered."""
        self._made[head, label + "\n" + part] += 1
        count = self._made[head, label + "\n" + part]
        part = part if count == 1 else f"{part}{count}"
        self._symbols.append(self._names.parameter(head, label, part, "element", meaning, unit, number))
        return len(self._symbols) - 1, self._symbols[-1].name


def element_terms(
    platform: Platform, tree: Topology, symbols: ElementSymbols
) -> tuple[tuple[Term, ...], tuple[str, ...]]:
    """Return the terms of all force elements on the left side (−Q), and notes on what is not among them."""
    terms: list[Term] = []
    notes: list[str] = []
    _springs(platform, symbols, terms)
    _frictions(platform, symbols, terms, notes)
    _cages(platform, symbols, terms, notes)
    _unbalances(platform, tree, symbols, terms)
    _erections(platform, tree, symbols, terms, notes)
    return tuple(terms), tuple(notes)


def _springs(platform: Platform, symbols: ElementSymbols, terms: list[Term]) -> None:
    for spring in platform.springs:
        k = platform.gimbal(spring.gimbal)
        at, _ = symbols.add("k", spring.gimbal, "", f"spring at gimbal {spring.gimbal}", "N m/rad", spring.stiffness)
        terms.append(Term(k, "angle", k, (), at, 1.0))
        if spring.rest:
            _, rest = symbols.add(
                "rest", spring.gimbal, "", "angle at which that spring is relaxed", "rad", spring.rest
            )
            terms.append(Term(k, "constant", 0, (rest,), at, -1.0))


def _frictions(platform: Platform, symbols: ElementSymbols, terms: list[Term], notes: list[str]) -> None:
    for friction in platform.frictions:
        k = platform.gimbal(friction.gimbal)
        if friction.viscous:
            meaning = f"viscous friction of gimbal {friction.gimbal}"
            at, _ = symbols.add("d", friction.gimbal, "", meaning, "N m s", friction.viscous)
            terms.append(Term(k, "rate", k, (), at, 1.0))
        if any(friction.breakaway):
            notes.append(f"dry friction of gimbal {friction.gimbal} is left out: it has no slope at rest")


def _cages(platform: Platform, symbols: ElementSymbols, terms: list[Term], notes: list[str]) -> None:
    for cage in platform.cages:
        k, name = platform.gimbal(cage.gimbal), cage.gimbal
        if cage.clearance and abs(cage.angle) <= cage.clearance:
            notes.append(f"cage of gimbal {name} is left out: within its clearance it does not act")
            continue
        at, _ = symbols.add("k", name, "c", f"stiffness of the cage of gimbal {name}", "N m/rad", cage.stiffness)
        terms.append(Term(k, "angle", k, (), at, 1.0))
        if cage.angle:
            _, middle = symbols.add("rest", name, "c", "middle of that cage", "rad", cage.angle)
            terms.append(Term(k, "constant", 0, (middle,), at, -1.0))
        if cage.clearance:
            _, play = symbols.add(
                "gap", name, "", "clearance of that cage, taken up at zero angle", "rad", cage.clearance
            )
            terms.append(Term(k, "constant", 0, (play,), at, math.copysign(1.0, cage.angle)))
        if cage.damping:
            at, _ = symbols.add("d", name, "c", f"damping of the cage of gimbal {name}", "N m s", cage.damping)
            terms.append(Term(k, "rate", k, (), at, 1.0))


def _unbalances(platform: Platform, tree: Topology, symbols: ElementSymbols, terms: list[Term]) -> None:
    """−∂/∂q of f · (m r), to first order in the angles."""
    n = len(platform.gimbals)
    for body, name in enumerate(platform.gimbal_names, 1):
        moment = sum((u.moment for u in platform.unbalances if u.body == name), np.zeros(3))
        if not moment.any():
            continue
        turned = _rotation(tree, body)
        on_path = tree.on_path[body]
        for i in np.flatnonzero(moment):
            about = f"mass moment of gimbal {name} along axis {i + 1}"
            at, _ = symbols.add("m", name, str(i + 1), about, "kg m", float(moment[i]))
            for j in np.flatnonzero(on_path):
                for a in range(3):
                    f = (f"f{a + 1}",)
                    terms.append(Term(int(j), "constant", 0, f, at, _at(turned, (int(j),))[a, i]))
                    for k in range(n):
                        both = tuple(sorted((int(j), k)))
                        slope = (2.0 if j == k else 1.0) * _at(turned, both)[a, i]
                        terms.append(Term(int(j), "angle", k, f, at, slope))


def _erections(
    platform: Platform, tree: Topology, symbols: ElementSymbols, terms: list[Term], notes: list[str]
) -> None:
    n, size = len(platform.gimbals), float(np.linalg.norm(platform.specific_force))
    for device in platform.erections:
        name, k = device.gimbal, platform.gimbal(device.gimbal)
        if size == 0.0:
            notes.append(f"erection of gimbal {name} is left out: there is no specific force")
            continue
        torque = device.gain * float(device.axis @ platform.specific_force) / size
        if device.limit is not None and abs(torque) >= device.limit:
            at, _ = symbols.add("limit", name, "", f"limit of the erection of gimbal {name}", "N m", device.limit)
            terms.append(Term(k, "constant", 0, (), at, -math.copysign(1.0, torque)))
            notes.append(f"erection of gimbal {name} is at its limit at zero angles")
            continue
        at, _ = symbols.add("e", name, "", f"gain of the erection of gimbal {name}", "N m", device.gain)
        body = platform.body(device.senses)
        turned = _rotation(tree, body)
        for a in range(3):
            factors = (f"f{a + 1}", "1/f")
            terms.append(Term(k, "constant", 0, factors, at, -float(device.axis[a])))
            for j in range(n):
                slope = _at(turned, (j,))[a] @ device.axis
                terms.append(Term(k, "angle", j, factors, at, -float(slope)))


def _rotation(tree: Topology, body: int) -> Series:
    """Return the rotation from body axes to root axes, to second order."""
    algebra = Taylor(2)
    out: Series = {ONE: np.eye(3)}
    k = body - 1
    while k >= 0:
        out = product(algebra, algebra.rotation(k, tree.axes[k]), out, np.matmul)
        k = int(tree.parents[k])
    return out


def _at(series: Series, monomial: tuple[int, ...]) -> FloatArray:
    return series.get(monomial, np.zeros((3, 3)))


Factors = tuple[str, ...]
Forms = dict[Factors, FloatArray]
Row = dict[tuple[Variable, int], Forms]

_ROOT = range(3)


def gimbal_rows(
    A_star: Series,
    BtL: Series,
    carried: Series | None,
    names: tuple[tuple[str, ...], tuple[str, ...]],
    elements: tuple[Term, ...],
) -> tuple[Row, ...]:
    """Return the left side of every gimbal row.

    Parameters
    ----------
    A_star, BtL
        To second order in the angles; coefficients (symbols, 3 + n, 3 + n) and (symbols, 3 + n).
    carried
        None: exact. With the paper's rule BᵀA_R B, whose slope is the coefficient of Ω̇ q.
    names
        Of Omega1 to Omega3, and of their derivatives.
    elements
        What force elements add.
    """
    rates, changes = names
    zero = np.zeros_like(next(iter(A_star.values())))
    n = zero.shape[1] - 3

    def slope(series: Series, *angles: int) -> FloatArray:
        monomial: Monomial = tuple(sorted(angles))
        out = series.get(monomial, zero if series is not BtL else zero[:, :, 0])
        return 2.0 * out if len(angles) == 2 and angles[0] == angles[1] else out

    exact = carried is None
    before_change = A_star if carried is None else carried
    rest = slope(A_star)
    rows: list[Row] = [{} for _ in range(n)]
    for j, row in enumerate(rows):
        by_j, spin_by_j = slope(A_star, j), slope(BtL, j)
        constant = row.setdefault(("constant", 0), {})
        for a in _ROOT:
            _add(constant, (changes[a],), rest[:, 3 + j, a])
            _add(constant, (rates[a],), -spin_by_j[:, a])
        if exact:
            _add_squares(constant, rates, by_j)
        for k in range(n):
            _add(row.setdefault(("acceleration", k), {}), (), rest[:, 3 + j, 3 + k])
            by_k, spin_by_k, spin_by_both = slope(A_star, k), slope(BtL, k), slope(BtL, j, k)
            rate, angle = row.setdefault(("rate", k), {}), row.setdefault(("angle", k), {})
            _add(rate, (), spin_by_k[:, 3 + j] - spin_by_j[:, 3 + k])
            for a in _ROOT:
                _add(angle, (rates[a],), -spin_by_both[:, a])
                _add(angle, (changes[a],), slope(before_change, k)[:, 3 + j, a])
                if exact:
                    _add(rate, (rates[a],), by_k[:, 3 + j, a] - by_j[:, 3 + k, a])
            if exact:
                _add_squares(angle, rates, slope(A_star, j, k))
    for term in elements:
        form = np.zeros(len(zero))
        form[term.position] = term.coefficient
        _add(rows[term.row].setdefault((term.variable, term.of), {}), term.factors, form)
    return tuple(rows)


def at_rest(row: Row, moving: tuple[str, ...]) -> Row:
    """Return (19): linear in the angles and in Omega, whose components and derivatives are `moving`, together."""

    def kept(variable: Variable, factors: Factors) -> bool:
        return sum(name in moving for name in factors) <= (variable == "constant")

    return {
        (variable, k): {factors: form for factors, form in forms.items() if kept(variable, factors)}
        for (variable, k), forms in row.items()
    }


def without_inertia(row: Row, kept: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Row:
    """Return (15): only what contains a parameter of `kept`, momenta and force elements."""
    return {
        where: {factors: np.where(kept, form, 0.0) for factors, form in forms.items()}
        for where, forms in row.items()
        if where[0] != "acceleration"
    }


def coupled_groups(rows: tuple[Row, ...]) -> tuple[tuple[int, ...], ...]:
    """Return the gimbals whose equations are coupled when Omega is given, group by group."""
    coupled = np.zeros((len(rows), len(rows)), dtype=bool)
    for j, row in enumerate(rows):
        for (variable, k), forms in row.items():
            coupled[j, k] |= variable != "constant" and any(form.any() for form in forms.values())
    return tuple(map(tuple, connected(coupled)))


def _add_squares(into: Forms, rates: tuple[str, ...], slope: FloatArray) -> None:
    """Add −½ Ω_a Ω_b slope_ab."""
    for a in _ROOT:
        _add(into, (rates[a], rates[a]), -0.5 * slope[:, a, a])
        for b in range(a):
            _add(into, (rates[b], rates[a]), -slope[:, a, b])


def _add(into: Forms, factors: Factors, form: FloatArray) -> None:
    kept = without_residue(form)
    if kept.any():
        into[factors] = into[factors] + kept if factors in into else kept
