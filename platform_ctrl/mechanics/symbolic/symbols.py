"""The symbols of a platform: of what moves, of its inertias and momenta, and of its force elements."""

from __future__ import annotations

import builtins
import keyword
import unicodedata
from typing import Literal, NamedTuple

import numpy as np
import sympy

from platform_ctrl.common.text import dotted
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.mechanics.forces import ForceElements
from platform_ctrl.mechanics.kinematics import Topology, kinematics
from platform_ctrl.mechanics.polynomials import without_elements
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


class Motion(NamedTuple):
    """Symbols of what changes with time: Omega, Omega' and M by root axis, the others by gimbal."""

    Omega: tuple[NamedSymbol, ...]
    Omega_dot: tuple[NamedSymbol, ...]
    accelerations: tuple[NamedSymbol, ...]
    rates: tuple[NamedSymbol, ...]
    angles: tuple[NamedSymbol, ...]
    torques: tuple[NamedSymbol, ...]
    root_torques: tuple[NamedSymbol, ...]


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


def inertia_symbols(
    platform: Platform, tree: Topology, names: SymbolNames
) -> list[tuple[NamedSymbol, tuple[int, int, int]]]:
    """Return the symbols of what turns with each body at zero angles, without C; their body (0: all), row, column."""
    composites: FloatArray = tree.inertias.copy()
    for k in reversed(tree.order):
        composites[1 + tree.parents[k]] += composites[1 + k]
    out = []
    for body, S in enumerate(composites):
        label = "" if body == 0 else platform.gimbals[body - 1].name
        of = "the whole platform" if body == 0 else f"all that turns with gimbal {label}"
        along = np.flatnonzero(platform.gimbals[body - 1].axis).tolist() if body else []
        own = along[0] if len(along) == 1 else None
        for i, j in sorted(_ENTRIES, key=lambda entry: entry != (own, own)):  # that about the gimbal's axis first
            if abs(S[i, j]) <= _ZERO * np.abs(S).max():
                continue
            part = f"{i + 1}" if i == j else f"{i + 1}{j + 1}"
            about = f"inertia about axis {part}" if i == j else f"product of inertia, entry {i + 1}, {j + 1},"
            about += ", its own," * (i == j == own)
            shown = joined("J", part) if body == 0 else joined("J", label, "" if i == j == own else part)
            symbol = names.symbol(shown, "inertia", f"{about} of {of}", "kg m²", float(S[i, j]))
            out.append((symbol, (body, i, j)))
    return out


def rotor_symbols(platform: Platform, names: SymbolNames) -> tuple[list[NamedSymbol | None], list[NamedSymbol]]:
    """Return the symbols of the rotors' axial inertias, None of free ones, and of their momenta."""
    C = [
        None
        if rotor.control == "free"
        else names.symbol(
            joined("C", rotor.name),
            "axial inertia",
            f"axial inertia of rotor {rotor.name}",
            "kg m²",
            rotor.axial_inertia,
        )
        for rotor in platform.rotors
    ]
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
    n, f = len(platform.gimbals), platform.specific_force
    out, notes = list[Element](), list[str]()
    for friction in platform.frictions:
        if any(friction.breakaway):
            notes.append(f"dry friction of gimbal {friction.gimbal} is left out: it has no slope at rest")
    for cage in platform.cages:
        if cage.clearance and abs(cage.angle) <= cage.clearance:
            notes.append(f"cage of gimbal {cage.gimbal} is left out: within its clearance it does not act")
    if platform.erections and not f.any():
        notes.append("erection is left out: there is no specific force")
    families = (
        ("springs", "gimbal", "k", "spring at gimbal {}", "N m/rad", "stiffness"),
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
            if head in ("d", "dc"):
                parts = np.zeros((n, n)), -slopes.rate, still
            else:
                parts = -slopes.angle[3:], np.zeros((n, n)), -acting.forces(still, still)[3:]
            number, label = getattr(element, strength), getattr(element, where)
            size = float(np.linalg.norm(number) if np.ndim(number) else number)
            if size and any(part.any() for part in parts):
                symbol = names.symbol(joined(head, label), "element", meaning.format(label), unit, size)
                out.append(Element(symbol, *(part / size for part in parts)))
    return out, notes
