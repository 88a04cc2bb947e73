"""The symbols of a platform, and polynomials in them: up to an order in the angles, or exact in sines and cosines.

Vectors and matrices of polynomials are object arrays of elements of SymPy's sparse polynomial rings.
"""

from __future__ import annotations

import builtins
import keyword
import unicodedata
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any, Literal, NamedTuple

import numpy as np
import sympy
from sympy.polys.rings import PolyRing

from platform_ctrl.common.text import dotted
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.mechanics.forces import ForceElements, specific_force_at
from platform_ctrl.mechanics.kinematics import Topology, cross_matrix, kinematics
from platform_ctrl.mechanics.matrices import derivatives
from platform_ctrl.mechanics.polynomials import without_elements
from platform_ctrl.plant.gimbals import Body
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

Kind = Literal["inertia", "axial inertia", "momentum", "element", "torque", "root", "acceleration", "rate", "angle"]

# An inertia this small against the largest of its body is zero.
_ZERO = 1e-15
_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@value
class NamedSymbol:
    """A symbol of the equations."""

    name: str  # of the SymPy symbol: an identifier that neither Python nor SymPy has taken
    # text, latex: how it is shown
    text: str
    latex: str
    kind: Kind  # what sort of quantity it is
    # meaning, unit: one line; SI
    meaning: str
    unit: str
    value: float | None = None  # the platform's number, SI; None for what changes with time


class SymbolNames:
    """Makes symbols with names and texts that occur only once."""

    def __init__(self) -> None:
        self._names: set[str] = set()
        self._texts: set[str] = set()

    def symbol(
        self, plain: str, kind: Kind, meaning: str, unit: str, number: float | None = None, dots: int = 0
    ) -> NamedSymbol:
        """Return the symbol that is called `plain`, or a derivative of it."""
        name = identifier(plain + ("", "_dot", "_ddot")[dots])
        primes = 0
        while name in self._names:
            name, primes = f"{name}_", primes + 1
        self._names.add(name)
        text = "_".join((dotted(plain, dots) if kind in ("root", "angle", "rate", "acceleration") else plain).split())
        text = name if text in self._texts else text
        self._texts.add(text)
        plain_latex = sympy.latex(sympy.Symbol(identifier(plain).rstrip("_")))
        latex = ("{}", r"\dot{{{}}}", r"\ddot{{{}}}")[dots].format(plain_latex) + "'" * primes
        return NamedSymbol(name=name, text=text, latex=latex, kind=kind, meaning=meaning, unit=unit, value=number)


def identifier(wanted: str) -> str:
    """Return the nearest identifier to a name that Python, its built-in functions and SymPy leave free."""
    name = "".join(c if c.isalnum() else "_" for c in unicodedata.normalize("NFKC", wanted))
    name = name if name.isidentifier() else "q_" + name
    name = name if name.isidentifier() else "q_" + "_".join(str(ord(c)) for c in wanted)
    return name + "_" if keyword.iskeyword(name) or hasattr(builtins, name) or hasattr(sympy, name) else name


def joined(head: str, label: str, part: str = "") -> str:
    """Return the name of a quantity of a part of the plant: L6, J_outer, J5_1."""
    digits = not label or (label.isascii() and label[0].isdigit())
    return f"{head}{'' if digits else '_'}{label}{'_' * bool(part)}{part}"


# Kind; body (0: the root) or geared motor; row or axis, column.
BodyNumber = tuple[Literal["inertia", "moment", "joint", "motor", "whole"], int, int, int]


class Motion(NamedTuple):
    """Symbols of what changes with time: Omega, Omega' and M by root axis, the others by gimbal."""

    Omega: tuple[NamedSymbol, ...]
    Omega_dot: tuple[NamedSymbol, ...]
    accelerations: tuple[NamedSymbol, ...]
    rates: tuple[NamedSymbol, ...]
    angles: tuple[NamedSymbol, ...]
    torques: tuple[NamedSymbol, ...]
    root_torques: tuple[NamedSymbol, ...]

    @property
    def moving(self) -> tuple[NamedSymbol, ...]:
        """All but the torques."""
        return sum(self[:5], ())


