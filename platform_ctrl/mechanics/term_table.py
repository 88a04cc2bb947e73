"""A term of a gimbal's equation and the table of all of them."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from typing import Literal

import numpy as np

from platform_ctrl.common.arguments import known_name, known_names
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import LETTERS, dotted, initial, padded, width
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.plant.platform import Platform

Kind = Literal[
    "nutation",
    "inertia",
    "coupling inertia",
    "gyroscopic action",
    "Coriolis",
    "gyroscopic restraint",
    "centrifugal",
    "rotor acceleration",
    "inertia acceleration",
    "acceleration disturbance",
    "gyroscopic disturbance",
    "centrifugal disturbance",
    "spring",
    "friction",
    "cage",
    "unbalance",
    "erection",
]

# The paper's reading of what (27) keeps, in our words; the rest is ours.
MEANINGS: dict[Kind, str] = {
    "nutation": "inertia about the gimbal's own axis; matters for nutation and fast oscillation, not for precession",
    "inertia": "inertia about the gimbal's own axis",
    "coupling inertia": "inertia that a gimbal feels when another is accelerated; matters for fast motion only",
    "gyroscopic action": "a rotor that is turned about one axis pushes about the other; dominant with fast rotors",
    "Coriolis": "adds J Ω to the L of a gyroscopic action; dropped, because L is much larger",
    "gyroscopic restraint": "the turning platform pulls the rotor's axis towards its own: a spring, stable where rotor "
    "and platform turn in the same sense",
    "centrifugal": "the turning platform pulls the gimbal's inertia; adds J Ω to the L of a gyroscopic restraint",
    "rotor acceleration": "a change of the platform's rate, felt by a deflected rotor's axial inertia; usually small",
    "inertia acceleration": "the same, felt by the other inertias; as large as the rotor's, yet dropped",
    "acceleration disturbance": "a change of the platform's rate, felt by the gimbal's inertia; belongs with J q̈",
    "gyroscopic disturbance": "the torque that takes a rotor along with the platform; the main disturbance, and what "
    "a caged gyro measures",
    "centrifugal disturbance": "the turning platform pulls the inertia of the gimbal even undeflected; adds J Ω to "
    "the L of a gyroscopic disturbance",
    "spring": "a spring between the gimbal and its parent",
    "friction": "friction in the gimbal's bearing, dry friction by its describing function",
    "cage": "the contact of a closed cage",
    "unbalance": "specific force on a centre of mass off the fixed point",
    "erection": "an erecting device that follows the specific force",
}

DROPPED_BY_THE_PAPER: frozenset[Kind] = frozenset(
    {"Coriolis", "centrifugal", "inertia acceleration", "centrifugal disturbance"}
)


@value
class Term:
    """One term on the left side of a gimbal's equation.

    Attributes
    ----------
    gimbal
        Name of the gimbal whose equation contains it.
    label
        The term as in (27); ``J`` without a number is a combination of moments of inertia whose value is `coefficient`.
    kind, meaning
        What it is, and how to read it: the paper's reading of what (27) keeps.
    coefficient
        Coefficient of Omega and the coordinate, with its sign, SI.
    factor
        `coefficient` times its Omega: the coefficient of the coordinate (or, of a forcing term, the term), SI.
    column, derivative
        The gimbal whose angle it multiplies, and which derivative of it: 0, 1 or 2. None for a forcing term.
    size
        Its amplitude at the operating point, N m: the torque that is missing when it is dropped.
    share, torque_error
        `size` as a share of the largest of its equation, and of the sum of all of them.
    rank
        Place by size in its equation, from 1.
    sense
        Of a stiffness on the gimbal's own angle: ``"stable"`` or ``"unstable"``. A gyroscopic restraint is stable where
        rotor and platform turn in the same sense.
    kept
        Whether the paper's rule keeps it.
    pole_change, poles_lost
        What dropping it alone does to the poles of its subsystem: the largest relative change of those that remain, and
        how many go to infinity (all, where nothing else determines the motion). None for a forcing term, which no pole
        feels.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).

    See docs/terms.md.
    """

    gimbal: str
    label: str
    kind: Kind
    meaning: str
    coefficient: float
    factor: float
    column: str | None
    derivative: int | None
    size: float
    share: float
    torque_error: float
    rank: int
    sense: Literal["stable", "unstable"] | None
    kept: bool
    pole_change: float | None
    poles_lost: int | None


@value
class TermTable:
    """Every term of every gimbal's equation at an operating point.

    Attributes
    ----------
    platform
        The platform.
    Omega, Omega_dot : (3,)
        The platform's rate and its derivative, rad/s, rad/s².
    angles, rates, accelerations : (n,)
        Amplitudes of the gimbals' motion, rad, rad/s, rad/s².
    terms
        Equations in the file's order, the terms of each by falling size.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).

    See docs/terms.md.
    """

    platform: Platform
    Omega: FloatArray
    Omega_dot: FloatArray
    angles: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    terms: tuple[Term, ...]

    @check_arguments
    def of(self, gimbal: str) -> tuple[Term, ...]:
        """Return the terms of the named gimbal's equation, by falling size."""
        known_name("gimbal", gimbal, self.platform.gimbal_names)
        return tuple(term for term in self.terms if term.gimbal == gimbal)

    def dropped_by_the_paper(self) -> tuple[Term, ...]:
        """Return the terms that (27) leaves out, the largest of all equations first.

        Returns
        -------
        tuple of Term
            By falling size.
        """
        return tuple(sorted((term for term in self.terms if not term.kept), key=lambda term: -term.size))

    @check_arguments
    def text(self, gimbals: Sequence[str] | None = None, smallest: float = 0.0) -> str:
        """Return the table as aligned text.

        Parameters
        ----------
        gimbals
            Names of those whose equations are wanted, shown in the file's order; default all.
        smallest
            Terms whose share of the largest of their equation is not above this are left out; by default those that are
            zero at the operating point.

        Returns
        -------
        str
            A block for each gimbal.
        """
        names = self.platform.gimbal_names
        lines = []
        for k in known_names("gimbals", names if gimbals is None else gimbals, names):
            gimbal, terms = names[k], self.of(names[k])
            shown = [term for term in terms if term.share > smallest]
            lines.append(f"gimbal {gimbal}: {len(shown)} of {len(terms)} terms")
            head = ("", "term", "kind", "N m", "share", "poles", "paper", "")
            cells = [head, *(_cells(term) for term in shown)]
            widths = [max(width(row[k]) for row in cells) for k in range(len(head))]
            lines += ["  ".join(padded(row[k], widths[k]) for k in range(len(head))).rstrip() for row in cells if shown]
        return "\n".join(lines) or f"platform {self.platform.name!r} has no gimbals: there is no term to rank"

    def legend(self) -> str:
        """Return what the kinds of terms that occur mean, a line each.

        Returns
        -------
        str
            For the terms of this table alone.
        """
        kinds = dict.fromkeys(term.kind for term in self.terms)
        return "\n".join(f"{kind}: {MEANINGS[kind]}" for kind in MEANINGS if kind in kinds)


