"""What springs, friction, cages, unbalance and erection add to the gimbal rows, linear about zero angles."""

from __future__ import annotations

import math
from collections import Counter
from typing import Literal, NamedTuple

import numpy as np

from platform_ctrl.description import Platform
from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.symbolic.names import NamedSymbol, Names
from platform_ctrl.symbolic.series import ONE, Series, Taylor, product

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


def element_terms(platform: Platform, symbols: ElementSymbols) -> tuple[tuple[Term, ...], tuple[str, ...]]:
    """Return the terms of all force elements on the left side (−Q), and notes on what is not among them."""
    terms: list[Term] = []
    notes: list[str] = []
    _springs(platform, symbols, terms)
    _frictions(platform, symbols, terms, notes)
    _cages(platform, symbols, terms, notes)
    _unbalances(platform, symbols, terms)
    _erections(platform, symbols, terms, notes)
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


def _unbalances(platform: Platform, symbols: ElementSymbols, terms: list[Term]) -> None:
    """−∂/∂q of f · (m r), to first order in the angles."""
    n = len(platform.gimbals)
    for body, name in enumerate(platform.gimbal_names, 1):
        moment = sum((u.moment for u in platform.unbalances if u.body == name), np.zeros(3))
        if not moment.any():
            continue
        turned = _rotation(platform, body)
        on_path = topology(platform).on_path[body]
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


def _erections(platform: Platform, symbols: ElementSymbols, terms: list[Term], notes: list[str]) -> None:
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
        turned = _rotation(platform, body)
        for a in range(3):
            factors = (f"f{a + 1}", "1/f")
            terms.append(Term(k, "constant", 0, factors, at, -float(device.axis[a])))
            for j in range(n):
                slope = _at(turned, (j,))[a] @ device.axis
                terms.append(Term(k, "angle", j, factors, at, -float(slope)))


def _rotation(platform: Platform, body: int) -> Series:
    """Return the rotation from body axes to root axes, to second order."""
    tree, algebra = topology(platform), Taylor(2)
    out: Series = {ONE: np.eye(3)}
    k = body - 1
    while k >= 0:
        out = product(algebra, algebra.rotation(k, tree.axes[k]), out, np.matmul)
        k = int(tree.parents[k])
    return out


def _at(series: Series, monomial: tuple[int, ...]) -> FloatArray:
    return series.get(monomial, np.zeros((3, 3)))