def motion_symbols(platform: Platform, names: SymbolNames) -> Motion:
    """Return the symbols of angles, rates and torques: they take their names first."""
    root, gimbals = platform.root_name, platform.gimbals

    def turning(dots: int, what: str, unit: str) -> tuple[NamedSymbol, ...]:
        about = ((name, f"{what} of {root} about its axis {a}") for a, name in enumerate(OMEGA_NAMES, 1))
        return tuple(names.symbol(name, "root", meaning, unit, dots=dots) for name, meaning in about)

    def moving(dots: int, kind: Kind, unit: str) -> tuple[NamedSymbol, ...]:
        return tuple(names.symbol(g.angle, kind, f"{kind} of gimbal {g.name}", unit, dots=dots) for g in gimbals)

    Omega, Omega_dot = turning(0, "rate", "rad/s"), turning(1, "angular acceleration", "rad/s²")
    angles, rates = moving(0, "angle", "rad"), moving(1, "rate", "rad/s")
    accelerations = moving(2, "acceleration", "rad/s²")
    torques = [(joined("Q", g.name), f"torque of the torquers on gimbal {g.name}") for g in gimbals]
    on_root = [(f"M{a}", f"torque on {root} about its axis {a}") for a in range(1, 4)]
    Q, M = (tuple(names.symbol(*one[:1], "torque", one[1], "N m") for one in some) for some in (torques, on_root))
    return Motion(Omega, Omega_dot, accelerations, rates, angles, Q, M)


def body_symbols(platform: Platform, tree: Topology, names: SymbolNames) -> dict[BodyNumber, NamedSymbol]:
    """Return the symbols of what turns with each body at zero angles, without C, by what they are and of which body.

    Inertias, then first moments, joints, geared rotors and 1/m.
    """
    out: dict[BodyNumber, NamedSymbol] = {}
    bodies = [Body(float(m), c, J) for m, c, J in zip(tree.masses, tree.centres, tree.inertias, strict=True)]
    for k in reversed(tree.order):
        bodies[1 + tree.parents[k]] |= bodies[1 + k].moved(tree.joints[k])
    labels = ["", *platform.gimbal_names]
    carried = ["the whole platform", *(f"all that turns with gimbal {name}" for name in platform.gimbal_names)]
    for body, composite in enumerate(bodies):
        S = composite.inertia_about_origin
        along = np.flatnonzero(platform.gimbals[body - 1].axis).tolist() if body else []
        own = along[0] if len(along) == 1 else None
        for i, j in sorted(_ENTRIES, key=lambda entry: entry != (own, own)):  # that about the gimbal's axis first
            if abs(S[i, j]) <= _ZERO * np.abs(S).max():
                continue
            part = f"{i + 1}" if i == j else f"{i + 1}{j + 1}"
            about = f"inertia about axis {part}" if i == j else f"product of inertia, entry {i + 1}, {j + 1},"
            about += ", its own," * (i == j == own)
            shown = joined("J", part) if body == 0 else joined("J", labels[body], "" if i == j == own else part)
            meaning = f"{about} of {carried[body]}"
            out["inertia", body, i, j] = names.symbol(shown, "inertia", meaning, "kg m²", float(S[i, j]))

    def listed(kind: Literal["moment", "joint"], body: int, head: str, meaning: str, unit: str, x: FloatArray) -> None:
        for i in np.flatnonzero(np.abs(x) > _ZERO * np.abs(x).max()).tolist():
            name, about = joined(head, labels[body], f"{i + 1}"), f"{meaning} along axis {i + 1}"
            out[kind, body, i, 0] = names.symbol(name, "inertia", about, unit, float(x[i]))

    for body in range(0 if tree.floating else 1, len(bodies)):
        moment = bodies[body].mass * bodies[body].centre
        listed("moment", body, "S", f"first moment of {carried[body]}", "kg m", moment)
    for body, joint in enumerate(tree.joints, 1):
        listed("joint", body, "d", f"joint of gimbal {labels[body]} from that of its parent", "m", joint)
    for j, (k, J) in enumerate(zip(tree.geared, tree.gear_inertias, strict=True)):
        label = platform.gimbals[k].name
        meaning = f"inertia of the motor's rotor at gimbal {label}"
        out["motor", j, 0, 0] = names.symbol(joined("Jm", label), "inertia", meaning, "kg m²", float(J))
    if tree.floating:
        meaning = "reciprocal of the whole platform's mass"
        out["whole", 0, 0, 0] = names.symbol("w", "inertia", meaning, "1/kg", 1.0 / tree.mass)
    return out