def _cells(term: Term) -> tuple[str, ...]:
    poles = "" if term.pole_change is None else f"{term.pole_change:.1e}"
    if term.poles_lost:
        poles += f", {term.poles_lost} lost"
    size, share = f"{term.size:.2e}", f"{100 * term.share:.3g} %"
    kept = "kept" if term.kept else "dropped"
    return (str(term.rank), term.label, term.kind, size, share, poles, kept, term.sense or "")


def coordinate(angle: str, derivative: int) -> str:
    """Return an angle or its derivative: ``alpha4``, 2 becomes α̈4."""
    head, _ = initial(angle)
    if len(LETTERS.get(head, head)) == 1:
        return unicodedata.normalize("NFC", dotted(angle, derivative))
    return ("{}", "d({})/dt", "d²({})/dt²")[derivative].format(angle)


def rates(monomial: str) -> str:
    """Return a product of platform rates: ``Omega1*Omega2`` becomes Ω1 Ω2, ``Omega1'`` Ω̇1, and ``1`` nothing."""
    if monomial == "1":
        return ""
    changing = re.sub("Omega([123])'", "Ω\u0307\\1", monomial)
    return changing.replace("Omega", "Ω").replace("*", " ").replace("^2", "²")


def symbol(letter: str, name: str) -> str:
    """Return a quantity of a body: L6, J_outer."""
    return f"{letter}{name}" if name[:1].isdigit() else f"{letter}_{name}"


def combination(names: Sequence[str], weights: FloatArray) -> str:
    """Return a sum of named quantities: (L6 − L8), −L8, 0.5 L6."""
    out = ""
    relevant = [k for k in range(len(names)) if abs(weights[k]) > 1e-12 * np.abs(weights).max()]
    for k in relevant:
        size = abs(weights[k])
        sign = "−" if weights[k] < 0.0 else "+"
        number = "" if abs(size - 1.0) < 1e-9 else f"{size:.3g} "
        joint = f" {sign} " if out else sign.replace("+", "")
        out += f"{joint}{number}{names[k]}"
    return f"({out})" if len(relevant) > 1 else out


def product(*factors: str) -> str:
    """Return factors with spaces between those that are not empty."""
    return " ".join(factor for factor in factors if factor)