def rotor_symbols(platform: Platform, names: SymbolNames) -> tuple[list[NamedSymbol | None], list[NamedSymbol]]:
    """Return the symbols of the rotors' axial inertias, None of free ones, and of their momenta."""
    C: list[NamedSymbol | None] = []
    for rotor in platform.rotors:
        name, meaning = joined("C", rotor.name), f"axial inertia of rotor {rotor.name}"
        free = rotor.control == "free"
        C.append(None if free else names.symbol(name, "axial inertia", meaning, "kg m²", rotor.axial_inertia))
    L = []
    for rotor in platform.rotors:
        head, where = ("p", "about its axis") if rotor.control == "free" else ("L", "in its carrier")
        meaning = f"angular momentum of rotor {rotor.name} {where}"
        L.append(names.symbol(joined(head, rotor.name), "momentum", meaning, "N m s", rotor.angular_momentum))
    return C, L


class Element(NamedTuple):
    """What a force element adds to the left side of the gimbal rows per unit of its symbol, linear about zero."""

    symbol: NamedSymbol
    angle: FloatArray  # (n, n)
    rate: FloatArray  # (n, n)
    constant: FloatArray  # (n,)


def elements(platform: Platform, names: SymbolNames) -> tuple[list[Element], list[str]]:
    """Return the force elements about zero angles, under the platform's specific force, and notes."""
    n, f = len(platform.gimbals), specific_force_at(platform)
    out, notes = list[Element](), list[str]()
    for friction in platform.frictions:
        if any(friction.breakaway):
            notes.append(f"dry friction of gimbal {friction.gimbal} is left out: it has no slope at rest")
    for cage in platform.cages:
        if cage.clearance and abs(cage.angle) <= cage.clearance:
            notes.append(f"cage of gimbal {cage.gimbal} is left out: within its clearance it does not act")
    for drive in platform.compliances:
        if drive.play:
            notes.append(f"play of the drive of gimbal {drive.gimbal} is left out: its gear is closed")
    if platform.erections and not f.any():
        notes.append("erection is left out: there is no specific force")
    for mode in platform.modes:
        notes.append(f"mode {mode.name} is left out: linear models and runs have it")
    families = (
        ("compliances", "gimbal", "ks", "stiffness of the drive of gimbal {}", "N m/rad", "strength"),
        ("compliances", "gimbal", "ds", "damping of the drive of gimbal {}", "N m s", "damping"),
        ("springs", "gimbal", "k", "spring at gimbal {}", "N m/rad", "stiffness"),
        ("servos", "gimbal", "kv", "torque of the servo of gimbal {} per rate", "N m s", "damping"),
        ("servos", "gimbal", "ka", "torque of the servo of gimbal {} per angle", "N m/rad", "stiffness"),
        ("frictions", "gimbal", "d", "viscous friction of gimbal {}", "N m s", "viscous"),
        ("cages", "gimbal", "kc", "stiffness of the cage of gimbal {}", "N m/rad", "stiffness"),
        ("cages", "gimbal", "dc", "damping of the cage of gimbal {}", "N m s", "damping"),
        ("unbalances", "body", "m", "size of the mass moment of {}", "kg m", "moment"),
        ("erections", "gimbal", "e", "gain of the erection of gimbal {}", "N m", "gain"),
    )
    at, alone, still = kinematics(platform, np.zeros(n)), without_elements(platform), np.zeros(n)
    for field, where, head, meaning, unit, strength in families:
        for element in getattr(platform, field):
            acting = ForceElements(replaced(alone, {field: (element,)}), at, f)
            slopes = acting.slopes(still)
            if strength in ("viscous", "damping"):
                parts = np.zeros((n, n)), -slopes.rate, still
            else:
                parts = -slopes.angle[3:], np.zeros((n, n)), -acting.forces(still, still)[3:]
            number, label = getattr(element, strength), getattr(element, where)
            size = float(np.linalg.norm(number) if np.ndim(number) else number)
            if size and any(part.any() for part in parts):
                symbol = names.symbol(joined(head, label), "element", meaning.format(label), unit, size)
                out.append(Element(symbol, *(part / size for part in parts)))
    change, P = derivatives(at).P[:, :, 3:], at.momentum[:, 3:]
    if f.any() and (P.any() or change.any()) and not at.tree.floating:
        size = float(np.linalg.norm(f))
        symbol = names.symbol("f", "element", "size of the specific force of the root's origin", "m/s²", size)
        out.append(Element(symbol, np.einsum("a,jak->kj", f / size, change), np.zeros((n, n)), P.T @ f / size))
    return out, notes


Expression = Any  # SymPy ships no types
Polynomial = Any
Array = np.ndarray[Any, np.dtype[np.object_]]

# Axes have length 1: a coefficient this small is what rounding leaves of zero.
_RESIDUE = sympy.QQ(1, 10**14)
# Coefficients of simple axes are fractions of small numbers (Taylor's factorials); others stay floats.
_DENOMINATOR, _ROUNDING = 1000, 2e-15


def rational(number: float) -> Fraction:
    """Return the fraction of small numbers that a float is but for rounding, or the float."""
    near = Fraction(number).limit_denominator(_DENOMINATOR)
    return near if abs(number - near) <= _ROUNDING * abs(number) else Fraction(number)


def _each(array: np.ndarray[Any, Any], function: Callable[[Any], Any]) -> Array:
    return np.asarray(np.frompyfunc(function, 1, 1)(array), dtype=object)


class Polynomials:
    """Polynomials in `fixed` parameters, in what moves, and in the angles, whose symbols are the last ones."""

    def __init__(self, fixed: int, symbols: Sequence[Expression], angles: int, order: int | None) -> None:
        self._fixed, self._n, self._order, self._first = fixed, angles, order, len(symbols) - angles
        turns = [*symbols[self._first :]]
        if order is None:
            turns = [*map(sympy.cos, turns), *map(sympy.sin, turns)]
        self._shown = [*symbols[: self._first], *turns]
        self._ring = PolyRing([f"x{k}" for k in range(len(self._shown))], sympy.QQ)
        own = self._ring.gens[self._first :]
        # What is zero with sines and cosines: remainders of it are of one form, cos² being 1 − sin².
        self._squares = [c**2 + s**2 - 1 for c, s in zip(own[:angles], own[angles:], strict=False)]

    def symbol(self, k: int) -> Polynomial:
        """Return a symbol by its place; not an angle of an exact form."""
        return self._ring.gens[k]

    def symbols(self, places: Sequence[int]) -> Array:
        """Return symbols by their places."""
        return np.array([self.symbol(k) for k in places], dtype=object)

    def numbers(self, array: FloatArray) -> Array:
        """Return an array of numbers as polynomials."""
        return _each(array, lambda x: self._ring.ground_new(sympy.QQ(*rational(float(x)).as_integer_ratio())))

    def zeros(self, *shape: int) -> Array:
        """Return zeros."""
        return np.full(shape, self._ring.zero, dtype=object)

    def cut(self, array: Array, order: int | None = None) -> Array:
        """Return the array without what lies beyond the order in the angles, and without residues of rounding."""
        return _each(array, lambda p: self._kept(p, self._order if order is None else order))

    def product(self, left: Array, right: Array) -> Array:
        """Return a matrix product, cut off."""
        return self.cut(np.asarray(left @ right, dtype=object))

    def _kept(self, polynomial: Polynomial, order: int | None) -> Polynomial:
        whole = self._ring(polynomial)
        terms = (whole.rem(self._squares) if self._squares else whole).items()
        kept = {m: c for m, c in terms if abs(c) > _RESIDUE and (order is None or sum(m[self._first :]) <= order)}
        return self._ring.from_dict(kept)

    def slope(self, array: Array, angle: int) -> Array:
        """Return the derivative in an angle."""
        at = self._first + angle
        if self._order is not None:
            return _each(array, lambda p: p.diff(self._ring.gens[at]))
        cosine, sine = self._ring.gens[at], self._ring.gens[at + self._n]
        return self.cut(_each(array, lambda p: p.diff(sine) * cosine - p.diff(cosine) * sine))

    def at_zero(self, array: Array) -> Array:
        """Return the value at zero angles."""
        turns = [
            (gen, int(self._order is None and k < self._n)) for k, gen in enumerate(self._ring.gens[self._first :])
        ]
        return _each(array, lambda p: p.subs(turns) if turns else p)

    def rotation(self, angle: int, axis: FloatArray) -> Array:
        """Return the rotation by an angle about an axis (3,)."""
        turn, at = cross_matrix(axis), self._first + angle
        if self._order is None:
            cosine, sine = self._ring.gens[at], self._ring.gens[at + self._n]
            square = self.numbers(turn @ turn)
            return np.asarray(self.numbers(np.eye(3)) + square + self.numbers(turn) * sine - square * cosine)
        power, out = np.eye(3), self.numbers(np.eye(3))
        for degree in range(1, self._order + 1):
            power = power @ turn / degree
            out = out + self.numbers(power) * self._ring.gens[at] ** degree
        return out

    def selected(self, polynomial: Polynomial, wanted: Callable[[tuple[int, ...]], bool]) -> Polynomial:
        """Return the terms that are wanted, by their powers of the symbols."""
        return self._ring.from_dict({m: c for m, c in polynomial.items() if wanted(m)})

    def split(self, polynomial: Polynomial, first: int) -> dict[int | None, Polynomial]:
        """Return the coefficients of the symbols from the place `first` on, in which it is linear, then the rest."""
        out: dict[int | None, dict[tuple[int, ...], Any]] = {}
        for powers, c in polynomial.items():
            at = next((k for k in range(first, len(powers)) if powers[k]), None)
            out.setdefault(at, {})[tuple(0 if k == at else power for k, power in enumerate(powers))] = c
        return {at: self._ring.from_dict(out[at]) for at in sorted(out, key=lambda at: (at is None, at))}

    def written(self, polynomial: Polynomial) -> Expression:
        """Return the polynomial in SymPy's symbols: parameters collected before what moves."""
        forms: dict[tuple[int, ...], list[Expression]] = {}
        for powers, c in sorted(polynomial.items(), key=lambda item: (sum(item[0]), [-power for power in item[0]])):
            number = rational(float(sympy.QQ.to_sympy(c)))
            simple = number.denominator <= _DENOMINATOR
            factor = sympy.Rational(number.numerator, number.denominator) if simple else sympy.Float(float(number))
            form = sympy.Mul(
                factor, *(self._shown[k] ** power for k, power in enumerate(powers[: self._fixed]) if power)
            )
            forms.setdefault(powers[self._fixed :], []).append(form)
        return sympy.Add(
            *(
                sympy.Add(*form)
                * sympy.Mul(*(self._shown[self._fixed + k] ** power for k, power in enumerate(moving) if power))
                for moving, form in forms.items()
            )
        )

    def matrix(self, array: Array) -> Expression:
        """Return an array as a matrix of SymPy."""
        return sympy.ImmutableDenseMatrix(*array.shape, [self.written(polynomial) for polynomial in array.ravel()])

    def used(self, *polynomials: Polynomial) -> set[int]:
        """Return the places of the symbols that occur."""
        return {k for p in polynomials for powers in p for k, power in enumerate(powers) if power}
